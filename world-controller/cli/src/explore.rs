//! The command `explore`.

use crate::scenario_args::{RescueArg, jobs};
use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use metamorph_console::command::{CommandOf, Group};
use metamorph_experiments::explore::draw::Drawn;
use metamorph_experiments::explore::{Budget, Request, explore};
use metamorph_processes::family::{self, Family};
use metamorph_sim_bridge::director::rescue::Rescue;
use std::fmt;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::Duration;

/// Examples for the help.
const EXAMPLES: &str = "\
Examples:
  metamorph explore --seconds 60
  metamorph explore --runs 10000 --family cube --seed 1
  metamorph explore --runs 1 --seed 4711      (one run, with its scenario)

Every run is a small scenario generated from its seed: world, start, goal, strategy, link, faults; from
seed 2^40 on also hosts, which are lost and come back. Seeds are consecutive, starting with --seed. All
invariants are checked; after all faults, the remaining modules must build the goal, unless that is
impossible. The first failure of each kind is shrunk and written to DIR as a scenario that
`metamorph run FILE --link sim` repeats. With -v each run is logged before it begins.

At the end, rare paths of the protocols and the simulator that never ran are listed.

Exit codes:
  0  nothing failed
  1  the program itself failed, for example because a file could not be written
  2  the command line is wrong
  3  a run stood still although a plan was left
  6  an invariant broke, or the program panicked, in at least one run
  7  stopped by Ctrl-C, SIGTERM or SIGHUP, before any failure";

/// Number of runs of `explore` if neither --runs nor --seconds is given.
const EXPLORED: u64 = 1_000;

/// Arguments of `explore`.
#[derive(Debug, Args)]
pub struct ExploreArgs {
    /// Number of runs
    #[arg(long, value_name = "N", help = format!("Number of runs; default without --seconds: {EXPLORED}"), conflicts_with = "seconds", value_parser = clap::value_parser!(u64).range(1..))]
    pub runs: Option<u64>,
    /// Stop after this many seconds, including shrinking; default: as --runs says
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=10_000_000))]
    pub seconds: Option<u64>,
    /// The seed of the first run; default: random, printed at the start
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(..=i64::MAX as u64))]
    pub seed: Option<u64>,
    /// One family of modules only; default: all
    #[arg(long, value_name = "FAMILY", value_parser = family_parser())]
    pub family: Option<FamilyArg>,
    /// Draw metamodules with passive elements only
    #[arg(long)]
    pub elements: bool,
    /// How far the controller helps broken swarms of cubes that stand still. At off and calls, a standstill with a plan left is no
    /// failure. Default: plans, and drawn for seeds from 2^39 on
    #[arg(long, value_enum, value_name = "LEVEL")]
    pub rescue: Option<RescueArg>,
    /// Number of concurrent runs; default: the number of processors
    #[arg(long, value_name = "N")]
    pub jobs: Option<NonZeroUsize>,
    /// Write failing scenarios to this directory
    #[arg(long, value_name = "DIR", default_value = "explored")]
    pub out: PathBuf,
    /// Write the numbers as JSON to a file, or to standard output with `-` (text for people then goes
    /// to standard error)
    #[arg(long, value_name = "FILE|-", allow_hyphen_values = true)]
    pub json: Option<PathBuf>,
    /// Print errors only
    #[arg(short, long)]
    pub quiet: bool,
}

/// A family of modules, as typed.
#[derive(Clone, Copy)]
pub struct FamilyArg(&'static dyn Family);

impl fmt::Debug for FamilyArg {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.0.name())
    }
}

/// Reads the name of a family.
fn family_parser() -> impl TypedValueParser<Value = FamilyArg> {
    let names = family::all().iter().map(|family| family.name());
    PossibleValuesParser::new(names).map(|name| {
        FamilyArg(family::named(&name).expect("invariant: only names of families are possible values"))
    })
}

impl From<ExploreArgs> for Request {
    fn from(args: ExploreArgs) -> Request {
        Request {
            budget: match args.seconds {
                Some(seconds) => Budget::Time(Duration::from_secs(seconds)),
                None => Budget::Runs(args.runs.unwrap_or(EXPLORED)),
            },
            seed: args.seed,
            drawn: Drawn {
                family: args.family.map(|family| family.0),
                elements: args.elements,
                rescue: args.rescue.map(Rescue::from),
            },
            jobs: jobs(args.jobs),
            out: args.out,
            json: args.json,
            quiet: args.quiet,
        }
    }
}

/// The command.
pub static COMMAND: CommandOf<ExploreArgs> = CommandOf {
    name: "explore",
    group: Some(Group::Study),
    about: "Generate random scenarios, run them, and shrink failures",
    after_help: || EXAMPLES.to_owned(),
    execute: |args, _| Ok(explore(&args.into())?),
};
