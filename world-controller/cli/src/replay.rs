//! The command `replay`.

use clap::Args;
use metamorph_console::command::{CommandOf, Group};
use metamorph_console::terminal::print_out;
use metamorph_processes::family;
use metamorph_processes::record::journal::JournalFailure;
use metamorph_processes::run::replay::{self, Request};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::time::{Span, SpanError, Time};
use metamorph_text::command_error::{DIFFERENT, Failure};
use std::path::PathBuf;

/// Examples for the help.
const EXAMPLES: &str = "\
Examples:
  metamorph run swarm --journal run.journal
  metamorph replay run.journal                        check that a replay matches the journal
  metamorph replay run.journal --until 10s            the state of every module at 10 s
  metamorph replay run.journal --agent 7 --until 5s   the history of module 7 until 5 s

Agents, world and controller receive the recorded inputs, in the order of cause and effect, and must
reach the same states, messages and counts. Of a killed run, the parts in FILE.parts are replayed.

Exit codes:
  0  the replay matches the journal
  1  the program itself failed
  2  the command line is wrong, or the file is not a journal of this version
  8  the replay differs from the journal; the first difference is named
  9  the journal is damaged; the replay matches what comes before the damage";

/// Arguments of `replay`.
#[derive(Debug, Args)]
pub struct ReplayArgs {
    /// The journal that `run --journal` wrote, or the directory of its parts
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Stop at this scenario time, and show the state of every module; default: the end
    #[arg(long, value_name = "T", value_parser = scenario_time)]
    pub until: Option<Time>,
    /// Show the history of this module; default: none
    #[arg(long, value_name = "ID")]
    pub agent: Option<u32>,
    /// Print errors only
    #[arg(short, long)]
    pub quiet: bool,
}

fn scenario_time(text: &str) -> Result<Time, String> {
    let span: Span = text.parse().map_err(|e: SpanError| e.to_string())?;
    Ok(Time::ZERO + span)
}

impl From<ReplayArgs> for Request {
    fn from(args: ReplayArgs) -> Request {
        Request { file: args.file, until: args.until, agent: args.agent.map(ModuleId) }
    }
}

fn replay(args: ReplayArgs) -> Result<u8, Failure> {
    let quiet = args.quiet;
    let (plan, replayed) = family::replay(&args.into())?;
    if !quiet {
        print_out(&replay::text(&plan, &replayed));
    }
    match replayed.damage {
        Some(damage) => Err(JournalFailure::from(damage).into()),
        None => Ok(if replayed.difference.is_some() { DIFFERENT } else { 0 }),
    }
}

/// The command.
pub static COMMAND: CommandOf<ReplayArgs> = CommandOf {
    name: "replay",
    group: Some(Group::Run),
    about: "Replay the journal of a run, and report the first difference",
    after_help: || EXAMPLES.to_owned(),
    execute: |args, _| replay(args),
};
