//! Families of modules with all that needs the operating system: files, processes, journals.
//!
//! [`Family`] follows from [`FamilyParts`], as that of `metamorph_families` does. An embedding program adds families with
//! [`install`].

use crate::record::journal::{Damage, Journal, JournalSession, ReadError, plan_of};
use crate::run::PageChannels;
use crate::run::machine::RealMachine;
use crate::run::processes::{self, LeftBehind, ProcessError, Processes};
use crate::run::replay::{self, ReplayError, Replayed, Request};
use crate::run::simulated::{Simulation, simulate as carry_out};
use metamorph_console::files::Files;
use metamorph_console::interrupt::Interrupt;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::Live;
use metamorph_families::runnable::{AgentOf, Runnable};
use metamorph_families::simulated::{SteppedRun, Watch};
use metamorph_families::worded::{self, Worded};
use metamorph_families::{self as families_of_runs, TooLate, with_all_parts};
use metamorph_module_agent::process::args::ArgsError;
use metamorph_module_agent::{AgentArgs, AgentError};
use metamorph_protocol::record::{Record, Sink, Step, Who};
use metamorph_report::progress;
use metamorph_report::run_result::RunResult;
use metamorph_report::schema::Report;
use metamorph_scenario::diagnostics::Diagnostics;
use metamorph_scenario::family::Families;
use metamorph_scenario::shipped::WithShipped;
use metamorph_scenario::{Overrides, Plan};
use metamorph_scene::scene::Scene;
use metamorph_scene::shared::Shared;
use metamorph_sim_bridge::director::progress::Progress;
use metamorph_sim_bridge::kernel::recording::Log;
use metamorph_text::command_error::{CommandError, FAILED};
use metamorph_text::sources::Sources;
use std::collections::VecDeque;
use std::ffi::OsString;
use std::path::Path;
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use thiserror::Error;

pub use metamorph_families::{FamilyParts, cube, free_module, generated, graphs, metamodule};
pub use metamorph_runs::scene;

/// The file system, and the files that ship with the program.
static SOURCES: WithShipped<Files> = WithShipped(Files);

/// The built-in families; the first is the default of scenarios.
const BUILT_IN: &[&dyn Family] =
    &[&cube::CubeFamily, &metamodule::MetamoduleFamily, &free_module::FreeModuleFamily];

/// Parts of built-in families that have agents of their own, by the name of these agents.
const OTHER_AGENTS: &[(&str, &dyn Family)] =
    &[(free_module::walking::AGENT, &free_module::walking::WalkingFamily)];

