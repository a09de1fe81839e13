//! Real time, for the report, the progress line and waiting for other processes. No result of a run depends on it.

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

/// The time between two looks at a condition.
const LOOK: Duration = Duration::from_millis(2);

/// Waits until a condition holds that another process or thread brings about, for at most `limit`. Returns true if it
/// holds.
#[allow(clippy::disallowed_methods, reason = "nothing can be waited on; there is a deadline")]
pub fn wait_until(limit: Duration, mut holds: impl FnMut() -> bool) -> bool {
    let since = Stopwatch::start();
    loop {
        if holds() {
            return true;
        }
        if since.elapsed() > limit {
            return false;
        }
        std::thread::sleep(LOOK);
    }
}
