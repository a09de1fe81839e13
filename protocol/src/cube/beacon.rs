//! Beacons: what a module tells its neighbours about itself, and what it makes of theirs.

use super::control::Status;
use super::field::{Limits, Offer, newer};
use super::message::{Beacon, Claim, Entry, Message, Role};
use super::params::Connectivity;
use super::{Cube, Peer, UNLABELLED};
use crate::agent::{Class, Output};
use crate::goal::Growth;
use crate::lattice::Face;
use crate::marks::{Mark, hit};
use crate::sabotage::Sabotage;
use crate::time::{Span, Time};

/// Marks an offer that comes from another face of the same module.
pub(super) const OWN: u8 = 6;
/// Marks an offer of a module one further out, which touches the same cell.
pub(super) const SAME_CELL: u8 = 12;

/// A target has come much closer by this part of its distance.
const MUCH_CLOSER: u16 = 8;

impl Cube {
    pub(super) fn on_beacon(&mut self, now: Time, face: Face, beacon: Beacon) {
        if let Some(peer) = &self.side(face).peer {
            let late = peer.beacon.sequence >= beacon.sequence;
            // One session has one neighbour; anything else is garbage.
            if late || peer.beacon.id != beacon.id {
                hit(Mark::CubeBeaconLate);
                return;
            }
            let is_known = (Beacon { sequence: beacon.sequence, ..peer.beacon }) == beacon;
            if self.is_missed(now, face) {
                self.wait_for_news(now);
            }
            if is_known {
                self.side_mut(face).peer = Some(Peer { beacon, heard: now });
                return;
            }
        }
        if beacon.id == self.id {
            return;
        }
        let corner_hint = self.setup.params.corner_hint;
        let side = self.side_mut(face);
        side.peer = Some(Peer { beacon, heard: now });
        if beacon.corners != 0 {
            side.corners |= beacon.corners;
            side.corners_until = now + corner_hint;
        }
        if beacon.epoch > self.epoch {
            self.follow_epoch(now, beacon.epoch);
        }
        // A walker that has arrived needs its reservation no more: it is anchored by contact now.
        self.release_locks(|lock| lock.id.origin == beacon.id && lock.reserved == Some(face));
        self.register_child(now, face, &beacon);
        if self.role == Role::Reserve {
            for entry in beacon.field.iter().filter(|e| e.is_known()) {
                self.hear_of(now, entry.source);
            }
        }
        self.touch();
        self.decide_soon(now);
    }

    /// What has long been unfilled may only have been out of hearing: before any is started out of turn there
    /// is time for distances to come from there.
    fn wait_for_news(&mut self, now: Time) {
        hit(Mark::CubeWaitsForNews);
        let (relax, hold) = (self.setup.params.relax, self.setup.params.hold);
        for side in &mut self.sides {
            side.unfilled_since = side.unfilled_since.map(|since| since.max(now + hold - relax));
        }
        self.field_stale = true;
    }

    /// Becomes finalized if it stands in a goal cell that a finalized neighbour wants filled.
    pub(super) fn finalize_if_wanted(&mut self, now: Time) {
        // A module that has just restarted may be on its way elsewhere without knowing.
        let settled = self.role != Role::Final && self.moving.is_none() && !self.is_quarantined(now);
        if !settled || !self.goal().contains(self.cell) {
            return;
        }
        let wanted_by = |f: &Face| {
            self.live(now, *f).is_some_and(|b| b.wants_you && b.role == Role::Final && b.epoch == self.epoch)
        };
        if let Some(face) = Face::ALL.into_iter().find(wanted_by) {
            self.abort_attempt(now, None);
            self.become_final(Some(face));
        }
    }

    /// Whether this finalized module wants the cell outside a face filled.
    pub(super) fn wants(&self, now: Time, face: Face) -> bool {
        self.target(now, face).is_some()
    }

