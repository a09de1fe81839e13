//! The launcher: starts agents, passes signals on and notices their ends, as one trait for processes of this
//! machine (`supervisor`) and threads (`memory`). Not here: when to do so, which the controller loop decides.

use crate::swarm::outcome::SwarmError;
use metamorph_console::shutdown::Urgency;
use metamorph_module_agent::clock::source::ClockSource;
use metamorph_module_agent::run_dir::counter_file::AgentCounters;
use metamorph_module_agent::transport::{AgentKey, Transport};
use metamorph_protocol::ids::{HostId, ModuleId};
use metamorph_protocol::link::HostChange;
use metamorph_sim_bridge::kernel::sim::Crossings;
use rustix::process::Signal;
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::Path;

/// Events of the launcher. Their number in a run is bounded: at most two for each incarnation, two for each
/// stop from outside, and two more.
#[derive(Debug)]
pub enum Event {
    /// An agent could not be started.
    SpawnFailed(AgentKey, io::Error),
    /// An agent has ended.
    Exited {
        /// The agent.
        agent: AgentKey,
        /// How it ended, in words.
        how: String,
        /// The signal that ended it; `None` if none did.
        signal: Option<i32>,
        /// True if the operating system denied or took away what it needs.
        of_machine: bool,
        /// The end of its standard error.
        stderr_tail: String,
    },
    /// A host is lost, and all its agents have ended.
    HostLost {
        /// The host.
        host: HostId,
        /// Why it counts as lost, in words.
        why: String,
        /// Its agents.
        agents: Vec<AgentKey>,
        /// Those of their modules that are to be started again.
        restarts: Vec<ModuleId>,
    },
    /// A host that was lost takes modules again, and these, which had none, are to be started.
    HostBack(HostId, Vec<ModuleId>),
    /// An agent was stopped by a signal that this controller did not send.
    Stopped(AgentKey, i32),
    /// An agent was continued after such a stop by a signal that this controller did not send.
    Continued(AgentKey),
    /// The run is to end early.
    Shutdown(Urgency),
}

/// Counts of the hosts of a swarm, apart from those of its agents.
#[derive(Clone, Debug)]
pub struct HostsAccount {
    /// The fates of frames at hosts and on the links between them.
    pub counters: Vec<AgentCounters>,
    /// The hosts that were lost, so that their counts are missing.
    pub missing: Vec<HostId>,
    /// Messages that crossed between hosts.
    pub crossings: Crossings,
}

/// Starts, signals and reaps agents. Dropping it ends all of them.
pub trait Launcher {
    /// Starts an incarnation of an agent, which then sends a hello to the controller.
    fn start(&mut self, agent: AgentKey);

    /// Sends a signal: SIGKILL, SIGSTOP or SIGCONT. An agent that has ended does not get it.
    fn signal(&mut self, agent: AgentKey, signal: Signal);

    /// Releases the resources of an agent that has ended.
    fn reap(&mut self, agent: AgentKey);

    /// Returns the next event, if any. Every event also wakes the controller's transport.
    ///
    /// # Errors
    /// If the launcher itself has failed.
    fn event(&mut self) -> Result<Option<Event>, SwarmError>;

    /// Takes note of what the scenario lets happen to a host. Without several hosts nothing follows.
    fn change_host(&mut self, _host: HostId, _change: HostChange) {}

    /// Returns the longest delay after which a host hears of a new slice of time (ns of real time).
    fn longest_delay(&self) -> u64 {
        0
    }

    /// Waits until all hosts can follow the clock of the run, before it begins.
    ///
    /// # Errors
    /// If one cannot.
    fn await_clocks(&mut self) -> Result<(), SwarmError> {
        Ok(())
    }

    /// Waits until no frame between hosts is under way, after all agents have ended, and returns what the hosts
    /// themselves have counted; `None` if there is one host only.
    ///
    /// # Errors
    /// If the launcher itself has failed.
    fn settle(&mut self) -> Result<Option<HostsAccount>, SwarmError> {
        Ok(None)
    }

    /// Returns the counters of an agent; `None` if it never started.
    ///
    /// # Errors
    /// Returns the reason why its counters cannot be read.
    fn counters(&self, agent: AgentKey) -> Result<Option<AgentCounters>, String>;
}

/// The agents that earlier controllers of a run have started.
#[derive(Clone, Debug, Default)]
pub struct Found {
    /// The latest incarnation of each module that has been started, or a later one.
    pub latest: Vec<AgentKey>,
    /// The agents that were taken over; false for those that have died since.
    pub present: BTreeMap<AgentKey, bool>,
}

/// A launcher that can take over from a killed one.
pub trait Takeover: Launcher {
    /// Takes charge of the agents of the run in `root` that take part, which are `wanted`, and ends all others.
    fn take_over(&mut self, root: &Path, wanted: &BTreeSet<AgentKey>) -> Found;
}

/// The types of one way to run a swarm: as processes of this machine, or as threads of this process.
pub trait Backend {
    /// The transport of frames.
    type Transport: Transport;
    /// The launcher of agents.
    type Launcher: Launcher;
    /// The source of time.
    type Clock: ClockSource;
}
