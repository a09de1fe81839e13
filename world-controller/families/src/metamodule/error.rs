//! All errors in the parts of a scenario that only metamodules have, with their fixes.

use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::manipulation::element::ElementError;
use metamorph_protocol::metamodule::Metamodule;
use metamorph_protocol::metamodule::blueprint::BlueprintError;
use metamorph_protocol::metamodule::elements::{ElementsError, MAX_ELEMENTS};
use metamorph_protocol::metamodule::params::Floor;
use metamorph_protocol::metamodule::start::StartError;
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::time::Span;
use metamorph_scenario::error::ScenarioError;
use thiserror::Error;

/// Largest number of metamodules of one swarm.
pub const MAX_METAMODULES: usize = 1_000;
/// Largest length of a side of a floor, in connectors.
pub const MAX_FLOOR: u16 = 256;
/// Largest distance at which metamodules may be set to hear each other, in connectors.
pub const MAX_COMMUNICATION_RANGE: u64 = 64;

/// An error in a metamodule's section.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum MetamoduleError {
    /// The seeds are impossible.
    #[error(transparent)]
    Blueprint(#[from] BlueprintError),
    /// A seed outside the floor.
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
    /// A start outside the floor.
    #[error("the start at {at:?} is not on the floor, which goes from {:?} to {:?}", floor.min, floor.max)]
    StartOffFloor {
        /// The connector.
        at: (i16, i16),
        /// The floor.
        floor: Floor,
    },
    /// A metamodule has more others around it than ports.
    #[error("metamodule {metamodule} starts with {others} others within its communication range, and has {ports} ports", ports = Metamodule::PORTS)]
    Crowded {
        /// The first of them.
        metamodule: ModuleId,
        /// Number of metamodules within its communication range.
        others: usize,
    },
    /// Two metamodules start at the same place.
    #[error("metamodules {first} and {second} both start at {at:?}")]
    StartTwice {
        /// One of them.
        first: usize,
        /// The other.
        second: usize,
        /// The connector.
        at: (i16, i16),
    },
    /// The floor has no room for the start.
    #[error(transparent)]
    NoRoom(#[from] StartError),
    /// `count` differs from the length of `start`.
    #[error("`count` is {count}, but `start` lists {listed} places")]
    Count {
        /// The value of `count`.
        count: u64,
        /// The number of places listed.
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
    /// The first goal has a start time.
    #[error("the first goal has an `at`, but it is active from the start")]
    FirstGoalAt,
    /// A detector with a strategy that is never permanently at a standstill.
    #[error(
        "`{0}` has no detector: a waiting metamodule tries again after a time, so none can detect a deadlock"
    )]
    NoDetector(&'static str),
    /// A key of the force field with a strategy that has none.
    #[error("`{1}` has no force field, so `{0}` does not apply to it")]
    NoField(&'static str, &'static str),
    /// Requests to the operator under a strategy that makes none.
    #[error("`{0}` has no meaning under `{1}`, which asks the operator nothing")]
    AsksNothing(&'static str, &'static str),
    /// A fallback of a strategy that decides by itself anyway.
    #[error("`{0}` makes no plan of the whole, so it has no fallback")]
    NoFallback(&'static str),
    /// A shape that is no element.
    #[error(transparent)]
    Element(#[from] ElementError),
    /// Elements that cannot be carried.
    #[error(transparent)]
    Elements(#[from] ElementsError),
    /// Too many elements.
    #[error("there are {0} elements, at most {MAX_ELEMENTS} are possible")]
    TooManyElements(usize),
    /// A rotation of an element that does not exist.
    #[error("`{0}` is not a rotation")]
    ElementTurn(String),
    /// A cell of an element is taken.
    #[error("{name} is in cell {cell}, where a seed or another element is at the same time")]
    ElementOverlap {
        /// The element.
        name: String,
        /// The cell.
        cell: Cell,
    },
    /// A cell of an element is below the floor.
    #[error("cell {cell} of {name} is below the floor")]
    ElementBelowFloor {
        /// The element.
        name: String,
        /// The cell.
        cell: Cell,
    },
    /// An element falls at the start.
    #[error("{0} does not rest on the floor: its centre of mass is not above the cells at its bottom")]
    ElementNoRest(String),
    /// A goal that lattice motions never reach.
    #[error(
        "{0} can never be brought to its goal: a lattice motion keeps the colour (x + y + z) mod 2 of every cell"
    )]
    ElementColour(String),
    /// No seed holds the element at its goal.
    #[error(
        "no metamodule in a seed holds {0} at its goal: no head faces one of its ports, and it does not lie on the floor"
    )]
    ElementNoHead(String),
    /// A fault hits an element that the swarm does not have.
    #[error("there is no element {element}; the swarm has {elements}, counted from 0")]
    NoSuchElement {
        /// Its number.
        element: u16,
        /// How many there are.
        elements: usize,
    },
    /// Metamodules that carry might not hear each other.
    #[error("two metamodules may meet with {name} before they hear each other")]
    ElementRange {
        /// The element.
        name: String,
        /// The communication range that is needed.
        needed: u16,
    },
    /// Elements with a strategy that does not carry.
    #[error("metamodules do not carry elements under `{0}`")]
    ElementStrategy(&'static str),
    /// As many places as goals are needed.
    #[error("the element has {places} places for {goals} goals")]
    ElementGoals {
        /// The places.
        places: usize,
        /// The goals.
        goals: usize,
    },
    /// Goals not sorted by time.
    #[error("this goal replaces the previous one at {at}, but that one starts at {before}")]
    GoalOrder {
        /// The time of this goal.
        at: Span,
        /// The time of the previous goal.
        before: Span,
    },
}

impl MetamoduleError {
    /// Returns what to do about it.
    pub fn fix(&self) -> String {
        match self {
            MetamoduleError::Blueprint(error) => blueprint_fix(error).into(),
            MetamoduleError::SeedOffFloor { .. } => "move the goal, or make `floor` in [swarm] larger".into(),
            MetamoduleError::SeedShape { .. } => {
                "choose other `directions` or another `kind`; `metamorph robot shapes` lists the possible shapes"
                    .into()
            }
            MetamoduleError::StartOffFloor { floor: Floor { min, max }, .. } => {
                format!("name a connector from {min:?} to {max:?}, or make `floor` larger")
            }
            MetamoduleError::Crowded { .. } => {
                "set a smaller `communication_range` in [swarm], or let them start farther apart".into()
            }
            MetamoduleError::StartTwice { .. } => "give each a connector of its own".into(),
            MetamoduleError::NoRoom(_) => {
                "make `floor` in [swarm] larger, or list the places in `start`".into()
            }
            MetamoduleError::Count { .. } => "leave `count` out; the list says how many there are".into(),
            MetamoduleError::TooFewMetamodules { seeds, .. } => {
                format!("write at least {seeds} in [swarm]")
            }
            MetamoduleError::FirstGoalAt => {
                "leave `at` out, or move this goal behind the one it replaces".into()
            }
            MetamoduleError::NoDetector(_) => {
                "leave `detector` out, or choose `greedy`, `slope` or `step`".into()
            }
            MetamoduleError::NoFallback(_) => "leave `fallback` out, or choose `planned`".into(),
            MetamoduleError::AsksNothing(key, _) => format!("leave `{key}` out, or choose `negotiated`"),
            MetamoduleError::NoField(key, _) => {
                format!("leave `{key}` out, or choose `greedy`, `slope` or `step`")
            }
            MetamoduleError::Element(_) => "write one of the names, or a list of cells".into(),
            MetamoduleError::Elements(_) | MetamoduleError::TooManyElements(_) => "leave some out".into(),
            MetamoduleError::ElementTurn(_) => {
                "write where z and x point, at right angles, such as \"z-up x-east\"".into()
            }
            MetamoduleError::ElementOverlap { .. } => "move one of the two".into(),
            MetamoduleError::ElementBelowFloor { .. } => "move it up, or choose another `turn`".into(),
            MetamoduleError::ElementNoRest(_) => "put it on the floor, its bottom in layer 0".into(),
            MetamoduleError::ElementColour(_) => "move its goal, or its start, by one cell".into(),
            MetamoduleError::ElementNoHead(_) => {
                "put its goal next to the head of a seed or on the floor, or add a seed".into()
            }
            MetamoduleError::NoSuchElement { elements: 0, .. } => "add a [[swarm.element]] table".into(),
            MetamoduleError::NoSuchElement { elements, .. } => {
                format!("name an element from 0 to {}", elements - 1)
            }
            MetamoduleError::ElementRange { needed, .. } => {
                format!("set `communication_range` in [swarm] to at least {needed}")
            }
            MetamoduleError::ElementStrategy(_) => "write `strategy = \"planned\"` in [protocol]".into(),
            MetamoduleError::ElementGoals { .. } => "list one place for each goal, or one for all".into(),
            MetamoduleError::GoalOrder { .. } => "list the goals in the order of their times".into(),
        }
    }
}

impl From<MetamoduleError> for ScenarioError {
    fn from(scenario_error: MetamoduleError) -> ScenarioError {
        ScenarioError::OfFamily { reason: scenario_error.to_string(), fix: scenario_error.fix() }
    }
}

fn blueprint_fix(error: &BlueprintError) -> &'static str {
    match error {
        BlueprintError::Empty => "name at least one seed",
        BlueprintError::TooMany(_) => "make the goal smaller",
        BlueprintError::Overlap { .. } => "move one of the two, or choose other `directions`",
        BlueprintError::Impossible(_) => "choose cells that go up from the floor, and never back",
    }
}
