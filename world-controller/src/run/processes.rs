//! Runs a plan with one process per module, over shared memory. What a swarm of processes is, and
//! how it is supervised, is in `swarm`; here a plan goes in and a report comes out.

use crate::console::escape::Shown;
use crate::console::format::{many, seconds};
use crate::console::progress::Status;
use crate::console::stopwatch::Stopwatch;
use crate::console::terminal::Live;
use crate::record::journal::{HeadError, Journal, JournalError, Keeping, parts_of, plan_of};
use crate::record::tee::both;
use crate::report::balance::unbalanced;
use crate::report::schema::Report;
use crate::report::{Facts, progress, report};
use crate::run::replay::{RecoverError, Recovered, recover};
use crate::run::runnable::Runnable;
use crate::scenario::{Plan, Swarm};
use crate::swarm::{
    CleanError, Crash, FULL, Meter, NotResumable, Resumption, SwarmError, SwarmOptions, SwarmOutcome, WATCH,
    adopt, clean, resume_swarm, run_swarm,
};
use metamorph_module_agent::clock::Speed;
use metamorph_module_agent::journal_file::{Head, Parts, Reader, RunId, controller_part};
use metamorph_module_agent::process::args::ArgsError;
use metamorph_module_agent::registry;
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::record::Outside;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::Time;
use metamorph_sim_bridge::cube::director::Progress;
use metamorph_sim_bridge::director::faults::Struck;
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_sim_bridge::director::port::Direct;
use metamorph_sim_bridge::kernel::recording::{Log, RecordedDirector, RecordedWorld};
use metamorph_sim_bridge::kernel::state::world_hash;
use metamorph_sim_bridge::world::World;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;
use thiserror::Error;

