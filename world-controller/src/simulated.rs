//! Runs a plan on the simulated link: one thread, virtual time, the same every time.

use crate::interrupt::Interrupt;
use crate::report::{Facts, progress, report, schema::Report};
use crate::scenario::Plan;
use crate::stopwatch::Stopwatch;
use crate::terminal::Live;
use metamorph_sim_bridge::cube_audit::audit_every;
use metamorph_sim_bridge::cube_world::CubeWorld;
use metamorph_sim_bridge::director::Director;
use metamorph_sim_bridge::sim::{Sim, SimConfig};
use std::sync::Arc;

/// Runs to the end, or until interrupted. `since` is when the program started.
pub fn run_simulated(plan: &Plan, interrupt: &Interrupt, live: &mut Live, since: Stopwatch) -> Report {
    let move_time = plan.setup.params.move_time;
    let world = CubeWorld::new(&plan.cells, move_time, plan.seed);
    let director = Director::new(
        Arc::clone(&plan.setup),
        plan.cells.len(),
        plan.schedule.clone(),
        plan.stop,
        plan.failure,
    );
    let config = SimConfig {
        setup: Arc::clone(&plan.setup),
        link: plan.link.clone(),
        seed: plan.seed,
        audit_every: audit_every(move_time),
        ignore_sessions: false,
    };
    let mut sim = Sim::new(config, world, director);
    let (setup, running) = (since.elapsed(), Stopwatch::start());
    tracing::info!(modules = plan.cells.len(), seed = plan.seed, "the simulation starts");
    // Slices are only for looking at the interrupt; where they end has no effect on the run.
    while !interrupt.is_set() && !sim.run_until(sim.now() + move_time) {
        live.show(|| progress(sim.now(), &sim.director().progress()));
    }
    live.clear();
    let (violations, broken) = sim.violations();
    report(&Facts {
        plan,
        director: sim.director(),
        motions: sim.world().motions(),
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
