//! The start of an agent process: it reads the run's directory, joins the run over iceoryx2, and hands over
//! to the wait loop ([`crate::process::agent_process`]).

use crate::clock::monotonic;
use crate::clock::source::FileClock;
use crate::journal_file::{Head, JournalError, Parts, Writer, agent_part};
use crate::process::agent_process::{AgentConfig, AgentProcess, AgentServices};
use crate::process::args::AgentArgs;
use crate::process::bounds::most_neighbours;
use crate::process::orphan_watch::OrphanWatch;
use crate::run_dir::controller_lease::ControllerLease;
use crate::run_dir::counter_file::{CounterFile, CounterFileError};
use crate::run_dir::identity::{Guard, Identity, survive_file_limits};
use crate::run_dir::run_name::RunName;
use crate::run_dir::swarm_file::{SwarmFile, SwarmFileError};
use crate::transport::iceoryx::rendezvous::{ChannelError, Rendezvous, set_verbosity};
use crate::transport::iceoryx::{IceoryxTransport, space};
use crate::transport::{AgentKey, ConnectError, LACK, TransportError};
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::{HostId, Incarnation, ModuleId};
use rustix::process::{getpgid, getppid, setpgid, setsid};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use thiserror::Error;

/// The exit code of an agent that could not get what it needs from the operating system: `EX_OSERR` of sysexits(3).
pub const EXIT_OF_MACHINE: u8 = 71;