/// Why processes cannot be run.
#[derive(Debug, Error)]
pub enum ProcessError {
    /// This program does not know where it is.
    #[error("cannot find this program's own file, which agents are started from: {0}")]
    Program(std::io::Error),
    /// The swarm.
    #[error(transparent)]
    Swarm(#[from] SwarmError),
    /// A journal cannot be read or written.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// A journal's scenario cannot be read.
    #[error(transparent)]
    Head(#[from] HeadError),
    /// There is no run.
    #[error(
        "{}: there is nothing to go on with: {why}\n  fix: name the journal of a run of processes whose controller was killed",
        .file.shown()
    )]
    NothingLeft {
        /// The journal.
        file: PathBuf,
        /// Why.
        why: &'static str,
    },
    /// A run cannot be gone on with.
    #[error(transparent)]
    NotResumable(#[from] NotResumable),
    /// A journal does not lead to where the run was.
    #[error("the run cannot be resumed, because its journal does not lead to where it was: {0}")]
    Recovery(RecoverError),
    /// What killed runs left behind.
    #[error(transparent)]
    Clean(#[from] CleanError),
    /// The arguments of an agent.
    #[error(transparent)]
    Args(#[from] ArgsError),
    /// One agent.
    #[error("{0}")]
    Agent(String),
}

impl From<RecoverError> for ProcessError {
    fn from(error: RecoverError) -> ProcessError {
        match error {
            RecoverError::Damaged(damage) => JournalError::from(damage).into(),
            different => ProcessError::Recovery(different),
        }
    }
}
/// Agents may be late by this part of a move, or of a step of a joint, before time is slowed: that much later
/// than usual no answer is given up, and leases and heartbeats are forty and more times as long.
const TOLERATED: u64 = 10;

/// Runs to the end, or until a signal asks for it. `since` is when the program started; `patience` is
/// how long agents wait for a controller to come back, if a journal is kept.
pub fn run_processes(
    plan: &Plan,
    live: &mut Live,
    since: Stopwatch,
    keeping: Option<Keeping>,
    patience: Duration,
    scribe: Option<Log>,
) -> Result<Report, ProcessError> {
    match &plan.swarm {
        Swarm::Cubes(cubes) => run(cubes, plan, live, since, keeping, patience, scribe),
        Swarm::Metamodules(metamodules) => run(metamodules, plan, live, since, keeping, patience, scribe),
    }
}

/// A run of processes whose controller was killed.
pub struct LeftBehind {
    /// The plan that it was made by.
    pub plan: Plan,
    file: PathBuf,
    run: RunId,
    part: Reader,
}

/// Finds the run that keeps this journal.
pub fn left_behind(file: &Path) -> Result<LeftBehind, ProcessError> {
    let file = std::path::absolute(file).map_err(|e| JournalError::Read(file.to_owned(), e))?;
    let parts = parts_of(&file);
    if !parts.is_dir() {
        let over = "the run is over, and this is all of its journal";
        let why = if file.is_file() { over } else { "no run keeps its journal there" };
        return Err(ProcessError::NothingLeft { file, why });
    }
    let path = controller_part(&parts);
    let part = Reader::open(&path)?;
    let Head::Run(head) = part.head().clone() else {
        return Err(JournalError::Unfit(path, "this is the part of a module".to_owned()).into());
    };
    // Taking the run over ends its agents if that fails. Damage is found before.
    for record in Journal::open(&parts)? {
        record.map_err(JournalError::from)?;
    }
    Ok(LeftBehind { plan: plan_of(&head)?, file, run: head.run, part })
}

/// Goes on with a run from its journal.
pub fn resume_processes(
    left: LeftBehind,
    live: &mut Live,
    since: Stopwatch,
    scribe: Option<Log>,
) -> Result<Report, ProcessError> {
    match &left.plan.clone().swarm {
        Swarm::Cubes(cubes) => resume(cubes, left, live, since, scribe),
        Swarm::Metamodules(metamodules) => resume(metamodules, left, live, since, scribe),
    }
}

fn options<R: Runnable>(swarm: &R, plan: &Plan, parts: Option<&Parts>) -> Result<SwarmOptions, ProcessError> {
    let program = std::env::current_exe().map_err(ProcessError::Program)?;
    Ok(SwarmOptions {
        // `--` keeps the agent's arguments from being read as options of this program.
        program_args: vec!["agent".into(), "--".into(), R::FAMILY.name().into()],
        seed: plan.seed,
        speed: speed(plan.time_scale),
        tolerance: swarm.beat() / TOLERATED,
        link: plan.link.clone(),
        // A swarm ends at once if it is interrupted while it is being set up.
        catch_signals: true,
        watcher: Some((program.clone(), vec![WATCH.into()])),
        journal: parts.cloned(),
        ..SwarmOptions::new(program)
    })
}

fn run<R: Runnable>(
    swarm: &R,
    plan: &Plan,
    live: &mut Live,
    since: Stopwatch,
    keeping: Option<Keeping>,
    patience: Duration,
    scribe: Option<Log>,
) -> Result<Report, ProcessError> {
    let mut world = swarm.world(plan);
    let mut options = options(swarm, plan, keeping.as_ref().and_then(Keeping::parts))?;
    options.patience = if keeping.is_some() { patience } else { Duration::ZERO };
    let brain = swarm.director(plan);
    let mut director =
        Watched::<R> { brain, plan, live, meter: Meter::new(&options), share: Arc::clone(&options.share) };
    tracing::info!(modules = world.len(), seed = plan.seed, "the swarm starts");
    let before = since.elapsed();
    let setup = swarm.setup().as_ref();
    let outcome = match both(keeping.as_ref().map(Keeping::log), scribe) {
        None => run_swarm(&options, setup, &mut world, &mut director)?,
        Some(log) => {
            let mut recorded = RecordedWorld::new(world, log.clone());
            let mut brain = RecordedDirector::new(director, log);
            let ran = run_swarm(&options, setup, &mut recorded, &mut brain);
            let give_up = |_: &SwarmError| keeping.iter().for_each(Keeping::give_up);
            let outcome = ran.inspect_err(give_up)?;
            (world, director) = (recorded.into_inner(), brain.into_inner());
            outcome
        }
    };
    director.live.clear();
    Ok(conclude(swarm, plan, world, director.brain, &outcome, before, keeping, Vec::new()))
}

fn resume<R: Runnable>(
    swarm: &R,
    left: LeftBehind,
    live: &mut Live,
    since: Stopwatch,
    scribe: Option<Log>,
) -> Result<Report, ProcessError> {
    let LeftBehind { plan, file, run, mut part } = left;
    let plan = &plan;
    // First of all, so that nobody writes to the journal any more while it is read.
    let parts = parts_of(&file);
    let adopted = adopt(&parts)?;
    let recovered = recover(swarm, plan, part.by_ref())?;
    let Recovered { world, director, struck, until, lives, latest, awaited, finishing, counted } = recovered;
    let mut said =
        vec![format!("the controller was killed; another went on from {}", seconds(until.as_secs_f64()))];
    said.extend(
        part.torn().map(|torn| {
            format!("the controller's part of the journal was cut off after {} bytes", torn.whole)
        }),
    );
    if let Some(scribe) = &scribe {
        // Whoever looks on is told what happened before.
        for record in Reader::open(&controller_part(&parts))? {
            scribe.borrow_mut().put(&record.map_err(JournalError::from)?);
        }
    }
    let keeping = Keeping::going_on(&file, run, part.end(), until)?;
    let options = options(swarm, plan, keeping.parts())?;
    let director = Watched::<R> {
        brain: director,
        plan,
        live,
        meter: Meter::new(&options),
        share: Arc::clone(&options.share),
    };
    let before = since.elapsed();
    let log = both(Some(keeping.log()), scribe).expect("invariant: two logs make one, and one is there");
    let mut recorded = RecordedWorld::new(world, log.clone());
    let mut brain = RecordedDirector::after(director, log, struck);
    let resumption = Resumption { until, lives, latest, awaited, finishing, counted };
    let ran = resume_swarm(&options, adopted, resumption, &mut recorded, &mut brain);
    let outcome = ran.inspect_err(|_| keeping.give_up())?;
    let Watched { brain, live, .. } = brain.into_inner();
    live.clear();
    Ok(conclude(swarm, plan, recorded.into_inner(), brain, &outcome, before, Some(keeping), said))
}

#[allow(clippy::too_many_arguments, reason = "all that is left of a run")]
fn conclude<R: Runnable>(
    swarm: &R,
    plan: &Plan,
    mut world: R::World,
    brain: R::Director,
    outcome: &SwarmOutcome,
    before: Duration,
    keeping: Option<Keeping>,
    said: Vec<String>,
) -> Report {
    let (mut violations, checked) = R::last_check(&mut world, outcome.end);
    violations.extend(unbalanced(outcome, <R::World as World>::Agent::PORTS, plan.link.is_transparent()));
    let account = swarm.account(plan, &brain, &world);
    let mut notes = [said, notes(outcome)].concat();
    if let Some(keeping) = keeping {
        let ended = account.ended.map_or(Outcome::Aborted, |(_, outcome)| outcome);
        let SwarmOutcome { end, tally, accounts, unrecorded, .. } = outcome;
        notes.extend(keeping.finish(*end, ended.name(), tally, accounts, *unrecorded));
    }
    report(&Facts {
        plan,
        account,
        beat: swarm.beat(),
        tally: &outcome.tally,
        body_messages: outcome.body_messages + outcome.control_messages,
        violations: &violations,
        broken: violations.len() as u64,
        // The message counts are checked once.
        checked: checked + 1,
        now: outcome.end,
        wall: outcome.wall,
        setup: before + outcome.setup,
        slowed: Some(outcome.slowed),
        left: Some(outcome.left),
        trace_hash: None,
        state_hash: None,
        agents_hash: None,
        world_hash: world_hash(&world),
        search: true,
        notes,
    })
}

/// Thousandths are as fine as anybody writes them; the plan keeps the range.
fn speed(time_scale: f64) -> Speed {
    let thousandths = (time_scale * 1_000.0).round().clamp(1.0, f64::from(u32::MAX)) as u32;
    Speed::new(thousandths, 1_000).unwrap_or(Speed::REAL)
}

/// What does not fit the report's numbers, in words.
fn notes(outcome: &SwarmOutcome) -> Vec<String> {
    let crash = |c: &Crash| {
        let tail = c.stderr_tail.trim();
        let said = if tail.is_empty() { String::new() } else { format!("; it said: {tail}") };
        let at = seconds(c.at.as_secs_f64());
        format!("module {} {} at {at} although nobody had asked it to{said}", c.id, c.how)
    };
    let mut notes: Vec<String> =
        outcome.shortage.iter().map(|why| format!("the run was ended: {why}")).collect();
    notes.extend(outcome.crashes.iter().map(crash));
    notes.extend(
        outcome.missing_counters.iter().map(|why| format!("messages are missing from the counts: {why}")),
    );
    if outcome.foreign > 0 {
        let frames = many(outcome.foreign, "frame");
        notes.push(format!("refused {frames} that no member of the run wrote"));
    }
    notes
}

/// The director, with somebody watching: draws the progress line.
struct Watched<'a, R: Runnable> {
    brain: R::Director,
    plan: &'a Plan,
    live: &'a mut Live,
    meter: Meter,
    /// The present speed of the clock, in parts of [`FULL`].
    share: Arc<AtomicU32>,
}

type ReportOf<W> = <<W as World>::Agent as Agent>::Report;
type OrderOf<W> = <<W as World>::Agent as Agent>::Order;

impl<R: Runnable> Direct<R::World> for Watched<'_, R> {
    fn report(&mut self, now: Time, id: ModuleId, report: ReportOf<R::World>) {
        self.brain.report(now, id, report);
    }
    fn died(&mut self, now: Time, id: ModuleId) {
        self.brain.died(now, id);
    }
    fn external(&mut self, now: Time, id: ModuleId, what: &Outside, world: &R::World) {
        self.brain.external(now, id, what, world);
    }
    fn started(&mut self, now: Time, id: ModuleId) {
        self.brain.started(now, id);
    }
    fn wake(&mut self, now: Time, world: &mut R::World) {
        self.brain.wake(now, world);
        self.live.show(|| {
            let seen = Progress { messages: self.meter.sent(), ..R::progress(&self.brain) };
            let share = f64::from(self.share.load(Ordering::Relaxed)) / f64::from(FULL);
            Status { speed: share, ..progress(self.plan, now, &seen) }
        });
    }
    fn input(&mut self, now: Time, kind: &str, bytes: &[u8]) -> Result<(), String> {
        self.brain.input(now, kind, bytes)
    }
    fn wake_at(&self) -> Time {
        self.brain.wake_at()
    }
    fn poll(&mut self) -> Option<Command<OrderOf<R::World>>> {
        self.brain.poll()
    }
    fn struck(&self) -> &[Struck] {
        self.brain.struck()
    }
}

/// Removes what killed runs of this user left behind, and says what was removed.
pub fn clean_up() -> Result<String, ProcessError> {
    let done = clean()?;
    let mut said = match done.runs.len() {
        0 => "nothing was left behind".to_owned(),
        n => format!(
            "removed what {} left behind: {}, {} of shared memory",
            many(n as u64, "killed run"),
            many(done.agents_killed as u64, "process"),
            many(done.files, "file")
        ),
    };
    if done.alive > 0 {
        said.push_str(&format!("; left {} alone", many(done.alive as u64, "live run")));
    }
    Ok(said)
}

/// The life of one agent process, started by [`run_processes`].
pub fn agent(args: &[OsString]) -> Result<(), ProcessError> {
    let (family, args) = registry::parse(args.iter().cloned())?;
    family.run(&args).map_err(|error| ProcessError::Agent(error.to_string()))
}
