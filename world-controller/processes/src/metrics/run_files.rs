//! The parts of metrics that are in the directory of a run of processes: the counters of agents, and the clock page.

use metamorph_console::stopwatch::Stopwatch;
use metamorph_module_agent::clock::monotonic;
use metamorph_module_agent::clock::source::{ClockSource, FileClock};
use metamorph_module_agent::run_dir::counter_file;
use metamorph_protocol::counters::{Class, Counts, Tally};
use metamorph_protocol::time::Time;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Shortest time between two readings of the counters.
const EVERY: Duration = Duration::from_secs(1);
/// Shortest time between two readings as a multiple of the duration of one, which bounds the cost for a scraper in a hurry.
const REST: u32 = 20;

/// The directory of a run, and the numbers as last read from it. They outlive it.
#[derive(Debug, Default)]
pub struct RunFiles {
    root: Option<PathBuf>,
    /// Messages of all agents of this host.
    pub tally: Tally,
    /// Scenario time.
    pub time: Time,
    read: Option<(Stopwatch, Duration)>,
}

impl RunFiles {
    /// Begins with the directory of a run.
    pub fn new(root: Option<&Path>) -> RunFiles {
        RunFiles { root: root.map(Path::to_owned), ..RunFiles::default() }
    }

    /// Reads again: scenario time always, counters if the last reading is long enough ago, or `at_once`.
    pub fn read(&mut self, at_once: bool) {
        let Some(root) = &self.root else { return };
        if let Ok(page) = FileClock::open(root).and_then(|clock| clock.read_page()) {
            self.time = self.time.max(page.at(monotonic()));
        }
        let is_fresh = |(read, rest): (Stopwatch, Duration)| read.elapsed() < rest;
        if !at_once && self.read.is_some_and(is_fresh) {
            return;
        }
        let begun = Stopwatch::start();
        if let Ok(tally) = counter_file::tally(root) {
            self.tally = no_less(&self.tally, &tally);
        }
        self.read = Some((Stopwatch::start(), (begun.elapsed() * REST).max(EVERY)));
    }
}

/// Returns the counts of the second reading, but none below the first: a file that could not be read counts as zero.
fn no_less(before: &Tally, now: &Tally) -> Tally {
    let mut most = *now;
    for class in Class::ALL {
        let Counts { sent, delivered, lost, duplicated, overflowed, expired, refused, bytes } = before[class];
        let now = &mut most[class];
        now.sent = now.sent.max(sent);
        now.delivered = now.delivered.max(delivered);
        now.lost = now.lost.max(lost);
        now.duplicated = now.duplicated.max(duplicated);
        now.overflowed = now.overflowed.max(overflowed);
        now.expired = now.expired.max(expired);
        now.refused = now.refused.max(refused);
        now.bytes = now.bytes.max(bytes);
    }
    most
}
