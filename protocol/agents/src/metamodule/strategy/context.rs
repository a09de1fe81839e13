//! The interface between a metamodule and its strategy: what a strategy works with, and what it decides.

use crate::metamodule::outbox::Outbox;
use crate::metamodule::plan::Plan;
use crate::metamodule::view::View;
use metamorph_core::ids::ModuleId;
use metamorph_core::time::Time;

/// Gives a strategy access to the metamodule in one step.
pub(in crate::metamodule) struct Context<'a> {
    pub v: View<'a>,
    pub out: &'a mut Outbox,
    /// Since when the metamodule has made no progress.
    pub waiting_since: &'a mut Time,
}

/// Tells the metamodule how to continue.
pub(in crate::metamodule) enum Decision {
    /// It asks for the lock of this motion.
    Ask(Plan),
    /// It looks again at this time.
    Wait(Time),
    /// It looks again at this time. Until then it waits for this neighbour; `None` if it waits for no particular one.
    WaitFor(Option<ModuleId>, Time),
}
