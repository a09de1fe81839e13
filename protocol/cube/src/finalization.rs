//! When a module becomes finalized: in the seed cell, beside a finalized module that wants its cell filled, or in place of a dead
//! one that would have started it.

use super::message::Role;
use super::{Cube, custody};
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::goal::Growth;
use metamorph_core::lattice::Face;
use metamorph_core::time::Time;

impl Cube {
    /// Finalizes the module in the seed cell, in every incarnation: growth starts from it.
    pub(super) fn take_root(&mut self, now: Time) {
        if self.own.masks.seed
            && self.own.role != Role::Final
            && self.moving.is_none()
            && !self.own.is_quarantined(now)
        {
            self.abort_attempt(now, None);
            self.become_final(now, None);
        }
    }

    /// Becomes finalized if it stands in a goal cell that a finalized neighbour wants filled.
    pub(super) fn finalize_if_wanted(&mut self, now: Time) {
        // A module that has just restarted may be moving elsewhere without knowing it.
        let settled = self.own.role != Role::Final && self.moving.is_none() && !self.own.is_quarantined(now);
        if !settled || !self.own.masks.own {
            return;
        }
        if self.is_started_by_dead(now) {
            hit(CoveragePoint::CubeStartedByDead);
            self.abort_attempt(now, None);
            return self.become_final(now, None);
        }
        let v = self.view(now);
        let wanted_by = |f: &Face| v.live(*f).is_some_and(|b| b.wants_you && v.is_final(b));
        if let Some(face) = Face::in_mask(v.sides.live_mask()).find(wanted_by) {
            self.abort_attempt(now, None);
            self.become_final(now, Some(face));
        }
    }

    /// Returns true if a certified dead neighbour would have started this cell: rule G1 allows it, the neighbour was
    /// finalized or is held by a finalized module, and rule G2 is met, which demands that the lower neighbours of
    /// the cell are filled, except in a scaffold. A module that was called to its cell, has rested there for long or
    /// has restarted is started by any dead neighbour in a goal cell, as it would be out of turn by a live one.
    pub(super) fn is_started_by_dead(&self, now: Time) -> bool {
        let (v, masks) = (self.view(now), &self.own.masks);
        // A module that has restarted in its cell stays there in any case.
        let rests = now.since(self.own.settled) > v.params().out_of_turn_after;
        let out_of_turn = self.waits_here() || self.own.restarted || rests;
        let dead = v.sides.certified_mask() & if out_of_turn { masks.cells } else { masks.starters };
        if dead == 0 || !custody::is_announced(v) {
            return false;
        }
        let is_filled = |f: Face| v.sides.is_certified_dead(f) || v.live(f).is_some_and(|b| v.is_final(b));
        let may_grow = out_of_turn
            || self.own.grows_as() == Growth::Scaffold
            || Face::in_mask(masks.own_lower).all(is_filled);
        let is_fixed = |f: Face| self.forest.is_fixed(v, f);
        may_grow && Face::in_mask(dead).any(is_fixed)
    }

    pub(super) fn become_final(&mut self, now: Time, activator: Option<Face>) {
        (self.own.role, self.own.activator, self.own.support) = (Role::Final, activator, None);
        self.forest.on_finalized();
        self.planner.on_finalized();
        self.called = None;
        self.surveyor.settle(now);
        self.invalidate();
    }
}
