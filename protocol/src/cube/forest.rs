//! The parent forest: the connection gradient (thesis 4.1.2) made safe for any message delay.
//!
//! Every module in reserve has one registered parent, closer to the finalized modules than itself; a
//! module that somebody calls parent does not leave. A child changes parents only after the new one
//! has acknowledged it, and a parent forgets a child only when the child says so, in the same
//! contact session. So whatever is late, lost or doubled, a parent is never a leaver.
//!
//! Whoever has forgotten its parent keeps all its neighbours from leaving, since one of them may have been
//! it, and takes another only on proof that the way to the finalized modules does not lead over itself:
//! the way must be known anew since it forgot ([`Rank`]), and nobody without a parent passes that on. For
//! the same proof asks whoever has lost its parent and would fall back. Finalized modules give it when
//! they are asked ([`Beacon::renew`]), so it costs nothing while nothing fails.
//!
//! Also here: the published rule without registration, for comparison.

use super::message::{Beacon, Claim, Rank, Role};
use super::params::Connectivity;
use super::{Cube, Side, UNLABELLED};
use crate::ids::ModuleId;
use crate::lattice::Face;
use crate::marks::{Mark, hit};
use crate::sabotage::Sabotage;
use crate::time::{Span, Time};

/// Why a module may not leave, and who is in the way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Held(pub Option<ModuleId>);

impl Cube {
    /// Registers or forgets the neighbour on a face as a child, as its beacon asks.
    pub(super) fn register_child(&mut self, now: Time, face: Face, beacon: &Beacon) {
        let can_adopt =
            self.role != Role::Walker && self.is_attached() && self.is_idle() && !self.is_quarantined(now);
        let child = match beacon.claim {
            _ if beacon.role != Role::Reserve || beacon.epoch != self.epoch => None,
            // What it said before that came late.
            _ if self.died_finalized(face) => None,
            Claim::None => None,
            // Also how a restarted parent learns of its children again.
            Claim::Parent(token) => Some(token),
            Claim::Want(token) if can_adopt => Some(token),
            Claim::Want(_) => self.side(face).child,
        };
        self.side_mut(face).child = child;
    }

