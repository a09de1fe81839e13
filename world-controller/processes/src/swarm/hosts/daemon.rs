//! The daemon of one host (`metamorph host`): serves the controller of one run after another. It starts, signals and
//! reaps the agents of its share in a run directory of its own, and forwards frames between its agents, other hosts
//! and the controller. To its agents it is the controller. Not here: decisions about the run.

use super::absence::{Absence, ControllerWatch};
use super::address::Address;
use super::connection::{Connection, Visitor};
use super::conversation::Conversations;
use super::follower::Follower;
use super::gate::Gate;
use super::messages::{
    Account, Answer, Assignment, HostStatus, Opening, Resuming, Sent, ToController, ToDaemon, write_opening,
};
use super::node::Node;
use super::notify;
use super::parts::Written;
use super::remains::{Ending, Remains};
use crate::metrics::Metrics;
use crate::swarm::launcher::{Event, Launcher};
use crate::swarm::outcome::SwarmError;
use crate::swarm::processes::{acquire_lease, attach};
use crate::swarm::reserve::Reserve;
use crate::swarm::run_dir::{RunDir, clean, leftovers};
use crate::swarm::supervisor::{Launch, Supervisor, oom_kills};
use metamorph_console::shutdown::{Shutdown, Urgency};
use metamorph_console::stopwatch::{Stopwatch, wait_until};
use metamorph_module_agent::clock::{monotonic, page};
use metamorph_module_agent::run_dir::counter_file::{AgentCounters, CounterFile, CounterStore};
use metamorph_module_agent::run_dir::share_lease;
use metamorph_module_agent::run_dir::swarm_file;
use metamorph_module_agent::transport::iceoryx::rendezvous::set_verbosity;
use metamorph_module_agent::transport::iceoryx::{IceoryxLink, IceoryxTransport};
use metamorph_module_agent::transport::{AgentKey, Transport};
use metamorph_protocol::host_link::State;
use metamorph_protocol::ids::{HostId, Incarnation};
use metamorph_protocol::wire::CONTROLLER;
use metamorph_text::command_error::CommandError;
use metamorph_text::escape::Shown;
use rustix::process::{Signal, getppid};
use std::ffi::OsString;
use std::io;
use std::os::unix::fs::symlink;
use std::os::unix::net::UnixStream;
use std::path::PathBuf;
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;
use thiserror::Error;

/// Number of the generation of a daemon, as the controller of its agents.
const GENERATION: u32 = 0;
/// The name of the file with the counts of a daemon itself, as if the controller of its agents were one of them.
pub const OWN_COUNTERS: AgentKey = (CONTROLLER, Incarnation(GENERATION as u16));
/// Number of frames taken from the inbox in one turn.
const DRAIN: usize = 2_048;
/// Longest time to wait for the next turn while something has to be tried again.
const RETRY_WAIT_MAX: Duration = Duration::from_millis(20);
/// Longest time to wait otherwise. After it the daemon looks for connections and requests to end.
const WAIT_MAX: Duration = Duration::from_millis(100);
/// Shortest time to wait for the clock of another machine.
const CLOCK_WAIT_MIN: Duration = Duration::from_millis(1);

/// Number of times that the lease of agents is renewed within a fence.
const LEASES: u64 = 10;
/// Time for which a daemon that is asked to end keeps the counts of a run in progress.
const LAST_CALL: Duration = Duration::from_secs(1);

/// A program and its arguments.
pub type CommandOfAgents = (PathBuf, Vec<OsString>);

/// How a daemon runs.
pub struct DaemonOptions {
    /// The build of the program (see [`build`](super::build)); runs of another build are refused.
    pub build: u64,
    /// The address on which it listens.
    pub address: Address,
    /// Which host it is, and the directory of its keys; on a network both are needed.
    pub identity: Option<(HostId, PathBuf)>,
    /// The most modules that it takes.
    pub most: u32,
    /// True if it ends after one run, or with the process that started it.
    pub once: bool,
    /// Returns the command line of the agents of a family, without what an agent itself adds; `None` if there is no
    /// such family.
    pub agents: fn(&str) -> Option<CommandOfAgents>,
    /// Takes note of runs, if metrics are served.
    pub metrics: Option<Metrics>,
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
    /// On a network a host has to say who it is.
    #[cfg(feature = "hosts")]
    #[error("a daemon on a network needs a name and keys\n  fix: add `--name h2 --keys DIRECTORY`")]
    NoIdentity,
    /// The keys cannot be used.
    #[cfg(feature = "hosts")]
    #[error(transparent)]
    Keys(super::net::KeysError),
    /// The network cannot be used.
    #[cfg(feature = "hosts")]
    #[error(
        "{0}\n  fix: check that the address is of this machine and free, and that the keys are of one `--make-keys`"
    )]
    Session(super::net::SessionError),
    /// This program has no links between machines.
    #[cfg(not(feature = "hosts"))]
    #[error(
        "this program is built without links between machines\n  fix: build it with `cargo build --release --features hosts`, or listen on the path of a socket"
    )]
    NotBuilt,
}