/// The interface of a family for commands: that for simulated runs, and processes and journals.
pub trait Family: families_of_runs::Family {
    /// Runs a plan with one process per module.
    fn run_processes(&self, plan: &Plan, processes: Processes<'_>) -> Result<Report, ProcessError>;
    /// Resumes a run of processes whose controller was killed.
    fn resume(
        &self,
        left: LeftBehind,
        live: &mut Live,
        since: Stopwatch,
        page: PageChannels,
    ) -> Result<Report, ProcessError>;
    /// Replays a journal.
    fn replay(&self, plan: &Plan, journal: &mut Journal, request: &Request) -> Replayed;
    /// Describes records of agents, in their order.
    fn told(&self, plan: &Plan, records: &[Record]) -> String;
    /// Describes an input of an agent in one line; `None` for a wake-up without effect.
    fn brief(&self, plan: &Plan, step: &Step) -> Option<String>;
    /// Runs one agent until its controller stops it or is gone.
    fn agent(&self, args: &AgentArgs) -> Result<(), AgentError>;
}

impl<F: FamilyParts> Family for F
where
    AgentOf<F::Swarm>: Worded<Place: 'static> + 'static,
{
    fn run_processes(&self, plan: &Plan, processes: Processes<'_>) -> Result<Report, ProcessError> {
        processes::run(plan.swarm.own::<F::Swarm>(), plan, processes).map(with_all_parts)
    }
    fn resume(
        &self,
        left: LeftBehind,
        live: &mut Live,
        since: Stopwatch,
        page: PageChannels,
    ) -> Result<Report, ProcessError> {
        let shared = left.plan.swarm.clone();
        processes::resume(shared.own::<F::Swarm>(), left, live, since, page).map(with_all_parts)
    }
    fn replay(&self, plan: &Plan, journal: &mut Journal, request: &Request) -> Replayed {
        replay::run(plan.swarm.own::<F::Swarm>(), plan, journal, request)
    }
    fn told(&self, plan: &Plan, records: &[Record]) -> String {
        let (mut text, setup) = (String::new(), plan.swarm.own::<F::Swarm>().setup());
        for record in records {
            if let Who::Agent(_, incarnation) = record.who {
                let mut lines = String::new();
                worded::tell::<AgentOf<F::Swarm>>(&mut lines, setup, record, incarnation);
                lines.lines().for_each(|line| text.push_str(&format!("{}: {line}\n", record.who)));
            }
        }
        text
    }
    fn brief(&self, plan: &Plan, step: &Step) -> Option<String> {
        worded::brief::<AgentOf<F::Swarm>>(plan.swarm.own::<F::Swarm>().setup(), step)
    }
    fn agent(&self, args: &AgentArgs) -> Result<(), AgentError> {
        metamorph_module_agent::run::<AgentOf<F::Swarm>>(args)
    }
}

static ALL: OnceLock<Vec<&'static dyn Family>> = OnceLock::new();

/// Adds families to the built-in ones. Call it before anything else.
///
/// # Errors
///
/// The families are already in use.
pub fn install(more: &[&'static dyn Family]) -> Result<(), TooLate> {
    let simulated: Vec<&'static dyn families_of_runs::Family> =
        more.iter().map(|family| *family as &'static dyn families_of_runs::Family).collect();
    families_of_runs::install(&simulated)?;
    ALL.set([BUILT_IN, more].concat()).map_err(|_| TooLate)
}

/// Returns all families.
pub fn all() -> &'static [&'static dyn Family] {
    ALL.get_or_init(|| BUILT_IN.to_vec())
}

/// Returns where files come from: the file system, and those that ship with the program.
pub fn sources() -> &'static dyn Sources {
    &SOURCES
}

/// Returns all families, for reading scenarios.
pub fn families() -> Families {
    families_of_runs::families(&SOURCES)
}

/// Returns the family of this name.
pub fn named(name: &str) -> Option<&'static dyn Family> {
    all().iter().copied().find(|family| family.name() == name)
}

/// Returns the family, or the part of one, whose agents have this name.
fn with_agents(name: &str) -> Option<&'static dyn Family> {
    let other = OTHER_AGENTS.iter().find(|(agent, _)| *agent == name);
    other.map(|(_, family)| *family).or_else(|| named(name))
}

/// Returns the family of a plan, or the part of it with the agents of the plan.
pub fn of(plan: &Plan) -> &'static dyn Family {
    with_agents(plan.swarm.agent()).expect("invariant: a plan is made by a family of the list")
}

/// Reads and checks a scenario file.
///
/// # Errors
/// All problems of the scenario.
pub fn read_file(path: &Path, overrides: &Overrides) -> Result<Plan, Diagnostics> {
    metamorph_runs::read_file(&SOURCES, path, overrides)
}

/// Reads and checks the text of a scenario; `origin` names it in messages.
///
/// # Errors
/// All problems of the scenario.
pub fn read_text(origin: &str, text: &str, overrides: &Overrides) -> Result<Plan, Diagnostics> {
    metamorph_runs::read_text(&SOURCES, origin, text, overrides)
}

/// Content of a journal.
pub struct Recorded {
    /// The plan of the run.
    pub plan: Plan,
    /// The run, up to the first damage.
    pub scene: Scene,
    /// That damage.
    pub damage: Option<Damage>,
}

/// Builds the scene of a journal.
///
/// # Errors
/// The journal cannot be read, or its scenario is not valid for this program.
pub fn recorded(file: &Path) -> Result<Recorded, ReadError> {
    let mut journal = Journal::open(file)?;
    let plan = plan_of(families(), journal.head())?;
    let scene = Shared::new(scene(&plan, true));
    let log = of(&plan).shown(&plan).scribe(scene.clone());
    let whole = journal.by_ref().try_for_each(|record| {
        log.lock().put(&record?);
        Ok(())
    });
    drop(log);
    let (mut scene, damage) = (scene.into_inner(), whole.err());
    let troubles = journal.troubles().into_iter().chain(damage.as_ref().map(Damage::to_string));
    scene.end(troubles.collect());
    Ok(Recorded { plan, scene, damage })
}

/// Simulates a plan to its end, or until `watch` returns false; also returns the results of world and
/// director. `since` was started with the program. Standstills are not searched for what could still have
/// been built.
pub fn simulate(plan: &Plan, since: Stopwatch, watch: &mut Watch<'_>) -> (Report, RunResult) {
    metamorph_runs::simulate(plan, RealMachine::since(since), watch)
}

