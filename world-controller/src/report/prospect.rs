//! Whether a run that stood still could have gone on: what is proved, and not what a reason suggests.
//!
//! A diagnosis names what one module after the other runs into. Whether all of them together could have
//! done something is decided by a search, which ends with a proof, with a way, or at its bound.

use crate::report::run_result::Question;
use metamorph_sim_bridge::director::outcome::Stall;
use metamorph_sim_bridge::director::proof::Within;
use metamorph_sim_bridge::director::reason::Proves;

/// Whether a run could have gone on from where it stood still.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Prospect {
    /// Whether live modules that can hear of the goal could have filled more of it.
    pub possible: Possible,
    /// The widest rules within which it is proved that nothing could have been done.
    pub within: Option<Within>,
}

/// What a search came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Possible {
    /// There is a way, of so many moves.
    Yes(usize),
    /// Proved impossible.
    No,
    /// The search reached its bound, or there was none.
    Undecided,
}

impl Possible {
    /// The name in reports.
    pub const fn name(self) -> &'static str {
        match self {
            Possible::Yes(_) => "yes",
            Possible::No => "no",
            Possible::Undecided => "undecided",
        }
    }
}

impl Prospect {
    /// Nothing is known.
    pub const UNDECIDED: Prospect = Prospect { possible: Possible::Undecided, within: None };

    /// Finds out what could have been done; without a search if there is no question.
    pub fn of(stall: &Stall, question: Option<&dyn Question>) -> Prospect {
        match question {
            // Counted: modules that cannot move, or are in goal cells already, fill no others.
            _ if stall.reason.proves == Proves::Counted => {
                Prospect { possible: Possible::No, within: Some(Within::Anything) }
            }
            // At another place more may be possible.
            _ if stall.reason.proves == Proves::NotHere => Prospect::UNDECIDED,
            // The director has searched already.
            _ if stall.proof.is_some() => Prospect { possible: Possible::No, within: Some(Within::Grown) },
            Some(question) => question.prospect(),
            None => Prospect::UNDECIDED,
        }
    }

    /// For people.
    pub fn text(&self) -> String {
        match (self.possible, self.within) {
            (Possible::No, within) => {
                let within = within.unwrap_or(Within::Called).text();
                format!("proved: nothing more can be filled {within}")
            }
            (Possible::Yes(moves), Some(within)) => format!(
                "proved: nothing more can be filled {within}; otherwise there is a way, of {}",
                plural(moves)
            ),
            (Possible::Yes(moves), None) => {
                format!("it could have gone on: there is a way, of {}", plural(moves))
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
