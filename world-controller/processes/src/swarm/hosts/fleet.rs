//! The daemons of the other hosts, as the controller gets them: it starts them, or they run already, and gives each
//! its share of the swarm.

use super::HostsOptions;
use super::address::Address;
use super::connection::Connection;
use super::messages::{Answer, Assignment, CountersOfAgent, Opening, Resuming};
use super::node::random;
use super::parts::Collected;
use super::reach::{MEETING, Reach, ReachError, Reached};
use super::succession::Succession;
use crate::swarm::SwarmOptions;
use crate::swarm::launcher::Found;
use crate::swarm::run_dir::RunDir;
use metamorph_console::stopwatch::{Stopwatch, wait_until};
use metamorph_module_agent::clock::page;
use metamorph_module_agent::run_dir::counter_file::AgentCounters;
use metamorph_module_agent::run_dir::run_name::RunName;
use metamorph_module_agent::run_dir::swarm_file;
use metamorph_module_agent::transport::AgentKey;
use metamorph_protocol::ids::HostId;
use metamorph_protocol::link::Hosts;
use metamorph_protocol::time::{Span, Time};
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;

/// Longest time to wait for a daemon to listen.
const START_WAIT_MAX: Duration = Duration::from_secs(30);
/// Longest time to wait for a daemon to end before it is killed.
const END_WAIT_MAX: Duration = Duration::from_secs(10);

/// The reason why the daemons of a run are not to be had.
#[derive(Debug, Error)]
pub enum FleetError {
    /// A daemon cannot be started.
    #[error("the daemon of {0} cannot be started: {1}")]
    Start(HostId, io::Error),
    /// A daemon cannot be reached.
    #[error(transparent)]
    Reach(#[from] ReachError),
    /// A daemon does not serve the run.
    #[error("{0} does not serve this run: {1}")]
    Refused(HostId, String),
    /// The clock of a host is not known well enough for it to follow the clock of the run.
    #[error(
        "the clock of {host} is known {}, and `clock_error` is {bound}\n  fix: write a larger `clock_error` in the hosts file, at least the time that a packet takes to {host}, and lower `time_scale` if the scenario is then refused",
        .known.map_or("not at all".to_owned(), |known| format!("to {known} only"))
    )]
    Clock {
        /// The host.
        host: HostId,
        /// By how much its clock may be off; `None` if that is not known.
        known: Option<Span>,
        /// The most by which it may be off.
        bound: Span,
    },
    /// The daemons belong to another build than the controller that takes over.
    #[error(
        "the run was begun by another build of the program\n  fix: resume it with the program that began it"
    )]
    OtherBuild,
    /// The hosts file of another machine names other hosts than the run has.
    #[error("the run has {run} hosts, and the hosts file names {file}\n  fix: name the hosts of the run")]
    OtherHosts {
        /// Number of hosts of the run.
        run: usize,
        /// Number of hosts in the file.
        file: usize,
    },
    /// Something of this host is missing.
    #[error("the run on several hosts cannot be prepared: {0}")]
    Prepare(io::Error),
}

/// The daemons of a run.
#[derive(Debug)]
pub struct Fleet {
    /// Assignment of the controller's own host.
    pub own: Assignment,
    /// The way to the daemons.
    pub reach: Arc<Reach>,
    /// The connections to daemons on this machine.
    streams: BTreeMap<HostId, UnixStream>,
    /// The run directories of the daemons; `None` on other machines.
    pub roots: BTreeMap<HostId, Option<PathBuf>>,
    /// The most modules that each daemon takes.
    pub rooms: BTreeMap<HostId, usize>,
    started: Vec<Child>,
    /// True if the daemons were started for this run by an earlier controller.
    are_inherited: bool,
    /// Hosts on other machines that did not answer the call of this controller. Their agents may act until they have not
    /// heard a controller for long enough.
    unanswered: BTreeSet<HostId>,
}

/// The daemons of a run that another controller has begun.
#[derive(Debug)]
pub struct Inherited {
    /// The daemons.
    pub fleet: Fleet,
    /// Their agents.
    pub found: Found,
    /// The counters of their agents that have ended.
    pub ended: BTreeMap<AgentKey, Result<Option<AgentCounters>, String>>,
    /// Hosts that have gone meanwhile, and why.
    pub lost: Vec<(HostId, String)>,
    /// When they had been called.
    pub since: Stopwatch,
    /// The latest scenario time that a host shows.
    pub time: Time,
    /// True if the controller before was on another machine, which is lost.
    pub has_moved: bool,
}

