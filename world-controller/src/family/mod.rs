//! Families of modules: everything particular to a family is in its folder, and the list here is the only
//! place that names them all.
//!
//! A family is a type that implements [`FamilyParts`] and its supertraits; [`Family`] follows from it and is the interface that
//! commands use. An embedding program can add families with [`install`].

pub mod cube;
pub mod free_module;
pub mod generated;
pub mod metamodule;

use crate::console::command_error::CommandError;
use crate::console::interrupt::Interrupt;
use crate::console::stopwatch::Stopwatch;
use crate::console::terminal::Live;
use crate::record::journal::{Damage, Journal, JournalSession, plan_of};
use crate::report::progress;
use crate::report::run_result::RunResult;
use crate::report::schema::Report;
use crate::run::PageChannels;
use crate::run::processes::{self, LeftBehind, ProcessError, Processes};
use crate::run::replay::{self, AgentOf, ReplayError, Replayed, Request, Worded};
use crate::run::runnable::Runnable;
use crate::run::simulated::{self, Simulation, SteppedRun, Watch};
use crate::scenario::diagnostics::Diagnostics;
use crate::scenario::family::{Families, ScenarioFamily};
use crate::scenario::{self, Overrides, Plan};
use crate::view::beginning::Heading;
use crate::view::bodies::{Bodies, ShownSwarm};
use crate::view::command_forms;
use crate::view::scene::Scene;
use crate::view::scene_builder::{ReadError, Shared};
use generated::{Dice, GeneratedSwarm};
use metamorph_module_agent::process::args::ArgsError;
use metamorph_module_agent::{AgentArgs, AgentError};
use metamorph_protocol::agent::Agent;
use metamorph_sim_bridge::director::progress::Progress;
use std::ffi::OsString;
use std::path::Path;
use std::sync::{Arc, OnceLock};
use thiserror::Error;

/// The built-in families; the first is the default of scenarios.
const BUILT_IN: &[&dyn Family] =
    &[&cube::CubeFamily, &metamodule::MetamoduleFamily, &free_module::FreeModuleFamily];

/// Parts of built-in families that have agents of their own, by the name of these agents.
const OTHER_AGENTS: &[(&str, &dyn Family)] =
    &[(free_module::walking::AGENT, &free_module::walking::WalkingFamily)];

/// What exploration needs of a family.
pub trait ExploredFamily: ScenarioFamily {
    /// Draws a swarm and its goals for exploration.
    fn generate(&self, dice: &mut Dice) -> Box<dyn GeneratedSwarm>;
    /// Returns true if swarms may have passive elements.
    fn has_elements(&self) -> bool {
        false
    }
    /// Draws a swarm with passive elements, if there are such; otherwise one without.
    fn generate_with_elements(&self, dice: &mut Dice) -> Box<dyn GeneratedSwarm> {
        self.generate(dice)
    }
    /// Returns a minimal swarm with a minimal goal.
    fn smallest(&self) -> Box<dyn GeneratedSwarm>;
    /// Returns the bounds for a standstill and for moves without progress of explored scenarios, in seconds,
    /// or `None` for the defaults. `fails` says whether moves fail, `delay` is the longest delay in
    /// milliseconds.
    fn patience(&self, fails: bool, delay: u64) -> Option<(u64, u64)>;
    /// Returns the limit of runs for shrinking one failing scenario.
    fn shrinking(&self) -> u64;
    /// Returns true if an exploration that names no family may draw this one.
    fn is_drawn(&self) -> bool {
        true
    }
}

/// The interface that a family implements.
pub trait FamilyParts: ExploredFamily {
    /// Its part of a plan, with its world and its director.
    type Swarm: Runnable;

    /// Where each body is at the start.
    fn places(&self, swarm: &Self::Swarm) -> Vec<<AgentOf<Self::Swarm> as Agent>::Place>;
}

