//! The number of messages that the agents of a run have sent so far, for display: the sum of their counter
//! files, which each agent writes before the messages become visible to others.

use metamorph_console::stopwatch::Stopwatch;
use metamorph_module_agent::run_dir::counter_file;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

/// The shortest time between two readings.
const EVERY: Duration = Duration::from_secs(1);
/// The shortest time between two readings as a multiple of the duration of one reading. Limits the cost to a
/// fiftieth of a core.
const REST: u32 = 50;

/// Reads the counter files at intervals.
#[derive(Debug)]
pub struct Meter {
    root: Arc<OnceLock<PathBuf>>,
    read: Option<Stopwatch>,
    rest: Duration,
    sent: Option<u64>,
}

impl Meter {
    /// Creates the meter of a run, whose directory `root` holds once it is there.
    pub fn new(root: &Arc<OnceLock<PathBuf>>) -> Meter {
        Meter { root: Arc::clone(root), read: None, rest: Duration::ZERO, sent: None }
    }

    /// Returns the number of messages sent, as of the last reading.
    pub fn sent(&mut self) -> Option<u64> {
        let root = self.root.get()?;
        if self.read.is_none_or(|read| read.elapsed() >= self.rest) {
            let begun = Stopwatch::start();
            // An error here is ignored; it is reported at the end of the run, when it matters.
            self.sent = counter_file::tally(root).ok().map(|tally| tally.total().sent).or(self.sent);
            self.rest = (begun.elapsed() * REST).max(EVERY);
            self.read = Some(Stopwatch::start());
        }
        self.sent
    }
}
