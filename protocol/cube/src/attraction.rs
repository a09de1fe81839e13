//! The attraction field: for each face, how many moves it is from the cell outside to the nearest target.
//!
//! A distance is followed only if it is *feasible*: smaller than every distance advertised here for the same
//! version of the same source. So the successors of one version never form a loop, even if messages are
//! late, lost or duplicated, and a source that is gone is forgotten with its last version instead of being
//! counted to infinity.

mod face_field;

use super::message::{Beacon, Entry, Role};
use super::view::View;
use core::hash::Hash;
use face_field::{FaceField, Limits, Offer, newer};
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::defects::Defect;
use metamorph_core::digest::Portable;
use metamorph_core::goal::Growth;
use metamorph_core::lattice::Face;
use metamorph_core::time::{Span, Time};

/// Number added to `via` for an offer of another face of the same module.
pub(super) const OWN: u8 = 6;
/// Number added to `via` for an offer of a module one further out, which touches the same cell.
pub(super) const SAME_CELL: u8 = 12;
/// The number of rounds after which the values of a module's faces no longer change: within one computation distances
/// only fall, and a path over one module passes each of its six faces at most once.
const ROUNDS: usize = 6;

/// Where following the attraction field leads from a face.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Successor {
    /// To another face of the same module.
    Own(Face),
    /// Along the neighbour in this direction: to its face of the same name or, if a further module stands out
    /// from it and touches the same cell, to the face of that module.
    Beside {
        /// The direction of the neighbour.
        heading: Face,
        /// True if a further module touches the same cell.
        same_cell: bool,
    },
}

/// The field on all faces of a module, and what it knows of the cells outside them.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Attraction {
    faces: [FaceField; 6],
    /// Directions in which the corner over each face was found blocked, and until when they are avoided.
    corners: [u8; 6],
    corners_until: [Time; 6],
    /// Since when the goal cell outside each face has been unfilled, as seen by a finalized module.
    unfilled_since: [Option<Time>; 6],
    /// True if something that the field follows from may have changed.
    stale: bool,
    /// Faces whose value has to be chosen again; the others would come out the same (see [`Self::tend`]).
    dirty: u8,
    /// The masks of open faces and of supports when the field was last computed.
    seen: (u8, u8),
    /// When the field was last computed.
    seen_at: Time,
    /// When the first value ceases to be usable unless it is renewed; follows from the values.
    expires: Time,
}

/// Result of computing the field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Tended {
    /// Faces whose value has changed.
    pub changed: u8,
    /// Faces outside which this finalized module wants the cell filled.
    pub wanted: u8,
}

/// The bits of all six faces.
pub(super) const ALL_FACES: u8 = 0b11_1111;

/// Returns the four faces at right angles to a face.
pub(super) fn beside(face: Face) -> u8 {
    ALL_FACES & !(face.bit() | face.opposite().bit())
}

impl Attraction {
    pub fn new() -> Attraction {
        Attraction {
            faces: core::array::from_fn(|_| FaceField::new()),
            corners: [0; 6],
            corners_until: [Time::ZERO; 6],
            unfilled_since: [None; 6],
            stale: true,
            dirty: ALL_FACES,
            seen: (0, 0),
            seen_at: Time::ZERO,
            expires: Time::NEVER,
        }
    }

