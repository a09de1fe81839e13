//! A swarm of agents that run by themselves, with this process as its controller.
//!
//! [`run_swarm`] drives any world and any director with one process per agent, real time and real
//! signals; [`run_in_memory`] does so with one thread per agent. The calling thread owns the world, the
//! director and all links, which cannot change threads (`controller_loop`). Absent: decisions about the
//! run, which are the director's, and knowledge of which family of units it runs.

mod controller_loop;
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

pub use crate::swarm::links::descriptor_limit;
pub use crate::swarm::memory::run_in_memory;
pub use crate::swarm::meter::Meter;
pub use crate::swarm::outcome::{Crash, SwarmError, SwarmOutcome};
pub use crate::swarm::pace::{FULL, Slowed};
pub use crate::swarm::process::ControlMessage;
pub use crate::swarm::processes::{resume_swarm, run_swarm};
pub use crate::swarm::resume::{Adopted, Counted, NotResumable, Resumption, TakenOver, adopt};
pub use crate::swarm::run_dir::{CleanError, CleanReport, RunDir, RunDirError, clean};
pub use crate::swarm::watch::{SUBCOMMAND as WATCH, watch};

use crate::console::interrupt::Interrupt;
use crate::console::shutdown::Shutdown;
use metamorph_module_agent::clock::Speed;
use metamorph_module_agent::journal_file::Parts;
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::time::Span;
use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::atomic::AtomicU32;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

/// How a swarm is run.
#[derive(Clone, Debug)]
pub struct SwarmOptions {
    /// The program of the agents' processes.
    pub program: PathBuf,
    /// What comes before an agent's own arguments, such as the name of a subcommand.
    pub program_args: Vec<OsString>,
    /// The seed of the run.
    pub seed: u64,
    /// How fast scenario time passes, unless agents cannot keep up.
    pub speed: Speed,
    /// By how much scenario time agents may be late before time passes more slowly. It should be small
    /// against the timeouts of the protocol.
    pub tolerance: Span,
    /// The present speed in parts of [`FULL`]; for display.
    pub share: Arc<AtomicU32>,
    /// What links do to messages.
    pub link: LinkModel,
    /// Whether agents log to this process's standard error. Otherwise it is kept, and the end of it
    /// reported for agents that crash.
    pub verbose: bool,
    /// Asks the swarm to end before its director does.
    pub shutdown: Shutdown,
    /// Whether SIGINT, SIGTERM and SIGHUP ask the swarm to end, see [`Interrupt`].
    pub catch_signals: bool,
    /// A program and its arguments that carry out [`watch`]: it removes what this process leaves in shared
    /// memory if it is killed. Without it, the next run does.
    pub watcher: Option<(PathBuf, Vec<OsString>)>,
    /// Where agents write their parts of the journal, if one is kept.
    pub journal: Option<Parts>,
    /// How long agents wait for a controller to come back after theirs was killed. Zero without a
    /// journal, from which alone it could.
    pub patience: Duration,
    /// Where the run's directory is, as soon as it has one; for display.
    pub root: Arc<OnceLock<PathBuf>>,
    /// How long it may take until one more agent has started.
    pub setup_timeout: Duration,
    /// How long it may take until one more agent has stopped, before the rest are killed.
    pub stop_timeout: Duration,
}

impl SwarmOptions {
    /// Agents of this program; real time, perfect links, nothing caught.
    pub fn new(program: PathBuf) -> SwarmOptions {
        SwarmOptions {
            program,
            program_args: Vec::new(),
            seed: 0,
            speed: Speed::REAL,
            tolerance: Span::millis(100),
            share: Arc::default(),
            link: LinkModel::default(),
            verbose: false,
            shutdown: Shutdown::new(),
            catch_signals: false,
            watcher: None,
            journal: None,
            patience: Duration::ZERO,
            root: Arc::default(),
            setup_timeout: Duration::from_secs(120),
            stop_timeout: Duration::from_secs(30),
        }
    }
}

/// The most modules of one run on one machine; pids and descriptors end soon after.
pub const MODULE_LIMIT: usize = 16_000;

fn catch_signals(options: &SwarmOptions) -> Result<(), SwarmError> {
    if options.catch_signals {
        let interrupt = Interrupt::listen().map_err(SwarmError::Signals)?;
        interrupt.begin();
        interrupt.pass_on(&options.shutdown);
    }
    Ok(())
}