impl Fleet {
    /// Turns the daemons of the run in `root` to this controller, after the one before has died. Agents that are not
    /// `wanted` are ended. `parts` is the directory of the journal.
    ///
    /// # Errors
    /// If nothing is known of the daemons.
    pub fn take_over(
        root: &Path,
        wanted: &BTreeSet<AgentKey>,
        parts: Option<&Path>,
    ) -> Result<Inherited, FleetError> {
        let missing = || io::Error::other("its hosts are not known");
        let succession = Succession::read(root).and_then(|read| read.ok_or_else(missing));
        let Succession { own, roots, rooms, are_ours, keys } = succession.map_err(FleetError::Prepare)?;
        let reach = Arc::new(Reach::new(&own.addresses, keys.as_deref(), own.build)?);
        let (streams, started) = (BTreeMap::new(), Vec::new());
        let unanswered = BTreeSet::new();
        let fleet = Fleet { own, reach, streams, roots, rooms, started, are_inherited: are_ours, unanswered };
        let collected = match fleet.away().next().and(parts) {
            Some(parts) => Collected::lengths(parts).map_err(FleetError::Prepare)?,
            None => BTreeMap::new(),
        };
        let mut inherited = Inherited::new(fleet);
        // At once, since each acts for a limited time without a controller.
        let answers: Vec<_> = std::thread::scope(|scope| {
            let (fleet, collected) = (&inherited.fleet, &collected);
            let call = |host| (host, scope.spawn(move || fleet.call(host, wanted, collected)));
            let calls: Vec<_> = fleet.roots.keys().copied().map(call).collect();
            let panicked = |_| Err(FleetError::Prepare(io::Error::other("a call has panicked")));
            calls.into_iter().map(|(host, call)| (host, call.join().unwrap_or_else(panicked))).collect()
        });
        inherited.since = Stopwatch::start();
        answers.into_iter().for_each(|(host, answer)| inherited.take(host, answer, wanted));
        Ok(inherited)
    }

    /// Gives each daemon its share of the swarm in `dir`, and starts the daemons that do not run yet.
    ///
    /// # Errors
    /// If a daemon cannot be started or reached, or refuses.
    pub fn muster(
        options: &SwarmOptions,
        hosts: &Arc<Hosts>,
        count: usize,
        dir: &RunDir,
    ) -> Result<Fleet, FleetError> {
        let socket = |host: HostId| Address::Unix(dir.root().join(format!("{host}.sock")));
        // Invariant: there are fewer than 2^16 hosts.
        let others: Vec<HostId> = (1..hosts.len() as u16).map(HostId).collect();
        let HostsOptions { addresses: given, keys, build, timing, family, clock_error } = &options.hosts;
        let addresses =
            if given.is_empty() { others.iter().map(|host| socket(*host)).collect() } else { given.clone() };
        let reach = Arc::new(Reach::new(&addresses, keys.as_deref(), *build)?);
        let own = Assignment {
            run: random().map_err(FleetError::Prepare)?.max(1),
            secret: [random().map_err(FleetError::Prepare)?, random().map_err(FleetError::Prepare)?],
            build: *build,
            host: HostId::CONTROLLER,
            hosts: Arc::clone(hosts),
            // Invariant: a swarm has at most 16,000 modules.
            count: count as u32,
            addresses,
            family: family.clone(),
            swarm: std::fs::read(swarm_file::path(dir.root())).map_err(FleetError::Prepare)?,
            clock: page::path(dir.root()),
            clock_error: *clock_error,
            silent_and_fence: (timing.silent, timing.fence),
            patience: Span(u64::try_from(options.patience.as_nanos()).unwrap_or(u64::MAX)),
            verbose: options.verbose,
        };
        let (streams, roots, rooms, started) =
            (BTreeMap::new(), BTreeMap::new(), BTreeMap::new(), Vec::new());
        let unanswered = BTreeSet::new();
        let mut fleet =
            Fleet { own, reach, streams, roots, rooms, started, are_inherited: false, unanswered };
        if given.is_empty() {
            for (host, address) in others.iter().zip(fleet.own.addresses.clone()) {
                let Address::Unix(socket) = address else { continue };
                let child = start(&options.program, &socket).map_err(|e| FleetError::Start(*host, e))?;
                fleet.started.push(child);
            }
        }
        for (host, address) in others.into_iter().zip(fleet.own.addresses.clone()) {
            fleet.enlist(host, &address)?;
        }
        let (mut own, roots, rooms) = (fleet.own.clone(), fleet.roots.clone(), fleet.rooms.clone());
        // Another controller may be started in another directory.
        let keys = keys.as_deref().map(std::path::absolute).transpose().map_err(FleetError::Prepare)?;
        let are_ours = given.is_empty();
        if let Some(parts) = options.journal.as_ref().filter(|_| fleet.away().next().is_some()) {
            // For a controller on another machine, whose directory of keys is another one.
            let (own, roots, rooms) = (own.clone(), roots.clone(), rooms.clone());
            let succession = Succession { own, roots, rooms, are_ours, keys: None };
            succession.write(&parts.dir).map_err(FleetError::Prepare)?;
        }
        // The swarm file lies beside it.
        own.swarm.clear();
        Succession { own, roots, rooms, are_ours, keys }.write(dir.root()).map_err(FleetError::Prepare)?;
        Ok(fleet)
    }

