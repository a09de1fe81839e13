//! The processor time that an analysis may take, and its cancellation.

use rustix::time::{ClockId, clock_gettime};
use std::cell::Cell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Processor time of an analysis.
pub const LONGEST: Duration = Duration::from_secs(2);
/// Questions from one look at the clock to the next, where a question is about little work.
const LOOK_EVERY: u32 = 32;

/// Remaining time of an analysis on this thread.
#[derive(Debug)]
pub struct Budget {
    cancelled: Arc<AtomicBool>,
    begun: Duration,
    longest: Duration,
    look_every: u32,
    asked: Cell<u32>,
    over: Cell<bool>,
}

fn processor_time() -> Duration {
    let spec = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(spec.tv_sec.unsigned_abs(), spec.tv_nsec as u32)
}

impl Budget {
    /// Begins an analysis of at most this processor time, which `cancelled` ends.
    pub fn new(cancelled: Arc<AtomicBool>, longest: Duration) -> Budget {
        Budget::looking(cancelled, longest, LOOK_EVERY)
    }
    /// The same for work in steps that each take longer than a look at the clock.
    pub fn of_steps(cancelled: Arc<AtomicBool>, longest: Duration) -> Budget {
        Budget::looking(cancelled, longest, 1)
    }
    fn looking(cancelled: Arc<AtomicBool>, longest: Duration, look_every: u32) -> Budget {
        let (begun, asked, over) = (processor_time(), Cell::new(0), Cell::new(false));
        Budget { cancelled, begun, longest, look_every, asked, over }
    }
    /// Returns whether the analysis may continue.
    pub fn is_left(&self) -> bool {
        self.asked.set(self.asked.get().wrapping_add(1));
        if !self.over.get() && self.asked.get().is_multiple_of(self.look_every) {
            let spent = processor_time().saturating_sub(self.begun);
            self.over.set(spent > self.longest || self.cancelled.load(Ordering::Relaxed));
        }
        !self.over.get()
    }
    /// Returns whether the analysis was ended before its end.
    pub fn was_ended(&self) -> bool {
        self.over.get()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cancelled_analysis_ends_and_one_that_takes_too_long_does() {
        let cancelled = Arc::new(AtomicBool::new(false));
        let budget = Budget::new(Arc::clone(&cancelled), Duration::MAX);
        assert!((0..1_000).all(|_| budget.is_left()) && !budget.was_ended());
        cancelled.store(true, Ordering::Relaxed);
        assert!((0..LOOK_EVERY).any(|_| !budget.is_left()) && budget.was_ended());
        let begun = processor_time();
        let longest = Duration::from_millis(5);
        let budget = Budget::new(Arc::default(), longest);
        while budget.is_left() {}
        assert!(processor_time() - begun > longest);
    }
}
