//! The end of an exploration: Ctrl-C, and a time budget that covers drawing, judging and shrinking.

use super::Budget;
use metamorph_console::interrupt::Interrupt;
use metamorph_console::stopwatch::Stopwatch;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// The limits of an exploration. Clones share them.
#[derive(Clone, Debug)]
pub struct Limits {
    interrupt: Interrupt,
    since: Stopwatch,
    time: Option<Duration>,
    failed: Arc<AtomicBool>,
}

impl Limits {
    /// Starts the limits of an exploration.
    pub fn new(budget: Budget, interrupt: Interrupt) -> Limits {
        let time = match budget {
            Budget::Runs(_) => None,
            Budget::Time(time) => Some(time),
        };
        Limits { interrupt, since: Stopwatch::start(), time, failed: Arc::default() }
    }
    /// Returns the time since the start.
    pub fn elapsed(&self) -> Duration {
        self.since.elapsed()
    }
    /// Notes that a run has failed and is to be shrunk.
    pub fn note_failure(&self) {
        self.failed.store(true, Ordering::Relaxed);
    }
    /// Returns true if no more runs are to be started: after Ctrl-C, and at the end of a time budget. Once a
    /// run has failed, a quarter of the budget is reserved for shrinking.
    pub fn end_drawing(&self) -> bool {
        let failed = self.failed.load(Ordering::Relaxed);
        let spent = |time: Duration| self.elapsed() >= if failed { time * 3 / 4 } else { time };
        self.interrupt.is_set() || self.time.is_some_and(spent)
    }
    /// Returns true if all work ends.
    pub fn end(&self) -> bool {
        self.interrupt.is_set() || self.time.is_some_and(|time| self.elapsed() >= time)
    }
}