impl CommandError for DaemonError {}

/// Serves runs until it is asked to end. `ready` is called once others can connect.
///
/// # Errors
/// If it cannot listen.
pub fn daemon(options: &DaemonOptions, ready: impl FnOnce()) -> Result<(), DaemonError> {
    let parent = getppid();
    let gate = Gate::open(options)?;
    ready();
    notify::ready();
    let mut remains: Vec<Remains> = Vec::new();
    let mut has_served = false;
    while options.shutdown.urgency() == Urgency::None {
        remains.retain(|share| !share.is_over());
        if options.once && has_served {
            if remains.is_empty() {
                break;
            }
            std::thread::park_timeout(RETRY_WAIT_MAX);
            continue;
        }
        if options.once && getppid() != parent {
            // A killed controller must not leave behind daemons that serve no run.
            break;
        }
        match gate.incoming.recv_timeout(WAIT_MAX) {
            Ok((Opening::Serve(assignment), visitor)) => {
                let run = assignment.run;
                match serve(options, &assignment, visitor, &gate, &mut remains) {
                    Ok(why) => tracing::info!("run {run:016x} is over: {why}"),
                    Err(e) => tracing::error!("run {run:016x}: {e}"),
                }
                has_served = true;
            }
            Ok((opening, visitor)) => answer(options, &opening, visitor, None),
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    // A controller on this machine takes the counts as soon as it has heard the goodbye.
    wait_until(LAST_CALL, || {
        remains.retain(|share| !share.is_over());
        remains.is_empty()
    });
    Ok(())
}

/// Answers someone who does not bring a run.
fn answer(options: &DaemonOptions, opening: &Opening, mut visitor: Visitor, serves: Option<(u64, u32)>) {
    let said = match opening {
        Opening::Status => Answer::Status(HostStatus {
            version: metamorph_text::version::version().to_owned(),
            build: options.build,
            most: options.most,
            serves,
            leftovers: leftovers().map_or(0, |runs| runs as u32),
        }),
        Opening::Clean => Answer::Cleaned(match clean() {
            Ok(done) => done.to_string(),
            Err(e) => format!("not all could be removed: {e}"),
        }),
        Opening::Serve(_) => Answer::Refused("it serves another run".to_owned()),
        // Of a run that is over.
        Opening::Join { .. } => return,
        Opening::Resume(_) => Answer::Refused("it does not serve that run any more".to_owned()),
    };
    if let Err(e) = visitor.answer(said) {
        tracing::debug!("an answer cannot be given: {e}");
    }
}

/// Serves one run to its end, and returns how it ended.
fn serve(
    options: &DaemonOptions,
    assignment: &Assignment,
    mut visitor: Visitor,
    gate: &Gate,
    remains: &mut Vec<Remains>,
) -> Result<Ending, SwarmError> {
    // Logs of several hosts may come together.
    let run = swarm_file::run_of(&assignment.swarm).unwrap_or_default().shown();
    let _named = tracing::error_span!("host", run, host = %assignment.host).entered();
    let mut prepared = prepare(options, assignment, gate);
    let said = match &prepared {
        Ok(share) => Answer::Ready(share.dir.root().to_owned(), options.most),
        Err(why) => Answer::Refused(why.clone()),
    };
    if let Ok(share) = &mut prepared {
        // Before the answer: from then on the controller is heard here.
        share.connect_lines().map_err(SwarmError::Supervisor)?;
    }
    visitor.answer(said).map_err(SwarmError::Supervisor)?;
    let Ok(mut share) = prepared else { return Ok(Ending::Refused) };
    let metrics = options.metrics.as_ref();
    metrics.into_iter().for_each(|metrics| metrics.begin(&run, assignment.host, Some(share.dir.root())));
    match visitor {
        Visitor::Unix(stream) => {
            let attached = share.node.attach(HostId::CONTROLLER, Connection::Unix(stream));
            attached.map_err(SwarmError::Supervisor)?;
        }
        #[cfg(feature = "hosts")]
        Visitor::Net(_) => {}
    }
    let ended = share.run(remains);
    // Agents first: a host that says goodbye has none left.
    let Share { supervisor, mut node, transport, mut counters, dir, .. } = share;
    drop(supervisor);
    node.close();
    let account = AgentCounters { closed: false, ..node.account() };
    drop((node, transport));
    if let Some(metrics) = metrics {
        metrics.settle();
        metrics.end(None);
    }
    if ended.as_ref().is_ok_and(|ended| !ended.leaves_counts()) {
        drop(dir);
    } else {
        counters.write(&account)?;
        remains.push(Remains::new(dir, Duration::from_nanos(assignment.silent_and_fence.1.0)));
    }
    ended
}

/// Checks an assignment and creates what serving it needs. The error is for people at the controller.
fn prepare<'a>(
    options: &'a DaemonOptions,
    assignment: &'a Assignment,
    gate: &'a Gate,
) -> Result<Share<'a>, String> {
    let Assignment { host, hosts, count, family, swarm, clock, .. } = assignment;
    if assignment.build != options.build {
        return Err("it runs another build of the program".to_owned());
    }
    let Some((program, args)) = (options.agents)(family) else {
        return Err(format!("it has no agents of the family `{family}`"));
    };
    let modules = hosts.modules(*host).count();
    let has_addresses = assignment.addresses.len() + 1 == hosts.len();
    // One that has come back may have no module yet.
    if *host == HostId::CONTROLLER || !has_addresses {
        return Err("the assignment contradicts itself".to_owned());
    }
    if options.identity.as_ref().is_some_and(|(own, _)| own != host) {
        return Err(format!("it is not {host}"));
    }
    if modules > options.most as usize {
        return Err(format!(
            "it has room for {} modules, and {modules} are at home there; `--most` and the hard limit of open files (ulimit -Hn) bound it",
            options.most
        ));
    }
    gate.prepare(*host, &assignment.addresses).map_err(|e| e.to_string())?;
    let is_away = assignment.addresses.iter().any(|address| matches!(address, Address::Net { .. }));
    let share = || -> Result<Share<'a>, SwarmError> {
        set_verbosity(assignment.verbose);
        if let Err(e) = clean() {
            tracing::warn!("what earlier runs left behind could not be removed: {e}");
        }
        let dir = RunDir::create()?;
        let mut reserve = Reserve::take(dir.root(), modules as u64)?;
        let written = match swarm_file::keeps_journal(swarm) && is_away {
            true => Some(Written::create(dir.root()).map_err(SwarmError::Clock)?),
            false => None,
        };
        let swarm = swarm_file::for_daemon(swarm, written.as_ref().map(Written::directory));
        let swarm = swarm_file::with_homes(&swarm, hosts);
        std::fs::write(swarm_file::path(dir.root()), swarm).map_err(SwarmError::Clock)?;
        let follower = if is_away {
            Some(Follower::create(dir.root(), assignment.clock_error).map_err(SwarmError::Clock)?)
        } else {
            // Hosts of one machine share the controller's clock page.
            symlink(clock, page::path(dir.root())).map_err(SwarmError::Clock)?;
            None
        };
        acquire_lease(&dir, GENERATION)?;
        reserve.release_own();
        let root = dir.root().to_owned();
        let (verbose, oom_kills) = (assignment.verbose, oom_kills());
        let launch = Launch { program, args, root, generation: GENERATION, verbose, oom_kills };
        let (transport, supervisor) = attach(launch, &options.shutdown, &dir, *count as usize, true)?;
        let node = Node::new(assignment, dir.root(), GENERATION).map_err(SwarmError::Clock)?;
        let counters = CounterFile::create(dir.root(), OWN_COUNTERS.0, OWN_COUNTERS.1)?;
        Ok(Share {
            options,
            assignment,
            gate,
            follower,
            written,
            sent: Stopwatch::start(),
            supervisor,
            node,
            transport,
            reserve,
            counters,
            dialled: None,
            watch: ControllerWatch::new(assignment, is_away),
            conversations: Conversations::default(),
            starting: modules,
            draining: false,
            leased: None,
            dir,
        })
    };
    share().map_err(|e| e.to_string())
}

