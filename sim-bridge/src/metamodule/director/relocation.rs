//! Whether and where the goal is moved when it cannot be built where it is.

use super::view::View;
use crate::metamodule::relocation::{Elsewhere, Shift, Trials, clear_places};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::blueprint::{SeedSet, Task};
use metamorph_protocol::metamodule::planning::cooperative::{SearchResult, WORK, search};
use std::collections::BTreeSet;

/// The places that the goal has been moved to, and what searches have shown of others.
#[derive(Clone, Default)]
pub(super) struct Relocation {
    /// True if the director may move the goal.
    pub is_allowed: bool,
    trials: Trials,
    /// True if the goal has been moved, by the director or by a command.
    pub has_moved: bool,
    /// The result of the last search for another place, at the last standstill.
    elsewhere: Option<Elsewhere>,
    /// The task and the filled seeds at which all metamodules were last found to have no path.
    out_of_reach: Option<(Task, SeedSet)>,
}

impl Relocation {
    pub fn new(is_allowed: bool) -> Relocation {
        Relocation { is_allowed, ..Relocation::default() }
    }
    pub fn elsewhere(&self) -> Option<Elsewhere> {
        self.elsewhere
    }
    /// Forgets which places have been tried, since bodies or obstacles have changed.
    pub fn forget_trials(&mut self) {
        self.trials.forget();
    }
    /// Notes that another task begins.
    pub fn begun(&mut self, is_other_goal: bool) {
        self.elsewhere = None;
        if is_other_goal {
            self.forget_trials();
        }
    }

    /// Returns the place to move the goal to if an immovable body or obstacle is in a seed: the clear place with the most
    /// room around it, of several the nearest (see [`clear_places`]).
    pub fn evade(&self, view: View<'_>) -> Option<Shift> {
        let foreign = view.foreign();
        if self.is_allowed && view.is_seed_blocked(&foreign) { clear_place(view, &foreign) } else { None }
    }

    /// Returns the place to move the goal to after a standstill: for `negotiated` one where a search builds it or may; for
    /// the others, whose local minima no search predicts, once a clear place.
    pub fn retreat(&mut self, view: View<'_>) -> Option<Shift> {
        if !self.is_allowed || view.goal.task().is_dropped {
            return None;
        }
        if view.setup.params.strategy.is_published() {
            let foreign = view.foreign();
            let may_move = !self.has_moved && !foreign.is_empty();
            return may_move.then(|| clear_place(view, &foreign)).flatten();
        }
        let next = self.trials.next(&view.all_free());
        self.elsewhere = Some(next);
        match next {
            Elsewhere::Place(shift) => Some(shift),
            Elsewhere::Barred(_) | Elsewhere::Unproved => None,
        }
    }

    /// Returns true if an open seed is unreachable for all metamodules, and no cooperative plan exists either. As that
    /// takes a search, it is asked once per state of the structure; after that the answer is false.
    pub fn is_stranded(&mut self, view: View<'_>) -> bool {
        let built = (view.goal.task(), view.goal.filled());
        if !self.is_allowed || self.out_of_reach == Some(built) || !view.is_out_of_reach() {
            return false;
        }
        self.out_of_reach = Some(built);
        matches!(search(&view.snapshot(), WORK), SearchResult::NoWay(_))
    }
}

fn clear_place(view: View<'_>, foreign: &BTreeSet<Cell>) -> Option<Shift> {
    let task = view.goal.task();
    clear_places(view.setup, task, foreign).into_iter().find(|shift| *shift != task.shift)
}