    /// Reads the memory that the next step will need; see [`Agent::look_ahead`](metamorph_core::agent::Agent).
    pub fn look_ahead(&self) -> u64 {
        let faces = self.faces.iter().fold(0, |read, face| read ^ u64::from(face.value().source));
        faces ^ self.expires.0
    }
    /// Starts over with another goal.
    pub fn on_goal(&mut self) {
        self.unfilled_since = [None; 6];
        self.faces = core::array::from_fn(|_| FaceField::new());
        self.expires = Time::NEVER;
    }
    /// Makes the next step recompute the field of all faces.
    pub fn invalidate(&mut self) {
        (self.stale, self.dirty) = (true, ALL_FACES);
    }
    /// Makes the next step recompute the field of the faces in a mask, the only ones that may come out
    /// differently.
    pub fn invalidate_faces(&mut self, faces: u8) {
        self.stale = true;
        self.dirty |= faces;
    }
    /// Feeds the field of one face into a hash; see `digest`.
    pub fn digest_field(&self, face: Face, hasher: &mut Portable<'_>) {
        self.faces[face.index()].hash(hasher);
    }
    /// Feeds what is known of the cell outside one face into a hash; see `digest`.
    pub fn digest_outside(&self, face: Face, sequence: u32, hasher: &mut Portable<'_>) {
        let i = face.index();
        (self.corners[i], self.corners_until[i], sequence, self.unfilled_since[i]).hash(hasher);
    }
    pub fn value(&self, face: Face) -> Entry {
        self.faces[face.index()].value()
    }
    /// Returns the smallest distance on any face.
    pub fn nearest(&self) -> Option<u16> {
        self.faces.iter().map(|f| f.value().distance).min()
    }
    /// Returns where following the field leads from a face, and when the version of its value was first
    /// heard.
    pub fn successor(&self, face: Face) -> (Option<Successor>, Time) {
        let field = &self.faces[face.index()];
        let (heading, kind) = (Face::from_index(field.via % 6), field.via / 6 * 6);
        let successor = heading.and_then(|heading| match kind {
            0 => Some(Successor::Beside { heading, same_cell: false }),
            OWN => Some(Successor::Own(heading)),
            SAME_CELL => Some(Successor::Beside { heading, same_cell: true }),
            _ => None,
        });
        (successor, field.heard())
    }

    /// Notes the corners over a face that a walker found blocked.
    pub fn note_corners(&mut self, v: View<'_>, face: Face, corners: u8) {
        if corners == 0 {
            return;
        }
        let i = face.index();
        let known = if v.now < self.corners_until[i] { self.corners[i] } else { 0 };
        self.corners[i] |= corners;
        self.corners_until[i] = v.now + v.params().corner_hint;
        if known != self.corners[i] {
            self.invalidate();
        }
    }

    /// Delays starting cells out of turn after a suspected neighbour has been heard again. A cell may have stayed
    /// unfilled only because messages did not get through, and distances need time to spread again.
    pub fn wait_for_news(&mut self, v: View<'_>) {
        hit(CoveragePoint::CubeWaitsForNews);
        let earliest = v.now + v.params().hold - v.params().out_of_turn_after;
        for since in self.unfilled_since.iter_mut().flatten() {
            *since = (*since).max(earliest);
        }
        self.invalidate();
    }

    /// Returns the distance to announce for the cell outside a face, if this finalized module wants that cell filled:
    /// zero if rules G1 and G2 allow it, and half the range if it is to be filled out of turn. A cell filled out of
    /// turn may wall in another one, so it attracts only if no nearer target is known or a module already stands in it.
    fn target(&self, v: View<'_>, face: Face) -> Option<u16> {
        let masks = &v.own.masks;
        if v.own.role != Role::Final
            || masks.cells & face.bit() == 0
            || v.peer(face).is_some_and(|b| b.role == Role::Final)
        {
            return None;
        }
        let is_next = (masks.next & face.bit() != 0 || starters_are_dead(v, face))
            && (v.own.grows_as() == Growth::Scaffold
                || v.has(Defect::AnyLowerOnSolids)
                || lower_are_filled(v, face));
        if is_next {
            return Some(0);
        }
        let since = self.unfilled_since[face.index()]?;
        let far = v.params().range.min(Entry::MAX_MOVES) / 2 * Entry::MOVE;
        // A module already in that cell blocks no other cell any more.
        let is_taken = || v.peer(face).is_some_and(|b| b.role == Role::Reserve || b.immobile);
        let is_last_hope = || self.faces.iter().all(|f| f.value().distance >= far);
        let patience = v.params().out_of_turn_after / if v.peer(face).is_some_and(awaits) { 4 } else { 1 };
        let is_due = v.now.since(since) > patience && v.sides.missed() == 0 && (is_taken() || is_last_hope());
        is_due.then(|| {
            hit(CoveragePoint::CubeRelaxed);
            far
        })
    }

