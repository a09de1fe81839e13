//! What can be wrong with the parts of a scenario that only metamodules have, and what to do about it.

use crate::scenario::flaw::Flaw;
use metamorph_protocol::metamodule::blueprint::BlueprintError;
use metamorph_protocol::metamodule::params::Floor;
use metamorph_protocol::metamodule::start::StartError;
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::time::Span;
use thiserror::Error;

/// The most metamodules of one swarm.
pub const MAX_METAMODULES: usize = 1_000;
/// The most connectors of a floor along each side.
pub const MAX_FLOOR: u16 = 256;
/// The farthest that metamodules hear. More makes little difference: nobody has ports for as many as there
/// may be within it.
pub const MAX_HEARING: u64 = 64;

/// What is wrong.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum MetamoduleFlaw {
    /// The seeds cannot be.
    #[error(transparent)]
    Blueprint(#[from] BlueprintError),
    /// A seed where nothing can hold on.
    #[error("the seed at {at:?} is not on the floor, which goes from {:?} to {:?}", floor.min, floor.max)]
    SeedOffFloor {
        /// The connector of the seed.
        at: (i16, i16),
        /// The floor.
        floor: Floor,
    },
    /// A seed that no posture fills.
    #[error("no posture of a metamodule of kind {kind} fills the seed at {at:?}")]
    SeedShape {
        /// The connector of the seed.
        at: (i16, i16),
        /// The kind.
        kind: Kind,
    },
    /// A metamodule starts where nothing can hold it.
    #[error("the start at {at:?} is not on the floor, which goes from {:?} to {:?}", floor.min, floor.max)]
    StartOffFloor {
        /// The connector.
        at: (i16, i16),
        /// The floor.
        floor: Floor,
    },
    /// Two metamodules start in each other.
    #[error("metamodules {first} and {second} both start at {at:?}")]
    StartTwice {
        /// One of them.
        first: usize,
        /// The other.
        second: usize,
        /// The connector.
        at: (i16, i16),
    },
    /// Nowhere to start.
    #[error(transparent)]
    NoRoom(#[from] StartError),
    /// More or fewer places than metamodules.
    #[error("`count` is {count}, but `start` lists {listed} places")]
    Count {
        /// As counted.
        count: u64,
        /// As listed.
        listed: usize,
    },
    /// More seeds than metamodules.
    #[error("the goal has {seeds} seeds and the swarm has {metamodules} metamodules: {} too few",
        seeds - metamodules)]
    TooFewMetamodules {
        /// Seeds of the goal.
        seeds: usize,
        /// Metamodules of the swarm.
        metamodules: usize,
    },
    /// The first goal is there from the beginning.
    #[error("the first goal has an `at`, but it is the goal from the beginning")]
    FirstGoalAt,
    /// Whoever negotiates never only waits.
    #[error("`negotiated` has no detector: whoever waits tries again after a time, so nobody can know")]
    NoDetector,
    /// A key of the force field with a strategy that has none.
    #[error("`negotiated` has no force field, so `{0}` means nothing to it")]
    NoField(&'static str),
    /// Goals in the wrong order.
    #[error("this goal replaces the one before at {at}, which itself comes at {before}")]
    GoalOrder {
        /// When this one comes.
        at: Span,
        /// When the one before comes.
        before: Span,
    },
}

impl MetamoduleFlaw {
    /// What to do about it.
    pub fn fix(&self) -> String {
        match self {
            MetamoduleFlaw::Blueprint(error) => blueprint_fix(error).into(),
            MetamoduleFlaw::SeedOffFloor { .. } => "move the goal, or make `floor` in [swarm] larger".into(),
            MetamoduleFlaw::SeedShape { .. } => {
                "choose other `directions` or another `kind`; `metamorph robot shapes` lists what they take"
                    .into()
            }
            MetamoduleFlaw::StartOffFloor { floor: Floor { min, max }, .. } => {
                format!("name a connector from {min:?} to {max:?}, or make `floor` larger")
            }
            MetamoduleFlaw::StartTwice { .. } => "give each a connector of its own".into(),
            MetamoduleFlaw::NoRoom(_) => {
                "make `floor` in [swarm] larger, or list the places in `start`".into()
            }
            MetamoduleFlaw::Count { .. } => "leave `count` out; the list says how many there are".into(),
            MetamoduleFlaw::TooFewMetamodules { seeds, .. } => {
                format!("let there be at least {seeds} in [swarm]")
            }
            MetamoduleFlaw::FirstGoalAt => {
                "leave `at` out, or move this goal behind the one it replaces".into()
            }
            MetamoduleFlaw::NoDetector => {
                "leave `detector` out, or choose `greedy`, `slope` or `step`".into()
            }
            MetamoduleFlaw::NoField(key) => {
                format!("leave `{key}` out, or choose `greedy`, `slope` or `step`")
            }
            MetamoduleFlaw::GoalOrder { .. } => "list the goals in the order of their times".into(),
        }
    }
}

impl From<MetamoduleFlaw> for Flaw {
    fn from(flaw: MetamoduleFlaw) -> Flaw {
        Flaw::OfFamily { reason: flaw.to_string(), fix: flaw.fix() }
    }
}

fn blueprint_fix(error: &BlueprintError) -> &'static str {
    match error {
        BlueprintError::Empty => "name at least one seed",
        BlueprintError::TooMany(_) => "make the goal smaller",
        BlueprintError::Overlap { .. } => "move one of the two, or choose other `directions`",
        BlueprintError::Impossible(_) => "let the cells go up from the floor, and never back",
    }
}
