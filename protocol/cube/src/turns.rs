//! Turns: when a module beside the dead may begin to move.
//!
//! A dead module neither leaves nor answers. A convex motion around it ends beside itself and needs no consent, but a slide
//! from it lands on another neighbour of the dead module, which the walker does not touch and so cannot ask to stay. Time is
//! divided instead: it consists of frames of four slots for slides and one for departures ([`Params::slide_slot`],
//! [`Params::departure_slot`]). A module slides from a dead one only in the slot of its own cell ([`colour`]), and one that may
//! be landed on leaves only in the slot for departures ([`Cube::may_be_landed_on`]).
//!
//! *A landing stays.* Let Y slide from D, which died at `t`, and land on X, which touches D. If X is finalized or dead, it
//! stays. Otherwise:
//!
//! * X holds the certificate of D, or has heard D, or has not heard it in this session. D has said nothing after `t`. So from
//!   `t + suspect` on, by any clock plus its skew, X knows that it may be landed on in the first two cases, whatever the
//!   delay of a message and however long X was stopped: beacons say when they were sent ([`Beacon::spoken`]). In the third
//!   case X does not leave: a module in reserve holds a stranger, and a walker waits for the first words of its neighbours, and
//!   then for those of a stranger ([`Cube::waits_for_stranger`]).
//! * What X has begun before ends within a lease, since the body refuses a later start. Y begins no earlier
//!   ([`Params::slides_after`]). From then on X leaves in the slot for departures, and its move ends in that slot.
//! * If X slides from a dead module itself, it does so in another slot: the cells of Y and X differ by one in two coordinates, and
//!   for no such difference the colours are equal.
//! * When Y has landed, X has a new contact. The body refuses a motion of X that was begun before X has sensed that contact. When X has
//!   sensed it, X begins none before it has heard Y ([`Cube::may_carry`], which is asked again when all is granted); and then
//!   Y rests on it, and keeps it there.
//!
//! * D may restart while Y slides. Then X has a new contact with D, and is back in the third case until D's first words. These say that
//!   D listens, for two leases, in which the slide ends; meanwhile X leaves in the slot for departures, also if D dies again.
//!
//! Nothing but pairs of neighbours occurs in this, so it holds for any number of modules. *Assumptions:* clocks differ by
//! [`Params::skew`] at most; the time in a certificate is not earlier than the last message of the dead module; a beacon is
//! younger than 2¹⁶ quarters of a move when it is taken from the inbox.

use super::Cube;
use super::message::{Beacon, Role};
use super::params::{Connectivity, Params};
use super::view::View;
use metamorph_core::defects::Defect;
use metamorph_core::lattice::{Cell, Face, Motion, MotionKind};
use metamorph_core::time::{Span, Time};

/// The number of kinds of cells, and of slots for slides in a frame.
const COLOURS: u64 = 4;

/// When a motion may begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Window {
    pub from: Time,
    /// The last instant.
    pub until: Time,
}

/// A part of a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Slot {
    /// Modules in cells of one colour slide from dead ones.
    Slide(u64),
    /// Modules that may be landed on leave.
    Departure,
}

