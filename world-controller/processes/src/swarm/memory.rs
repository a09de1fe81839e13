//! A swarm within this process: one thread per agent, over queues in memory. The agents, their wait loop
//! and the controller loop are those of a swarm of processes, without shared memory, files and signals.
//!
//! A thread is stopped, continued and killed at its next operation on a link, so a kill does not end an agent
//! in an endless computation. Not here: a controller that can be killed and replaced.

use crate::swarm::controller_loop::{ControllerLoop, Services};
use crate::swarm::launcher::{Backend, Event, Launcher};
use crate::swarm::outcome::{SwarmError, SwarmOutcome};
use crate::swarm::pace::Pace;
use crate::swarm::reserve::Reserve;
use crate::swarm::signals;
use crate::swarm::{MODULE_LIMIT, SwarmOptions, catch_signals};
use metamorph_console::shutdown::{Shutdown, Urgency};
use metamorph_module_agent::AgentError;
use metamorph_module_agent::clock::source::{ClockSource, MemoryClock};
use metamorph_module_agent::journal_file::Parts;
use metamorph_module_agent::most_neighbours;
use metamorph_module_agent::process::agent_process::{AgentConfig, AgentProcess, AgentServices};
use metamorph_module_agent::process::start::begin_journal;
use metamorph_module_agent::run_dir::counter_file::{AgentCounters, SharedCounters};
use metamorph_module_agent::transport::AgentKey;
use metamorph_module_agent::transport::memory::{Control, MemoryNetwork, MemoryTransport};
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::world::World;
use rustix::process::Signal;
use std::any::Any;
use std::collections::BTreeMap;
use std::io;
use std::marker::PhantomData;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;

/// Number of the generation of the only controller.
const GENERATION: u32 = 0;

/// The backend that runs agents as threads of this process.
struct Threads<A>(PhantomData<A>);

impl<A: Agent> Backend for Threads<A> {
    type Transport = MemoryTransport;
    type Launcher = ThreadLauncher<A>;
    type Clock = MemoryClock;
}

/// Runs a swarm of threads until its director finishes it or a shutdown is asked for. Like
/// [`run_swarm`](crate::swarm::run_swarm), except for the options about processes and files: `program`,
/// `program_args`, `verbose`, `watcher`, `patience` and `root` have no effect.
///
/// # Errors
/// If the swarm cannot be started, or its controller cannot continue.
pub fn run_in_memory<W, D>(
    options: &SwarmOptions,
    setup: &Arc<<W::Agent as Agent>::Setup>,
    world: &mut W,
    director: &mut D,
) -> Result<SwarmOutcome, SwarmError>
where
    W: World,
    D: DirectorPort<W>,
{
    let count = world.len();
    if count == 0 || count > MODULE_LIMIT {
        return Err(SwarmError::Size(count));
    }
    catch_signals(options)?;
    let clock = MemoryClock::real();
    let begun = clock.monotonic();
    let share = Arc::clone(&options.share);
    let pace =
        Pace::new(clock.clone(), options.speed, options.tolerance, share).map_err(SwarmError::Clock)?;
    let network = MemoryNetwork::new();
    let transport = network.controller(GENERATION);
    let config = AgentConfig {
        agent: (ModuleId(0), Incarnation(0)),
        count: count as u32,
        seed: options.seed,
        speed: options.speed,
        tolerance: options.tolerance,
        link: options.link.clone(),
        setup: Arc::clone(setup),
        generation: GENERATION,
    };
    let (ended, ends) = channel();
    let launcher = ThreadLauncher {
        config,
        journal: options.journal.clone(),
        network,
        clock,
        threads: BTreeMap::new(),
        counters: BTreeMap::new(),
        ended,
        ends,
        failed: Vec::new(),
        controller: transport.control(),
        shutdown: options.shutdown.clone(),
        told: Urgency::None,
    };
    let reserve = Reserve::default();
    let services = Services::<Threads<W::Agent>> { launcher, transport, pace, reserve, dir: None };
    ControllerLoop::new(options, services, world, director, begun).run()
}

/// The thread of one agent.
struct AgentThread {
    control: Control,
    handle: JoinHandle<Result<(), AgentError>>,
}

/// Starts agents as threads of this process.
struct ThreadLauncher<A: Agent> {
    /// The configuration of all agents; its key is a placeholder.
    config: AgentConfig<A::Setup>,
    journal: Option<Parts>,
    network: MemoryNetwork,
    clock: MemoryClock,
    threads: BTreeMap<AgentKey, AgentThread>,
    counters: BTreeMap<AgentKey, SharedCounters>,
    ended: Sender<AgentKey>,
    ends: Receiver<AgentKey>,
    /// Failed starts that have not been reported yet.
    failed: Vec<(AgentKey, io::Error)>,
    controller: Control,
    shutdown: Shutdown,
    told: Urgency,
}

