//! Beacons: when a module tells its neighbours about itself, and the class of each beacon.
//!
//! State is soft: everything is repeated, so that a lost beacon costs only time.

use super::Cube;
use super::message::{Beacon, Claim, Entry, Message, Role};
use super::params::Connectivity;
use metamorph_core::counters::Class;
use metamorph_core::lattice::Face;
use metamorph_core::time::{Span, Time};

/// A distance that has fallen by at least 1/`MUCH_CLOSER` of its new value is sent after one `advertise`, without a
/// further delay.
const MUCH_CLOSER: u16 = 8;

/// When beacons are sent over one face.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Sender {
    /// When the last beacon of this session was sent; `None` if there is none.
    sent_at: Option<Time>,
    sequence: u32,
    /// True if the state of the module may have changed since a beacon was last composed.
    stale: bool,
    /// The time at which a change that is not urgent is sent; `None` if there is no such change.
    later: Option<Time>,
    /// The time-dependent inputs of the beacon composed last; `None` if any other input may have changed since.
    composed_from: Option<Timed>,
}

/// When a beacon has to be sent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Due {
    Now(Class),
    /// Not before the next heartbeat: it equals the beacon sent last.
    Never,
    At(Time),
}

/// The inputs of a beacon that can change as time passes, even if the agent receives nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Timed {
    wanted: u8,
    finals: u8,
    filled: u8,
    supports: u8,
    live: u8,
    open: u8,
    is_quarantined: bool,
    is_stranded: bool,
    waits_here: bool,
    /// The module has been at its cell for longer than `suspect`, and so asks its children for a path as well.
    asks_children: bool,
}

impl Sender {
    const NEW: Sender = Sender { sent_at: None, sequence: 0, stale: true, later: None, composed_from: None };

    /// Returns when a beacon has to be sent, and with which class.
    ///
    /// That a module has died is no news. It is told with the next beacon that is sent for another reason, at the latest after a
    /// heartbeat, which is soon enough; a wave of beacons over the whole body would restart the wait of every distance.
    fn judge(
        &self,
        now: Time,
        sent: Option<&Beacon>,
        beacon: &Beacon,
        advertise: Span,
        heartbeat: Span,
    ) -> Due {
        let (Some(sent), Some(sent_at)) = (sent, self.sent_at) else { return Due::Now(Class::Liveness) };
        let age = now.since(sent_at);
        let before = &Beacon { knows_of_death: beacon.knows_of_death, ..sent.repeating(beacon) };
        if before == beacon {
            return if age < heartbeat { Due::Never } else { Due::Now(Class::Liveness) };
        }
        let class = class_of_news(before, beacon);
        if class == Class::Gradient {
            let wait = news_delay(before, beacon, advertise).min(heartbeat);
            if age < wait {
                return Due::At(sent_at + wait);
            }
        }
        Due::Now(class)
    }

    /// Returns true if a beacon composed now would not be sent yet: its inputs are the same as last time, and either
    /// the heartbeat is not due or the change that it carries can still wait.
    fn would_wait(&self, now: Time, from: Timed, heartbeat: Span) -> bool {
        let waits = |sent_at: Time| match self.later {
            None => now.since(sent_at) < heartbeat,
            Some(later) => now < later,
        };
        self.composed_from == Some(from) && self.sent_at.is_some_and(waits)
    }

    /// Returns the time before which no beacon needs to be composed; zero if none has been sent in this session.
    fn due_at(&self, advertise: Span, heartbeat: Span) -> Time {
        let Some(sent_at) = self.sent_at else { return Time::ZERO };
        let again = if self.stale { advertise } else { heartbeat };
        (sent_at + again).min(self.later.unwrap_or(Time::NEVER))
    }
}

/// The beacons of a module, face by face. Every step asks when the next one is due, and few send one: the beacons sent last are
/// kept apart, so that the times of all faces lie side by side in memory.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Beacons {
    senders: [Sender; 6],
    /// The last beacon sent in this session.
    sent: [Option<Beacon>; 6],
}

impl Beacons {
    pub fn new() -> Beacons {
        Beacons { senders: [Sender::NEW; 6], sent: [None; 6] }
    }
    /// Reads the memory that the next step will need; see [`Agent::look_ahead`](metamorph_core::agent::Agent).
    pub fn look_ahead(&self) -> u64 {
        self.senders.iter().fold(0, |read, sender| read ^ u64::from(sender.sequence))
    }
    /// Returns the number of beacons sent in the present session of a face.
    pub fn sequence(&self, face: Face) -> u32 {
        self.senders[face.index()].sequence
    }
    /// Begins a session on a face, or ends it.
    pub fn on_contact(&mut self, face: Face) {
        (self.senders[face.index()], self.sent[face.index()]) = (Sender::NEW, None);
    }
    /// Makes the next step compare all beacons with those sent last.
    pub fn invalidate(&mut self) {
        self.invalidate_faces(super::attraction::ALL_FACES);
    }
    /// Does what [`Beacons::invalidate`] does, if only the beacons of the faces in a mask may differ.
    pub fn invalidate_faces(&mut self, faces: u8) {
        for (face, sender) in Face::ALL.into_iter().zip(&mut self.senders) {
            sender.stale = true;
            if faces & face.bit() != 0 {
                sender.composed_from = None;
            }
        }
    }
}