    /// Gives one daemon its share.
    fn enlist(&mut self, host: HostId, address: &Address) -> Result<(), FleetError> {
        let opening = Opening::Serve(Box::new(Assignment { host, ..self.own.clone() }));
        let reached = match address {
            Address::Unix(path) if !self.started.is_empty() => {
                let failed = |e| ReachError::Socket(host, path.clone(), e);
                let stream = self.connect(path).map_err(failed)?;
                Reach::ask_on(stream, &opening).map_err(failed)?
            }
            address => self.reach.ask(host, address, &opening, Duration::ZERO, MEETING)?,
        };
        match reached.answer {
            Answer::Ready(root, most) => {
                self.rooms.insert(host, most as usize);
                let is_here = reached.stream.is_some();
                self.roots.insert(host, is_here.then_some(root));
                self.streams.extend(reached.stream.map(|stream| (host, stream)));
                Ok(())
            }
            Answer::Refused(why) => Err(FleetError::Refused(host, why)),
            _ => Err(FleetError::Refused(host, "it answers something else".to_owned())),
        }
    }

    /// Calls a daemon.
    fn call(
        &self,
        host: HostId,
        wanted: &BTreeSet<AgentKey>,
        collected: &BTreeMap<AgentKey, u64>,
    ) -> Result<Reached, FleetError> {
        let Assignment { hosts, run, secret, addresses, silent_and_fence, .. } = &self.own;
        let is_there = |(id, _): &&AgentKey| hosts.is_home(*id, host);
        let opening = Opening::Resume(Box::new(Resuming {
            run: *run,
            secret: *secret,
            host,
            agents: wanted.iter().filter(is_there).copied().collect(),
            collected: collected.iter().filter(|(agent, _)| is_there(agent)).map(|(a, n)| (*a, *n)).collect(),
        }));
        let address = addresses.get(host.index() - 1);
        let address = address.ok_or_else(|| FleetError::Refused(host, "it has no address".to_owned()))?;
        // The others act no longer than the fence without a controller, which is not heard before all are called.
        let meeting = MEETING.min(Duration::from_nanos(silent_and_fence.1.0) / 3);
        Ok(self.reach.ask(host, address, &opening, Duration::ZERO, meeting)?)
    }

    /// Returns the address and the opening by which the daemon of a lost host is asked to serve the run again, in its present
    /// state; `None` if the daemons end with the run.
    pub fn calls_back(&self, host: HostId, hosts: &Hosts) -> Option<(&Address, Opening)> {
        if self.are_inherited || !self.started.is_empty() {
            return None;
        }
        let address = self.own.addresses.get(host.index().checked_sub(1)?)?;
        let hosts = Arc::new(hosts.clone());
        Some((address, Opening::Serve(Box::new(Assignment { host, hosts, ..self.own.clone() }))))
    }

    /// Takes a daemon that serves the run again, with this answer.
    ///
    /// # Errors
    /// If its connection cannot be used.
    pub fn welcome(&mut self, host: HostId, reached: Reached) -> io::Result<Connection> {
        if let Answer::Ready(root, most) = reached.answer {
            self.rooms.insert(host, most as usize);
            self.roots.insert(host, reached.stream.is_some().then_some(root));
        }
        self.reach.connection(self.own.run, host, reached.stream)
    }

