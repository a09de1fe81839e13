//! Safety of a body of cubes, checked at every move: resting modules are connected, every mover has a resting
//! support at its start and its destination, and no two modules are in one cell.
//!
//! A check looks only at what the move changes. If the body was safe before, then
//! - a module that starts can only cut its own neighbours off from each other, and can only take a support
//!   from movers beside its cell;
//! - a module that comes to rest is connected by its support, and takes no support from any module.
//!
//! So the incremental checks find a violation if and only if the check of the whole body would
//! (`the_incremental_checks_agree_with_the_whole_one`). Not here: whether a move is possible at all.

use super::{CubeWorld, Occupant};
use crate::cube::invariants::{BODY_CONNECTED, MOVER_SUPPORTED};
use metamorph_kernel::world::invariants::ONE_MODULE_PER_CELL;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::{Cell, Face, Motion};
use metamorph_protocol::time::Time;
use std::collections::VecDeque;

impl CubeWorld {
    /// Checks a move that has just begun, for the mover and for all others.
    pub(super) fn check_departure(&mut self, now: Time, id: ModuleId) {
        let from = self.bodies[id.index()].cell;
        if !self.is_supported(id) {
            let motion = self.bodies[id.index()].under_way.map(|u| u.motion);
            let what = format!("{id} moves {motion:?} from {from} over a module that is leaving");
            self.queue.violate(MOVER_SUPPORTED, now, what);
        }
        if let Some(mover) = Face::ALL.into_iter().find_map(|face| self.supported_by(from, face)) {
            let what = format!("{id} leaves {from} while {mover} moves over it");
            self.queue.violate(MOVER_SUPPORTED, now, what);
        }
        if !self.neighbours_connected(from) {
            let what = format!("{id} leaves {from} while its neighbours need it");
            self.queue.violate(BODY_CONNECTED, now, what);
        }
    }

    /// Checks that a mover is still alone in the cells that its move needs, before they are released.
    pub(super) fn check_path(&mut self, now: Time, id: ModuleId, from: Cell, motion: Motion) {
        let path = [Some(motion.destination(from)), motion.corner(from)].into_iter().flatten();
        let needed = path.map(|cell| (cell, Occupant::Path(id))).chain([(from, Occupant::Body(id))]);
        let foreign = needed.into_iter().find(|(cell, by)| self.grid.get(*cell) != Some(*by));
        if let Some((cell, _)) = foreign {
            let what = format!("{id} moves through {cell}, which holds {:?}", self.grid.get(cell));
            self.queue.violate(ONE_MODULE_PER_CELL, now, what);
        }
    }

    /// Checks a module that has come to rest, at its destination or its start: the support on this face
    /// connects it.
    pub(super) fn check_arrival(&mut self, now: Time, id: ModuleId, support: Face) {
        let cell = self.bodies[id.index()].cell;
        if self.resting(cell.step(support)).is_none() {
            self.queue.violate(MOVER_SUPPORTED, now, format!("{id} comes to rest on nothing at {cell}"));
        }
    }

    /// Returns true if a module rests, or moves over modules that rest.
    fn is_supported(&self, id: ModuleId) -> bool {
        let body = &self.bodies[id.index()];
        body.under_way.is_none_or(|under_way| {
            let motion = under_way.motion;
            let landing = motion.destination(body.cell).step(motion.landing_support());
            self.resting(body.cell.step(motion.support)).is_some() && self.resting(landing).is_some()
        })
    }

    /// Returns the module beside a cell, on this face of it, that moves and has its support in the cell: the
    /// first support if the body is there, the landing support if it is under way there.
    fn supported_by(&self, cell: Cell, face: Face) -> Option<ModuleId> {
        let beside = cell.step(face);
        let (mover, lands) = match self.grid.get(beside)? {
            Occupant::Body(id) => (id, false),
            Occupant::Path(id) => (id, true),
        };
        let body = &self.bodies[mover.index()];
        let motion = body.under_way?.motion;
        let support = if lands { motion.landing_support() } else { motion.support };
        // The corner of a path is only swept.
        let is_there = !lands || motion.destination(body.cell) == beside;
        (is_there && support == face.opposite()).then_some(mover)
    }

