//! A swarm of agents that run on their own, with this process as their controller.
//!
//! [`run_swarm`] drives any world and any director with one process per agent, real time and real signals;
//! [`run_in_memory`] does so with one thread per agent. The calling thread owns the world, the director and
//! all links, which cannot change threads (`controller_loop`). Not here: decisions about the run, which the
//! director takes, and knowledge of the family.

pub mod balance;
mod controller_loop;
mod hosts;
mod launcher;
mod links;
mod memory;
mod meter;
mod outcome;
mod pace;
mod process;
mod processes;
mod reaper;
mod reserve;
mod resume;
mod run_dir;
mod signals;
mod supervisor;
mod watch;

pub use crate::swarm::hosts::{
    Address, AddressError, DaemonError, DaemonOptions, HOSTS_FILE_VERSION, HostsFile, HostsFileError,
    HostsOptions, NetCost, NetCosts, Placement, ReachError, Survey, build, daemon, host_status,
};
#[cfg(feature = "hosts")]
pub use crate::swarm::hosts::{
    KeysError, NetBenchError, keep_zenoh_on_one_thread, make_keys, measure_net, renew_keys,
};
pub use crate::swarm::links::{MODULE_LIMIT, descriptor_limit, descriptors_needed, room_of_daemon};
pub use crate::swarm::memory::run_in_memory;
pub use crate::swarm::meter::Meter;
pub use crate::swarm::outcome::{Crash, SwarmError, SwarmOutcome};
pub use crate::swarm::pace::FULL;
pub use crate::swarm::process::ControlMessage;
pub use crate::swarm::processes::{resume_swarm, run_swarm};
pub use crate::swarm::reserve::needed as shared_memory_needed;
pub use crate::swarm::resume::{
    Adopted, Counted, NotResumable, Resumption, TakenOver, adopt, adopt_elsewhere,
};
pub use crate::swarm::run_dir::{
    CleanError, CleanReport, RunDir, RunDirError, clean, leftovers, log_directory,
};
pub use crate::swarm::watch::{SUBCOMMAND as WATCH, watch};

use crate::control::SharedQueue;
use crate::metrics::Metrics;
use metamorph_console::interrupt::Interrupt;
use metamorph_console::shutdown::Shutdown;
use metamorph_module_agent::clock::Speed;
use metamorph_module_agent::journal_file::Parts;
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::time::Span;
use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::atomic::AtomicU32;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

/// The options of a swarm.
#[derive(Clone, Debug)]
pub struct SwarmOptions {
    /// The program of the agents' processes.
    pub program: PathBuf,
    /// The arguments before an agent's own, such as the name of a subcommand.
    pub program_args: Vec<OsString>,
    /// The seed of the run.
    pub seed: u64,
    /// The speed of scenario time, unless agents cannot keep up.
    pub speed: Speed,
    /// The lateness of agents, in scenario time, above which time passes more slowly. It should be small
    /// compared with the time-outs of the protocol.
    pub tolerance: Span,
    /// The present speed in parts of [`FULL`]; for display.
    pub share: Arc<AtomicU32>,
    /// The effects of links on messages, and the hosts.
    pub link: LinkModel,
    /// The daemons of the other hosts, if there are several.
    pub hosts: HostsOptions,
    /// True if agents log to this process's standard error. Otherwise the standard error of each agent is
    /// kept in a file, whose end is reported if the agent crashes.
    pub verbose: bool,
    /// Has the commands of operators, if the run can be controlled.
    pub control: Option<SharedQueue>,
    /// Takes note of the run, if its metrics are served.
    pub metrics: Option<Metrics>,
    /// Requests the end of the swarm before its director does.
    pub shutdown: Shutdown,
    /// True if SIGINT, SIGTERM and SIGHUP request the end of the swarm, see [`Interrupt`].
    pub catch_signals: bool,
    /// A program with arguments that calls [`watch`]: it removes what this process leaves in shared memory
    /// when it is killed. Without it, the next run does.
    pub watcher: Option<(PathBuf, Vec<OsString>)>,
    /// The location of the agents' parts of the journal; `None` if none is kept.
    pub journal: Option<Parts>,
    /// How long agents wait for a controller to come back after theirs was killed (real time). Zero without a
    /// journal, which a new controller needs.
    pub patience: Duration,
    /// The run's directory, as soon as it exists; for display.
    pub root: Arc<OnceLock<PathBuf>>,
    /// The name of the run in logs and metrics, as soon as it has one.
    pub run: Arc<OnceLock<String>>,
    /// Longest time that the start of the swarm may take without one more agent coming up.
    pub setup_timeout: Duration,
    /// Longest time that the end of the swarm may take without one more agent falling silent or ending, before the
    /// rest are killed.
    pub stop_timeout: Duration,
}

impl SwarmOptions {
    /// Returns options for agents of this program: real time, perfect links, no signals caught.
    pub fn new(program: PathBuf) -> SwarmOptions {
        SwarmOptions {
            program,
            program_args: Vec::new(),
            seed: 0,
            speed: Speed::REAL,
            tolerance: Span::millis(100),
            share: Arc::default(),
            link: LinkModel::default(),
            hosts: HostsOptions::default(),
            verbose: false,
            control: None,
            metrics: None,
            shutdown: Shutdown::new(),
            catch_signals: false,
            watcher: None,
            journal: None,
            patience: Duration::ZERO,
            root: Arc::default(),
            run: Arc::default(),
            setup_timeout: Duration::from_secs(120),
            stop_timeout: Duration::from_secs(30),
        }
    }
}

fn catch_signals(options: &SwarmOptions) -> Result<(), SwarmError> {
    if options.catch_signals {
        let interrupt = Interrupt::listen().map_err(SwarmError::Signals)?;
        interrupt.begin();
        interrupt.pass_on(&options.shutdown);
    }
    Ok(())
}
