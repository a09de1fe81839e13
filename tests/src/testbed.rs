//! What a driver must offer to be tested, and the testbeds: real processes, threads in memory, and the
//! simulator.

use crate::probe::{Felt, Probe, ProbeOrder, ProbePlace, ProbeReport, ProbeSetup, ProbeWorld, Touch};
use crate::script::Script;
use metamorph_protocol::counters::Tally;
use metamorph_protocol::ids::{HostId, Incarnation, ModuleId, Revision};
use metamorph_protocol::link::{ClockOffset, Hosts, LinkModel};
use metamorph_protocol::runtime::Command;
use metamorph_protocol::runtime::Sensed;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::kernel::audited::{Agents, Audited};
use metamorph_sim_bridge::kernel::sim::{Sim, SimConfig};
use metamorph_sim_bridge::world::World;
use metamorph_sim_bridge::world::invariants::Violation;
use metamorph_world_controller::swarm::{SwarmOptions, SwarmOutcome, run_in_memory, run_swarm};
use std::path::PathBuf;
use std::sync::Arc;

/// A driver under test: it runs a script to its end.
pub trait Testbed {
    /// Runs `script` in `world`, with links that do what `link` says, and returns what was counted
    /// over all incarnations of all agents.
    fn run(&mut self, link: &LinkModel, world: &mut ProbeWorld, script: &mut Script) -> Tally;
}

/// Real processes over shared memory.
#[derive(Debug)]
pub struct ProcessBed {
    /// How swarms are run.
    pub options: SwarmOptions,
    /// What the last run came to.
    pub outcome: SwarmOutcome,
}

impl ProcessBed {
    /// Agents are processes of this program, see `probe-agent`.
    pub fn new(program: impl Into<PathBuf>) -> ProcessBed {
        ProcessBed { options: SwarmOptions::new(program.into()), outcome: SwarmOutcome::default() }
    }
}

impl Testbed for ProcessBed {
    fn run(&mut self, link: &LinkModel, world: &mut ProbeWorld, script: &mut Script) -> Tally {
        self.options.link = link.clone();
        let outcome = run_swarm(&self.options, &setup(), world, script);
        self.outcome = outcome.unwrap_or_else(|e| panic!("the swarm could not be run: {e}"));
        self.outcome.tally
    }
}

/// Real processes on two hosts: neighbours in a line are on different ones.
#[derive(Debug)]
pub struct HostsBed(ProcessBed);

impl HostsBed {
    /// Agents and the daemon are processes of this program, see `probe-agent`.
    pub fn new(program: impl Into<PathBuf>) -> HostsBed {
        HostsBed(ProcessBed::new(program))
    }
}

impl Testbed for HostsBed {
    fn run(&mut self, link: &LinkModel, world: &mut ProbeWorld, script: &mut Script) -> Tally {
        let homes = (0..world.len()).map(|i| HostId((i % 2) as u16)).collect();
        let between = LinkModel { partitions: Vec::new(), ..link.clone() };
        let hosts = Hosts::new(homes, vec![ClockOffset::default(); 2], vec![between]);
        let hosts = hosts.unwrap_or_else(|e| panic!("two hosts: {e}"));
        self.0.run(&LinkModel { hosts: Some(Arc::new(hosts)), ..link.clone() }, world, script)
    }
}

/// What all probes of a run share.
fn setup() -> ProbeSetup {
    ProbeSetup { ballast: vec![7; 1_000] }
}

/// Threads over queues in memory.
#[derive(Debug)]
pub struct MemoryBed {
    /// How swarms are run.
    pub options: SwarmOptions,
}

impl MemoryBed {
    /// Agents are threads of this process.
    pub fn new() -> MemoryBed {
        MemoryBed { options: SwarmOptions::new(PathBuf::new()) }
    }
}

impl Default for MemoryBed {
    fn default() -> MemoryBed {
        MemoryBed::new()
    }
}

impl Testbed for MemoryBed {
    fn run(&mut self, link: &LinkModel, world: &mut ProbeWorld, script: &mut Script) -> Tally {
        self.options.link = link.clone();
        let outcome = run_in_memory(&self.options, &Arc::new(setup()), world, script);
        let outcome = outcome.unwrap_or_else(|e| panic!("the swarm could not be run: {e}"));
        assert_eq!((outcome.foreign, &outcome.crashes[..]), (0, &[][..]));
        outcome.tally
    }
}

/// The simulator.
#[derive(Debug, Default)]
pub struct SimBed;

impl Testbed for SimBed {
    fn run(&mut self, link: &LinkModel, world: &mut ProbeWorld, script: &mut Script) -> Tally {
        let config = SimConfig {
            setup: Arc::new(setup()),
            link: link.clone(),
            seed: 0,
            audit_every: Span::secs(1),
            ignore_sessions: false,
        };
        let mut sim = Sim::new(config, Borrowed(world), Scripted(script));
        // Scripts end by themselves; this is the watchdog.
        sim.run_until(Time(3_600_000_000_000));
        assert_eq!(sim.violations().0, []);
        *sim.tally()
    }
}

/// A world that a simulated run only borrows.
struct Borrowed<'a>(&'a mut ProbeWorld);

impl World for Borrowed<'_> {
    type Agent = Probe;

    fn len(&self) -> usize {
        self.0.len()
    }
    fn place(&self, id: ModuleId) -> ProbePlace {
        self.0.place(id)
    }
    fn start(&mut self, now: Time, id: ModuleId, incarnation: Incarnation) {
        self.0.start(now, id, incarnation);
    }
    fn act(&mut self, now: Time, id: ModuleId, sensed: Revision, action: &Touch) {
        self.0.act(now, id, sensed, action);
    }
    fn next_event(&self) -> Time {
        self.0.next_event()
    }
    fn advance(&mut self, now: Time) {
        self.0.advance(now);
    }
    fn poll(&mut self) -> Option<(ModuleId, Sensed<Felt>)> {
        self.0.poll()
    }
}

/// Probes have nothing to audit.
impl Audited for Borrowed<'_> {
    fn audit_agent(&mut self, _: Time, _: ModuleId, _: &Agents<'_, Probe>, _: &mut Vec<Violation>) {}
    fn audit_action(&self, _: Time, _: ModuleId, _: &Agents<'_, Probe>, _: &mut Vec<Violation>) {}
    fn audit_all(&mut self, _: Time, _: &Agents<'_, Probe>, _: &mut Vec<Violation>) {}
    fn take_violations(&mut self) -> Vec<Violation> {
        Vec::new()
    }
}

/// A script that a simulated run only borrows.
struct Scripted<'a>(&'a mut Script);

impl<'w> DirectorPort<Borrowed<'w>> for Scripted<'_> {
    fn report(&mut self, now: Time, id: ModuleId, report: ProbeReport) {
        self.0.report(now, id, report);
    }
    fn died(&mut self, now: Time, id: ModuleId) {
        self.0.died(now, id);
    }
    fn started(&mut self, now: Time, id: ModuleId) {
        self.0.started(now, id);
    }
    fn wake(&mut self, now: Time, world: &mut Borrowed<'w>) {
        self.0.wake(now, world.0);
    }
    fn wake_at(&self) -> Time {
        self.0.wake_at()
    }
    fn poll(&mut self) -> Option<Command<ProbeOrder>> {
        self.0.poll()
    }
}