/// Begins a simulated run that is carried out in steps, for programs that embed one.
pub fn begin(plan: &Plan) -> Box<dyn SteppedRun> {
    metamorph_runs::begin(plan, RealMachine::since(Stopwatch::start()), None)
}

/// Begins a simulated run in steps, and returns with it the scene that it fills.
pub fn begin_shown(plan: &Plan) -> (Box<dyn SteppedRun>, Shared) {
    let scene = Shared::new(scene(plan, true));
    let log = of(plan).shown(plan).scribe(scene.clone());
    (metamorph_runs::begin(plan, RealMachine::since(Stopwatch::start()), Some(log)), scene)
}

/// Keeps records in memory.
#[derive(Default)]
struct Kept(Vec<Record>);

impl Sink for Kept {
    fn put(&mut self, record: &Record) {
        self.0.push(record.clone());
    }
    fn commit(&mut self) {}
}

/// Describes records of agents of a run, in their order.
pub fn told(plan: &Plan, records: &[Record]) -> String {
    of(plan).told(plan, records)
}

/// Returns the records of the last `window` of so many events of a simulated run, each with the number of events before it.
pub fn recorded_events(plan: &Plan, events: u64, window: usize) -> VecDeque<(u64, Vec<Record>)> {
    let kept = Arc::new(Mutex::new(Kept::default()));
    let log = Log::new(Arc::clone(&kept));
    let mut run = metamorph_runs::begin(plan, RealMachine::since(Stopwatch::start()), Some(log));
    let take = || std::mem::take(&mut kept.lock().unwrap_or_else(PoisonError::into_inner).0);
    take();
    let mut last = VecDeque::with_capacity(window.min(1 << 16));
    while run.events() < events {
        let before = run.events();
        if !run.step() {
            break;
        }
        if last.len() == window {
            last.pop_front();
        }
        last.push_back((before, take()));
    }
    last
}

/// Simulates a plan to its end, or until interrupted, with a progress line. `since` was started with the
/// program; the run is recorded in a journal and for a page, if given.
pub fn run_simulated(
    plan: &Plan,
    interrupt: &Interrupt,
    live: &mut Live,
    since: Stopwatch,
    keeping: Option<JournalSession>,
    page: PageChannels,
) -> Report {
    tracing::info!(modules = plan.swarm.len(), seed = plan.seed, "the simulation starts");
    let mut watch = |now, so_far: &dyn Fn() -> Progress| {
        live.show(|| progress(plan, now, &so_far()));
        !interrupt.is_set()
    };
    let simulation = Simulation { since, watch: &mut watch, keeping, page, search: true };
    let (report, _) = carry_out(plan, simulation);
    live.clear();
    report
}

/// Replays a journal.
///
/// # Errors
/// The journal cannot be read, or does not fit the request.
pub fn replay(request: &Request) -> Result<(Plan, Replayed), ReplayError> {
    let (plan, mut journal) = replay::open(families(), request)?;
    let replayed = of(&plan).replay(&plan, &mut journal, request);
    Ok((plan, replayed))
}

