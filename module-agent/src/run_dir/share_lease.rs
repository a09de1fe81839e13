//! The lease of a daemon's share of a run: the instant until which the agents of the daemon may act. A daemon renews it as long
//! as it runs, so agents whose daemon is frozen end by the time at which the controller may count them as dead. The agents of
//! the controller's own host have no such lease.

use std::fs;
use std::io;
use std::path::Path;

const NAME: &str = "acts-until";

/// Extends the lease in the run directory `root` to `until`, in nanoseconds of the machine's monotonic clock. A reader sees
/// either the whole new lease or the whole previous one.
///
/// # Errors
/// If the file cannot be written.
pub fn renew(root: &Path, until: u64) -> io::Result<()> {
    let part = root.join("acts-until.part");
    fs::write(&part, until.to_le_bytes())?;
    fs::rename(part, root.join(NAME))
}

/// True if the run directory `root` holds a lease that has ended at `now`, in nanoseconds of the machine's monotonic clock. A
/// missing lease never ends.
pub fn has_ended(root: &Path, now: u64) -> bool {
    let bytes = fs::read(root.join(NAME)).ok();
    bytes.and_then(|bytes| bytes.try_into().ok()).is_some_and(|until| u64::from_le_bytes(until) <= now)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lease_ends_unless_it_is_renewed() {
        let dir = tempfile::tempdir().unwrap();
        assert!(!has_ended(dir.path(), u64::MAX));
        renew(dir.path(), 1_000).unwrap();
        assert!(!has_ended(dir.path(), 999) && has_ended(dir.path(), 1_000));
        renew(dir.path(), 2_000).unwrap();
        assert!(!has_ended(dir.path(), 1_000) && has_ended(dir.path(), 2_000));
    }
}
