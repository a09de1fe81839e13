//! The results of world and director at the end of a run, from which reports are made.

use crate::family_part::FamilyPart;
use crate::operator::OperatorReport;
use crate::prospect::Prospect;
use crate::schema::{MoveReport, StageReport};
use metamorph_core::time::Time;
use metamorph_kernel::director::faults::FaultRecord;
use metamorph_kernel::director::monitor::RunMonitor;
use metamorph_kernel::director::outcome::{Outcome, Stall};
use metamorph_kernel::director::progress::Progress;
use metamorph_kernel::director::proof::{Found, RuleSet};
use metamorph_kernel::director::standstills::Standstills;

/// A standstill as a search problem: what could still have been done?
pub trait Question {
    /// Searches for a way to continue, and returns the result for the report of a run.
    fn prospect(&self) -> Prospect;
    /// Returns the widest rules under which progress is proved impossible, or else the search's result.
    /// `misplaced` says whether more may be possible with the goal at another place.
    fn judge(&self, misplaced: bool) -> Result<RuleSet, Found>;
    /// Returns whether any robot with these modules could have built the whole goal; `None` if the search does
    /// not decide it.
    fn could_be_built(&self) -> Option<bool> {
        None
    }
    /// Returns the number of moves of a plan by which the goal could have been built from where the last fault left the modules, or
    /// from the start if there was none; `None` if a search finds no plan.
    fn plan_before(&self) -> Option<usize> {
        None
    }
    /// Returns true if a standstill in which nothing was broken or restarted is the fault of the modules even
    /// when nothing can be done any more, because they brought themselves there.
    fn blames_whole_modules(&self) -> bool {
        false
    }
}

/// The results of director and world at the end of a run, for any family.
pub struct RunResult {
    /// Time and outcome; `None` if the run was interrupted.
    pub ended: Option<(Time, Outcome)>,
    /// The progress at the end.
    pub progress: Progress,
    /// Processes that died.
    pub crashed: u64,
    /// Processes that were restarted.
    pub restarted: u64,
    /// The standstill, if there was one.
    pub stall: Option<Stall>,
    /// All standstills in the course of the run, and the help of the controller.
    pub standstills: Standstills,
    /// The standstill as a search problem.
    pub snapshot: Option<Box<dyn Question>>,
    /// The effect of each fault.
    pub struck: Vec<FaultRecord>,
    /// Collisions prevented between modules, by negotiation or locks.
    pub prevented: u64,
    /// Every goal that was opened.
    pub stages: Vec<StageReport>,
    /// Counts of the bodies' actions.
    pub bodies: MoveReport,
    /// The number of moves completed, as the family counts moves.
    pub moves: u64,
    /// The scripted operator, if there was one.
    pub operator: Option<OperatorReport>,
    /// The results that only this family has.
    pub family_part: Option<FamilyPart>,
}

impl RunResult {
    /// Returns the part of a result that the monitor of a run knows; the rest is empty.
    pub fn of<O>(monitor: &RunMonitor<O>, progress: Progress) -> RunResult {
        let (crashed, restarted) = monitor.crashed_and_restarted();
        RunResult {
            ended: monitor.outcome(),
            progress,
            crashed,
            restarted,
            stall: monitor.stall().cloned(),
            standstills: monitor.standstills().clone(),
            snapshot: None,
            struck: monitor.struck().to_vec(),
            prevented: 0,
            stages: Vec::new(),
            bodies: MoveReport::default(),
            moves: 0,
            operator: None,
            family_part: None,
        }
    }
}