    /// Recomputes the field from the last messages of the neighbours, if anything it follows from may have
    /// changed.
    ///
    /// The value of a face depends on the neighbours and faces at right angles to it, and on the memory of the face
    /// itself. The same inputs give the same value, so a face is recomputed only if one of its inputs has changed, or
    /// may have changed as time passed. A debug build recomputes all faces and compares the results.
    pub fn tend(&mut self, v: View<'_>) -> Tended {
        let is_final = v.own.role == Role::Final;
        let targets = self.targets(v);
        let due = self.expires <= v.now || (is_final && self.are_old(v, &targets));
        if !self.stale && !due {
            return Tended { changed: 0, wanted: mask_of(&targets) };
        }
        #[cfg(debug_assertions)]
        let mut anew = Attraction { dirty: ALL_FACES, ..self.clone() };
        let changed = self.recompute(v, due);
        #[cfg(debug_assertions)]
        {
            anew.recompute_all(v);
            self.assert_same(&anew);
        }
        self.expires = self.first_expiry(v.params().hold);
        Tended { changed, wanted: mask_of(&self.targets(v)) }
    }

    /// Recomputes the faces that may come out differently; returns those that have changed.
    fn recompute(&mut self, v: View<'_>, due: bool) -> u8 {
        self.stale = false;
        let wanted = if v.own.role == Role::Final {
            self.note_unfilled(v);
            v.own.masks.cells
        } else {
            0
        };
        self.dirty |= self.dirty_by_time(v, due) | wanted;
        let mut changed = 0;
        for _ in 0..ROUNDS {
            let mut changed_now = 0;
            for face in Face::ALL {
                if self.dirty & face.bit() == 0 {
                    self.faces[face.index()].renew(v.now);
                    continue;
                }
                self.dirty &= !face.bit();
                if self.tend_face(v, face) {
                    changed_now |= face.bit();
                    // Whether a cell is filled out of turn depends on the values of all faces.
                    self.dirty |= beside(face) | wanted;
                }
            }
            changed |= changed_now;
            if changed_now == 0 {
                break;
            }
        }
        changed
    }

    /// Returns the faces whose value may come out differently though the neighbours have said nothing new:
    /// others can be seen alive, a corner may be free again, a value has expired, or time has made room for
    /// another source.
    fn dirty_by_time(&mut self, v: View<'_>, due: bool) -> u8 {
        let seen = (v.sides.open_mask(), v.sides.support_mask());
        let is_other = core::mem::replace(&mut self.seen, seen) != seen;
        let before = core::mem::replace(&mut self.seen_at, v.now);
        let is_free_again = |until: &Time| before < *until && *until <= v.now;
        if due || is_other || v.own.restarted || self.corners_until.iter().any(is_free_again) {
            return ALL_FACES;
        }
        let is_full = |f: &Face| self.faces[f.index()].is_full();
        Face::mask(Face::ALL.into_iter().filter(is_full))
    }

    /// Recomputes all faces in all rounds.
    #[cfg(debug_assertions)]
    fn recompute_all(&mut self, v: View<'_>) {
        if v.own.role == Role::Final {
            self.note_unfilled(v);
        }
        for _ in 0..ROUNDS {
            let changed = Face::ALL.map(|face| self.tend_face(v, face));
            if changed == [false; 6] {
                break;
            }
        }
    }

    #[cfg(debug_assertions)]
    fn assert_same(&self, anew: &Attraction) {
        assert_eq!(self.faces, anew.faces, "a face was left alone and would change");
        assert_eq!(self.unfilled_since, anew.unfilled_since);
    }

