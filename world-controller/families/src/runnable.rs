//! The interface between a family and the drivers and reports: setup of its world and director, and the result of a
//! run.
//!
//! Absent: driving (`simulated`, `processes`) and the layout of reports (`report`).

use metamorph_protocol::agent::Agent;
use metamorph_protocol::time::{Span, Time};
use metamorph_report::run_result::RunResult;
use metamorph_report::schema::StageReport;
use metamorph_scenario::Plan;
use metamorph_scenario::family::SwarmPlan;
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::director::progress::{Progress, Stage};
use metamorph_sim_bridge::kernel::audited::Audited;
use metamorph_sim_bridge::kernel::sim::Sim;
use metamorph_sim_bridge::world::World;
use metamorph_sim_bridge::world::invariants::Violation;
use std::sync::Arc;

/// The agents of a family.
pub type AgentOf<R> = <<R as Runnable>::World as World>::Agent;

/// The setup shared by a family's agents.
pub type SetupOf<R> = <AgentOf<R> as Agent>::Setup;

/// A swarm that can be run.
pub trait Runnable: SwarmPlan {
    /// Its world.
    type World: Audited + Send + Sync + 'static;
    /// Its director.
    type Director: DirectorPort<Self::World> + Send + Sync + 'static;

    /// Returns what all agents share.
    fn setup(&self) -> &Arc<SetupOf<Self>>;
    /// Returns the world at the start.
    fn world(&self, plan: &Plan) -> Self::World;
    /// Returns the director at the start.
    fn director(&self, plan: &Plan) -> Self::Director;
    /// Returns the shortest observable time step: a move, or a step of a joint.
    fn time_step(&self) -> Span;
    /// Returns the time between two complete audits in a simulation.
    fn audit_every(&self) -> Span;
    /// Returns a copy of a run that goes on independently ([`Sim::fork`]); `None` if its parts cannot be copied, which is the default.
    fn fork(_sim: &Sim<Self::World, Self::Director>) -> Option<Sim<Self::World, Self::Director>> {
        None
    }
    /// Returns the progress of the run.
    fn progress(director: &Self::Director) -> Progress;
    /// Returns the result for the report.
    fn account(&self, plan: &Plan, director: &Self::Director, world: &Self::World) -> RunResult;
    /// Checks the world once more after a run of processes. Returns all violations of the run, and the number
    /// of checks.
    fn last_check(world: &mut Self::World, now: Time) -> (Vec<Violation>, u64);
}

/// Converts the result of one goal to its entry in the report.
pub fn stage(name: &str, stage: &Stage) -> StageReport {
    StageReport {
        name: name.to_owned(),
        cells: stage.cells as u64,
        filled: stage.filled as u64,
        omitted: 0,
        opened_s: stage.opened.as_secs_f64(),
        built_s: stage.built.map(Time::as_secs_f64),
        known_s: stage.known.map(Time::as_secs_f64),
        detect_lag_s: stage.built.zip(stage.known).map(|(built, known)| known.since(built).as_secs_f64()),
    }
}
