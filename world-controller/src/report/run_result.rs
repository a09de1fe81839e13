//! What the world and the director of a run know when it is over, in the form that reports are made of.

use crate::report::schema::{MetamoduleReport, MoveReport, StageReport};
use metamorph_protocol::metamodule::planning::cooperative::Standstill;
use metamorph_protocol::time::Time;
use metamorph_sim_bridge::cube::director::Progress;
use metamorph_sim_bridge::cube::reachability::Plight;
use metamorph_sim_bridge::director::faults::Struck;
use metamorph_sim_bridge::director::outcome::{Outcome, Stall};

/// A standstill as a question for a search: what could still have been done?
#[derive(Clone, Debug)]
pub enum Question {
    /// Of cubes.
    Cubes(Plight),
    /// Of metamodules.
    Metamodules(Standstill),
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
    pub plight: Option<Question>,
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
