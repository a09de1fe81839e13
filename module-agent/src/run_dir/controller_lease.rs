//! Who controls a run at present: `controller` in the run's directory, read by every agent when it
//! starts and whenever its controller seems to be gone or to be another. A run that is resumed after
//! its controller was killed gets the next generation of controller, with channels of its own.

use crate::run_dir::identity::Identity;
use std::fs;
use std::io;
use std::path::Path;

/// The controller of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seat {
    /// Its process.
    pub controller: Identity,
    /// How many there were before it.
    pub generation: u32,
}

const NAME: &str = "controller";
/// Marks a run that has begun, and whose agents wait when their controller is killed.
const AWAITED: &str = "awaited";

/// From now on the agents of this run wait for a while when their controller is killed.
pub fn mark_awaited(root: &Path) -> io::Result<()> {
    fs::write(root.join(AWAITED), b"")
}

/// Whether the agents of this run are to wait when their controller is killed.
pub fn is_marked(root: &Path) -> bool {
    root.join(AWAITED).exists()
}

impl Seat {
    /// Who controls the run in `root`.
    pub fn read(root: &Path) -> io::Result<Seat> {
        let text = fs::read_to_string(root.join(NAME))?;
        let parse = |text: &str| {
            let (identity, generation) = text.trim_end().rsplit_once(' ')?;
            Some(Seat { controller: identity.parse().ok()?, generation: generation.parse().ok()? })
        };
        parse(&text).ok_or_else(|| io::Error::other("it does not say who controls the run"))
    }

    /// Takes the seat; readers see all of it or what was there before.
    pub fn write(&self, root: &Path) -> io::Result<()> {
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
        assert!(Seat::read(dir.path()).is_err());
        let seat = Seat { controller: Identity { pid: 7, start: 9 }, generation: 3 };
        seat.write(dir.path()).unwrap();
        assert_eq!(Seat::read(dir.path()).unwrap(), seat);
        for bad in ["", "7 9", "x 9 3", "7 9 -1"] {
            fs::write(dir.path().join(NAME), bad).unwrap();
            assert!(Seat::read(dir.path()).is_err(), "{bad}");
        }
    }
}
