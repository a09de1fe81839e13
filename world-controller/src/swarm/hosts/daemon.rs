//! The daemon of one host (`metamorph host`): serves the controller of one run after another. It starts, signals and
//! reaps the agents of its share in a run directory of its own, and forwards frames between its agents, other hosts
//! and the controller. To its agents it is the controller. Not here: decisions about the run.

use super::messages::{Account, Answer, Assignment, Opening, Sent, ToController, ToDaemon};
use super::messages::{read_opening, write_opening};
use super::node::Node;
use crate::console::shutdown::{Shutdown, Urgency};
use crate::console::stopwatch::Stopwatch;
use crate::swarm::launcher::{Event, Launcher};
use crate::swarm::links::raise_descriptor_limit;
use crate::swarm::outcome::SwarmError;
use crate::swarm::processes::{acquire_lease, attach};
use crate::swarm::reserve::Reserve;
use crate::swarm::run_dir::{RunDir, clean};
use crate::swarm::supervisor::{Launch, Supervisor};
use metamorph_module_agent::clock::page;
use metamorph_module_agent::run_dir::counter_file::{AgentCounters, CounterFile, CounterStore};
use metamorph_module_agent::run_dir::swarm_file;
use metamorph_module_agent::transport::iceoryx::rendezvous::set_verbosity;
use metamorph_module_agent::transport::iceoryx::{IceoryxLink, IceoryxTransport};
use metamorph_module_agent::transport::{AgentKey, Transport};
use metamorph_protocol::host_link::State;
use metamorph_protocol::ids::{HostId, Incarnation};
use metamorph_protocol::wire::CONTROLLER;
use rustix::process::Signal;
use std::ffi::OsString;
use std::io;
use std::os::unix::fs::symlink;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, sync_channel};
use std::time::Duration;
use thiserror::Error;

/// The generation of the controllers of a run on several hosts, which cannot be resumed.
pub const GENERATION: u32 = 0;
/// The name of the file with the counts of a daemon itself, as if the controller of its agents were one of them.
pub const OWN_COUNTERS: AgentKey = (CONTROLLER, Incarnation(0));
/// Number of frames taken from the inbox in one turn.
const DRAIN: usize = 2_048;
/// The longest wait for the next turn while something has to be tried again.
const RETRY: Duration = Duration::from_millis(20);
/// The longest wait otherwise, after which connections and requests to end are looked for.
const LONGEST_WAIT: Duration = Duration::from_millis(100);
/// How long a new connection may take to say what it is for.
const OPENING: Duration = Duration::from_secs(30);

/// A program and its arguments.
pub type CommandOfAgents = (PathBuf, Vec<OsString>);

/// How a daemon runs.
pub struct DaemonOptions {
    /// The build of the program (see [`build`](super::build)); runs of another build are refused.
    pub build: u64,
    /// The address on which it listens.
    pub socket: PathBuf,
    /// True if it ends after one run, or with the process that started it.
    pub once: bool,
    /// Returns the command line of the agents of a family, without what an agent itself adds; `None` if there is no
    /// such family.
    pub agents: fn(&str) -> Option<CommandOfAgents>,
    /// Requests the end of the daemon.
    pub shutdown: Shutdown,
}

/// The reason why a daemon cannot run.
#[derive(Debug, Error)]
pub enum DaemonError {
    /// The socket cannot be created.
    #[error(
        "cannot listen on {0}: {1}\n  fix: name a new file in a directory that exists and is yours; remove the file if no daemon uses it"
    )]
    Listen(PathBuf, io::Error),
    /// A thread cannot be started.
    #[error("cannot start a thread: {0}")]
    Thread(io::Error),
}

/// A connection that has said what it is for.
type Incoming = (Opening, UnixStream);

