//! Surroundings of a metamodule, as `negotiated` sees them, and the places where it blocks others.

use super::safety::Beside;
use crate::metamodule::blueprint::{Seed, SeedSet};
use crate::metamodule::message::{Claim, Path};
use crate::metamodule::planning::enclosure::is_away;
use crate::metamodule::pose::Pose;
use crate::metamodule::view::View;
use metamorph_core::ids::{ModuleId, Port};
use metamorph_core::lattice::Cell;
use std::cell::OnceCell;
use std::collections::BTreeMap;

/// Another metamodule that can move.
pub(super) struct Other {
    pub id: ModuleId,
    pub pose: Pose,
    /// The cells of its body and of the element that it holds.
    pub cells: Vec<Cell>,
    /// Its pose after the motion that this metamodule has granted it; `pose` if there is none.
    pub soon: Pose,
    pub claim: Option<Claim>,
    pub unreachable: SeedSet,
    pub path: Option<Path>,
}

/// Surroundings of a metamodule, unchanged during one decision.
pub(super) struct Scene<'a> {
    pub v: View<'a>,
    /// Cells of what does not move: the built, the dead, the stuck, obstacles.
    pub stays: Vec<Cell>,
    /// `stays`, and the cells of blocked metamodules.
    pub fixed: Vec<Cell>,
    /// The metamodules that can move, blocked or not, and where they are.
    pub movable: Vec<(ModuleId, Pose)>,
    /// Those that are not blocked.
    pub free: Vec<Other>,
    /// The poses that all metamodules that can move will soon be in; see [`Other::soon`].
    pub candidates: Vec<Pose>,
    /// All cells to keep out of now: fixed ones, bodies, grants.
    pub taken: Vec<Cell>,
    /// The cells of dead bodies and obstacles, and of all seeds: what is fixed once the goal is built.
    pub built: Vec<Cell>,
    /// The corners of the rectangle around the feet of all seeds.
    zone: ((i16, i16), (i16, i16)),
    /// The cells of what is built and of other free metamodules; see `safety`.
    pub around: OnceCell<Vec<Cell>>,
    /// The other free metamodules outside the zone; see `safety`.
    pub beside: OnceCell<Vec<Beside>>,
}

impl<'a> Scene<'a> {
    pub fn new(v: View<'a>, paths: &BTreeMap<Port, Path>) -> Scene<'a> {
        let own = v.own;
        let fixed = v.fixed();
        let near = v.neighbours.states().count();
        let (mut stays, mut blocked) = (fixed.clone(), Vec::new());
        let mut free = Vec::with_capacity(near);
        let (mut candidates, mut movable) = (Vec::with_capacity(near), Vec::with_capacity(near));
        for (port, state) in v.neighbours.states().filter(|(_, s)| !v.neighbours.is_dead(s.id)) {
            let cells: Vec<Cell> = v.setup.occupied(state.pose).collect();
            let soon = v.locks.grant_of(port).map_or(state.pose, |g| Pose { posture: g.ends, ..g.pose });
            if v.stays(state) || state.stuck {
                stays.extend(cells);
                continue;
            }
            candidates.push(soon);
            movable.push((state.id, state.pose));
            if state.blocked {
                blocked.extend(cells);
                continue;
            }
            let fits = |c: &Claim| state.task == own.task && !own.filled.has(c.seed);
            free.push(Other {
                id: state.id,
                pose: state.pose,
                cells,
                soon,
                claim: state.claim.filter(fits),
                unreachable: state.unreachable,
                path: paths.get(&port).copied().filter(|w| w.count > 0),
            });
        }
        free.sort_by_key(|o| o.id);
        movable.sort_by_key(|(id, _)| *id);
        let mut built = fixed;
        let fixed = [&stays[..], &blocked].concat();
        let mut taken = Vec::with_capacity(fixed.len() + near * ROOM);
        taken.extend(&fixed);
        taken.extend(free.iter().flat_map(|o| &o.cells));
        taken.extend(v.locks.cells(v.setup));
        let seeds = || v.setup.seeds(own.task).map(|(_, s)| s);
        built.extend(seeds().flat_map(|s| s.cells()));
        let (far, none) = ((i16::MIN, i16::MIN), (i16::MAX, i16::MAX));
        let zone = seeds().fold((none, far), |(min, max), s| {
            let (x, y) = s.foot;
            ((min.0.min(x), min.1.min(y)), (max.0.max(x), max.1.max(y)))
        });
        let (around, beside) = (OnceCell::new(), OnceCell::new());
        Scene { v, stays, fixed, movable, free, candidates, taken, built, zone, around, beside }
    }

    /// All cells with something in them.
    pub fn bodies(&self) -> Vec<Cell> {
        self.fixed.iter().copied().chain(self.free.iter().flat_map(|o| o.cells.iter().copied())).collect()
    }
    pub fn seed(&self, number: u8) -> Option<Seed> {
        self.v.setup.seed(self.v.own.task, number)
    }
    /// Seeds that are claimed by others.
    pub fn claimed(&self) -> SeedSet {
        self.free.iter().filter_map(|o| o.claim).fold(SeedSet::default(), |set, c| set.with(c.seed))
    }
    /// Whether no seed before this one is claimed by others. Only the first may be in the zone: others there
    /// could be walled in.
    pub fn is_first(&self, claim: Claim) -> bool {
        self.free.iter().filter_map(|o| o.claim).all(|c| claim.seed <= c.seed)
    }
    /// Returns the fixed cells, and those of all unfilled seeds that come before this one.
    pub fn planned(&self, number: u8) -> Vec<Cell> {
        let before = self.v.goal().before(number).without(self.v.own.filled);
        let seeds = before.iter().filter_map(|s| self.seed(s));
        let mut planned = Vec::with_capacity(self.fixed.len() + before.len() * ROOM);
        planned.extend(&self.fixed);
        planned.extend(seeds.flat_map(|s| s.cells()));
        planned
    }
    /// Returns true if all unfilled seeds that come before this one can still be reached after it has been filled.
    pub fn keeps_open(&self, number: u8) -> bool {
        let Some(seed) = self.seed(number) else { return true };
        let before = self.v.goal().before(number).without(self.v.own.filled);
        before.iter().filter_map(|s| Some((s, self.seed(s)?))).all(|(earlier, other)| {
            let mut around = self.planned(earlier);
            around.extend(seed.cells());
            let distances = self.v.motions().distances(self.v.setup.floor, other, &around);
            let (x, y) = other.foot;
            distances.reach(|from| is_away((i64::from(x) * 4, i64::from(y) * 4), from))
        })
    }

    /// Whether a connector is more than `by` cells away from those of the seeds.
    pub fn is_beyond(&self, x: i16, y: i16, by: i16) -> bool {
        let (min, max) = self.zone;
        // Without a seed everything is beyond.
        let beyond = |v: i16, min: i16, max: i16| v < min.saturating_sub(by) || v > max.saturating_add(by);
        beyond(x, min.0, max.0) || beyond(y, min.1, max.1)
    }
}

/// Number of cells for which there is room at first for each metamodule: those of its body, and of a motion.
pub(super) const ROOM: usize = 16;

/// Returns a hash of a set of cells, which does not depend on their order.
pub(super) fn fingerprint(cells: &[Cell]) -> u64 {
    let mix = |c: &Cell| {
        let v = (c.x as u16 as u64) << 32 | (c.y as u16 as u64) << 16 | c.z as u16 as u64;
        (v + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29).wrapping_mul(0xBF58_476D_1CE4_E5B9)
    };
    cells.iter().map(mix).fold(0, u64::wrapping_add)
}
