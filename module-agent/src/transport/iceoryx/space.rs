//! Free shared memory. iceoryx2 only sets the size of a segment; the system gives it pages on first write,
//! and a write without a free page ends the process by SIGBUS. So free space is checked before a segment is
//! created, and the few segments that are not written as a whole at once get all their pages before they are
//! relied on ([`allocate`]).
//!
//! Another program can take the space between the check and the first write. That window is microseconds
//! long; a process hit in it dies of SIGBUS, and its supervisor reports so.

use crate::run_dir::run_name::{HOME, RunName};
use crate::transport::SpaceShortage;
use rustix::fs::{FallocateFlags, fallocate, statvfs};
use std::collections::BTreeSet;
use std::fs::{self, File};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;

/// Number of bytes in a block of [`MetadataExt::blocks`].
const BLOCK: u64 = 512;

/// Returns the number of bytes of free shared memory.
///
/// # Errors
/// If the file system cannot be inspected.
pub fn free() -> io::Result<u64> {
    let fs = statvfs(HOME)?;
    Ok(fs.f_bavail.saturating_mul(fs.f_frsize))
}

/// Checks that `needed` bytes of shared memory are free. If that cannot be determined, the check passes: the
/// attempt to use them reports the failure.
///
/// # Errors
/// If fewer bytes are free.
pub fn require(needed: u64) -> Result<(), SpaceShortage> {
    match free() {
        Ok(free) if free < needed => Err(SpaceShortage { needed, free }),
        _ => Ok(()),
    }
}

/// Gives every segment of the run that this process maps all of its pages.
///
/// # Errors
/// If the memory is exhausted.
pub fn allocate(run: &RunName) -> io::Result<()> {
    let prefix = format!("{HOME}/{}", run.prefix());
    // Names of other mapped files may be any bytes.
    let maps = String::from_utf8_lossy(&fs::read("/proc/self/maps")?).into_owned();
    let mapped = |line: &str| {
        let start = line.find(&prefix)?;
        // The name of a removed segment ends with this mark.
        (!line.ends_with(" (deleted)")).then(|| PathBuf::from(&line[start..]))
    };
    for path in maps.lines().filter_map(mapped).collect::<BTreeSet<_>>() {
        match File::options().write(true).open(&path).and_then(|segment| fill(&segment)) {
            Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
            _ => {}
        }
    }
    Ok(())
}

fn fill(segment: &File) -> io::Result<()> {
    let found = segment.metadata()?;
    if found.blocks() * BLOCK < found.len() {
        fallocate(segment, FallocateFlags::empty(), 0, found.len())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn says_what_is_missing() {
        assert_eq!(require(0), Ok(()));
        let shortage = require(u64::MAX).unwrap_err();
        assert_eq!(shortage.needed, u64::MAX);
        assert!(shortage.to_string().contains("--shm-size"), "{shortage}");
    }

    #[test]
    fn fills_what_has_a_size_and_no_pages() {
        let segment = tempfile::tempfile_in(HOME).unwrap();
        segment.set_len(100_000).unwrap();
        assert_eq!(segment.metadata().unwrap().blocks(), 0);
        fill(&segment).unwrap();
        assert!(segment.metadata().unwrap().blocks() * BLOCK >= 100_000);
    }
}
