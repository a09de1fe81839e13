//! The conditions that end a run, and its progress.

use metamorph_core::time::{Span, Time};

/// The conditions that end a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stop {
    /// The time at which it ends in any case.
    pub timeout: Time,
    /// Without moves for this long, and without planned events, a run is a deadlock.
    pub stall: Span,
    /// With moves but without a filled goal cell for this long, a run is a livelock.
    pub livelock: Span,
    /// The end of planned events that may resolve a standstill, besides faults of the schedule: the last
    /// partition, and impairments of messages.
    pub planned_until: Time,
}

/// The progress of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Progress {
    /// The goal that is being built, from 0.
    pub stage: u16,
    /// The number of goals.
    pub stages: u16,
    /// The number of cells of this goal.
    pub goal: usize,
    /// The number of its cells that are filled.
    pub filled: usize,
    /// The number of live processes.
    pub alive: usize,
    /// The number of moves completed.
    pub moves: u64,
    /// The number of standstills so far, with one that lasts.
    pub standstills: u64,
    /// The number of processes restarted.
    pub restarts: u64,
    /// The number of messages sent so far, if the driver counts them.
    pub messages: Option<u64>,
}

/// The result of building one goal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stage {
    /// The number of cells of the goal.
    pub cells: usize,
    /// The number of its cells that were filled at the end.
    pub filled: usize,
    /// When the goal was opened.
    pub opened: Time,
    /// When the last cell was filled, by the ground truth.
    pub built: Option<Time>,
    /// When the module in the seed knew that all cells were filled, by the swarm's own count.
    pub known: Option<Time>,
}

impl Stage {
    /// Creates the entry of a goal of this many cells that has just been opened.
    pub fn opened(cells: usize, now: Time) -> Stage {
        Stage { cells, filled: 0, opened: now, built: None, known: None }
    }
}
