//! `metamorph explore`: runs generated scenarios on the simulated link; failures are shrunk and written as
//! ordinary scenario files.
//!
//! `draw` creates a [`GeneratedScenario`] from a seed, `commands` those of operators in it, `pool` runs many,
//! `verdict` judges each, `shrink` reduces failing ones, `summary` collects the results.
//!
//! *Invariant.* A seed determines a run, whatever runs beside it; results do not depend on the number of
//! threads. Absent: the process link, where runs are not deterministic.

pub mod commands;
pub mod draw;
pub mod generated_scenario;
pub mod limits;
pub mod pool;
pub mod shrink;
pub mod summary;
pub mod verdict;

use draw::{Drawn, draw};
use generated_scenario::GeneratedScenario;
use limits::Limits;
use metamorph_console::interrupt::Interrupt;
use metamorph_console::output::{Json, OutputError, Outputs};
use metamorph_console::output_kind::OutputKind;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::{Channel, Live};
use metamorph_processes::family::{self, simulate};
use metamorph_protocol::coverage::{self, CoveragePoints};
use metamorph_protocol::defects::Defect;
use metamorph_scenario::Plan;
use metamorph_scenario::quote;
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_text::command_error::{CommandError, FAILED};
use metamorph_text::escape::{Shown, portable};
use metamorph_text::format::{many, rate, seconds};
use metamorph_text::program;
use std::fs;
use std::hash::{BuildHasher, RandomState};
use std::io;
use std::num::NonZeroUsize;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::path::PathBuf;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::thread;
use std::time::Duration;
use summary::{Found, Summary, Tallies};
use thiserror::Error;
use verdict::{Failure, Kind, Verdict, could_be_built, judge};

/// Largest number of kinds of failures that are shrunk.
const FAILURE_KINDS_MAX: usize = 16;

/// The arguments of `metamorph explore`.
#[derive(Clone)]
pub struct Request {
    /// The number of runs or the time.
    pub budget: Budget,
    /// The first seed; drawn if `None`.
    pub seed: Option<u64>,
    /// Which scenarios are drawn.
    pub drawn: Drawn,
    /// Number of threads.
    pub jobs: NonZeroUsize,
    /// The directory for failing scenarios.
    pub out: PathBuf,
    /// The destination of the results as JSON.
    pub json: Option<PathBuf>,
    /// True to print errors only.
    pub quiet: bool,
}

/// The amount of exploration.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Budget {
    /// This many runs.
    Runs(u64),
    /// This much time, including shrinking. Runs active at its end are dropped.
    Time(Duration),
}

/// Why an exploration failed.
#[derive(Debug, Error)]
pub enum ExploreError {
    /// Signals cannot be caught.
    #[error("cannot listen for Ctrl-C: {0}")]
    Signals(io::Error),
    /// The numbers or a scenario cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// The directory cannot be created.
    #[error("--out {}: cannot create it: {error}\n  fix: name a directory in one that exists and is yours", .path.shown())]
    Directory {
        /// The directory.
        path: PathBuf,
        /// The cause.
        error: io::Error,
    },
}

impl CommandError for ExploreError {
    fn exit_code(&self) -> u8 {
        match self {
            ExploreError::Output(error) => error.exit_code(),
            _ => FAILED,
        }
    }
}

/// The result of a run.
#[derive(Clone, Debug)]
pub struct Ran {
    /// The protocol, with its family.
    pub protocol: String,
    /// The reason of a standstill, if there was one.
    pub reason: Option<&'static str>,
    /// The verdict.
    pub verdict: Verdict,
    /// Whether any robot with these modules could have built the goal; `None` if that is not decided.
    pub could: Option<bool>,
    /// The outcome; `None` if the run panicked.
    pub outcome: Option<Outcome>,
    /// Coverage points reached.
    pub marks: CoveragePoints,
    /// Messages delivered to agents, plus messages between agents, bodies and the controller.
    pub events: u64,
    /// Standstills in the course of the run.
    pub standstills: u64,
    /// Standstills that the controller resolved.
    pub rescued: u64,
    /// Moves completed.
    pub moves: u64,
    /// Messages sent.
    pub messages: u64,
}

