//! Whether a run that stood still could have gone on: what is proved, and not what a reason suggests.
//!
//! A diagnosis names what one module after the other runs into. Whether all of them together could have
//! done something is decided by a search, which ends with a proof, with a way, or at its bound.

use crate::report::run_result::Question;
use metamorph_protocol::metamodule::params::Strategy;
use metamorph_protocol::metamodule::planning::cooperative::{self, Sought, WORK};
use metamorph_sim_bridge::cube::reachability::{Found, Within, search, widest_proof};
use metamorph_sim_bridge::director::outcome::{Reason, Stall};

/// Arrangements of cubes that are looked at, times the number of modules; one of many modules takes longer.
const EFFORT: usize = 2_000_000;
/// The most arrangements, and the least that are worth a search.
const ARRANGEMENTS: (usize, usize) = (20_000, 200);

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
    const UNDECIDED: Prospect = Prospect { possible: Possible::Undecided, within: None };

    /// Finds out what could have been done; without a search if there is no question.
    pub fn of(stall: &Stall, question: Option<&Question>) -> Prospect {
        match question {
            // Counted: modules that cannot move, or are in goal cells already, fill no others.
            _ if stall.reason == Reason::MaterialExhausted => {
                Prospect { possible: Possible::No, within: Some(Within::Anything) }
            }
            // At another place more may be possible.
            _ if stall.reason == Reason::Misplaced => Prospect::UNDECIDED,
            // The director has searched already.
            _ if stall.proof.is_some() => Prospect { possible: Possible::No, within: Some(Within::Grown) },
            Some(Question::Cubes(plight)) => {
                let bound = (EFFORT / plight.modules.len().max(1)).min(ARRANGEMENTS.0);
                if bound < ARRANGEMENTS.1 {
                    return Prospect::UNDECIDED;
                }
                let held = search(plight, Within::Held, bound);
                let found = match held {
                    // What the protocol allows itself, everybody may do.
                    Found::Way(_) => held,
                    _ => search(plight, Within::Called, bound),
                };
                let proved = matches!(held, Found::Impossible(_)).then_some(Within::Held);
                match found {
                    Found::Way(moves) => Prospect { possible: Possible::Yes(moves), within: proved },
                    Found::Undecided => Prospect { possible: Possible::Undecided, within: proved },
                    Found::Impossible(_) => {
                        let widest = widest_proof(plight, bound).unwrap_or(Within::Called);
                        Prospect { possible: Possible::No, within: Some(widest.max(Within::Called)) }
                    }
                }
            }
            Some(Question::Metamodules(plight)) if plight.setup.params.strategy == Strategy::Negotiated => {
                match cooperative::search(plight, WORK) {
                    Sought::Way(moves) => {
                        let moves = moves.iter().filter(|m| m.lands).count();
                        Prospect { possible: Possible::Yes(moves), within: None }
                    }
                    Sought::NoWay(_) => Prospect { possible: Possible::No, within: Some(Within::Grown) },
                    Sought::Undecided => Prospect::UNDECIDED,
                }
            }
            _ => Prospect::UNDECIDED,
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

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::lattice::Cell;
    use metamorph_protocol::time::Time;
    use metamorph_sim_bridge::cube::reachability::{Plight, Standing};

    fn stall(reason: Reason) -> Stall {
        Stall {
            since: Time::ZERO,
            reason,
            text: reason.text(),
            unfilled: vec![Cell::new(2, 0, 0)],
            wait_cycle: Vec::new(),
            waiting: Vec::new(),
            detected: None,
            proof: None,
        }
    }

    /// A row of two that is built, and a third on top of it that is to come down at its end.
    fn plight(pinned: bool, stuck: bool) -> Question {
        let module = |x, z, finalized: bool| Standing {
            cell: Cell::new(x, 0, z),
            alive: true,
            stuck: stuck && !finalized,
            walker: false,
            finalized,
            pinned: pinned && !finalized,
        };
        Question::Cubes(Plight {
            modules: vec![module(0, 0, true), module(1, 0, true), module(1, 1, false)],
            goal: (0..3).map(|x| Cell::new(x, 0, 0)).collect(),
            filled: 2,
            spared_by_live: false,
        })
    }

    #[test]
    fn a_module_that_holds_on_could_go_if_it_let_go() {
        let found = Prospect::of(&stall(Reason::Pinned), Some(&plight(true, false)));
        assert!(matches!(found.possible, Possible::Yes(1..)), "{found:?}");
        assert_eq!(found.within, Some(Within::Held));
        assert!(found.text().contains("as long as nobody lets go"), "{}", found.text());
    }

    #[test]
    fn what_is_possible_is_not_called_impossible_whatever_the_reason() {
        let found = Prospect::of(&stall(Reason::NoWay), Some(&plight(false, false)));
        assert!(matches!(found, Prospect { possible: Possible::Yes(_), within: None }), "{found:?}");
        let found = Prospect::of(&stall(Reason::NoWay), Some(&plight(false, true)));
        assert_eq!(found, Prospect { possible: Possible::No, within: Some(Within::Anything) });
        assert_eq!(Prospect::of(&stall(Reason::NoWay), None), Prospect::UNDECIDED);
    }
}
