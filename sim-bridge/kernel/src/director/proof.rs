//! Proofs about a standstill: the rules within which a search shows that no plan exists.

use serde::Serialize;
use std::fmt;

/// The rules within which no plan exists.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum RuleSet {
    /// Modules do not release what may hang on them: they cannot know that it is safe.
    Held,
    /// Walkers carry no other module, and the finalized structure stays.
    Carried,
    /// The finalized structure stays.
    Grown,
    /// No restrictions.
    Anything,
}

impl RuleSet {
    /// All sets of rules, the narrowest first.
    pub const ALL: [RuleSet; 4] = [RuleSet::Held, RuleSet::Carried, RuleSet::Grown, RuleSet::Anything];

    /// Returns the name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            RuleSet::Held => "held",
            RuleSet::Carried => "carried",
            RuleSet::Grown => "grown",
            RuleSet::Anything => "anything",
        }
    }
    /// Returns the proof in words, for reports.
    pub const fn text(self) -> &'static str {
        match self {
            RuleSet::Held => "as long as no module lets go of what may hang on it",
            RuleSet::Carried => "as long as walkers carry no other module",
            RuleSet::Grown => "without taking down what is built",
            RuleSet::Anything => "whatever is done",
        }
    }
}

impl fmt::Display for RuleSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.text())
    }
}

/// The result of a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Found {
    /// There is a plan of this number of moves.
    Way(usize),
    /// None of the reachable arrangements, of which this is the number, reaches the goal.
    Impossible(usize),
    /// The search reached its bound before it had a result.
    Undecided,
}
