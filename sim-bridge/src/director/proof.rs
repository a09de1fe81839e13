//! What a search of a standstill can prove: within which rules nothing could have been done.

use serde::Serialize;
use std::fmt;

/// Within which rules nothing could have been done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Within {
    /// What the protocol holds on to stays: nobody can know that it is safe to let go.
    Held,
    /// Modules move over live ones that can hear of the goal, and what is built stays.
    Called,
    /// What is built stays.
    Grown,
    /// Whatever is done.
    Anything,
}

impl Within {
    /// All of them, the narrowest first.
    pub const ALL: [Within; 4] = [Within::Held, Within::Called, Within::Grown, Within::Anything];

    /// The name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Within::Held => "held",
            Within::Called => "called",
            Within::Grown => "grown",
            Within::Anything => "anything",
        }
    }
    /// For people: what was proved.
    pub const fn text(self) -> &'static str {
        match self {
            Within::Held => "as long as nobody lets go of what may hang on it",
            Within::Called => "by live modules that can hear of it",
            Within::Grown => "without taking down what is built",
            Within::Anything => "whatever is done",
        }
    }
}

impl fmt::Display for Within {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.text())
    }
}

/// What a search came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Found {
    /// There is a way, of so many moves.
    Way(usize),
    /// Every arrangement that can be reached was seen, so many, and none is the goal.
    Impossible(usize),
    /// The bound was reached first.
    Undecided,
}