/// The interface of a family for commands.
pub trait Family: ExploredFamily {
    /// Simulates a plan to its end, or until it is interrupted.
    fn simulate(&self, plan: &Plan, simulation: Simulation<'_>) -> (Report, RunResult);
    /// Begins a simulated run to be carried out in steps.
    fn begin(&self, plan: &Plan, since: Stopwatch) -> Box<dyn SteppedRun>;
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
    /// Runs one agent until its controller stops it or is gone.
    fn agent(&self, args: &AgentArgs) -> Result<(), AgentError>;
    /// The bodies of a plan at its start, for all that shows them.
    fn shown(&self, plan: &Plan) -> Box<dyn ShownSwarm + Send>;
}

impl<F: FamilyParts> Family for F
where
    AgentOf<F::Swarm>: Worded<Place: 'static> + 'static,
{
    fn simulate(&self, plan: &Plan, simulation: Simulation<'_>) -> (Report, RunResult) {
        let (report, result) = simulated::run::<F::Swarm>(plan, simulation);
        (with_all_parts(report), result)
    }
    fn begin(&self, plan: &Plan, since: Stopwatch) -> Box<dyn SteppedRun> {
        simulated::begin::<F::Swarm>(plan, since)
    }
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
    fn agent(&self, args: &AgentArgs) -> Result<(), AgentError> {
        metamorph_module_agent::run::<AgentOf<F::Swarm>>(args)
    }
    fn shown(&self, plan: &Plan) -> Box<dyn ShownSwarm + Send> {
        let swarm = plan.swarm.own::<F::Swarm>();
        let (setup, places) = (Arc::clone(swarm.setup()), self.places(swarm));
        Box::new(Bodies::<AgentOf<F::Swarm>> { setup, places })
    }
}

/// Adds the fields that other families fill, as null: every report has the same fields.
fn with_all_parts(mut report: Report) -> Report {
    for (key, _) in families().0.iter().filter_map(|family| family.report_part()) {
        report.family_parts.entry(key.to_owned()).or_default();
    }
    report
}

struct Registry {
    all: Vec<&'static dyn Family>,
    scenario: Vec<&'static dyn ScenarioFamily>,
}

static REGISTRY: OnceLock<Registry> = OnceLock::new();

impl Registry {
    fn with(more: &[&'static dyn Family]) -> Registry {
        let all = [BUILT_IN, more].concat();
        let scenario = all.iter().map(|family| *family as &'static dyn ScenarioFamily).collect();
        Registry { all, scenario }
    }
}

fn registry() -> &'static Registry {
    REGISTRY.get_or_init(|| Registry::with(&[]))
}

/// Families were used before [`install`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error("families can be installed only once, and before the first scenario is read")]
pub struct TooLate;

/// Adds families to the built-in ones. Call it before anything else.
///
/// # Errors
///
/// The families are already in use.
pub fn install(more: &[&'static dyn Family]) -> Result<(), TooLate> {
    REGISTRY.set(Registry::with(more)).map_err(|_| TooLate)
}

/// Returns all families.
pub fn all() -> &'static [&'static dyn Family] {
    &registry().all
}

/// Returns all families, for reading scenarios.
pub fn families() -> Families {
    Families(&registry().scenario)
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
pub fn read_file(path: &Path, overrides: &Overrides) -> Result<Plan, Diagnostics> {
    scenario::read_file(families(), path, overrides)
}

/// Reads and checks the text of a scenario; `origin` names it in messages.
pub fn read_text(origin: &str, text: &str, overrides: &Overrides) -> Result<Plan, Diagnostics> {
    scenario::read_text(families(), origin, text, overrides)
}

/// Creates the scene of a plan before its run. `messages` says whether messages will be shown.
pub fn scene(plan: &Plan, messages: bool) -> Scene {
    let family = of(plan);
    let heading = Heading { commands: command_forms::of(plan, family), ..Heading::of(plan) };
    Scene::new(heading, &*family.shown(plan), messages)
}

/// What a journal holds.
pub struct Recorded {
    /// The plan of the run.
    pub plan: Plan,
    /// The run, up to the first damage.
    pub scene: Scene,
    /// That damage.
    pub damage: Option<Damage>,
}

/// Builds the scene of a journal.
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
    of(plan).simulate(
        plan,
        Simulation { since, watch, keeping: None, page: PageChannels::default(), search: false },
    )
}

/// Begins a simulated run that is carried out in steps, for programs that embed one.
pub fn begin(plan: &Plan) -> Box<dyn SteppedRun> {
    of(plan).begin(plan, Stopwatch::start())
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
    let (report, _) = of(plan).simulate(plan, simulation);
    live.clear();
    report
}

/// Replays a journal.
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

impl CommandError for AgentProcessError {}

/// Runs one agent process, started by a controller with these arguments, until its controller stops it or is
/// gone. The first argument is the family.
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
    use metamorph_sim_bridge::director::faults::Fault;

    fn plan(name: &str, kill: &[String]) -> Plan {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../deploy/scenarios").join(name);
        let kill = kill.to_vec();
        let overrides = Overrides { link: scenario::LinkKind::Sim, kill, ..Overrides::default() };
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
}
