//! The death of the controller, as the daemon of another host of the same machine sees it: the run's directory shows for
//! certain that it is dead, and then no other counts this host as dead until one has taken over.

use super::messages::Assignment;
use crate::swarm::run_dir::is_locked;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_module_agent::run_dir::controller_lease::is_resumable;
use std::path::PathBuf;
use std::time::Duration;

/// Known state of a controller that is not heard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Absence {
    /// It lives, or is on another machine.
    Unknown,
    /// It is dead, and another may take over.
    Awaited,
    /// It is dead, and no other will take over.
    Final,
}

/// The watch over the controller.
#[derive(Debug)]
pub struct ControllerWatch {
    /// The directory of the controller's host, if it is on this machine.
    root: Option<PathBuf>,
    patience: Duration,
    dead_since: Option<Stopwatch>,
}

impl ControllerWatch {
    /// Watches the controller of an assignment, which `is_away` on another machine.
    pub fn new(assignment: &Assignment, is_away: bool) -> ControllerWatch {
        let root = assignment.clock.parent().filter(|_| !is_away).map(PathBuf::from);
        ControllerWatch { root, patience: Duration::from_nanos(assignment.patience.0), dead_since: None }
    }

    /// Notes that a controller has taken over.
    pub fn forget(&mut self) {
        self.dead_since = None;
    }

    /// Looks for the controller; `is_heard` if its host is.
    pub fn look(&mut self, is_heard: bool) -> Absence {
        if is_heard {
            self.forget();
        }
        let Some(root) = self.root.as_ref().filter(|_| !is_heard) else { return Absence::Unknown };
        // A controller that takes over holds the lock before it calls.
        if self.dead_since.is_none() && is_locked(root) {
            return Absence::Unknown;
        }
        let since = *self.dead_since.get_or_insert_with(Stopwatch::start);
        // A run that has not begun cannot be resumed.
        if is_resumable(root) && since.elapsed() < self.patience { Absence::Awaited } else { Absence::Final }
    }
}
