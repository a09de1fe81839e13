//! The families of units that an agent process can be, by the names that scenarios and command lines
//! use. The one place of this crate that knows them.

use crate::args::AgentArgs;
use crate::drive::{AgentError, run};
use metamorph_protocol::cube::Cube;
use metamorph_protocol::metamodule::Metamodule;
use std::str::FromStr;
use thiserror::Error;

/// A family of units.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Default)]
pub enum Family {
    /// Sliding cubes (thesis 4.1.2).
    #[default]
    Cube,
    /// Two Roombots modules that walk over a floor of connectors (thesis 4.1.3).
    Metamodule,
}

/// A name that is no family's.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("unknown family `{0}`; an agent is a cube or a metamodule")]
pub struct UnknownFamily(String);

impl Family {
    /// All of them.
    pub const ALL: [Family; 2] = [Family::Cube, Family::Metamodule];

    /// The name.
    pub const fn name(self) -> &'static str {
        match self {
            Family::Cube => "cube",
            Family::Metamodule => "metamodule",
        }
    }

    /// Runs one agent of this family until its controller stops it or is gone.
    pub fn run(self, args: &AgentArgs) -> Result<(), AgentError> {
        match self {
            Family::Cube => run::<Cube>(args),
            Family::Metamodule => run::<Metamodule>(args),
        }
    }
}

impl FromStr for Family {
    type Err = UnknownFamily;

    fn from_str(text: &str) -> Result<Family, UnknownFamily> {
        let named = |f: &Family| f.name() == text;
        Family::ALL.into_iter().find(named).ok_or_else(|| UnknownFamily(text.to_owned()))
    }
}
