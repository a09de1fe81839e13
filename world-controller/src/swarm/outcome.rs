//! What a swarm of processes came to, and why one could not be run.

use metamorph_module_agent::run_dir::counter_file::AgentCounters;
use metamorph_module_agent::run_dir::swarm_file::SwarmFileError;
use metamorph_module_agent::transport::TransportError;
use metamorph_module_agent::transport::iceoryx::rendezvous::ChannelError;
use metamorph_protocol::counters::Class;
use metamorph_protocol::counters::Tally;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::time::Time;
use std::io;
use std::path::PathBuf;
use std::time::Duration;
use thiserror::Error;

use super::pace::Slowed;
use super::run_dir::RunDirError;

/// A process that ended by an error of its own.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Crash {
    /// Which module.
    pub id: ModuleId,
    /// Which incarnation of it.
    pub incarnation: Incarnation,
    /// When.
    pub at: Time,
    /// How it ended, in words.
    pub how: String,
    /// The end of what it wrote to standard error.
    pub stderr_tail: String,
}

/// What a swarm came to.
#[derive(Clone, Debug, Default)]
pub struct SwarmOutcome {
    /// Protocol messages of all incarnations of all agents.
    pub tally: Tally,
    /// Messages by class that were under way at the end, as agents counted them.
    pub left: [u64; Class::ALL.len()],
    /// Messages by class that may be lost with links that were closed while the receiver was stopped.
    pub loose: [u64; Class::ALL.len()],
    /// Incarnations that did not end in order, so that messages under way to and from them are not counted.
    pub unclosed: u64,
    /// By how much the clock was slowed.
    pub slowed: Slowed,
    /// Frames that no member of the run wrote.
    pub foreign: u64,
    /// How often agents woke up.
    pub wakes: u64,
    /// Actions, percepts and sensed contacts.
    pub body_messages: u64,
    /// Orders and reports.
    pub control_messages: u64,
    /// Real time until all agents were up.
    pub setup: Duration,
    /// Real time from there to the end.
    pub wall: Duration,
    /// Scenario time at the end.
    pub end: Time,
    /// Modules started at least once.
    pub launched: u32,
    /// Modules alive when the run was finished.
    pub alive: u32,
    /// Incarnations begun after the first.
    pub restarted: u32,
    /// Processes killed on the director's command.
    pub killed: u32,
    /// What was done to processes from outside: kills, stops, and ends of these stops.
    pub external: u32,
    /// Processes that ended by themselves.
    pub crashes: Vec<Crash>,
    /// Incarnations whose counters could not be read back, with the reason.
    pub missing_counters: Vec<String>,
    /// What each incarnation of an agent has counted.
    pub accounts: Vec<(ModuleId, Incarnation, Tally)>,
    /// Records that agents could not write to the journal.
    pub unrecorded: u64,
    /// Whether a shutdown was asked for before the director had finished.
    pub interrupted: bool,
    /// Why the swarm was ended before, if shared memory ran short.
    pub shortage: Option<String>,
}

impl SwarmOutcome {
    /// Adds what one incarnation of an agent has counted, if its counters could be read.
    pub fn count(
        &mut self,
        id: ModuleId,
        incarnation: Incarnation,
        counters: Result<Option<AgentCounters>, String>,
    ) {
        match counters {
            Ok(Some(counters)) => {
                self.tally += counters.tally;
                for class in 0..Class::ALL.len() {
                    self.left[class] += counters.left[class];
                    self.loose[class] += counters.loose[class];
                }
                self.unclosed += u64::from(!counters.closed);
                self.foreign += counters.foreign;
                self.wakes += counters.wakes;
                self.unrecorded += counters.unrecorded;
                self.accounts.push((id, incarnation, counters.tally));
            }
            // Killed before it had started.
            Ok(None) => {}
            Err(e) => self.missing_counters.push(e),
        }
    }
}

/// Why a swarm could not be run.
#[derive(Debug, Error)]
pub enum SwarmError {
    /// No modules, or more than one machine holds.
    #[error("a swarm of {0} modules cannot be run as processes; the least is 1, the most is {limit}", limit = super::MODULE_LIMIT)]
    Size(usize),
    /// Not enough file descriptors.
    #[error(
        "this swarm needs {needed} open files, but only {allowed} are allowed, and asking for more was refused ({why}); raise the hard limit (ulimit -Hn, or LimitNOFILE of the service) or use fewer modules"
    )]
    Descriptors {
        /// How many.
        needed: u64,
        /// The hard limit.
        allowed: u64,
        /// Why it could not be raised.
        why: io::Error,
    },
    /// Not enough shared memory.
    #[error("this swarm needs about {needed} MB in {home}, but only {available} MB are free; give it more (mount -o remount,size=..., docker: --shm-size) or use fewer modules", home = metamorph_module_agent::run_dir::run_name::HOME)]
    Space {
        /// How many megabytes.
        needed: u64,
        /// How many are free.
        available: u64,
    },
    /// Files may not become large enough.
    #[error("this swarm needs files of {needed} kB in {home}, and the limit of file sizes (ulimit -f) is lower; raise it or use fewer modules", home = metamorph_module_agent::run_dir::run_name::HOME)]
    FileSize {
        /// How many kilobytes.
        needed: u64,
    },
    /// Signals cannot be caught.
    #[error("cannot listen for Ctrl-C: {0}")]
    Signals(io::Error),
    /// The process that cleans up if this one is killed cannot be started.
    #[error("cannot start the process that cleans up if this one is killed: {0}")]
    Watcher(io::Error),
    /// No shared memory at all.
    #[error("cannot use {home}: {0}; processes need it to talk to each other", home = metamorph_module_agent::run_dir::run_name::HOME)]
    NoSharedMemory(io::Error),
    /// This process cannot say who it is.
    #[error("cannot find out who this process is, or say that it controls the run: {0}")]
    Identity(io::Error),
    /// The run's directory cannot be created.
    #[error(transparent)]
    RunDir(#[from] RunDirError),
    /// The swarm file cannot be written.
    #[error(transparent)]
    SwarmFile(#[from] SwarmFileError),
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
        /// Which module.
        id: ModuleId,
        /// Its program.
        program: PathBuf,
        /// Why.
        cause: String,
    },
    /// An agent ended while the swarm was set up.
    #[error("module {id} {how} before the run began; it said:\n{stderr_tail}")]
    DiedEarly {
        /// Which module.
        id: ModuleId,
        /// How it ended, in words.
        how: String,
        /// The end of what it wrote to standard error.
        stderr_tail: String,
    },
    /// Agents did not come up in time.
    #[error(
        "{missing} of {count} agents were not up, and none came up for {seconds} s; is the machine overloaded?"
    )]
    SetupTimeout {
        /// How many were missing.
        missing: usize,
        /// How many there should be.
        count: usize,
        /// How long was waited for one more.
        seconds: u64,
    },
}
