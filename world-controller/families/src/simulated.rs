//! Runs a plan on the simulated link: one thread, virtual time, deterministic. A run is carried out to its end, or in
//! steps by a program that embeds it.

use crate::runnable::{AgentOf, Runnable};
use crate::visible::Visible;
use metamorph_protocol::agent::{Agent, Summary};
use metamorph_protocol::counters::Tally;
use metamorph_protocol::defects::Defect;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::time::{Span, Time};
use metamorph_report::run_result::RunResult;
use metamorph_report::{Facts, report, schema::Report};
use metamorph_scenario::Plan;
use metamorph_sim_bridge::director::commands::{COMMAND_INPUT, Commands};
use metamorph_sim_bridge::director::faults::Fault;
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::director::progress::Progress;
use metamorph_sim_bridge::kernel::audited::Audited;
use metamorph_sim_bridge::kernel::change::{Change, ChangeKind};
use metamorph_sim_bridge::kernel::recording::{Log, RecordedDirector, RecordedWorld};
use metamorph_sim_bridge::kernel::sim::{Sim, SimConfig, Step};
use metamorph_sim_bridge::world::World;
use metamorph_sim_bridge::world::invariants::Violation;
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;

/// A callback with the scenario time and the progress of the run; returning false ends the run.
pub type Watch<'w> = dyn FnMut(Time, &dyn Fn() -> Progress) -> bool + 'w;

/// Access to the machine for the report of a run. A run itself does not read the machine.
pub trait Machine: Send + Sync {
    /// Returns the real time since the program started.
    fn elapsed(&self) -> Duration;
    /// Returns the number of processors available.
    fn cores(&self) -> u64;
}

/// No machine: no time passes.
#[derive(Clone, Copy, Debug)]
pub struct NoMachine;

impl Machine for NoMachine {
    fn elapsed(&self) -> Duration {
        Duration::ZERO
    }
    fn cores(&self) -> u64 {
        1
    }
}

/// Carries out a run to its end, or until `watch` returns false.
pub fn to_the_end(run: &mut dyn SteppedRun, watch: &mut Watch<'_>) {
    let time_step = run.time_step();
    // Slices exist for `watch` only; where they end has no effect on the run.
    while watch(run.now(), &|| run.progress()) && !run.run_until(run.now() + time_step) {}
}

/// A function that copies a run, or returns `None`.
type Fork<W, D> = fn(&Sim<W, D>) -> Option<Sim<W, D>>;

/// A simulated run of a swarm; `W` and `D` are its world and director, or wrappers of them that record.
struct Run<R: Runnable, W: Audited, D: DirectorPort<W>> {
    plan: Plan,
    sim: Sim<W, D>,
    world: fn(&W) -> &R::World,
    director: fn(&D) -> &R::Director,
    /// `None` if the run is recorded.
    fork: Option<Fork<W, D>>,
    machine: Arc<dyn Machine>,
    /// The real time, since the program started, at which the run began.
    begun: Duration,
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
    let mut sim = Sim::new(config::<R>(plan), swarm.world(plan), swarm.director(plan));
    sim.plan_changes(plan.changes.clone());
    sim
}

impl<R: Runnable> Run<R, R::World, R::Director> {
    fn plain(plan: &Plan, machine: Arc<dyn Machine>) -> Self {
        let sim = simulation::<R>(plan);
        Run::begin(plan, machine, sim, |w| w, |d| d, Some(R::fork))
    }
}

impl<R: Runnable> Run<R, RecordedWorld<R::World>, RecordedDirector<R::Director>> {
    fn recorded(plan: &Plan, machine: Arc<dyn Machine>, log: Log) -> Self {
        let swarm = plan.swarm.own::<R>();
        let world = RecordedWorld::new(swarm.world(plan), log.clone());
        let director = RecordedDirector::new(swarm.director(plan), log.clone());
        let mut sim = Sim::with_journal(config::<R>(plan), world, director, Some(log));
        sim.plan_changes(plan.changes.clone());
        Run::begin(plan, machine, sim, RecordedWorld::inner, RecordedDirector::inner, None)
    }
}

impl<R: Runnable, W: Audited, D: DirectorPort<W>> Run<R, W, D> {
    fn begin(
        plan: &Plan,
        machine: Arc<dyn Machine>,
        sim: Sim<W, D>,
        world: fn(&W) -> &R::World,
        director: fn(&D) -> &R::Director,
        fork: Option<Fork<W, D>>,
    ) -> Self {
        let begun = machine.elapsed();
        Run { plan: plan.clone(), sim, world, director, fork, machine, begun, injected: Time::ZERO }
    }

    fn swarm(&self) -> &R {
        self.plan.swarm.own()
    }
    fn progress(&self) -> Progress {
        let messages = Some(self.sim.tally().total().sent);
        Progress { messages, ..R::progress((self.director)(self.sim.director())) }
    }

    fn account(&self) -> RunResult {
        self.swarm().account(&self.plan, (self.director)(self.sim.director()), (self.world)(self.sim.world()))
    }

