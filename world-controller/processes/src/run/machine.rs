//! The machine, as reports describe it.

use metamorph_console::stopwatch::Stopwatch;
use metamorph_families::simulated::Machine;
use std::sync::{Arc, OnceLock};
use std::time::Duration;

/// This machine, with a stopwatch that was started with the program.
#[derive(Clone, Copy, Debug)]
pub struct RealMachine(Stopwatch);

impl RealMachine {
    /// Returns this machine; `since` was started with the program.
    pub fn since(since: Stopwatch) -> Arc<dyn Machine> {
        Arc::new(RealMachine(since))
    }
}

impl Machine for RealMachine {
    fn elapsed(&self) -> Duration {
        self.0.elapsed()
    }
    fn cores(&self) -> u64 {
        cores()
    }
}

/// Returns the number of processors available. Cached: the query takes as long as a short run.
pub fn cores() -> u64 {
    static CORES: OnceLock<u64> = OnceLock::new();
    *CORES.get_or_init(|| std::thread::available_parallelism().map_or(1, |n| n.get() as u64))
}
