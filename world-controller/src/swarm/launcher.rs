//! What starts agents, passes signals on to them and notices their ends, as one trait: processes of this
//! machine (`supervisor`), or threads (`memory`). Absent: when to do so, which the controller loop decides.

use crate::console::shutdown::Urgency;
use crate::swarm::outcome::SwarmError;
use metamorph_module_agent::clock::source::ClockSource;
use metamorph_module_agent::run_dir::counter_file::AgentCounters;
use metamorph_module_agent::transport::{AgentKey, Transport};
use rustix::process::Signal;
use std::io;

/// What the launcher tells the controller. At most two for each incarnation, two for each stop from outside,
/// and two more.
#[derive(Debug)]
pub enum Event {
    /// It could not be started.
    SpawnFailed(AgentKey, io::Error),
    /// It has ended.
    Exited {
        /// Which incarnation.
        agent: AgentKey,
        /// How it ended, in words.
        how: String,
        /// The signal that ended it, if it was one.
        signal: Option<i32>,
        /// The end of what it wrote to standard error.
        stderr_tail: String,
    },
    /// A signal that this controller did not send has stopped it.
    Stopped(AgentKey, i32),
    /// It goes on after that, not by this controller.
    Continued(AgentKey),
    /// The run is to end early.
    Shutdown(Urgency),
}

/// Starts, signals and reaps agents. Dropping it ends all of them.
pub trait Launcher {
    /// Starts an incarnation of an agent, which says hello to the controller.
    fn start(&mut self, agent: AgentKey);

    /// Sends a signal: SIGKILL, SIGSTOP or SIGCONT. One that has ended does not get it.
    fn signal(&mut self, agent: AgentKey, signal: Signal);

    /// Gives back what an agent that has ended still holds.
    fn reap(&mut self, agent: AgentKey);

    /// The next event, if there is one. Every event also wakes the controller's transport.
    ///
    /// # Errors
    /// If the launcher itself has failed.
    fn event(&mut self) -> Result<Option<Event>, SwarmError>;

    /// What an agent has counted; `None` if it never started.
    ///
    /// # Errors
    /// With the reason, if its counters cannot be read.
    fn counters(&self, agent: AgentKey) -> Result<Option<AgentCounters>, String>;
}

/// One way to run a swarm: what carries frames, what starts agents, and what tells the time.
pub trait Backend {
    /// What carries frames.
    type Transport: Transport;
    /// What starts agents.
    type Launcher: Launcher;
    /// What tells the time.
    type Clock: ClockSource;
}
