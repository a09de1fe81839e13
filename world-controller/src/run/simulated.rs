//! Runs a plan on the simulated link: one thread, virtual time, the same every time.

use crate::console::interrupt::Interrupt;
use crate::console::stopwatch::Stopwatch;
use crate::console::terminal::Live;
use crate::record::journal::Keeping;
use crate::record::tee::both;
use crate::report::run_result::RunResult;
use crate::report::{Facts, progress, report, schema::Report};
use crate::run::runnable::Runnable;
use crate::scenario::{Plan, Swarm};
use metamorph_protocol::defects::Sabotage;
use metamorph_protocol::time::Time;
use metamorph_sim_bridge::cube::director::Progress;
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_sim_bridge::director::port::Direct;
use metamorph_sim_bridge::kernel::recording::{Log, RecordedDirector, RecordedWorld};
use metamorph_sim_bridge::kernel::sim::{Audited, Sim, SimConfig};
use std::sync::Arc;

/// Runs to the end, or until interrupted. `since` is when the program started; what happens is written
/// to a journal and for a page, if somebody wants it.
pub fn run_simulated(
    plan: &Plan,
    interrupt: &Interrupt,
    live: &mut Live,
    since: Stopwatch,
    keeping: Option<Keeping>,
    scribe: Option<Log>,
) -> Report {
    tracing::info!(modules = plan.swarm.len(), seed = plan.seed, "the simulation starts");
    let watch = |now, so_far: &dyn Fn() -> Progress| {
        live.show(|| progress(plan, now, &so_far()));
        !interrupt.is_set()
    };
    let (report, _) = match &plan.swarm {
        Swarm::Cubes(cubes) => run(cubes, plan, since, watch, keeping, scribe, true),
        Swarm::Metamodules(metamodules) => run(metamodules, plan, since, watch, keeping, scribe, true),
    };
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
    simulate_and_account(plan, since, watch).0
}

/// The same, with what director and world know in the end.
pub fn simulate_and_account(
    plan: &Plan,
    since: Stopwatch,
    watch: impl FnMut(Time, &dyn Fn() -> Progress) -> bool,
) -> (Report, RunResult) {
    match &plan.swarm {
        Swarm::Cubes(cubes) => run(cubes, plan, since, watch, None, None, false),
        Swarm::Metamodules(metamodules) => run(metamodules, plan, since, watch, None, None, false),
    }
}

fn run<R: Runnable>(
    swarm: &R,
    plan: &Plan,
    since: Stopwatch,
    watch: impl FnMut(Time, &dyn Fn() -> Progress) -> bool,
    keeping: Option<Keeping>,
    scribe: Option<Log>,
    search: bool,
) -> (Report, RunResult) {
    let config = SimConfig {
        setup: Arc::clone(swarm.setup()),
        link: plan.link.clone(),
        seed: plan.seed,
        audit_every: swarm.audit_every(),
        ignore_sessions: plan.swarm.sabotage() == Some(Sabotage::IgnoreSessions),
    };
    let (world, director) = (swarm.world(plan), swarm.director(plan));
    let Some(log) = both(keeping.as_ref().map(Keeping::log), scribe) else {
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
fn drive<R: Runnable, W: Audited, D: Direct<W>>(
    swarm: &R,
    plan: &Plan,
    since: Stopwatch,
    mut watch: impl FnMut(Time, &dyn Fn() -> Progress) -> bool,
    mut sim: Sim<W, D>,
    world: fn(&W) -> &R::World,
    director: fn(&D) -> &R::Director,
    finish: impl FnOnce(&Sim<W, D>, Outcome) -> Vec<String>,
    search: bool,
) -> (Report, RunResult) {
    let (setup, running) = (since.elapsed(), Stopwatch::start());
    // Slices are only for being watched; where they end has no effect on the run.
    while watch(sim.now(), &|| Progress {
        messages: Some(sim.tally().total().sent),
        ..R::progress(director(sim.director()))
    }) && !sim.run_until(sim.now() + swarm.beat())
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
        beat: swarm.beat(),
        tally: sim.tally(),
        body_messages: sim.body_messages(),
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
