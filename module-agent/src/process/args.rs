//! The command line of an agent process. All other configuration is in the swarm file. Not here: environment
//! variables, which would be a hidden interface.

use metamorph_protocol::ids::{Incarnation, ModuleId};
use std::ffi::OsString;
use std::path::PathBuf;
use thiserror::Error;

/// The run and the agent that a process belongs to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AgentArgs {
    /// The run's directory.
    pub root: PathBuf,
    /// The module.
    pub id: ModuleId,
    /// Its incarnation.
    pub incarnation: Incarnation,
    /// True if it logs at the level of debugging.
    pub verbose: bool,
}

/// Errors of the arguments of an agent process.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ArgsError {
    /// An unknown argument.
    #[error("unknown argument `{0}`; an agent takes --root DIR --id N --incarnation N [--verbose]")]
    Unknown(String),
    /// An argument without its value.
    #[error("`{0}` needs a value")]
    NoValue(&'static str),
    /// A value that is not a number in range.
    #[error("`{0}` needs a number in range, not `{1}`")]
    Number(&'static str, String),
    /// A required argument is missing.
    #[error("`{0}` is missing; agents are started by the world-controller")]
    Missing(&'static str),
    /// An unknown family.
    #[error("unknown family `{0}`; this program has no agents of that name")]
    Family(String),
}

impl AgentArgs {
    /// Returns the arguments as a command line, the inverse of [`AgentArgs::parse`].
    pub fn to_command_line(&self) -> Vec<OsString> {
        let mut line: Vec<OsString> = vec!["--root".into(), self.root.clone().into()];
        line.extend(["--id".into(), self.id.to_string().into()]);
        line.extend(["--incarnation".into(), self.incarnation.to_string().into()]);
        if self.verbose {
            line.push("--verbose".into());
        }
        line
    }

    /// Parses a command line without the program's name.
    ///
    /// # Errors
    /// If an argument is unknown, missing, without its value or out of range.
    pub fn parse(line: impl IntoIterator<Item = OsString>) -> Result<AgentArgs, ArgsError> {
        let (mut root, mut id, mut incarnation, mut verbose) = (None, None, None, false);
        let mut line = line.into_iter();
        while let Some(name) = line.next() {
            match name.to_str() {
                Some("--root") => root = Some(line.next().ok_or(ArgsError::NoValue("--root"))?.into()),
                Some("--id") => id = Some(ModuleId(number("--id", line.next())?)),
                Some("--incarnation") => {
                    incarnation = Some(Incarnation(number("--incarnation", line.next())?));
                }
                Some("--verbose") => verbose = true,
                _ => return Err(ArgsError::Unknown(name.to_string_lossy().into_owned())),
            }
        }
        Ok(AgentArgs {
            root: root.ok_or(ArgsError::Missing("--root"))?,
            id: id.ok_or(ArgsError::Missing("--id"))?,
            incarnation: incarnation.ok_or(ArgsError::Missing("--incarnation"))?,
            verbose,
        })
    }
}

fn number<N: std::str::FromStr>(name: &'static str, value: Option<OsString>) -> Result<N, ArgsError> {
    let value = value.ok_or(ArgsError::NoValue(name))?;
    let text = value.to_string_lossy();
    text.parse().map_err(|_| ArgsError::Number(name, text.clone().into_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_what_it_writes() {
        for verbose in [false, true] {
            let args = AgentArgs {
                root: "/dev/shm/mm0000000000".into(),
                id: ModuleId(7),
                incarnation: Incarnation(2),
                verbose,
            };
            assert_eq!(AgentArgs::parse(args.to_command_line()), Ok(args));
        }
    }

    #[test]
    fn says_what_is_wrong() {
        let parse = |text: &str| AgentArgs::parse(text.split(' ').map(OsString::from));
        assert_eq!(parse("--colour"), Err(ArgsError::Unknown("--colour".into())));
        assert_eq!(parse("--root"), Err(ArgsError::NoValue("--root")));
        assert_eq!(parse("--id -1"), Err(ArgsError::Number("--id", "-1".into())));
        assert_eq!(parse("--incarnation 70000"), Err(ArgsError::Number("--incarnation", "70000".into())));
        assert_eq!(parse("--root /x --id 1"), Err(ArgsError::Missing("--incarnation")));
    }
}