impl Params {
    /// Returns the duration of the slot in which modules in cells of one colour slide from dead ones: a move, and a quarter of one
    /// for the start.
    pub fn slide_slot(&self) -> Span {
        self.move_time + self.move_time / 4 + self.skew * 2
    }
    /// Returns the duration of the slot in which modules that may be landed on leave: half a lease, in which they ask for what
    /// they need, and move.
    pub fn departure_slot(&self) -> Span {
        (self.lease / 2).max(self.move_time * 2) + self.skew * 2
    }
    /// Returns when modules begin to slide from one that died at `died`: all that touch it know by then that they may be landed
    /// on, and what they have begun before has ended.
    pub fn slides_after(&self, died: Time) -> Time {
        died + self.suspect + self.lease + self.move_time + self.skew * 4
    }
    /// Returns the stamp of a beacon that is sent at `now`; see [`Beacon::spoken`].
    pub(super) fn stamp(&self, now: Time) -> u16 {
        self.quarters(now) as u16
    }
    /// Returns when a beacon was sent at the latest that was taken from the inbox at `heard`, rounded down.
    fn spoken_at(&self, stamp: u16, heard: Time) -> Time {
        let latest = self.quarters(heard + self.skew);
        let ago = (latest as u16).wrapping_sub(stamp);
        Time(latest.saturating_sub(u64::from(ago)) * self.quarter())
    }
    fn quarter(&self) -> u64 {
        (self.move_time.0 / Beacon::QUARTERS).max(1)
    }
    fn quarters(&self, at: Time) -> u64 {
        at.0 / self.quarter()
    }
    /// Returns when a motion may begin in a slot, at `at` or as early as possible after it.
    fn window(&self, at: Time, slot: Slot) -> Window {
        let slides = self.slide_slot() * COLOURS;
        let frame = slides + self.departure_slot();
        let (offset, length) = match slot {
            Slot::Slide(colour) => (self.slide_slot() * colour, self.slide_slot()),
            Slot::Departure => (slides, self.departure_slot()),
        };
        let in_frame = |begins: Time| Window {
            from: begins + offset + self.skew,
            until: begins + offset + length - self.move_time - self.skew,
        };
        let begins = Time(at.0 / frame.0 * frame.0);
        let this = in_frame(begins);
        let next = if at <= this.until { this } else { in_frame(begins + frame) };
        Window { from: next.from.max(at), ..next }
    }
}

impl Cube {
    /// Returns when a motion may begin: at once, unless this module touches dead or silent ones.
    pub(super) fn turn(&self, now: Time, motion: Motion) -> Window {
        let free = Window { from: now, until: Time::NEVER };
        if self.own.is_closed || !self.has_turns() || self.own.has(Defect::IgnoreTurns) {
            return free;
        }
        let p = self.own.params();
        if self.is_unasked(motion) {
            // Without a certificate it is not known when slides begin.
            let never = Window { from: Time::NEVER, until: Time::ZERO };
            let Some(died) = self.forest.custody().died(motion.support) else { return never };
            let colour = if self.own.has(Defect::OneColour) { 0 } else { colour(self.own.cell) };
            p.window(now.max(p.slides_after(died)), Slot::Slide(colour))
        } else if self.may_be_landed_on(now) {
            p.window(now, Slot::Departure)
        } else {
            free
        }
    }

    /// Returns true if modules of this swarm move in turns. The forest is the only check that they are proved with.
    pub(super) fn has_turns(&self) -> bool {
        self.own.params().connectivity == Connectivity::Forest
    }

    /// Returns true if a motion is a slide from a dead module that no controller has vouched for.
    fn is_unasked(&self, motion: Motion) -> bool {
        self.called.is_none()
            && motion.kind == MotionKind::Slide
            && self.sides.is_certified_dead(motion.support)
    }

    /// Returns true if another module may be about to land on this one without having asked: a neighbour has said nothing for
    /// so long that others may slide from it, or it listens after a restart, and one that began before may slide from it still.
    fn may_be_landed_on(&self, now: Time) -> bool {
        let (v, p) = (self.view(now), self.own.params());
        let died = |f: Face| self.forest.custody().died(f).unwrap_or_default();
        let is_silent = |f: Face| spoke_at(v, f).is_some_and(|spoke| now.since(spoke) > p.suspect);
        let listens = |f: Face| v.peer(f).is_some_and(|b| b.quarantined);
        // It may have listened and died again without a word that was heard.
        let is_new = |f: Face| v.peer(f).is_none() && now <= died(f) + p.move_time + p.skew * 2;
        let (dead, heard) = (v.sides.certified_mask(), v.sides.heard_mask());
        Face::in_mask(heard & !dead).any(|f| is_silent(f) || listens(f))
            || Face::in_mask(dead).any(|f| now >= died(f) + p.suspect || listens(f) || is_new(f))
    }

    /// Returns true if this is a walker with a neighbour that it has not heard, and another module may rest here that has not
    /// asked: that neighbour itself, or one that has come from it, because it is dead.
    pub(super) fn waits_for_stranger(&self, now: Time) -> bool {
        if self.own.role != Role::Walker
            || !self.sides.any_unheard()
            || !self.has_turns()
            || self.own.has(Defect::LeaveStrangers)
        {
            return false;
        }
        // A contact is sensed a little later than the arrival that it begins with.
        let patience = self.own.params().first_words() / 2;
        self.own.knows_of_death || self.may_be_landed_on(now) || self.sides.any_unheard_for(now, patience)
    }

