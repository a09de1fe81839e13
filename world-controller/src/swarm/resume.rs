//! What a controller needs to go on with a swarm that another controller has left, besides its world and
//! its director: where the run is, when it began, and the messages sent to each agent.

use super::process::ControlMessage;
use super::run_dir::{RunDir, RunDirError};
use metamorph_module_agent::regular_file;
use metamorph_module_agent::run_dir::run_name::{RunName, RunNameError};
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::time::Time;
use std::collections::{BTreeSet, VecDeque};
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// The most bytes of the file that says which run it is.
const LONGEST: u64 = 1 << 10;

/// Why a run cannot be resumed.
#[derive(Debug, Error)]
pub enum NotResumable {
    /// It is not known which run it is.
    #[error("{0}: {1}; the controller was killed before the run began, so there is nothing to go on with")]
    NotBegun(PathBuf, io::Error),
    /// The file that names the run is damaged.
    #[error("{0} does not say which run it is")]
    Damaged(PathBuf),
    /// Its directory cannot be taken over.
    #[error(transparent)]
    Dir(#[from] RunDirError),
    /// The name is not one of a run.
    #[error(transparent)]
    Name(#[from] RunNameError),
}

/// One incarnation of an agent that is taken over.
pub struct TakenOver<A: Agent> {
    /// Which module.
    pub id: ModuleId,
    /// Which incarnation of it.
    pub incarnation: Incarnation,
    /// Where its body stood when it began.
    pub place: A::Place,
    /// Actions and reports of it that were taken.
    pub heard: u32,
    /// All messages to it since its beginning.
    pub told: VecDeque<ControlMessage<A>>,
    /// Whether it was to be killed.
    pub condemned: bool,
    /// Whether it was to be stopped.
    pub paused: bool,
}

/// What a run's journal says of its agents.
pub struct Resumption<A: Agent> {
    /// Scenario time of the last record.
    pub until: Time,
    /// Every incarnation that was alive then.
    pub lives: Vec<TakenOver<A>>,
    /// The latest incarnation of every module, alive or not.
    pub latest: Vec<Incarnation>,
    /// Modules that are to be started again.
    pub awaited: BTreeSet<ModuleId>,
    /// Whether the run was over but for ending its agents.
    pub finishing: bool,
    /// What the controller had counted.
    pub counted: Counted,
}

/// A run that has lost its controller and that this process has taken over.
pub struct Adopted {
    pub(super) dir: RunDir,
    /// CLOCK_MONOTONIC at scenario time zero.
    pub(super) epoch: u64,
}

/// Takes over the run whose journal is in `parts`. From here on no other process can.
pub fn adopt(parts: &Path) -> Result<Adopted, NotResumable> {
    let (run, epoch) = read_run(parts)?;
    Ok(Adopted { dir: RunDir::adopt(run)?, epoch })
}

/// What a controller counts by itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counted {
    /// Actions, percepts and sensed contacts.
    pub body_messages: u64,
    /// Orders and reports.
    pub control_messages: u64,
    /// Incarnations begun after the first.
    pub restarted: u32,
    /// Processes killed on the director's command.
    pub killed: u32,
}

fn path(parts: &Path) -> PathBuf {
    parts.join("run")
}

/// Writes down which run the journal in `parts` is of.
pub fn write_run(parts: &Path, root: &Path, epoch: u64) -> io::Result<()> {
    let name = root.file_name().unwrap_or_default().to_string_lossy();
    let part = parts.join("run.new");
    fs::write(&part, format!("{name} {epoch}\n"))?;
    fs::rename(part, path(parts))
}

/// Which run it is, and when it began.
fn read_run(parts: &Path) -> Result<(RunName, u64), NotResumable> {
    let path = path(parts);
    let bytes = regular_file::read(&path, LONGEST).map_err(|e| NotResumable::NotBegun(path.clone(), e))?;
    let text = String::from_utf8(bytes).map_err(|_| NotResumable::Damaged(path.clone()))?;
    let (name, epoch) = text.trim_end().split_once(' ').ok_or(NotResumable::Damaged(path.clone()))?;
    let epoch = epoch.parse().map_err(|_| NotResumable::Damaged(path))?;
    Ok((RunName::parse(name)?, epoch))
}
