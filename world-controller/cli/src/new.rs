//! The command `new`: a scenario to begin with, or a protocol.

use crate::new_protocol::protocol;
use clap::Args;
use metamorph_console::command::{CommandOf, Group};
use metamorph_console::output::{OutputError, Outputs};
use metamorph_console::terminal::print_out;
use metamorph_processes::family::{self, families};
use metamorph_scenario::error::ScenarioError;
use metamorph_scenario::shipped;
use metamorph_scenario::template::template;
use metamorph_text::command_error::{BAD_USAGE, CommandError, FAILED};
use metamorph_text::escape::{Shown, portable};
use std::io;
use std::path::PathBuf;
use thiserror::Error;
use toml::{Table, Value};

/// The scenarios that new ones begin with: one of each family.
const BASES: [(&str, &str); 3] =
    [("cube", "line-to-box"), ("metamodule", "chair"), ("free-module", "line-to-loop")];

/// Arguments of `new`.
#[derive(Debug, Args)]
pub struct NewArgs {
    /// The file to write, which must not exist yet; its name is that of the scenario
    #[arg(value_name = "FILE", required_unless_present = "protocol")]
    pub file: Option<PathBuf>,
    /// Write a repository for a protocol of your own to this directory, which must not exist yet or be empty
    #[arg(long, value_name = "DIR", conflicts_with_all = ["file", "family", "like", "minimal"])]
    pub protocol: Option<PathBuf>,
    /// The family of its modules: cube, metamodule or free-module; default: that of --like, or cube
    #[arg(long, value_name = "FAMILY", conflicts_with = "like")]
    pub family: Option<String>,
    /// Begin with the values of this scenario, a name that `metamorph scenarios` lists; default: a small
    /// one of the family
    #[arg(long, value_name = "NAME")]
    pub like: Option<String>,
    /// Write only the keys that are set, without comments
    #[arg(long)]
    pub minimal: bool,
}

/// Errors of `new`.
#[derive(Debug, Error)]
pub enum NewError {
    /// No such family.
    #[error("--family {}: there is no such family\n  fix: name one of {}", .0.shown(), BASES.map(|(family, _)| family).join(", "))]
    Family(String),
    /// No such scenario.
    #[error("--like {}: no scenario of this name ships with the program\n  fix: {}", .name.shown(), meant(.suggestions))]
    Like {
        /// The name.
        name: String,
        /// Similar names.
        suggestions: Vec<String>,
    },
    /// The directory of a repository has files.
    #[error("--protocol {}: this directory is not empty; nothing was written\n  fix: name one that does not exist yet", .0.shown())]
    NotEmpty(PathBuf),
    /// A directory of a repository cannot be created.
    #[error("--protocol {}: cannot create a directory there: {error}\n  fix: name a directory that is yours", .directory.shown())]
    Directory {
        /// The directory.
        directory: PathBuf,
        /// The cause.
        error: io::Error,
    },
    /// The file cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}

fn meant(suggestions: &[String]) -> String {
    ScenarioError::NoSuchFile { suggestions: suggestions.to_vec() }.fix()
}

impl CommandError for NewError {
    fn exit_code(&self) -> u8 {
        match self {
            NewError::Output(error) if !error.is_input() => FAILED,
            _ => BAD_USAGE,
        }
    }
    fn text(&self) -> String {
        format!("metamorph: {self}")
    }
}

/// Writes a scenario, or a repository for a protocol.
///
/// # Errors
///
/// There is no such family or scenario, or what is to be written exists or cannot be written.
pub fn new(args: &NewArgs) -> Result<u8, NewError> {
    if let Some(directory) = &args.protocol {
        print_out(&protocol(directory)?);
        return Ok(0);
    }
    let path = args.file.as_deref().expect("invariant: clap asks for one of both");
    let base = match (&args.like, &args.family) {
        (Some(name), _) => name.as_str(),
        (None, None) => BASES[0].1,
        (None, Some(wanted)) => match BASES.iter().find(|(family, _)| family == wanted) {
            Some((_, base)) => *base,
            None => return Err(NewError::Family(wanted.clone())),
        },
    };
    let text = shipped::text_elsewhere(base).ok_or_else(|| {
        let suggestions = shipped::similar(base);
        NewError::Like { name: base.to_owned(), suggestions }
    })?;
    let base: Table = text.parse().expect("invariant: shipped scenarios are TOML, as a test shows");
    let own = base.get("swarm").and_then(|swarm| swarm.get("family")).and_then(Value::as_str);
    let own = own.unwrap_or(BASES[0].0);
    let family = family::named(own).expect("invariant: shipped scenarios name a family, as a test shows");
    let name = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
    let file = Outputs::new().creates("new", path)?;
    file.write(template(families(), family, &base, &name.shown(), args.minimal))?;
    print_out(&format!(
        "{}: a scenario of the family {own}\n  metamorph check {} says what would run\n",
        path.shown(),
        metamorph_scenario::quote(portable(path)),
    ));
    Ok(0)
}

/// Examples for the help.
const EXAMPLES: &str = "\
Examples:
  metamorph new mine.toml
  metamorph new chairs.toml --family metamodule
  metamorph new tower.toml --like rabbit --minimal
  metamorph new --protocol leader           a program with a protocol, as a family of modules, and tests

Keys that are not set are commented out, with their defaults or examples. An existing file is never
overwritten.

Exit codes:
  0  the scenario or the repository is written
  1  it could not be written completely
  2  the command line is wrong, or the file exists";

/// The command.
pub static COMMAND: CommandOf<NewArgs> = CommandOf {
    name: "new",
    group: Some(Group::Run),
    about: "Write a scenario to begin with: every key with its default and meaning",
    after_help: || EXAMPLES.to_owned(),
    execute: |args, _| Ok(new(&args)?),
};

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_processes::family::read_text;
    use metamorph_scenario::schema::schema;
    use metamorph_scenario::{LinkKind, Overrides};
    use serde_json::Value as Json;

