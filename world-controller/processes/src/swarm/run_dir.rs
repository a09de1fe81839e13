//! Run directories: created so that a live run can be distinguished from the leftovers of a dead one, and removed
//! without touching a live run or one of another user.
//!
//! A run's directory is prepared under another name, which contains the preparing process, and is renamed
//! once it holds `owner`, the controller's pid and start time. The controller keeps that file locked while it
//! is alive, which holds across containers that share memory but not pids. The shared-memory files of a run
//! lie beside it and start with its name and an underscore. The directory is removed last, so that the
//! leftovers of a killed cleaner are found by the next.

use crate::swarm::watch::Watch;
use metamorph_module_agent::clock::page;
use metamorph_module_agent::pid_directory;
use metamorph_module_agent::run_dir::controller_lease::is_resumable;
use metamorph_module_agent::run_dir::counter_file;
use metamorph_module_agent::run_dir::identity::Identity;
use metamorph_module_agent::run_dir::run_name::{HOME, NAME_PREFIX, RunName};
use metamorph_text::format::many;
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{FlockOperation, flock};
use rustix::process::{PidfdFlags, Signal, geteuid, pidfd_open, pidfd_send_signal};
use std::collections::BTreeSet;
use std::fmt;
use std::fs::{self, DirBuilder, File};
use std::io::{self, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use thiserror::Error;

/// Errors of creating or taking over a run's directory.
#[derive(Debug, Error)]
pub enum RunDirError {
    /// A file in it cannot be created.
    #[error("cannot create {0}: {1}; is {HOME} writable and not full?")]
    Create(PathBuf, io::Error),
    /// The run is gone.
    #[error(
        "{0}: {1}; its agents have waited long enough and the run was cleaned up, or the machine was restarted"
    )]
    Gone(PathBuf, io::Error),
    /// The run has a controller.
    #[error("{0} has a controller that lives; the run goes on")]
    Alive(PathBuf),
    /// Too many names were taken.
    #[error("no free name for a run in {HOME}; `metamorph clean` removes what killed runs left there")]
    Names,
}

/// Errors of cleaning up.
#[derive(Debug, Error)]
pub enum CleanError {
    /// The parent of run directories cannot be read.
    #[error("cannot look for runs in {HOME}: {0}")]
    List(io::Error),
    /// A file cannot be removed.
    #[error("cannot remove {0}: {1}")]
    Remove(PathBuf, io::Error),
}

/// The result of cleaning up.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CleanReport {
    /// The runs with leftovers.
    pub runs: Vec<String>,
    /// Number of agents still alive although their controller was dead.
    pub agents_killed: u32,
    /// Number of shared-memory files, beside the directories.
    pub files: u64,
    /// Number of this user's live runs, which were left alone.
    pub alive: u32,
}

impl fmt::Display for CleanReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.runs.len() {
            0 => write!(f, "nothing was left behind")?,
            n => write!(
                f,
                "removed what {} left behind: {}, {} of shared memory",
                many(n as u64, "killed run"),
                many(self.agents_killed.into(), "process"),
                many(self.files, "file")
            )?,
        }
        match self.alive {
            0 => Ok(()),
            alive => write!(f, "; left {} alone", many(alive.into(), "live run")),
        }
    }
}

const OWNER: &str = "owner";
/// Largest number of names tried for the directory of a run.
const NAMES_TRIED_MAX: u64 = 256;
/// Number of runs that this process has begun.
static RUNS: AtomicU64 = AtomicU64::new(0);

/// The directory of a run that this process controls. Removed, with the run's shared memory, when dropped.
#[derive(Debug)]
pub struct RunDir {
    name: RunName,
    root: PathBuf,
    lock: File,
    /// Notified after everything is removed.
    watch: Option<Watch>,
}

