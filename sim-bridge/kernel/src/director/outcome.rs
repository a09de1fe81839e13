//! Outcomes of a run, in the words of reports and exit codes.

use crate::director::reason::{Reason, Why};
use metamorph_core::ids::ModuleId;
use metamorph_core::lattice::Cell;
use metamorph_core::time::Time;
use serde::{Deserialize, Serialize};
use std::fmt;

/// The outcome of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Outcome {
    /// Every goal cell is filled.
    Built,
    /// No module can make progress, goals are unfilled, and no planned event can change that.
    Deadlock,
    /// Modules move, but no goal cell has been filled for longer than the scenario's bound.
    Livelock,
    /// The scenario's time was up.
    Timeout,
    /// An invariant broke.
    Unsafe,
    /// Stopped from outside.
    Aborted,
}

impl Outcome {
    /// All outcomes.
    pub const ALL: [Outcome; 6] = [
        Outcome::Built,
        Outcome::Deadlock,
        Outcome::Livelock,
        Outcome::Timeout,
        Outcome::Unsafe,
        Outcome::Aborted,
    ];

    /// Returns the name used in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Outcome::Built => "built",
            Outcome::Deadlock => "deadlock",
            Outcome::Livelock => "livelock",
            Outcome::Timeout => "timeout",
            Outcome::Unsafe => "unsafe",
            Outcome::Aborted => "aborted",
        }
    }
    /// Returns the exit code of the command. 1 is for failures of the program itself, 2 for bad usage.
    pub const fn exit_code(self) -> u8 {
        match self {
            Outcome::Built => 0,
            Outcome::Deadlock => 3,
            Outcome::Livelock => 4,
            Outcome::Timeout => 5,
            Outcome::Unsafe => 6,
            Outcome::Aborted => 7,
        }
    }
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A module that does not continue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Waiter {
    /// The module.
    pub module: ModuleId,
    /// The module that it waits for, if any.
    pub on: Option<ModuleId>,
    /// The reason.
    pub why: Why,
}

/// The result of exhaustive searches for metamodules at a standstill: the free ones have no sequence of moves
/// after which one more seed is filled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Proof {
    /// The number of reachable arrangements of bodies.
    pub arrangements: usize,
    /// The number of clear places for the goal, at none of which it can be built; `None` if the goal may not be
    /// moved.
    pub places: Option<usize>,
}

/// A part of a goal, such as a cell or a seed to be filled.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Objective {
    /// Its description for people.
    pub text: String,
    /// Its cell, if it is to fill one.
    pub cell: Option<Cell>,
}

impl From<Cell> for Objective {
    fn from(cell: Cell) -> Objective {
        Objective { text: cell.to_string(), cell: Some(cell) }
    }
}

/// A standstill, with the evidence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stall {
    /// Its start.
    pub since: Time,
    /// The reason.
    pub reason: Reason,
    /// The reason in words.
    pub text: &'static str,
    /// The objectives that are not reached: for most families goal cells.
    pub open: Vec<Objective>,
    /// Modules that wait for each other in a circle, if they do.
    pub wait_cycle: Vec<ModuleId>,
    /// Spare modules that have a path to a goal cell and do not take it; of metamodules, all that are free.
    pub waiting: Vec<Waiter>,
    /// When the swarm itself detected the standstill, and which module did; `None` if it did not.
    pub detected: Option<(Time, ModuleId)>,
    /// The proof; `None` if nothing is proved, or if the modules are cubes.
    pub proof: Option<Proof>,
}
