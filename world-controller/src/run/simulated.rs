//! Runs a plan on the simulated link: one thread, virtual time, deterministic. A run is carried out to its end, or in
//! steps by a program that embeds it.

use crate::console::stopwatch::Stopwatch;
use crate::control::{CommandQueue, READ_EVERY};
use crate::record::journal::JournalSession;
use crate::record::tee::both;
use crate::report::run_result::RunResult;
use crate::report::{Facts, report, schema::Report};
use crate::run::PageChannels;
use crate::run::runnable::Runnable;
use crate::scenario::Plan;
use crate::view::visible::Visible;
use metamorph_protocol::agent::{Agent, Summary};
use metamorph_protocol::counters::Tally;
use metamorph_protocol::defects::Defect;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::director::commands::{COMMAND_INPUT, Commands};
use metamorph_sim_bridge::director::faults::Fault;
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::director::progress::Progress;
use metamorph_sim_bridge::kernel::audited::Audited;
use metamorph_sim_bridge::kernel::recording::{Log, RecordedDirector, RecordedWorld};
use metamorph_sim_bridge::kernel::sim::{Sim, SimConfig, Step};
use metamorph_sim_bridge::world::World;
use std::sync::Arc;
use std::time::Duration;

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
    /// The page, if one is shown. Under control, time passes as on the process link.
    pub page: PageChannels,
    /// Whether a standstill is worth a search for what could still have been built.
    pub search: bool,
}

/// Runs the plan to its end, or until `watch` returns false.
pub fn run<R: Runnable>(plan: &Plan, simulation: Simulation<'_>) -> (Report, RunResult) {
    let log = both(simulation.keeping.as_ref().map(JournalSession::log), simulation.page.scribe.clone());
    match log {
        None => to_the_end(Run::<R, _, _>::plain(plan, simulation.since), simulation),
        Some(log) => to_the_end(Run::<R, _, _>::recorded(plan, simulation.since, log), simulation),
    }
}

fn to_the_end<R: Runnable, W: Audited, D: DirectorPort<W>>(
    mut run: Run<R, W, D>,
    simulation: Simulation<'_>,
) -> (Report, RunResult) {
    let Simulation { watch, keeping, search, page, .. } = simulation;
    let time_step = run.swarm().time_step();
    match page.control {
        // Slices exist for `watch` only; where they end has no effect on the run.
        None => {
            while watch(run.sim.now(), &|| run.progress()) && !run.sim.run_until(run.sim.now() + time_step) {}
        }
        Some(queue) => run.under_control(watch, &mut queue.lock()),
    }
    run.report(keeping, search)
}

/// A simulated run of a swarm; `W` and `D` are its world and director, or wrappers of them that record.
struct Run<R: Runnable, W: Audited, D: DirectorPort<W>> {
    plan: Plan,
    sim: Sim<W, D>,
    world: fn(&W) -> &R::World,
    director: fn(&D) -> &R::Director,
    setup: Duration,
    running: Stopwatch,
    /// The time of the fault injected last.
    injected: Time,
}

fn config<R: Runnable>(plan: &Plan) -> SimConfig<<R::World as World>::Agent> {
    SimConfig {
        setup: Arc::clone(plan.swarm.own::<R>().setup()),
        link: plan.link.clone(),
        seed: plan.seed,
        audit_every: plan.swarm.own::<R>().audit_every(),
        ignore_sessions: plan.swarm.defect() == Some(Defect::IgnoreSessions),
    }
}

/// Creates the simulation of a plan, for a program that runs it itself.
pub fn simulation<R: Runnable>(plan: &Plan) -> Sim<R::World, R::Director> {
    let swarm = plan.swarm.own::<R>();
    Sim::new(config::<R>(plan), swarm.world(plan), swarm.director(plan))
}

impl<R: Runnable> Run<R, R::World, R::Director> {
    fn plain(plan: &Plan, since: Stopwatch) -> Self {
        let sim = simulation::<R>(plan);
        Run::begin(plan, since, sim, |w| w, |d| d)
    }
}

impl<R: Runnable> Run<R, RecordedWorld<R::World>, RecordedDirector<R::Director>> {
    fn recorded(plan: &Plan, since: Stopwatch, log: Log) -> Self {
        let swarm = plan.swarm.own::<R>();
        let world = RecordedWorld::new(swarm.world(plan), log.clone());
        let director = RecordedDirector::new(swarm.director(plan), log.clone());
        let sim = Sim::with_journal(config::<R>(plan), world, director, Some(log));
        Run::begin(plan, since, sim, RecordedWorld::inner, RecordedDirector::inner)
    }
}

impl<R: Runnable, W: Audited, D: DirectorPort<W>> Run<R, W, D> {
    fn begin(
        plan: &Plan,
        since: Stopwatch,
        sim: Sim<W, D>,
        world: fn(&W) -> &R::World,
        director: fn(&D) -> &R::Director,
    ) -> Self {
        let (setup, running, injected) = (since.elapsed(), Stopwatch::start(), Time::ZERO);
        Run { plan: plan.clone(), sim, world, director, setup, running, injected }
    }