    /// The distance at which the cell outside a face attracts, if this finalized module wants it filled:
    /// none by rules G1 and G2, and far if it has only been unfilled for long. Filled before its turn it may
    /// wall in another, so that is for when nobody hears of any other.
    fn target(&self, now: Time, face: Face) -> Option<u16> {
        if self.role != Role::Final {
            return None;
        }
        let (goal, cell) = (self.goal(), self.cell.step(face));
        if !goal.contains(cell) || self.peer(face).is_some_and(|b| b.role == Role::Final) {
            return None;
        }
        let is_next = goal.may_start(self.cell, face)
            && (goal.growth() == Growth::Scaffold
                || self.has(Sabotage::AnyLowerOnSolids)
                || self.lower_are_filled(now, face));
        if is_next {
            return Some(0);
        }
        let relaxed = |since: Time| now.since(since) > self.setup.params.relax;
        let far = self.setup.params.range.min(Entry::MAX_MOVES) / 2 * Entry::MOVE;
        // Who stands there anyhow is in nobody's way more than before.
        let is_taken = || self.peer(face).is_some_and(|b| b.role == Role::Reserve || b.immobile);
        let is_last_hope = || self.sides.iter().all(|s| s.field.value().distance >= far);
        let is_due = self.side(face).unfilled_since.is_some_and(relaxed)
            && !Face::ALL.into_iter().any(|f| self.is_missed(now, f))
            && (is_taken() || is_last_hope());
        is_due.then(|| {
            hit(Mark::CubeRelaxed);
            far
        })
    }

    /// Whether the neighbour on a face has fallen silent and is not certified dead: whoever is behind it
    /// cannot be heard either.
    fn is_missed(&self, now: Time, face: Face) -> bool {
        let side = self.side(face);
        side.peer.is_some() && !side.condemned && self.live(now, face).is_none()
    }

    /// Rule G2: every lower neighbour of the cell is finalized, as far as the common neighbours that
    /// can see it say.
    fn lower_are_filled(&self, now: Time, face: Face) -> bool {
        let (goal, cell) = (self.goal(), self.cell.step(face));
        goal.lower_neighbours(cell).all(|toward| {
            if toward == face.opposite() {
                return true;
            }
            match toward.slot_in(face) {
                // The lower cell lies beside ours, seen by the module that both touch.
                Some(_) if goal.contains(self.cell.step(toward)) => {
                    self.terrain(now, toward).is_some_and(|b| b.finals & face.bit() != 0)
                }
                // Opposite fronts, or nobody in between: nothing to go by.
                _ => true,
            }
        })
    }

