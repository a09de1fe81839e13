//! The input of a controller that takes over a swarm, besides its world and its director: the run's
//! directory, the time of its beginning, and the messages sent to each agent.

use super::hosts::{FleetError, HostsFile, Succession};
use super::process::ControlMessage;
use super::run_dir::{RunDir, RunDirError};
use metamorph_module_agent::clock::monotonic;
use metamorph_module_agent::pid_file;
use metamorph_module_agent::regular_file;
use metamorph_module_agent::run_dir::controller_lease::make_resumable;
use metamorph_module_agent::run_dir::identity::Identity;
use metamorph_module_agent::run_dir::run_name::{RunName, RunNameError};
use metamorph_module_agent::transport::AgentKey;
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::link::LinkChanges;
use metamorph_protocol::time::Time;
use rustix::fs::{FlockOperation, flock};
use std::collections::{BTreeSet, VecDeque};
use std::fs::{self, File};
use std::io;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Largest size of the file that names the run, in bytes.
const LONGEST: u64 = 1 << 10;

/// Errors of resuming a run.
#[derive(Debug, Error)]
pub enum NotResumable {
    /// The file that names the run cannot be read.
    #[error("{0}: {1}; the controller was killed before the run began, so there is nothing to go on with")]
    NotBegun(PathBuf, io::Error),
    /// The file that names the run is damaged.
    #[error("{0} is damaged: it does not name the run and the time of its beginning")]
    Damaged(PathBuf),
    /// The controller's machine is said to be lost, and is this one.
    #[error(
        "the run's directory {0} is on this machine, so the controller's machine is not lost\n  fix: leave out `--old-host-is-gone`"
    )]
    NotLost(PathBuf),
    /// The run has no hosts on other machines.
    #[error(
        "{0} holds nothing about other hosts, so all modules were lost with the controller's machine\n  fix: run the scenario again"
    )]
    NothingElsewhere(PathBuf),
    /// No agent of the run is alive.
    #[error(
        "none of the {0} agents of the run is there any more: they were killed, or had waited in vain for a controller\n  fix: run the scenario again; the journal is as it was"
    )]
    NobodyThere(usize),
    /// Another controller has taken over.
    #[error("{0} is locked: another controller has taken over the run\n  fix: wait for its end")]
    Taken(PathBuf),
    /// The hosts of the run cannot be taken over.
    #[error(transparent)]
    Hosts(#[from] FleetError),
    /// The run's directory cannot be taken over.
    #[error(transparent)]
    Dir(#[from] RunDirError),
    /// The name is not that of a run.
    #[error(transparent)]
    Name(#[from] RunNameError),
}

/// One incarnation of an agent that is taken over.
pub struct TakenOver<A: Agent> {
    /// The module.
    pub id: ModuleId,
    /// Its incarnation.
    pub incarnation: Incarnation,
    /// The place of its body when it began.
    pub place: A::Place,
    /// Number of its actions and reports that earlier controllers have taken.
    pub heard: u32,
    /// All messages that earlier controllers had for it, from its beginning on.
    pub told: VecDeque<ControlMessage<A>>,
    /// True if it was to be killed.
    pub terminating: bool,
    /// True if it was to be stopped.
    pub paused: bool,
}

/// The state of a run's agents, as recorded in its journal.
pub struct Resumption<A: Agent> {
    /// Scenario time of the last record.
    pub until: Time,
    /// Every incarnation alive then.
    pub agents: Vec<TakenOver<A>>,
    /// The latest incarnation of every module, alive or not.
    pub latest: Vec<Incarnation>,
    /// Modules that are to be restarted.
    pub restarting: BTreeSet<ModuleId>,
    /// True if the director had ended the run, so that only its agents remain to be ended.
    pub finishing: bool,
    /// Changes of the director to the links between modules.
    pub links: LinkChanges,
    /// The counts of the controller.
    pub counted: Counted,
}

/// A run whose controller is dead and that this process has taken over.
pub struct Adopted {
    pub(super) dir: RunDir,
    /// CLOCK_MONOTONIC at scenario time zero, or at the takeover if the controller before was on another machine.
    pub(super) epoch: u64,
    /// Held if the controller before was on another machine, which is lost.
    pub(super) lock: Option<TakeoverLock>,
}

/// The lock that keeps controllers on several machines from taking over one run, as far as the file system of its journal
/// locks across machines.
pub struct TakeoverLock(#[allow(dead_code, reason = "the lock ends with it")] File);

impl TakeoverLock {
    fn take(parts: &Path) -> Result<TakeoverLock, NotResumable> {
        let path = parts.join("takeover");
        let file = File::options().create(true).append(true).open(&path);
        let file = file.map_err(|e| RunDirError::Create(path.clone(), e))?;
        match flock(&file, FlockOperation::NonBlockingLockExclusive) {
            Ok(()) => Ok(TakeoverLock(file)),
            Err(_) => Err(NotResumable::Taken(path)),
        }
    }
}

/// Takes over the run whose journal is in `parts`, with a program of this build. From here on no other process can.
///
/// # Errors
/// If the run is unknown, gone, or has a controller, or its other hosts cannot be taken over.
pub fn adopt(parts: &Path, build: u64) -> Result<Adopted, NotResumable> {
    let (run, epoch) = read_run(parts)?;
    Succession::find(&run.root(), build)?;
    Ok(Adopted { dir: RunDir::adopt(run)?, epoch, lock: None })
}

/// Takes over the run whose journal is in `parts` on this machine, after that of its controller has been lost. Its other hosts
/// are where the hosts file says. Nothing shows that the other machine is lost: the caller vouches for it.
///
/// # Errors
/// If the run is unknown, is on this machine, has no other hosts, or another controller has taken over.
pub fn adopt_elsewhere(parts: &Path, build: u64, hosts: &HostsFile) -> Result<Adopted, NotResumable> {
    let (run, _) = read_run(parts)?;
    if run.root().exists() {
        return Err(NotResumable::NotLost(run.root()));
    }
    let lock = TakeoverLock::take(parts)?;
    let succession = Succession::find(parts, build)?;
    let succession = succession.ok_or_else(|| NotResumable::NothingElsewhere(parts.to_owned()))?;
    let (dir, epoch) = (RunDir::create()?, monotonic());
    succession.move_to(dir.root(), parts, hosts)?;
    let begin = write_run(parts, dir.root(), epoch).and_then(|()| make_resumable(dir.root()));
    begin.map_err(|e| RunDirError::Create(parts.to_owned(), e))?;
    Ok(Adopted { dir, epoch, lock: Some(lock) })
}

impl Adopted {
    /// Finds one of these agents that is alive.
    ///
    /// # Errors
    /// If none is.
    pub fn find_one(&self, agents: impl Iterator<Item = AgentKey>) -> Result<(), NotResumable> {
        let is_alive = |(id, incarnation): &AgentKey| {
            let identity = fs::read_to_string(pid_file(self.dir.root(), *id, *incarnation)).ok();
            identity
                .and_then(|text| text.parse::<Identity>().ok())
                .is_some_and(|identity| identity.is_alive())
        };
        let agents: Vec<AgentKey> = agents.collect();
        match agents.iter().any(is_alive) || agents.is_empty() {
            true => Ok(()),
            false => Err(NotResumable::NobodyThere(agents.len())),
        }
    }
}

/// The counts of the controller itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counted {
    /// Number of actions, percepts and sensed contacts.
    pub body_messages: u64,
    /// Number of orders and reports.
    pub control_messages: u64,
    /// Number of incarnations after the first.
    pub restarted: u32,
    /// Number of processes killed on the director's command.
    pub killed: u32,
}

fn path(parts: &Path) -> PathBuf {
    parts.join("run")
}

/// Writes the name of the run that the journal in `parts` belongs to.
///
/// # Errors
/// If the file cannot be written.
pub fn write_run(parts: &Path, root: &Path, epoch: u64) -> io::Result<()> {
    let name = root.file_name().unwrap_or_default().to_string_lossy();
    let part = parts.join("run.new");
    fs::write(&part, format!("{name} {epoch}\n"))?;
    fs::rename(part, path(parts))
}

/// Reads the name of the run, and when it began.
fn read_run(parts: &Path) -> Result<(RunName, u64), NotResumable> {
    let path = path(parts);
    let bytes = regular_file::read(&path, LONGEST).map_err(|e| NotResumable::NotBegun(path.clone(), e))?;
    let text = String::from_utf8(bytes).map_err(|_| NotResumable::Damaged(path.clone()))?;
    let (name, epoch) = text.trim_end().split_once(' ').ok_or(NotResumable::Damaged(path.clone()))?;
    let epoch = epoch.parse().map_err(|_| NotResumable::Damaged(path))?;
    Ok((RunName::parse(name)?, epoch))
}