    /// Returns true if this is a walker, and another module rests on it, or may do so.
    pub(super) fn may_carry(&self, now: Time) -> bool {
        self.waits_for_stranger(now) || self.is_ridden()
    }

    /// Returns true if this is a walker, and another walker rests on it.
    pub(super) fn is_ridden(&self) -> bool {
        let rests_here =
            |f: Face| self.sides.peer(f).is_some_and(|b| b.role == Role::Walker && b.supported_here);
        self.has_turns()
            && self.own.role == Role::Walker
            && Face::in_mask(self.sides.touching_mask()).any(rests_here)
    }

    /// Returns true if this module begins no move before `until`: it waits for its turn, moves already, or has a neighbour that it
    /// has not heard. For audits.
    pub fn stays_in_turn(&self, now: Time, until: Time) -> bool {
        let motion = |kind, support: Face| Motion { kind, support, heading: support.perpendicular()[0] };
        let slides = Face::in_mask(self.sides.certified_mask()).map(|f| motion(MotionKind::Slide, f));
        let mut motions = slides.chain([motion(MotionKind::Convex, Face::Down)]);
        let holds_stranger = self.own.role != Role::Walker && self.sides.any_unheard();
        self.moving.is_some()
            || holds_stranger
            || self.waits_for_stranger(now)
            || motions.all(|motion| self.turn(now, motion).from >= until)
    }
}

/// Returns when the neighbour on a face sent the last beacon that was heard of it; `None` if none was heard.
fn spoke_at(v: View<'_>, face: Face) -> Option<Time> {
    let heard = v.sides.heard_at(face);
    let stamp = v.peer(face)?.spoken;
    Some(if v.has(Defect::TrustArrival) { heard } else { v.params().spoken_at(stamp, heard) })
}

