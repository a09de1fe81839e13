//! The lease of the process that controls a run: `controller` in the run's directory, read by every agent
//! when it starts and whenever its controller seems to be gone or replaced. A run that is resumed after its
//! controller was killed gets the next generation of controller, with an inbox of its own.

use crate::run_dir::identity::Identity;
use std::fs;
use std::io;
use std::path::Path;

/// The controller of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ControllerLease {
    /// The process of the controller.
    pub controller: Identity,
    /// The number of controllers before it.
    pub generation: u32,
}

const NAME: &str = "controller";
/// Name of the file that marks a run whose agents wait when their controller is killed.
const RESUMABLE: &str = "resumable";

/// Marks the run: from now on its agents wait for a while when their controller is killed.
///
/// # Errors
/// If the file cannot be created.
pub fn make_resumable(root: &Path) -> io::Result<()> {
    fs::write(root.join(RESUMABLE), b"")
}

/// True if the agents of this run wait when their controller is killed.
pub fn is_resumable(root: &Path) -> bool {
    root.join(RESUMABLE).exists()
}

impl ControllerLease {
    /// Reads the lease of the run in `root`.
    ///
    /// # Errors
    /// If the file cannot be read, or does not hold a lease.
    pub fn read(root: &Path) -> io::Result<ControllerLease> {
        let text = fs::read_to_string(root.join(NAME))?;
        let parse = |text: &str| {
            let (identity, generation) = text.trim_end().rsplit_once(' ')?;
            Some(ControllerLease { controller: identity.parse().ok()?, generation: generation.parse().ok()? })
        };
        parse(&text).ok_or_else(|| io::Error::other("its file `controller` holds no lease"))
    }

    /// Takes the lease of the run in `root`; a reader sees either the whole new lease or the whole
    /// previous one.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn acquire(&self, root: &Path) -> io::Result<()> {
        let part = root.join("controller.part");
        fs::write(&part, format!("{} {}\n", self.controller.to_line().trim_end(), self.generation))?;
        fs::rename(part, root.join(NAME))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_what_it_writes_and_refuses_the_rest() {
        let dir = tempfile::tempdir().unwrap();
        assert!(ControllerLease::read(dir.path()).is_err());
        let lease = ControllerLease { controller: Identity { pid: 7, start: 9 }, generation: 3 };
        lease.acquire(dir.path()).unwrap();
        assert_eq!(ControllerLease::read(dir.path()).unwrap(), lease);
        for bad in ["", "7 9", "x 9 3", "7 9 -1"] {
            fs::write(dir.path().join(NAME), bad).unwrap();
            assert!(ControllerLease::read(dir.path()).is_err(), "{bad}");
        }
    }
}
