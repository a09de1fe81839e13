//! Families for protocols of one's own: modules that do not move, with any graph of contacts.
//!
//! A type that implements [`GraphProtocol`] has, as the family [`GraphFamily`], all that a built-in family has: scenarios,
//! faults, both links, journals and replay, reports, the page, sweeps and exploration. `contacts` reads the graph of a scenario,
//! `director` ends a run, `look` describes modules and messages, `generated` draws swarms for exploration.

pub mod contacts;
mod director;
mod generated;
mod look;
mod scenario;

pub use director::GraphDirector;
pub use look::ROLES;

use crate::generated::{Dice, GeneratedSwarm};
use crate::runnable::{Runnable, stage};
use crate::{ExploredFamily, FamilyParts};
use contacts::Contacts;
use generated::GraphDraft;
use metamorph_protocol::agent::Agent;
use metamorph_protocol::defects::Defect;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::time::{Span, Time};
use metamorph_protocol::wire::Never;
use metamorph_report::message_timeline::MessageLabel;
use metamorph_report::run_result::RunResult;
use metamorph_scenario::Plan;
use metamorph_scenario::error::ScenarioError;
use metamorph_scenario::family::{Swarm, SwarmPlan, Words};
use metamorph_scene::visible::{ModuleView, Role};
use metamorph_sim_bridge::director::progress::Progress;
use metamorph_sim_bridge::kernel::graph_world::{AgentCheck, GraphWorld};
use metamorph_sim_bridge::world::contact_graph::ContactGraph;
use metamorph_sim_bridge::world::invariants::{Invariant, Violation};
use std::fmt;
use std::marker::PhantomData;
use std::sync::Arc;

/// A protocol among modules that do not move.
///
/// The agent is the protocol; the rest says when a run is over and how to show it. `Setup` holds the parameters: the keys of
/// `[protocol]` are its fields as serde names them, and what a scenario leaves out is as in its default.
pub trait GraphProtocol:
    Agent<
        Setup: Default,
        Place = Cell,
        Action = Never,
        Percept = Never,
        Order = Never,
        Report: Clone + Send + Sync,
    >
{
    /// The name of the family in scenarios and on command lines.
    const NAME: &'static str;
    /// The work of the modules, as it continues "modules that".
    const ABOUT: &'static str;
    /// The roles of modules on the page: [`GraphProtocol::standing`] names one by its number.
    const ROLES: [Role; 3] = ROLES;

    /// Returns the longest time between two messages of a module to the same neighbour. From it follows how long a run may go
    /// without a report before that is a standstill.
    fn repeat(setup: &Self::Setup) -> Span;
    /// Returns which modules have reached the goal, from the last report of each; `None` if it has not reported or is dead. A
    /// run is over once all living modules have reached it. It is called whenever a report or a death changes something.
    fn reached(setup: &Self::Setup, reports: &[Option<Self::Report>]) -> Vec<bool>;
    /// Returns what must always hold. On the simulated link each check is called after every input of an agent, with all living
    /// agents and the number of that one; a run in which one fails is `unsafe`.
    fn invariants() -> &'static [(Invariant, AgentCheck<Self>)] {
        &[]
    }
    /// Returns the label of a message, for the page and for `replay`.
    fn label(message: &Self::Message) -> MessageLabel;
    /// Describes a report, for `replay`.
    fn describe(report: &Self::Report) -> String;
    /// Returns the role of a module that has reported this, and a number for the text of that role. By default all modules have
    /// the first role.
    fn standing(_report: &Self::Report) -> (u8, i32) {
        (0, 0)
    }
}

/// The family of a protocol.
pub struct GraphFamily<P>(PhantomData<fn() -> P>);

impl<P> GraphFamily<P> {
    /// Creates the family, for [`install`](crate::install).
    #[allow(clippy::new_without_default, reason = "it is for statics, which need a constant function")]
    pub const fn new() -> GraphFamily<P> {
        GraphFamily(PhantomData)
    }
}

/// Modules with a graph of contacts and a protocol.
pub struct GraphSwarm<P: Agent> {
    contacts: Contacts,
    graph: Arc<ContactGraph>,
    setup: Arc<P::Setup>,
}

impl<P: Agent> Clone for GraphSwarm<P> {
    fn clone(&self) -> Self {
        let GraphSwarm { contacts, graph, setup } = self;
        GraphSwarm { contacts: contacts.clone(), graph: Arc::clone(graph), setup: Arc::clone(setup) }
    }
}

