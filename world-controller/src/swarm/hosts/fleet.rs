//! The daemons of the other hosts, as the controller gets them: it starts them, or they run already, and gives each
//! its share of the swarm.

use super::HostsOptions;
use super::address::Address;
use super::connection::Connection;
use super::messages::{Answer, Assignment, Opening, Resuming};
use super::node::random;
use super::reach::{Reach, ReachError};
use super::succession::Succession;
use crate::console::stopwatch::{Stopwatch, wait_until};
use crate::swarm::SwarmOptions;
use crate::swarm::launcher::Found;
use crate::swarm::run_dir::RunDir;
use metamorph_module_agent::clock::page;
use metamorph_module_agent::run_dir::run_name::RunName;
use metamorph_module_agent::run_dir::swarm_file;
use metamorph_module_agent::transport::AgentKey;
use metamorph_protocol::ids::HostId;
use metamorph_protocol::link::Hosts;
use metamorph_protocol::time::Span;
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::time::Duration;
use thiserror::Error;

/// The longest wait for a daemon to listen.
const STARTING: Duration = Duration::from_secs(30);
/// The longest wait for a daemon to end before it is killed.
const ENDING: Duration = Duration::from_secs(10);

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
    /// The daemons belong to another build than the controller that takes over.
    #[error(
        "the run was begun by another build of the program\n  fix: resume it with the program that began it"
    )]
    OtherBuild,
    /// A run between machines cannot be resumed.
    #[error(
        "the run has a host on another machine ({0}), which cannot tell a controller that was killed from one that is cut off\n  fix: end what is left with `metamorph clean --hosts FILE`, and run the scenario again"
    )]
    Away(Address),
    /// Something of this host is missing.
    #[error("the run on several hosts cannot be prepared: {0}")]
    Prepare(io::Error),
}

/// The daemons of a run.
#[derive(Debug)]
pub struct Fleet {
    /// What the controller's own host works with.
    pub own: Assignment,
    /// The way to the daemons.
    pub reach: Reach,
    /// The connections to daemons on this machine.
    streams: BTreeMap<HostId, UnixStream>,
    /// The run directories of the daemons; `None` on other machines.
    pub roots: BTreeMap<HostId, Option<PathBuf>>,
    started: Vec<Child>,
    /// True if the daemons were started for this run by an earlier controller.
    are_inherited: bool,
}

/// The daemons of a run that another controller has begun.
#[derive(Debug)]
pub struct Inherited {
    /// The daemons.
    pub fleet: Fleet,
    /// Their agents.
    pub found: Found,
    /// Hosts that have gone meanwhile, and why.
    pub lost: Vec<(HostId, String)>,
}

impl Fleet {
    /// Turns the daemons of the run in `root` to this controller, after the one before has died. Agents that are not
    /// `wanted` are ended.
    ///
    /// # Errors
    /// If nothing is known of the daemons.
    pub fn take_over(root: &Path, wanted: &BTreeSet<AgentKey>) -> Result<Inherited, FleetError> {
        let missing = || io::Error::other("its hosts are not known");
        let succession = Succession::read(root).and_then(|read| read.ok_or_else(missing));
        let Succession { own, roots, are_ours } = succession.map_err(FleetError::Prepare)?;
        let reach = Reach::new(&own.addresses, None, own.build)?;
        let (streams, started) = (BTreeMap::new(), Vec::new());
        let fleet = Fleet { own, reach, streams, roots, started, are_inherited: are_ours };
        let mut inherited = Inherited { fleet, found: Found::default(), lost: Vec::new() };
        for host in inherited.fleet.roots.keys().copied().collect::<Vec<_>>() {
            if let Err(e) = inherited.call(host, wanted) {
                inherited.lost.push((host, e.to_string()));
            }
        }
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
        let reach = Reach::new(&addresses, keys.as_deref(), *build)?;
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
        let (streams, roots, started) = (BTreeMap::new(), BTreeMap::new(), Vec::new());
        let mut fleet = Fleet { own, reach, streams, roots, started, are_inherited: false };
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
        let (own, roots) = (fleet.own.clone(), fleet.roots.clone());
        let succession = Succession { own, roots, are_ours: given.is_empty() };
        succession.write(dir.root()).map_err(FleetError::Prepare)?;
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
            address => self.reach.ask(host, address, &opening, Duration::ZERO)?,
        };
        match reached.answer {
            Answer::Ready(root) => {
                let is_here = reached.stream.is_some();
                self.roots.insert(host, is_here.then_some(root));
                self.streams.extend(reached.stream.map(|stream| (host, stream)));
                Ok(())
            }
            Answer::Refused(why) => Err(FleetError::Refused(host, why)),
            _ => Err(FleetError::Refused(host, "it answers something else".to_owned())),
        }
    }

    /// Returns the connections of the run, each once.
    ///
    /// # Errors
    /// If a session has ended.
    pub fn connections(&mut self) -> io::Result<Vec<(HostId, Connection)>> {
        let mut streams = std::mem::take(&mut self.streams);
        // A daemon that is gone when the run is resumed has none.
        let is_there =
            |(host, root): &(&HostId, &Option<PathBuf>)| root.is_none() || streams.contains_key(host);
        let there: Vec<HostId> = self.roots.iter().filter(is_there).map(|(host, _)| *host).collect();
        let connect = |host: &HostId| {
            let connection = self.reach.connection(self.own.run, *host, streams.remove(host))?;
            Ok((*host, connection))
        };
        there.iter().map(connect).collect()
    }

    /// Returns true if a host has a clock of its own.
    pub fn is_away(&self, host: HostId) -> bool {
        self.roots.get(&host).is_some_and(Option::is_none)
    }

    /// Connects to a daemon that was just started, which takes a moment to listen.
    fn connect(&mut self, socket: &Path) -> io::Result<UnixStream> {
        let mut connected = UnixStream::connect(socket);
        wait_until(STARTING, || {
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
        .args(["host", "--once", "--listen"])
        .arg(socket)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        // Ctrl-C reaches only the controller.
        .process_group(0)
        .spawn()
}

impl Inherited {
    /// Calls a daemon.
    fn call(&mut self, host: HostId, wanted: &BTreeSet<AgentKey>) -> Result<(), FleetError> {
        let Fleet { own, reach, streams, .. } = &mut self.fleet;
        let is_there = |(id, _): &&AgentKey| own.hosts.is_home(*id, host);
        let agents = wanted.iter().filter(is_there).copied().collect();
        let opening = Opening::Resume(Box::new(Resuming { run: own.run, secret: own.secret, host, agents }));
        // Invariant: each host but the controller's has an address.
        let Some(address) = own.addresses.get(host.index() - 1) else { return Ok(()) };
        let reached = reach.ask(host, address, &opening, Duration::ZERO)?;
        match reached.answer {
            Answer::Resumed { present, latest } => {
                streams.extend(reached.stream.map(|stream| (host, stream)));
                self.found.present.extend(present.into_iter().map(|agent| (agent, true)));
                self.found.latest.extend(latest);
                Ok(())
            }
            Answer::Refused(why) => Err(FleetError::Refused(host, why)),
            _ => Err(FleetError::Refused(host, "it answers something else".to_owned())),
        }
    }
}

impl Drop for Fleet {
    fn drop(&mut self) {
        self.streams.clear();
        if self.are_inherited {
            // They are no children of this process.
            let roots = || self.roots.values().flatten();
            wait_until(ENDING, || roots().all(|root| !root.is_dir()));
        }
        let begun = Stopwatch::start();
        let mut killed = false;
        for child in &mut self.started {
            let left = ENDING.saturating_sub(begun.elapsed());
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
