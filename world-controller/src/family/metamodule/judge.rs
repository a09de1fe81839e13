//! Decides what could still have been done when metamodules stand still.

use crate::report::prospect::{Possible, Prospect};
use crate::report::run_result::Question;
use metamorph_protocol::metamodule::params::Strategy;
use metamorph_protocol::metamodule::planning::cooperative::{Sought, Standstill, WORK, search};
use metamorph_sim_bridge::director::proof::{Found, Within};

impl Question for Standstill {
    fn prospect(&self) -> Prospect {
        // The published strategies are not expected to find every plan.
        if self.setup.params.strategy != Strategy::Negotiated {
            return Prospect::UNDECIDED;
        }
        match search(self, WORK) {
            Sought::Way(moves) => {
                let moves = moves.iter().filter(|m| m.lands).count();
                Prospect { possible: Possible::Yes(moves), within: None }
            }
            Sought::NoWay(_) => Prospect { possible: Possible::No, within: Some(Within::Grown) },
            Sought::Undecided => Prospect::UNDECIDED,
        }
    }
    fn judge(&self, misplaced: bool) -> Result<Within, Found> {
        if self.setup.params.strategy != Strategy::Negotiated {
            return Err(Found::Undecided);
        }
        match search(self, WORK) {
            Sought::Way(moves) => Err(Found::Way(moves.iter().filter(|m| m.lands).count())),
            // The goal may have to be moved; the search covers its current place only.
            Sought::NoWay(_) if misplaced => Err(Found::Undecided),
            Sought::NoWay(_) => Ok(Within::Grown),
            Sought::Undecided => Err(Found::Undecided),
        }
    }
}
