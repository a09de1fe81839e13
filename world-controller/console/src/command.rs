//! Commands of the program, one definition each: arguments, help, completions, man pages and the reference follow from it.
//! Absent: the list of all commands, which is in the crate of the command line, and what other programs add to it.

use crate::interrupt::Interrupt;
use crate::stopwatch::Stopwatch;
use clap::{ArgMatches, Args};
use metamorph_text::command_error::Failure;

/// The part of the help that lists a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Group {
    /// Runs of a swarm.
    Run,
    /// Pictures, pages and files of runs and structures.
    Look,
    /// Many runs, plans, and experiments.
    Study,
    /// This machine and this program.
    Machine,
}

impl Group {
    /// All groups, in the order of the help.
    pub const ALL: [Group; 4] = [Group::Run, Group::Look, Group::Study, Group::Machine];

    /// Returns the heading of the group in the help.
    pub const fn heading(self) -> &'static str {
        match self {
            Group::Run => "Run a swarm",
            Group::Look => "Look at runs and structures",
            Group::Study => "Study",
            Group::Machine => "This machine and this program",
        }
    }
}

/// Context in which a command is executed, besides its arguments.
#[derive(Clone, Copy)]
pub struct Call<'a> {
    /// Started with the program.
    pub since: Stopwatch,
    /// Set by Ctrl-C and the signals that end a program.
    pub interrupt: &'a Interrupt,
}

/// A command of the program.
///
/// [`CommandOf`] implements it for arguments that clap derives.
pub trait Command: Sync {
    /// Returns the name that is typed.
    fn name(&self) -> &'static str;
    /// Returns the group that lists it in the help; `None` if it is not listed.
    fn group(&self) -> Option<Group>;
    /// Returns one sentence about it, without its period.
    fn about(&self) -> &'static str;
    /// Returns the definition of its arguments and its help.
    fn define(&self) -> clap::Command;
    /// Executes it with parsed arguments, and returns the exit code.
    ///
    /// # Errors
    /// The text and the exit code of a failure. The arguments do not fit if they are not those of [`define`](Self::define).
    fn execute(&self, matches: &ArgMatches, call: Call<'_>) -> Result<u8, Failure>;
}

/// A command with arguments `A`.
pub struct CommandOf<A> {
    /// The name that is typed.
    pub name: &'static str,
    /// The group that lists it in the help; `None` if it is not listed.
    pub group: Option<Group>,
    /// One sentence without its period.
    pub about: &'static str,
    /// The end of its help: examples and exit codes; empty if there are none.
    pub after_help: fn() -> String,
    /// Executes it, and returns the exit code.
    pub execute: fn(A, Call<'_>) -> Result<u8, Failure>,
}

/// Returns a text for the end of a help with each paragraph on one line, for the terminal to wrap. Lines that begin with a blank, such
/// as examples and lists, stay, and so does a heading.
pub fn unwrapped(text: &str) -> String {
    let mut all = String::new();
    for line in text.lines() {
        let last = all.lines().last().unwrap_or_default();
        let is_prose = |line: &str| !line.is_empty() && !line.starts_with(' ');
        if is_prose(line) && is_prose(last) && !last.ends_with(':') {
            all.pop();
            all.push(' ');
        }
        all.push_str(line);
        all.push('\n');
    }
    all.trim_end().to_owned()
}

impl<A: Args> Command for CommandOf<A> {
    fn name(&self) -> &'static str {
        self.name
    }
    fn group(&self) -> Option<Group> {
        self.group
    }
    fn about(&self) -> &'static str {
        self.about
    }
    fn define(&self) -> clap::Command {
        let command = A::augment_args(clap::Command::new(self.name)).about(self.about).long_about(None);
        let command = command.hide(self.group.is_none());
        match (self.after_help)() {
            help if help.is_empty() => command,
            help => command.after_help(unwrapped(&help)),
        }
    }
    fn execute(&self, matches: &ArgMatches, call: Call<'_>) -> Result<u8, Failure> {
        let arguments = A::from_arg_matches(matches).map_err(|error| Failure {
            text: error.to_string(),
            exit_code: metamorph_text::command_error::BAD_USAGE,
        })?;
        (self.execute)(arguments, call)
    }
}
