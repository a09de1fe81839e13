//! The command `run`.

use crate::exit_codes::EXIT_CODES;
use crate::export::write_tables;
use crate::metrics::MetricsArg;
use crate::runs::{Asked, Show, plan};
use crate::scenario_args::{PlanArgs, real_time};
use clap::Args;
use metamorph_console::command::{CommandOf, Group};
use metamorph_console::interrupt::Interrupt;
use metamorph_console::output::Outputs;
use metamorph_console::output_kind::OutputKind;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::Live;
use metamorph_processes::family::{self, run_simulated};
use metamorph_processes::record::journal::{JournalError, JournalSession, exit_code};
use metamorph_processes::run::PageChannels;
use metamorph_processes::run::processes::Processes;
use metamorph_scenario::LinkKind;
use metamorph_text::command_error::{CommandError, Failure};
use metamorph_view::export::csv::Tables;
use std::path::Path;
use std::path::PathBuf;
use std::time::Duration;
use thiserror::Error;

/// Examples for the help.
const EXAMPLES: &str = "\
Examples:
  metamorph run swarm --kill 3@2s --pause 7@1s..3s
  metamorph run slab-to-sphere --link sim --seed 7 --loss 5%
  metamorph run swarm --link sim --quiet --json - | jq .messages.by_class
  metamorph run swarm --hosts 3

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
    /// Record the run, and write modules.csv (a line for each module), time.csv (a line for each time bin) and latency.csv (a
    /// histogram of each class of messages) into this directory; the journal is run.journal there, unless --journal names
    /// another
    #[arg(long, value_name = "DIR")]
    pub csv: Option<PathBuf>,
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
    /// The port of the page's address, for example one that is forwarded; default: any free one
    #[arg(long, value_name = "N", requires = "view", value_parser = clap::value_parser!(u16).range(1..))]
    pub port: Option<u16>,
    /// Let the page command the run (kill, pause, stick a module and so on); a second address, with the secret for
    /// that, is printed. A simulated run then takes the time that processes would
    #[arg(long, requires = "view")]
    pub control: bool,
    /// Metrics of the run.
    #[command(flatten)]
    pub metrics: MetricsArg,
    /// Print errors only, and JSON if requested
    #[arg(short, long)]
    pub quiet: bool,
}

/// The journal cannot be created.
#[derive(Debug, Error)]
#[error("--journal: {0}")]
struct NoJournal(JournalError);

impl CommandError for NoJournal {
    fn exit_code(&self) -> u8 {
        exit_code(&self.0)
    }
}

/// Runs a scenario.
fn run(args: RunArgs, since: Stopwatch, interrupt: &Interrupt) -> Result<u8, Failure> {
    let hosts = args.plan.hosts.as_ref().and_then(|hosts| hosts.file.clone());
    let (path, overrides) = args.plan.into();
    let plan = plan(&path, &overrides)?;
    let mut outputs = Outputs::new();
    outputs.reads("the scenario", Path::new(&plan.origin));
    plan.files.iter().for_each(|file| outputs.reads("a file that the scenario names,", file));
    let tables = args.csv.as_deref().map(|directory| Tables::new(directory, &mut outputs)).transpose()?;
    let option = if args.journal.is_some() { "--journal" } else { "--csv" };
    let journal = args.journal.or_else(|| Some(args.csv?.join("run.journal")));
    if let Some(file) = &journal {
        // The journal is written during the run; only its permission is checked here.
        outputs.writes(option, file, OutputKind::Journal)?;
    }
    let asked = Asked {
        json: args.json,
        html: args.html,
        journal: journal.clone(),
        view: args.view.then_some(args.port),
        control: args.control,
        quiet: args.quiet,
    };
    let metrics = args.metrics.serve(args.quiet)?;
    let show = Show::begin(&plan, asked, &mut outputs, interrupt)?;
    let mut live = Live::new(!args.quiet);
    let begin = match overrides.link {
        LinkKind::Sim => JournalSession::simulated,
        LinkKind::Ipc => JournalSession::of_processes,
    };
    let keeping = journal.as_deref().map(|file| begin(file, &plan)).transpose();
    let keeping = keeping.map_err(NoJournal)?;
    let page = PageChannels { metrics, ..show.channels(&plan) };
    let report = match overrides.link {
        LinkKind::Sim => run_simulated(&plan, &show.interrupt, &mut live, since, keeping, page),
        LinkKind::Ipc => {
            let (patience, live) = (args.patience, &mut live);
            let processes = Processes { live, since, keeping, patience, hosts, page };
            family::of(&plan).run_processes(&plan, processes)?
        }
    };
    drop(live);
    let written = match (&tables, &journal) {
        (Some(tables), Some(journal)) if report.incomplete_journal.is_none() => write_tables(journal, tables),
        _ => Ok(()),
    };
    let code = show.end(&plan, &report, journal.as_deref())?;
    written.map(|()| code)
}

/// The command.
pub static COMMAND: CommandOf<RunArgs> = CommandOf {
    name: "run",
    group: Some(Group::Run),
    about: "Run a scenario and report what happened",
    after_help: || format!("{EXAMPLES}\n\n{EXIT_CODES}"),
    execute: |args, call| run(args, call.since, call.interrupt),
};
