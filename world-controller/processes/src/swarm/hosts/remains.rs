//! Remains of a share whose controller did not end it: the run's directory with the counts of this host and its agents.
//! It is kept until the controller has taken them, or until no controller can want them any more.

use crate::swarm::run_dir::RunDir;
use metamorph_console::stopwatch::Stopwatch;
use std::fmt;
use std::fs;
use std::io;
use std::path::Path;
use std::time::Duration;

/// Name of the file in a run's directory by which the controller says that it has taken the counts.
const COLLECTED: &str = "collected";

/// Notes in the directory of a host of this machine that its counts have been taken.
///
/// # Errors
/// If the file cannot be written.
pub fn mark_collected(root: &Path) -> io::Result<()> {
    fs::write(root.join(COLLECTED), b"")
}

/// How a share of a run ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// It was refused at the beginning.
    Refused,
    /// The controller has ended it.
    Finished,
    /// The daemon is asked to end.
    Asked,
    /// The controller has been silent for too long.
    Alone,
    /// The controller is dead, and no other has taken over.
    Orphaned,
}

impl Ending {
    /// True if a controller may live that does not have the counts.
    pub fn leaves_counts(self) -> bool {
        matches!(self, Ending::Asked | Ending::Alone)
    }
}

impl fmt::Display for Ending {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Ending::Refused => "it was refused",
            Ending::Finished => "it is finished",
            Ending::Asked => "the daemon is asked to end",
            Ending::Alone => "the controller has been silent for too long",
            Ending::Orphaned => "the controller is dead, and no other has taken over",
        })
    }
}

/// The remains of one share. The directory is removed when it is dropped.
#[derive(Debug)]
pub struct Remains {
    dir: RunDir,
    since: Stopwatch,
    patience: Duration,
}

impl Remains {
    /// Keeps the directory of a share without agents for at most `patience`.
    pub fn new(dir: RunDir, patience: Duration) -> Remains {
        if let Err(e) = dir.release_shared() {
            tracing::warn!("{e}; `metamorph clean` will try again");
        }
        Remains { dir, since: Stopwatch::start(), patience }
    }

    /// True if it need not be kept.
    pub fn is_over(&self) -> bool {
        self.since.elapsed() > self.patience || self.dir.root().join(COLLECTED).exists()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn remains_are_kept_until_they_are_collected_or_late() {
        let dir = RunDir::create().unwrap();
        let root = dir.root().to_owned();
        let hour = Duration::from_secs(3_600);
        let remains = Remains::new(dir, hour);
        assert!(!remains.is_over() && root.is_dir());
        mark_collected(&root).unwrap();
        assert!(remains.is_over());
        drop(remains);
        assert!(!root.exists());
        assert!(!Remains::new(RunDir::create().unwrap(), hour).is_over());
        let late = Remains::new(RunDir::create().unwrap(), Duration::ZERO);
        assert!(metamorph_console::stopwatch::wait_until(hour, || late.is_over()));
    }
}