impl RunDir {
    /// Creates the directory of a new run.
    ///
    /// # Errors
    /// If a file cannot be created, or no name is free.
    pub fn create() -> Result<RunDir, RunDirError> {
        let me = Identity::own().map_err(|e| RunDirError::Create("/proc".into(), e))?;
        for _ in 0..NAMES_TRIED_MAX {
            let name = RunDir::name_of(me, RUNS.fetch_add(1, Ordering::Relaxed));
            let part = Path::new(HOME).join(format!("{name}~{}.{}", me.pid, me.start));
            let lock = prepare(&part, me).map_err(|e| RunDirError::Create(part.clone(), e))?;
            let root = name.root();
            match fs::rename(&part, &root) {
                Ok(()) => return Ok(RunDir { name, root, lock, watch: None }),
                Err(e) => {
                    let _ = fs::remove_dir_all(&part);
                    if !matches!(e.kind(), io::ErrorKind::DirectoryNotEmpty | io::ErrorKind::AlreadyExists) {
                        return Err(RunDirError::Create(root, e));
                    }
                }
            }
        }
        Err(RunDirError::Names)
    }

    /// Returns true unless the directory was removed during the run.
    pub fn is_there(&self) -> bool {
        self.lock.metadata().is_ok_and(|lock| lock.nlink() > 0)
    }

    /// Returns the name of a process's next run, given the number of those begun before.
    pub fn name_of(controller: Identity, before: u64) -> RunName {
        let salt = (controller.pid as u64) << 40 ^ controller.start << 8 ^ before;
        RunName::new(geteuid().as_raw(), salt)
    }

    /// Takes over the directory of a run whose controller is dead.
    ///
    /// # Errors
    /// If the run is gone, or its controller lives.
    pub fn adopt(name: RunName) -> Result<RunDir, RunDirError> {
        let root = name.root();
        let path = root.join(OWNER);
        let gone = |e| RunDirError::Gone(root.clone(), e);
        let mut owner = File::options().write(true).open(&path).map_err(gone)?;
        if flock(&owner, FlockOperation::NonBlockingLockExclusive).is_err() {
            return Err(RunDirError::Alive(root));
        }
        let me = Identity::own().map_err(|e| RunDirError::Create("/proc".into(), e))?;
        let line = me.to_line();
        owner.set_len(line.len() as u64).and_then(|()| owner.write_all(line.as_bytes())).map_err(gone)?;
        Ok(RunDir { name, root, lock: owner, watch: None })
    }

    /// Keeps the watcher of the run until its files are removed.
    pub fn keep(&mut self, watch: Watch) {
        self.watch = Some(watch);
    }

    /// Removes the run's shared memory, after all its processes have ended, but not the directory.
    ///
    /// # Errors
    /// If a file cannot be removed.
    pub fn release_shared(&self) -> Result<(), CleanError> {
        remove_shared(&BTreeSet::from([self.name.to_string()])).map(drop)
    }

    /// Returns the name of the run.
    pub fn name(&self) -> &RunName {
        &self.name
    }

    /// Returns the directory.
    pub fn root(&self) -> &Path {
        &self.root
    }
}

impl Drop for RunDir {
    fn drop(&mut self) {
        let removed = self.release_shared().and_then(|()| remove_tree(&self.root));
        if let Err(e) = removed {
            tracing::error!(
                "{e}; another process will try again when this one has ended, and so will `metamorph clean`"
            );
            // This process may lack descriptors, and the watcher does not.
            self.watch.take().into_iter().for_each(Watch::hand_over);
        }
    }
}

/// Returns the directory of the agents' standard error.
pub fn log_directory(root: &Path) -> PathBuf {
    root.join("logs")
}

fn prepare(part: &Path, me: Identity) -> io::Result<File> {
    let make = |path: &Path| DirBuilder::new().mode(0o700).create(path);
    make(part)?;
    for directory in [pid_directory(part), counter_file::directory(part), log_directory(part)] {
        make(&directory)?;
    }
    // Agents do not inherit it: like all files of the standard library it is closed on exec.
    let mut owner = File::create_new(part.join(OWNER))?;
    owner.write_all(me.to_line().as_bytes())?;
    flock(&owner, FlockOperation::NonBlockingLockExclusive)?;
    Ok(owner)
}

