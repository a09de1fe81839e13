//! When a run ends, and how far it has come.

use metamorph_protocol::time::{Span, Time};

/// When a run ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stop {
    /// At this time, whatever happens.
    pub timeout: Time,
    /// Standing still for this long, with nothing planned, is a deadlock.
    pub stall: Span,
    /// Moving for this long without filling a goal cell is a livelock.
    pub livelock: Span,
    /// Until then something is planned that may get a standstill going again, besides faults of the
    /// schedule: the end of the last partition, and of what harms messages.
    pub planned_until: Time,
}

/// How far a run has come.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    /// Which goal is being built, from 0.
    pub stage: u16,
    /// How many goals there are.
    pub stages: u16,
    /// Cells of this goal.
    pub goal: usize,
    /// Cells of it that are filled.
    pub filled: usize,
    /// Processes alive.
    pub alive: usize,
    /// Moves completed.
    pub moves: u64,
    /// Messages sent so far, if the driver can tell; the director cannot.
    pub messages: Option<u64>,
}

/// How a stage ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stage {
    /// Cells of the goal.
    pub cells: usize,
    /// Cells of it that were filled at the end.
    pub filled: usize,
    /// When it was opened.
    pub opened: Time,
    /// When the last cell was filled, by the ground truth.
    pub built: Option<Time>,
    /// When the seed knew, by the swarm's own count.
    pub known: Option<Time>,
}