    pub(super) fn wanted_faces(&self, now: Time) -> impl Iterator<Item = Face> + '_ {
        Face::ALL.into_iter().filter(move |f| self.wants(now, *f))
    }

    /// Versions count the refresh periods of this module, whose phase is its own so that not all
    /// sources flood at once. They go on after a restart.
    fn version(&self, now: Time) -> u16 {
        self.version_of(self.id.0, now)
    }
    fn version_of(&self, id: u32, now: Time) -> u16 {
        (self.phased(id, now) / self.setup.params.refresh.0.max(1)) as u16
    }
    fn phased(&self, id: u32, now: Time) -> u64 {
        let refresh = self.setup.params.refresh.0.max(1);
        now.0.saturating_add(u64::from(id).wrapping_mul(0x9E37_79B9_7F4A_7C15) % refresh)
    }
    /// Whether an earlier life of this module may have told of this version: what is heard of it may be its
    /// own word that comes back, and lead in a circle.
    fn may_be_own_word(&self, entry: Entry) -> bool {
        self.reborn
            && entry.is_known()
            && !self.has(Sabotage::AcceptStaleValues)
            && !newer(entry.version, self.version_of(entry.source >> 3, self.settled))
    }
    pub(super) fn next_refresh(&self, now: Time) -> Time {
        let refresh = self.setup.params.refresh.0.max(1);
        now + Span(refresh - self.phased(self.id.0, now) % refresh)
    }

    fn corner_blocked(&self, now: Time, a: Face, b: Face) -> bool {
        let one_way = |f: Face, d: Face| {
            let side = self.side(f);
            side.corners & d.bit() != 0 && now < side.corners_until
        };
        one_way(a, b) || one_way(b, a)
    }

    /// Recomputes the attraction field of all faces from what the neighbours said last.
    pub(super) fn tend_field(&mut self, now: Time) {
        let due = self.sides.iter().any(|s| s.field.expires(self.setup.params.hold) <= now)
            || (self.role == Role::Final && self.targets_are_old(now));
        if !self.field_stale && !due {
            return;
        }
        self.field_stale = false;
        if self.role == Role::Final {
            self.note_unfilled(now);
        }
        let p = &self.setup.params;
        let limits = Limits {
            hold: p.hold,
            range: p.range.min(Entry::MAX_MOVES) * Entry::MOVE,
            accept_stale: self.has(Sabotage::AcceptStaleValues),
        };
        let version = self.version(now);
        let open = Face::ALL.map(|f| self.is_open(now, f));
        let mut changed_any = false;
        // A walker is traffic, not terrain: nobody walks over it.
        let carries = self.role != Role::Walker;
        // Faces depend on each other; distances only fall within one round of settling, and no path
        // over one module is longer than its six faces.
        for _ in 0..6 {
            let mut changed = false;
            for face in Face::ALL {
                let i = face.index();
                changed |= if !open[i] || !carries {
                    self.sides[i].field.set(Entry::NONE)
                } else if self.side(face).session.is_none()
                    && let Some(distance) = self.target(now, face)
                {
                    let source = self.id.0 << 3 | face as u32;
                    self.sides[i].field.set(Entry { distance, source, version })
                } else {
                    let (mut offers, n) = self.offers(now, face, &open);
                    // What comes back of this face's own word is no news of a target.
                    let own = self.id.0 << 3 | face as u32;
                    let is_own = |e: Entry| e.source == own || self.may_be_own_word(e);
                    for offer in offers.iter_mut().filter(|o| is_own(o.entry)) {
                        offer.entry = Entry::NONE;
                    }
                    self.sides[i].field.choose(now, limits, &offers[..n])
                };
            }
            changed_any |= changed;
            if !changed {
                break;
            }
        }
        if changed_any {
            for side in &mut self.sides {
                side.stale = true;
            }
        }
    }

    /// Whether a face that is a target does not say so, in the present version.
    fn targets_are_old(&self, now: Time) -> bool {
        let version = self.version(now);
        Face::ALL.into_iter().filter(|f| self.side(*f).session.is_none()).any(|f| {
            let value = self.side(f).field.value();
            self.target(now, f).is_some_and(|distance| (value.distance, value.version) != (distance, version))
        })
    }

    /// Notes since when goal cells around a finalized module have been unfilled.
    fn note_unfilled(&mut self, now: Time) {
        for face in Face::ALL {
            let unfilled = self.goal().contains(self.cell.step(face))
                && self.peer(face).is_none_or(|b| b.role != Role::Final)
                && !self.side(face).condemned;
            let since = &mut self.side_mut(face).unfilled_since;
            *since = if unfilled { since.or(Some(now)) } else { None };
        }
    }

    /// The distances that the cell outside `face` can be given: along neighbouring modules, and
    /// around the edges of this one.
    fn offers(&self, now: Time, face: Face, open: &[bool; 6]) -> ([Offer; 4], usize) {
        let mut offers = [Offer { entry: Entry::NONE, cost: 0, via: 0 }; 4];
        let mut n = 0;
        let mut add = |offer| {
            offers[n] = offer;
            n += 1;
        };
        for heading in face.perpendicular() {
            if let Some(beacon) = self.terrain(now, heading) {
                // What was known of another goal's targets was forgotten with that goal, so that their
                // distances could lead in circles.
                if beacon.epoch != self.epoch {
                    continue;
                }
                let slot = face.slot_in(heading).unwrap_or(0);
                // A module one further out touches the very same cell; otherwise it is one slide.
                let (cost, via) = match beacon.terrain & face.bit() {
                    0 => (Entry::MOVE, heading as u8),
                    _ => (1, SAME_CELL + heading as u8),
                };
                add(Offer { entry: beacon.field[slot], cost, via });
            } else if open[heading.index()] && !self.corner_blocked(now, face, heading) {
                let entry = self.side(heading).field.value();
                add(Offer { entry, cost: Entry::MOVE, via: OWN + heading as u8 });
            }
        }
        (offers, n)
    }

    /// What a walker on `face` would find in each of its four headings.
    fn advertised(&self, now: Time, face: Face) -> [Entry; 4] {
        face.perpendicular().map(|heading| {
            if self.is_open(now, heading) {
                self.side(heading).field.value()
            } else {
                match self.terrain(now, heading) {
                    Some(b) if b.terrain & face.bit() == 0 && b.epoch == self.epoch => {
                        b.field[face.slot_in(heading).unwrap_or(0)]
                    }
                    _ => Entry::NONE,
                }
            }
        })
    }

    fn compose(&self, now: Time, face: Face, masks: (u8, u8)) -> Beacon {
        let side = self.side(face);
        let claim = match (self.setup.params.connectivity, self.role) {
            (_, Role::Final | Role::Walker) | (Connectivity::Cycles, _) => Claim::None,
            (Connectivity::Gradient, Role::Reserve) => self.gradient_claim(now, face),
            (Connectivity::Forest, Role::Reserve) => self.forest_claim(face),
        };
        let subtree =
            if self.role == Role::Final && self.activator == Some(face) { self.subtree(now) } else { 0 };
        Beacon {
            id: self.id,
            sequence: side.sequence,
            epoch: self.epoch,
            role: self.role,
            attached: self.is_attached(),
            immobile: self.immobile || self.is_stranded(now),
            anchored_here: match self.role {
                Role::Walker => self.anchor == Some(face),
                Role::Final => self.activator == Some(face),
                Role::Reserve => false,
            },
            wants_you: self.wants(now, face),
            quarantined: self.is_quarantined(now),
            final_hops: self.final_hops(),
            terrain: masks.0,
            finals: masks.1,
            rank: self.told_rank(),
            renew: self.renewal(now, face),
            claim,
            ack: side.child,
            corners: self.corners_seen[face.index()],
            subtree,
            field: if self.role == Role::Walker { [Entry::NONE; 4] } else { self.advertised(now, face) },
        }
    }

    /// Whether this is a walker with nobody to walk over: whoever carried it has died.
    fn is_stranded(&self, now: Time) -> bool {
        self.role == Role::Walker
            && self.moving.is_none()
            && !self.may_hear_more(now)
            && Face::ALL.into_iter().all(|f| self.terrain(now, f).is_none())
    }

    pub(super) fn is_attached(&self) -> bool {
        match self.setup.params.connectivity {
            _ if self.role == Role::Final => true,
            Connectivity::Forest => self.parent.is_some(),
            Connectivity::Gradient => self.rank.label != UNLABELLED,
            Connectivity::Cycles => true,
        }
    }

    /// Finalized modules that this one stands for: itself and those it made finalized, and so on.
    fn subtree(&self, now: Time) -> u32 {
        let below: u32 = Face::ALL
            .into_iter()
            .filter(|f| Some(*f) != self.activator)
            .filter_map(|f| self.live(now, f))
            .filter(|b| b.role == Role::Final && b.anchored_here && b.epoch == self.epoch)
            .map(|b| b.subtree)
            .sum();
        below + 1
    }

    /// Sends the beacons that are due: news at most once per `advertise`, news of the field that can wait
    /// later, the rest per `heartbeat`.
    pub(super) fn tend_beacons(&mut self, now: Time) {
        let (advertise, heartbeat) = (self.setup.params.advertise, self.setup.params.heartbeat);
        let due = |side: &super::Side| {
            let age = now.since(side.sent_at);
            side.session.is_some()
                && (side.sent.is_none()
                    || (side.stale && age >= advertise)
                    || side.later.is_some_and(|at| at <= now)
                    || age >= heartbeat)
        };
        if !self.sides.iter().any(due) {
            return;
        }
        let mask = |keep: &dyn Fn(&Beacon) -> bool| {
            let faces = Face::ALL.into_iter().filter(|f| self.terrain(now, *f).is_some_and(keep));
            faces.fold(0, |mask, f| mask | f.bit())
        };
        let masks = (mask(&|_| true), mask(&|b| b.role == Role::Final && b.epoch == self.epoch));
        for face in Face::ALL {
            if !due(self.side(face)) {
                continue;
            }
            let mut beacon = self.compose(now, face, masks);
            let side = self.side_mut(face);
            side.stale = false;
            let age = now.since(side.sent_at);
            let class = match &side.sent {
                None => Class::Liveness,
                Some(before) if *before == beacon => {
                    side.later = None;
                    if age < heartbeat {
                        continue;
                    }
                    Class::Liveness
                }
                Some(before) => news(before, &beacon),
            };
            if class == Class::Gradient
                && let Some(before) = &side.sent
            {
                let wait = patience(before, &beacon, advertise).min(heartbeat);
                if age < wait {
                    side.later = Some(side.sent_at + wait);
                    continue;
                }
            }
            side.later = None;
            side.sequence += 1;
            beacon.sequence = side.sequence;
            side.sent = Some(beacon);
            side.sent_at = now;
            self.send(face, class, Message::Beacon(beacon));
        }
    }

    /// Tells the world-controller when something it counts on has changed: at once what matters for
    /// the outcome, the rest now and then.
    pub(super) fn tend_report(&mut self, now: Time) {
        let is_seed = self.role == Role::Final && self.is_root();
        let status = Status {
            epoch: self.epoch,
            role: self.role,
            attached: self.is_attached(),
            immobile: self.immobile,
            pinned: self.is_pinned(now),
            attracted: self.is_attracted(now),
            wants: self.wanted_faces(now).fold(0, |mask, f| mask | f.bit()),
            subtree: if is_seed { self.subtree(now) } else { 0 },
            prevented: self.prevented,
            waits_for: self.waits_for,
        };
        let urgent = self.reported.is_none_or(|r| {
            (r.epoch, r.role, r.immobile) != (status.epoch, status.role, status.immobile)
                || (is_seed && r.subtree != status.subtree)
        });
        let rested = now.since(self.reported_at) >= self.setup.params.heartbeat;
        if self.reported != Some(status) && (urgent || rested) {
            self.reported = Some(status);
            self.reported_at = now;
            self.out.push_back(Output::Report(status));
        }
    }

    fn is_attracted(&self, now: Time) -> bool {
        Face::ALL
            .into_iter()
            .filter_map(|f| self.terrain(now, f))
            .any(|b| b.field.iter().any(|e| e.is_known()))
    }
}