/// Returns the controller of the run in `root`, alive or dead.
pub fn owner(root: &Path) -> Option<Identity> {
    fs::read_to_string(root.join(OWNER)).ok()?.parse().ok()
}

/// True if a live controller holds the lock of this run.
pub fn is_locked(root: &Path) -> bool {
    File::open(root.join(OWNER)).is_ok_and(|owner| {
        flock(&owner, FlockOperation::NonBlockingLockShared) == Err(rustix::io::Errno::WOULDBLOCK)
    })
}

/// True if agents of this run still wait for a controller to take over. Stopped agents do not count, as they
/// cannot end by themselves.
pub fn waits_for_controller(root: &Path) -> bool {
    is_resumable(root) && identities(root).any(|(_, agent)| agent.is_alive() && !agent.is_stopped())
}

/// True if this is the directory of a daemon whose controller, on the same machine, lives: then that one reads the counts there,
/// and removes it.
fn is_read_by_another(root: &Path) -> bool {
    fs::read_link(page::path(root)).is_ok_and(|page| page.parent().is_some_and(is_locked))
}

/// Iterates over the registered processes of agents, each with the name of its file: `ID.INCARNATION`.
pub fn identities(root: &Path) -> impl Iterator<Item = (String, Identity)> {
    fs::read_dir(pid_directory(root)).into_iter().flatten().flatten().filter_map(|entry| {
        let text = fs::read_to_string(entry.path()).ok()?;
        Some((entry.file_name().into_string().ok()?, text.parse().ok()?))
    })
}

/// The directory of a dead run.
struct DeadRun {
    name: String,
    path: PathBuf,
    /// True if it was given its name, and so may have shared memory.
    begun: bool,
}

/// Returns the dead runs of this user, and the number of live ones.
fn survey() -> Result<(Vec<DeadRun>, u32), CleanError> {
    let user = geteuid().as_raw();
    let (mut dead, mut alive) = (Vec::new(), 0);
    for entry in fs::read_dir(HOME).map_err(CleanError::List)? {
        let entry = entry.map_err(CleanError::List)?;
        let Some(name) = entry.file_name().to_str().map(str::to_owned) else { continue };
        let ours = entry.metadata().is_ok_and(|m| m.is_dir() && m.uid() == user);
        if !name.starts_with(NAME_PREFIX) || !ours {
            continue;
        }
        let (run, owner) = match name.split_once('~') {
            // Under preparation: the name contains the process. It has no shared memory yet.
            Some((run, by)) => (run, by.replacen('.', " ", 1).parse::<Identity>().ok()),
            None => (name.as_str(), owner(&entry.path())),
        };
        if RunName::parse(run).is_err() {
            continue;
        }
        // A run's directory gets its name together with its owner: without one, it is a leftover.
        let root = entry.path();
        let is_needed = || is_locked(&root) || waits_for_controller(&root) || is_read_by_another(&root);
        if owner.is_some_and(|owner: Identity| owner.is_alive()) || is_needed() {
            alive += 1;
            continue;
        }
        let begun = run == name;
        dead.push(DeadRun { name, path: entry.path(), begun });
    }
    Ok((dead, alive))
}

/// Returns the number of dead runs of this user that [`clean`] would remove.
///
/// # Errors
/// If the runs cannot be listed.
pub fn leftovers() -> Result<usize, CleanError> {
    survey().map(|(dead, _)| dead.len())
}

/// Removes the leftovers of this user's dead runs: agents still alive, shared memory and directories. Never
/// touches a live run or one of another user.
///
/// # Errors
/// If the runs cannot be listed, or a file cannot be removed.
pub fn clean() -> Result<CleanReport, CleanError> {
    let (runs, alive) = survey()?;
    let mut report = CleanReport { alive, ..CleanReport::default() };
    report.agents_killed = runs.iter().map(|run| kill_agents(&run.path)).sum();
    let begun: BTreeSet<String> = runs.iter().filter(|run| run.begun).map(|run| run.name.clone()).collect();
    if !begun.is_empty() {
        report.files = remove_shared(&begun)?;
    }
    for run in runs {
        remove_tree(&run.path)?;
        report.runs.push(run.name);
    }
    report.runs.sort_unstable();
    Ok(report)
}

