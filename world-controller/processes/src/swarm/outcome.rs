//! The outcome of a swarm of processes, and the errors that keep one from running.

use super::links::TooFewDescriptors;
use metamorph_module_agent::run_dir::counter_file::{AgentCounters, CounterFileError};
use metamorph_module_agent::run_dir::swarm_file::SwarmFileError;
use metamorph_module_agent::transport::TransportError;
use metamorph_module_agent::transport::iceoryx::rendezvous::ChannelError;
use metamorph_protocol::counters::Class;
use metamorph_protocol::counters::Tally;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::latency::Latencies;
use metamorph_protocol::time::Time;
use metamorph_sim_bridge::kernel::sim::Crossings;
use metamorph_text::format::bytes;
use std::collections::BTreeSet;
use std::io;
use std::path::PathBuf;
use std::time::Duration;
use thiserror::Error;

use super::hosts::FleetError;
use super::launcher::HostsAccount;
use super::run_dir::RunDirError;
use metamorph_report::Slowed;

/// A process that ended by an error of its own.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Crash {
    /// The module.
    pub id: ModuleId,
    /// Its incarnation.
    pub incarnation: Incarnation,
    /// When it ended.
    pub at: Time,
    /// How it ended, in words.
    pub how: String,
    /// The end of its standard error.
    pub stderr_tail: String,
}

/// The outcome of a swarm.
#[derive(Clone, Debug, Default)]
pub struct SwarmOutcome {
    /// Protocol messages of all incarnations of all agents.
    pub tally: Tally,
    /// Latencies of the messages delivered, as agents measured them.
    pub latencies: Latencies,
    /// Messages by class that were under way at the end, as agents counted them.
    pub left: [u64; Class::ALL.len()],
    /// Messages by class that may be lost with links that were closed while the receiver was stopped.
    pub loose: [u64; Class::ALL.len()],
    /// Number of incarnations that did not end regularly: messages in transit to and from them are not
    /// counted.
    pub unclosed: u64,
    /// How the clock was slowed.
    pub slowed: Slowed,
    /// Number of frames that no member of the run wrote.
    pub foreign: u64,
    /// Number of wake-ups of agents.
    pub wakes: u64,
    /// Number of actions, percepts and sensed contacts.
    pub body_messages: u64,
    /// Number of orders and reports.
    pub control_messages: u64,
    /// Real time until all agents were up.
    pub setup: Duration,
    /// Real time from there to the end.
    pub wall: Duration,
    /// Scenario time at the end.
    pub end: Time,
    /// Number of modules started at least once.
    pub launched: u32,
    /// Number of modules alive when the run was finished.
    pub alive: u32,
    /// Number of incarnations after the first.
    pub restarted: u32,
    /// Number of processes killed on the director's command.
    pub killed: u32,
    /// Number of interventions from outside: processes killed, stopped, or continued after such a stop.
    pub external: u32,
    /// Processes that ended by themselves.
    pub crashes: Vec<Crash>,
    /// Incarnations whose counters could not be read back, with the reason.
    pub missing_counters: BTreeSet<String>,
    /// The message counts of each incarnation of an agent.
    pub accounts: Vec<(ModuleId, Incarnation, Tally)>,
    /// Number of records that agents could not write to the journal.
    pub unrecorded: u64,
    /// True if a shutdown was asked for, or the machine failed, before the director had finished.
    pub interrupted: bool,
    /// Why the swarm was ended early, if the machine took away what it needs.
    pub machine_fault: Option<String>,
    /// Messages that crossed between hosts; empty if there is only one host.
    pub crossings: Crossings,
}

impl SwarmOutcome {
    /// Adds the counters of one incarnation of an agent, if they could be read.
    pub fn count(
        &mut self,
        id: ModuleId,
        incarnation: Incarnation,
        counters: Result<Option<AgentCounters>, String>,
    ) {
        match counters {
            Ok(Some(counters)) => {
                self.add(&counters);
                self.accounts.push((id, incarnation, counters.tally));
            }
            // Killed before it had started.
            Ok(None) => {}
            Err(e) => {
                self.missing_counters.insert(e);
            }
        }
    }

    /// Adds what the hosts themselves have counted.
    pub fn count_hosts(&mut self, account: HostsAccount) {
        account.counters.iter().for_each(|counters| self.add(counters));
        let missing =
            account.missing.iter().map(|host| format!("{host} was lost, and its own counts with it"));
        self.missing_counters.extend(missing);
        self.crossings = account.crossings;
    }

