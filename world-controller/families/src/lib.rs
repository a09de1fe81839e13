//! Families of modules: everything particular to a family is in its folder. They are listed here and, with all that needs
//! processes, in `metamorph_processes::family`.
//!
//! A family is a type that implements [`FamilyParts`] and its supertraits; [`Family`] follows from it and is the interface that
//! others use. An embedding program can add families with [`install`]. `runnable` is what a run needs of a family,
//! `simulated` carries out simulated runs, `generated` draws scenarios for exploration. Nothing here asks the operating
//! system.

#[cfg(test)]
mod command_forms_tests;
pub mod connection;
pub mod cube;
pub mod free_module;
pub mod generated;
pub mod graphs;
pub mod metamodule;
pub mod runnable;
pub mod scene_builder;
pub mod simulated;
pub mod visible;
pub mod worded;

use generated::{Dice, GeneratedSwarm};
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::ModuleId;
use metamorph_report::schema::Report;
use metamorph_scenario::Plan;
use metamorph_scenario::family::{Families, ScenarioFamily};
use metamorph_scene::bodies::ShownSwarm;
use metamorph_sim_bridge::kernel::recording::Log;
use metamorph_text::sources::Sources;
use runnable::{AgentOf, Runnable};
use simulated::{Machine, SteppedRun};
use std::sync::{Arc, OnceLock};
use thiserror::Error;
use visible::Bodies;
use worded::Worded;

/// The built-in families; the first is the default of scenarios.
const BUILT_IN: &[&dyn Family] =
    &[&cube::CubeFamily, &metamodule::MetamoduleFamily, &free_module::FreeModuleFamily];

/// Parts of built-in families that have agents of their own, by the name of these agents.
const OTHER_AGENTS: &[(&str, &dyn Family)] =
    &[(free_module::walking::AGENT, &free_module::walking::WalkingFamily)];

/// A family whose swarms exploration can generate at random.
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
    /// Returns true if a model of connections may decide which connectors close.
    fn has_connections(&self) -> bool {
        false
    }
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
    /// Contacts that do not follow from the places of bodies, for pictures.
    fn drawn_contacts(&self, _: &Self::Swarm) -> Vec<(ModuleId, ModuleId)> {
        Vec::new()
    }
}

/// The interface of a family for all who run, read and show scenarios.
pub trait Family: ExploredFamily {
    /// Begins a simulated run; it is recorded in the log, if one is given. `machine` is what the report says of the machine.
    fn begin(&self, plan: &Plan, machine: Arc<dyn Machine>, log: Option<Log>) -> Box<dyn SteppedRun>;
    /// The bodies of a plan at its start, for all that shows them.
    fn shown(&self, plan: &Plan) -> Box<dyn ShownSwarm + Send>;
}

impl<F: FamilyParts> Family for F
where
    AgentOf<F::Swarm>: Worded<Place: 'static> + 'static,
{
    fn begin(&self, plan: &Plan, machine: Arc<dyn Machine>, log: Option<Log>) -> Box<dyn SteppedRun> {
        simulated::begin::<F::Swarm>(plan, machine, log)
    }
    fn shown(&self, plan: &Plan) -> Box<dyn ShownSwarm + Send> {
        let swarm = plan.swarm.own::<F::Swarm>();
        let (setup, places) = (Arc::clone(swarm.setup()), self.places(swarm));
        let contacts = self.drawn_contacts(swarm);
        Box::new(Bodies::<AgentOf<F::Swarm>> { setup, places, contacts })
    }
}

/// Adds the fields that other families fill, as null: every report has the same fields.
pub fn with_all_parts(mut report: Report) -> Report {
    for (key, _) in registry().scenario.iter().filter_map(|family| family.report_part()) {
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

/// Returns all families, for reading scenarios whose files come from `sources`.
pub fn families(sources: &'static dyn Sources) -> Families {
    Families { all: &registry().scenario, sources }
}

/// Returns the family of this name.
pub fn named(name: &str) -> Option<&'static dyn Family> {
    all().iter().copied().find(|family| family.name() == name)
}

/// Returns the family, or the part of one, whose agents have this name.
pub fn with_agents(name: &str) -> Option<&'static dyn Family> {
    let other = OTHER_AGENTS.iter().find(|(agent, _)| *agent == name);
    other.map(|(_, family)| *family).or_else(|| named(name))
}

/// Returns the family of a plan, or the part of it with the agents of the plan.
pub fn of(plan: &Plan) -> &'static dyn Family {
    with_agents(plan.swarm.agent()).expect("invariant: a plan is made by a family of the list")
}
