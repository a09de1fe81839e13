//! How a run ended, in the words used by reports and exit codes.

use crate::director::reason::{Reason, Why};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::time::Time;
use serde::{Deserialize, Serialize};
use std::fmt;

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Outcome {
    /// Every goal cell is filled.
    Built,
    /// Nobody can make progress, goals are unfilled, and nothing under way can change that.
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
    /// All of them.
    pub const ALL: [Outcome; 6] = [
        Outcome::Built,
        Outcome::Deadlock,
        Outcome::Livelock,
        Outcome::Timeout,
        Outcome::Unsafe,
        Outcome::Aborted,
    ];

    /// The name used in reports.
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
    /// The exit code of the command. 1 is left for failures of the program itself, 2 for bad usage.
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

/// A module that does not go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Waiter {
    /// Which.
    pub module: ModuleId,
    /// For whom it waits, if it does.
    pub on: Option<ModuleId>,
    /// Why.
    pub why: Why,
}

/// What exhaustive searches have shown of metamodules at a standstill: all that are free have no moves, in any
/// order, after which one more seed is filled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Proof {
    /// The number of arrangements of bodies that can be reached.
    pub arrangements: usize,
    /// The number of places at which the goal cannot be built either, all that there are; none if the goal may
    /// not be moved.
    pub places: Option<usize>,
}

/// A standstill, with the evidence.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stall {
    /// Since when.
    pub since: Time,
    /// Why.
    pub reason: Reason,
    /// Why, in words.
    pub text: &'static str,
    /// Goal cells that are not filled.
    pub unfilled: Vec<Cell>,
    /// Modules that wait for each other in a circle, if they do.
    pub wait_cycle: Vec<ModuleId>,
    /// Spare modules that have a way to a goal cell and do not take it; of metamodules, all that are free.
    pub waiting: Vec<Waiter>,
    /// When the swarm itself found out that nobody can go on, and who did; none if it did not.
    pub detected: Option<(Time, ModuleId)>,
    /// What is proved of it; none if nothing is, or if it is one of cubes.
    pub proof: Option<Proof>,
}
