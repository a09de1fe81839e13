//! Runs a plan with one process per module, over shared memory.

use crate::interrupt::Interrupt;
use crate::report::schema::Report;
use crate::scenario::Plan;
use crate::stopwatch::Stopwatch;
use crate::terminal::Live;
use std::ffi::OsString;
use thiserror::Error;

/// Why processes cannot be run.
#[derive(Debug, Error)]
pub enum ProcessError {
    /// This build has no process link.
    #[error("the process link is not built into this program; use `--link sim`")]
    NotBuiltIn,
}

/// Runs to the end, or until interrupted. `since` is when the program started.
pub fn run_processes(
    _plan: &Plan,
    _interrupt: &Interrupt,
    _live: &mut Live,
    _since: Stopwatch,
) -> Result<Report, ProcessError> {
    Err(ProcessError::NotBuiltIn)
}

/// Removes what killed runs of this user left behind, and says what was removed.
pub fn clean() -> Result<String, ProcessError> {
    Err(ProcessError::NotBuiltIn)
}

/// The life of one agent process, started by [`run_processes`].
pub fn agent(_args: &[OsString]) -> Result<(), ProcessError> {
    Err(ProcessError::NotBuiltIn)
}