/// One host's share of a run.
struct Share<'a> {
    options: &'a DaemonOptions,
    assignment: &'a Assignment,
    gate: &'a Gate,
    /// The clock page, if the controller's is on another machine.
    follower: Option<Follower>,
    /// The agents' parts of the journal, if the controller's are on another machine.
    written: Option<Written>,
    /// When they were last sent.
    sent: Stopwatch,
    // Dropped in this order: agents are ended, links are closed, then their transport; the directory is last.
    supervisor: Supervisor,
    node: Node<IceoryxLink>,
    transport: IceoryxTransport,
    reserve: Reserve,
    /// The counts of this host itself, for the controller if this process is killed.
    counters: CounterFile,
    /// When other hosts were last dialled.
    dialled: Option<Stopwatch>,
    watch: ControllerWatch,
    conversations: Conversations,
    /// Number of agents that have not been started yet.
    starting: usize,
    /// True from the request to report that nothing is under way until that is so.
    draining: bool,
    /// When the lease of its agents was last renewed.
    leased: Option<Stopwatch>,
    dir: RunDir,
}

impl Share<'_> {
    /// Serves until the share is over. Meanwhile `remains` of earlier shares are removed when they are not wanted any more.
    fn run(&mut self, remains: &mut Vec<Remains>) -> Result<Ending, SwarmError> {
        loop {
            if self.options.shutdown.urgency() > Urgency::None {
                return Ok(Ending::Asked);
            }
            match self.watch.look(self.node.is_up(HostId::CONTROLLER)) {
                Absence::Final => return Ok(Ending::Orphaned),
                Absence::Unknown if self.node.has_to_stop() => return Ok(Ending::Alone),
                Absence::Unknown | Absence::Awaited => {}
            }
            self.renew_lease().map_err(SwarmError::Supervisor)?;
            remains.retain(|share| !share.is_over());
            while let Ok((opening, visitor)) = self.gate.incoming.try_recv() {
                self.connect(opening, visitor);
            }
            self.dial();
            self.follow_clock()?;
            let heard = self.take_events()? + self.drain()?;
            self.node.turn(&mut self.transport);
            if let Some(metrics) = &self.options.metrics {
                metrics.note_links(|| (self.node.peers(), self.conversations.count() as u64));
            }
            while let Some((host, state)) = self.node.next_change() {
                tracing::info!("the link to {host} is {state:?}");
                if (host, state) == (HostId::CONTROLLER, State::Closed) {
                    return Ok(Ending::Finished);
                }
            }
            self.obey()?;
            self.follow_clock()?;
            let node = &mut self.node;
            let mut told = Vec::new();
            node.residents.catch_up(&mut self.transport, |agent, count| told.push((agent, count)));
            for (agent, count) in told {
                node.tell(HostId::CONTROLLER, &ToController::Taken(agent, count));
            }
            node.residents.flush();
            let is_due = self.draining || self.sent.elapsed() > WAIT_MAX;
            let is_sent = self.written.as_mut().filter(|_| is_due).is_none_or(|written| {
                self.sent = Stopwatch::start();
                written.send(|stretch| node.tell_in_bulk(HostId::CONTROLLER, &stretch))
                    && node.is_bulk_through(HostId::CONTROLLER)
            });
            if self.draining && heard == 0 && node.is_drained() && is_sent {
                self.draining = false;
                node.tell(HostId::CONTROLLER, &ToController::Drained);
            }
            // Before the packets of this turn are sent: what others receive has been counted.
            let account = AgentCounters { closed: false, ..node.account() };
            self.counters.write(&account)?;
            node.turn(&mut self.transport);
            let is_behind = node.residents.is_behind() || node.is_behind(HostId::CONTROLLER) || self.draining;
            let longest = if is_behind { RETRY_WAIT_MAX } else { WAIT_MAX };
            let due = self.follower.as_ref().and_then(Follower::due);
            let due = due.map_or(longest, |due| Duration::from_nanos(due.saturating_sub(monotonic())));
            // A clock that stands still is not looked at all the time.
            let wait = node.wait().min(longest).min(due.max(CLOCK_WAIT_MIN));
            if heard < DRAIN && !wait.is_zero() {
                self.transport.wait(wait)?;
            }
        }
    }

    /// Takes a connection of another host of this run. A further run is refused.
    fn connect(&mut self, opening: Opening, visitor: Visitor) {
        let Assignment { run, secret, host, .. } = self.assignment;
        match (opening, visitor) {
            (Opening::Resume(resuming), visitor)
                if (resuming.run, resuming.secret, resuming.host) == (*run, *secret, *host) =>
            {
                if let Err(e) = self.turn_to(&resuming, visitor) {
                    tracing::warn!("the controller that takes over cannot be reached: {e}");
                }
            }
            (Opening::Join { run, from }, Visitor::Unix(stream))
                if run == self.assignment.run
                    && from < self.assignment.host
                    && from != HostId::CONTROLLER =>
            {
                if let Err(e) = self.node.attach(from, Connection::Unix(stream)) {
                    tracing::warn!("the connection of {from} cannot be used: {e}");
                }
            }
            (opening, visitor) => {
                let modules = self.node.hosts().modules(self.assignment.host).count();
                answer(self.options, &opening, visitor, Some((self.assignment.run, modules as u32)));
            }
        }
    }

    /// Turns to a controller that has taken over. Agents that it does not know of are ended.
    fn turn_to(&mut self, resuming: &Resuming, mut visitor: Visitor) -> io::Result<()> {
        tracing::info!("another controller has taken over");
        if self.is_away() {
            self.node.keep_lease();
        }
        self.node.renew(self.assignment, HostId::CONTROLLER);
        self.watch.forget();
        self.draining = false;
        self.follower.iter_mut().for_each(Follower::forget);
        if let Some(written) = &mut self.written {
            written.turn_to(&resuming.collected);
        }
        let unwanted = self.conversations.take_over(&resuming.agents);
        unwanted.into_iter().for_each(|agent| self.supervisor.signal(agent, Signal::KILL));
        let counters =
            |agent| (agent, self.supervisor.counters(agent).map(|c| c.map(|c| Box::new(c.into()))));
        let said = Answer::Resumed {
            present: self.conversations.present(&resuming.agents),
            latest: self.conversations.latest(),
            ended: self.conversations.ended().map(counters).collect(),
            time: self.node.promised(),
        };
        if let Some(line) = self.gate.line(self.assignment.run, HostId::CONTROLLER)? {
            // Before the answer: from then on the controller is heard here.
            self.node.attach(HostId::CONTROLLER, line)?;
        }
        visitor.answer(said)?;
        match visitor {
            Visitor::Unix(stream) => self.node.attach(HostId::CONTROLLER, Connection::Unix(stream)),
            #[cfg(feature = "hosts")]
            Visitor::Net(_) => Ok(()),
        }
    }

    /// Takes lines to all other hosts into use that need not be dialled.
    fn connect_lines(&mut self) -> io::Result<()> {
        for host in self.node.unconnected().collect::<Vec<_>>() {
            if let Some(line) = self.gate.line(self.assignment.run, host)? {
                self.node.attach(host, line)?;
            }
        }
        Ok(())
    }

    /// Connects to hosts of higher number on this machine.
    fn dial(&mut self) {
        if self.dialled.is_some_and(|last| last.elapsed() < WAIT_MAX) {
            return;
        }
        self.dialled = Some(Stopwatch::start());
        let Assignment { host: own, run, addresses, .. } = self.assignment;
        for host in self.node.unconnected().filter(|host| host > own).collect::<Vec<_>>() {
            let Some(Address::Unix(socket)) = addresses.get(host.index() - 1) else { continue };
            let connected = UnixStream::connect(socket).and_then(|mut stream| {
                write_opening(&mut stream, &Opening::Join { run: *run, from: *own })?;
                self.node.attach(host, Connection::Unix(stream))
            });
            if let Err(e) = connected {
                tracing::debug!("{host} cannot be reached: {e}");
            }
        }
    }

    /// Lets the agents act for another fence, so that they end by then if this daemon is frozen.
    fn renew_lease(&mut self) -> io::Result<()> {
        let fence = self.assignment.silent_and_fence.1;
        let is_fresh = |last: Stopwatch| last.elapsed() < Duration::from_nanos(fence.0 / LEASES);
        if self.leased.is_some_and(is_fresh) {
            return Ok(());
        }
        self.leased = Some(Stopwatch::start());
        share_lease::renew(self.dir.root(), monotonic().saturating_add(fence.0))
    }

    /// Goes on with the clock page of this host.
    fn follow_clock(&mut self) -> Result<(), SwarmError> {
        let Some(follower) = &mut self.follower else { return Ok(()) };
        let change = follower.go_on(monotonic(), self.node.clock_of(HostId::CONTROLLER));
        if let Some(still) = change.map_err(SwarmError::Clock)? {
            self.node.tell(HostId::CONTROLLER, &ToController::Still(still));
        }
        Ok(())
    }

    /// Passes on what the supervisor reports. Returns the number of events.
    fn take_events(&mut self) -> Result<usize, SwarmError> {
        let mut count = 0;
        while let Some(event) = self.supervisor.event()? {
            count += 1;
            let message = match event {
                // A daemon has agents of its own host only.
                Event::Shutdown(_) | Event::HostLost { .. } | Event::HostBack(..) => continue,
                Event::SpawnFailed(agent, e) => {
                    self.node.residents.leave(agent);
                    if !self.conversations.end(agent) {
                        continue;
                    }
                    ToController::SpawnFailed(agent, e.to_string())
                }
                Event::Stopped(agent, signal) => ToController::Stopped(agent, signal),
                Event::Continued(agent) => ToController::Continued(agent),
                Event::Exited { agent, how, signal, of_machine, stderr_tail } => {
                    // Frames that it sent before its end go before the report of its end.
                    for _ in 0..DRAIN {
                        if !self.drain_once()? {
                            break;
                        }
                    }
                    self.node.residents.leave(agent);
                    if !self.conversations.end(agent) {
                        self.supervisor.reap(agent);
                        continue;
                    }
                    let counters =
                        self.supervisor.counters(agent).map(|c| c.map(|c| Box::new(Account::from(c))));
                    ToController::Exited { agent, how, signal, of_machine, stderr_tail, counters }
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
        if !self.node.forward(&mut self.transport, &shared) && self.conversations.hear(&shared.frame()) {
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
                    self.written.iter_mut().for_each(|written| written.begin(agent));
                    self.node.residents.arrive(agent);
                    self.conversations.begin(agent);
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
                    let answer = frame.and_then(|frame| self.conversations.tell(agent, &frame));
                    if let Some(here) = &answer {
                        // Messages of the agent to the previous controller are read from its journal.
                        let written = self.written.as_mut().map(|written| written.since_takeover(agent));
                        for stretch in written.into_iter().flatten() {
                            self.node.tell(HostId::CONTROLLER, &ToController::Journal(stretch));
                        }
                        self.node.tell(HostId::CONTROLLER, &ToController::Frame(Sent::new(here)));
                    }
                    let frame = frame.filter(|_| answer.is_none());
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
                ToDaemon::Clock(bytes) => {
                    let page = bytes.as_slice().try_into().ok().and_then(page::Page::decode);
                    if let Some((follower, page)) = self.follower.as_mut().zip(page) {
                        follower.take(page);
                    }
                }
                ToDaemon::Lost(host) => self.node.give_up(host),
                ToDaemon::Homes(homes) => self.move_homes(homes)?,
                ToDaemon::Back(host) => {
                    self.node.renew(self.assignment, host);
                    self.connect_lines().map_err(SwarmError::Supervisor)?;
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

    /// Lets agents that start from now on find other homes of modules.
    fn move_homes(&mut self, homes: Vec<HostId>) -> Result<(), SwarmError> {
        if let Err(e) = self.node.change_homes(|hosts| hosts.set_homes(homes)) {
            tracing::warn!("the controller says where modules are, and {e}");
            return Ok(());
        }
        swarm_file::move_homes(self.dir.root(), self.node.hosts()).map_err(SwarmError::Supervisor)
    }

    /// True if hosts of the run are on other machines.
    fn is_away(&self) -> bool {
        self.follower.is_some()
    }

    fn is_ours(&self, agent: AgentKey) -> bool {
        self.node.hosts().is_home(agent.0, self.assignment.host)
    }
}
