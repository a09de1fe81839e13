//! Decides what could still have been done when cubes stand still.

use metamorph_report::prospect::{Possible, Prospect};
use metamorph_report::run_result::Question;
use metamorph_sim_bridge::cube::reachability::{StandstillSnapshot, search, widest_proof};
use metamorph_sim_bridge::director::proof::{Found, RuleSet};

/// Search budget: arrangements of cubes examined, times the number of modules, because larger arrangements
/// take longer.
const EFFORT: usize = 2_000_000;
/// Arrangements examined at most, and the fewest that are worth a search.
const ARRANGEMENTS: (usize, usize) = (20_000, 200);

/// Largest number of arrangements that exploration examines before a standstill stays undecided.
const ARRANGEMENTS_MAX: usize = 20_000;

/// A standstill of cubes, as a question to the search.
pub struct CubeQuestion {
    /// The present state.
    pub now: StandstillSnapshot,
    /// The state in which the last fault left the modules.
    pub before: Option<StandstillSnapshot>,
}

impl Question for CubeQuestion {
    fn prospect(&self) -> Prospect {
        let bound = (EFFORT / self.now.modules.len().max(1)).min(ARRANGEMENTS.0);
        if bound < ARRANGEMENTS.1 {
            return Prospect::UNDECIDED;
        }
        let held = search(&self.now, RuleSet::Held, bound);
        let found = match held {
            // A plan within the protocol's own rules is a plan within all wider rules.
            Found::Way(_) => held,
            _ => search(&self.now, RuleSet::Carried, bound),
        };
        let proved = matches!(held, Found::Impossible(_)).then_some(RuleSet::Held);
        match found {
            Found::Way(moves) => Prospect::new(Possible::Yes(moves), proved),
            Found::Undecided => Prospect::new(Possible::Undecided, proved),
            Found::Impossible(_) => {
                let widest = widest_proof(&self.now, bound).unwrap_or(RuleSet::Carried);
                Prospect::new(Possible::No, Some(widest.max(RuleSet::Carried)))
            }
        }
    }
    fn judge(&self, _: bool) -> Result<RuleSet, Found> {
        widest_proof(&self.now, ARRANGEMENTS_MAX)
    }
    fn could_be_built(&self) -> Option<bool> {
        match search(&self.now, RuleSet::Anything, ARRANGEMENTS_MAX) {
            Found::Way(_) => Some(true),
            Found::Impossible(_) => Some(false),
            Found::Undecided => None,
        }
    }
    fn plan_before(&self) -> Option<usize> {
        let before = self.before.as_ref()?;
        let bound = (EFFORT / before.modules.len().max(1)).min(ARRANGEMENTS.0);
        match search(before, RuleSet::Grown, bound) {
            Found::Way(moves) => Some(moves),
            Found::Impossible(_) | Found::Undecided => None,
        }
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
    use metamorph_sim_bridge::cube::reachability::{ModuleSnapshot, StandstillSnapshot};
    use metamorph_sim_bridge::cube::reasons::PINNED;
    use metamorph_sim_bridge::director::outcome::Stall;
    use metamorph_sim_bridge::director::reason::NO_PATH;
    use metamorph_sim_bridge::director::reason::Reason;

    fn stall(reason: Reason) -> Stall {
        Stall {
            since: Time::ZERO,
            reason,
            text: reason.text,
            open: vec![Cell::new(2, 0, 0).into()],
            wait_cycle: Vec::new(),
            waiting: Vec::new(),
            detected: None,
            proof: None,
        }
    }

    /// A built row of two, and a third module on top of it that has to come down at its end.
    fn snapshot(pinned: bool, stuck: bool) -> CubeQuestion {
        let module = |x, z, finalized: bool| ModuleSnapshot {
            cell: Cell::new(x, 0, z),
            alive: true,
            stuck: stuck && !finalized,
            walker: false,
            finalized,
            held_for_good: false,
            pinned: pinned && !finalized,
            unattached: false,
        };
        let now = StandstillSnapshot {
            modules: vec![module(0, 0, true), module(1, 0, true), module(1, 1, false)],
            goal: (0..3).map(|x| Cell::new(x, 0, 0)).collect(),
            seed: Cell::new(0, 0, 0),
            filled: 2,
            spared_by_live: false,
        };
        CubeQuestion { now, before: None }
    }

    #[test]
    fn a_module_that_holds_on_could_go_if_it_let_go() {
        let found = Prospect::of(&stall(PINNED), Some(&snapshot(true, false)));
        assert!(matches!(found.possible, Possible::Yes(1..)), "{found:?}");
        assert_eq!(found.within, Some(RuleSet::Held));
        assert!(found.text().contains(RuleSet::Held.text()), "{}", found.text());
    }

    #[test]
    fn what_is_possible_is_not_called_impossible_whatever_the_reason() {
        let found = Prospect::of(&stall(NO_PATH), Some(&snapshot(false, false)));
        assert!(matches!(found, Prospect { possible: Possible::Yes(_), within: None, .. }), "{found:?}");
        let found = Prospect::of(&stall(NO_PATH), Some(&snapshot(false, true)));
        assert_eq!(found, Prospect::new(Possible::No, Some(RuleSet::Anything)));
        assert_eq!(Prospect::of(&stall(NO_PATH), None), Prospect::UNDECIDED);
    }
}
