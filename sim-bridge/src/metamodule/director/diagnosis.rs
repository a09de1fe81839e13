//! Why metamodules stand still: the reason, the waiting metamodules, and what a search proves.

use super::{Known, MetamoduleDirector};
use crate::director::outcome::{Proof, Stall, Waiter};
use crate::director::reason::Why;
use crate::director::reason::{BLOCKED, MATERIAL_EXHAUSTED, NO_WAY};
use crate::metamodule::reasons::{
    BARRED, ELEMENT_BLOCKED, ELEMENT_OFF_COLOUR, ELEMENT_PINNED, GOAL_GIVEN_UP, HAS_NO_BETTER_PLACE,
    KEPT_FROM_ELEMENT, MISPLACED, NO_BETTER_PLACE, NO_LOCK, SEED_BLOCKED,
};
use crate::metamodule::relocation::Elsewhere;
use crate::metamodule::world::MetamoduleWorld;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::planning::cooperative::{SearchResult, WORK, search};
use metamorph_protocol::time::Time;
use std::collections::BTreeSet;

impl MetamoduleDirector {
    /// Describes a standstill: the unfilled seeds, the waiting metamodules by the last refusal, and what is
    /// proved.
    pub(super) fn explain(&self, since: Time, world: &MetamoduleWorld) -> Stall {
        let unfilled = self.setup.goal(self.task).all().without(self.filled);
        let is_free = |(id, k): &(ModuleId, &Known)| {
            k.alive && !world.is_stuck(*id) && k.status.is_some_and(|s| s.settled.is_none())
        };
        let free: Vec<Waiter> =
            (0..).map(ModuleId).zip(&self.known).filter(is_free).map(|(id, k)| self.waiter(id, k)).collect();
        let blocked = self.blocked(world);
        let free: Vec<Waiter> = match blocked.as_ref().and_then(|(_, by)| by.first()) {
            Some(by) => {
                free.into_iter().map(|w| Waiter { on: Some(*by), why: KEPT_FROM_ELEMENT, ..w }).collect()
            }
            None => free,
        };
        let waits: Vec<_> = free.iter().map(|w| (w.module, w.on)).collect();
        let all = (0..self.known.len() as u32).map(ModuleId);
        let stuck = all.filter(|id| world.is_stuck(*id)).flat_map(|id| world.cells(id)).copied();
        let stays: BTreeSet<Cell> = self.foreign(world).into_iter().chain(stuck).collect();
        let negotiated = !self.setup.params.strategy.is_published();
        // While an element is not there, what fills seeds decides nothing.
        let is_sought = negotiated && !self.task.is_dropped && blocked.is_none();
        let sought = if is_sought { search(&self.snapshot(world), WORK) } else { SearchResult::Undecided };
        let proof = self.proof(&sought);
        // By precedence a metamodule also waits for one that is refused nothing and has no place to go to.
        let ordered = self.setup.params.precedence.is_some();
        let here = if self.task.is_dropped {
            GOAL_GIVEN_UP
        } else if !self.pinned(world).is_empty() {
            ELEMENT_PINNED
        } else if self.is_off_colour(world) {
            ELEMENT_OFF_COLOUR
        } else if free.len() < unfilled.len() {
            MATERIAL_EXHAUSTED
        } else if self.is_seed_blocked(&stays) {
            SEED_BLOCKED
        } else if blocked.is_some() {
            ELEMENT_BLOCKED
        } else if matches!(sought, SearchResult::Path(_)) {
            BLOCKED
        } else if matches!(sought, SearchResult::NoWay(_)) || self.is_out_of_reach(world) {
            NO_WAY
        } else if negotiated {
            BLOCKED
        } else if free.iter().filter(|w| w.on.is_some()).count() >= if ordered { free.len() } else { 1 } {
            NO_LOCK
        } else {
            NO_BETTER_PLACE
        };
        let may_be_elsewhere =
            negotiated && self.relocate && !matches!(self.elsewhere, Some(Elsewhere::Barred(_)));
        let reason = match here {
            SEED_BLOCKED | NO_WAY if may_be_elsewhere => MISPLACED,
            here => here,
        };
        Stall {
            since,
            reason,
            text: reason.text,
            open: unfilled
                .iter()
                .filter_map(|s| self.setup.seed(self.task, s))
                .map(|s| s.foot)
                .map(|(x, y)| Cell::new(x, y, 0).into())
                .collect(),
            wait_cycle: cycle(&waits),
            waiting: free,
            detected: self.detected,
            proof,
        }
    }

    /// Returns what a search at a standstill and at other places has proved.
    fn proof(&self, sought: &SearchResult) -> Option<Proof> {
        let SearchResult::NoWay(arrangements) = *sought else { return None };
        match self.elsewhere {
            Some(Elsewhere::Barred(places)) => Some(Proof { arrangements, places: Some(places) }),
            None if !self.relocate => Some(Proof { arrangements, places: None }),
            _ => None,
        }
    }

    fn waiter(&self, module: ModuleId, known: &Known) -> Waiter {
        let on = known.status.and_then(|s| s.waits_for);
        let open = self.setup.goal(self.task).open(self.filled);
        let unreachable = known.status.is_some_and(|s| !open.is_empty() && s.unreachable.holds(open));
        let why = match on {
            Some(other) if self.dead.contains(&other) => Why::WAITS_FOR_DEAD,
            Some(_) => Why::WAITS,
            None if unreachable => BARRED,
            None if !self.setup.params.strategy.is_published() => Why::UNKNOWN,
            None => HAS_NO_BETTER_PLACE,
        };
        Waiter { module, on, why }
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