    /// Returns the distance at which the cell outside each face attracts.
    fn targets(&self, v: View<'_>) -> [Option<u16>; 6] {
        if v.own.role != Role::Final || v.own.masks.cells == 0 {
            return [None; 6];
        }
        let mut targets = [None; 6];
        for face in Face::in_mask(v.own.masks.cells) {
            targets[face.index()] = self.target(v, face);
        }
        targets
    }

    fn tend_face(&mut self, v: View<'_>, face: Face) -> bool {
        let i = face.index();
        // A walker is traffic, not a support: no route leads over it.
        if !v.sides.is_open(face) || v.own.role == Role::Walker {
            return self.faces[i].set(Entry::NONE);
        }
        let source = v.own.id.0 << 3 | face as u32;
        if !v.sides.is_touching(face)
            && let Some(distance) = self.target(v, face)
        {
            return self.faces[i].set(Entry { distance, source, version: version(v) });
        }
        let (mut offers, n) = self.offers(v, face);
        // An echo of this face's own announcement is no news of a target.
        let is_own = |e: Entry| e.source == source || may_be_own(v, e);
        for offer in offers.iter_mut().filter(|o| is_own(o.entry)) {
            offer.entry = Entry::NONE;
        }
        let limits = Limits {
            hold: v.params().hold,
            range: v.params().range.min(Entry::MAX_MOVES) * Entry::MOVE,
            accept_stale: v.has(Defect::AcceptStaleValues),
        };
        self.faces[i].choose(v.now, limits, &offers[..n])
    }

    /// Returns true if some face with a target does not announce that target's distance in the present version.
    fn are_old(&self, v: View<'_>, targets: &[Option<u16>; 6]) -> bool {
        let version = version(v);
        Face::in_mask(v.own.masks.cells & !v.sides.touching_mask()).any(|f| {
            let value = self.value(f);
            targets[f.index()].is_some_and(|distance| (value.distance, value.version) != (distance, version))
        })
    }

    /// Notes since when goal cells around a finalized module have been unfilled.
    fn note_unfilled(&mut self, v: View<'_>) {
        for face in Face::in_mask(v.own.masks.cells) {
            let unfilled =
                v.peer(face).is_none_or(|b| b.role != Role::Final) && !v.sides.is_certified_dead(face);
            let since = &mut self.unfilled_since[face.index()];
            *since = if unfilled { since.or(Some(v.now)) } else { None };
        }
    }

    /// Returns the offers for the cell outside `face`, along neighbouring modules and around the edges of this one, and
    /// their number.
    fn offers(&self, v: View<'_>, face: Face) -> ([Offer; 4], usize) {
        let mut offers = [Offer { entry: Entry::NONE, cost: 0, via: 0 }; 4];
        let mut n = 0;
        let mut add = |offer| {
            offers[n] = offer;
            n += 1;
        };
        for heading in face.perpendicular() {
            if let Some(beacon) = v.support(heading) {
                // Targets of another goal were forgotten with that goal, so their distances could lead in
                // circles.
                if beacon.epoch != v.own.epoch {
                    continue;
                }
                let slot = face.slot_in(heading).unwrap_or(0);
                // A module one further out touches the very same cell; otherwise it is one slide.
                let (cost, via) = match beacon.supports & face.bit() {
                    0 => (Entry::MOVE, heading as u8),
                    _ => (1, SAME_CELL + heading as u8),
                };
                add(Offer { entry: beacon.field[slot], cost, via });
            } else if v.sides.is_open(heading) && !self.corner_blocked(v.now, face, heading) {
                let entry = self.value(heading);
                add(Offer { entry, cost: Entry::MOVE, via: OWN + heading as u8 });
            }
        }
        (offers, n)
    }

    fn corner_blocked(&self, now: Time, a: Face, b: Face) -> bool {
        let one_way =
            |f: Face, d: Face| self.corners[f.index()] & d.bit() != 0 && now < self.corners_until[f.index()];
        one_way(a, b) || one_way(b, a)
    }

