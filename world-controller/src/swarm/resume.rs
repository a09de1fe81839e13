//! The input of a controller that goes on with a swarm, besides its world and its director: the run's
//! directory, the time of its beginning, and the messages sent to each agent.

use super::hosts::{FleetError, Succession};
use super::process::ControlMessage;
use super::run_dir::{RunDir, RunDirError};
use metamorph_module_agent::regular_file;
use metamorph_module_agent::run_dir::run_name::{RunName, RunNameError};
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::link::LinkChanges;
use metamorph_protocol::time::Time;
use std::collections::{BTreeSet, VecDeque};
use std::fs;
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
    /// What the director had changed about the links between modules.
    pub links: LinkChanges,
    /// The counts of the controller.
    pub counted: Counted,
}

/// A run whose controller is dead and that this process has taken over.
pub struct Adopted {
    pub(super) dir: RunDir,
    /// CLOCK_MONOTONIC at scenario time zero.
    pub(super) epoch: u64,
}

/// Takes over the run whose journal is in `parts`, with a program of this build. From here on no other process can.
///
/// # Errors
/// If the run is unknown, gone, or has a controller, or its other hosts cannot be taken over.
pub fn adopt(parts: &Path, build: u64) -> Result<Adopted, NotResumable> {
    let (run, epoch) = read_run(parts)?;
    Succession::check(&run.root(), build)?;
    Ok(Adopted { dir: RunDir::adopt(run)?, epoch })
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
