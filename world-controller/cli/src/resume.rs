//! The command `resume`.

use crate::exit_codes::{DAMAGED_EXIT_CODE, EXIT_CODES};
use crate::metrics::MetricsArg;
use crate::runs::{Asked, Show};
use crate::scenario_args::hosts_file;
use clap::Args;
use metamorph_console::command::{CommandOf, Group};
use metamorph_console::interrupt::Interrupt;
use metamorph_console::output::Outputs;
use metamorph_console::output_kind::OutputKind;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::Live;
use metamorph_processes::family::{self, families};
use metamorph_processes::record::journal::parts_of;
use metamorph_processes::run::{PageChannels, processes};
use metamorph_processes::swarm::HostsFile;
use metamorph_text::command_error::Failure;
use std::path::Path;
use std::path::PathBuf;

/// Examples for the help.
const EXAMPLES: &str = "\
Examples:
  metamorph run swarm --journal run.journal --patience 60s
  (its controller is killed, for example by kill -9)
  metamorph resume run.journal
  metamorph resume run.journal --hosts hosts.toml --old-host-is-gone

The controller hosts the simulated bodies, so without it nothing moves, while modules keep exchanging
messages. Bodies and controller are rebuilt from the journal. Modules wait for --patience; after that, or
if the machine was restarted, the run cannot be resumed. The daemons of a run with --hosts wait as well on
this machine; on other machines they wait for the `fence` of the hosts file, and those that have ended count
as lost. With --old-host-is-gone the run goes on from another machine that has the parts of the journal.";

/// Arguments of `resume`.
#[derive(Debug, Args)]
pub struct ResumeArgs {
    /// The journal of the run
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Go on from this machine, since that of the controller is lost for good; its modules count as dead.
    /// Nothing checks that it is lost, and two controllers would break the run
    #[arg(long, requires = "hosts")]
    pub old_host_is_gone: bool,
    /// With --old-host-is-gone: the hosts, as seen from this machine, with the keys of h1
    #[arg(long, value_name = "FILE", requires = "old_host_is_gone", value_parser = hosts_file)]
    pub hosts: Option<HostsFile>,
    /// Write the report as JSON to a file, or to standard output with `-` (text for people then goes
    /// to standard error)
    #[arg(long, value_name = "FILE|-", allow_hyphen_values = true)]
    pub json: Option<PathBuf>,
    /// Write a report with plots to this file, as one self-contained HTML page
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
    /// Show the run in the browser during the run and afterwards, until Ctrl-C; the address is
    /// printed. Messages between processes are shown afterwards
    #[arg(long)]
    pub view: bool,
    /// The port of the page's address, for example one that is forwarded; default: any free one
    #[arg(long, value_name = "N", requires = "view", value_parser = clap::value_parser!(u16).range(1..))]
    pub port: Option<u16>,
    /// Let the page command the run; a second address, with the secret for that, is printed
    #[arg(long, requires = "view")]
    pub control: bool,
    /// Metrics of the run.
    #[command(flatten)]
    pub metrics: MetricsArg,
    /// Print errors only, and JSON if requested
    #[arg(short, long)]
    pub quiet: bool,
}

/// Resumes a run whose controller was killed.
fn resume(args: ResumeArgs, since: Stopwatch, interrupt: &Interrupt) -> Result<u8, Failure> {
    let mut left = processes::left_behind(families(), &args.file)?;
    left.elsewhere = args.hosts;
    let plan = left.plan.clone();
    let mut outputs = Outputs::new();
    outputs.reads("the scenario", Path::new(&plan.origin));
    plan.files.iter().for_each(|file| outputs.reads("a file that the scenario names,", file));
    outputs.reads_directory("a part of the journal,", &parts_of(&args.file));
    outputs.writes("the journal", &args.file, OutputKind::Journal)?;
    let asked = Asked {
        json: args.json,
        html: args.html,
        journal: Some(args.file.clone()),
        view: args.view.then_some(args.port),
        control: args.control,
        quiet: args.quiet,
    };
    let metrics = args.metrics.serve(args.quiet)?;
    let show = Show::begin(&plan, asked, &mut outputs, interrupt)?;
    let mut live = Live::new(!args.quiet);
    let page = PageChannels { metrics, ..show.channels(&plan) };
    let report = family::of(&plan).resume(left, &mut live, since, page)?;
    drop(live);
    show.end(&plan, &report, Some(&args.file))
}

/// The command.
pub static COMMAND: CommandOf<ResumeArgs> = CommandOf {
    name: "resume",
    group: Some(Group::Run),
    about: "Resume a run whose controller was killed",
    after_help: || format!("{EXAMPLES}\n\n{EXIT_CODES}{DAMAGED_EXIT_CODE}"),
    execute: |args, call| resume(args, call.since, call.interrupt),
};