    fn swarm(&self) -> &R {
        self.plan.swarm.own()
    }
    /// Runs to the end at the pace of the process link, and takes commands meanwhile.
    fn under_control(&mut self, watch: &mut Watch<'_>, queue: &mut CommandQueue) {
        let (time_step, clock) = (self.swarm().time_step(), Stopwatch::start());
        while watch(self.sim.now(), &|| self.progress()) {
            let passed = clock.elapsed().mul_f64(self.plan.time_scale);
            let present = Time(u64::try_from(passed.as_nanos()).unwrap_or(u64::MAX));
            let until = present.min(self.sim.now() + time_step);
            if self.sim.run_until(until) {
                break;
            }
            queue.hand_in(self.sim.now(), |kind, bytes| self.sim.input(kind, bytes));
            if until == present {
                queue.wait(READ_EVERY);
            }
        }
        queue.close();
    }
    fn progress(&self) -> Progress {
        let messages = Some(self.sim.tally().total().sent);
        Progress { messages, ..R::progress((self.director)(self.sim.director())) }
    }

    /// Returns the result so far; `search` says whether a standstill is searched for what could still be built.
    fn report(&self, keeping: Option<JournalSession>, search: bool) -> (Report, RunResult) {
        let (sim, plan) = (&self.sim, &self.plan);
        let wall = self.running.elapsed();
        let account = self.swarm().account(plan, (self.director)(sim.director()), (self.world)(sim.world()));
        let outcome = account.ended.map_or(Outcome::Aborted, |(_, outcome)| outcome);
        let kept = keeping.map(|k| k.finish(sim.now(), outcome.name(), sim.tally(), &[], 0));
        let (violations, broken) = sim.violations();
        let hashes = sim.hashes();
        let facts = Facts {
            slowed: None,
            left: None,
            plan,
            account,
            time_step: self.swarm().time_step(),
            tally: sim.tally(),
            body_messages: sim.body_messages(),
            violations,
            broken,
            checked: sim.checked(),
            control: Some(sim.control()),
            crossings: sim.crossings(),
            now: sim.now(),
            wall,
            setup: self.setup,
            trace_hash: Some(sim.trace().value()),
            state_hash: Some(hashes.states),
            agents_hash: Some(hashes.agents),
            world_hash: hashes.world,
            search,
            notes: kept.unwrap_or_default(),
        };
        (report(&facts), facts.account)
    }
}

/// What a module is and does at an instant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModuleState {
    /// The cell of its body; of bodies with several cells, the one at the connector that holds them.
    pub cell: Cell,
    /// Whether its process lives.
    pub is_alive: bool,
    /// What its agent says of itself; of a dead one, the last state.
    pub summary: Option<Summary>,
}

/// A simulated run that is carried out in steps.
pub trait SteppedRun: Send + Sync {
    /// Carries out the next event of the kernel. Returns false if the run is over.
    fn step(&mut self) -> bool;
    /// Runs until a time. Returns true if the run is over.
    fn run_until(&mut self, until: Time) -> bool;
    /// Returns the scenario time.
    fn now(&self) -> Time;
    /// Injects a fault a nanosecond from now, and after the last one injected, so that it does not meet what else is due
    /// at this instant. Returns its time: a scenario with the fault at this time makes the same run.
    ///
    /// # Errors
    /// Returns why there can be no such fault.
    fn inject(&mut self, fault: Fault) -> Result<Time, String>;
    /// Returns the number of modules.
    fn modules(&self) -> usize;
    /// Returns the cell of each module's body.
    fn cells(&self) -> Vec<Cell>;
    /// Returns the state of a module.
    fn module(&self, id: ModuleId) -> ModuleState;
    /// Returns the message counts.
    fn tally(&self) -> &Tally;
    /// Returns the hash of all events so far.
    fn trace_hash(&self) -> u64;
    /// Returns the hash of the sampled states and the current one.
    fn state_hash(&self) -> u64;
    /// Returns the report so far. Before the end its outcome is `aborted`.
    fn report(&self) -> Report;
}

/// Begins a run to be carried out in steps.
pub fn begin<R: Runnable<World: World<Agent: Visible>>>(
    plan: &Plan,
    since: Stopwatch,
) -> Box<dyn SteppedRun> {
    Box::new(Run::<R, _, _>::plain(plan, since))
}

impl<R: Runnable<World: World<Agent: Visible>>> SteppedRun for Run<R, R::World, R::Director> {
    fn step(&mut self) -> bool {
        self.sim.step(Time::NEVER) != Step::Over
    }
    fn run_until(&mut self, until: Time) -> bool {
        self.sim.run_until(until)
    }
    fn now(&self) -> Time {
        self.sim.now()
    }
    fn inject(&mut self, fault: Fault) -> Result<Time, String> {
        let at = self.sim.now().max(self.injected) + Span(1);
        let commands = Commands { at, operator: 0, faults: vec![fault] };
        self.sim.input(COMMAND_INPUT, commands.to_string().as_bytes())?;
        self.injected = at;
        Ok(at)
    }
    fn modules(&self) -> usize {
        self.sim.world().len()
    }
    fn cells(&self) -> Vec<Cell> {
        let world = self.sim.world();
        (0..world.len() as u32)
            .map(|id| <R::World as World>::Agent::cell(&world.place(ModuleId(id))))
            .collect()
    }
    fn module(&self, id: ModuleId) -> ModuleState {
        let agents = self.sim.agents();
        ModuleState {
            cell: <R::World as World>::Agent::cell(&self.sim.world().place(id)),
            is_alive: agents.get(id).is_some(),
            summary: agents.last(id).map(|agent| agent.summary(self.sim.now())),
        }
    }
    fn tally(&self) -> &Tally {
        self.sim.tally()
    }
    fn trace_hash(&self) -> u64 {
        self.sim.trace().value()
    }
    fn state_hash(&self) -> u64 {
        self.sim.hashes().states
    }
    fn report(&self) -> Report {
        self.report(None, true).0
    }
}
