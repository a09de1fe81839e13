//! `metamorph explore`: scenarios drawn from numbers, run on the simulated link until something is
//! wrong; what is wrong is made small and written as an ordinary scenario file.
//!
//! `draw` makes a [`draft`] of a scenario from a seed, `pool` runs many, `verdict` judges each,
//! `shrink` makes a failing one small, `summary` says what all of them came to.
//!
//! *Invariant.* One seed is one run, whatever runs beside it; the results of so many runs do not depend
//! on the number of threads. Deliberately absent: the process link, where a run cannot be repeated.

pub mod draft;
pub mod draw;
pub mod limits;
pub mod pool;
pub mod shrink;
pub mod summary;
pub mod verdict;

use crate::console::escape::{Shown, portable};
use crate::console::format::{many, rate, seconds};
use crate::console::interrupt::Interrupt;
use crate::console::output::{Json, OutputError, Outputs};
use crate::console::stopwatch::Stopwatch;
use crate::console::terminal::{Channel, Live};
use crate::family::{self, Family, simulate};
use crate::scenario::Plan;
use draft::Draft;
use draw::draw;
use limits::Limits;
use metamorph_protocol::coverage::{self, Marks};
use metamorph_protocol::defects::Sabotage;
use metamorph_sim_bridge::director::outcome::Outcome;
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
use verdict::{Failure, Kind, Verdict, judge};

/// So many kinds of failures are made small; more of them say no more.
const MOST_FOUND: usize = 16;

/// What `metamorph explore` was asked for.
#[derive(Clone)]
pub struct Request {
    /// How much.
    pub budget: Budget,
    /// The first seed; drawn if left out.
    pub seed: Option<u64>,
    /// One family only.
    pub family: Option<&'static dyn Family>,
    /// How many threads.
    pub jobs: NonZeroUsize,
    /// Where failing scenarios go.
    pub out: PathBuf,
    /// Where the numbers go as JSON.
    pub json: Option<PathBuf>,
    /// Whether to say nothing but errors.
    pub quiet: bool,
}

/// How much is explored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Budget {
    /// So many runs.
    Runs(u64),
    /// This much time, in which failures are made small as well. A run under way at its end is dropped.
    Time(Duration),
}

/// Why an exploration did not come to an end.
#[derive(Debug, Error)]
pub enum ExploreError {
    /// Signals cannot be caught.
    #[error("cannot listen for Ctrl-C: {0}")]
    Signals(io::Error),
    /// The numbers or a scenario cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// The directory cannot be made.
    #[error("--out {}: cannot make it: {error}\n  fix: name a directory in one that exists and is yours", .path.shown())]
    Directory {
        /// Which.
        path: PathBuf,
        /// Why.
        error: io::Error,
    },
}

/// What a run came to.
#[derive(Clone, Debug)]
pub struct Ran {
    /// The family, and the protocol in it.
    pub protocol: String,
    /// Why it stood still, in words, if it did.
    pub reason: Option<&'static str>,
    /// What it is judged.
    pub verdict: Verdict,
    /// How it ended; none if it panicked.
    pub outcome: Option<Outcome>,
    /// Rare paths that it took.
    pub marks: Marks,
    /// Messages handed to agents, and what bodies and agents told each other.
    pub events: u64,
    /// Moves completed.
    pub moves: u64,
    /// Messages sent.
    pub messages: u64,
}

/// Runs a plan and judges it. `None` if `stop` was true before that was done.
pub fn run(plan: &Plan, stop: &dyn Fn() -> bool) -> Option<Ran> {
    // What drawing or an earlier run has set is none of this run's.
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
            outcome: None,
            marks,
            events: 0,
            moves: 0,
            messages: 0,
        });
    };
    let outcome = Outcome::ALL.into_iter().find(|o| o.name() == report.outcome);
    (outcome != Some(Outcome::Aborted)).then(|| Ran {
        protocol,
        reason: account.stall.as_ref().map(|stall| stall.text),
        verdict: judge(&report, &account),
        outcome,
        marks,
        events: report.messages.all.delivered + report.body_messages,
        moves: report.moves,
        messages: report.messages.total,
    })
}

