//! What the world and the director of a run know when it is over, in the form that reports are made of.

use crate::report::prospect::Prospect;
use crate::report::schema::{MetamoduleReport, MoveReport, StageReport};
use metamorph_protocol::time::Time;
use metamorph_sim_bridge::director::faults::Struck;
use metamorph_sim_bridge::director::outcome::{Outcome, Stall};
use metamorph_sim_bridge::director::progress::Progress;
use metamorph_sim_bridge::director::proof::{Found, Within};

/// A standstill as a question for a search: what could still have been done?
pub trait Question {
    /// Searches for the report of a run.
    fn prospect(&self) -> Prospect;
    /// The widest rules within which it is proved that nothing could have been done; or else what a search
    /// found. `misplaced` is whether more may be possible with the goal at another place.
    fn judge(&self, misplaced: bool) -> Result<Within, Found>;
    /// Whether modules that nothing has broken are to blame if nothing can be done any more, because they
    /// have brought themselves there.
    fn blames_whole_modules(&self) -> bool {
        false
    }
}

/// What director and world of a run know when it is over, whatever the family.
pub struct RunResult {
    /// How the run ended; none if it was stopped from outside.
    pub ended: Option<(Time, Outcome)>,
    /// How far it came.
    pub progress: Progress,
    /// Processes that died.
    pub crashed: u64,
    /// Processes that were started again.
    pub restarted: u64,
    /// Why it stood still.
    pub stall: Option<Stall>,
    /// The same as a question for a search.
    pub plight: Option<Box<dyn Question>>,
    /// What each fault did.
    pub struck: Vec<Struck>,
    /// Collisions prevented between modules, by negotiation or locks.
    pub prevented: u64,
    /// Every goal that was begun.
    pub stages: Vec<StageReport>,
    /// What became of what bodies were asked to do.
    pub bodies: MoveReport,
    /// What only metamodules have.
    pub metamodules: Option<MetamoduleReport>,
}