/// Why an agent process failed.
#[derive(Debug, Error)]
pub enum AgentProcessError {
    /// Its arguments are invalid.
    #[error(transparent)]
    Args(#[from] ArgsError),
    /// It ended before its controller stopped it.
    #[error(transparent)]
    Agent(#[from] AgentError),
}

impl CommandError for AgentProcessError {
    fn exit_code(&self) -> u8 {
        match self {
            AgentProcessError::Args(_) => FAILED,
            AgentProcessError::Agent(error) => error.exit_code(),
        }
    }
}

/// Runs one agent process, started by a controller with these arguments, until its controller stops it or is
/// gone. The first argument is the family.
///
/// # Errors
/// The arguments are invalid, or the agent ended before its controller stopped it.
pub fn agent(line: &[OsString]) -> Result<(), AgentProcessError> {
    let (first, rest) = line.split_first().ok_or(ArgsError::Missing("the family"))?;
    let name = first.to_string_lossy();
    let family = with_agents(&name).ok_or_else(|| ArgsError::Family(name.into_owned()))?;
    Ok(family.agent(&AgentArgs::parse(rest.iter().cloned())?)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::ids::ModuleId;
    use metamorph_protocol::time::Time;
    use metamorph_scenario::shipped::{Named, find, is_scenario, names, suggestions};
    use metamorph_sim_bridge::director::faults::Fault;
    use std::fs;

    fn plan(name: &str, kill: &[String]) -> Plan {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/scenarios").join(name);
        let kill = kill.to_vec();
        let overrides = Overrides { link: metamorph_scenario::LinkKind::Sim, kill, ..Overrides::default() };
        read_file(&file, &overrides).unwrap_or_else(|e| panic!("{e}"))
    }

    /// Neither steps nor where a run is stopped have an effect; an injected fault has that of a planned one.
    #[test]
    fn a_run_in_steps_is_the_run_at_once() {
        for name in ["swarm.toml", "chair.toml"] {
            let at_once = |plan: &Plan| simulate(plan, Stopwatch::start(), &mut |_, _| true).0;
            let hashes = |report: Report| (report.trace_hash, report.state_hash, report.messages.all.sent);
            let whole = at_once(&plan(name, &[]));
            let mut run = begin(&plan(name, &[]));
            assert!(!run.run_until(Time(1_234_567_890)));
            while run.step() {}
            assert_eq!(hashes(run.report()), hashes(whole));
            assert!(!run.step() && run.run_until(Time::NEVER));
            assert_eq!(run.inject(Fault::Kill(ModuleId(1))), Err("the run is over".to_owned()));

            // At two seconds the first scenario has a fault of its own.
            let mut run = begin(&plan(name, &[]));
            run.run_until(Time(2_000_000_000));
            let at = [2, 3].map(|id| run.inject(Fault::Kill(ModuleId(id))).unwrap());
            assert_eq!(at, [1, 2].map(|ns| Time(2_000_000_000 + ns)));
            let planned = plan(name, &[format!("2@{}ns", at[0].0), format!("3@{}ns", at[1].0)]);
            assert!(run.inject(Fault::Kill(ModuleId(4_000))).unwrap_err().contains("no module 4000"));
            run.run_until(Time::NEVER);
            assert!(!run.module(ModuleId(2)).is_alive && run.cells().len() == run.modules());
            assert_eq!(hashes(run.report()), hashes(at_once(&planned)));
        }
    }

    fn deploy() -> std::path::PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy")
    }

    /// The list is the directory, and every file that a scenario names is there.
    #[test]
    fn all_scenarios_are_in_the_program() {
        let entries = fs::read_dir(deploy().join("scenarios")).unwrap();
        let mut files: Vec<String> = entries
            .map(|entry| {
                entry.unwrap().file_name().into_string().unwrap().trim_end_matches(".toml").to_owned()
            })
            .collect();
        files.sort();
        assert_eq!(names().collect::<Vec<_>>(), files);
        let overrides = Overrides { link: metamorph_scenario::LinkKind::Sim, ..Overrides::default() };
        for name in names() {
            assert_eq!(find(&Files, Path::new(name)), Named::Shipped(name));
            let shipped = read_file(Path::new(name), &overrides).unwrap_or_else(|p| panic!("{p}"));
            let file = deploy().join("scenarios").join(format!("{name}.toml"));
            let read = read_file(&file, &overrides).unwrap_or_else(|p| panic!("{p}"));
            assert_eq!((&shipped.text, shipped.swarm.len()), (&read.text, read.swarm.len()), "{name}");
            assert!(shipped.repeat_with().starts_with(&format!("metamorph run {name} --link sim")), "{name}");
        }
    }

    #[test]
    fn similar_names_are_suggested() {
        let near = |name: &str| suggestions(&Files, Path::new(name));
        assert_eq!(near("swram"), ["swarm"]);
        assert_eq!(near("swarm200"), ["swarm-200"]);
        assert_eq!(near("chiar.toml"), ["chair"]);
        assert_eq!(near("slab-to-spere"), ["slab-to-sphere"]);
        assert_eq!(near("nothing-like-it"), [""; 0]);
        assert!(suggestions(&Files, Path::new("/")).is_empty());
        let directory = tempfile::tempdir().unwrap();
        let path = |name: &str| directory.path().join(name);
        fs::write(path("tower.toml"), "").unwrap();
        fs::write(path("tower.txt"), "").unwrap();
        assert_eq!(suggestions(&Files, &path("towre.toml")), [path("tower.toml").display().to_string()]);
        assert_eq!(find(&Files, &path("tower")), Named::File(path("tower.toml")));
        assert!(
            is_scenario(&Files, &path("tower"))
                && is_scenario(&Files, Path::new("swarm"))
                && is_scenario(&Files, &path("missing"))
                && !is_scenario(&Files, &path("missing.journal"))
                && !is_scenario(&Files, &path("tower.txt"))
        );
    }
}
