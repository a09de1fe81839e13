//! Parameters of the metamodule protocol: strategies, the force field, times.

use metamorph_core::defects::Defect;
use metamorph_core::names;
use metamorph_core::time::Span;
use serde::{Deserialize, Serialize};

/// How a metamodule decides what to do next. The first three are the thesis's (4.1.3) and differ in how
/// neighbours push, [`Repulsion`], and in who goes first, [`Precedence`]; the others are ours.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, Default)]
#[serde(rename_all = "lowercase")]
pub enum Strategy {
    /// Neighbours do not push; of two that are close, the one nearer to a seed goes first.
    Greedy,
    /// Neighbours push, the less the farther away they are.
    Slope,
    /// Neighbours push, equally at all distances within the range.
    Step,
    /// Metamodules share out the seeds, announce their paths, and move out of more important paths (see
    /// `docs/negotiated.md`). The default, because the published strategies deadlock.
    #[default]
    Negotiated,
    /// The world-controller plans for all, and orders one move after the other (see `docs/planned.md`).
    Planned,
}

names!(Strategy {
    Greedy => "greedy",
    Slope => "slope",
    Step => "step",
    Negotiated => "negotiated",
    Planned => "planned",
});

impl Strategy {
    /// The three of the thesis.
    pub const PUBLISHED: [Strategy; 3] = [Strategy::Greedy, Strategy::Slope, Strategy::Step];
    /// The strategies under which each metamodule decides for itself.
    pub const DISTRIBUTED: [Strategy; 4] =
        [Strategy::Greedy, Strategy::Slope, Strategy::Step, Strategy::Negotiated];
    /// Whether it is one of the three of the thesis: a force field, which has local minima.
    pub const fn is_published(self) -> bool {
        matches!(self, Strategy::Greedy | Strategy::Slope | Strategy::Step)
    }

    /// Returns the repulsion under this strategy. The thesis gives no numbers; these are our own choice.
    pub const fn repulsion(self) -> Repulsion {
        match self {
            Strategy::Greedy | Strategy::Negotiated | Strategy::Planned => {
                Repulsion { strength: 0, decay: 0, range: 4 }
            }
            Strategy::Slope => Repulsion { strength: 1000, decay: 1000, range: 4 },
            Strategy::Step => Repulsion { strength: 600, decay: 0, range: 4 },
        }
    }
    /// Returns the rule of precedence under this strategy, if it has one. The thesis defines it only for `greedy`, by
    /// "locking modules which are too close from each other before deciding which one should move first". The distance,
    /// and the rule that the nearer one goes first, are our own choice.
    pub const fn precedence(self) -> Option<Precedence> {
        match self {
            Strategy::Greedy => Some(Precedence { within: 4, by: PrecedenceBy::SeedDistance }),
            Strategy::Slope | Strategy::Step | Strategy::Negotiated | Strategy::Planned => None,
        }
    }
}

/// Which of two unsettled metamodules goes first. The other one stands still meanwhile.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Precedence {
    /// Distance of two feet in connectors (the larger of those along x and y) up to which the rule holds.
    pub within: u16,
    /// The criterion.
    pub by: PrecedenceBy,
}

/// Criterion of precedence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PrecedenceBy {
    /// The one nearer to an open seed goes first; of equal ones the one with the smaller id.
    SeedDistance,
    /// The one with the smaller id goes first.
    Id,
}

names!(PrecedenceBy { SeedDistance => "seed-distance", Id => "id" });

/// How strongly a neighbour at distance r pushes: `strength · (1 − decay · r / range)` within the
/// range, in thousandths of the attraction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Repulsion {
    /// The push at distance zero, in thousandths of the attraction.
    pub strength: u16,
    /// How much of it is lost at the edge of the range, in thousandths.
    pub decay: u16,
    /// The distance from which on a neighbour does not push, in cells between the middles of the two metamodules.
    pub range: u16,
}

/// The least [`Params::communication_range`], in connectors. Motions from one foot reach at most four cells to the side,
/// so a metamodule farther away cannot be in the way of a move, nor come into it by a move of its own.
pub const LEAST_COMMUNICATION_RANGE: u16 = 9;
/// The usual communication range: a distance in connectors. The thesis's metamodules broadcast, and it names no range
/// (4.1.3); this one covers the floor that its experiments are repeated on.
pub const COMMUNICATION_RANGE: u16 = 12;