/// Runs a plan and judges it. `None` if `stop` returned true before that was done.
pub fn run(plan: &Plan, stop: &dyn Fn() -> bool) -> Option<Ran> {
    // Discard coverage points from drawing or an earlier run.
    coverage::take();
    let since = Stopwatch::start();
    let simulated = catch_unwind(AssertUnwindSafe(|| simulate(plan, since, &mut |_, _| !stop())));
    let marks = coverage::take();
    let protocol = format!("{}, {}", plan.swarm.family(), plan.swarm.protocol());
    let Ok((report, account)) = simulated else {
        let failure = Failure { kind: Kind::Panic, what: "the program panicked".into() };
        let verdict = Verdict::Failed(failure);
        return Some(Ran {
            protocol,
            reason: None,
            verdict,
            could: None,
            outcome: None,
            marks,
            standstills: 0,
            rescued: 0,
            events: 0,
            moves: 0,
            messages: 0,
        });
    };
    let outcome = Outcome::ALL.into_iter().find(|o| o.name() == report.outcome);
    (outcome != Some(Outcome::Aborted)).then(|| {
        let (verdict, could) = could_be_built(judge(&report, &account), &account);
        Ran {
            protocol,
            reason: account.stall.as_ref().map(|stall| stall.text),
            could,
            verdict,
            outcome,
            marks,
            events: report.messages.all.delivered + report.body_messages,
            standstills: report.standstills.as_ref().map_or(0, |all| all.count),
            rescued: report.standstills.as_ref().map_or(0, |all| all.rescued),
            moves: report.moves,
            messages: report.messages.total,
        }
    })
}

/// A shrunk failing scenario.
#[derive(Clone, Debug)]
pub struct Small {
    /// The scenario.
    pub draft: GeneratedScenario,
    /// The failure.
    pub failure: Failure,
    /// Runs needed for shrinking.
    pub runs: u64,
}

/// Shrinks a failing scenario in at most `budget` runs. Calls `take` with the given scenario, and then with
/// each smaller one that fails the same way; never calls it if the given one does not fail. Ends early when
/// `stop` returns true.
pub fn make_small(
    draft: &GeneratedScenario,
    kind: &Kind,
    defect: Option<Defect>,
    budget: u64,
    stop: &dyn Fn() -> bool,
    mut take: impl FnMut(Small),
) {
    let fails = |draft: &GeneratedScenario| {
        let plan = draft.plan("shrunk.toml", defect).ok()?;
        match run(&plan, stop)?.verdict {
            Verdict::Failed(failure) if failure.kind == *kind => Some(failure),
            _ => None,
        }
    };
    let Some(failure) = fails(draft) else { return };
    take(Small { draft: draft.clone(), failure, runs: 0 });
    let mut runs = 0;
    shrink::shrink(draft, budget, |draft| {
        runs += 1;
        let failure = if stop() { None } else { fails(draft) };
        let fails = failure.is_some();
        if let Some(failure) = failure {
            take(Small { draft: draft.clone(), failure, runs });
        }
        fails
    });
}

/// Returns the smallest failing scenario found within the limits. The search runs on a thread of its own,
/// which is not waited for at the limits.
fn smallest(draft: &GeneratedScenario, kind: &Kind, budget: u64, limits: &Limits) -> Option<Small> {
    let (sender, receiver) = channel();
    let (draft, kind, within) = (draft.clone(), kind.clone(), limits.clone());
    let worker = thread::spawn(move || {
        let take = |small| {
            // If the receiver is gone, the limits have ended, which `make_small` checks itself.
            let _ = sender.send(small);
        };
        make_small(&draft, &kind, None, budget, &|| within.end(), take);
    });
    let mut smallest = None;
    while !limits.end() {
        match receiver.recv_timeout(pool::LOOK) {
            Ok(small) => smallest = Some(small),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => {
                worker.join().unwrap_or_else(|panic| resume_unwind(panic));
                break;
            }
        }
    }
    smallest
}

