//! Runs a plan on the simulated link: one thread, virtual time, the same every time.

use crate::interrupt::Interrupt;
use crate::report::{Facts, progress, report, schema::Report};
use crate::runnable::Runnable;
use crate::scenario::{Plan, Swarm};
use crate::stopwatch::Stopwatch;
use crate::terminal::Live;
use metamorph_protocol::sabotage::Sabotage;
use metamorph_protocol::time::Time;
use metamorph_sim_bridge::director::Progress;
use metamorph_sim_bridge::sim::{Sim, SimConfig};
use std::sync::Arc;

/// Runs to the end, or until interrupted. `since` is when the program started.
pub fn run_simulated(plan: &Plan, interrupt: &Interrupt, live: &mut Live, since: Stopwatch) -> Report {
    tracing::info!(modules = plan.swarm.len(), seed = plan.seed, "the simulation starts");
    let report = simulate(plan, since, |now, so_far| {
        live.show(|| progress(plan, now, &so_far()));
        !interrupt.is_set()
    });
    live.clear();
    report
}

/// Runs to the end, or until `watch`, which is asked again and again how to go on, says no. It is
/// given the scenario time and, if it cares, how far the run has come.
pub fn simulate(
    plan: &Plan,
    since: Stopwatch,
    watch: impl FnMut(Time, &dyn Fn() -> Progress) -> bool,
) -> Report {
    match &plan.swarm {
        Swarm::Cubes(cubes) => run(cubes, plan, since, watch),
        Swarm::Metamodules(metamodules) => run(metamodules, plan, since, watch),
    }
}

fn run<R: Runnable>(
    swarm: &R,
    plan: &Plan,
    since: Stopwatch,
    mut watch: impl FnMut(Time, &dyn Fn() -> Progress) -> bool,
) -> Report {
    let config = SimConfig {
        setup: Arc::clone(swarm.setup()),
        link: plan.link.clone(),
        seed: plan.seed,
        audit_every: swarm.audit_every(),
        ignore_sessions: plan.swarm.sabotage() == Some(Sabotage::IgnoreSessions),
    };
    let mut sim = Sim::new(config, swarm.world(plan), swarm.director(plan));
    let (setup, running) = (since.elapsed(), Stopwatch::start());
    // Slices are only for being watched; where they end has no effect on the run.
    while watch(sim.now(), &|| R::progress(sim.director())) && !sim.run_until(sim.now() + swarm.beat()) {}
    let (violations, broken) = sim.violations();
    report(&Facts {
        plan,
        account: swarm.account(plan, sim.director(), sim.world()),
        beat: swarm.beat(),
        tally: sim.tally(),
        body_messages: sim.body_messages(),
        violations,
        broken,
        checked: sim.checked(),
        now: sim.now(),
        wall: running.elapsed(),
        setup,
        trace_hash: Some(sim.trace().value()),
        notes: Vec::new(),
    })
}
