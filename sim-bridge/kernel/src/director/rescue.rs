//! The help that a controller gives to a swarm that stands still: which kinds it may give, and how much it has given.

use serde::{Deserialize, Serialize};
use std::fmt;

/// How far the controller helps a broken swarm that stands still. Each level includes the one before.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Rescue {
    /// Not at all: what the run measures is the local protocol alone.
    Off,
    /// It calls single modules to unfilled cells of the goal. A called module still checks and negotiates each move.
    Calls,
    /// If calls do not help, it also moves one module after the other by a plan for the whole swarm.
    #[default]
    Plans,
}

impl Rescue {
    /// All levels, the least help first.
    pub const ALL: [Rescue; 3] = [Rescue::Off, Rescue::Calls, Rescue::Plans];

    /// Returns the name used in scenarios and reports.
    pub const fn name(self) -> &'static str {
        match self {
            Rescue::Off => "off",
            Rescue::Calls => "calls",
            Rescue::Plans => "plans",
        }
    }
}

impl fmt::Display for Rescue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The numbers of moves that a controller has brought about.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Help {
    /// Moves of called modules.
    pub called: u64,
    /// Moves that were led by a plan for the whole swarm.
    pub led: u64,
}

impl Help {
    /// Returns the help given since an earlier state.
    pub fn since(self, before: Help) -> Help {
        Help { called: self.called.saturating_sub(before.called), led: self.led.saturating_sub(before.led) }
    }
    /// Returns the number of all these moves.
    pub fn moves(self) -> u64 {
        self.called + self.led
    }
}