    /// The rank that the neighbours are told.
    pub(super) fn told_rank(&self) -> Rank {
        let is_lost = self.setup.params.connectivity == Connectivity::Forest && !self.is_attached();
        if is_lost { Rank { label: UNLABELLED, ..self.rank } } else { self.rank }
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

    /// Adopts the wanted parent once it has acknowledged, follows the parent's rank, and looks for a
    /// better parent.
    pub(super) fn tend_forest(&mut self, now: Time) {
        match self.role {
            Role::Reserve => {}
            Role::Walker => return,
            Role::Final => return self.renew_root(now),
        }
        let before = (self.parent, self.rank, self.want, self.renew);
        match self.dead_root() {
            Some(face) if self.is_idle() => self.hang_on_dead(now, face),
            _ => self.tend_parent(now),
        }
        if before != (self.parent, self.rank, self.want, self.renew) {
            self.touch();
            self.decide_soon(now);
        }
    }

    /// A dead finalized neighbour, if there is one, and the parent rather than another. It never leaves, and
    /// hangs together with all that is finalized.
    fn dead_root(&self) -> Option<Face> {
        let is_final = |b: &Beacon| b.role == Role::Final && b.epoch == self.epoch;
        let is_root = |f: &Face| {
            self.died_finalized(*f) || (self.side(*f).condemned && self.peer(*f).is_some_and(is_final))
        };
        self.parent.into_iter().chain(Face::ALL).find(is_root)
    }

    /// Whether the neighbour on a face is certified to have died finalized, heard or not.
    pub(super) fn died_finalized(&self, face: Face) -> bool {
        self.side(face).died_final == Some(self.epoch)
    }

    /// Whoever hangs on a dead finalized module needs no leave to, and vouches for it.
    fn hang_on_dead(&mut self, now: Time, face: Face) {
        if self.parent != Some(face) {
            hit(Mark::CubeHangsOnDead);
            let vouched = self.peer(face).map_or(Time::ZERO, |b| b.rank.rooted);
            self.rank = Rank { rooted: self.rank.rooted.max(vouched), label: 1 };
            self.parent = Some(face);
        }
        (self.want, self.renew) = (None, Time::ZERO);
        self.renew_root(now);
    }

    fn tend_parent(&mut self, now: Time) {
        if let Some((face, token)) = self.want {
            match self.live(now, face) {
                Some(b) if b.epoch == self.epoch && b.attached && b.role != Role::Walker => {
                    let (acknowledged, rank) = (b.ack == Some(token), b.rank);
                    let is_worth_it = self.is_worth_it(b, self.needs_parent(now));
                    if !(rank.is_above(self.rank) && is_worth_it) {
                        // It was relabelled meanwhile, or the old parent has spoken again. Whoever goes on
                        // asking keeps the other from leaving, which may be a child by now: both would wait
                        // for each other.
                        hit(Mark::CubeNotAdoptable);
                        self.want = None;
                    } else if acknowledged || self.has(Sabotage::AdoptUnacknowledged) {
                        if self.parent.is_some() {
                            hit(Mark::CubeParentReplaced);
                        }
                        self.rank = rank.below();
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
            && b.rank.below().is_above(self.rank)
        {
            self.rank = b.rank.below();
        }
        if self.want.is_none() && self.is_idle() {
            if self.all_heard() {
                self.look_for_parent(now);
            } else {
                hit(Mark::CubeRebornWaits);
            }
        }
    }

    /// A finalized module vouches for itself whenever it is asked; so does whoever hangs on a dead one.
    fn renew_root(&mut self, now: Time) {
        let asked = self.asked(None);
        if asked > self.rank.rooted && asked <= now {
            hit(Mark::CubeRootRenewed);
            self.rank.rooted = asked;
            self.touch();
        }
    }

    /// The latest time at which the neighbours, all but one, need the way to be known anew.
    fn asked(&self, except: Option<Face>) -> Time {
        let others = Face::ALL.into_iter().filter(|f| Some(*f) != except);
        let renew = others.filter_map(|f| self.peer(f)).filter(|b| b.epoch == self.epoch).map(|b| b.renew);
        renew.max().unwrap_or(Time::ZERO)
    }

    /// What a neighbour is asked for, as [`Beacon::renew`]: what this module itself needs, or what it has
    /// been asked for and does not have. The latter is for its parent; but if it was the parent that has
    /// asked, somebody else has to know.
    pub(super) fn renewal(&self, now: Time, face: Face) -> Time {
        if self.role != Role::Reserve || self.setup.params.connectivity != Connectivity::Forest {
            return Time::ZERO;
        }
        // Those that hang on it know last.
        let is_last_resort = self.side(face).child.is_some();
        let own = if is_last_resort && now.since(self.settled) <= self.setup.params.suspect {
            Time::ZERO
        } else {
            self.renew
        };
        let passed_on = match self.parent {
            Some(parent) if parent == face => self.asked(Some(face)),
            Some(parent) => self.peer(parent).map_or(Time::ZERO, |b| b.renew),
            None => Time::ZERO,
        };
        own.max(if passed_on > self.rank.rooted { passed_on } else { Time::ZERO })
    }

    /// After a restart every neighbour must have been heard, however long it takes, before a parent is
    /// chosen: one that is silent may be a child in a later goal than this module knows of. The dead are no
    /// more than the goal that their certificate names.
    fn all_heard(&self) -> bool {
        let is_last_goal = usize::from(self.epoch) + 1 == self.setup.goals.len();
        let is_known = |s: &Side| s.session.is_none() || s.peer.is_some() || s.condemned;
        !self.reborn || is_last_goal || self.sides.iter().all(is_known)
    }

    /// Whether any parent is better than none, or than the present one: that is silent, or asks itself.
    fn needs_parent(&self, now: Time) -> bool {
        self.parent.is_none_or(|f| {
            // Whoever has children stays anyhow, and leaves its parent only for their sake.
            let is_missed = self.children() == 0 || self.asked(None) > self.rank.rooted;
            (is_missed && self.live(now, f).is_none())
                || self.peer(f).is_some_and(|b| b.renew > self.rank.rooted)
        })
    }

    /// Whether a neighbour would be the better parent. Whoever stays for good had better hang on somebody
    /// who does so too.
    fn is_worth_it(&self, b: &Beacon, needs_parent: bool) -> bool {
        let stays = |f: Face| self.peer(f).is_none_or(|p| p.final_hops != Beacon::NO_FINAL);
        let is_steadier =
            self.may_be_final() && b.final_hops < self.final_hops() && !self.parent.is_some_and(stays);
        b.rank.below().label < self.rank.label || needs_parent || is_steadier
    }

    fn look_for_parent(&mut self, now: Time) {
        let needs_parent = self.needs_parent(now);
        let (mut best, mut is_refused) = (None, false);
        for face in Face::ALL {
            let Some(b) = self.terrain(now, face) else { continue };
            let usable = b.attached
                && b.epoch == self.epoch
                && b.claim == Claim::None
                && !b.quarantined
                && self.parent != Some(face)
                && self.is_worth_it(b, needs_parent);
            if usable && b.rank.is_above(self.rank) {
                let offer = (b.rank.label, face);
                best = Some(best.map_or(offer, |other: (u16, Face)| other.min(offer)));
            } else {
                is_refused |= usable;
            }
        }
        self.renew = if let Some((_, face)) = best {
            if self.parent.is_some() && needs_parent {
                hit(Mark::CubeParentSuspected);
            }
            let token = self.token();
            self.want = Some((face, token));
            Time::ZERO
        } else if needs_parent && self.rank.label != UNLABELLED {
            hit(Mark::CubeRenewalAsked);
            self.asked(None).max(self.rank.rooted + Span(1))
        } else if is_refused {
            self.rank.rooted
        } else {
            Time::ZERO
        };
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
            .map(|b| b.rank.label)
            .min();
        // Without a bound labels of a part that has lost its source would count up for ever.
        let label =
            least.map(|l| l.saturating_add(1)).filter(|l| *l < self.setup.params.range).unwrap_or(UNLABELLED);
        let label = if self.role == Role::Reserve { label } else { UNLABELLED };
        if label != self.rank.label {
            self.rank.label = label;
            self.touch();
            self.decide_soon(now);
        }
    }

    /// In the published rule a module depends on a neighbour if no other has a lower label.
    pub(super) fn gradient_claim(&self, now: Time, face: Face) -> Claim {
        let lower =
            |f: Face| self.terrain(now, f).is_some_and(|b| b.attached && b.rank.label < self.rank.label);
        let others = Face::ALL.into_iter().any(|f| f != face && lower(f));
        if lower(face) && !others { Claim::Parent(self.parent_token()) } else { Claim::None }
    }

    /// Whether a module in reserve may leave the body, as far as it knows: it is attached and has no
    /// children, nobody has locked it, and every neighbour is known to hold on to something else.
    pub(super) fn may_leave(&self, now: Time) -> Result<(), Held> {
        if !self.is_attached() || self.is_quarantined(now) || self.may_be_final() {
            return Err(Held(None));
        }
        let locked = self.locks.iter().find(|l| l.expires > now);
        if let Some(lock) = locked.filter(|_| !self.has(Sabotage::IgnoreLocks)) {
            return Err(Held(Some(lock.id.origin)));
        }
        Face::ALL.into_iter().find_map(|face| self.held_by(now, face)).map_or(Ok(()), Err)
    }

    /// Whether this module may have been finalized in an earlier life, so that finalized ones may hang on
    /// it.
    pub(super) fn may_be_final(&self) -> bool {
        self.role != Role::Final && self.final_hops() != Beacon::NO_FINAL
    }

    /// See [`Beacon::final_hops`]. Whoever is finalized touches somebody who is, and neither leaves: so one of
    /// its neighbours is finalized still, or has forgotten it as well, or has not been heard, and so on up to
    /// the seed. Those who only think so because of each other count up and see it.
    pub(super) fn final_hops(&self) -> u8 {
        let hops = |b: &Beacon| if b.epoch == self.epoch { b.final_hops } else { 0 };
        if self.role == Role::Final {
            return 0;
        }
        if !self.reborn || !self.goal().contains(self.cell) {
            return Beacon::NO_FINAL;
        }
        if self.is_root() {
            return 0;
        }
        let touched = self.sides.iter().filter(|s| s.session.is_some());
        let nearest = touched.map(|s| s.peer.as_ref().map_or(0, |p| hops(&p.beacon))).min();
        nearest.map_or(Beacon::NO_FINAL, |n| n.saturating_add(1))
    }

    /// Whether the neighbour on a face may hang on this module, as far as it has said.
    fn held_by(&self, now: Time, face: Face) -> Option<Held> {
        let side = self.side(face);
        side.session?;
        if self.died_finalized(face) {
            return None;
        }
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
        // A dead finalized neighbour would have to say whether this one was finalized.
        let holds = |f: Face| self.may_be_final() || self.held_by(now, f).is_some();
        self.role == Role::Reserve && Face::ALL.into_iter().any(|f| is_gone(f) && holds(f))
    }
}