    fn add(&mut self, counters: &AgentCounters) {
        self.tally += counters.tally;
        self.latencies += &counters.latencies;
        for class in 0..Class::ALL.len() {
            self.left[class] += counters.left[class];
            self.loose[class] += counters.loose[class];
        }
        self.unclosed += u64::from(!counters.closed);
        self.foreign += counters.foreign;
        self.wakes += counters.wakes;
        self.unrecorded += counters.unrecorded;
    }
}

/// Errors that keep a swarm from running.
#[derive(Debug, Error)]
pub enum SwarmError {
    /// No modules, or more than a machine can hold.
    #[error("a swarm of {0} modules cannot be run; it must have 1 to {limit} modules", limit = super::MODULE_LIMIT)]
    Size(usize),
    /// Too few file descriptors.
    #[error(transparent)]
    Descriptors(#[from] TooFewDescriptors),
    /// Too little shared memory.
    #[error(
        "this swarm needs about {} in {home}, but only {} are free\n  fix: give it more (of a container: --shm-size, else mount -o remount,size=...), or use fewer modules; `metamorph doctor --modules N` says how much",
        bytes(*.needed), bytes(*.available), home = metamorph_module_agent::run_dir::run_name::HOME
    )]
    Space {
        /// Bytes needed.
        needed: u64,
        /// Bytes free.
        available: u64,
    },
    /// The limit of file sizes is too low.
    #[error("this swarm needs files of {needed} kB in {home}, and the limit of file sizes (ulimit -f) is lower; raise it or use fewer modules", home = metamorph_module_agent::run_dir::run_name::HOME)]
    FileSize {
        /// Kilobytes needed.
        needed: u64,
    },
    /// Signals cannot be caught.
    #[error("cannot listen for Ctrl-C: {0}")]
    Signals(io::Error),
    /// The process that cleans up if this one is killed cannot be started.
    #[error("cannot start the process that cleans up if this one is killed: {0}")]
    Watcher(io::Error),
    /// Shared memory cannot be used.
    #[error("cannot use {home}: {0}; processes need it to talk to each other", home = metamorph_module_agent::run_dir::run_name::HOME)]
    NoSharedMemory(io::Error),
    /// This process cannot be identified, or the lease of the run cannot be read or written.
    #[error("cannot identify this process, or cannot read or write the controller's lease of the run: {0}")]
    Identity(io::Error),
    /// The run's directory cannot be created.
    #[error(transparent)]
    RunDir(#[from] RunDirError),
    /// The swarm file cannot be written.
    #[error(transparent)]
    SwarmFile(#[from] SwarmFileError),
    /// A host cannot write its counts.
    #[error(transparent)]
    Counters(#[from] CounterFileError),
    /// The daemons of the other hosts are not to be had.
    #[error(transparent)]
    Fleet(#[from] FleetError),
    /// A channel cannot be created.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// The controller's inbox failed.
    #[error(transparent)]
    Transport(#[from] TransportError),
    /// The clock page cannot be written or read.
    #[error("cannot set the clock of the run: {0}")]
    Clock(io::Error),
    /// The supervisor's thread cannot be started.
    #[error("cannot start the supervisor: {0}")]
    Supervisor(io::Error),
    /// An agent's process cannot be started.
    #[error("cannot start the process of module {id} ({program}): {cause}")]
    Spawn {
        /// The module.
        id: ModuleId,
        /// Its program.
        program: PathBuf,
        /// The cause.
        cause: String,
    },
    /// An agent ended while the swarm was set up.
    #[error("module {id} {how} before the run began; it said:\n{stderr_tail}")]
    DiedEarly {
        /// The module.
        id: ModuleId,
        /// How it ended, in words.
        how: String,
        /// The end of its standard error.
        stderr_tail: String,
    },
    /// Agents did not come up in time.
    #[error(
        "{missing} of {count} agents were not up, and none came up for {seconds} s; is the machine overloaded?"
    )]
    SetupTimeout {
        /// Number of missing agents.
        missing: usize,
        /// Number of agents in the swarm.
        count: usize,
        /// How long the wait for one more lasted (s).
        seconds: u64,
    },
}
