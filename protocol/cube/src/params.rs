//! Parameters of the cube protocol.

use super::epoch::Epoch;
use alloc::vec::Vec;
use metamorph_core::defects::Defect;
use metamorph_core::goal::Goal;
use metamorph_core::ratio::Ratio;
use metamorph_core::time::Span;
use serde::{Deserialize, Serialize};

/// The fixed part of the time of a back-off, in ticks ([`Params::tick`]).
pub(super) const BACK_OFF: u64 = 6;
/// The bound of the random part of the time of a back-off, in ticks; it doubles with every failure in a row.
pub(super) const BACK_OFF_SPREAD: u64 = 8;
/// The largest number of times that [`BACK_OFF_SPREAD`] doubles.
pub(super) const MOST_DOUBLED: u8 = 4;

/// The number of hops of a request beyond which an answer is not waited for longer.
const HOPS_WAITED: usize = 3;

/// How a module makes sure that the structure stays in one piece when it leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Connectivity {
    /// A forest of registered parents that is rooted in the finalized modules: the connection gradient made
    /// safe against late and lost messages. A module with a child does not leave.
    #[default]
    Forest,
    /// Connecting cycles, locked before a move (thesis 4.2.2, after Fitch and Butler). Needs no
    /// rooted structure, but its search has a limited depth and misses long thin loops.
    Cycles,
    /// The connection gradient as published (thesis 4.1.2, after Stoy): a module may leave if no neighbour's gradient depends on
    /// it, as far as it has heard, and has none from the moment at which it wants to leave. Of two modules that hold a third
    /// the later one has to hear in time that the third depends on it now, so this asks for messages that all take the same
    /// time. It knows nothing of the dead. Kept because it is the published rule.
    Gradient,
}

/// Parameters of the cube protocol. All times are scenario time. [`Params::scaled`] derives the defaults from the
/// duration of a move and the delay of a message.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Params {
    /// The connectivity check.
    pub connectivity: Connectivity,
    /// True if a reservation also needs the consent of the other modules that touch the cell, as far as the module that
    /// reserves it knows them.
    pub co_owners: bool,
    /// The longest duration of a move.
    pub move_time: Span,
    /// The time within which a message usually arrives. Time-outs depend on it, safety does not.
    pub usual_delay: Span,
    /// The least time between two beacons on a face.
    pub advertise: Span,
    /// The longest time between two beacons on a face.
    pub heartbeat: Span,
    /// The time between two versions of a target's gradient.
    pub refresh: Span,
    /// How long a version of a gradient is used after it was first heard.
    pub hold: Span,
    /// How long a neighbour may be silent before it is suspected dead.
    pub suspect: Span,
    /// How long a module of a body with dead modules hears of no target before it looks for one itself.
    pub survey_after: Span,
    /// How long a lock or reservation lasts: at least eight usual delays and one move.
    pub lease: Span,
    /// The largest relative drift of clocks against each other: time gained or lost per time passed.
    pub drift: Ratio,
    /// The largest difference between the controller's clock and the clock of a host.
    pub skew: Span,
    /// How long a corner found blocked is avoided.
    pub corner_hint: Span,
    /// How long a goal cell must have been unfilled before any finalized neighbour may start it out of turn. A module
    /// with a suspected neighbour starts no cell out of turn.
    pub out_of_turn_after: Span,
    /// How long a restarted module only listens and looks for a parent: it grants nothing, does not move and
    /// is not finalized. Two leases are longer than any lock lasts that it granted before, by the fastest clock, and than any move
    /// that its body was asked for before.
    pub quarantine: Span,
    /// The reach of gradients, in moves.
    pub range: u16,
    /// How long a module in reserve must have known a target before it leaves for it, per move of the target's
    /// distance.
    pub recruit_per_move: Span,
    /// The number of failed actions in a row after which a module counts itself immobile.
    pub immobile_after: u8,
    /// A defect for tests.
    #[doc(hidden)]
    pub defect: Option<Defect>,
}