    fn made(base: &str, minimal: bool) -> String {
        let base: Table = shipped::text_elsewhere(base).unwrap().parse().unwrap();
        let own = base["swarm"].get("family").and_then(Value::as_str).unwrap_or("cube");
        template(families(), family::named(own).unwrap(), &base, "mine", minimal)
    }

    fn check(text: &str) -> Result<usize, String> {
        let overrides = Overrides { link: LinkKind::Sim, ..Overrides::default() };
        read_text("elsewhere/mine.toml", text, &overrides)
            .map(|plan| plan.swarm.len())
            .map_err(|problems| problems.to_string())
    }

    #[test]
    fn templates_of_all_shipped_scenarios_can_be_run() {
        for name in shipped::names() {
            let whole = check(&shipped::text_elsewhere(name).unwrap()).unwrap();
            for minimal in [false, true] {
                let text = made(name, minimal);
                assert_eq!(check(&text), Ok(whole), "{name}: {text}");
                assert_eq!(text.contains('#'), !minimal, "{name}");
            }
        }
    }

    /// Every key of the sections occurs, set or commented out, unless it is the former name of another.
    #[test]
    fn templates_have_every_key() {
        let schema = schema(families());
        for (family, base) in BASES {
            let text = made(base, false);
            let lines: Vec<&str> = text.lines().map(|line| line.trim_start_matches('#')).collect();
            for part in ["Swarm", "Goal", "Protocol"]
                .map(|part| format!("{family}{part}"))
                .iter()
                .map(String::as_str)
                .chain(["link", "process", "stop"])
            {
                for (key, value) in schema["$defs"][part]["properties"].as_object().unwrap() {
                    let is_there = lines.iter().any(|line| line.starts_with(&format!("{key} = ")));
                    assert_eq!(is_there, value["deprecated"] != Json::Bool(true), "{family}: {key}");
                }
            }
        }
    }

    /// Each commented key can be set as it is, but for those that contradict what is set.
    #[test]
    fn commented_keys_can_be_set() {
        // `seed` depends on the shape, `levels` is instead of it, `at` is of further goals, `joints_deg` is instead of
        // `types`, and the others are for other strategies.
        let contradict =
            ["seed", "levels", "at", "joints_deg", "precedence", "settled_repel", "repulsion", "fallback"];
        let mut set = 0;
        for (family, base) in BASES {
            let text = made(base, false);
            let (keys, faults) = text.split_once("# Faults").unwrap();
            for line in keys.lines().filter(|line| line.starts_with('#') && !line.starts_with("# ")) {
                let key = line[1..].split(' ').next().unwrap();
                let changed = text.replacen(line, &line[1..], 1);
                match check(&changed) {
                    Ok(_) => set += 1,
                    Err(problems) => {
                        // A key of the other body of free modules names both.
                        let is_of_other_body = problems.contains("and the body is lattice");
                        assert!(
                            is_of_other_body || contradict.contains(&key),
                            "{family}: {line}\n{problems}"
                        );
                        assert!(!problems.contains("unknown"), "{family}: {line}\n{problems}");
                    }
                }
            }
            for block in faults.split("#[[fault]]\n").skip(1) {
                let fault: String = block
                    .lines()
                    .take_while(|line| !line.is_empty())
                    .filter(|line| !line.starts_with("# "))
                    .map(|line| format!("{}\n", &line[1..]))
                    .collect();
                // Faults of hosts need hosts.
                let hosts = text.replacen("#between_hosts = ", "between_hosts = ", 1);
                let text = if fault.contains("h2") { &hosts } else { &text };
                let checked = check(&format!("{text}\n[[fault]]\n{fault}"));
                if fault.contains("drop = ") {
                    // The swarms of `new` have no elements.
                    assert!(checked.is_err_and(|problems| problems.contains("there is no element 1")));
                    continue;
                }
                if fault.contains("kill_host = ") {
                    // Hosts come back only where the modules of lost ones start elsewhere.
                    assert!(checked.is_err_and(|problems| problems.contains("`until` counts only if")));
                    continue;
                }
                checked.unwrap_or_else(|problems| panic!("{fault}\n{problems}"));
                set += 1;
            }
        }
        assert!(set > 35, "{set}");
    }
}