/// Serves runs until it is asked to end.
///
/// # Errors
/// If it cannot listen.
pub fn daemon(options: &DaemonOptions) -> Result<(), DaemonError> {
    if options.once {
        // An interrupted controller must not leave its daemons behind.
        let _ = rustix::process::set_parent_process_death_signal(Some(Signal::TERM));
    }
    let listen = |e| DaemonError::Listen(options.socket.clone(), e);
    let listener = bind(&options.socket).map_err(listen)?;
    let _socket = Socket(&options.socket);
    let (sender, incoming) = sync_channel(16);
    let thread = std::thread::Builder::new().name("connections".into());
    thread.spawn(move || accept(&listener, &sender)).map_err(DaemonError::Thread)?;
    while options.shutdown.urgency() == Urgency::None {
        match incoming.recv_timeout(LONGEST_WAIT) {
            Ok((Opening::Serve(assignment), stream)) => {
                let run = assignment.run;
                match serve(options, &assignment, stream, &incoming) {
                    Ok(why) => tracing::info!("run {run:016x} is over: {why}"),
                    Err(e) => tracing::error!("run {run:016x}: {e}"),
                }
                if options.once {
                    break;
                }
            }
            // Of a run that is over.
            Ok((Opening::Join { .. }, _)) | Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    Ok(())
}

/// Creates the socket, in place of one that a killed daemon has left.
fn bind(path: &Path) -> io::Result<UnixListener> {
    UnixListener::bind(path).or_else(|e| {
        let refused = |e: io::Error| e.kind() == io::ErrorKind::ConnectionRefused;
        if e.kind() != io::ErrorKind::AddrInUse || !UnixStream::connect(path).is_err_and(refused) {
            return Err(e);
        }
        std::fs::remove_file(path)?;
        UnixListener::bind(path)
    })
}

/// The file of the socket, which goes with the daemon.
struct Socket<'a>(&'a Path);

impl Drop for Socket<'_> {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(self.0);
    }
}

/// Accepts connections. Each may take its time without holding up the others.
fn accept(listener: &UnixListener, sender: &SyncSender<Incoming>) {
    for stream in listener.incoming() {
        let sender = sender.clone();
        let open = move |mut stream: UnixStream| -> io::Result<()> {
            stream.set_read_timeout(Some(OPENING))?;
            let opening = read_opening(&mut stream)?;
            // Fails only at the daemon's end.
            let _ = sender.send((opening, stream));
            Ok(())
        };
        let opened = stream.and_then(|stream| {
            let thread = std::thread::Builder::new().name("opening".into());
            thread.spawn(move || {
                if let Err(e) = open(stream) {
                    tracing::warn!("a connection is refused: {e}");
                }
            })
        });
        if let Err(e) = opened {
            tracing::warn!("a connection cannot be accepted: {e}");
        }
    }
}

/// Serves one run to its end, and returns how it ended.
fn serve(
    options: &DaemonOptions,
    assignment: &Assignment,
    mut stream: UnixStream,
    incoming: &Receiver<Incoming>,
) -> Result<&'static str, SwarmError> {
    let prepared = prepare(options, assignment);
    let answer = match &prepared {
        Ok(share) => Answer::Ready(share.dir.root().to_owned()),
        Err(why) => Answer::Refused(why.clone()),
    };
    write_opening(&mut stream, &answer).map_err(SwarmError::Supervisor)?;
    let Ok(mut share) = prepared else { return Ok("it was refused") };
    share.node.attach(HostId::CONTROLLER, stream).map_err(SwarmError::Supervisor)?;
    let ended = share.run(options, incoming);
    // Agents first: a host that says goodbye has none left.
    let Share { supervisor, mut node, .. } = share;
    drop(supervisor);
    node.close();
    ended
}

/// Checks an assignment and creates what serving it needs. The error is for people at the controller.
fn prepare<'a>(options: &DaemonOptions, assignment: &'a Assignment) -> Result<Share<'a>, String> {
    let Assignment { host, hosts, count, family, swarm, clock, .. } = assignment;
    if assignment.build != options.build {
        return Err("it runs another build of the program".to_owned());
    }
    let Some((program, args)) = (options.agents)(family) else {
        return Err(format!("it has no agents of the family `{family}`"));
    };
    let modules = hosts.modules(*host).count();
    let has_sockets = assignment.sockets.len() + 1 == hosts.len();
    if modules == 0 || *host == HostId::CONTROLLER || !has_sockets {
        return Err("the assignment contradicts itself".to_owned());
    }
    let share = || -> Result<Share<'a>, SwarmError> {
        raise_descriptor_limit(modules as u64)?;
        set_verbosity(assignment.verbose);
        if let Err(e) = clean() {
            tracing::warn!("what earlier runs left behind could not be removed: {e}");
        }
        let dir = RunDir::create()?;
        let mut reserve = Reserve::take(dir.root(), modules as u64)?;
        std::fs::write(swarm_file::path(dir.root()), swarm).map_err(SwarmError::Clock)?;
        // Hosts of one machine share the controller's clock page.
        symlink(clock, page::path(dir.root())).map_err(SwarmError::Clock)?;
        acquire_lease(&dir, GENERATION)?;
        reserve.release_own();
        let root = dir.root().to_owned();
        let launch = Launch { program, args, root, generation: GENERATION, verbose: assignment.verbose };
        let (transport, supervisor) = attach(launch, &options.shutdown, &dir, *count as usize, true)?;
        let node = Node::new(assignment, dir.root()).map_err(SwarmError::Clock)?;
        let counters = CounterFile::create(dir.root(), OWN_COUNTERS.0, OWN_COUNTERS.1)?;
        Ok(Share {
            assignment,
            supervisor,
            node,
            transport,
            reserve,
            counters,
            dialled: None,
            starting: modules,
            draining: false,
            dir,
        })
    };
    share().map_err(|e| e.to_string())
}

