//! The command `why`.

use crate::runs;
use crate::scenario_args::{SimulatedArgs, jobs, real_time};
use clap::Args;
use metamorph_console::command::{CommandOf, Group};
use metamorph_experiments::why::{WhyRequest, why as answer};
use metamorph_processes::family::{self, families};
use metamorph_processes::record::journal::{Event, Journal, JournalFailure, plan_of};
use metamorph_scenario::shipped::is_scenario;
use metamorph_scenario::{LinkKind, Plan};
use metamorph_sim_bridge::director::rescue::Rescue;
use metamorph_text::command_error::{BAD_USAGE, CommandError, Failure};
use metamorph_text::escape::Shown;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::time::Duration;
use thiserror::Error;

/// Examples for the help.
const EXAMPLES: &str = "\
Examples:
  metamorph why box --seed 12
  metamorph why box --seed 12 --plot why.svg --json why.json
  metamorph why broken.toml --standstill 1      (one that the controller resolved)
  metamorph why run.journal                     (a journal of a simulated run)

The run is copied at 12 points along its course, and 100 copies of each continue with other delays and
losses of messages. The share of these futures that are built tells how much was open at that point;
the interval with the largest fall is halved, with more futures, as long as one half of it holds half
of the fall: down to one event, or to a stretch in which no event decides alone. Shares have intervals
of Wilson, changes those of Newcombe. Of a run in which an invariant broke, futures that break the
same one are counted.

If the start decided, it says what of it: whether other random numbers of agents and joints, or another
strategy, would have helped, and whether a search proved the goal impossible.

In futures the controller does not help, so that its help does not hide what was decided; with --rescue
LEVEL both the run and its futures have this level. Every future is the run of the scenario with the changes that are printed.

Exit codes:
  0  there is an answer, also if --budget cut it short
  1  the answer could not be written
  2  the command line or the scenario is wrong, or there is nothing to explain: the run was built
  7  stopped by Ctrl-C, SIGTERM or SIGHUP";

/// Arguments of `why`.
#[derive(Debug, Args)]
pub struct WhyArgs {
    /// The scenario, or a journal of a simulated run
    #[arg(value_name = "SCENARIO|JOURNAL")]
    pub file: PathBuf,
    /// Explain this standstill, from 1, of a run that stood still and continued; default: the end of the run
    #[arg(long, value_name = "N")]
    pub standstill: Option<usize>,
    /// End the search after this real time, with the answer so far
    #[arg(long, value_name = "T", value_parser = real_time, default_value = "60s")]
    pub budget: Duration,
    /// Number of concurrent runs; default: the number of processors
    #[arg(long, value_name = "N")]
    pub jobs: Option<NonZeroUsize>,
    /// Draw the shares along the run to this file, as SVG; default: none
    #[arg(long, value_name = "FILE.svg")]
    pub plot: Option<PathBuf>,
    /// Write the answer as JSON to a file, or to standard output with `-` (text for people then goes to
    /// standard error)
    #[arg(long, value_name = "FILE|-", allow_hyphen_values = true)]
    pub json: Option<PathBuf>,
    /// The changes of the scenario.
    #[command(flatten)]
    pub simulated: SimulatedArgs,
    /// Print errors only, and JSON if requested
    #[arg(short, long)]
    pub quiet: bool,
}

/// A journal whose run cannot be carried out again.
#[derive(Debug, Error)]
enum JournalError {
    #[error("{}: the journal of a run of processes\n  fix: explain a simulated run of its scenario: {repeat}", .file.shown())]
    OfProcesses { file: PathBuf, repeat: String },
    #[error("{}: operators gave commands in this run\n  fix: write them into the scenario (`metamorph export --commands`), and name that", .0.shown())]
    Commanded(PathBuf),
}

impl CommandError for JournalError {
    fn exit_code(&self) -> u8 {
        BAD_USAGE
    }
    fn text(&self) -> String {
        format!("metamorph: {self}")
    }
}

/// Returns the plan of a journal.
fn recorded(file: &Path) -> Result<Plan, Failure> {
    let mut journal = Journal::open(file).map_err(JournalFailure::from)?;
    let plan = plan_of(families(), journal.head())
        .map_err(|error| Failure { text: format!("metamorph: {error}"), exit_code: BAD_USAGE })?;
    if plan.overrides.link == LinkKind::Ipc {
        let repeat = plan
            .repeat_with()
            .replacen(" run ", " why ", 1)
            .replace(" --link ipc", "")
            .replace(" --link sim", "");
        return Err(JournalError::OfProcesses { file: file.to_owned(), repeat }.into());
    }
    // A change that the scenario has is made again.
    let planned: Vec<String> = plan.changes.iter().map(ToString::to_string).collect();
    let is_commanded = |event: &Event| match event {
        Event::Input { .. } => true,
        Event::Changed { change } => !planned.contains(change),
        _ => false,
    };
    for record in journal.by_ref() {
        if is_commanded(&record.map_err(JournalFailure::from)?.event) {
            return Err(JournalError::Commanded(file.to_owned()).into());
        }
    }
    Ok(plan)
}

fn why(args: WhyArgs) -> Result<u8, Failure> {
    let plan = if is_scenario(family::sources(), &args.file) {
        runs::plan(&args.file, &args.simulated.overrides())?
    } else {
        args.simulated.must_be_left_out()?;
        recorded(&args.file)?
    };
    let rescue = args.simulated.changes.rescue.is_none().then_some(Rescue::Off);
    Ok(answer(&WhyRequest {
        // A swarm that is not helped has the same futures with and without the change.
        rescue: rescue.filter(|_| plan.swarm.has_rescue() && plan.rescue != Rescue::Off),
        plan,
        standstill: args.standstill,
        budget: args.budget,
        jobs: jobs(args.jobs),
        json: args.json,
        plot: args.plot,
        quiet: args.quiet,
    })?)
}

/// The command.
pub static COMMAND: CommandOf<WhyArgs> = CommandOf {
    name: "why",
    group: Some(Group::Study),
    about: "Ask the futures of a run when its end was decided",
    after_help: || EXAMPLES.to_owned(),
    execute: |args, _| why(args),
};
