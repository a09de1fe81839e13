//! The name of a run. It is the name of its directory under /dev/shm and, with an underscore, the prefix of
//! all its shared-memory files, so that runs do not interfere.

use std::fmt;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// The parent of run directories: memory, since setting up on a disk takes six times as long.
pub const HOME: &str = "/dev/shm";
/// The prefix of every run's name.
pub const NAME_PREFIX: &str = "mm";
/// Length of a run's name in bytes. Short, because socket paths end at 108 bytes.
const LENGTH: usize = 12;
const DIGITS: &[u8; 36] = b"0123456789abcdefghijklmnopqrstuvwxyz";

/// The name of a run: `mm`, four digits for the user, six for the run.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RunName(String);

/// A path or name that is not that of a run's directory.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error(
    "`{0}` is not the directory of a run, which is {HOME}/{NAME_PREFIX} followed by ten digits or lower-case letters"
)]
pub struct RunNameError(String);

impl RunName {
    /// Returns a name for a run of `user`; `salt` makes it differ from the user's other runs.
    pub fn new(user: u32, salt: u64) -> RunName {
        RunName(format!("{NAME_PREFIX}{}{}", base36(user.into(), 4), base36(mix(salt), 6)))
    }

    /// Parses the name of a run's directory.
    ///
    /// # Errors
    /// If it is not the name of a run.
    pub fn parse(name: &str) -> Result<RunName, RunNameError> {
        let good = name.len() == LENGTH
            && name.starts_with(NAME_PREFIX)
            && name.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit());
        if good { Ok(RunName(name.to_owned())) } else { Err(RunNameError(name.to_owned())) }
    }

    /// Returns the name of the run whose directory this is.
    ///
    /// # Errors
    /// If the last component is not the name of a run.
    pub fn of_root(root: &Path) -> Result<RunName, RunNameError> {
        let err = || RunNameError(root.display().to_string());
        if root.parent() != Some(Path::new(HOME)) {
            return Err(err());
        }
        RunName::parse(root.file_name().and_then(|n| n.to_str()).ok_or_else(err)?)
    }

    /// Returns the run's directory.
    pub fn root(&self) -> PathBuf {
        Path::new(HOME).join(&self.0)
    }

    /// Returns the prefix of all shared-memory files of the run.
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