    /// Returns true if the resting neighbours of a cell are connected with each other over resting modules.
    /// Searches from all of them in turn and stops when they have met, so that a small local loop costs
    /// little in a large body.
    pub(super) fn neighbours_connected(&mut self, cell: Cell) -> bool {
        let starts: Vec<ModuleId> = cell.neighbours().into_iter().filter_map(|c| self.resting(c)).collect();
        if starts.len() < 2 {
            return true;
        }
        self.search += 1;
        let mut part: Vec<usize> = (0..starts.len()).collect();
        let mut fronts: Vec<VecDeque<Cell>> = Vec::new();
        for (i, id) in starts.iter().enumerate() {
            self.marks[id.index()] = (self.search, i as u32);
            fronts.push(VecDeque::from([self.bodies[id.index()].cell]));
        }
        loop {
            for i in 0..fronts.len() {
                let Some(at) = fronts[i].pop_front() else {
                    // All modules of this part are seen. If others share the name of the part they continue.
                    let alone =
                        !(0..fronts.len()).any(|j| j != i && part[j] == part[i] && !fronts[j].is_empty());
                    if alone && part.iter().any(|p| *p != part[i]) {
                        return false;
                    }
                    continue;
                };
                for next in at.neighbours() {
                    let Some(id) = self.resting(next) else { continue };
                    let mark = self.marks[id.index()];
                    if mark.0 != self.search {
                        self.marks[id.index()] = (self.search, i as u32);
                        fronts[i].push_back(next);
                    } else if part[mark.1 as usize] != part[i] {
                        let (keep, drop) = (part[i], part[mark.1 as usize]);
                        part.iter_mut().filter(|p| **p == drop).for_each(|p| *p = keep);
                        if part.iter().all(|p| *p == keep) {
                            return true;
                        }
                    }
                }
            }
        }
    }

