//! Runs a plan with one process per module, over shared memory: a plan goes in and a report comes out. The
//! swarm of processes and its supervision are in `swarm`.

use crate::metrics::Metrics;
use crate::record::journal::{HeadError, Journal, JournalError, JournalSession, parts_of, plan_of};
use crate::record::tee::both;
use crate::run::PageChannels;
use crate::run::machine::cores;
use crate::run::replay::{RecoverError, Recovered, recover};
use crate::swarm::balance::unbalanced;
use crate::swarm::{
    CleanError, Crash, FULL, HostsFile, HostsOptions, Meter, NotResumable, Resumption, SwarmError,
    SwarmOptions, SwarmOutcome, WATCH, adopt, adopt_elsewhere, build, clean, log_directory, resume_swarm,
    run_swarm,
};
use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::Live;
use metamorph_families::runnable::Runnable;
use metamorph_module_agent::clock::Speed;
use metamorph_module_agent::journal_file::{Head, Parts, Reader, RunId, controller_part};
use metamorph_module_agent::most_neighbours;
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::{HostId, ModuleId};
use metamorph_protocol::record::{Outside, Record, Sink};
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::Time;
use metamorph_report::schema::{LogPlace, LogsReport, Report};
use metamorph_report::{Facts, ended, progress, report};
use metamorph_scenario::Plan;
use metamorph_scenario::family::Families;
use metamorph_sim_bridge::director::faults::FaultRecord;
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::director::progress::Progress;
use metamorph_sim_bridge::kernel::recording::{Log, RecordedDirector, RecordedWorld};
use metamorph_sim_bridge::kernel::state::world_hash;
use metamorph_sim_bridge::world::World;
use metamorph_text::command_error::{CommandError, DAMAGED, FAILED};
use metamorph_text::escape::Shown;
use metamorph_text::format::{many, seconds};
use metamorph_text::program;
use metamorph_text::progress::Status;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use thiserror::Error;