impl Cube {
    /// Sends the beacons that are due: urgent changes at most once per `advertise`, changed distances possibly later
    /// (see `news_delay`), and an unchanged beacon once per `heartbeat`.
    pub(super) fn tend_beacons(&mut self, now: Time) {
        let (advertise, heartbeat) = (self.own.params().advertise, self.own.params().heartbeat);
        let (interval, mut timed, mut common) = (self.least_interval(), None, None);
        for face in Face::in_mask(self.sides.touching_mask()) {
            let sender = &self.beacons.senders[face.index()];
            if now < sender.due_at(interval, heartbeat) {
                continue;
            }
            let timed = *timed.get_or_insert_with(|| self.timed(now));
            if sender.would_wait(now, timed, heartbeat) {
                #[cfg(debug_assertions)]
                self.assert_waits(now, face);
                self.beacons.senders[face.index()].stale = false;
                continue;
            }
            let common = common.get_or_insert_with(|| self.compose_common(now));
            let mut beacon = self.compose(now, face, common);
            let Beacons { senders, sent } = &mut self.beacons;
            let (sender, sent) = (&mut senders[face.index()], &mut sent[face.index()]);
            (sender.stale, sender.composed_from) = (false, Some(timed));
            let class = match sender.judge(now, sent.as_ref(), &beacon, advertise, heartbeat) {
                Due::Now(class) => class,
                Due::Never => {
                    sender.later = None;
                    continue;
                }
                Due::At(later) => {
                    sender.later = Some(later);
                    continue;
                }
            };
            sender.later = None;
            sender.sequence += 1;
            (beacon.sequence, beacon.spoken) = (sender.sequence, self.own.params().stamp(now));
            (*sent, sender.sent_at) = (Some(beacon), Some(now));
            self.out.send(&self.sides, face, class, Message::Beacon(beacon));
        }
    }

    /// Returns the least time between two beacons on a face. In the published simulation of the connection gradient every module
    /// speaks in every step: a neighbour that hears later than the next module leaves would be cut off.
    fn least_interval(&self) -> Span {
        match self.own.connectivity() {
            Connectivity::Gradient => Span::ZERO,
            Connectivity::Forest | Connectivity::Cycles => self.own.params().advertise,
        }
    }

    /// Checks that a beacon that is not composed would not have been sent.
    #[cfg(debug_assertions)]
    fn assert_waits(&self, now: Time, face: Face) {
        let (advertise, heartbeat) = (self.own.params().advertise, self.own.params().heartbeat);
        let beacon = self.compose(now, face, &self.compose_common(now));
        let (sender, sent) = (&self.beacons.senders[face.index()], &self.beacons.sent[face.index()]);
        let expected = sender.later.map_or(Due::Never, Due::At);
        let due = sender.judge(now, sent.as_ref(), &beacon, advertise, heartbeat);
        assert_eq!(due, expected, "a beacon was not composed and would differ");
    }

    fn timed(&self, now: Time) -> Timed {
        Timed {
            wanted: self.wanted,
            finals: self.finals,
            filled: self.filled,
            supports: self.sides.support_mask(),
            live: self.sides.live_mask(),
            open: self.sides.open_mask(),
            is_quarantined: self.own.is_quarantined(now),
            is_stranded: self.is_stranded(now),
            waits_here: self.waits_here(),
            asks_children: now.since(self.own.settled) > self.own.params().suspect,
        }
    }

    /// Composes the part of the beacon that is the same for all neighbours.
    fn compose_common(&self, now: Time) -> Beacon {
        let (own, v) = (&self.own, self.view(now));
        Beacon {
            id: own.id,
            sequence: 0,
            epoch: own.epoch,
            role: own.role,
            attached: self.forest.is_attached(v),
            immobile: own.immobile || self.is_stranded(now) || self.waits_here(),
            supported_here: false,
            wants_you: false,
            quarantined: v.is_quarantined(),
            knows_of_death: own.knows_of_death,
            spoken: 0,
            final_hops: v.final_hops(),
            supports: self.sides.support_mask(),
            finals: self.finals,
            filled: self.filled,
            dead: self.sides.certified_mask(),
            fixed: self.forest.fixed_mask(v),
            rank: self.forest.told_rank(v, self.is_idle()),
            renew: Time::ZERO,
            claim: Claim::None,
            ack: None,
            corners: 0,
            taken: 0,
            subtree: 0,
            field: [Entry::NONE; 4],
        }
    }

