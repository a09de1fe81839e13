//! The families that an agent process can belong to, by the names in scenarios and command lines. The only
//! place of this crate that knows them.

use crate::process::args::{AgentArgs, ArgsError};
use crate::process::start::{AgentError, run};
use metamorph_protocol::cube::Cube;
use metamorph_protocol::free_module::gait::FreeModule;
use metamorph_protocol::free_module::reconfiguration::LatticeModule;
use metamorph_protocol::metamodule::Metamodule;
use std::ffi::OsString;
use std::str::FromStr;

/// A family of modules.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Default)]
pub enum Family {
    /// Sliding cubes (thesis 4.1.2).
    #[default]
    Cube,
    /// Two Roombots modules that walk over a floor of connectors (thesis 4.1.3).
    Metamodule,
    /// Single Roombots modules that rebuild their structure.
    FreeModule,
    /// Single Roombots modules that walk as one structure.
    WalkingModule,
}

impl Family {
    /// All families.
    pub const ALL: [Family; 4] =
        [Family::Cube, Family::Metamodule, Family::FreeModule, Family::WalkingModule];

    /// Returns the name.
    pub const fn name(self) -> &'static str {
        match self {
            Family::Cube => "cube",
            Family::Metamodule => "metamodule",
            Family::FreeModule => "free-module",
            Family::WalkingModule => "walking-module",
        }
    }

    /// Runs one agent of this family until its controller stops it or is gone.
    ///
    /// # Errors
    /// If the agent cannot start or continue, for example because its controller is gone.
    pub fn run(self, args: &AgentArgs) -> Result<(), AgentError> {
        match self {
            Family::Cube => run::<Cube>(args),
            Family::Metamodule => run::<Metamodule>(args),
            Family::FreeModule => run::<LatticeModule>(args),
            Family::WalkingModule => run::<FreeModule>(args),
        }
    }
}

impl FromStr for Family {
    type Err = ArgsError;

    fn from_str(text: &str) -> Result<Family, ArgsError> {
        let named = |f: &Family| f.name() == text;
        Family::ALL.into_iter().find(named).ok_or_else(|| ArgsError::Family(text.to_owned()))
    }
}

/// Reads the command line of an agent process, whose first word names its family.
///
/// # Errors
/// If the family is unknown, or an argument is unknown, missing or out of range.
pub fn parse(line: impl IntoIterator<Item = OsString>) -> Result<(Family, AgentArgs), ArgsError> {
    let mut line = line.into_iter();
    let family = line.next().ok_or(ArgsError::Missing("the family"))?;
    Ok((family.to_string_lossy().parse()?, AgentArgs::parse(line)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::ids::{Incarnation, ModuleId};

    #[test]
    fn the_family_comes_first() {
        let args =
            AgentArgs { root: "/x".into(), id: ModuleId(0), incarnation: Incarnation(1), verbose: false };
        for family in Family::ALL {
            let line = [vec![family.name().into()], args.to_command_line()].concat();
            assert_eq!(parse(line), Ok((family, args.clone())));
        }
        let line = [vec!["cubes".into()], args.to_command_line()].concat();
        assert!(matches!(parse(line), Err(ArgsError::Family(_))));
        assert_eq!(parse([]), Err(ArgsError::Missing("the family")));
    }
}
