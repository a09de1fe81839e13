//! Why metamodules stand still: the reason, the waiting metamodules, and what a search proves.

use super::elements::{Elements, is_off_colour, pinned};
use super::relocation::Relocation;
use super::view::View;
use crate::metamodule::reasons::{
    BARRED, ELEMENT_BLOCKED, ELEMENT_OFF_COLOUR, ELEMENT_PINNED, GOAL_GIVEN_UP, HAS_NO_BETTER_PLACE,
    KEPT_FROM_ELEMENT, MISPLACED, NO_BETTER_PLACE, NO_LOCK, SEED_BLOCKED,
};
use crate::metamodule::relocation::Elsewhere;
use metamorph_kernel::director::outcome::{Proof, Stall, Waiter};
use metamorph_kernel::director::reason::Why;
use metamorph_kernel::director::reason::{BLOCKED, MATERIAL_EXHAUSTED, NO_PATH, NO_SPARE};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::message::Status;
use metamorph_protocol::metamodule::planning::cooperative::{SearchResult, WORK, search};
use metamorph_protocol::time::Time;
use std::collections::BTreeSet;

/// The parts that explain a standstill.
pub(super) struct Diagnosis<'a> {
    pub view: View<'a>,
    pub elements: &'a Elements,
    pub relocation: &'a Relocation,
}

impl Diagnosis<'_> {
    /// Describes a standstill: the unfilled seeds, the waiting metamodules by the last refusal, and what is
    /// proved. Without a search, nothing is proved.
    pub fn explain(&self, since: Time, searches: bool) -> Stall {
        let View { setup, world, members, goal } = self.view;
        let unfilled = setup.goal(goal.task()).all().without(goal.filled());
        let free = self.view.movable().filter_map(|(id, known)| Some((id, known.status?)));
        let free = free.filter(|(_, status)| status.settled.is_none());
        let free: Vec<Waiter> = free.map(|(id, status)| self.waiter(id, status)).collect();
        let blocked = self.elements.blocked(self.view);
        let free: Vec<Waiter> = match blocked.as_ref().and_then(|(_, by)| by.first()) {
            Some(by) => {
                free.into_iter().map(|w| Waiter { on: Some(*by), why: KEPT_FROM_ELEMENT, ..w }).collect()
            }
            None => free,
        };
        let waits: Vec<_> = free.iter().map(|w| (w.module, w.on)).collect();
        let stuck = members.ids().filter(|id| world.is_stuck(*id)).flat_map(|id| world.cells(id)).copied();
        let stays: BTreeSet<Cell> = self.view.foreign().into_iter().chain(stuck).collect();
        let negotiated = !setup.params.strategy.is_published();
        // While an element is not there, what fills seeds decides nothing.
        let is_sought = searches && negotiated && !goal.task().is_dropped && blocked.is_none();
        let sought = if is_sought { search(&self.view.snapshot(), WORK) } else { SearchResult::Undecided };
        let proof = self.proof(&sought);
        // By precedence a metamodule also waits for one that is refused nothing and has no place to go to.
        let ordered = setup.params.precedence.is_some();
        let here = if goal.task().is_dropped {
            GOAL_GIVEN_UP
        } else if !pinned(self.view).is_empty() {
            ELEMENT_PINNED
        } else if is_off_colour(self.view) {
            ELEMENT_OFF_COLOUR
        } else if free.is_empty() && !unfilled.is_empty() {
            NO_SPARE
        } else if free.len() < unfilled.len() {
            MATERIAL_EXHAUSTED
        } else if self.view.is_seed_blocked(&stays) {
            SEED_BLOCKED
        } else if blocked.is_some() {
            ELEMENT_BLOCKED
        } else if matches!(sought, SearchResult::Path(_)) {
            BLOCKED
        } else if matches!(sought, SearchResult::NoWay(_)) || self.view.is_out_of_reach() {
            NO_PATH
        } else if negotiated {
            BLOCKED
        } else if free.iter().filter(|w| w.on.is_some()).count() >= if ordered { free.len() } else { 1 } {
            NO_LOCK
        } else {
            NO_BETTER_PLACE
        };
        let may_be_elsewhere = negotiated
            && self.relocation.is_allowed
            && !matches!(self.relocation.elsewhere(), Some(Elsewhere::Barred(_)));
        let reason = match here {
            SEED_BLOCKED | NO_PATH if may_be_elsewhere => MISPLACED,
            here => here,
        };
        Stall {
            since,
            reason,
            text: reason.text,
            open: unfilled
                .iter()
                .filter_map(|s| setup.seed(goal.task(), s))
                .map(|s| s.foot)
                .map(|(x, y)| Cell::new(x, y, 0).into())
                .collect(),
            wait_cycle: cycle(&waits),
            waiting: free,
            detected: members.detected(),
            proof,
        }
    }

    /// Returns what a search at a standstill and at other places has proved.
    fn proof(&self, sought: &SearchResult) -> Option<Proof> {
        let SearchResult::NoWay(arrangements) = *sought else { return None };
        match self.relocation.elsewhere() {
            Some(Elsewhere::Barred(places)) => Some(Proof { arrangements, places: Some(places) }),
            None if !self.relocation.is_allowed => Some(Proof { arrangements, places: None }),
            _ => None,
        }
    }

    fn waiter(&self, module: ModuleId, status: Status) -> Waiter {
        let View { setup, members, goal, .. } = self.view;
        let open = goal.open(setup);
        let why = match status.waits_for {
            Some(other) if members.dead().contains(&other) => Why::WAITS_FOR_DEAD,
            Some(_) => Why::WAITS,
            None if !open.is_empty() && status.unreachable.holds(open) => BARRED,
            None if !setup.params.strategy.is_published() => Why::UNKNOWN,
            None => HAS_NO_BETTER_PLACE,
        };
        Waiter { module, on: status.waits_for, why }
    }
}

/// Returns the metamodules that wait for each other in a circle; each waits for at most one.
fn cycle(waiting: &[(ModuleId, Option<ModuleId>)]) -> Vec<ModuleId> {
    let on = |id: ModuleId| waiting.iter().find(|(w, _)| *w == id).and_then(|(_, on)| *on);
    for (start, _) in waiting {
        let mut path = vec![*start];
        while let Some(next) = path.last().and_then(|id| on(*id)) {
            if next == *start {
                path.sort_unstable();
                return path;
            }
            if path.contains(&next) {
                break;
            }
            path.push(next);
        }
    }
    Vec::new()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_a_circle_of_waiting_metamodules() {
        let wait = |pairs: &[(u32, Option<u32>)]| {
            let pairs: Vec<_> = pairs.iter().map(|(a, b)| (ModuleId(*a), b.map(ModuleId))).collect();
            cycle(&pairs)
        };
        assert_eq!(wait(&[(0, Some(1)), (1, Some(2)), (2, Some(1))]), [ModuleId(1), ModuleId(2)]);
        assert_eq!(wait(&[(0, Some(1)), (1, None)]), []);
        assert_eq!(wait(&[(0, Some(7))]), []);
    }
}
