//! The parent forest: the connection gradient (thesis 4.1.2) made safe for any message delay.
//!
//! Every module in reserve has one registered parent, closer to the finalized modules than itself; a
//! module that somebody calls parent does not leave. A child changes parents only after the new one
//! has acknowledged it, and a parent forgets a child only when the child says so, in the same
//! contact session. So whatever is late, lost or doubled, a parent is never a leaver.
//!
//! Also here: the published rule without registration, for comparison.

use super::message::{Beacon, Claim, Role};
use super::params::Connectivity;
use super::{Cube, UNLABELLED};
use crate::ids::ModuleId;
use crate::lattice::Face;
use crate::marks::{Mark, hit};
use crate::sabotage::Sabotage;
use crate::time::Time;

/// Why a module may not leave, and who is in the way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Held(pub Option<ModuleId>);

impl Cube {
    /// Registers or forgets the neighbour on a face as a child, as its beacon asks.
    pub(super) fn register_child(&mut self, now: Time, face: Face, beacon: &Beacon) {
        let can_adopt = self.role != Role::Walker
            && self.is_attached()
            && self.is_idle()
            && !self.is_quarantined(now)
            && self.label < beacon.label;
        let child = match beacon.claim {
            _ if beacon.role != Role::Reserve || beacon.epoch != self.epoch => None,
            Claim::None => None,
            // Also how a restarted parent learns of its children again.
            Claim::Parent(token) => Some(token),
            Claim::Want(token) if can_adopt => Some(token),
            Claim::Want(_) => self.side(face).child,
        };
        self.side_mut(face).child = child;
    }

    pub(super) fn forest_claim(&self, face: Face) -> Claim {
        match (self.want, self.parent) {
            (Some((f, token)), _) if f == face => Claim::Want(token),
            (_, Some(f)) if f == face => Claim::Parent(self.parent_token()),
            _ => Claim::None,
        }
    }

    /// Claims to a parent need not be told apart from each other, only from claims to candidates.
    fn parent_token(&self) -> crate::ids::Token {
        crate::ids::Token(u32::MAX)
    }

    /// Adopts the wanted parent once it has acknowledged, follows the parent's label down, and looks
    /// for a better parent.
    pub(super) fn tend_forest(&mut self, now: Time) {
        if self.role != Role::Reserve {
            return;
        }
        let before = (self.parent, self.label, self.want);
        if let Some((face, token)) = self.want {
            match self.live(now, face) {
                Some(b) if b.epoch == self.epoch && b.attached && b.role != Role::Walker => {
                    let (acknowledged, label) = (b.ack == Some(token), b.label);
                    if !self.adoptable(label) {
                        // It was relabelled meanwhile, or the old parent has spoken again. Whoever goes on
                        // asking keeps the other from leaving, which may be a child by now: both would wait
                        // for each other.
                        hit(Mark::CubeNotAdoptable);
                        self.want = None;
                    } else if acknowledged || self.has(Sabotage::AdoptUnacknowledged) {
                        if self.parent.is_some() {
                            hit(Mark::CubeParentReplaced);
                        }
                        self.label = label + 1;
                        self.parent = Some(face);
                        self.want = None;
                    }
                }
                _ => {
                    hit(Mark::CubeWantDropped);
                    self.want = None;
                }
            }
        }
        if let Some(b) = self.parent.and_then(|f| self.peer(f))
            && b.epoch == self.epoch
            && b.attached
            && b.label.saturating_add(1) < self.label
        {
            self.label = b.label + 1;
        }
        if self.want.is_none() && self.is_idle() {
            if self.all_heard() {
                self.look_for_parent(now);
            } else {
                hit(Mark::CubeRebornWaits);
            }
        }
        if before != (self.parent, self.label, self.want) {
            self.touch();
            self.decide_soon(now);
        }
    }

    /// A parent's label must be lower than ours, so that labels fall along parents; without children
    /// that could form a ring, ours may also rise when the parent is gone.
    /// It must also leave room below the children: the candidate may have been relabelled since it
    /// was chosen.
    fn adoptable(&self, label: u16) -> bool {
        label.saturating_add(1) < self.least_child_label()
            && (label < self.label || (self.children() == 0 && self.parent_is_gone()))
    }

    fn least_child_label(&self) -> u16 {
        let children = Face::ALL.into_iter().filter(|f| self.side(*f).child.is_some());
        children.map(|f| self.peer(f).map_or(0, |b| b.label)).min().unwrap_or(UNLABELLED)
    }

    fn parent_is_gone(&self) -> bool {
        self.parent.is_none_or(|f| self.side(f).condemned || self.side(f).peer.is_none())
    }

