//! Decides what could still have been done when metamodules stand still.

use metamorph_protocol::metamodule::planning::cooperative::{SearchResult, Standstill, WORK, search};
use metamorph_report::prospect::{Possible, Prospect};
use metamorph_report::run_result::Question;
use metamorph_sim_bridge::director::proof::{Found, RuleSet};

/// Divisor of the work: the share that the search for each seed may take from an earlier state, where most plans are found at once.
const BEFORE_DIVISOR: usize = 20;

/// A standstill of metamodules, as a question to the search.
pub struct MetamoduleQuestion {
    /// The present state.
    pub now: Standstill,
    /// The state in which the last fault left the metamodules.
    pub before: Option<Standstill>,
}

impl Question for MetamoduleQuestion {
    fn prospect(&self) -> Prospect {
        // The published strategies are not expected to find every plan.
        if self.now.setup.params.strategy.is_published() {
            return Prospect::UNDECIDED;
        }
        match search(&self.now, WORK) {
            SearchResult::Path(moves) => {
                let moves = moves.iter().filter(|m| m.lands).count();
                Prospect::new(Possible::Yes(moves), None)
            }
            SearchResult::NoWay(_) => Prospect::new(Possible::No, Some(RuleSet::Grown)),
            SearchResult::Undecided => Prospect::UNDECIDED,
        }
    }
    fn judge(&self, misplaced: bool) -> Result<RuleSet, Found> {
        if self.now.setup.params.strategy.is_published() {
            return Err(Found::Undecided);
        }
        match search(&self.now, WORK) {
            SearchResult::Path(moves) => Err(Found::Way(moves.iter().filter(|m| m.lands).count())),
            // The goal may have to be moved; the search covers its current place only.
            SearchResult::NoWay(_) if misplaced => Err(Found::Undecided),
            SearchResult::NoWay(_) => Ok(RuleSet::Grown),
            SearchResult::Undecided => Err(Found::Undecided),
        }
    }
    fn could_be_built(&self) -> Option<bool> {
        let unfilled = self.now.setup.goal(self.now.task).all().without(self.now.filled).len();
        (self.now.free.len() < unfilled).then_some(false)
    }
    fn plan_before(&self) -> Option<usize> {
        if self.now.setup.params.strategy.is_published() {
            return None;
        }
        let mut state = self.before.clone()?;
        let all = state.setup.goal(state.task).all();
        let mut moves = 0;
        // One seed after the other, as metamodules fill them. Another order may succeed where this one does not.
        while state.filled != all {
            let SearchResult::Path(path) = search(&state, WORK / BEFORE_DIVISOR) else { return None };
            moves += path.iter().filter(|m| m.lands).count();
            state = state.after(&path)?;
        }
        Some(moves)
    }
}
