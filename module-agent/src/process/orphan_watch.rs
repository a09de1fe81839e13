//! The watch over the controller: an agent process whose controller is gone waits for a while if the run can
//! be resumed, and turns to the next controller as soon as there is one. Not here: agents that are threads,
//! which end with their controller anyway.

use crate::run_dir::controller_lease::{ControllerLease, is_resumable};
use crate::run_dir::identity::Guard;
use crate::run_dir::share_lease;
use std::path::PathBuf;
use std::time::Duration;

/// Shortest real time between two checks of the controller, in nanoseconds.
const CHECK_NANOS: u64 = 900_000_000;
/// The longest wait before the next check: first, if the kernel ends this process with its controller;
/// second, if not.
const LONGEST_WAIT: (Duration, Duration) = (Duration::from_secs(2), Duration::from_secs(1));

/// The state of the controller, as last checked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ControllerState {
    /// It lives, or it is too early for another check.
    Alive,
    /// It is gone, and another may take over.
    Missing,
    /// It is gone permanently.
    Gone,
    /// It is a daemon that has not run for so long that its agents may count as dead.
    Frozen,
}

/// Watches the controller from within one agent process.
#[derive(Debug)]
pub struct OrphanWatch {
    root: PathBuf,
    lease: ControllerLease,
    guard: Guard,
    /// How long to continue without a controller (ns of real time).
    timeout: u64,
    /// Since when the controller has been missing.
    orphaned: Option<u64>,
    /// When the controller was last checked.
    checked: u64,
}

impl OrphanWatch {
    /// Starts to watch the controller that holds `lease` on the run in `root`.
    pub fn new(root: PathBuf, lease: ControllerLease, guard: Guard, timeout: u64, now: u64) -> OrphanWatch {
        OrphanWatch { root, lease, guard, timeout, orphaned: None, checked: now }
    }

    /// Returns the process id of the controller.
    pub fn controller(&self) -> i32 {
        self.lease.controller.pid
    }

    /// Returns the longest time that the process may wait before the next check.
    pub fn longest_wait(&self) -> Duration {
        if self.guard.is_signalled() { LONGEST_WAIT.0 } else { LONGEST_WAIT.1 }
    }

    /// Checks the controller if a check is due.
    pub fn check(&mut self, now: u64) -> ControllerState {
        if now.saturating_sub(self.checked) < CHECK_NANOS {
            return ControllerState::Alive;
        }
        self.checked = now;
        if !self.guard.controller_is_gone() {
            let is_frozen = share_lease::has_ended(&self.root, now);
            return if is_frozen { ControllerState::Frozen } else { ControllerState::Alive };
        }
        let since = *self.orphaned.get_or_insert(now);
        // A run that has not begun cannot be resumed.
        if !is_resumable(&self.root) || now.saturating_sub(since) >= self.timeout {
            ControllerState::Gone
        } else {
            ControllerState::Missing
        }
    }

    /// Returns the lease of a later controller, if there is one.
    pub fn successor(&self) -> Option<ControllerLease> {
        let lease = ControllerLease::read(&self.root).ok()?;
        (lease.generation > self.lease.generation).then_some(lease)
    }

    /// Watches another controller from now on.
    pub fn follow(&mut self, lease: ControllerLease) {
        self.lease = lease;
        self.guard = Guard::new(lease.controller, true);
        self.orphaned = None;
    }
}