/// From whom metamodules learn which seeds are filled and open.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, Default)]
#[serde(rename_all = "lowercase")]
pub enum SeedAuthority {
    /// From the world-controller, as in the thesis.
    #[default]
    Controller,
    /// From neighbours in range: each tells what it knows to be filled, and works out what is open.
    Neighbours,
}

/// Before which searches for a plan of all together a metamodule asks the operator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, Default)]
#[serde(rename_all = "lowercase")]
pub enum Ask {
    /// None.
    #[default]
    Never,
    /// Those that begin because nothing moves.
    Stuck,
    /// All.
    Always,
}

impl Ask {
    /// All of them, with the names used in scenarios.
    pub const ALL: [(&'static str, Ask); 3] =
        [("never", Ask::Never), ("stuck", Ask::Stuck), ("always", Ask::Always)];
}

/// How metamodules find out that none of them can continue.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Detector {
    /// How long a metamodule waits before it begins a wave of questions, and the time between two of its waves.
    pub after: Span,
    /// The number of metamodules in the swarm; a deadlock is found only if all of them have been counted.
    pub metamodules: u16,
}

/// Parameters of the metamodule protocol. All times are scenario time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Params {
    /// How decisions are made.
    pub strategy: Strategy,
    /// How neighbours push.
    pub repulsion: Repulsion,
    /// Which of two metamodules close together goes first; `None` leaves that to locks. Read by the published
    /// strategies only.
    pub precedence: Option<Precedence>,
    /// Whether settled metamodules push like others. Read by the published strategies only.
    pub settled_repel: bool,
    /// From whom open seeds are learnt.
    pub seed_authority: SeedAuthority,
    /// The communication range: feet at most this far apart (the larger of the two distances along x and y)
    /// hear each other.
    pub communication_range: u16,
    /// How long a joint needs for a step.
    pub turn_time: Span,
    /// How long connecting and disconnecting take.
    pub connect_time: Span,
    /// How long a grant lasts.
    pub lease: Span,
    /// The largest difference between the controller's clock and the clock of a host.
    pub skew: Span,
    /// The time after which an unanswered request is repeated, and within which all neighbours should have heard a
    /// message.
    pub resend: Span,
    /// The longest time between two states that a metamodule sends to its neighbours.
    pub repeat: Span,
    /// The shortest wait after a lock was denied; the longest is twice as long.
    pub back_off: Span,
    /// Whether, and how, metamodules find out among themselves that none of them can continue.
    pub detector: Option<Detector>,
    /// How long a metamodule waits for others to make way, or to claim a seed that falls to one of them, before it acts
    /// itself. Several other time-outs are multiples of it.
    pub patience: Span,
    /// Before which searches of all together the operator is asked (`negotiated` only).
    pub ask: Ask,
    /// How long a metamodule waits for the answer before it continues by itself.
    pub answer_within: Span,
    /// A defect for tests.
    #[doc(hidden)]
    pub defect: Option<Defect>,
}

impl Params {
    /// Returns default parameters for joints that need `turn_time` per step, and links with this message delay.
    pub fn scaled(strategy: Strategy, turn_time: Span, delay: Span) -> Params {
        let round_trip = delay * 2;
        let patience = turn_time * 10 + round_trip * 4;
        Params {
            strategy,
            repulsion: strategy.repulsion(),
            precedence: strategy.precedence(),
            settled_repel: true,
            seed_authority: SeedAuthority::Controller,
            communication_range: COMMUNICATION_RANGE,
            turn_time,
            connect_time: turn_time,
            lease: turn_time * 40 + round_trip * 4,
            skew: Span::ZERO,
            resend: round_trip + Span(delay.0 / 2) + Span::millis(20),
            repeat: turn_time * 10,
            back_off: turn_time,
            detector: None,
            patience,
            ask: Ask::Never,
            answer_within: patience * 3,
            defect: None,
        }
    }

    /// Returns how much earlier than the end of a lease the deadline of an action is: the holder of the lock sets the
    /// deadline by its own clock, and the body compares it with the controller's.
    pub fn clock_margin(&self) -> Span {
        if self.defect == Some(Defect::IgnoreSkew) { Span::ZERO } else { self.skew }
    }
}
