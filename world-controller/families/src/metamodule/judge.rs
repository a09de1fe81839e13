//! Decides what could still have been done when metamodules stand still.

use metamorph_protocol::metamodule::planning::cooperative::{SearchResult, Standstill, WORK, search};
use metamorph_report::prospect::{Possible, Prospect};
use metamorph_report::run_result::Question;
use metamorph_sim_bridge::director::proof::{Found, RuleSet};

/// A standstill of metamodules, as a question to the search.
pub struct MetamoduleQuestion(pub Standstill);

impl Question for MetamoduleQuestion {
    fn prospect(&self) -> Prospect {
        // The published strategies are not expected to find every plan.
        if self.0.setup.params.strategy.is_published() {
            return Prospect::UNDECIDED;
        }
        match search(&self.0, WORK) {
            SearchResult::Path(moves) => {
                let moves = moves.iter().filter(|m| m.lands).count();
                Prospect { possible: Possible::Yes(moves), within: None }
            }
            SearchResult::NoWay(_) => Prospect { possible: Possible::No, within: Some(RuleSet::Grown) },
            SearchResult::Undecided => Prospect::UNDECIDED,
        }
    }
    fn judge(&self, misplaced: bool) -> Result<RuleSet, Found> {
        if self.0.setup.params.strategy.is_published() {
            return Err(Found::Undecided);
        }
        match search(&self.0, WORK) {
            SearchResult::Path(moves) => Err(Found::Way(moves.iter().filter(|m| m.lands).count())),
            // The goal may have to be moved; the search covers its current place only.
            SearchResult::NoWay(_) if misplaced => Err(Found::Undecided),
            SearchResult::NoWay(_) => Ok(RuleSet::Grown),
            SearchResult::Undecided => Err(Found::Undecided),
        }
    }
    fn could_be_built(&self) -> Option<bool> {
        let unfilled = self.0.setup.goal(self.0.task).all().without(self.0.filled).len();
        (self.0.free.len() < unfilled).then_some(false)
    }
}
