//! The state that the parts of a cube read: the module itself, its neighbours, and the time of the step.

use super::epoch::Epoch;
use super::message::{Beacon, Role};
use super::params::{Connectivity, Params, Setup};
use super::sides::Sides;
use alloc::sync::Arc;
use core::hash::{Hash, Hasher};
use core::ops::Deref;
use metamorph_core::defects::Defect;
use metamorph_core::goal::{Goal, Growth};
use metamorph_core::ids::ModuleId;
use metamorph_core::lattice::{Cell, Face};
use metamorph_core::time::Time;

/// The setup that all cubes of a swarm share. It never changes, so it is not part of an agent's state.
#[derive(Clone, Debug)]
pub(super) struct Shared(pub Arc<Setup>);

impl Deref for Shared {
    type Target = Setup;
    fn deref(&self) -> &Setup {
        &self.0
    }
}
impl PartialEq for Shared {
    fn eq(&self, other: &Shared) -> bool {
        Arc::ptr_eq(&self.0, &other.0) || self.0 == other.0
    }
}
impl Eq for Shared {}
impl Hash for Shared {
    fn hash<H: Hasher>(&self, _: &mut H) {}
}

/// The cell and its six neighbours in the goal, as masks of faces. Derived from the goal and the cell; the
/// goal's grid is looked up once per cell instead of in every step.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Default)]
pub(super) struct GoalMasks {
    /// The cell itself belongs to the goal.
    pub own: bool,
    /// The cell is the seed of the goal.
    pub seed: bool,
    /// Neighbouring cells that belong to the goal.
    pub cells: u8,
    /// Neighbouring goal cells that may be started from here, by rule G1 ([`Goal::may_start`]).
    pub next: u8,
    /// For each neighbouring goal cell, the faces towards its lower neighbours.
    pub lower: [u8; 6],
    /// Neighbouring goal cells from which this one may be started, by rule G1.
    pub starters: u8,
    /// The lower neighbours of the cell itself.
    pub own_lower: u8,
}

impl GoalMasks {
    pub fn of(goal: &Goal, cell: Cell) -> GoalMasks {
        let mut masks =
            GoalMasks { own: goal.contains(cell), seed: cell == goal.seed(), ..GoalMasks::default() };
        if masks.own {
            masks.own_lower = Face::mask(goal.lower_neighbours(cell));
        }
        for face in Face::ALL {
            let outside = cell.step(face);
            if goal.contains(outside) {
                masks.cells |= face.bit();
                masks.starters |= if goal.may_start(outside, face.opposite()) { face.bit() } else { 0 };
                masks.next |= if goal.may_start(cell, face) { face.bit() } else { 0 };
                masks.lower[face.index()] = Face::mask(goal.lower_neighbours(outside));
            }
        }
        masks
    }
}

/// State of a module itself.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Own {
    pub setup: Shared,
    pub id: ModuleId,
    pub cell: Cell,
    /// When the module arrived at its cell or, if later, restarted there.
    pub settled: Time,
    /// The epoch that it works in.
    pub epoch: Epoch,
    /// True if no module is finalized in this epoch, and none has a reason to move.
    pub is_closed: bool,
    /// When this incarnation began, by the controller's clock.
    pub born: Time,
    pub role: Role,
    /// True if it has lost its memory at this cell and cannot know its former role.
    pub restarted: bool,
    pub quarantine_until: Time,
    /// The neighbour that made this module finalized.
    pub activator: Option<Face>,
    /// The support that carries a walker.
    pub support: Option<Face>,
    /// True if too many actions of its body have failed in a row.
    pub immobile: bool,
    /// True if a module of the body has died, as far as this one has heard.
    pub knows_of_death: bool,
    /// Derived from goal and cell.
    pub masks: GoalMasks,
}

