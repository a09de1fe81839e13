//! The command `run`.

use crate::exit_codes::EXIT_CODES;
use crate::runs::run;
use crate::scenario_args::{PlanArgs, real_time};
use clap::Args;
use metamorph_console::command::{CommandOf, Group};
use std::path::PathBuf;
use std::time::Duration;

/// Examples for the help.
const EXAMPLES: &str = "\
Examples:
  metamorph run deploy/scenarios/swarm.toml --kill 3@2s --pause 7@1s..3s
  metamorph run deploy/scenarios/slab-to-sphere.toml --link sim --seed 7 --loss 5%
  metamorph run deploy/scenarios/swarm.toml --link sim --quiet --json - | jq .messages.by_class
  metamorph run deploy/scenarios/swarm.toml --hosts 3

Times are scenario times with a unit: 200ms, 1.5s, 2min. Probabilities are written 5%, 0.05 or 1/20.
Modules are numbered from 0; `metamorph check SCENARIO` prints their number.

Ctrl-C, SIGTERM or SIGHUP ends a run with a partial report; a second one does not wait for agents.";

/// Arguments of `run`.
#[derive(Debug, Args)]
pub struct RunArgs {
    /// The scenario and its overrides.
    #[command(flatten)]
    pub plan: PlanArgs,
    /// Write the report as JSON to a file, or to standard output with `-` (text for people then goes
    /// to standard error)
    #[arg(long, value_name = "FILE|-", allow_hyphen_values = true)]
    pub json: Option<PathBuf>,
    /// Record everything that happens in a file, for `metamorph replay` and for viewers; it is written
    /// during the run
    #[arg(long, value_name = "FILE")]
    pub journal: Option<PathBuf>,
    /// On `ipc` with --journal: how long, in real time, modules wait for `metamorph resume FILE` after the
    /// controller was killed; with --hosts only if all hosts are on this machine
    #[arg(long, value_name = "T", value_parser = real_time, default_value = "30s", requires = "journal")]
    pub patience: Duration,
    /// Write a report with plots to this file, as one self-contained HTML page
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
    /// Show the run in the browser during the run and afterwards, until Ctrl-C; the address is
    /// printed. Messages between processes are shown afterwards, and with --journal only
    #[arg(long)]
    pub view: bool,
    /// Let the page command the run (kill, pause, stick a module and so on); a second address, with the secret for
    /// that, is printed. A simulated run then takes the time that processes would
    #[arg(long, requires = "view")]
    pub control: bool,
    /// Print errors only, and JSON if requested
    #[arg(short, long)]
    pub quiet: bool,
}

/// The command.
pub static COMMAND: CommandOf<RunArgs> = CommandOf {
    name: "run",
    group: Some(Group::Run),
    about: "Run a scenario and report what happened",
    after_help: || format!("{EXAMPLES}\n\n{EXIT_CODES}"),
    execute: |args, call| run(args, call.since, call.interrupt),
};
