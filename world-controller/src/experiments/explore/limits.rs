//! Until when an exploration goes on: Ctrl-C, and a budget of time that covers drawing, judging and making
//! failures small.

use super::Budget;
use crate::console::interrupt::Interrupt;
use crate::console::stopwatch::Stopwatch;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// The end of an exploration. Clones share it.
#[derive(Clone, Debug)]
pub struct Limits {
    interrupt: Interrupt,
    since: Stopwatch,
    time: Option<Duration>,
    failed: Arc<AtomicBool>,
}

impl Limits {
    /// The limits of an exploration that begins now.
    pub fn new(budget: Budget, interrupt: Interrupt) -> Limits {
        let time = match budget {
            Budget::Runs(_) => None,
            Budget::Time(time) => Some(time),
        };
        Limits { interrupt, since: Stopwatch::start(), time, failed: Arc::default() }
    }
    /// How long it has taken so far.
    pub fn elapsed(&self) -> Duration {
        self.since.elapsed()
    }
    /// Something has failed, and is to be made small.
    pub fn note_failure(&self) {
        self.failed.store(true, Ordering::Relaxed);
    }
    /// Whether nothing is drawn any more. Of a budget of time, a quarter is kept for making small what has
    /// failed.
    pub fn end_drawing(&self) -> bool {
        let failed = self.failed.load(Ordering::Relaxed);
        let spent = |time: Duration| self.elapsed() >= if failed { time * 3 / 4 } else { time };
        self.interrupt.is_set() || self.time.is_some_and(spent)
    }
    /// Whether nothing is done any more.
    pub fn end(&self) -> bool {
        self.interrupt.is_set() || self.time.is_some_and(|time| self.elapsed() >= time)
    }
}
