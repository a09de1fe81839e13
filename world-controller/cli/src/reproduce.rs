//! The command `reproduce`.

use crate::scenario_args::jobs;
use clap::Args;
use metamorph_console::command::{CommandOf, Group};
use metamorph_reproduce::{Experiment, Request, reproduce};
use std::num::NonZeroUsize;
use std::path::PathBuf;

/// Examples for the help.
const EXAMPLES: &str = "\
Examples:
  metamorph reproduce 4.1 4.2 fig4.5
  metamorph reproduce 4.2 --seeds 100 --out results
  metamorph reproduce 4.1 --quiet --json - | jq '.experiments[0].cells[0]'
  metamorph reproduce graph-signature on-grid reward-map planned
  metamorph reproduce stoy --seeds 20
  metamorph reproduce gripping torque thesis-7
  metamorph reproduce transport --out worlds     again after Ctrl-C: it continues
  metamorph reproduce why --seeds 4000 --out placements --plot shares.svg
  metamorph reproduce thesis-7 --gaits fo.json,blf.json,blf-sym.json
  metamorph reproduce c.6 8.2

4.1, 4.2 and fig4.5 run the thesis's experiment with metamodules (4.1.3), re-implemented by the nearest
reading of its text, with every kind (PAR, PER, SRS, SRZ), strategy (greedy, slope, step, and our negotiated)
and order of seeds (circular, crosswise, at-once), and print the published numbers beside ours: with exact
tests, another reading, the effect of each open assumption (from fewer seeds), and whether experiments of
the published size show what the thesis says. The experiments of planners, and thesis-7, are not sweeps:
they are named without these and without --out, and print one table each. `stoy`, `why` and `transport` take
--out alone: they keep every run in DIR, and the same command continues where it was interrupted.

Files in DIR: report.html with tables and plots, and for each of box and chair the scenario and a
directory as `metamorph sweep` writes it; the same for the other reading (box-locks, chair-locks) and for other
orders of the chair's seeds (chair-recipe).

Exit codes:
  0  every run has ended, however it ended
  1  the program itself failed, for example because a file could not be written
  2  the command line or the directory is wrong
  6  an invariant broke in at least one run, such as two modules in one cell
  7  stopped by Ctrl-C, SIGTERM or SIGHUP before every run was done";

/// Arguments of `reproduce`.
#[derive(Debug, Args)]
pub struct ReproduceArgs {
    /// Which tables and figures
    #[arg(value_enum, required = true, value_name = "EXPERIMENT")]
    pub experiments: Vec<Experiment>,
    /// Random starts for every kind, strategy and order of seeds; of e, ten times the swarms of a row
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub seeds: u64,
    /// Gait files of `learn`, for thesis-7: their learning curves beside table 7.5 (several by commas).
    /// Default: none
    #[arg(long, value_name = "FILES", value_delimiter = ',')]
    pub gaits: Vec<PathBuf>,
    /// Session logs, for 8.2: their measures beside table 8.2 (several by commas). Default: none
    #[arg(long, value_name = "FILES", value_delimiter = ',')]
    pub study: Vec<PathBuf>,
    /// Number of concurrent runs; default: the number of processors
    #[arg(long, value_name = "N")]
    pub jobs: Option<NonZeroUsize>,
    /// Write every run and a report to files in this directory, which must be new or empty, except for
    /// `stoy`, `why` and `transport`, which continue there
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Draw the shares of `why` with their intervals to this file, as SVG; default: none
    #[arg(long, value_name = "FILE.svg")]
    pub plot: Option<PathBuf>,
    /// Write the numbers as JSON to a file, or to standard output with `-` (text for people then goes
    /// to standard error)
    #[arg(long, value_name = "FILE|-", allow_hyphen_values = true)]
    pub json: Option<PathBuf>,
    /// Print errors only, and JSON if requested
    #[arg(short, long)]
    pub quiet: bool,
}

impl From<ReproduceArgs> for Request {
    fn from(args: ReproduceArgs) -> Request {
        Request {
            experiments: args.experiments,
            seeds: args.seeds,
            gaits: args.gaits,
            studies: args.study,
            jobs: jobs(args.jobs),
            out: args.out,
            json: args.json,
            plot: args.plot,
            quiet: args.quiet,
        }
    }
}

/// The command.
pub static COMMAND: CommandOf<ReproduceArgs> = CommandOf {
    name: "reproduce",
    group: Some(Group::Study),
    about: "Run experiments of the thesis and print the published numbers beside ours",
    after_help: || EXAMPLES.to_owned(),
    execute: |args, _| Ok(reproduce(&args.into())?),
};