    /// After a restart every neighbour must have been heard, however long it takes, before a parent
    /// is chosen: one that is silent, even dead, may be a child, and what it carries must not become
    /// the parent.
    fn all_heard(&self) -> bool {
        !self.reborn || self.sides.iter().all(|s| s.session.is_none() || s.peer.is_some())
    }

    fn look_for_parent(&mut self, now: Time) {
        let least_child = self.least_child_label();
        let candidate = Face::ALL
            .into_iter()
            .filter_map(|f| {
                let b = self.terrain(now, f)?;
                let usable = b.attached
                    && b.epoch == self.epoch
                    && b.claim == Claim::None
                    && !b.quarantined
                    && self.parent != Some(f)
                    && b.label.saturating_add(1) < least_child;
                usable.then_some((b.label, f))
            })
            .min();
        let Some((label, face)) = candidate else { return };
        let suspected = self.parent.is_some_and(|f| self.live(now, f).is_none());
        if label.saturating_add(1) < self.label {
            let token = self.token();
            self.want = Some((face, token));
        } else if suspected && self.children() == 0 {
            hit(Mark::CubeParentSuspected);
            self.label = self.label.max(label.saturating_add(1));
            let token = self.token();
            self.want = Some((face, token));
        }
    }

    /// The published rule: the label is one more than the least label heard from a neighbour.
    pub(super) fn tend_gradient(&mut self, now: Time) {
        if self.role == Role::Final {
            return;
        }
        let least = Face::ALL
            .into_iter()
            .filter_map(|f| self.terrain(now, f))
            .filter(|b| b.epoch == self.epoch && b.attached)
            .map(|b| b.label)
            .min();
        // Without a bound labels of a part that has lost its source would count up for ever.
        let label =
            least.map(|l| l.saturating_add(1)).filter(|l| *l < self.setup.params.range).unwrap_or(UNLABELLED);
        let label = if self.role == Role::Reserve { label } else { UNLABELLED };
        if label != self.label {
            self.label = label;
            self.touch();
            self.decide_soon(now);
        }
    }

    /// In the published rule a module depends on a neighbour if no other has a lower label.
    pub(super) fn gradient_claim(&self, now: Time, face: Face) -> Claim {
        let lower = |f: Face| self.terrain(now, f).is_some_and(|b| b.attached && b.label < self.label);
        let others = Face::ALL.into_iter().any(|f| f != face && lower(f));
        if lower(face) && !others { Claim::Parent(self.parent_token()) } else { Claim::None }
    }

    /// Whether a module in reserve may leave the body, as far as it knows: it is attached and has no
    /// children, nobody has locked it, and every neighbour is known to hold on to something else.
    pub(super) fn may_leave(&self, now: Time) -> Result<(), Held> {
        if !self.is_attached() || self.is_quarantined(now) {
            return Err(Held(None));
        }
        // A restarted module in a goal cell may have been finalized before, and others may hang on it.
        if self.reborn && self.goal().contains(self.cell) {
            return Err(Held(None));
        }
        let locked = self.locks.iter().find(|l| l.expires > now);
        if let Some(lock) = locked.filter(|_| !self.has(Sabotage::IgnoreLocks)) {
            return Err(Held(Some(lock.id.origin)));
        }
        Face::ALL.into_iter().find_map(|face| self.held_by(now, face)).map_or(Ok(()), Err)
    }

    /// Whether the neighbour on a face may hang on this module, as far as it has said.
    fn held_by(&self, now: Time, face: Face) -> Option<Held> {
        let side = self.side(face);
        side.session?;
        let Some(peer) = &side.peer else {
            return (!self.has(Sabotage::IgnoreStrangers)).then_some(Held(None));
        };
        let b = &peer.beacon;
        let silent = now.since(peer.heard) > self.setup.params.suspect;
        let forgotten = silent && self.has(Sabotage::DropSilentChildren);
        let free = match b.role {
            _ if b.epoch != self.epoch => false,
            _ if forgotten => true,
            Role::Final => true,
            Role::Walker => !b.anchored_here,
            // A cycle can only be locked over modules that answer.
            Role::Reserve if self.setup.params.connectivity == Connectivity::Cycles => {
                !silent && !side.condemned
            }
            Role::Reserve => b.attached && b.claim == Claim::None && side.child.is_none(),
        };
        (!free).then_some(Held(Some(b.id)))
    }

    /// Whether somebody who seems dead keeps this module from ever leaving.
    pub(super) fn is_pinned(&self, now: Time) -> bool {
        let is_gone = |f: Face| {
            let side = self.side(f);
            side.condemned || (side.peer.is_some() && self.live(now, f).is_none())
        };
        self.role == Role::Reserve
            && Face::ALL.into_iter().any(|f| is_gone(f) && self.held_by(now, f).is_some())
    }
}