impl Own {
    pub fn goal(&self) -> &Goal {
        // Invariant: epochs are only taken up if there is a goal for them, and there is a first goal.
        &self.setup.goals[usize::from(self.epoch.goal())]
    }
    pub fn params(&self) -> &Params {
        &self.setup.params
    }
    /// Returns the connectivity check in use.
    pub fn connectivity(&self) -> Connectivity {
        self.params().connectivity_in(self.epoch)
    }
    /// Returns true if a test has switched this defect on.
    pub fn has(&self, defect: Defect) -> bool {
        self.setup.params.defect == Some(defect)
    }
    pub fn is_quarantined(&self, now: Time) -> bool {
        now < self.quarantine_until
    }
    pub fn grows_as(&self) -> Growth {
        self.goal().growth()
    }
    /// Looks up the cell in the goal, after either has changed.
    pub fn look_up(&mut self) {
        let masks = (!self.is_closed).then(|| GoalMasks::of(self.goal(), self.cell));
        self.masks = masks.unwrap_or_default();
    }
}

/// Inputs of a part of the agent in one step.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    pub now: Time,
    pub own: &'a Own,
    pub sides: &'a Sides,
}

impl<'a> View<'a> {
    pub fn params(self) -> &'a Params {
        self.own.params()
    }
    pub fn has(self, defect: Defect) -> bool {
        self.own.has(defect)
    }
    pub fn is_quarantined(self) -> bool {
        self.own.is_quarantined(self.now)
    }
    /// Returns the neighbour on a face, if it has been heard in this session.
    pub fn peer(self, face: Face) -> Option<&'a Beacon> {
        self.sides.peer(face)
    }
    /// Returns the neighbour on a face, if it is believed alive.
    pub fn live(self, face: Face) -> Option<&'a Beacon> {
        self.sides.live(face)
    }
    /// Returns the neighbour on a face, if it is a live module that can carry a walker.
    pub fn support(self, face: Face) -> Option<&'a Beacon> {
        self.sides.support(face)
    }
    /// Returns true if the neighbour on a face is certified to have died finalized in the present goal.
    pub fn died_finalized(self, face: Face) -> bool {
        self.sides.died_final(face) == Some(self.own.epoch)
    }
    /// Returns true if a beacon is from a finalized module of the present goal.
    pub fn is_final(self, b: &Beacon) -> bool {
        b.role == Role::Final && b.epoch == self.own.epoch
    }
    /// Returns true if the first beacon of a neighbour may still arrive, which may want this cell filled or tell of a
    /// shorter route. After [`Params::first_words`] at a cell, the module no longer waits for unheard neighbours.
    pub fn may_hear_more(self) -> bool {
        self.now.since(self.own.settled) < self.params().first_words() && self.sides.any_unheard()
    }
    /// Returns the number of hops to a finalized module over modules that have restarted
    /// ([`Beacon::final_hops`]). Every finalized module but the seed touches another one, and neither leaves. So if
    /// this module was finalized before it restarted, one of its neighbours is still finalized, or has forgotten its
    /// role too, or has not been heard yet; and so on up to the seed. Modules that count only on each other count up
    /// to [`Beacon::NO_FINAL`].
    pub fn final_hops(self) -> u8 {
        let hops = |b: &Beacon| if b.epoch == self.own.epoch { b.final_hops } else { 0 };
        if self.own.role == Role::Final {
            return 0;
        }
        if !self.own.restarted || !self.own.masks.own {
            return Beacon::NO_FINAL;
        }
        if self.own.masks.seed {
            return 0;
        }
        let nearest = Face::in_mask(self.sides.touching_mask()).map(|f| self.peer(f).map_or(0, hops)).min();
        nearest.map_or(Beacon::NO_FINAL, |n| n.saturating_add(1))
    }
    /// Returns true if this module may have been finalized in an earlier incarnation, so that finalized ones
    /// may hang on it.
    pub fn may_be_final(self) -> bool {
        self.own.role != Role::Final && self.final_hops() != Beacon::NO_FINAL
    }
}