impl Params {
    /// Returns default parameters for moves that take `move_time`, links that usually deliver within
    /// `usual_delay`, and gradients of the given range.
    pub fn scaled(move_time: Span, usual_delay: Span, range: u16) -> Params {
        let heartbeat = Span(move_time.0 * 4).max(usual_delay * 4);
        let lease = Span((move_time.0 * 8).max(usual_delay.0 * 16 + move_time.0 * 2));
        Params {
            connectivity: Connectivity::Forest,
            co_owners: true,
            move_time,
            usual_delay,
            advertise: Span(move_time.0 * 2 / 5),
            heartbeat,
            refresh: heartbeat * 2,
            hold: heartbeat * 8,
            suspect: heartbeat * 10,
            survey_after: heartbeat * 8,
            lease,
            drift: Ratio::new(1, 50).expect("invariant: 1/50 is a ratio"),
            skew: Span::ZERO,
            corner_hint: move_time * 75,
            out_of_turn_after: Span(heartbeat.0 / 2) * 125,
            quarantine: lease * 2,
            range,
            // Longer saves moves and costs time: for 10,000 modules three fifths of a move instead of a half save 6 % of the moves
            // and cost 3 % more time.
            recruit_per_move: Span(move_time.0 * 11 / 20),
            immobile_after: 6,
            defect: None,
        }
    }

    /// Returns the parameters with another connectivity check. With connecting cycles, the lease and the quarantine
    /// are made long enough for the longest route.
    pub fn keeping(mut self, connectivity: Connectivity) -> Params {
        self.connectivity = connectivity;
        if connectivity == Connectivity::Cycles {
            // A request over the longest cycle must be answered within a lease, or the cycle would be found
            // too late.
            let there_and_back = self.usual_delay * (2 * super::route::MAX_HOPS as u64);
            self.lease = self.lease.max(there_and_back + self.move_time * 2);
            self.quarantine = self.lease * 2;
        }
        self
    }

    /// Returns the connectivity check of an epoch. A goal that is opened again needs modules to leave that the forest
    /// keeps for the sake of the dead; connecting cycles, which cost more messages, let them go.
    pub fn connectivity_in(&self, epoch: Epoch) -> Connectivity {
        match self.connectivity {
            Connectivity::Forest if epoch.opening() > 0 => Connectivity::Cycles,
            check => check,
        }
    }
    /// Returns the time unit of back-offs, a twentieth of a move.
    pub fn tick(&self) -> Span {
        (self.move_time / 20).max(Span(1))
    }
    /// Returns how long the answer of a module `hops` away may take before the request is repeated: two usual delays a hop, and
    /// eight ticks. On a longer way than [`HOPS_WAITED`] it is repeated earlier, because what was lost on its first hops would
    /// be noticed too late.
    pub fn answer_over(&self, hops: usize) -> Span {
        self.usual_delay * (2 * hops.min(HOPS_WAITED) as u64) + self.tick() * 8
    }
    /// Returns the longest wait after a failed attempt.
    pub fn longest_back_off(&self) -> Span {
        self.tick() * (BACK_OFF + (BACK_OFF_SPREAD << MOST_DOUBLED))
    }
    /// Returns how long a module at a new cell waits for the first beacons of its neighbours.
    pub fn first_words(&self) -> Span {
        self.usual_delay + self.advertise * 6
    }
    /// Returns how long a walker rests without a target before it takes a place in the forest again.
    pub fn parks_after(&self) -> Span {
        self.out_of_turn_after / 4
    }
    /// Returns the latest start of a move, counted from its first request: `lease·(1−drift) − move − skew`. The mover
    /// sets the deadline by its own clock, and the body compares it with the controller's.
    ///
    /// A lock so ends strictly after the latest end of the move: a grantor may leave at the instant at which its lock ends.
    pub fn start_within(&self) -> Span {
        let shrunk = self.lease.0 - self.lease.0 / u64::from(self.drift.den()) * u64::from(self.drift.num());
        Span(shrunk) - self.move_time - self.clock_margin()
    }
    fn clock_margin(&self) -> Span {
        if self.defect == Some(Defect::IgnoreSkew) { Span::ZERO } else { self.skew }
    }
    /// Returns how long a grantor keeps a lock, counted from the request's arrival: `lease·(1+drift)`.
    pub fn keep_for(&self) -> Span {
        Span(self.lease.0 + self.lease.0 / u64::from(self.drift.den()) * u64::from(self.drift.num()))
    }
}

/// Parameters and goals that all cubes of a swarm share.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Setup {
    /// The parameters.
    pub params: Params,
    /// The goals in order; never empty.
    pub goals: Vec<Goal>,
}
