//! One run: simulated, on processes, or replayed from a journal.

pub mod machine;
pub mod processes;
pub mod replay;
pub mod simulated;

use crate::control::SharedQueue;
use crate::metrics::Metrics;
use metamorph_console::shutdown::Shutdown;
use metamorph_sim_bridge::kernel::recording::Log;

/// Channels between a run and those who follow it: the page, and scrapers of metrics; none by default.
#[derive(Clone, Default)]
pub struct PageChannels {
    /// Takes what happens in the run.
    pub scribe: Option<Log>,
    /// Has the commands of operators, if the run can be controlled.
    pub control: Option<SharedQueue>,
    /// Takes note of numbers of the run, if they are served.
    pub metrics: Option<Metrics>,
    /// Asks a run of processes to end.
    pub shutdown: Shutdown,
}
