//! The daemons of the other hosts, as the controller gets them: it starts them, or they run already, and gives each
//! its share of the swarm.

use super::messages::{Answer, Assignment, Opening, read_opening, write_opening};
use super::node::random;
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

/// The longest wait for a daemon to listen, and for its answer.
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
    #[error("{0} cannot be reached at {1}: {2}\n  fix: start `metamorph host --listen {path}` there", path = .1.display())]
    Reach(HostId, PathBuf, io::Error),
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
    /// The connections to the daemons.
    pub streams: BTreeMap<HostId, UnixStream>,
    /// The run directories of the daemons, which are on this machine.
    pub roots: BTreeMap<HostId, PathBuf>,
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
        let socket = |host: HostId| dir.root().join(format!("{host}.sock"));
        // Invariant: there are fewer than 2^16 hosts.
        let others: Vec<HostId> = (1..hosts.len() as u16).map(HostId).collect();
        let given = &options.hosts.sockets;
        let sockets =
            if given.is_empty() { others.iter().map(|host| socket(*host)).collect() } else { given.clone() };
        let timing = options.hosts.timing;
        let own = Assignment {
            run: random().map_err(FleetError::Prepare)?,
            secret: [random().map_err(FleetError::Prepare)?, random().map_err(FleetError::Prepare)?],
            build: options.hosts.build,
            host: HostId::CONTROLLER,
            hosts: Arc::clone(hosts),
            // Invariant: a swarm has at most 16,000 modules.
            count: count as u32,
            sockets,
            family: options.hosts.family.clone(),
            swarm: std::fs::read(swarm_file::path(dir.root())).map_err(FleetError::Prepare)?,
            clock: page::path(dir.root()),
            silent_and_fence: (timing.silent, timing.fence),
            verbose: options.verbose,
        };
        let mut fleet = Fleet { own, streams: BTreeMap::new(), roots: BTreeMap::new(), started: Vec::new() };
        if given.is_empty() {
            for (host, socket) in others.iter().zip(fleet.own.sockets.clone()) {
                let child = start(&options.program, &socket).map_err(|e| FleetError::Start(*host, e))?;
                fleet.started.push(child);
            }
        }
        for (host, socket) in others.into_iter().zip(fleet.own.sockets.clone()) {
            fleet.enlist(host, &socket)?;
        }
        Ok(fleet)
    }

    /// Gives one daemon its share.
    fn enlist(&mut self, host: HostId, socket: &Path) -> Result<(), FleetError> {
        let unreachable = |e| FleetError::Reach(host, socket.to_owned(), e);
        let mut stream = self.connect(socket).map_err(unreachable)?;
        let assignment = Assignment { host, ..self.own.clone() };
        stream.set_read_timeout(Some(STARTING)).map_err(unreachable)?;
        write_opening(&mut stream, &Opening::Serve(Box::new(assignment))).map_err(unreachable)?;
        match read_opening(&mut stream).map_err(unreachable)? {
            Answer::Ready(root) => {
                self.roots.insert(host, root);
                self.streams.insert(host, stream);
                Ok(())
            }
            Answer::Refused(why) => Err(FleetError::Refused(host, why)),
        }
    }

    /// Connects to a daemon. One that was just started takes a moment to listen.
    fn connect(&mut self, socket: &Path) -> io::Result<UnixStream> {
        let mut connected = UnixStream::connect(socket);
        let limit = if self.started.is_empty() { Duration::ZERO } else { STARTING };
        wait_until(limit, || {
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