/// Kills the live agents of a dead run and waits for their end. Returns their number.
pub fn kill_agents(root: &Path) -> u32 {
    identities(root).map(|(_, agent)| u32::from(kill(agent))).sum()
}

/// Kills an agent that has no supervisor, and waits for its end. Returns false if it is dead already.
pub fn kill(agent: Identity) -> bool {
    // The descriptor is opened before the identity is checked: from then on the process is fixed.
    let fd = agent.as_pid().and_then(|pid| pidfd_open(pid, PidfdFlags::empty()).ok());
    let Some(fd) = fd.filter(|_| agent.is_alive()) else { return false };
    let killed = pidfd_send_signal(&fd, Signal::KILL).is_ok();
    if killed {
        let limit = Timespec { tv_sec: 5, tv_nsec: 0 };
        let _ = poll(&mut [PollFd::new(&fd, PollFlags::IN)], Some(&limit));
    }
    killed
}

/// Unlinks this user's shared-memory files of these runs. Returns their number.
fn remove_shared(runs: &BTreeSet<String>) -> Result<u64, CleanError> {
    let user = geteuid().as_raw();
    let mut removed = 0;
    for entry in fs::read_dir(HOME).map_err(CleanError::List)? {
        let entry = entry.map_err(CleanError::List)?;
        let name = entry.file_name();
        let of_run = name.to_str().and_then(|n| n.split_once('_')).is_some_and(|(run, _)| runs.contains(run));
        if !of_run || !entry.metadata().is_ok_and(|m| m.is_file() && m.uid() == user) {
            continue;
        }
        match fs::remove_file(entry.path()) {
            Ok(()) => removed += 1,
            Err(e) if e.kind() == io::ErrorKind::NotFound => {}
            Err(e) => return Err(CleanError::Remove(entry.path(), e)),
        }
    }
    Ok(removed)
}

fn remove_tree(root: &Path) -> Result<(), CleanError> {
    match fs::remove_dir_all(root) {
        Ok(()) => Ok(()),
        // Another process cleans up at the same time.
        Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(e) => Err(CleanError::Remove(root.to_owned(), e)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    #[test]
    fn a_live_run_is_left_alone_and_a_dropped_one_leaves_nothing() {
        let dir = RunDir::create().unwrap();
        let root = dir.root().to_owned();
        let shared = Path::new(HOME).join(format!("{}test", dir.name.prefix()));
        fs::write(&shared, b"x").unwrap();
        assert!(clean().unwrap().alive >= 1);
        assert!(root.join(OWNER).exists() && shared.exists());
        drop(dir);
        assert!(!root.exists() && !shared.exists());
    }

    #[test]
    fn a_dead_run_is_removed_with_its_shared_memory() {
        let dir = RunDir::create().unwrap();
        let (root, name) = (dir.root().to_owned(), dir.name.to_string());
        let shared = Path::new(HOME).join(format!("{}test", dir.name.prefix()));
        fs::write(&shared, b"x").unwrap();
        // A pid of this very process, but with another start time: a reused pid.
        let me = Identity::own().unwrap();
        fs::write(root.join(OWNER), Identity { start: me.start + 1, ..me }.to_line()).unwrap();
        // Locked by a process that is not visible: counts as alive.
        clean().unwrap();
        assert!(root.join(OWNER).exists() && shared.exists());
        flock(&dir.lock, FlockOperation::Unlock).unwrap();
        // Of a daemon whose controller lives: that one still reads the counts.
        let controller = RunDir::create().unwrap();
        symlink(page::path(controller.root()), page::path(&root)).unwrap();
        clean().unwrap();
        assert!(root.join(OWNER).exists() && shared.exists());
        drop(controller);
        std::mem::forget(dir);
        // Another test may clean it up at the same time; in any case nothing may be left.
        let report = clean().unwrap();
        assert!(!root.exists() && !shared.exists(), "{name} {report:?}");
    }
}
