//! How many messages the agents of a run have sent so far, for display: each agent writes its counters to a
//! file before the messages that they count are visible to others, and here they are added up.

use super::SwarmOptions;
use crate::console::stopwatch::Stopwatch;
use metamorph_module_agent::run_dir::counter_file;
use std::path::PathBuf;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

/// The least time between two readings.
const EVERY: Duration = Duration::from_secs(1);
/// The time between two readings in durations of one reading: reading costs a fiftieth of a core at most.
const REST: u32 = 50;

/// Reads counter files now and then.
#[derive(Debug)]
pub struct Meter {
    root: Arc<OnceLock<PathBuf>>,
    read: Option<Stopwatch>,
    rest: Duration,
    sent: Option<u64>,
}

impl Meter {
    /// For the run that is made with these options.
    pub fn new(options: &SwarmOptions) -> Meter {
        Meter { root: Arc::clone(&options.root), read: None, rest: Duration::ZERO, sent: None }
    }

    /// Messages sent, as of the last reading.
    pub fn sent(&mut self) -> Option<u64> {
        let root = self.root.get()?;
        if self.read.is_none_or(|read| read.elapsed() >= self.rest) {
            let begun = Stopwatch::start();
            // What cannot be read now is said at the end, when it matters.
            self.sent = counter_file::sent(root).ok().or(self.sent);
            self.rest = (begun.elapsed() * REST).max(EVERY);
            self.read = Some(Stopwatch::start());
        }
        self.sent
    }
}