/// The reason why processes cannot be run.
#[derive(Debug, Error)]
pub enum ProcessError {
    /// The path of this executable is unknown.
    #[error("cannot find this executable, which agents are started from: {0}")]
    Program(std::io::Error),
    /// The swarm of processes cannot be started or cannot continue.
    #[error(transparent)]
    Swarm(#[from] SwarmError),
    /// A journal cannot be read or written.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// A journal's scenario cannot be read.
    #[error(transparent)]
    Head(#[from] HeadError),
    /// The journal belongs to no run that can be resumed.
    #[error(
        "{}: no run to resume: {why}\n  fix: name the journal of a run of processes whose controller was killed",
        .file.shown()
    )]
    NothingLeft {
        /// The journal.
        file: PathBuf,
        /// The cause.
        why: &'static str,
    },
    /// The run cannot be resumed.
    #[error(transparent)]
    NotResumable(#[from] NotResumable),
    /// Re-executing the controller's records did not reproduce them.
    #[error("the run cannot be resumed, because its journal does not reproduce its state: {0}")]
    Recovery(RecoverError),
    /// Cleaning up after killed runs failed.
    #[error(transparent)]
    Clean(#[from] CleanError),
}

impl CommandError for ProcessError {
    fn exit_code(&self) -> u8 {
        match self {
            ProcessError::Journal(error) if error.is_damage() => DAMAGED,
            _ => FAILED,
        }
    }
}

impl From<RecoverError> for ProcessError {
    fn from(error: RecoverError) -> ProcessError {
        match error {
            RecoverError::Damaged(damage) => JournalError::from(damage).into(),
            different => ProcessError::Recovery(different),
        }
    }
}
/// Divisor of the time of a move or joint step that gives the lateness of agents tolerated before scenario
/// time is slowed. Such a delay lets no time-out expire: leases and heartbeats are at least forty times as
/// long.
const TOLERATED: u64 = 10;

/// The inputs of a run of processes besides its plan.
pub struct Processes<'l> {
    /// The progress line.
    pub live: &'l mut Live,
    /// Started with the program.
    pub since: Stopwatch,
    /// The journal, if one is written.
    pub keeping: Option<JournalSession>,
    /// How long agents wait for a controller to come back (real time), if a journal is written.
    pub patience: Duration,
    /// The hosts file, if daemons run already.
    pub hosts: Option<HostsFile>,
    /// The page, if one is shown.
    pub page: PageChannels,
}

/// A run of processes whose controller was killed.
pub struct LeftBehind {
    /// The plan of the run.
    pub plan: Plan,
    /// The hosts file, if the controller's machine is lost and the run goes on from this one.
    pub elsewhere: Option<HostsFile>,
    file: PathBuf,
    run: RunId,
    part: Reader,
}

/// Finds the run that writes this journal.
pub fn left_behind(families: Families, file: &Path) -> Result<LeftBehind, ProcessError> {
    let file = std::path::absolute(file).map_err(|e| JournalError::Read(file.to_owned(), e))?;
    let parts = parts_of(&file);
    if !parts.is_dir() {
        let over = "the run is finished and its journal complete";
        let why =
            if file.is_file() { over } else { "there is no such file, so no run writes its journal there" };
        return Err(ProcessError::NothingLeft { file, why });
    }
    let path = controller_part(&parts);
    let part = Reader::open(&path)?;
    let Head::Run(head) = part.head().clone() else {
        return Err(JournalError::Unfit(path, "this is the part of a module".to_owned()).into());
    };
    // A takeover that fails ends the run's agents: find damage before.
    for record in Journal::open(&parts)? {
        record.map_err(JournalError::from)?;
    }
    Ok(LeftBehind { plan: plan_of(families, &head)?, elsewhere: None, file, run: head.run, part })
}

fn options<R: Runnable>(swarm: &R, plan: &Plan, parts: Option<&Parts>) -> Result<SwarmOptions, ProcessError> {
    let program = std::env::current_exe().map_err(ProcessError::Program)?;
    Ok(SwarmOptions {
        // `--` keeps the agent's arguments from being read as options of this program.
        program_args: program::again(["agent".into(), "--".into(), swarm.agent().into()]),
        seed: plan.seed,
        speed: speed(plan.time_scale),
        tolerance: swarm.time_step() / TOLERATED,
        link: plan.link.clone(),
        hosts: HostsOptions { build: build(), family: swarm.agent().to_owned(), ..HostsOptions::default() },
        // An interrupt during the setup ends the swarm at once.
        catch_signals: true,
        watcher: Some((program.clone(), program::again([WATCH.into()]))),
        journal: parts.cloned(),
        ..SwarmOptions::new(program)
    })
}

/// Returns metrics that know the plan of the run that begins.
fn described(metrics: Option<Metrics>, plan: &Plan) -> Option<Metrics> {
    metrics.inspect(|metrics| metrics.describe(plan))
}

/// The records of a run that has no journal and no page.
struct Forgotten;

impl Sink for Forgotten {
    fn put(&mut self, _: &Record) {}
    fn commit(&mut self) {}
}

/// Runs the plan until the run is over or a signal asks it to end.
pub fn run<R: Runnable>(swarm: &R, plan: &Plan, processes: Processes<'_>) -> Result<Report, ProcessError> {
    let Processes { live, since, keeping, patience, hosts, page } = processes;
    let world = swarm.world(plan);
    let mut options = options(swarm, plan, keeping.as_ref().and_then(JournalSession::parts))?;
    (options.control, options.shutdown) = (page.control, page.shutdown);
    options.metrics = described(page.metrics, plan);
    if let Some(HostsFile { addresses, keys, clock_error, timing, .. }) = hosts {
        let clock_error = clock_error.unwrap_or_default();
        options.hosts = HostsOptions { addresses, keys, clock_error, timing, ..options.hosts };
    }
    options.patience = if keeping.is_some() { patience } else { Duration::ZERO };
    let brain = swarm.director(plan);
    let director = Watched::<R>::new(brain, plan, live, &options);
    tracing::info!(modules = world.len(), seed = plan.seed, "the swarm starts");
    let before = since.elapsed();
    let setup = swarm.setup().as_ref();
    // A controller without a journal records to nothing: a second controller for each family would take long to compile.
    let log = both(keeping.as_ref().map(JournalSession::log), page.scribe);
    let log = log.unwrap_or_else(|| Log::new(Arc::new(Mutex::new(Forgotten))));
    let mut recorded = RecordedWorld::new(world, log.clone());
    let mut brain = RecordedDirector::new(director, log);
    let ran = run_swarm(&options, setup, &mut recorded, &mut brain);
    let give_up = |_: &SwarmError| keeping.iter().for_each(JournalSession::give_up);
    let outcome = ran.inspect_err(give_up)?;
    let brain = brain.into_inner().end();
    Ok(conclude(
        swarm,
        plan,
        recorded.into_inner(),
        brain,
        &outcome,
        before,
        keeping,
        Vec::new(),
        logs(&options, plan),
    ))
}

/// Resumes a run from its journal.
pub fn resume<R: Runnable>(
    swarm: &R,
    left: LeftBehind,
    live: &mut Live,
    since: Stopwatch,
    page: PageChannels,
) -> Result<Report, ProcessError> {
    let LeftBehind { plan, elsewhere, file, run, mut part } = left;
    let plan = &plan;
    // Take over first, so that no other controller writes to the journal while it is read.
    let parts = parts_of(&file);
    let adopted = match &elsewhere {
        Some(hosts) => adopt_elsewhere(&parts, build(), hosts)?,
        None => adopt(&parts, build())?,
    };
    let recovered = recover(swarm, plan, part.by_ref())?;
    if elsewhere.is_none() && plan.link.hosts.is_none() {
        adopted.find_one(recovered.agents.iter().map(|agent| (agent.id, agent.incarnation)))?;
    }
    let Recovered { world, director, struck, until, agents, latest, restarting, finishing, links, counted } =
        recovered;
    let what =
        if elsewhere.is_some() { "the controller's machine was lost" } else { "the controller was killed" };
    let mut said = vec![format!("{what}; another one resumed the run at {}", seconds(until.as_secs_f64()))];
    said.extend(
        part.torn().map(|torn| {
            format!("the controller's part of the journal was cut off after {} bytes", torn.whole)
        }),
    );
    if let Some(scribe) = &page.scribe {
        // The page receives the records from before.
        for record in Reader::open(&controller_part(&parts))? {
            scribe.lock().put(&record.map_err(JournalError::from)?);
        }
    }
    let keeping = JournalSession::going_on(&file, run, part.end(), until)?;
    let mut options = options(swarm, plan, keeping.parts())?;
    (options.control, options.metrics) = (page.control, described(page.metrics, plan));
    let director = Watched::<R>::new(director, plan, live, &options);
    let before = since.elapsed();
    let log = both(Some(keeping.log()), page.scribe).expect("invariant: two logs make one, and one is there");
    let mut recorded = RecordedWorld::new(world, log.clone());
    let mut brain = RecordedDirector::after(director, log, struck);
    let resumption = Resumption { until, agents, latest, restarting, finishing, links, counted };
    let ran = resume_swarm(&options, adopted, resumption, &mut recorded, &mut brain);
    let outcome = ran.inspect_err(|_| keeping.give_up())?;
    let brain = brain.into_inner().end();
    Ok(conclude(
        swarm,
        plan,
        recorded.into_inner(),
        brain,
        &outcome,
        before,
        Some(keeping),
        said,
        logs(&options, plan),
    ))
}

#[allow(clippy::too_many_arguments, reason = "all results of a run")]
fn conclude<R: Runnable>(
    swarm: &R,
    plan: &Plan,
    mut world: R::World,
    brain: R::Director,
    outcome: &SwarmOutcome,
    before: Duration,
    keeping: Option<JournalSession>,
    said: Vec<String>,
    logs: LogsReport,
) -> Report {
    let (mut violations, checked) = R::last_check(&mut world, outcome.end);
    let neighbours = most_neighbours::<<R::World as World>::Agent>(world.len());
    violations.extend(unbalanced(outcome, neighbours, plan.link.is_transparent()));
    let account = swarm.account(plan, &brain, &world);
    let (mut notes, mut incomplete) = ([said, notes(outcome)].concat(), None);
    if let Some(keeping) = keeping {
        let ended = ended(&account, outcome.machine_fault.as_deref());
        let SwarmOutcome { end, tally, accounts, unrecorded, .. } = outcome;
        incomplete = keeping.finish(*end, ended.name(), tally, accounts, *unrecorded);
        notes.extend(incomplete.clone());
    }
    let report = report(&Facts {
        plan,
        account,
        time_step: swarm.time_step(),
        tally: &outcome.tally,
        latencies: &outcome.latencies,
        body_messages: outcome.body_messages + outcome.control_messages,
        control: None,
        crossings: outcome.crossings.clone(),
        violations: &violations,
        broken: violations.len() as u64,
        // The message counts are one more check.
        checked: checked + 1,
        now: outcome.end,
        wall: outcome.wall,
        setup: before + outcome.setup,
        cores: cores(),
        slowed: Some(outcome.slowed),
        left: Some(outcome.left),
        trace_hash: None,
        state_hash: None,
        agents_hash: None,
        world_hash: world_hash(&world),
        search: true,
        machine_fault: outcome.machine_fault.clone(),
        logs: Some(logs),
        notes,
    });
    Report { incomplete_journal: incomplete, ..report }
}

/// Says where the hosts of a run write their logs.
fn logs(options: &SwarmOptions, plan: &Plan) -> LogsReport {
    let own = "standard error of this command";
    let place = |i: u16| {
        let host = HostId(i);
        // A daemon that this command has started writes where it does itself.
        let place = match options.hosts.addresses.get(host.index().wrapping_sub(1)) {
            Some(address) => format!("standard error of `metamorph host` at {address}"),
            None => own.to_owned(),
        };
        let directory =
            options.root.get().filter(|_| host == HostId::CONTROLLER).map(|root| log_directory(root));
        let modules = directory.map(|directory| directory.display().to_string());
        LogPlace { host: host.to_string(), place, modules }
    };
    // Invariant: there are fewer than 2^16 hosts.
    let count = plan.link.hosts.as_ref().map_or(1, |hosts| hosts.len().max(1)) as u16;
    LogsReport { run: options.run.get().cloned().unwrap_or_default(), hosts: (0..count).map(place).collect() }
}

/// Converts the time scale; thousandths are precise enough, and the plan limits the range.
fn speed(time_scale: f64) -> Speed {
    let thousandths = (time_scale * 1_000.0).round().clamp(1.0, f64::from(u32::MAX)) as u32;
    Speed::new(thousandths, 1_000).unwrap_or(Speed::REAL)
}

/// Lists what has no field in the report, as text.
fn notes(outcome: &SwarmOutcome) -> Vec<String> {
    let crash = |c: &Crash| {
        let tail = c.stderr_tail.trim();
        let said = if tail.is_empty() { String::new() } else { format!("; it said: {tail}") };
        let at = seconds(c.at.as_secs_f64());
        format!("module {} {} at {at} without an order{said}", c.id, c.how)
    };
    let mut notes: Vec<String> =
        outcome.machine_fault.iter().map(|why| format!("the run was ended early: {why}")).collect();
    notes.extend(outcome.crashes.iter().map(crash));
    notes.extend(
        outcome.missing_counters.iter().map(|why| format!("messages are missing from the counts: {why}")),
    );
    let left = outcome.left.iter().sum::<u64>() as i64;
    let uncounted = u64::try_from(outcome.tally.total().in_flight() - left).unwrap_or(0);
    // On one host these are a handful around each kill, and a number in the table of messages.
    if uncounted > 0 && !outcome.crossings.is_empty() {
        notes.push(format!(
            "{} without a known fate: under way to or from processes or hosts that ended, or on links that were given up",
            many(uncounted, "message")
        ));
    }
    if outcome.foreign > 0 {
        let frames = many(outcome.foreign, "frame");
        notes.push(format!("refused {frames} from outside the run"));
    }
    notes
}

/// A director that draws the progress line.
struct Watched<'a, R: Runnable> {
    brain: R::Director,
    plan: &'a Plan,
    live: &'a mut Live,
    meter: Meter,
    /// The current speed of the clock, in parts of [`FULL`].
    share: Arc<AtomicU32>,
    metrics: Option<Metrics>,
}

impl<'a, R: Runnable> Watched<'a, R> {
    fn new(brain: R::Director, plan: &'a Plan, live: &'a mut Live, options: &SwarmOptions) -> Self {
        let (meter, share) = (Meter::new(&options.root), Arc::clone(&options.share));
        Watched { brain, plan, live, meter, share, metrics: options.metrics.clone() }
    }

    /// Returns the director of a run that is over.
    fn end(self) -> R::Director {
        self.live.clear();
        self.metrics.iter().for_each(|metrics| metrics.end(Some(R::progress(&self.brain))));
        self.brain
    }
}

type ReportOf<W> = <<W as World>::Agent as Agent>::Report;
type OrderOf<W> = <<W as World>::Agent as Agent>::Order;

impl<R: Runnable> DirectorPort<R::World> for Watched<'_, R> {
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
        if let Some(metrics) = &self.metrics {
            metrics.note_progress(|| (R::progress(&self.brain), self.share.load(Ordering::Relaxed)));
        }
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
    fn struck(&self) -> &[FaultRecord] {
        self.brain.struck()
    }
}

/// Removes what killed runs of this user left behind, and describes what was removed.
pub fn clean_up() -> Result<String, ProcessError> {
    Ok(clean()?.to_string())
}
