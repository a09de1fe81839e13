//! Errors of making, reading or checking a plan: place, reason and fix.

use metamorph_protocol::assembly::named::NameError;
use metamorph_protocol::assembly::structure::StructureError;
use metamorph_protocol::free_module::geometry::GeometryError;
use metamorph_protocol::free_module::structure as connected;
use metamorph_text::command_error::{BAD_USAGE, CommandError};
use std::io;
use thiserror::Error;

/// Fix for the name of a shape that cannot be parsed.
const SHAPES: &str =
    "name a file, or line:N, loop:WxH, ell:N, zigzag:N, quadruped:4, quadruped:6 or tree:NxSEED";

/// Why there is no answer.
#[derive(Debug, Error)]
pub enum PlanError {
    /// An option is missing or wrong.
    #[error("{place}: {reason}\n  fix: {fix}")]
    Option {
        /// The option.
        place: String,
        /// Description of the error.
        reason: String,
        /// Suggested fix.
        fix: String,
    },
    /// A name does not name a shape.
    #[error("{place}: {error}\n  fix: {fix}", fix = name_fix(.error))]
    Name {
        /// The option.
        place: String,
        /// Cause of the error.
        error: NameError,
    },
    /// A file cannot be read.
    #[error("{place}: cannot be read: {error}\n  fix: {fix}", fix = read_fix(.schema))]
    Read {
        /// The option and the file.
        place: String,
        /// Cause of the error.
        error: io::Error,
        /// The name of the schema of such files.
        schema: &'static str,
    },
    /// A file is not a document of this format.
    #[error("{place}: {reason}\n  fix: `metamorph schema {schema}` describes the format")]
    Format {
        /// The option, the file and the place in it.
        place: String,
        /// Description of the error.
        reason: String,
        /// The name of the schema.
        schema: &'static str,
    },
    /// A file does not describe a valid structure.
    #[error("{place}: {error}\n  fix: {fix}", fix = structure_fix(.error))]
    Structure {
        /// The option and the file.
        place: String,
        /// Cause of the error.
        error: StructureError,
    },
    /// A file by connectors does not describe a structure.
    #[error("{place}: {error}\n  fix: {fix}", fix = connection_fix(.error))]
    Connections {
        /// The option and the file.
        place: String,
        /// Cause of the error.
        error: connected::StructureError,
    },
    /// A structure by connectors cannot have its joint values.
    #[error("{place}: {error}\n  fix: {fix}", fix = geometry_fix(.error))]
    Geometry {
        /// The option and the file.
        place: String,
        /// Cause of the error.
        error: GeometryError,
    },
    /// A plan fails its check: an action is impossible, or its effect or the cost is not what the file
    /// states.
    #[error("{place}: {reason}\n  fix: {fix}")]
    Check {
        /// The file and the action.
        place: String,
        /// Description of the error.
        reason: String,
        /// Suggested fix.
        fix: String,
    },
}

impl PlanError {
    /// Describes a wrong option.
    pub fn option(place: &str, reason: impl Into<String>, fix: impl Into<String>) -> PlanError {
        PlanError::Option { place: place.to_owned(), reason: reason.into(), fix: fix.into() }
    }
}

impl PlanError {
    /// Returns the reason, with its place, and what to do.
    pub fn reason_and_fix(&self) -> (String, String) {
        let text = self.to_string();
        let (reason, fix) = text.split_once("\n  fix: ").unwrap_or((&text, "check the file"));
        (reason.to_owned(), fix.to_owned())
    }
}

impl CommandError for PlanError {
    fn exit_code(&self) -> u8 {
        BAD_USAGE
    }
    fn text(&self) -> String {
        format!("metamorph: {self}")
    }
}

fn read_fix(schema: &str) -> &'static str {
    match schema {
        "structure" => SHAPES,
        "plan" => "name a file that `metamorph plan -o FILE` has written",
        _ => "name a regular file that this user may read",
    }
}

fn name_fix(error: &NameError) -> &'static str {
    match error {
        NameError::Unknown(_) | NameError::Size { .. } => SHAPES,
        NameError::TooMany(_) => {
            "plan parts of at most 16 modules, or let metamodules build it: `metamorph run` with a metamodule scenario"
        }
    }
}

fn structure_fix(error: &StructureError) -> &'static str {
    match error {
        StructureError::Empty => "list at least one module",
        StructureError::TooMany(_) => name_fix(&NameError::TooMany(0)),
        StructureError::NotAdjacent { .. } => "a module fills two cells that differ by 1 in one coordinate",
        StructureError::Overlap { .. } => "give every cell to one module",
        StructureError::NoModule { .. } => "name cells that modules fill",
        StructureError::NotTouching { .. } => "join cells that differ by 1 in one coordinate",
        StructureError::SameModule { .. } => "join cells of different modules",
        StructureError::Disconnected { .. } => "join it with the others, or move it to them",
        StructureError::NotARotation { .. } => {
            "write three rows with one 1 or -1 each, of determinant 1, such as [[1,0,0],[0,1,0],[0,0,1]]"
        }
        StructureError::OtherCell { .. } => "correct the cells, the rotation or the joint values",
    }
}

fn connection_fix(error: &connected::StructureError) -> &'static str {
    use connected::StructureError as E;
    match error {
        E::Empty => "write how many modules there are, at least 1",
        E::TooMany(_) => "divide it into structures of at most 256 modules",
        E::NoModule { .. } => "modules are numbered from 0; correct the number, or `modules`",
        E::ToItself { .. } => "join two different modules",
        E::UsedTwice { .. } => "give every connector one connection",
        E::Rotation { .. } => "write 0, 1, 2 or 3 quarter turns",
        E::Disconnected { .. } => "join it with the others, or leave it out",
    }
}

fn geometry_fix(error: &GeometryError) -> &'static str {
    match error {
        GeometryError::Count { .. } => "write three angles in degrees for every module",
        GeometryError::Angle { .. } => "write an angle in degrees",
        GeometryError::OpenRing { .. } => {
            "write joints_deg with which the ring closes, or correct a connector or a rotation in it"
        }
        GeometryError::Overlap { .. } => "correct joints_deg, a connector or a rotation",
    }
}
