//! What could still have been done when cubes stand still.

use crate::report::prospect::{Possible, Prospect};
use crate::report::run_result::Question;
use metamorph_sim_bridge::cube::reachability::{Plight, search, widest_proof};
use metamorph_sim_bridge::director::proof::{Found, Within};

/// Arrangements of cubes that are looked at, times the number of modules; one of many modules takes longer.
const EFFORT: usize = 2_000_000;
/// The most arrangements, and the least that are worth a search.
const ARRANGEMENTS: (usize, usize) = (20_000, 200);

/// The most arrangements that exploration looks at before it stays undecided what could be built.
const EXPLORED: usize = 20_000;

impl Question for Plight {
    fn prospect(&self) -> Prospect {
        let bound = (EFFORT / self.modules.len().max(1)).min(ARRANGEMENTS.0);
        if bound < ARRANGEMENTS.1 {
            return Prospect::UNDECIDED;
        }
        let held = search(self, Within::Held, bound);
        let found = match held {
            // What the protocol allows itself, everybody may do.
            Found::Way(_) => held,
            _ => search(self, Within::Called, bound),
        };
        let proved = matches!(held, Found::Impossible(_)).then_some(Within::Held);
        match found {
            Found::Way(moves) => Prospect { possible: Possible::Yes(moves), within: proved },
            Found::Undecided => Prospect { possible: Possible::Undecided, within: proved },
            Found::Impossible(_) => {
                let widest = widest_proof(self, bound).unwrap_or(Within::Called);
                Prospect { possible: Possible::No, within: Some(widest.max(Within::Called)) }
            }
        }
    }
    fn judge(&self, _: bool) -> Result<Within, Found> {
        widest_proof(self, EXPLORED)
    }
    fn blames_whole_modules(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::lattice::Cell;
    use metamorph_protocol::time::Time;
    use metamorph_sim_bridge::cube::reachability::{Plight, Standing};
    use metamorph_sim_bridge::cube::reasons::PINNED;
    use metamorph_sim_bridge::director::outcome::Stall;
    use metamorph_sim_bridge::director::reason::NO_WAY;
    use metamorph_sim_bridge::director::reason::Reason;

    fn stall(reason: Reason) -> Stall {
        Stall {
            since: Time::ZERO,
            reason,
            text: reason.text,
            unfilled: vec![Cell::new(2, 0, 0)],
            wait_cycle: Vec::new(),
            waiting: Vec::new(),
            detected: None,
            proof: None,
        }
    }

    /// A row of two that is built, and a third on top of it that is to come down at its end.
    fn plight(pinned: bool, stuck: bool) -> Plight {
        let module = |x, z, finalized: bool| Standing {
            cell: Cell::new(x, 0, z),
            alive: true,
            stuck: stuck && !finalized,
            walker: false,
            finalized,
            pinned: pinned && !finalized,
        };
        Plight {
            modules: vec![module(0, 0, true), module(1, 0, true), module(1, 1, false)],
            goal: (0..3).map(|x| Cell::new(x, 0, 0)).collect(),
            filled: 2,
            spared_by_live: false,
        }
    }

    #[test]
    fn a_module_that_holds_on_could_go_if_it_let_go() {
        let found = Prospect::of(&stall(PINNED), Some(&plight(true, false)));
        assert!(matches!(found.possible, Possible::Yes(1..)), "{found:?}");
        assert_eq!(found.within, Some(Within::Held));
        assert!(found.text().contains("as long as no module lets go"), "{}", found.text());
    }

    #[test]
    fn what_is_possible_is_not_called_impossible_whatever_the_reason() {
        let found = Prospect::of(&stall(NO_WAY), Some(&plight(false, false)));
        assert!(matches!(found, Prospect { possible: Possible::Yes(_), within: None }), "{found:?}");
        let found = Prospect::of(&stall(NO_WAY), Some(&plight(false, true)));
        assert_eq!(found, Prospect { possible: Possible::No, within: Some(Within::Anything) });
        assert_eq!(Prospect::of(&stall(NO_WAY), None), Prospect::UNDECIDED);
    }
}