    fn conclude(&self, search: bool, notes: Vec<String>) -> (Report, RunResult) {
        let (sim, plan, account) = (&self.sim, &self.plan, self.account());
        let wall = self.machine.elapsed().saturating_sub(self.begun);
        let (violations, broken) = sim.violations();
        let hashes = sim.hashes();
        let facts = Facts {
            slowed: None,
            left: None,
            plan,
            account,
            time_step: self.swarm().time_step(),
            tally: sim.tally(),
            latencies: sim.latencies(),
            body_messages: sim.body_messages(),
            violations,
            broken,
            checked: sim.checked(),
            control: Some(sim.control()),
            crossings: sim.crossings(),
            now: sim.now(),
            wall,
            setup: self.begun,
            cores: self.machine.cores(),
            trace_hash: Some(sim.trace().value()),
            state_hash: Some(hashes.states),
            agents_hash: Some(hashes.agents),
            world_hash: hashes.world,
            search,
            machine_fault: None,
            logs: None,
            notes,
        };
        (report(&facts), facts.account)
    }
}

/// State of a module at an instant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModuleState {
    /// The cell of its body; of bodies with several cells, the one at the connector that holds them.
    pub cell: Cell,
    /// Whether its process lives.
    pub is_alive: bool,
    /// Latest summary of its agent; of a dead one, the last before its death.
    pub summary: Option<Summary>,
}

/// Why a run is not copied.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum ForkError {
    /// It has a journal.
    #[error(
        "a run that is recorded has no copy, since two runs cannot continue one journal; begin it without a journal"
    )]
    Recorded,
    /// Its family does not support it.
    #[error("runs of `{0}` have no copy yet; begin the run again, and run it until this time")]
    Family(&'static str),
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
    /// Returns a copy of the run, which goes on independently: until one of them is given a fault or an input, both take the same
    /// events and have the same hashes. Its real time counts from the beginning of the origin.
    ///
    /// # Errors
    /// If the run is recorded, or its family has parts that cannot be copied: walking bodies, and protocols of one's own.
    fn fork(&self) -> Result<Box<dyn SteppedRun>, ForkError>;
    /// Changes the run now ([`ChangeKind`]). The run is then that of its scenario with this change, as its report says. Returns the change.
    fn change(&mut self, kind: ChangeKind) -> Change;
    /// Returns the number of events of the kernel so far.
    fn events(&self) -> u64;
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
    /// Returns the shortest observable time step: a move, or a step of a joint.
    fn time_step(&self) -> Span;
    /// Returns the progress so far.
    fn progress(&self) -> Progress;
    /// Hands an input to the director, as a driver under control does; it is recorded.
    ///
    /// # Errors
    /// Returns why the director refuses it.
    fn input(&mut self, kind: &str, bytes: &[u8]) -> Result<(), String>;
    /// Returns the outcome so far; before the end it is `aborted`.
    fn outcome(&self) -> Outcome;
    /// Returns the first violations of invariants, at most a hundred.
    fn violations(&self) -> &[Violation];
    /// Returns the report with these notes, and the results of world and director. `search` says whether a standstill is
    /// searched for what could still have been built.
    fn conclude(&self, search: bool, notes: Vec<String>) -> (Report, RunResult);
}

/// Begins a run; it is recorded in the log, if one is given.
pub fn begin<R: Runnable<World: World<Agent: Visible>>>(
    plan: &Plan,
    machine: Arc<dyn Machine>,
    log: Option<Log>,
) -> Box<dyn SteppedRun> {
    match log {
        None => Box::new(Run::<R, _, _>::plain(plan, machine)),
        Some(log) => Box::new(Run::<R, _, _>::recorded(plan, machine, log)),
    }
}

impl<R, W, D> SteppedRun for Run<R, W, D>
where
    R: Runnable<World: World<Agent: Visible>>,
    W: Audited + World<Agent = AgentOf<R>> + Send + Sync + 'static,
    D: DirectorPort<W> + Send + Sync + 'static,
{
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
    fn fork(&self) -> Result<Box<dyn SteppedRun>, ForkError> {
        let fork = self.fork.ok_or(ForkError::Recorded)?;
        let sim = fork(&self.sim).ok_or(ForkError::Family(self.plan.swarm.agent()))?;
        Ok(Box::new(Run::<R, W, D> {
            plan: self.plan.clone(),
            sim,
            machine: Arc::clone(&self.machine),
            ..*self
        }))
    }
    fn change(&mut self, kind: ChangeKind) -> Change {
        let change = self.sim.change(kind);
        self.plan.add_change(change);
        change
    }
    fn events(&self) -> u64 {
        self.sim.events()
    }
    fn modules(&self) -> usize {
        self.sim.world().len()
    }
    fn cells(&self) -> Vec<Cell> {
        let world = self.sim.world();
        (0..world.len() as u32).map(|id| AgentOf::<R>::cell(&world.place(ModuleId(id)))).collect()
    }
    fn module(&self, id: ModuleId) -> ModuleState {
        let agents = self.sim.agents();
        ModuleState {
            cell: AgentOf::<R>::cell(&self.sim.world().place(id)),
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
        self.conclude(true, Vec::new()).0
    }
    fn time_step(&self) -> Span {
        self.swarm().time_step()
    }
    fn progress(&self) -> Progress {
        self.progress()
    }
    fn input(&mut self, kind: &str, bytes: &[u8]) -> Result<(), String> {
        self.sim.input(kind, bytes)
    }
    fn outcome(&self) -> Outcome {
        self.account().ended.map_or(Outcome::Aborted, |(_, outcome)| outcome)
    }
    fn violations(&self) -> &[Violation] {
        self.sim.violations().0
    }
    fn conclude(&self, search: bool, notes: Vec<String>) -> (Report, RunResult) {
        self.conclude(search, notes)
    }
}
