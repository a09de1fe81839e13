//! How a run ended, in the words used by reports and exit codes.

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

/// Why nothing goes on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reason {
    /// A spare module could walk to a goal cell, but does not: the protocol's fault.
    Blocked,
    /// Every spare module that could walk holds a dead or stuck one and must stay, or waits for one
    /// that does.
    Pinned,
    /// Every spare module that could walk is cut off from the growth by dead ones, since messages pass only
    /// between neighbours that live.
    CutOff,
    /// There are fewer live spare modules that can move than cells to fill.
    MaterialExhausted,
    /// No live finalized module touches an unfilled goal cell that it could start.
    NoActiveTarget,
    /// Metamodules: something that stays is in a cell of an unfilled seed.
    SeedBlocked,
    /// Metamodules: nobody that is free has a better place to go to. A local minimum of the field.
    NoBetterPlace,
    /// Metamodules: somebody that is free has a better place to go to, but does not get the way.
    NoLock,
    /// The only ways to goal cells lead over dead modules.
    NeedsDeadSupport,
    /// No way leads to a goal cell, even over dead modules.
    NoWay,
    /// Metamodules: nothing more is built where the goal is, which may be moved, and it is not proved that it
    /// could not be built elsewhere.
    Misplaced,
}

impl Reason {
    /// All of them.
    pub const ALL: [Reason; 10] = [
        Reason::Blocked,
        Reason::Pinned,
        Reason::CutOff,
        Reason::MaterialExhausted,
        Reason::NoActiveTarget,
        Reason::SeedBlocked,
        Reason::NoBetterPlace,
        Reason::NoLock,
        Reason::NeedsDeadSupport,
        Reason::NoWay,
    ];

    /// The name used in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Reason::Blocked => "blocked",
            Reason::Pinned => "pinned",
            Reason::CutOff => "cut-off",
            Reason::MaterialExhausted => "material-exhausted",
            Reason::NoActiveTarget => "no-active-target",
            Reason::SeedBlocked => "seed-blocked",
            Reason::NoBetterPlace => "no-better-place",
            Reason::NoLock => "no-lock",
            Reason::NeedsDeadSupport => "needs-dead-support",
            Reason::NoWay => "no-way",
            Reason::Misplaced => "misplaced",
        }
    }
    /// Whether no module could have gone on as the others stand, so that it is no fault of a module that it
    /// did not. That nothing could be done at all takes a search (`feasible`) to prove.
    pub const fn is_infeasible(self) -> bool {
        !matches!(
            self,
            Reason::Blocked
                | Reason::Pinned
                | Reason::CutOff
                | Reason::NoBetterPlace
                | Reason::NoLock
                | Reason::Misplaced
        )
    }
    /// For people.
    pub const fn text(self) -> &'static str {
        match self {
            Reason::Blocked => "deadlock: a spare module has a way to a goal cell and does not take it",
            Reason::Pinned => {
                "pinned: every spare module that has a way holds a dead or stuck module, or waits for one that does"
            }
            Reason::CutOff => {
                "cut off: dead modules separate every spare module that has a way from those that could call it"
            }
            Reason::SeedBlocked => {
                "seed blocked: something that cannot move is in a cell of an unfilled seed"
            }
            Reason::NoBetterPlace => {
                "deadlock: no free metamodule can get to a place that the force field prefers to its own"
            }
            Reason::NoLock => "deadlock: a free metamodule is refused the way to a better place",
            Reason::MaterialExhausted => {
                "material exhausted: fewer live spare modules than goal cells to fill"
            }
            Reason::NoActiveTarget => {
                "no active target: no live finalized module can start one of the unfilled goal cells"
            }
            Reason::NeedsDeadSupport => {
                "needs dead support: every way that a module could walk to a goal cell leads over dead ones"
            }
            Reason::NoWay => {
                "no way: no module could walk to a goal cell while the others stay where they are"
            }
            Reason::Misplaced => {
                "misplaced: nothing more is built where the goal is now, and it may be possible at another place"
            }
        }
    }
}

/// Why a module that is free does not go on, as far as it has told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Why {
    /// Its joints do not turn.
    Immobile,
    /// Cubes: it has no parent that it could leave.
    Unattached,
    /// Cubes: it holds a module that seems dead.
    HoldsDead,
    /// It waits for somebody that is dead.
    WaitsForDead,
    /// It waits for somebody: its child, whoever has locked it, has refused it, or stands in its way.
    Waits,
    /// Cubes: no distance to a goal cell reaches it.
    HearsOfNoTarget,
    /// Metamodules: it knows no way to any open seed.
    Barred,
    /// Metamodules: no place that it can get to is better than its own.
    NoBetterPlace,
    /// Nothing that it has told holds it.
    Unknown,
}

impl Why {
    /// For people, after the name of the module.
    pub const fn text(self) -> &'static str {
        match self {
            Why::Immobile => "cannot turn its joints",
            Why::Unattached => "has no parent in the forest",
            Why::HoldsDead => "holds a module that seems dead",
            Why::WaitsForDead => "waits for a dead module",
            Why::Waits => "waits",
            Why::HearsOfNoTarget => "hears of no goal cell",
            Why::Barred => "knows no way to an open seed",
            Why::NoBetterPlace => "has no better place to go to",
            Why::Unknown => "does not move, for no reason that it has told",
        }
    }
}

/// A module that does not go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
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
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
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