    /// Checks the whole body: the resting modules are connected, and every mover has its supports. The
    /// incremental checks do the same move by move; this is for the start, the end and now and then.
    pub fn check_connected(&mut self, now: Time) {
        let resting: Vec<ModuleId> =
            (0..self.bodies.len() as u32).map(ModuleId).filter(|id| !self.is_moving(*id)).collect();
        let Some(first) = resting.first() else { return };
        self.search += 1;
        self.marks[first.index()] = (self.search, 0);
        let (mut stack, mut seen) = (vec![self.bodies[first.index()].cell], 1);
        while let Some(cell) = stack.pop() {
            for next in cell.neighbours() {
                if let Some(id) = self.resting(next)
                    && self.marks[id.index()].0 != self.search
                {
                    self.marks[id.index()].0 = self.search;
                    seen += 1;
                    stack.push(next);
                }
            }
        }
        for id in (0..self.bodies.len() as u32).map(ModuleId) {
            if !self.is_supported(id) {
                let cell = self.bodies[id.index()].cell;
                self.queue.violate(MOVER_SUPPORTED, now, format!("{id} moves from {cell} without support"));
            }
        }
        if seen != resting.len() {
            let lost = resting.iter().find(|id| self.marks[id.index()].0 != self.search);
            let what = format!(
                "{} of {} resting modules are cut off, {lost:?} among them",
                resting.len() - seen,
                resting.len()
            );
            self.queue.violate(BODY_CONNECTED, now, what);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_kernel::world::World;
    use metamorph_kernel::world::invariants::Invariant;
    use metamorph_kernel::world::invariants::Violation;
    use metamorph_protocol::cube::body::Move;
    use metamorph_protocol::lattice::MotionKind;
    use metamorph_protocol::ratio::Ratio;
    use metamorph_protocol::rng::Rng;
    use metamorph_protocol::time::Span;

    const MOVE: Span = Span::secs(1);
    /// A direction at right angles to east and west.
    const BESIDE: Face = Face::North;

    fn world(cells: &[[i16; 3]]) -> CubeWorld {
        let cells: Vec<Cell> = cells.iter().copied().map(Cell::from).collect();
        CubeWorld::new(&cells, MOVE, 1)
    }

    fn act(world: &mut CubeWorld, now: Time, id: u32, motion: Motion) {
        let (id, revision) = (ModuleId(id), world.bodies[id as usize].ports.revision);
        world.act(now, id, revision, &Move { motion, not_after: Time::NEVER });
    }

    fn slide(support: Face, heading: Face) -> Motion {
        Motion { kind: MotionKind::Slide, support, heading }
    }

    fn fired(world: &mut CubeWorld) -> Vec<Invariant> {
        world.take_violations().into_iter().map(|v| v.invariant).collect()
    }

    /// Returns a plate of five and a module on it, which can slide from module 0 to module 1. Beside these
    /// two are others, along which they can leave.
    fn plate() -> CubeWorld {
        let Cell { x: dx, y: dy, .. } = BESIDE.offset();
        world(&[[0, 0, 0], [1, 0, 0], [dx, dy, 0], [1 + dx, dy, 0], [2 + dx, dy, 0], [0, 0, 1]])
    }

    #[test]
    fn a_support_that_leaves_fires() {
        let over = slide(Face::Down, Face::East);
        for (leaves, heading) in [(1, Face::East), (0, Face::West)] {
            let mut plate = plate();
            act(&mut plate, Time(0), 5, over);
            assert_eq!((plate.motions().started, fired(&mut plate)), (1, vec![]));
            // Module 1 is the landing; module 0 is the start, and cannot slide.
            let kind = if leaves == 1 { MotionKind::Slide } else { MotionKind::Convex };
            let motion = Motion { kind, support: BESIDE, heading };
            act(&mut plate, Time(1), leaves, motion);
            assert_eq!((plate.motions().started, fired(&mut plate)), (2, vec![MOVER_SUPPORTED]));
        }
    }

    #[test]
    fn a_failed_move_that_comes_back_to_nothing_fires() {
        let mut plate = plate();
        plate.set_stuck(ModuleId(5), true);
        act(&mut plate, Time(0), 5, slide(Face::Down, Face::East));
        act(
            &mut plate,
            Time(1),
            0,
            Motion { kind: MotionKind::Convex, support: BESIDE, heading: Face::West },
        );
        assert_eq!(fired(&mut plate), [MOVER_SUPPORTED]);
        plate.advance(Time(0) + MOVE);
        assert_eq!((plate.motions().failed, fired(&mut plate)), (1, vec![MOVER_SUPPORTED]));
        let mut sound = self::plate();
        sound.set_stuck(ModuleId(5), true);
        act(&mut sound, Time(0), 5, slide(Face::Down, Face::East));
        sound.advance(Time(0) + MOVE);
        assert_eq!((sound.motions().failed, fired(&mut sound)), (1, vec![]));
    }

    #[test]
    fn another_body_in_the_path_fires() {
        for (cell, fails) in [([1, 0, 1], false), ([1, 0, 1], true), ([0, 0, 1], true)] {
            let mut plate = plate();
            plate.set_stuck(ModuleId(5), fails);
            act(&mut plate, Time(0), 5, slide(Face::Down, Face::East));
            plate.grid.set(cell.into(), Some(Occupant::Body(ModuleId(2))));
            plate.advance(Time(0) + MOVE);
            assert_eq!(fired(&mut plate), [ONE_MODULE_PER_CELL]);
        }
    }

    /// Modules move at random, safely or not, several at a time, and some moves fail. The incremental checks
    /// find all violations that the whole check finds, at the same event, and no others.
    #[test]
    fn the_incremental_checks_agree_with_the_whole_one() {
        let (mut broken, mut events) = (0, 0);
        for seed in 0..400 {
            let mut rng = Rng::named(seed, "safety", 0);
            let side = 2 + rng.below(4) as i16;
            let cells = (0..side * side).map(|i| [i % side, i / side, 0]);
            let top = (0..side).map(|i| [i, 0, 1]);
            let mut world = world(&cells.chain(top).collect::<Vec<_>>());
            world.set_failure("20%".parse().unwrap_or(Ratio::ZERO));
            // With careless moves nearly every run breaks soon, without them nearly none gets far.
            let careless = rng.below(2) == 0;
            let mut now = Time::ZERO;
            for _ in 0..300 {
                now += Span(rng.below(MOVE.0 / 4));
                world.advance(now);
                if !incremental_is_whole(&mut world, now, seed, &mut broken) {
                    break;
                }
                let id = rng.below(world.len() as u64) as u32;
                let support = Face::ALL[rng.below(6) as usize];
                let heading = support.perpendicular()[rng.below(4) as usize];
                let kind = if rng.below(2) == 0 { MotionKind::Slide } else { MotionKind::Convex };
                if !careless && !world.is_removable(ModuleId(id)) {
                    continue;
                }
                act(&mut world, now, id, Motion { kind, support, heading });
                if !incremental_is_whole(&mut world, now, seed, &mut broken) {
                    break;
                }
            }
            events += world.motions().started;
        }
        assert!(broken > 50 && events > 2_000, "{broken} broke in {events} moves");
    }

    /// Returns true if the body is sound, by both checks.
    fn incremental_is_whole(world: &mut CubeWorld, now: Time, seed: u64, broken: &mut u32) -> bool {
        let found: Vec<Violation> = world.take_violations();
        world.check_connected(now);
        let whole = world.take_violations();
        assert_eq!(found.is_empty(), whole.is_empty(), "seed {seed} at {now}: {found:?} and {whole:?}");
        *broken += u32::from(!found.is_empty());
        found.is_empty()
    }
}
