//! One run: simulated, on processes, or replayed from a journal.

pub mod machine;
pub mod processes;
pub mod replay;
pub mod simulated;

use crate::control::SharedQueue;
use metamorph_console::shutdown::Shutdown;
use metamorph_sim_bridge::kernel::recording::Log;

/// Channels between a run and the page that shows it; none by default.
#[derive(Clone, Default)]
pub struct PageChannels {
    /// Takes what happens in the run.
    pub scribe: Option<Log>,
    /// Has the commands of operators, if the run can be controlled.
    pub control: Option<SharedQueue>,
    /// Asks a run of processes to end.
    pub shutdown: Shutdown,
}