/// Returns the kind of a cell: two cells that differ by one in each of two coordinates are of different kinds.
fn colour(cell: Cell) -> u64 {
    (i32::from(cell.y) + 2 * i32::from(cell.z)).rem_euclid(COLOURS as i32) as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::custody::tests::{Bench, DEAD, NEARER, PARENT};
    use crate::message::Rank;
    use crate::sides::Sides;
    use metamorph_core::agent::Input;
    use metamorph_core::ids::{Port, Session};

    const MOVE: Span = Span::secs(1);

    fn params() -> Params {
        Params::scaled(MOVE, Span::millis(10), 100)
    }

    #[test]
    fn walkers_and_what_they_land_on_differ_in_colour() {
        let cells = (-3..4).flat_map(|x| (-3..4).flat_map(move |y| (-3..4).map(move |z| Cell::new(x, y, z))));
        for dead in cells {
            for support in Face::ALL {
                for heading in support.perpendicular() {
                    let (walker, landing) = (dead.step(support.opposite()), dead.step(heading));
                    assert_ne!(colour(walker), colour(landing), "{walker} slides from {dead} onto {landing}");
                }
            }
        }
    }

    #[test]
    fn moves_of_different_slots_never_overlap() {
        for skew in [Span::ZERO, Span::millis(300)] {
            let p = Params { skew, ..params() };
            let slots = (0..COLOURS).map(Slot::Slide).chain([Slot::Departure]);
            let windows: Vec<(Slot, Window)> = slots
                .flat_map(|slot| (0..300).map(move |i| (slot, Time(i * 97_000_000))))
                .map(|(slot, at)| (slot, at, p.window(at, slot)))
                .inspect(|(_, at, w)| assert!(w.from >= *at && w.from <= w.until, "{at}: {w:?}"))
                .map(|(slot, _, w)| (slot, w))
                .collect();
            for (slot, a) in &windows {
                for (_, b) in windows.iter().filter(|(other, _)| other != slot) {
                    // A move begins up to a skew earlier than by the mover's clock, and no later than `until` by the
                    // controller's.
                    let ends_before = |a: &Window, b: &Window| a.until + MOVE <= b.from - skew;
                    assert!(ends_before(a, b) || ends_before(b, a), "{a:?} and {b:?}");
                }
            }
        }
    }

    #[test]
    fn a_stamp_says_when_a_beacon_was_sent() {
        let p = params();
        for sent in [0, 1, 333, 16_384_000, 16_384_001, 100_000_000].map(|ms| Time(ms * 1_000_000)) {
            for delay in [0, 10, 5_000, 16_000_000].map(Span::millis) {
                let told = p.spoken_at(p.stamp(sent), sent + delay);
                assert!(
                    told <= sent && sent.since(told) < MOVE / Beacon::QUARTERS,
                    "{sent} + {delay}: {told}"
                );
            }
        }
    }

    #[test]
    fn walkers_wait_for_neighbours_that_they_have_not_heard() {
        let first_words = params().first_words();
        let waits = |defect, knows_of_death, later| {
            let mut bench = Bench::living(defect);
            bench.touches(NEARER);
            // It has been in reserve, or it would take its place there again.
            (bench.cube.own.role, bench.cube.own.knows_of_death) = (Role::Walker, knows_of_death);
            bench.cube.waits_for_stranger(bench.now + later)
        };
        assert!(!waits(None, false, Span::ZERO) && waits(None, false, first_words));
        assert!(waits(None, true, Span::ZERO));
        assert!(!waits(Some(Defect::LeaveStrangers), true, first_words));
    }

    /// A module that slides from a dead one lands although that restarts, and dies again, meanwhile.
    #[test]
    fn modules_beside_one_that_listens_may_be_landed_on() {
        let mut bench = Bench::new(None);
        assert!(bench.cube.may_be_landed_on(bench.now + params().suspect));
        let rank = Rank { rooted: Time::ZERO, label: 2 };
        let session = Session(2);
        bench.hand_in(Input::Contact { port: Port(DEAD as u8), session: Some(session) });
        bench.speaks(DEAD, rank, |b| b.quarantined = true);
        assert!(bench.cube.may_be_landed_on(bench.now));
        bench.condemn(session);
        assert!(bench.cube.may_be_landed_on(bench.now));
        let mut bench = Bench::new(None);
        bench.hand_in(Input::Contact { port: Port(DEAD as u8), session: Some(session) });
        bench.speaks(DEAD, rank, |_| {});
        assert!(!bench.cube.may_be_landed_on(bench.now), "it has listened, and is alive");
        // One that has died again before it was heard.
        let bench = Bench::new(None);
        let died = bench.cube.forest.custody().died(DEAD).unwrap();
        assert!(bench.cube.may_be_landed_on(died + MOVE));
        assert!(!bench.cube.may_be_landed_on(died + MOVE + Span(1)), "slides from before have ended");
    }

    /// A walker that has not heard a restarted neighbour waits for its words without patience: another may come from there.
    #[test]
    fn contacts_that_follow_others_at_once_are_unheard_for_long() {
        let (mut sides, now) = (Sides::new(), Time::ZERO + MOVE * 100);
        let mut begin = |session: Option<u32>| {
            sides.begin(now, NEARER, session.map(Session));
            sides.any_unheard_for(now, MOVE)
        };
        assert!(!begin(Some(1)), "it has just come");
        assert!(begin(Some(2)), "it has restarted");
        assert!(!begin(None) && !begin(Some(3)), "another has come");
    }

    /// A module that was stopped takes beacons from its inbox that a dead neighbour sent long ago.
    #[test]
    fn old_beacons_are_no_sign_of_life() {
        let is_free = |defect, ago: Span| {
            let mut bench = Bench::living(defect);
            let sent = bench.now;
            bench.now += ago;
            let stamp = bench.cube.own.params().stamp(sent);
            bench.speaks(PARENT, Rank { rooted: Time::ZERO, label: 2 }, |b| b.spoken = stamp);
            !bench.cube.may_be_landed_on(bench.now)
        };
        let suspect = params().suspect;
        assert!(is_free(None, suspect) && !is_free(None, suspect + MOVE));
        assert!(is_free(Some(Defect::TrustArrival), suspect + MOVE));
    }
}
