//! Runs a plan on the simulated link: one thread, virtual time, deterministic.

use crate::console::stopwatch::Stopwatch;
use crate::record::journal::JournalSession;
use crate::record::tee::both;
use crate::report::run_result::RunResult;
use crate::report::{Facts, report, schema::Report};
use crate::run::runnable::Runnable;
use crate::scenario::Plan;
use metamorph_protocol::defects::Defect;
use metamorph_protocol::time::Time;
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::director::progress::Progress;
use metamorph_sim_bridge::kernel::audited::Audited;
use metamorph_sim_bridge::kernel::recording::{Log, RecordedDirector, RecordedWorld};
use metamorph_sim_bridge::kernel::sim::{Sim, SimConfig};
use std::sync::Arc;

/// A callback with the scenario time and the progress of the run; returning false ends the run.
pub type Watch<'w> = dyn FnMut(Time, &dyn Fn() -> Progress) -> bool + 'w;

/// The inputs of a simulated run besides its plan.
pub struct Simulation<'w> {
    /// When the program started.
    pub since: Stopwatch,
    /// Called between slices of the run.
    pub watch: &'w mut Watch<'w>,
    /// The journal, if one is written.
    pub keeping: Option<JournalSession>,
    /// The log of the page, if one is shown.
    pub scribe: Option<Log>,
    /// Whether a standstill is worth a search for what could still have been built.
    pub search: bool,
}

/// Runs the plan to its end, or until `watch` returns false.
pub fn run<R: Runnable>(swarm: &R, plan: &Plan, simulation: Simulation<'_>) -> (Report, RunResult) {
    let Simulation { since, watch, keeping, scribe, search } = simulation;
    let config = SimConfig {
        setup: Arc::clone(swarm.setup()),
        link: plan.link.clone(),
        seed: plan.seed,
        audit_every: swarm.audit_every(),
        ignore_sessions: plan.swarm.defect() == Some(Defect::IgnoreSessions),
    };
    let (world, director) = (swarm.world(plan), swarm.director(plan));
    let Some(log) = both(keeping.as_ref().map(JournalSession::log), scribe) else {
        let sim = Sim::new(config, world, director);
        return drive(swarm, plan, since, watch, sim, |w| w, |d| d, |_, _| Vec::new(), search);
    };
    let world = RecordedWorld::new(world, log.clone());
    let director = RecordedDirector::new(director, log.clone());
    let sim = Sim::with_journal(config, world, director, Some(log));
    let finish = |sim: &Sim<_, _>, outcome: Outcome| {
        let kept = keeping.map(|k| k.finish(sim.now(), outcome.name(), sim.tally(), &[], 0));
        kept.unwrap_or_default()
    };
    drive(swarm, plan, since, watch, sim, RecordedWorld::inner, RecordedDirector::inner, finish, search)
}

#[allow(clippy::too_many_arguments, reason = "the same for runs with and without a journal")]
fn drive<R: Runnable, W: Audited, D: DirectorPort<W>>(
    swarm: &R,
    plan: &Plan,
    since: Stopwatch,
    watch: &mut Watch<'_>,
    mut sim: Sim<W, D>,
    world: fn(&W) -> &R::World,
    director: fn(&D) -> &R::Director,
    finish: impl FnOnce(&Sim<W, D>, Outcome) -> Vec<String>,
    search: bool,
) -> (Report, RunResult) {
    let (setup, running) = (since.elapsed(), Stopwatch::start());
    // Slices exist for `watch` only; where they end has no effect on the run.
    while watch(sim.now(), &|| Progress {
        messages: Some(sim.tally().total().sent),
        ..R::progress(director(sim.director()))
    }) && !sim.run_until(sim.now() + swarm.time_step())
    {}
    let wall = running.elapsed();
    let account = swarm.account(plan, director(sim.director()), world(sim.world()));
    let notes = finish(&sim, account.ended.map_or(Outcome::Aborted, |(_, outcome)| outcome));
    let (violations, broken) = sim.violations();
    let hashes = sim.hashes();
    let facts = Facts {
        slowed: None,
        left: None,
        plan,
        account,
        time_step: swarm.time_step(),
        tally: sim.tally(),
        body_messages: sim.body_messages(),
        crossings: sim.crossings(),
        violations,
        broken,
        checked: sim.checked(),
        now: sim.now(),
        wall,
        setup,
        trace_hash: Some(sim.trace().value()),
        state_hash: Some(hashes.states),
        agents_hash: Some(hashes.agents),
        world_hash: hashes.world,
        search,
        notes,
    };
    (report(&facts), facts.account)
}
