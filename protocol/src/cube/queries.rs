//! What audits, viewers and the model checker may ask of a cube. Absent: anything that changes it.

use super::message::{Entry, Rank, Role};
use super::params::Connectivity;
use super::parent_forest::UNLABELLED;
use super::{Cube, Successor};
use crate::ids::{ModuleId, Session};
use crate::lattice::{Cell, Face};
use crate::time::Time;

impl Cube {
    /// The module's part in the growth.
    pub fn role(&self) -> Role {
        self.own.role
    }
    /// The module's cell, as it believes.
    pub fn cell(&self) -> Cell {
        self.own.cell
    }
    /// The goal the module works for.
    pub fn epoch(&self) -> u16 {
        self.own.epoch
    }
    /// Depth in the parent forest; 65,535 without a parent.
    pub fn label(&self) -> u16 {
        // The time of the view plays no part in the rank.
        self.forest.told_rank(self.view(self.own.settled)).label
    }
    /// Whether the module has no place in the parent forest.
    pub fn is_unlabelled(&self) -> bool {
        self.label() == UNLABELLED
    }
    /// The place in the parent forest; without a parent, what a parent's has to be better than.
    pub fn rank(&self) -> Rank {
        self.forest.rank()
    }
    /// The face behind which the parent is.
    pub fn parent(&self) -> Option<Face> {
        self.forest.parent()
    }
    /// Whether the neighbour on a face is a registered child.
    pub fn has_child(&self, face: Face) -> bool {
        self.forest.child(face).is_some()
    }
    /// The number of registered children.
    pub fn children(&self) -> usize {
        self.forest.child_count()
    }
    /// The session the module believes to have on a face.
    pub fn session(&self, face: Face) -> Option<Session> {
        self.sides.session(face)
    }
    /// Whether the neighbour on a face has been heard in this contact session.
    pub fn has_heard(&self, face: Face) -> bool {
        self.sides.peer(face).is_some()
    }
    /// Whether the module has asked its body to move and has not heard how it went.
    pub fn is_moving(&self) -> bool {
        self.moving.is_some()
    }
    /// The field value of a face, where following it leads, and when its version was first heard of.
    pub fn attraction(&self, face: Face) -> (Entry, Option<Successor>, Time) {
        let (successor, heard) = self.attraction.successor(face);
        (self.attraction.value(face), successor, heard)
    }
    /// Since when the module has been at its cell with its memory.
    pub fn settled(&self) -> Time {
        self.own.settled
    }
    /// What the module is busy with, for people.
    pub fn activity(&self, now: Time) -> &'static str {
        match self.own.role {
            Role::Final => "finalized",
            _ if self.own.immobile => "immobile",
            _ if self.moving.is_some() => "moving",
            _ if self.attempt.is_some() => "asking",
            _ if self.own.is_quarantined(now) => "listening",
            _ if now < self.planner.back_off_until => "backing off",
            Role::Reserve if self.may_leave(now).is_err() => "holding",
            _ if self.planner.waits_for.is_some() => "waiting",
            _ => "idle",
        }
    }
    /// Until when the module stays because of a lock of `origin`.
    pub fn locked_for(&self, origin: ModuleId) -> Option<Time> {
        self.locks.iter().filter(|l| l.id.origin == origin).map(|l| l.expires).max()
    }
    /// Faces outside which the cell is kept free, and for which module.
    pub fn reservations(&self) -> Vec<(Face, ModuleId)> {
        self.locks.iter().filter_map(|l| l.reserved.map(|f| (f, l.id.origin))).collect()
    }
    /// Whether the module has restarted and is still listening.
    pub fn is_listening(&self, now: Time) -> bool {
        self.own.is_quarantined(now)
    }
    /// Whether the module has restarted and cannot know what it was before.
    pub fn has_restarted(&self) -> bool {
        self.own.restarted
    }
    /// The connectivity check in use.
    pub fn connectivity(&self) -> Connectivity {
        self.own.params().connectivity
    }
    /// Whether the module stands where its goal begins.
    pub fn is_root(&self) -> bool {
        self.own.masks.seed
    }
    /// The finalized neighbour that made this module finalized; none for the seed.
    pub fn activator(&self) -> Option<Face> {
        self.own.activator
    }
}
