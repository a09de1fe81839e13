//! Decides whether a run that stood still could have gone on: what is proved, not what a reason suggests.
//!
//! A diagnosis says what stops each module. Whether all of them together could have made progress is decided
//! by a search, which ends with a proof, with a plan, or at its bound.

use crate::run_result::Question;
use metamorph_kernel::director::outcome::Stall;
use metamorph_kernel::director::proof::RuleSet;
use metamorph_kernel::director::reason::Proves;

/// The result for one standstill.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Prospect {
    /// Whether modules that nothing holds in place could have filled more of the goal.
    pub possible: Possible,
    /// The widest rules under which progress is proved impossible.
    pub within: Option<RuleSet>,
    /// The moves of a plan for the whole goal from where the last fault left the modules, if there was one and it is proved that there
    /// is none any more: the modules blocked themselves.
    pub before: Option<usize>,
}

/// The result of a search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Possible {
    /// A plan of this many moves exists.
    Yes(usize),
    /// Proved impossible.
    No,
    /// The search reached its bound, or was not made.
    Undecided,
}

impl Possible {
    /// Returns the name used in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Possible::Yes(_) => "yes",
            Possible::No => "no",
            Possible::Undecided => "undecided",
        }
    }
}

impl Prospect {
    /// The result if nothing is known.
    pub const UNDECIDED: Prospect = Prospect::new(Possible::Undecided, None);

    /// Creates the result of a search that did not look at an earlier state.
    pub const fn new(possible: Possible, within: Option<RuleSet>) -> Prospect {
        Prospect { possible, within, before: None }
    }

    /// Decides what could have been done; without a search if `question` is `None`.
    pub fn of(stall: &Stall, question: Option<&dyn Question>) -> Prospect {
        let prospect = Prospect::now(stall, question);
        let is_proved = prospect.possible == Possible::No && prospect.within >= Some(RuleSet::Grown);
        Prospect { before: question.filter(|_| is_proved).and_then(Question::plan_before), ..prospect }
    }

    fn now(stall: &Stall, question: Option<&dyn Question>) -> Prospect {
        match question {
            // A counting argument: modules that cannot move, or are in goal cells already, fill no others.
            _ if stall.reason.proves == Proves::Counted => {
                Prospect::new(Possible::No, Some(RuleSet::Anything))
            }
            // Another placement of the goal may allow more.
            _ if stall.reason.proves == Proves::NotHere => Prospect::UNDECIDED,
            // The director has searched already.
            _ if stall.proof.is_some() => Prospect::new(Possible::No, Some(RuleSet::Grown)),
            Some(question) => question.prospect(),
            None => Prospect::UNDECIDED,
        }
    }

    /// Describes the result.
    pub fn text(&self) -> String {
        match (self.possible, self.within) {
            (Possible::No, within) => {
                let within = within.unwrap_or(RuleSet::Carried).text();
                let before = self.before.map_or(String::new(), |moves| {
                    format!("; where the last fault left the modules a plan existed, of {}", plural(moves))
                });
                format!("proved: nothing more can be filled {within}{before}")
            }
            (Possible::Yes(moves), Some(within)) => format!(
                "proved: nothing more can be filled {within}; otherwise a plan exists, of {}",
                plural(moves)
            ),
            (Possible::Yes(0), None) => {
                "it could have gone on without a move: a module stands in the next cell, and only had to be finalized".to_owned()
            }
            (Possible::Yes(moves), None) => {
                format!("it could have gone on: a plan exists, of {}", plural(moves))
            }
            (Possible::Undecided, Some(within)) => {
                format!("proved: nothing more can be filled {within}; whether otherwise is not decided")
            }
            (Possible::Undecided, None) => "whether it could have gone on is not decided".to_owned(),
        }
    }
}

fn plural(moves: usize) -> String {
    if moves == 1 { "1 move".to_owned() } else { format!("{moves} moves") }
}
