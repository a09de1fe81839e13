//! The numbers a cube protocol runs with.

use crate::defects::Sabotage;
use crate::goal::Goal;
use crate::ratio::Ratio;
use crate::time::Span;
use serde::{Deserialize, Serialize};

/// The least ticks of a back-off, the ticks that are drawn in addition at first, and how often these double
/// at most.
pub(super) const BACK_OFF: u64 = 6;
pub(super) const BACK_OFF_SPREAD: u64 = 8;
pub(super) const MOST_DOUBLED: u8 = 4;

/// How a module makes sure that the structure stays in one piece when it leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Connectivity {
    /// A forest of registered parents that is rooted in the finalized modules: the connection
    /// gradient made safe under late and lost messages. A module with a child does not leave.
    #[default]
    Forest,
    /// Connecting cycles, locked before a move (thesis 4.2.2, after Fitch and Butler). Needs no
    /// rooted structure, but long thin loops can be beyond its search.
    Cycles,
    /// The connection gradient as published (thesis 4.1.2, after Stoy): a module may leave if no
    /// neighbour's gradient depends on it, as far as it has heard. Not safe when messages are late;
    /// kept because it is the published rule.
    Gradient,
}

/// Parameters of the cube protocol. All times are scenario time; the defaults scale with the
/// duration of a move (prototype values in units of a twentieth of a move).
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Params {
    /// Which connectivity check.
    pub connectivity: Connectivity,
    /// Whether modules that touch the same empty cell as the one asked are asked too.
    pub co_owners: bool,
    /// How long a move takes at most.
    pub move_time: Span,
    /// How long a message takes at most, usually; for time-outs only, not for safety.
    pub usual_delay: Span,
    /// The least time between two beacons on a face.
    pub advertise: Span,
    /// A beacon is repeated after this time without news.
    pub heartbeat: Span,
    /// A target's gradient gets a new version this often.
    pub refresh: Span,
    /// A version of a gradient is used this long after it was first heard.
    pub hold: Span,
    /// A neighbour silent for this long is suspected dead.
    pub suspect: Span,
    /// How long a lock or reservation lasts. At least eight usual delays and one move.
    pub lease: Span,
    /// How much clocks drift against each other at most.
    pub drift: Ratio,
    /// How long a corner found blocked is avoided.
    pub corner_hint: Span,
    /// After this long an unfilled goal cell may be started from any filled neighbour, unless it misses one of
    /// its own.
    pub relax: Span,
    /// How long a restarted module only listens and looks for a parent: it grants nothing, does not
    /// move and is not finalized.
    pub quarantine: Span,
    /// Gradients end at this distance in moves.
    pub range: u16,
    /// A module in reserve leaves for a target only after having known it for this long per move of
    /// its distance.
    pub recruit_per_move: Span,
    /// After this many failed actions in a row a module counts itself immobile.
    pub immobile_after: u8,
    /// A defect for tests.
    #[doc(hidden)]
    pub sabotage: Option<Sabotage>,
}

impl Params {
    /// Default parameters for moves that take `move_time`, links that usually deliver within
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
            lease,
            drift: Ratio::new(1, 50).expect("invariant: 1/50 is a ratio"),
            corner_hint: move_time * 75,
            relax: Span(heartbeat.0 / 2) * 125,
            quarantine: lease * 2,
            range,
            // As long as a nearer one needs would save an eighth of the moves and cost half as much time again;
            // less than half as long saves no more time.
            recruit_per_move: move_time / 2,
            immobile_after: 6,
            sabotage: None,
        }
    }

    /// The same with another connectivity check.
    pub fn keeping(mut self, connectivity: Connectivity) -> Params {
        self.connectivity = connectivity;
        if connectivity == Connectivity::Cycles {
            // The longest cycle can be asked for and answer within a lease, or it would be found in vain.
            let there_and_back = self.usual_delay * (2 * super::route::MAX_HOPS as u64);
            self.lease = self.lease.max(there_and_back + self.move_time * 2);
            self.quarantine = self.lease * 2;
        }
        self
    }

    /// The time unit of back-offs, a twentieth of a move.
    pub fn tick(&self) -> Span {
        (self.move_time / 20).max(Span(1))
    }
    /// The longest that a module waits after an attempt that failed, before it makes another.
    pub fn longest_back_off(&self) -> Span {
        self.tick() * (BACK_OFF + (BACK_OFF_SPREAD << MOST_DOUBLED))
    }
    /// How long the first words of new neighbours take.
    pub fn first_words(&self) -> Span {
        self.usual_delay + self.advertise * 6
    }
    /// Until when a mover may start, counted from its first request: `lease·(1−drift) − move`.
    pub fn start_within(&self) -> Span {
        let shrunk = self.lease.0 - self.lease.0 / u64::from(self.drift.den()) * u64::from(self.drift.num());
        Span(shrunk) - self.move_time
    }
    /// How long a grantor keeps a lock, counted from the request's arrival: `lease·(1+drift)`.
    pub fn keep_for(&self) -> Span {
        Span(self.lease.0 + self.lease.0 / u64::from(self.drift.den()) * u64::from(self.drift.num()))
    }
}

/// What all cubes of a swarm share.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Setup {
    /// The parameters.
    pub params: Params,
    /// The goals, one after the other; never empty.
    pub goals: Vec<Goal>,
}