/// How long after the beacon before news of the field is sent. A target that comes much closer is told
/// of at once. All else is worth the less the farther the target is: whoever stands `n` moves away
/// gets there `n` moves later at the earliest, by when the news will have changed again.
fn patience(before: &Beacon, after: &Beacon, advertise: Span) -> Span {
    let changed = before.field.iter().zip(&after.field).filter(|(b, a)| a != b);
    let moves = changed.map(|(b, a)| {
        let gained = b.distance.saturating_sub(a.distance);
        let much = gained > 0 && gained >= a.distance / MUCH_CLOSER;
        if much { 0 } else { b.moves().min(a.moves()) }
    });
    advertise + advertise * u64::from(moves.min().unwrap_or(0))
}

/// What a beacon is for, judged by what is new in it; connectivity first, gradient last.
fn news(before: &Beacon, after: &Beacon) -> Class {
    let connectivity = |b: &Beacon| {
        (b.attached, b.rank, b.renew, b.claim, b.ack, b.anchored_here, b.quarantined, b.final_hops)
    };
    let seed = |b: &Beacon| (b.epoch, b.role, b.wants_you, b.terrain, b.finals, b.subtree, b.immobile);
    if connectivity(before) != connectivity(after) {
        Class::Connectivity
    } else if seed(before) != seed(after) {
        Class::Seed
    } else if before.corners != after.corners {
        Class::Negotiation
    } else {
        Class::Gradient
    }
}
