//! Read-only queries about a cube, for audits, viewers and the model checker. None changes its state.

use super::control::CustodyKey;
use super::epoch::Epoch;
use super::message::{Entry, Rank, Role};
use super::params::Connectivity;
use super::parent_forest::UNLABELLED;
use super::{Cube, Successor};
use alloc::vec::Vec;
use metamorph_core::ids::{ModuleId, Session};
use metamorph_core::lattice::{Cell, Face};
use metamorph_core::time::Time;

impl Cube {
    /// Returns the role of the module in the growth.
    pub fn role(&self) -> Role {
        self.own.role
    }
    /// Returns the cell that the module believes itself to be in.
    pub fn cell(&self) -> Cell {
        self.own.cell
    }
    /// Returns the epoch that the module works in.
    pub fn epoch(&self) -> Epoch {
        self.own.epoch
    }
    /// Returns the depth in the parent forest; 65,535 without a parent.
    pub fn label(&self) -> u16 {
        // The time of the view does not affect the rank.
        self.forest.told_rank(self.view(self.own.settled), true).label
    }
    /// Returns true if the module has no place in the parent forest.
    pub fn is_unlabelled(&self) -> bool {
        self.label() == UNLABELLED
    }
    /// Returns the rank in the parent forest. For a module without a parent it is a bound: the rank of its next parent
    /// must be better.
    pub fn rank(&self) -> Rank {
        self.forest.rank()
    }
    /// Returns the face of the parent.
    pub fn parent(&self) -> Option<Face> {
        self.forest.parent()
    }
    /// Returns true if the neighbour on a face is a registered child.
    pub fn has_child(&self, face: Face) -> bool {
        self.forest.child(face).is_some()
    }
    /// Returns the faces whose neighbour has been heard in its contact session.
    pub fn heard_faces(&self) -> u8 {
        self.sides.heard_mask()
    }
    /// Returns the faces with registered children.
    pub fn child_faces(&self) -> u8 {
        Face::mask(Face::ALL.into_iter().filter(|f| self.has_child(*f)))
    }
    /// Returns the number of locks that the module has granted.
    pub fn granted(&self) -> usize {
        self.locks.len()
    }
    /// Returns the faces whose neighbour is certified dead.
    pub fn certified_faces(&self) -> u8 {
        self.sides.certified_mask()
    }
    /// Returns the time of death of the neighbour on a face, if the module has announced for its current goal that it
    /// holds that neighbour.
    pub fn custody(&self, face: Face) -> Option<Time> {
        let custody = self.forest.custody();
        custody.died(face).filter(|_| custody.is_announced(face))
    }
    /// Returns true if the module stays because of the neighbour on a face, or stays anyway.
    pub fn keeps(&self, now: Time, face: Face) -> bool {
        let v = self.view(now);
        match self.own.role {
            Role::Final => true,
            Role::Walker => false,
            Role::Reserve => {
                let stays = v.is_quarantined() || v.may_be_final() || !self.forest.is_attached(v);
                stays || self.forest.holds(v, face)
            }
        }
    }
    /// Returns the module's place in the order of holders, as it has announced it for the dead neighbour on a face; `None` if it has
    /// announced nothing, or let go.
    pub fn custody_key(&self, face: Face) -> Option<CustodyKey> {
        self.forest.custody().own(self.view(self.own.settled), face)
    }
    /// Returns true if the controller leads the module somewhere.
    pub fn is_called(&self) -> bool {
        self.called.is_some()
    }
    /// Returns the number of registered children.
    pub fn children(&self) -> usize {
        self.forest.child_count()
    }
    /// Returns the contact session on a face, as far as the module knows.
    pub fn session(&self, face: Face) -> Option<Session> {
        self.sides.session(face)
    }
    /// Returns true if the neighbour on a face has been heard in this contact session.
    pub fn has_heard(&self, face: Face) -> bool {
        self.sides.peer(face).is_some()
    }
    /// Returns true if the module has asked its body to move and has not received the percept yet.
    pub fn is_moving(&self) -> bool {
        self.moving.is_some()
    }
    /// Returns the field value of a face, where following it leads, and when its version was first heard.
    pub fn attraction(&self, face: Face) -> (Entry, Option<Successor>, Time) {
        let (successor, heard) = self.attraction.successor(face);
        (self.attraction.value(face), successor, heard)
    }
    /// Returns true if nothing is built in the present epoch, and no module moves unless it is called.
    pub fn is_closed(&self) -> bool {
        self.own.is_closed
    }
    /// Returns the time at which the module arrived at its cell or, if later, restarted there.
    pub fn settled(&self) -> Time {
        self.own.settled
    }
    /// Returns the current activity, for viewers.
    pub fn activity(&self, now: Time) -> &'static str {
        match self.own.role {
            Role::Final => "finalized",
            _ if self.own.immobile => "immobile",
            _ if self.moving.is_some() => "moving",
            _ if self.attempt.is_some() => "asking",
            _ if self.own.is_quarantined(now) => "listening",
            _ if now < self.planner.back_off_until => "backing off",
            Role::Reserve if self.may_leave(now).is_err() => "holding",
            _ if self.planner.waiting_since.is_some() => "waiting",
            _ => "idle",
        }
    }
    /// Returns when the last lock that the module has granted to `origin` expires.
    pub fn locked_for(&self, origin: ModuleId) -> Option<Time> {
        self.locks.iter().filter(|l| l.id.origin == origin).map(|l| l.expires).max()
    }
    /// Returns the faces outside which the cell is reserved, and for which module.
    pub fn reservations(&self) -> Vec<(Face, ModuleId)> {
        self.locks.iter().filter_map(|l| l.reserved.map(|f| (f, l.id.origin))).collect()
    }
    /// Returns true if the module has restarted and is still listening.
    pub fn is_listening(&self, now: Time) -> bool {
        self.own.is_quarantined(now)
    }
    /// Returns true if the module may have been finalized before it restarted: then it stays permanently.
    pub fn may_be_final(&self, now: Time) -> bool {
        self.view(now).may_be_final()
    }
    /// Returns true if the module has restarted and cannot know its former role.
    pub fn has_restarted(&self) -> bool {
        self.own.restarted
    }
    /// Returns the connectivity check in use.
    pub fn connectivity(&self) -> Connectivity {
        self.own.connectivity()
    }
    /// Returns true if the module stands at the seed of its goal.
    pub fn is_root(&self) -> bool {
        self.own.masks.seed
    }
    /// Returns the cell from which the module's goal grows.
    pub fn seed(&self) -> Cell {
        self.own.goal().seed()
    }
    /// Returns the face of the finalized neighbour that made this module finalized; `None` for the seed.
    pub fn activator(&self) -> Option<Face> {
        self.own.activator
    }
}
