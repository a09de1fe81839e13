//! The command `sweep`.

use crate::runs::plan;
use crate::scenario_args::{ChangeArgs, jobs};
use clap::Args;
use metamorph_console::command::{CommandOf, Group};
use metamorph_console::output::Outputs;
use metamorph_console::terminal::print_out;
use metamorph_experiments::sweep::{Request, join_parts, sweep};
use metamorph_processes::family::families;
use metamorph_scenario::json::is_json;
use metamorph_scenario::pack::{PackError, packed};
use metamorph_scenario::{LinkKind, Overrides};
use metamorph_text::command_error::{BAD_USAGE, CommandError, Failure};
use metamorph_text::escape::Shown;
use metamorph_text::format::many;
use metamorph_text::program;
use std::collections::BTreeSet;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Examples for the help.
const EXAMPLES: &str = "\
Examples:
  metamorph sweep swarm --seeds 0..1000
  metamorph sweep swarm --seeds 0..1000 --vary link.loss=0%,1%,5%
  metamorph sweep swarm --seeds 0..200 --vary protocol.connectivity=forest,cycles \\
      --vary goal.0.growth=scaffold,solid --out results
  metamorph sweep (the same options) --out results --resume
  metamorph sweep (the same options) --part 3/16 --out part-3 --resume
  metamorph sweep --join part-* --out results
  metamorph sweep rabbit --pack packed.toml

Every combination of the varied values is run with every seed, on the simulated link. A key is the
names of tables and keys joined by dots, with the number of an element for lists: goal.0.growth. A
value is TOML, or text without quotes; commas in brackets or quotes belong to it. At most 10 million
runs and 10,000 combinations.

Files in DIR: runs.csv has a line for every run, summary.json the numbers of the table, report.html
shows them. They are the same on every machine and with any number of jobs.

Ctrl-C ends a sweep; with --out every completed run is kept. --resume begins where nothing is yet, so that one
command serves a job that is started again. With more seeds than before it runs only these.

--pack writes the scenario and all files that it names as one file, which is a scenario: any machine runs, checks
and sweeps it, with the trace hashes of the unpacked one. Options that change the scenario are given to the runs.

--part divides the runs among machines, and --join makes of all parts the files of one machine.

Exit codes:
  0  every run has ended, however it ended
  1  the program itself failed, for example because a file could not be written
  2  the command line, the scenario or the directory is wrong
  6  an invariant broke in at least one run, such as two modules in one cell
  7  stopped by Ctrl-C, SIGTERM or SIGHUP before every run was done";

/// Arguments of `sweep`.
#[derive(Debug, Args)]
pub struct SweepArgs {
    /// The scenario: a file of TOML or JSON, `-` for standard input, or a name that `metamorph scenarios` lists; left out only
    /// with --join
    #[arg(value_name = "SCENARIO", required_unless_present = "join")]
    pub scenario: Option<PathBuf>,
    /// The seeds, from A to B without B: 0..1000 are 1,000 runs; left out only with --join or --pack
    #[arg(long, value_name = "A..B", allow_hyphen_values = true, required_unless_present_any = ["join", "pack"])]
    pub seeds: Option<String>,
    /// Run with each of these values of a key, for example link.loss=0%,1%,5% (repeatable: every combination is run)
    #[arg(long, value_name = "KEY=V1,V2,..", allow_hyphen_values = true)]
    pub vary: Vec<String>,
    /// The changes of the scenario, in all runs.
    #[command(flatten)]
    pub changes: ChangeArgs,
    /// Number of concurrent runs; default: the number of processors
    #[arg(long, value_name = "N")]
    pub jobs: Option<NonZeroUsize>,
    /// Write the results to files in this directory, which must be new or empty
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Resume an interrupted sweep in DIR, or begin one; with more seeds than before only these are run
    #[arg(long, requires = "out")]
    pub resume: bool,
    /// Run the part I of N of the runs, from 1 to N, as one of several machines; --join makes one sweep of all parts; default:
    /// all runs
    #[arg(long, value_name = "I/N", requires = "out")]
    pub part: Option<String>,
    /// Make one sweep in --out of the parts in these directories
    #[arg(long, value_name = "DIR", num_args = 1.., requires = "out",
        conflicts_with_all = ["scenario", "seeds", "vary", "jobs", "resume", "part", "ChangeArgs"])]
    pub join: Vec<PathBuf>,
    /// Run nothing, and write the scenario with all files that it names as one scenario to this new file, for other machines;
    /// left out, the sweep is run
    #[arg(long, value_name = "FILE",
        conflicts_with_all = ["seeds", "vary", "jobs", "out", "resume", "part", "join", "ChangeArgs"])]
    pub pack: Option<PathBuf>,
    /// Print errors only
    #[arg(short, long)]
    pub quiet: bool,
}

impl From<SweepArgs> for Request {
    /// Without a scenario and seeds, which only `--join` needs not, these are empty.
    fn from(args: SweepArgs) -> Request {
        Request {
            scenario: args.scenario.unwrap_or_default(),
            seeds: args.seeds.unwrap_or_default(),
            vary: args.vary,
            overrides: args.changes.overrides(),
            jobs: jobs(args.jobs),
            out: args.out,
            resume: args.resume,
            part: args.part,
            quiet: args.quiet,
        }
    }
}

/// The name of a packed scenario does not say that it is one.
#[derive(Debug, Error)]
#[error("--pack {}: a scenario in {format} has a name that ends in .{end}\n  fix: name the file so", .file.shown())]
struct WrongEnd {
    file: PathBuf,
    format: &'static str,
    end: &'static str,
}

impl CommandError for WrongEnd {
    fn exit_code(&self) -> u8 {
        BAD_USAGE
    }
}

/// A scenario cannot be packed.
#[derive(Debug, Error)]
#[error("--pack: {0}")]
struct NotPacked(PackError);

impl CommandError for NotPacked {
    fn exit_code(&self) -> u8 {
        BAD_USAGE
    }
}

/// Writes a scenario with all files that it names as one file.
fn pack(scenario: &Path, file: &Path, is_quiet: bool) -> Result<u8, Failure> {
    let plan = plan(scenario, &Overrides { link: LinkKind::Sim, ..Overrides::default() })?;
    let (format, end) = if is_json(&plan.text) { ("JSON", "json") } else { ("TOML", "toml") };
    if file.extension().is_none_or(|found| found != end) {
        return Err(WrongEnd { file: file.to_owned(), format, end }.into());
    }
    let text = packed(families(), &plan).map_err(NotPacked)?;
    Outputs::new().creates("--pack", file)?.write(text)?;
    if !is_quiet {
        let names: BTreeSet<&String> = plan.names.iter().collect();
        let files = many(names.len() as u64, "file");
        let shown = file.shown();
        print_out(&format!(
            "{shown} has the scenario and {files} that it names\nrun it with {} run {shown}",
            program::name()
        ));
    }
    Ok(0)
}

/// The command.
pub static COMMAND: CommandOf<SweepArgs> = CommandOf {
    name: "sweep",
    group: Some(Group::Study),
    about: "Run a scenario with many seeds and varied values, and compare",
    after_help: || EXAMPLES.to_owned(),
    execute: |args, _| match (&args.pack, &args.join[..], &args.out) {
        (Some(file), ..) => pack(&args.scenario.unwrap_or_default(), file, args.quiet),
        (_, [], _) | (.., None) => Ok(sweep(&args.into())?),
        (_, parts, Some(out)) => Ok(join_parts(parts, out, args.quiet)?),
    },
};