/// Errors that end an agent process before its controller ends it.
#[derive(Debug, Error)]
pub enum AgentError {
    /// The swarm file cannot be read.
    #[error(transparent)]
    Swarm(#[from] SwarmFileError),
    /// The counters cannot be written.
    #[error(transparent)]
    Counters(#[from] CounterFileError),
    /// A channel of this process cannot be created.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// The controller cannot be reached.
    #[error(transparent)]
    Connect(#[from] ConnectError),
    /// The inbox failed.
    #[error(transparent)]
    Transport(#[from] TransportError),
    /// The journal cannot be created.
    #[error(transparent)]
    Journal(#[from] JournalError),
    /// The identity of this process cannot be written.
    #[error("cannot register this process in {0}: {1}")]
    Register(PathBuf, io::Error),
    /// The clock of the run cannot be read.
    #[error("cannot read the clock of the run: {0}")]
    Clock(io::Error),
    /// The lease of the controller cannot be read.
    #[error("cannot find out who controls the run in {0}: {1}")]
    Lease(PathBuf, io::Error),
    /// The inbox has no room in shared memory.
    #[error("cannot get memory for the inbox of this agent in {0}: {1}; is shared memory full?")]
    Space(PathBuf, io::Error),
    /// The controller is gone.
    #[error("the controller (process {0}) is gone; an agent does not go on without it")]
    Orphan(i32),
    /// The daemon has not run for longer than the fence of its host.
    #[error("the daemon (process {0}) has not run for so long that this agent may count as dead")]
    Frozen(i32),
    /// No link to a neighbour can be opened.
    #[error("cannot reach module {peer}, a neighbour: {cause}; {reason}", reason = LACK)]
    Silenced {
        /// The neighbour.
        peer: ModuleId,
        /// The last failure.
        cause: ConnectError,
    },
    /// The number of the module exceeds the size of the swarm.
    #[error("this agent is number {0}, but the swarm has only {1} modules")]
    NoSuchModule(u32, u32),
}

impl AgentError {
    /// Returns the exit code of the process: [`EXIT_OF_MACHINE`], or 1 if its controller is gone, is frozen, or has
    /// started it wrongly.
    pub fn exit_code(&self) -> u8 {
        match self {
            AgentError::Orphan(_) | AgentError::Frozen(_) | AgentError::NoSuchModule(..) => 1,
            _ => EXIT_OF_MACHINE,
        }
    }
}

/// Returns the directory in which the processes of a run write their identities.
pub fn pid_directory(root: &Path) -> PathBuf {
    root.join("pids")
}

/// Returns the file in which one incarnation of an agent writes its identity: its process, and then, once it
/// has joined, the number of its membership of the run.
pub fn pid_file(root: &Path, id: ModuleId, incarnation: Incarnation) -> PathBuf {
    pid_directory(root).join(format!("{id}.{incarnation}"))
}

/// Runs one agent until its controller ends it or is gone. Returns `Ok` in the first case only: the program
/// then exits with success, and any other exit code counts as a crash.
///
/// # Errors
/// If the agent cannot start or continue.
pub fn run<A: Agent>(args: &AgentArgs) -> Result<(), AgentError> {
    prepare_process(args.verbose);
    let swarm: SwarmFile<A::Setup> = SwarmFile::read(&args.root)?;
    let _named = name_lines(args.id, &swarm).entered();
    let lease = ControllerLease::read(&args.root).map_err(|e| AgentError::Lease(args.root.clone(), e))?;
    let guard = Guard::new(lease.controller, swarm.patience > 0);
    if guard.controller_is_gone() {
        return Err(AgentError::Orphan(lease.controller.pid));
    }
    if swarm.patience > 0 {
        leave_session();
    }
    if args.id.0 >= swarm.count {
        return Err(AgentError::NoSuchModule(args.id.0, swarm.count));
    }
    let agent = (args.id, args.incarnation);
    let mut transport = join(args, agent, most_neighbours::<A>(swarm.count as usize))?;
    if let Some(hosts) = &swarm.link.hosts {
        transport = transport.on_hosts(Arc::clone(hosts), lease.generation);
    }
    let counters = Box::new(CounterFile::create(&args.root, args.id, args.incarnation)?);
    // Before the controller hears of this incarnation: every incarnation that it knows has its part.
    let journal = swarm.journal.as_ref().map(|parts| begin_journal(parts, agent)).transpose()?;
    let clock = FileClock::open(&args.root).map_err(AgentError::Clock)?;
    let timeout = u64::from(swarm.patience) * 1_000_000;
    let orphan_watch = Some(OrphanWatch::new(args.root.clone(), lease, guard, timeout, monotonic()));
    let SwarmFile { seed, speed, tolerance, link, setup, count, .. } = swarm;
    let generation = lease.generation;
    let setup = Arc::new(setup);
    let config = AgentConfig { agent, count, seed, speed, tolerance, link, setup, generation };
    let services = AgentServices { transport, clock, counters, journal, orphan_watch };
    AgentProcess::<A, _, _>::new(config, services)?.run()
}

/// Joins the run and creates the inbox, for frames of up to `neighbours` neighbours at a time.
fn join(args: &AgentArgs, agent: AgentKey, neighbours: usize) -> Result<IceoryxTransport, AgentError> {
    register(args, None)?;
    let at = Rendezvous::join(&args.root)?;
    register(args, Some(at.member()))?;
    let transport = IceoryxTransport::agent(at, agent, neighbours)?;
    space::allocate(&RunName::of_root(&args.root).map_err(ChannelError::Run)?)
        .map_err(|e| AgentError::Space(args.root.clone(), e))?;
    Ok(transport)
}

/// Sets up logging, signals and priority. Only rare events are logged above the level of debugging, because
/// the file that they go to is not emptied before the end.
fn prepare_process(verbose: bool) {
    use tracing::level_filters::LevelFilter;
    let level = if verbose { LevelFilter::DEBUG } else { LevelFilter::WARN };
    // Fails if the program has set up logging of its own, which then stays.
    let _ = tracing_subscriber::fmt().with_writer(io::stderr).with_max_level(level).try_init();
    set_verbosity(verbose);
    if let Err(e) = survive_file_limits() {
        tracing::debug!("a write beyond the limit of file sizes ends this process: {e}");
    }
    // The controller carries the traffic of all agents, so it has priority.
    if let Err(e) = rustix::process::nice(1) {
        tracing::debug!("priority is unchanged: {e}");
    }
}

/// Names the run, the host and the module in every line of the log: those of many agents come together.
fn name_lines<S>(id: ModuleId, swarm: &SwarmFile<S>) -> tracing::Span {
    let host = swarm.link.hosts.as_ref().and_then(|hosts| hosts.home_of(id)).unwrap_or(HostId::CONTROLLER);
    tracing::error_span!("agent", run = swarm.run, %host, module = id.0)
}

/// Leaves the session of the controller. When a process dies, the kernel sends SIGHUP to its stopped children
/// in its session, which would end them.
fn leave_session() {
    // The leader of a process group cannot leave; the supervisor has made this process one.
    let parent = getppid().ok_or(rustix::io::Errno::SRCH);
    let left =
        parent.and_then(|p| getpgid(Some(p))).and_then(|g| setpgid(None, Some(g))).and_then(|()| setsid());
    if let Err(e) = left {
        tracing::warn!("if this process is stopped when its controller is killed, it dies too: {e}");
    }
}

/// Writes the identity of this process, so that it can be found if its controller is killed, and its
/// membership of the run, so that it can be reaped.
fn register(args: &AgentArgs, member: Option<u128>) -> Result<(), AgentError> {
    let path = pid_file(&args.root, args.id, args.incarnation);
    let member = member.map_or_else(String::new, |m| format!("{m}\n"));
    Identity::own()
        .and_then(|me| std::fs::write(&path, me.to_line() + &member))
        .map_err(|e| AgentError::Register(path, e))
}

/// Creates this incarnation's part of the journal.
///
/// # Errors
/// If the file cannot be written.
pub fn begin_journal(parts: &Parts, agent: AgentKey) -> Result<Writer, JournalError> {
    let head = Head::Part { run: parts.run, id: agent.0, incarnation: agent.1 };
    Writer::create(&agent_part(&parts.dir, agent.0, agent.1), &head)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::Speed;
    use metamorph_protocol::link::{ClockOffset, Hosts, LinkModel};
    use metamorph_protocol::time::Span;
    use std::sync::{Mutex, PoisonError};

    #[derive(Clone, Default)]
    struct Kept(Arc<Mutex<Vec<u8>>>);

    impl io::Write for Kept {
        fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
            self.0.lock().unwrap_or_else(PoisonError::into_inner).extend(bytes);
            Ok(bytes.len())
        }
        fn flush(&mut self) -> io::Result<()> {
            Ok(())
        }
    }

    #[test]
    fn lines_of_the_log_name_run_host_and_module() {
        let homes = [0, 0, 1].map(HostId).to_vec();
        let clocks = vec![ClockOffset::default(); 2];
        let hosts = Hosts::new(homes, clocks, vec![LinkModel::default()]).unwrap();
        let swarm = SwarmFile {
            run: "mm0000k2x9q1".to_owned(),
            count: 3,
            seed: 1,
            speed: Speed::REAL,
            tolerance: Span::millis(1),
            link: LinkModel { hosts: Some(Arc::new(hosts)), ..LinkModel::default() },
            journal: None,
            patience: 0,
            setup: (),
        };
        let kept = Kept::default();
        let writer = kept.clone();
        let lines = tracing_subscriber::fmt().with_ansi(false).with_writer(move || writer.clone()).finish();
        tracing::subscriber::with_default(lines, || {
            for id in [1, 2].map(ModuleId) {
                let _named = name_lines(id, &swarm).entered();
                tracing::warn!("hears nothing");
            }
        });
        let text = String::from_utf8(kept.0.lock().unwrap().clone()).unwrap();
        for name in ["host=h1 module=1", "host=h2 module=2"] {
            assert!(text.contains(&format!("agent{{run=\"mm0000k2x9q1\" {name}}}: ")), "{text}");
        }
    }
}