/// Executes the request, and returns the exit code.
pub fn explore(request: &Request) -> Result<u8, ExploreError> {
    let interrupt = Interrupt::listen().map_err(ExploreError::Signals)?;
    interrupt.begin();
    // Small enough to be retyped, large enough to be new.
    let seed = request.seed.unwrap_or_else(|| RandomState::new().hash_one(0) >> 28);
    let mut outputs = Outputs::new();
    let json = Json::of(request.json.as_deref(), &mut outputs)?;
    let channel = Channel::beside(json.is_out(), request.quiet);
    let one_run = request.budget == Budget::Runs(1);
    channel.say(&format!(
        "exploring from seed {seed}{}\n",
        if one_run { format!("\n\n{}", draw(seed, request.drawn).0) } else { String::new() }
    ));
    let limits = Limits::new(request.budget, interrupt.clone());
    let (mut tallies, mut live) = (Tallies::default(), Live::new(!request.quiet));
    pool::run(seed, request, &limits, |number, ran| {
        // Report it now, because shrinking can take long and may be interrupted.
        if let Some(failure) = tallies.add(number, &ran) {
            limits.note_failure();
            live.clear();
            let repeat = repeat(seed.wrapping_add(number), request.drawn);
            channel.say(&format!("{} ({}): {}\n  {repeat}\n", failure.kind, ran.protocol, failure.what));
        }
        live.show(|| {
            let (runs, rate) =
                (many(tallies.runs, "run"), rate(tallies.runs, limits.elapsed().as_secs_f64()));
            format!("{runs}  {}  {rate}", many(tallies.failed(), "failure"))
        });
    });
    live.clear();
    let drawing = limits.elapsed().as_secs_f64();
    let interrupted = interrupt.is_set();
    let found = found(request, seed, &tallies, &mut outputs, &limits)?;
    let summary = Summary::new(seed, request.drawn.family, tallies, found);
    channel.say(&summary::text(&summary, channel.paint()));
    channel.say(&format!(
        "  {} on {}; {} were drawn\n",
        seconds(limits.elapsed().as_secs_f64()),
        many(request.jobs.get() as u64, "thread"),
        rate(summary.runs, drawing)
    ));
    json.write(&summary)?;
    Ok(match () {
        () if summary.found.iter().any(|f| f.kind.is_unsafe()) => Outcome::Unsafe.exit_code(),
        () if !summary.found.is_empty() => Outcome::Deadlock.exit_code(),
        () if interrupted => Outcome::Aborted.exit_code(),
        () => 0,
    })
}

/// Shrinks the first failure of each kind, and writes it to a file.
fn found(
    request: &Request,
    seed: u64,
    tallies: &Tallies,
    outputs: &mut Outputs,
    limits: &Limits,
) -> Result<Vec<Found>, ExploreError> {
    let mut all = Vec::new();
    for ((kind, protocol), failures) in tallies.failures() {
        let seeds = summary::seeds(seed, &failures.first);
        let first = *seeds.first().expect("invariant: what failed has a first run");
        let (draft, plan) = draw(first, request.drawn);
        let mut found = Found {
            kind: kind.clone(),
            protocol: protocol.clone(),
            seed: first,
            seeds,
            runs: failures.count,
            what: failures.what.clone(),
            repeat: repeat(first, request.drawn),
            scenario: None,
            here: None,
            agents: draft.modules(),
            faults: draft.faults.len(),
            shrinking: 0,
        };
        if all.len() < FAILURE_KINDS_MAX
            && let Some(small) = smallest(&draft, kind, family::of(&plan).shrinking(), limits)
        {
            let path = request.out.join(format!("explored-{}.toml", found.seed));
            let repeat = &found.repeat;
            let description = format!("{kind}: {}. Found with `{repeat}`, then shrunk.", small.failure.what);
            fs::create_dir_all(&request.out)
                .map_err(|error| ExploreError::Directory { path: request.out.clone(), error })?;
            let text = GeneratedScenario { description, ..small.draft.clone() }.to_string();
            outputs.writes("--out", &path, OutputKind::Any)?.write(text)?;
            (found.agents, found.faults) = (small.draft.modules(), small.draft.faults.len());
            found.what = small.failure.what;
            found.shrinking = small.runs;
            found.scenario = Some(portable(&path));
            found.here = Some(path);
        }
        all.push(found);
    }
    Ok(all)
}

/// Returns the command that repeats the run of a seed.
fn repeat(seed: u64, drawn: Drawn) -> String {
    let program = quote(program::name().to_owned());
    format!("{program} explore --runs 1 --seed {seed}{}", drawn.options())
}