impl<P: Agent> fmt::Debug for GraphSwarm<P> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("GraphSwarm").field("contacts", &self.contacts).finish_non_exhaustive()
    }
}

impl<P: GraphProtocol> SwarmPlan for GraphSwarm<P> {
    fn family(&self) -> &'static str {
        P::NAME
    }
    fn modules(&self) -> usize {
        self.graph.cells().len()
    }
    fn protocol(&self) -> String {
        P::NAME.to_owned()
    }
    fn with_seed(&self, seed: u64) -> Result<Option<Swarm>, ScenarioError> {
        if !self.contacts.is_drawn() {
            return Ok(None);
        }
        let graph = Arc::new(self.contacts.graph(P::PORTS, seed)?);
        Ok(Some(Swarm::new(GraphSwarm { graph, ..self.clone() })))
    }
    fn defect(&self) -> Option<Defect> {
        None
    }
    fn with_defect(&self, _: Option<Defect>) -> Swarm {
        Swarm::new(self.clone())
    }
    fn contacts(&self) -> Option<Vec<(ModuleId, ModuleId)>> {
        Some(self.graph.pairs())
    }
    fn describe(&self, _: &Plan, out: &mut String) -> fmt::Result {
        use fmt::Write;
        let (modules, contacts) = (self.modules(), self.graph.contacts().len());
        writeln!(
            out,
            "  swarm     {modules} modules that {}, {}, {contacts} contacts",
            P::ABOUT,
            self.contacts
        )?;
        let names: Vec<&str> = P::invariants().iter().map(|(invariant, _)| invariant.name).collect();
        if !names.is_empty() {
            writeln!(out, "  holds     {}, checked on the simulated link", names.join(", "))?;
        }
        Ok(())
    }
    fn words(&self) -> &'static Words {
        &Words {
            module: "module",
            modules: "modules",
            cell: "module",
            part: "module",
            cells: "modules",
            filled: "done",
            collisions: None,
            idle: "lives",
            time_step: "move time",
            action: "move",
        }
    }
}

impl<P: GraphProtocol> Runnable for GraphSwarm<P> {
    type World = GraphWorld<P>;
    type Director = GraphDirector<P>;

    fn setup(&self) -> &Arc<P::Setup> {
        &self.setup
    }
    fn world(&self, _: &Plan) -> GraphWorld<P> {
        GraphWorld::new(&self.graph, P::invariants())
    }
    fn director(&self, plan: &Plan) -> GraphDirector<P> {
        GraphDirector::new(&self.graph, &self.setup, plan.schedule.clone(), plan.stop)
    }
    fn time_step(&self) -> Span {
        metamorph_scenario::plan::BEAT
    }
    fn audit_every(&self) -> Span {
        self.time_step() * 20
    }
    fn progress(director: &GraphDirector<P>) -> Progress {
        director.progress()
    }
    fn account(&self, plan: &Plan, director: &GraphDirector<P>, _: &GraphWorld<P>) -> RunResult {
        RunResult {
            stages: plan.stages.iter().map(|plan| stage(&plan.name, &director.stage())).collect(),
            ..RunResult::of(director.monitor(), director.progress())
        }
    }
    fn last_check(_: &mut GraphWorld<P>, _: Time) -> (Vec<Violation>, u64) {
        (Vec::new(), 0)
    }
}

impl<P: GraphProtocol> ExploredFamily for GraphFamily<P> {
    fn generate(&self, dice: &mut Dice) -> Box<dyn GeneratedSwarm> {
        Box::new(GraphDraft::<P>::draw(dice))
    }
    fn smallest(&self) -> Box<dyn GeneratedSwarm> {
        Box::new(GraphDraft::<P>::smallest())
    }
    fn patience(&self, _: bool, _: u64) -> Option<(u64, u64)> {
        None
    }
    fn shrinking(&self) -> u64 {
        1_000
    }
}

impl<P: GraphProtocol> FamilyParts for GraphFamily<P> {
    type Swarm = GraphSwarm<P>;

    fn places(&self, swarm: &GraphSwarm<P>) -> Vec<Cell> {
        swarm.graph.cells().to_vec()
    }
    fn drawn_contacts(&self, swarm: &GraphSwarm<P>) -> Vec<(ModuleId, ModuleId)> {
        swarm.graph.pairs()
    }
}

/// Returns what a module shows that has reported this.
fn view<P: GraphProtocol>(report: &P::Report) -> ModuleView {
    let (role, place) = P::standing(report);
    ModuleView { role: role.min(P::ROLES.len() as u8 - 1), flags: 0, place, waits_for: None }
}