/// Reports the end of a thread to the launcher, however the thread ends.
struct TellsEnd {
    agent: AgentKey,
    ended: Sender<AgentKey>,
    controller: Control,
}

impl Drop for TellsEnd {
    fn drop(&mut self) {
        // If the launcher is gone, the event is not needed.
        let _ = self.ended.send(self.agent);
        self.controller.wake();
    }
}

impl<A: Agent> ThreadLauncher<A> {
    fn spawn(&mut self, agent: AgentKey) -> io::Result<()> {
        let transport = self.network.agent(agent, most_neighbours::<A>(self.config.count as usize));
        let control = transport.control();
        let counters = SharedCounters::default();
        self.counters.insert(agent, counters.clone());
        let config = AgentConfig {
            agent,
            link: self.config.link.clone(),
            setup: Arc::clone(&self.config.setup),
            ..self.config
        };
        let (clock, journal) = (self.clock.clone(), self.journal.clone());
        let tells_end = TellsEnd { agent, ended: self.ended.clone(), controller: self.controller.clone() };
        let run = move || {
            let _tells_end = tells_end;
            let journal = journal.map(|parts| begin_journal(&parts, agent)).transpose()?;
            let counters = Box::new(counters);
            let services = AgentServices { transport, clock, counters, journal, orphan_watch: None };
            AgentProcess::<A, _, _>::new(config, services)?.run()
        };
        let handle = std::thread::Builder::new().name(format!("{}.{}", agent.0, agent.1)).spawn(run)?;
        self.threads.insert(agent, AgentThread { control, handle });
        Ok(())
    }
}

impl<A: Agent> Launcher for ThreadLauncher<A> {
    fn start(&mut self, agent: AgentKey) {
        if let Err(e) = self.spawn(agent) {
            self.failed.push((agent, e));
            self.controller.wake();
        }
    }

    fn signal(&mut self, agent: AgentKey, signal: Signal) {
        let Some(AgentThread { control, .. }) = self.threads.get(&agent) else { return };
        match signal {
            Signal::STOP => control.stop(),
            Signal::CONT => control.resume(),
            _ => control.kill(),
        }
    }

    /// A thread leaves nothing behind: its inbox and links were dropped with it.
    fn reap(&mut self, _: AgentKey) {}

    fn event(&mut self) -> Result<Option<Event>, SwarmError> {
        if let Some((agent, e)) = self.failed.pop() {
            return Ok(Some(Event::SpawnFailed(agent, e)));
        }
        while let Ok(agent) = self.ends.try_recv() {
            if let Some(thread) = self.threads.remove(&agent) {
                return Ok(Some(exited(agent, thread)));
            }
        }
        let urgency = self.shutdown.urgency();
        if urgency > self.told {
            self.told = urgency;
            return Ok(Some(Event::Shutdown(urgency)));
        }
        Ok(None)
    }

    fn counters(&self, agent: AgentKey) -> Result<Option<AgentCounters>, String> {
        Ok(self.counters.get(&agent).map(SharedCounters::read))
    }
}

impl<A: Agent> Drop for ThreadLauncher<A> {
    fn drop(&mut self) {
        for thread in self.threads.values() {
            thread.control.kill();
        }
        for (agent, thread) in std::mem::take(&mut self.threads) {
            if thread.handle.join().is_err() {
                tracing::error!("the thread of module {} panicked", agent.0);
            }
        }
    }
}

/// Returns the event for the end of a thread, in the words used for processes.
fn exited(agent: AgentKey, thread: AgentThread) -> Event {
    let killed = thread.control.is_killed();
    let (how, signal, stderr_tail) = match thread.handle.join() {
        _ if killed => {
            let signal = Signal::KILL.as_raw();
            (format!("was killed by {}", signals::name(signal)), Some(signal), String::new())
        }
        Ok(Ok(())) => ("exited".to_owned(), None, String::new()),
        Ok(Err(e)) => ("ended with an error".to_owned(), None, e.to_string()),
        Err(panic) => ("panicked".to_owned(), None, said(panic.as_ref())),
    };
    Event::Exited { agent, how, signal, of_machine: false, stderr_tail }
}

/// Returns the text of a panic.
fn said(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().copied();
    text.or_else(|| panic.downcast_ref::<String>().map(String::as_str)).unwrap_or_default().to_owned()
}