/// A failing scenario, made small.
#[derive(Clone, Debug)]
pub struct Small {
    /// The scenario.
    pub draft: Draft,
    /// How it fails.
    pub failure: Failure,
    /// How many runs that took.
    pub runs: u64,
}

/// Makes a failing scenario small in at most so many runs, and hands over each scenario that is smaller than
/// those before and fails the same way; first the one that was given. Nothing is handed over if that does not
/// fail. Ends early when `stop` is true.
pub fn make_small(
    draft: &Draft,
    kind: &Kind,
    sabotage: Option<Sabotage>,
    budget: u64,
    stop: &dyn Fn() -> bool,
    mut take: impl FnMut(Small),
) {
    let fails = |draft: &Draft| {
        let plan = draft.plan("shrunk.toml", sabotage).ok()?;
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

/// The smallest scenario that is found within the limits. The search for it is on a thread of its own, which
/// is not waited for when the limits have ended.
fn smallest(draft: &Draft, kind: &Kind, budget: u64, limits: &Limits) -> Option<Small> {
    let (sender, receiver) = channel();
    let (draft, kind, within) = (draft.clone(), kind.clone(), limits.clone());
    let worker = thread::spawn(move || {
        let take = |small| {
            // If nobody listens, the limits have ended, which `make_small` sees itself.
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

/// Does what was asked for, and gives the exit code.
pub fn explore(request: &Request) -> Result<u8, ExploreError> {
    let interrupt = Interrupt::listen().map_err(ExploreError::Signals)?;
    interrupt.begin();
    // Small enough to be typed again, large enough to be new.
    let seed = request.seed.unwrap_or_else(|| RandomState::new().hash_one(0) >> 28);
    let mut outputs = Outputs::new();
    let json = Json::of(request.json.as_deref(), &mut outputs)?;
    let channel = Channel::beside(json.is_out(), request.quiet);
    let one_run = request.budget == Budget::Runs(1);
    channel.say(&format!(
        "exploring from seed {seed}{}\n",
        if one_run { format!("\n\n{}", draw(seed, request.family).0) } else { String::new() }
    ));
    let limits = Limits::new(request.budget, interrupt.clone());
    let (mut tallies, mut live) = (Tallies::default(), Live::new(!request.quiet));
    pool::run(seed, request, &limits, |number, ran| {
        // Now, because making it small can take long, and nothing is known of it if that is interrupted.
        if let Some(failure) = tallies.add(number, &ran) {
            limits.note_failure();
            live.clear();
            let repeat = repeat(seed.wrapping_add(number), request.family);
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
    let summary = Summary::new(seed, request.family, tallies, found);
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

/// Makes the first failure of each kind small and writes it down.
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
        let (draft, plan) = draw(first, request.family);
        let mut found = Found {
            kind: kind.clone(),
            protocol: protocol.clone(),
            seed: first,
            seeds,
            runs: failures.count,
            what: failures.what.clone(),
            repeat: repeat(first, request.family),
            scenario: None,
            here: None,
            agents: draft.modules(),
            faults: draft.faults.len(),
            shrinking: 0,
        };
        if all.len() < MOST_FOUND
            && let Some(small) = smallest(&draft, kind, family::of(&plan).shrinking(), limits)
        {
            let path = request.out.join(format!("explored-{}.toml", found.seed));
            let repeat = &found.repeat;
            let description =
                format!("{kind}: {}. Found with `{repeat}`, then made small.", small.failure.what);
            fs::create_dir_all(&request.out)
                .map_err(|error| ExploreError::Directory { path: request.out.clone(), error })?;
            let text = Draft { description, ..small.draft.clone() }.to_string();
            outputs.writes("--out", &path)?.write(text)?;
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

/// The command that repeats the run of a seed.
fn repeat(seed: u64, family: Option<&dyn Family>) -> String {
    let family = family.map_or(String::new(), |f| format!(" --family {}", f.name()));
    format!("metamorph explore --runs 1 --seed {seed}{family}")
}
