//! Reopening of a goal: when nothing moves any more, calls lead nowhere and cells are unfilled, modules that are finalized may
//! be in the way. The director looks for a plan in which they may leave, and opens the goal once more without the cells
//! that they leave ([`Opening`](metamorph_protocol::cube::epoch::Opening)). What is left of the goal is built then, by the
//! rules of any goal, and the rest is opened afterwards.
//!
//! All modules start over in reserve in a new epoch, so walkers that rest carry others again, and modules that were restarted
//! in goal cells may leave. A goal is never opened again as long as nothing is broken, and safety is that of a change of
//! goals: a bad choice of cells costs time.

use crate::cube::reachability::{ModuleSnapshot, StandstillSnapshot, plan_of_all};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::time::Time;

/// The largest number of modules of a swarm whose goal is opened again. In a larger one the search takes too long.
const MODULES: usize = 256;
/// The largest number of arrangements in the search for a plan.
const ARRANGEMENTS: usize = 20_000;
/// The largest number of cells in these arrangements together.
const EFFORT: usize = 1_000_000;
/// How often in a row the goal is opened again though no shorter plan is left than before.
const FRUITLESS: u8 = 3;

/// The reopenings of a goal since something last broke.
#[derive(Clone, Debug, Default, Hash)]
pub(super) struct Reopening {
    /// The goal, and when something last broke.
    of: (u16, Time),
    /// The number of moves of the shortest plan that was left.
    shortest: Option<usize>,
    /// How often in a row no shorter plan was left.
    fruitless: u8,
    /// True if no plan gives a reason to open the goal again.
    is_over: bool,
}

impl Reopening {
    /// Begins anew for another goal, or after something broke.
    pub fn take_up(&mut self, goal: u16, last_fault: Time) {
        if self.of != (goal, last_fault) {
            *self = Reopening { of: (goal, last_fault), ..Reopening::default() };
        }
    }
    /// Returns true if the goal is not opened again.
    pub fn is_over(&self) -> bool {
        self.is_over
    }

    /// Returns the cells to withhold when the goal is opened again; `None` if no plan gives a reason to open it. The snapshot
    /// is that of the whole goal.
    pub fn withhold(&mut self, snapshot: &StandstillSnapshot) -> Option<Vec<Cell>> {
        let withheld = self.cells_in_the_way(snapshot);
        self.is_over = withheld.is_none();
        withheld
    }

    fn cells_in_the_way(&mut self, snapshot: &StandstillSnapshot) -> Option<Vec<Cell>> {
        if snapshot.modules.len() > MODULES {
            return None;
        }
        let bound = (EFFORT / snapshot.modules.len().max(1)).min(ARRANGEMENTS);
        let plan = plan_of_all(snapshot, bound)?;
        if self.shortest.is_none_or(|shortest| plan.len() < shortest) {
            (self.shortest, self.fruitless) = (Some(plan.len()), 0);
        } else {
            self.fruitless += 1;
        }
        let mut withheld: Vec<Cell> = plan.into_iter().filter(|cell| snapshot.goal.contains(cell)).collect();
        withheld.sort_unstable();
        withheld.dedup();
        // Without any, a new epoch changes something only for walkers and for modules that were restarted.
        let is_changed = |m: &ModuleSnapshot| m.alive && (m.walker || m.pinned);
        let changes = !withheld.is_empty() || snapshot.modules.iter().any(is_changed);
        (self.fruitless < FRUITLESS && changes).then_some(withheld)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cube of three by three by three around an empty goal cell, and a spare module outside.
    fn walled_in() -> StandstillSnapshot {
        let along = || -1..=1;
        let cells = along().flat_map(|x| along().flat_map(move |y| along().map(move |z| Cell::new(x, y, z))));
        let goal: Vec<Cell> = cells.collect();
        let module = |cell, finalized| ModuleSnapshot {
            cell,
            alive: true,
            stuck: false,
            walker: false,
            finalized,
            held_for_good: false,
            pinned: false,
            unattached: false,
        };
        let walls = goal.iter().filter(|cell| **cell != Cell::default()).map(|cell| module(*cell, true));
        let modules = walls.chain([module(Cell::new(2, 0, 0), false)]).collect();
        let (seed, filled) = (Cell::new(-1, -1, -1), goal.len() - 1);
        StandstillSnapshot { modules, goal, seed, filled, spared_by_live: false }
    }

    /// Walls make way for the spare module: one beside the empty cell is the first.
    #[test]
    fn walls_that_are_in_the_way_are_withheld() {
        let snapshot = walled_in();
        let withheld = Reopening::default().withhold(&snapshot).unwrap();
        assert!(withheld.iter().all(|cell| snapshot.goal.contains(cell)), "{withheld:?}");
        assert!(withheld.iter().any(|cell| cell.manhattan(Cell::default()) == 1), "{withheld:?}");
    }

    #[test]
    fn reopening_ends_when_no_plan_gets_shorter() {
        let mut reopening = Reopening::default();
        let snapshot = walled_in();
        let opened = (0..9).take_while(|_| reopening.withhold(&snapshot).is_some()).count();
        assert!(opened == usize::from(FRUITLESS) && reopening.is_over(), "{opened}");
        reopening.take_up(0, Time::ZERO);
        assert!(reopening.is_over(), "nothing has happened");
        reopening.take_up(0, Time(5));
        assert!(!reopening.is_over() && reopening.withhold(&snapshot).is_some());
    }

    /// Without a module to spare no plan is left, and the goal stays as it is.
    #[test]
    fn a_goal_without_a_plan_is_not_opened_again() {
        let mut snapshot = walled_in();
        snapshot.modules.pop();
        assert_eq!(Reopening::default().withhold(&snapshot), None);
    }
}