    /// Returns the connections of the run, each once.
    ///
    /// # Errors
    /// If a session has ended.
    pub fn connections(&mut self) -> io::Result<Vec<(HostId, Connection)>> {
        let mut streams = std::mem::take(&mut self.streams);
        // A daemon of this machine that is gone when the run is resumed has none.
        let is_there = |(host, root): &(&HostId, &Option<PathBuf>)| match root {
            None => !self.unanswered.contains(host),
            Some(_) => streams.contains_key(host),
        };
        let there: Vec<HostId> = self.roots.iter().filter(is_there).map(|(host, _)| *host).collect();
        let connect = |host: &HostId| {
            let connection = self.reach.connection(self.own.run, *host, streams.remove(host))?;
            Ok((*host, connection))
        };
        there.iter().map(connect).collect()
    }

    /// Iterates over the hosts on other machines.
    pub fn away(&self) -> impl Iterator<Item = HostId> {
        self.roots.iter().filter(|(_, root)| root.is_none()).map(|(host, _)| *host)
    }

    /// Connects to a daemon that was just started, which takes a moment to listen.
    fn connect(&mut self, socket: &Path) -> io::Result<UnixStream> {
        let mut connected = UnixStream::connect(socket);
        wait_until(START_WAIT_MAX, || {
            if connected.is_err() {
                connected = UnixStream::connect(socket);
            }
            let ended = self.started.iter_mut().find_map(|child| child.try_wait().transpose());
            match ended.filter(|_| connected.is_err()) {
                None => connected.is_ok(),
                Some(status) => {
                    let why = status.map_or_else(|e| e.to_string(), |s| format!("the daemon ended with {s}"));
                    connected = Err(io::Error::other(why));
                    true
                }
            }
        });
        connected
    }
}

fn start(program: &Path, socket: &Path) -> io::Result<Child> {
    // iceoryx2 does not mark its files to be closed on exec.
    close_fds::set_fds_cloexec_threadsafe(3, &[]);
    Command::new(program)
        .args(metamorph_text::program::again(["host", "--once", "--listen"].map(Into::into)))
        .arg(socket)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        // Ctrl-C reaches only the controller.
        .process_group(0)
        .spawn()
}

impl Inherited {
    /// Wraps the daemons of a run that begins.
    pub fn new(fleet: Fleet) -> Inherited {
        let (found, ended) = (Found::default(), BTreeMap::new());
        let (since, time) = (Stopwatch::start(), Time::ZERO);
        Inherited { fleet, found, ended, lost: Vec::new(), since, time, has_moved: false }
    }

    /// Takes the answer of a daemon.
    fn take(&mut self, host: HostId, answer: Result<Reached, FleetError>, wanted: &BTreeSet<AgentKey>) {
        let why = match answer {
            Ok(Reached { answer: Answer::Resumed { present, latest, ended, time }, stream, .. }) => {
                self.fleet.streams.extend(stream.map(|stream| (host, stream)));
                self.found.present.extend(present.into_iter().map(|agent| (agent, true)));
                self.found.latest.extend(latest);
                self.time = self.time.max(time);
                let counters = |(agent, c): (_, CountersOfAgent)| (agent, c.map(|c| c.map(|c| (*c).into())));
                return self.ended.extend(ended.into_iter().map(counters));
            }
            Ok(Reached { answer: Answer::Refused(why), .. }) => FleetError::Refused(host, why),
            Ok(_) => FleetError::Refused(host, "it answers something else".to_owned()),
            Err(e) if self.fleet.roots.get(&host).is_some_and(Option::is_none) => {
                tracing::warn!("{e}");
                self.fleet.unanswered.insert(host);
                let hosts = &self.fleet.own.hosts;
                let theirs = wanted.iter().filter(|(id, _)| hosts.is_home(*id, host));
                return self.found.present.extend(theirs.map(|agent| (*agent, false)));
            }
            Err(e) => e,
        };
        self.lost.push((host, why.to_string()));
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        self.streams.clear();
        if self.are_inherited {
            // They are no children of this process.
            let roots = || self.roots.values().flatten();
            wait_until(END_WAIT_MAX, || roots().all(|root| !root.is_dir()));
        }
        let begun = Stopwatch::start();
        let mut killed = false;
        for child in &mut self.started {
            let left = END_WAIT_MAX.saturating_sub(begun.elapsed());
            if !wait_until(left, || !matches!(child.try_wait(), Ok(None))) {
                killed = true;
                let _ = child.kill();
                let _ = child.wait();
            }
            killed |= !matches!(child.try_wait(), Ok(Some(status)) if status.success());
        }
        if killed {
            // Dropping what it has left removes it.
            let names = self.roots.values().flatten().filter_map(|root| RunName::of_root(root).ok());
            names.for_each(|name| drop(RunDir::adopt(name)));
        }
    }
}
