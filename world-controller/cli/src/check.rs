//! The command `check`.

use crate::host;
use crate::runs;
use crate::scenario_args::PlanArgs;
use clap::Args;
use metamorph_console::command::{CommandOf, Group};
use metamorph_console::terminal::print_out;
use metamorph_scenario::plan_summary::overview;
use metamorph_text::command_error::Failure;

/// Examples for the help.
const EXAMPLES: &str = "\
Examples:
  metamorph check swarm
  metamorph check swarm --link sim --kill 3@2s
  metamorph check swarm --hosts 3

The same options as for `run` are checked together with the scenario. Nothing is run.

Exit codes:
  0  the scenario can be run
  2  the command line or the scenario is wrong; every error names its place, reason and fix";

/// Arguments of `check`.
#[derive(Debug, Args)]
pub struct CheckArgs {
    /// The scenario and its overrides.
    #[command(flatten)]
    pub plan: PlanArgs,
}

fn check(args: CheckArgs) -> Result<u8, Failure> {
    let hosts = args.plan.hosts.as_ref().and_then(|hosts| hosts.file.clone());
    let (path, overrides) = args.plan.into();
    let plan = runs::plan(&path, &overrides)?;
    print_out(&overview(&plan));
    hosts.map_or(Ok(0), |file| host::check(&file, &plan))
}

/// The command.
pub static COMMAND: CommandOf<CheckArgs> = CommandOf {
    name: "check",
    group: Some(Group::Run),
    about: "Check a scenario and show what would run",
    after_help: || EXAMPLES.to_owned(),
    execute: |args, _| check(args),
};
