//! What a run is called. The name is its directory under /dev/shm and, with an underscore, the
//! prefix of every shared-memory file of it, so that runs never meet.

use std::fmt;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Where run directories are: memory, not a disk (setting up on a disk is six times slower).
pub const HOME: &str = "/dev/shm";
/// What every run's name starts with.
pub const MARK: &str = "mm";
/// Length of a run's name. Short, because socket paths end at 108 bytes.
const LENGTH: usize = 12;
const DIGITS: &[u8; 36] = b"0123456789abcdefghijklmnopqrstuvwxyz";

/// The name of a run: `mm`, four digits for the user, six for the run.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RunName(String);

/// A name that is not one of a run.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("`{0}` is not the directory of a run; those are called {HOME}/{MARK} and ten digits or letters")]
pub struct RunNameError(String);

impl RunName {
    /// A name for a run of `user`; `salt` makes it differ from the user's other runs.
    pub fn new(user: u32, salt: u64) -> RunName {
        RunName(format!("{MARK}{}{}", base36(user.into(), 4), base36(mix(salt), 6)))
    }

    /// The name of a run from the name of its directory.
    pub fn parse(name: &str) -> Result<RunName, RunNameError> {
        let good = name.len() == LENGTH
            && name.starts_with(MARK)
            && name.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit());
        if good { Ok(RunName(name.to_owned())) } else { Err(RunNameError(name.to_owned())) }
    }

    /// The name of the run whose directory this is.
    pub fn of_root(root: &Path) -> Result<RunName, RunNameError> {
        let err = || RunNameError(root.display().to_string());
        if root.parent() != Some(Path::new(HOME)) {
            return Err(err());
        }
        RunName::parse(root.file_name().and_then(|n| n.to_str()).ok_or_else(err)?)
    }

    /// The run's directory.
    pub fn root(&self) -> PathBuf {
        Path::new(HOME).join(&self.0)
    }

    /// What all shared-memory files of the run start with.
    pub fn prefix(&self) -> String {
        format!("{}_", self.0)
    }
}

impl fmt::Display for RunName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

fn base36(mut n: u64, width: usize) -> String {
    let mut digits = vec![b'0'; width];
    for digit in digits.iter_mut().rev() {
        *digit = DIGITS[(n % 36) as usize];
        n /= 36;
    }
    digits.into_iter().map(char::from).collect()
}

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_short_own_and_read_back() {
        let name = RunName::new(1_000, 1);
        assert_eq!(name.to_string().len(), LENGTH);
        assert!(name.root().as_os_str().len() + name.prefix().len() <= 60);
        assert_eq!(RunName::of_root(&name.root()), Ok(name.clone()));
        assert_ne!(name, RunName::new(1_000, 2));
        assert_ne!(name, RunName::new(1_001, 1));
    }

    #[test]
    fn refuses_what_is_not_a_run() {
        for bad in ["/dev/shm", "/dev/shm/mmABCDEFGHIJ", "/dev/shm/mm0", "/tmp/mm0000000000", "/", ""] {
            assert!(RunName::of_root(Path::new(bad)).is_err(), "{bad}");
        }
    }
}
