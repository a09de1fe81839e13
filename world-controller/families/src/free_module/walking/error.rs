//! All errors in the parts of a scenario that only walking structures have, with their fixes.

use metamorph_free_modules::plan::PlanError;
use metamorph_protocol::free_module::named;
use metamorph_protocol::free_module::network::NetworkKind;
use metamorph_scenario::error::ScenarioError;
use metamorph_sim_bridge::free_module::physics::{NotADirection, PhysicsError};
use std::ops::RangeInclusive;
use thiserror::Error;

/// An error in a section of walking structures.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum WalkError {
    /// The start, or a gait file, is wrong.
    #[error("{reason}")]
    File {
        /// Description of the error.
        reason: String,
        /// Suggested fix.
        fix: String,
    },
    /// The start is neither a name nor a file.
    #[error("`{0}` is not the name of a structure that walks")]
    Unknown(String),
    /// Bodies cannot be made.
    #[error("{0}")]
    Bodies(PhysicsError),
    /// A direction that is none.
    #[error(transparent)]
    Down(#[from] NotADirection),
    /// A speed that is none.
    #[error("`{0}` is not a speed of at least 0")]
    Speed(String),
    /// A number without its unit, or out of its range.
    #[error("{what} is `{got}`, which is not a number of {unit} between {} and {}", .range.start(), .range.end())]
    Quantity {
        /// The key.
        what: &'static str,
        /// The value as written.
        got: String,
        /// The unit.
        unit: &'static str,
        /// The valid range.
        range: RangeInclusive<f64>,
    },
    /// A turn that is none, or one without a speed of which it is a share.
    #[error("a walk with a turn needs a turn other than 0 and a speed above 0")]
    NoTurn,
    /// A friction that is none.
    #[error("friction is {0}, which is not between 0 and 10")]
    Friction(f64),
    /// A gait of another network.
    #[error("the gait is of the network {theirs}, not {ours}")]
    Network {
        /// Of the scenario.
        ours: NetworkKind,
        /// Of the gait file.
        theirs: String,
    },
    /// Two gaits for the same failure.
    #[error("there is another gait for the same dead modules {0:?}")]
    Twice(Vec<u32>),
    /// No gait of the whole structure.
    #[error("none of the gaits is of the structure without dead modules")]
    NotWhole,
    /// More than one goal.
    #[error("a walking structure has one goal, and this is another one")]
    SecondGoal,
}

impl WalkError {
    /// Creates the error of a file.
    pub fn file(error: &PlanError) -> WalkError {
        let (reason, fix) = error.reason_and_fix();
        WalkError::File { reason, fix }
    }
    /// Returns what to do about it.
    pub fn fix(&self) -> String {
        match self {
            WalkError::File { fix, .. } => fix.clone(),
            WalkError::Unknown(_) => format!("write a structure file, or one of {}", named::NAMES.join(", ")),
            WalkError::Bodies(PhysicsError::NoEngine) => {
                "use a program that is built with its default features".into()
            }
            WalkError::Bodies(_) => {
                "name a structure whose modules do not overlap and whose rings close".into()
            }
            WalkError::Down(_) => "-y is right for the named structures".into(),
            WalkError::Speed(_) => "write a speed such as \"15mm/s\"".into(),
            WalkError::Quantity { unit, .. } => format!("write a number with its unit, such as \"10{unit}\""),
            WalkError::NoTurn => "leave the turn out, or write another one".into(),
            WalkError::Friction(_) => "write a number such as 0.8".into(),
            WalkError::Network { ours, .. } => {
                format!("write the gait's network, or learn a gait with `--network {ours}`")
            }
            WalkError::Twice(_) => "leave one of them out".into(),
            WalkError::NotWhole => "learn one with `metamorph learn STRUCTURE --write FILE`".into(),
            WalkError::SecondGoal => "leave it out".into(),
        }
    }
}

impl From<WalkError> for ScenarioError {
    fn from(error: WalkError) -> ScenarioError {
        ScenarioError::OfFamily { reason: error.to_string(), fix: error.fix() }
    }
}
