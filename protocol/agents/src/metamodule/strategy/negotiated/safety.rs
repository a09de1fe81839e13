//! Places where a metamodule is safe, and where it leaves the others safe: outside the zone of the goal, and free to get away
//! once the whole goal is built. A decision asks this for many places of one metamodule, so what the answers share is found once.

use super::scene::{ROOM, Scene};
use crate::metamodule::planning::enclosure::bears_on;
use crate::metamodule::pose::Pose;
use metamorph_core::ids::ModuleId;
use metamorph_core::lattice::Cell;
use std::cell::OnceCell;

/// Another free metamodule that is outside the zone.
pub(super) struct Beside {
    /// Its pose; see `Other::soon`.
    pose: Pose,
    /// The cells around it, without those of this metamodule.
    around: Vec<Cell>,
    is_safe_now: OnceCell<bool>,
}

impl Beside {
    /// Returns true if it could not get away with this metamodule in `me`.
    fn is_shut_in(&self, scene: &Scene<'_>, me: Pose) -> bool {
        let taken = [&self.around[..], &scene.v.motions().cells(me)].concat();
        scene.v.ground(&taken).is_shut_in(self.pose)
    }
    /// Returns true if it can get away with this metamodule where it is.
    fn is_safe_now(&self, scene: &Scene<'_>) -> bool {
        *self.is_safe_now.get_or_init(|| !self.is_shut_in(scene, scene.v.own.pose))
    }
}

impl Scene<'_> {
    /// Returns the cells of what is built, and of free metamodules but one, which count.
    fn all_but(&self, id: ModuleId, counts: impl Fn(&Cell) -> bool) -> Vec<Cell> {
        let mut around = Vec::with_capacity(self.built.len() + self.free.len() * ROOM);
        around.extend(self.built.iter().filter(|cell| counts(cell)));
        for other in self.free.iter().filter(|other| other.id != id) {
            around.extend(self.v.motions().cells(other.soon).iter().filter(|cell| counts(cell)));
        }
        around
    }
    fn beside(&self) -> &[Beside] {
        self.beside.get_or_init(|| {
            let outside = self.free.iter().filter(|o| self.is_outside_zone(o.soon));
            let beside = outside.map(|o| {
                let middle = self.v.motions().middle(o.soon);
                let around = self.all_but(o.id, |cell| bears_on(middle, *cell));
                Beside { pose: o.soon, around, is_safe_now: OnceCell::new() }
            });
            beside.collect()
        })
    }

    /// Whether a metamodule in `pose` is outside the zone: the goal and one cell around it.
    pub fn is_outside_zone(&self, pose: Pose) -> bool {
        self.v.motions().cells(pose).iter().all(|c| self.is_beyond(c.x, c.y, 1))
    }
    /// True if this metamodule in `pose` is outside the zone, and can still get away from there once the whole
    /// goal is built, even if no free neighbour moves any more. The second matters because a metamodule beside
    /// the zone may need room that the goal will take.
    pub fn is_safe(&self, pose: Pose) -> bool {
        let around = || self.all_but(self.v.own.id, |_| true);
        self.is_outside_zone(pose) && !self.v.ground(self.around.get_or_init(around)).is_shut_in(pose)
    }
    /// Returns true if all other free metamodules are safe, in the sense of [`Scene::is_safe`], with this one where it is.
    pub fn leaves_others_safe(&self) -> bool {
        let beside = self.beside();
        beside.len() == self.free.len() && beside.iter().all(|other| other.is_safe_now(self))
    }
    /// Whether this metamodule in `me` is safe and leaves all others as safe as they are.
    pub fn is_non_blocking(&self, me: Pose) -> bool {
        self.is_safe(me) && !self.shuts_in(me)
    }
    /// Whether another metamodule that is safe now would not be if this one stood in `me`.
    fn shuts_in(&self, me: Pose) -> bool {
        let motions = self.v.motions();
        let cells = motions.cells(me);
        self.beside().iter().any(|other| {
            let middle = motions.middle(other.pose);
            // Without this metamodule it is at least as free as with it.
            cells.iter().any(|cell| bears_on(middle, *cell))
                && other.is_safe_now(self)
                && other.is_shut_in(self, me)
        })
    }
}