/// One host's share of a run.
struct Share<'a> {
    assignment: &'a Assignment,
    // Dropped in this order: agents are ended, links are closed, then their transport; the directory is last.
    supervisor: Supervisor,
    node: Node<IceoryxLink>,
    transport: IceoryxTransport,
    reserve: Reserve,
    /// The counts of this host itself, for the controller if this process is killed.
    counters: CounterFile,
    /// When other hosts were last dialled.
    dialled: Option<Stopwatch>,
    /// Number of agents that have not been started yet.
    starting: usize,
    /// True from the request to report that nothing is under way until that is so.
    draining: bool,
    dir: RunDir,
}

impl Share<'_> {
    fn run(
        &mut self,
        options: &DaemonOptions,
        incoming: &Receiver<Incoming>,
    ) -> Result<&'static str, SwarmError> {
        loop {
            if options.shutdown.urgency() > Urgency::None {
                return Ok("the daemon is asked to end");
            }
            if self.node.has_to_stop() {
                return Ok("the controller has been silent for too long");
            }
            while let Ok((opening, stream)) = incoming.try_recv() {
                self.connect(opening, stream);
            }
            self.dial();
            let heard = self.take_events()? + self.drain()?;
            self.node.turn(&mut self.transport);
            while let Some((host, state)) = self.node.next_change() {
                tracing::info!("the link to {host} is {state:?}");
                if (host, state) == (HostId::CONTROLLER, State::Closed) {
                    return Ok("it is finished");
                }
            }
            self.obey()?;
            let node = &mut self.node;
            let mut told = Vec::new();
            node.residents.catch_up(&mut self.transport, |agent, count| told.push((agent, count)));
            for (agent, count) in told {
                node.tell(HostId::CONTROLLER, &ToController::Taken(agent, count));
            }
            node.residents.flush();
            if self.draining && heard == 0 && node.is_drained() {
                self.draining = false;
                node.tell(HostId::CONTROLLER, &ToController::Drained);
            }
            // Before the packets of this turn are sent: what others receive has been counted.
            let account = AgentCounters { closed: false, ..node.account() };
            self.counters.write(&account)?;
            node.turn(&mut self.transport);
            let is_behind = node.residents.is_behind() || node.is_behind(HostId::CONTROLLER) || self.draining;
            let longest = if is_behind { RETRY } else { LONGEST_WAIT };
            let wait = node.wait().min(longest);
            if heard < DRAIN && !wait.is_zero() {
                self.transport.wait(wait)?;
            }
        }
    }

    /// Takes a connection of another host of this run. A further run is refused.
    fn connect(&mut self, opening: Opening, mut stream: UnixStream) {
        match opening {
            Opening::Join { run, from }
                if run == self.assignment.run
                    && from < self.assignment.host
                    && from != HostId::CONTROLLER =>
            {
                if let Err(e) = self.node.attach(from, stream) {
                    tracing::warn!("the connection of {from} cannot be used: {e}");
                }
            }
            Opening::Join { .. } => {}
            Opening::Serve(_) => {
                let answer = Answer::Refused("it serves another run".to_owned());
                let _ = write_opening(&mut stream, &answer);
            }
        }
    }

    /// Connects to hosts of higher number.
    fn dial(&mut self) {
        if self.dialled.is_some_and(|last| last.elapsed() < LONGEST_WAIT) {
            return;
        }
        self.dialled = Some(Stopwatch::start());
        for host in self.node.to_dial().collect::<Vec<_>>() {
            let Some(socket) = self.assignment.sockets.get(host.index() - 1) else { continue };
            let connected = UnixStream::connect(socket).and_then(|mut stream| {
                write_opening(
                    &mut stream,
                    &Opening::Join { run: self.assignment.run, from: self.assignment.host },
                )?;
                self.node.attach(host, stream)
            });
            if let Err(e) = connected {
                tracing::debug!("{host} cannot be reached: {e}");
            }
        }
    }

    /// Passes on what the supervisor reports. Returns the number of events.
    fn take_events(&mut self) -> Result<usize, SwarmError> {
        let mut count = 0;
        while let Some(event) = self.supervisor.event()? {
            count += 1;
            let message = match event {
                Event::Shutdown(_) => continue,
                Event::SpawnFailed(agent, e) => {
                    self.node.residents.leave(agent);
                    ToController::SpawnFailed(agent, e.to_string())
                }
                Event::Stopped(agent, signal) => ToController::Stopped(agent, signal),
                Event::Continued(agent) => ToController::Continued(agent),
                Event::Exited { agent, how, signal, stderr_tail } => {
                    // Frames that it sent before its end go before the report of its end.
                    for _ in 0..DRAIN {
                        if !self.drain_once()? {
                            break;
                        }
                    }
                    self.node.residents.leave(agent);
                    let counters =
                        self.supervisor.counters(agent).map(|c| c.map(|c| Box::new(Account::from(c))));
                    ToController::Exited { agent, how, signal, stderr_tail, counters }
                }
            };
            self.node.tell(HostId::CONTROLLER, &message);
        }
        Ok(count)
    }

    /// Takes frames out of the inbox, unless the link to the controller is behind. Returns their number.
    fn drain(&mut self) -> Result<usize, SwarmError> {
        for taken in 0..DRAIN {
            if self.node.is_behind(HostId::CONTROLLER) || !self.drain_once()? {
                return Ok(taken);
            }
        }
        Ok(DRAIN)
    }

    fn drain_once(&mut self) -> Result<bool, SwarmError> {
        let Some(shared) = self.transport.receive()? else { return Ok(false) };
        if !self.node.forward(&shared) {
            self.node.tell(HostId::CONTROLLER, &ToController::Frame(Sent::new(&shared)));
        }
        Ok(true)
    }

    /// Does what the controller says.
    fn obey(&mut self) -> Result<(), SwarmError> {
        while let Some(message) = self.node.hear(HostId::CONTROLLER).map_err(SwarmError::Supervisor)? {
            match message {
                ToDaemon::Start(agent) if self.is_ours(agent) => {
                    if agent.1 == Incarnation(0) {
                        self.starting = self.starting.saturating_sub(1);
                        match self.starting {
                            0 => self.reserve.release_most(),
                            _ => self.reserve.release_one(),
                        }
                    }
                    self.node.residents.arrive(agent);
                    self.supervisor.start(agent);
                }
                ToDaemon::Signal(agent, signal) if self.is_ours(agent) => {
                    if let Some(signal) = Signal::from_named_raw(signal) {
                        self.supervisor.signal(agent, signal);
                    }
                }
                ToDaemon::Reap(agent) if self.is_ours(agent) => self.supervisor.reap(agent),
                ToDaemon::Frame(agent, sent) if self.is_ours(agent) => {
                    let frame = sent.shared(self.node.healed(HostId::CONTROLLER));
                    let posted = frame.is_some_and(|frame| self.node.residents.post(agent, frame));
                    if !posted {
                        self.node.tell(HostId::CONTROLLER, &ToController::Taken(agent, 1));
                    }
                }
                ToDaemon::Start((id, _))
                | ToDaemon::Signal((id, _), _)
                | ToDaemon::Reap((id, _))
                | ToDaemon::Frame((id, _), _) => {
                    tracing::warn!("the controller takes module {id} for one of this host");
                }
                ToDaemon::Drain => self.draining = true,
                ToDaemon::Account => {
                    let account = Box::new(self.node.account().into());
                    let account = ToController::Account(account, self.node.crossed());
                    self.node.tell(HostId::CONTROLLER, &account);
                }
            }
        }
        Ok(())
    }

    fn is_ours(&self, agent: AgentKey) -> bool {
        self.assignment.hosts.is_home(agent.0, self.assignment.host)
    }
}