    /// Returns the field values of the cells that a walker on `face` can move to, by its four headings.
    pub fn advertised(&self, v: View<'_>, face: Face) -> [Entry; 4] {
        if v.own.role == Role::Walker {
            return [Entry::NONE; 4];
        }
        face.perpendicular().map(|heading| {
            if v.sides.is_open(heading) {
                return self.value(heading);
            }
            match v.support(heading) {
                Some(b) if b.supports & face.bit() == 0 && b.epoch == v.own.epoch => {
                    b.field[face.slot_in(heading).unwrap_or(0)]
                }
                _ => Entry::NONE,
            }
        })
    }

    /// Returns when the first value ceases to be usable unless it is renewed.
    pub fn expires(&self) -> Time {
        self.expires
    }
    fn first_expiry(&self, hold: Span) -> Time {
        self.faces.iter().map(|f| f.expires(hold)).min().unwrap_or(Time::NEVER)
    }
}

/// Returns the faces with a target.
fn mask_of(targets: &[Option<u16>; 6]) -> u8 {
    Face::mask(Face::ALL.into_iter().filter(|f| targets[f.index()].is_some()))
}

/// Returns true if rule G2 holds for the cell outside a face: each of its lower neighbours is filled, as far as the
/// module that touches both that neighbour and this module reports.
fn lower_are_filled(v: View<'_>, face: Face) -> bool {
    let lower = v.own.masks.lower[face.index()];
    Face::in_mask(lower).all(|toward| {
        if toward == face.opposite() || toward == face || v.own.masks.cells & toward.bit() == 0 {
            // The cell itself, opposite fronts, or no module in between: nothing is known.
            return true;
        }
        // The lower cell lies beside ours, seen by the module that both touch; a dead one says nothing.
        v.sides.is_certified_dead(toward) || v.support(toward).is_some_and(|b| b.filled & face.bit() != 0)
    })
}

/// Returns true if all modules that could start the cell outside a face are dead, as far as the neighbours that touch
/// them report. Then this module starts the cell in their place.
fn starters_are_dead(v: View<'_>, face: Face) -> bool {
    let lower = v.own.masks.lower[face.index()];
    let is_dead = |toward: Face| {
        let aside = toward != face && toward != face.opposite();
        aside && v.support(toward).is_some_and(|b| b.filled & !b.finals & face.bit() != 0)
    };
    lower != 0 && Face::in_mask(lower).all(is_dead)
}

/// Returns the version of the module's own targets: the number of refresh periods since time zero. The phase depends on
/// the module's id, so that not all sources flood at once. Versions depend on the time alone, so they continue after a
/// restart.
fn version(v: View<'_>) -> u16 {
    version_of(v, v.own.id.0, v.now)
}
fn version_of(v: View<'_>, id: u32, at: Time) -> u16 {
    (phased(v, id, at) / refresh(v)) as u16
}
fn phased(v: View<'_>, id: u32, at: Time) -> u64 {
    at.0.saturating_add(u64::from(id).wrapping_mul(0x9E37_79B9_7F4A_7C15) % refresh(v))
}
fn refresh(v: View<'_>) -> u64 {
    v.params().refresh.0.max(1)
}
/// Returns when the module's own targets get their next version.
pub(super) fn next_refresh(v: View<'_>) -> Time {
    v.now + Span(refresh(v) - phased(v, v.own.id.0, v.now) % refresh(v))
}

/// Returns true if an earlier incarnation of this module may have advertised this version of the source. Other modules
/// may offer that distance back, and following it would lead in a circle.
fn may_be_own(v: View<'_>, entry: Entry) -> bool {
    v.own.restarted
        && entry.is_known()
        && !v.has(Defect::AcceptStaleValues)
        && !newer(entry.version, version_of(v, entry.source >> 3, v.own.settled))
}

/// Returns true if the sender of a beacon is a walker that stays in its cell although it is not finalized, in a body with dead modules:
/// it has come over the dead and waits there, or is stuck.
fn awaits(b: &Beacon) -> bool {
    b.knows_of_death && b.immobile && b.role == Role::Walker
}
