//! All errors in the parts of a scenario that only free modules have, with their fixes.

use metamorph_protocol::roombots::KinematicsError;
use metamorph_scenario::error::ScenarioError;
use thiserror::Error;

/// An error in a section of free modules.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum FreeModuleError {
    /// A start or a goal is not a structure.
    #[error("{reason}")]
    Structure {
        /// Description of the error.
        reason: String,
        /// Suggested fix.
        fix: String,
    },
    /// The goal has more or fewer modules than the start.
    #[error("the start has {start} modules and the goal {goal}")]
    Unequal {
        /// Modules of the start.
        start: usize,
        /// Modules of the goal.
        goal: usize,
    },
    /// `types` of something that is not a line by name.
    #[error("`types` are the quarter turns of the connections of a line, but the start is {0}")]
    TypesOfNoLine(String),
    /// `types` of the wrong form.
    #[error("`{got}` are not the types of {connections} connections")]
    Types {
        /// As written.
        got: String,
        /// Connections of the line.
        connections: usize,
    },
    /// The start has joint values already.
    #[error("the start has joint values already, so `{0}` does not apply to it")]
    JointsTwice(&'static str),
    /// Joint values for another number of modules.
    #[error("`joints_deg` lists {listed} modules, and the start has {modules}")]
    JointsCount {
        /// Modules listed.
        listed: usize,
        /// Modules of the start.
        modules: usize,
    },
    /// Joint values off the lattice.
    #[error("module {module}: {error}")]
    OffLattice {
        /// The module.
        module: usize,
        /// Description of the error.
        error: String,
    },
    /// A key or a value that belongs to the other model of bodies.
    #[error("`{what}` is for body {theirs}, and the body is {ours}")]
    OtherBody {
        /// The key or the value.
        what: &'static str,
        /// The body that it is for.
        theirs: &'static str,
        /// The body of the scenario.
        ours: &'static str,
    },
    /// More than one goal.
    #[error("free modules have one goal, and this is another one")]
    SecondGoal,
}

impl FreeModuleError {
    /// Creates the error of joint values that are off the lattice.
    pub fn off_lattice(module: usize, error: &KinematicsError) -> FreeModuleError {
        FreeModuleError::OffLattice { module, error: error.to_string() }
    }
    /// Returns what to do about it.
    pub fn fix(&self) -> String {
        match self {
            FreeModuleError::Structure { fix, .. } => fix.clone(),
            FreeModuleError::Unequal { start, .. } => format!("name a goal of {start} modules"),
            FreeModuleError::TypesOfNoLine(_) => "leave `types` out, or write `joints_deg`".into(),
            FreeModuleError::Types { connections, .. } => {
                format!("write {connections} digits from 0 to 3, such as \"{}\"", "0".repeat(*connections))
            }
            FreeModuleError::JointsTwice(key) => format!("leave `{key}` out"),
            FreeModuleError::JointsCount { modules, .. } => {
                format!("write three angles for each of {modules} modules, such as [0, 90, 0]")
            }
            FreeModuleError::OffLattice { .. } => {
                "write 0, 120 or -120 for the outer joints, and 0, 90, -90 or 180 for the middle one".into()
            }
            FreeModuleError::OtherBody { what, theirs, .. } => {
                format!("leave `{what}` out, or write body = \"{theirs}\" in [swarm]")
            }
            FreeModuleError::SecondGoal => "run it as another scenario, from the goal of this one".into(),
        }
    }
}

impl From<FreeModuleError> for ScenarioError {
    fn from(error: FreeModuleError) -> ScenarioError {
        ScenarioError::OfFamily { reason: error.to_string(), fix: error.fix() }
    }
}
