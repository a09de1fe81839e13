//! Real time, for the report and the progress line only. No result of a run depends on it.

use std::time::{Duration, Instant};

/// A running stopwatch.
#[derive(Clone, Copy, Debug)]
pub struct Stopwatch(Instant);

impl Stopwatch {
    /// Starts a stopwatch.
    #[allow(clippy::disallowed_methods, reason = "measures how long a run takes; no run depends on it")]
    pub fn start() -> Stopwatch {
        Stopwatch(Instant::now())
    }
    /// Returns the time since the start.
    pub fn elapsed(self) -> Duration {
        self.0.elapsed()
    }
}
