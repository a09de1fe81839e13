//! Real time, for the report and the progress line only. Nothing that a run computes depends on it.

use std::time::{Duration, Instant};

/// Runs from its start.
#[derive(Clone, Copy, Debug)]
pub struct Stopwatch(Instant);

impl Stopwatch {
    /// Starts.
    #[allow(clippy::disallowed_methods, reason = "measures how long a run takes; no run depends on it")]
    pub fn start() -> Stopwatch {
        Stopwatch(Instant::now())
    }
    /// Since the start.
    pub fn elapsed(self) -> Duration {
        self.0.elapsed()
    }
}
