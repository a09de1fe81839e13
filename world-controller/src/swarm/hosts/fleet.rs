//! The daemons of the other hosts, as the controller gets them: it starts them, or they run already, and gives each
//! its share of the swarm.

use super::HostsOptions;
use super::address::Address;
use super::connection::Connection;
use super::messages::{Answer, Assignment, Opening};
use super::node::random;
use super::reach::{Reach, ReachError};
use crate::console::stopwatch::{Stopwatch, wait_until};
use crate::swarm::SwarmOptions;
use crate::swarm::run_dir::{RunDir, clean};
use metamorph_module_agent::clock::page;
use metamorph_module_agent::run_dir::swarm_file;
use metamorph_protocol::ids::HostId;
use metamorph_protocol::link::Hosts;
use std::collections::BTreeMap;
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
}

impl Fleet {
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
            verbose: options.verbose,
        };
        let (streams, roots, started) = (BTreeMap::new(), BTreeMap::new(), Vec::new());
        let mut fleet = Fleet { own, reach, streams, roots, started };
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
        let connect = |host: &HostId| {
            let connection = self.reach.connection(self.own.run, *host, streams.remove(host))?;
            Ok((*host, connection))
        };
        self.roots.keys().map(connect).collect()
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

impl Drop for Fleet {
    fn drop(&mut self) {
        self.streams.clear();
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
        if killed && let Err(e) = clean() {
            tracing::warn!("what a daemon left behind could not be removed: {e}");
        }
    }
}