    fn compose(&self, now: Time, face: Face, common: &Beacon) -> Beacon {
        let (own, v) = (&self.own, self.view(now));
        let activated_here = own.role == Role::Final && own.activator == Some(face);
        Beacon {
            supported_here: activated_here || (own.role == Role::Walker && own.support == Some(face)),
            wants_you: self.wanted & face.bit() != 0,
            renew: self.forest.renewal(v, face),
            claim: self.forest.claim(v, face),
            ack: self.forest.child(face),
            corners: self.planner.corners_seen(face),
            taken: self.taken_over_edges(face),
            subtree: if activated_here { self.subtree(now) } else { 0 },
            field: self.attraction.advertised(v, face),
            ..*common
        }
    }

    /// Returns the directions in which the cell over this module's edge is taken for now, for a walker on a face: by another walker, or
    /// by a reservation. The walker cannot see that cell, and would be denied it. A neighbour that has not been heard is told as well,
    /// since a walker chooses its next motion when it hears the first beacon at a new place. A walker that cannot move on is left out:
    /// nothing would be gained by waiting for it.
    fn taken_over_edges(&self, face: Face) -> u8 {
        let walker = match self.sides.peer(face) {
            Some(b) if b.role == Role::Walker => Some(b.id),
            Some(_) => return 0,
            None => None,
        };
        let standing = self.sides.touching_mask() & self.sides.open_mask();
        (standing | self.locks.reserved_for_others(walker)) & super::attraction::beside(face)
    }

    /// Returns true if this is a walker without any neighbour to walk over: its supports have died.
    fn is_stranded(&self, now: Time) -> bool {
        self.own.role == Role::Walker
            && self.moving.is_none()
            && !self.view(now).may_hear_more()
            && self.sides.support_mask() == 0
    }

    /// Returns the number of finalized modules in the subtree of this one: itself, the modules that it made finalized,
    /// those that they made finalized, and so on.
    pub(super) fn subtree(&self, now: Time) -> u32 {
        let v = self.view(now);
        let below: u32 = Face::in_mask(self.sides.live_mask())
            .filter(|f| Some(*f) != self.own.activator)
            .filter_map(|f| v.live(f))
            .filter(|b| v.is_final(b) && b.supported_here)
            .map(|b| b.subtree)
            .sum();
        below + 1
    }

    /// Returns when the next beacon is due.
    pub(super) fn beacons_due(&self) -> Time {
        let (interval, heartbeat) = (self.least_interval(), self.own.params().heartbeat);
        let touching = Face::in_mask(self.sides.touching_mask());
        let due = touching.map(|f| self.beacons.senders[f.index()].due_at(interval, heartbeat));
        due.min().unwrap_or(Time::NEVER)
    }
}

/// Returns how long after the last beacon a change of distances is sent. A distance that has fallen by much
/// ([`MUCH_CLOSER`]) waits for one `advertise`. Other changes wait for one more `advertise` per move to the target:
/// a module `n` moves away needs at least `n` moves to get there, and by then the distance will have changed again.
fn news_delay(before: &Beacon, after: &Beacon, advertise: Span) -> Span {
    let changed = before.field.iter().zip(&after.field).filter(|(b, a)| a != b);
    let moves = changed.map(|(b, a)| {
        let gained = b.distance.saturating_sub(a.distance);
        let much = gained > 0 && gained >= a.distance / MUCH_CLOSER;
        if much { 0 } else { b.moves().min(a.moves()) }
    });
    advertise + advertise * u64::from(moves.min().unwrap_or(0))
}

/// Returns the class of a beacon, judged by what is new in it; connectivity first, gradient last.
fn class_of_news(before: &Beacon, after: &Beacon) -> Class {
    let connectivity = |b: &Beacon| {
        (b.attached, b.rank, b.renew, b.claim, b.ack, b.supported_here, b.quarantined, b.final_hops)
    };
    let seed = |b: &Beacon| {
        let faces = (b.supports, b.finals, b.filled, b.dead, b.fixed);
        (b.epoch, b.role, b.wants_you, faces, b.subtree, b.immobile)
    };
    if connectivity(before) != connectivity(after) {
        Class::Connectivity
    } else if seed(before) != seed(after) {
        Class::Seed
    } else if (before.corners, before.taken) != (after.corners, after.taken) {
        Class::Negotiation
    } else {
        Class::Gradient
    }
}
