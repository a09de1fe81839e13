//! Beacons: when a module tells its neighbours about itself, and the class of each beacon.
//!
//! State is soft: everything is repeated, so that a lost beacon costs only time.

use super::Cube;
use super::message::{Beacon, Message, Role};
use crate::counters::Class;
use crate::lattice::Face;
use crate::time::{Span, Time};

/// A distance that falls by more than this fraction of itself (one in `MUCH_CLOSER`) is sent at once.
const MUCH_CLOSER: u16 = 8;

/// What has been sent over one face.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Sender {
    /// The last beacon sent in this session.
    sent: Option<Beacon>,
    sent_at: Time,
    sequence: u32,
    /// True if something may have changed since.
    stale: bool,
    /// When news that can wait is sent.
    later: Option<Time>,
}

impl Sender {
    const NEW: Sender = Sender { sent: None, sent_at: Time::ZERO, sequence: 0, stale: true, later: None };

    /// Returns the latest time at which a beacon is due.
    fn due_at(&self, advertise: Span, heartbeat: Span) -> Time {
        if self.sent.is_none() {
            return Time::ZERO;
        }
        let again = if self.stale { advertise } else { heartbeat };
        (self.sent_at + again).min(self.later.unwrap_or(Time::NEVER))
    }
}

/// The beacons of a module, face by face.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Beacons {
    senders: [Sender; 6],
}

impl Beacons {
    pub fn new() -> Beacons {
        Beacons { senders: [Sender::NEW; 6] }
    }
    /// Returns the number of beacons sent in the present session of a face.
    pub fn sequence(&self, face: Face) -> u32 {
        self.senders[face.index()].sequence
    }
    /// Begins a session on a face, or ends it.
    pub fn on_contact(&mut self, face: Face) {
        let sender = &mut self.senders[face.index()];
        *sender = Sender { sent_at: sender.sent_at, ..Sender::NEW };
    }
    /// Makes the next step compare all beacons with those sent last.
    pub fn touch(&mut self) {
        for sender in &mut self.senders {
            sender.stale = true;
        }
    }
}

impl Cube {
    /// Sends the beacons that are due: news at most once per `advertise`, news of the field that can wait
    /// later, the rest per `heartbeat`.
    pub(super) fn tend_beacons(&mut self, now: Time) {
        let (advertise, heartbeat) = (self.own.params().advertise, self.own.params().heartbeat);
        for face in Face::ALL {
            let sender = &self.beacons.senders[face.index()];
            if !self.sides.is_touching(face) || now < sender.due_at(advertise, heartbeat) {
                continue;
            }
            let mut beacon = self.compose(now, face, sender.sequence);
            let sender = &mut self.beacons.senders[face.index()];
            sender.stale = false;
            let age = now.since(sender.sent_at);
            let class = match &sender.sent {
                None => Class::Liveness,
                Some(before) if *before == beacon => {
                    sender.later = None;
                    if age < heartbeat {
                        continue;
                    }
                    Class::Liveness
                }
                Some(before) => class_of_news(before, &beacon),
            };
            if class == Class::Gradient
                && let Some(before) = &sender.sent
            {
                let wait = news_delay(before, &beacon, advertise).min(heartbeat);
                if age < wait {
                    sender.later = Some(sender.sent_at + wait);
                    continue;
                }
            }
            sender.later = None;
            sender.sequence += 1;
            beacon.sequence = sender.sequence;
            (sender.sent, sender.sent_at) = (Some(beacon), now);
            self.out.send(&self.sides, face, class, Message::Beacon(beacon));
        }
    }

    fn compose(&self, now: Time, face: Face, sequence: u32) -> Beacon {
        let (own, v) = (&self.own, self.view(now));
        let activated_here = own.role == Role::Final && own.activator == Some(face);
        Beacon {
            id: own.id,
            sequence,
            epoch: own.epoch,
            role: own.role,
            attached: self.forest.is_attached(v),
            immobile: own.immobile || self.is_stranded(now),
            anchored_here: activated_here || (own.role == Role::Walker && own.anchor == Some(face)),
            wants_you: self.wanted & face.bit() != 0,
            quarantined: v.is_quarantined(),
            final_hops: v.final_hops(),
            terrain: self.sides.terrain_mask(),
            finals: self.finals,
            rank: self.forest.told_rank(v),
            renew: self.forest.renewal(v, face),
            claim: self.forest.claim(v, face),
            ack: self.forest.child(face),
            corners: self.planner.corners_seen(face),
            subtree: if activated_here { self.subtree(now) } else { 0 },
            field: self.attraction.advertised(v, face),
        }
    }

    /// Returns true if this is a walker without any neighbour to walk over: its supports have died.
    fn is_stranded(&self, now: Time) -> bool {
        self.own.role == Role::Walker
            && self.moving.is_none()
            && !self.view(now).may_hear_more()
            && self.sides.terrain_mask() == 0
    }

    /// Returns the number of finalized modules that this one counts for: itself, those that it made
    /// finalized, and so on.
    pub(super) fn subtree(&self, now: Time) -> u32 {
        let v = self.view(now);
        let below: u32 = Face::ALL
            .into_iter()
            .filter(|f| Some(*f) != self.own.activator)
            .filter_map(|f| v.live(f))
            .filter(|b| v.is_final(b) && b.anchored_here)
            .map(|b| b.subtree)
            .sum();
        below + 1
    }

    /// Returns when the next beacon is due.
    pub(super) fn beacons_due(&self) -> Time {
        let p = self.own.params();
        let touching = Face::ALL.into_iter().filter(|f| self.sides.is_touching(*f));
        let due = touching.map(|f| {
            let sender = &self.beacons.senders[f.index()];
            let again = if sender.stale { p.advertise } else { p.heartbeat };
            (sender.sent_at + again).min(sender.later.unwrap_or(Time::NEVER))
        });
        due.min().unwrap_or(Time::NEVER)
    }
}

/// Returns the delay of news of the field after the beacon before. A target that comes much closer is sent at
/// once. Other news matters less the farther the target is: a module `n` moves away gets there `n` moves
/// later at the earliest, and by then the news will have changed again.
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
