//! The command line as typed values. Absent: executing commands (see `dispatch`).

use crate::cli::reference::{CompletionArgs, ManArgs, SchemaArgs};
use crate::experiments::bench;
use crate::experiments::explore;
use crate::experiments::reproduce::{self, Experiment};
use crate::experiments::sweep::Request;
use crate::family::metamodule::robot::RobotArgs;
use crate::family::{self, Family};
use crate::plan;
use crate::run::replay;
use crate::scenario::mesh_import::shape::ShapeArgs;
use crate::scenario::settings::Setting;
use crate::scenario::{LinkKind, NEVER, Overrides, SEED, TIME_SCALE};
use crate::view::export::ExportArgs;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{ArgAction, Args, Parser, Subcommand, ValueEnum};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::time::{Span, SpanError, Time};
use std::ffi::OsString;
use std::fmt;
use std::fmt::Display;
use std::num::NonZeroUsize;
use std::path::PathBuf;
use std::time::Duration;

const EXIT_CODES: &str = "\
Exit codes:
  0  built: every goal cell is filled (or the command succeeded)
  1  the program itself failed, for example because a file or standard output could not be written
  2  the command line or the scenario is wrong
  3  deadlock: no module can make progress and goal cells are unfilled
  4  livelock: modules move, but no goal cell is filled for longer than the scenario's bound
  5  timeout: the scenario's time limit was reached
  6  unsafe: an invariant broke, such as two modules in one cell
  7  aborted: stopped by Ctrl-C, SIGTERM or SIGHUP, or because shared memory ran short; the report,
     if the run had begun, is partial";

/// Continues the list of exit codes.
const JOURNAL_EXIT_CODES: &str = "
  8  a replay differs from the journal
  9  a journal is damaged: bytes were changed, or parts are missing or of another run";
const DAMAGED_EXIT_CODE: &str = "
  9  the journal is damaged; the message says where and how";

const TOP_EXAMPLES: &str = "\
Examples:
  metamorph run deploy/scenarios/swarm.toml              one process per module
  metamorph run deploy/scenarios/swarm.toml --link sim   the same in virtual time, repeatable
  metamorph check my.toml                                what would run, or what is wrong
  metamorph clean                                        remove what killed runs left behind

An output file appears at the end of a command, complete; it must not be another file that the command
reads or writes. If standard output cannot be written, the exit code is 1; a reader that closes it early
(`| head`) is no error.

Logs go to standard error; -v, -vv and -vvv show more, and METAMORPH_LOG takes filters such as
`metamorph_world_controller=debug`.";

const RUN_EXAMPLES: &str = "\
Examples:
  metamorph run deploy/scenarios/swarm.toml --kill 3@2s --pause 7@1s..3s
  metamorph run deploy/scenarios/slab-to-sphere.toml --link sim --seed 7 --loss 5%
  metamorph run deploy/scenarios/swarm.toml --link sim --quiet --json - | jq .messages.by_class

Times are scenario times with a unit: 200ms, 1.5s, 2min. Probabilities are written 5%, 0.05 or 1/20.
Modules are numbered from 0; `metamorph check SCENARIO` prints their number.

Ctrl-C, SIGTERM or SIGHUP ends a run with a partial report; a second one does not wait for agents.";

const VIEW_EXAMPLES: &str = "\
Examples:
  metamorph run deploy/scenarios/swarm.toml --journal run.journal
  metamorph view run.journal                             show a recorded run
  metamorph view deploy/scenarios/chair.toml --seed 7    simulate a scenario, and show it
  metamorph run deploy/scenarios/swarm.toml --view       show processes while they run

The address of the page is printed; open it in a browser of this machine. It works without a network,
listens on the loopback interface only, and admits only requests with the complete address. `?` on the
page lists its keys. Ctrl-C ends it.

Exit codes:
  0  the page was shown until Ctrl-C, SIGTERM or SIGHUP
  1  the program itself failed, for example because no port was free
  2  the command line or the scenario is wrong, or the file is no journal of this version
  9  the journal is damaged; what comes before the damage was shown until Ctrl-C";

const CHECK_EXAMPLES: &str = "\
Examples:
  metamorph check deploy/scenarios/swarm.toml
  metamorph check deploy/scenarios/swarm.toml --link sim --kill 3@2s

The same options as for `run` are checked together with the scenario. Nothing is run.

Exit codes:
  0  the scenario can be run
  2  the command line or the scenario is wrong; every error names its place, reason and fix";

const SWEEP_EXAMPLES: &str = "\
Examples:
  metamorph sweep deploy/scenarios/swarm.toml --seeds 0..1000
  metamorph sweep deploy/scenarios/swarm.toml --seeds 0..1000 --vary link.loss=0%,1%,5%
  metamorph sweep deploy/scenarios/swarm.toml --seeds 0..200 --vary protocol.connectivity=forest,cycles \\
      --vary goal.0.growth=scaffold,solid --out results
  metamorph sweep (the same options) --out results --resume

Every combination of the varied values is run with every seed, on the simulated link. A key is the
names of tables and keys joined by dots, with the number of an element for lists: goal.0.growth. A
value is TOML, or text without quotes; commas in brackets or quotes belong to it. At most 10 million
runs and 10,000 combinations.

Files in DIR: runs.csv has a line for every run, summary.json the numbers of the table, report.html
shows them. They are the same on every machine and with any number of jobs.

Ctrl-C ends a sweep; with --out every completed run is kept.

Exit codes:
  0  every run has ended, however it ended
  1  the program itself failed, for example because a file could not be written
  2  the command line, the scenario or the directory is wrong
  6  an invariant broke in at least one run, such as two modules in one cell
  7  stopped by Ctrl-C, SIGTERM or SIGHUP before every run was done";

const REPRODUCE_EXAMPLES: &str = "\
Examples:
  metamorph reproduce 4.1 4.2 fig4.5
  metamorph reproduce 4.2 --seeds 100 --out results
  metamorph reproduce 4.1 --quiet --json - | jq '.experiments[0].cells[0]'
  metamorph reproduce graph-signature on-grid reward-map

4.1, 4.2 and fig4.5 run the thesis's experiment with metamodules (4.1.3), re-implemented by the nearest
reading of its text, with every kind (PAR, PER, SRS, SRZ), strategy (greedy, slope, step, and our negotiated)
and order of seeds (circular, crosswise, at-once), and print the published numbers beside ours: with exact
tests, another reading, the effect of each open assumption (from fewer seeds), and whether experiments of
the published size show what the thesis says. The experiments of planners are no sweeps: they
are named without these and without --out, and print one table each.

Files in DIR: report.html with tables and plots, and for each of box and chair the scenario and a
directory as `metamorph sweep` writes it; the same for the other reading (box-locks, chair-locks) and for other
orders of the chair's seeds (chair-recipe).

Exit codes:
  0  every run has ended, however it ended
  1  the program itself failed, for example because a file could not be written
  2  the command line or the directory is wrong
  6  an invariant broke in at least one run, such as two modules in one cell
  7  stopped by Ctrl-C, SIGTERM or SIGHUP before every run was done";

const RESUME_EXAMPLES: &str = "\
Examples:
  metamorph run deploy/scenarios/swarm.toml --journal run.journal --patience 60s
  (its controller is killed, for example by kill -9)
  metamorph resume run.journal

The controller hosts the simulated bodies, so without it nothing moves, while modules keep exchanging
messages. Bodies and controller are rebuilt from the journal. Modules wait for --patience; after that, or
if the machine was restarted, the run cannot be resumed.";

const SHAPE_EXAMPLES: &str = "\
Examples:
  metamorph shape deploy/shapes/table.obj --pitch 10
  metamorph shape deploy/shapes/rabbit.stl --cells 14 --svg rabbit.svg --write rabbit.toml
  metamorph shape config.xml --part blocks
  metamorph shape config.xml --write case.toml

A cell is filled if its centre is inside the solid. In a scenario, the same goal is
    shape = { file = { path = \"rabbit.stl\", pitch = 10 } }
The written scenario lists the cells themselves and does not need the file. Its modules start in a
slab below the goal, or at the places of the configuration.

Exit codes:
  0  no obstacle to building it was found before a run
  1  a file could not be written
  2  the command line or the file is wrong, or something cannot be built; every error names its
     place, reason and fix";

const EXPORT_EXAMPLES: &str = "\
Examples:
  metamorph run deploy/scenarios/swarm.toml --link sim --journal run.journal
  metamorph export run.journal --mcap run.mcap

The recording has Foxglove's SceneUpdate on /modules and Log on /log. Open it in Foxglove or in Lichtblick
and show /modules in a 3D panel whose frame is `world`.

Exit codes:
  0  the recording is written
  1  it could not be written completely
  2  the command line is wrong, or the file is no journal of this version
  9  the journal is damaged; no recording is left behind";

const SCHEMA_EXAMPLES: &str = "\
Examples:
  metamorph schema > scenario.schema.json
  metamorph schema report | jq .properties.outcome

An editor with a TOML language server checks a scenario that begins with
    #:schema scenario.schema.json";

const COMPLETION_EXAMPLES: &str = "\
Examples:
  metamorph completions bash > ~/.local/share/bash-completion/completions/metamorph
  metamorph completions zsh > ~/.zfunc/_metamorph
  metamorph completions fish > ~/.config/fish/completions/metamorph.fish";
const BENCH_EXAMPLES: &str = "\
Examples:
  metamorph bench                            everything; takes several minutes
  metamorph bench flood wire                 the simulated and the process link, message by message
  metamorph bench growth --most 2500         sizes of up to 2,500 modules
  metamorph bench --quiet --json new.json && jq .flood new.json

What each measures:
  flood   a million simulated modules propagate hop counts from a corner: processor time and memory
  growth  a slab of 100 to 10,000 simulated modules becomes a ball: time, moves, messages, and how they grow
  chairs  the thesis's chair with every strategy, on all processors: runs per second
  wire    round trips and throughput of 64 bytes between two processes, beside bare iceoryx2, a Unix
          socket, a pipe and TCP
  swarm   100 to 5,000 processes: starting, exchanging, memory, idling
  churn   1,000 processes, of which 2 and then 20 per second are killed and restarted

Other load increases the times measured in real time (`wire` and `swarm`); compare numbers of one run.

Exit codes:
  0  everything was measured that this machine permits
  1  something could not be measured
  2  the command line is wrong";

const REPLAY_EXAMPLES: &str = "\
Examples:
  metamorph run deploy/scenarios/swarm.toml --journal run.journal
  metamorph replay run.journal                       check that a replay matches the journal
  metamorph replay run.journal --until 10s           the state of every module at 10 s
  metamorph replay run.journal --agent 7 --until 5s  the history of module 7 until 5 s

Agents, world and controller receive the recorded inputs, in the order of cause and effect, and must
reach the same states, messages and counts. Of a killed run, the parts in FILE.parts are replayed.

Exit codes:
  0  the replay matches the journal
  1  the program itself failed
  2  the command line is wrong, or the file is no journal of this version
  8  the replay differs from the journal; the first difference is named
  9  the journal is damaged; the replay matches what comes before the damage";

const EXPLORE_EXAMPLES: &str = "\
Examples:
  metamorph explore --seconds 60
  metamorph explore --runs 10000 --family cube --seed 1
  metamorph explore --runs 1 --seed 4711      (one run, with its scenario)

Every run is a small scenario generated from its seed: world, start, goal, strategy, link, faults. Seeds
are consecutive, starting with --seed. All invariants are checked; after all faults, the remaining
modules must build the goal, unless that is impossible. The first failure of each kind is shrunk and
written to DIR as a scenario that `metamorph run FILE --link sim` repeats. With -v each run is logged
before it begins.

At the end, rare paths of the protocols and the simulator that never ran are listed.

Exit codes:
  0  nothing failed
  1  the program itself failed, for example because a file could not be written
  2  the command line is wrong
  3  a run stood still although a plan was left
  6  an invariant broke, or the program panicked, in at least one run
  7  stopped by Ctrl-C, SIGTERM or SIGHUP, before any failure";

const CLEAN_EXAMPLES: &str = "\
Removes shared memory, files and stopped processes of this user's runs whose controller was killed.
Active runs are not touched. The next `metamorph run` does the same.

Exit codes:
  0  nothing is left behind
  1  something could not be removed";

/// Runs swarms of self-reconfiguring modules: every module is a process, or all are simulated in
/// virtual time.
#[derive(Debug, Parser)]
#[command(name = "metamorph", version, after_help = TOP_EXAMPLES, after_long_help = format!("{TOP_EXAMPLES}\n\n{EXIT_CODES}{JOURNAL_EXIT_CODES}"))]
pub struct CommandLine {
    /// The command.
    #[command(subcommand)]
    pub command: Command,
    /// Log more to standard error; repeatable
    #[arg(short, long, action = ArgAction::Count, global = true)]
    pub verbose: u8,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Run a scenario and report what happened
    #[command(after_help = format!("{RUN_EXAMPLES}\n\n{EXIT_CODES}"))]
    Run(RunArgs),
    /// Show a run in the browser: in 3D, with a timeline
    #[command(after_help = VIEW_EXAMPLES)]
    View(ViewArgs),
    /// Run a scenario with many seeds and varied values, and compare
    #[command(after_help = SWEEP_EXAMPLES)]
    Sweep(SweepArgs),
    /// Resume a run whose controller was killed
    #[command(after_help = format!("{RESUME_EXAMPLES}\n\n{EXIT_CODES}{DAMAGED_EXIT_CODE}"))]
    Resume(ResumeArgs),
    /// Replay the journal of a run, and report the first difference
    #[command(after_help = REPLAY_EXAMPLES)]
    Replay(ReplayArgs),
    /// Run experiments of the thesis and print the published numbers beside ours
    #[command(after_help = REPRODUCE_EXAMPLES)]
    Reproduce(ReproduceArgs),
    /// Plan the reconfiguration of free modules, exactly; check, compare and count
    #[command(after_help = plan::EXAMPLES)]
    Plan(Box<plan::PlanArgs>),
    /// Measure both links beside bare mechanisms, in tables and as JSON
    #[command(after_help = BENCH_EXAMPLES)]
    Bench(BenchArgs),
    /// Generate random scenarios, run them, and shrink failures
    #[command(after_help = EXPLORE_EXAMPLES)]
    Explore(ExploreArgs),
    /// Check a scenario and show what would run
    #[command(after_help = CHECK_EXAMPLES)]
    Check(CheckArgs),
    /// Convert a solid from a CAD program to cells, and write it as a scenario
    #[command(after_help = SHAPE_EXAMPLES)]
    Shape(ShapeArgs),
    /// Remove what killed runs left behind
    #[command(after_help = CLEAN_EXAMPLES)]
    Clean,
    /// Query the Roombots model: shapes, moves, kinematics, published tables
    Robot(RobotArgs),
    /// Export a journal as a recording for other viewers
    #[command(after_help = EXPORT_EXAMPLES)]
    Export(ExportArgs),
    /// Print the JSON schema of scenarios or reports
    #[command(after_help = SCHEMA_EXAMPLES)]
    Schema(SchemaArgs),
    /// Print a script that completes command lines in a shell
    #[command(after_help = COMPLETION_EXAMPLES)]
    Completions(CompletionArgs),
    /// Write man pages
    Man(ManArgs),
    /// One agent process; started by `run`
    #[command(hide = true)]
    Agent(AgentArgs),
}

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
    /// controller was killed
    #[arg(long, value_name = "T", value_parser = real_time, default_value = "30s", requires = "journal")]
    pub patience: Duration,
    /// Write a report with plots to this file, as one self-contained HTML page
    #[arg(long, value_name = "FILE")]
    pub html: Option<PathBuf>,
    /// Show the run in the browser during the run and afterwards, until Ctrl-C; the address is
    /// printed. Messages between processes are shown afterwards, and with --journal only
    #[arg(long)]
    pub view: bool,
    /// Print errors only, and JSON if requested
    #[arg(short, long)]
    pub quiet: bool,
}

/// Arguments of `view`.
#[derive(Debug, Args)]
pub struct ViewArgs {
    /// A journal that `run --journal` wrote; or a scenario (a file whose name ends in .toml), which is
    /// simulated and shown
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Of a scenario: the seed of the run's randomness
    #[arg(long, value_name = "N", help = left_out("Of a scenario: the seed of the run's randomness", SEED))]
    pub seed: Option<u64>,
    /// Of a scenario: set a value in it, as for `run` (repeatable)
    #[arg(long, value_name = "KEY=VALUE", allow_hyphen_values = true)]
    pub set: Vec<String>,
    /// Of a scenario: kill the process of module ID at time T (repeatable)
    #[arg(long, value_name = "ID@T", allow_hyphen_values = true)]
    pub kill: Vec<String>,
    /// Of a scenario: stop the process of module ID from one time to another (repeatable)
    #[arg(long, value_name = "ID@T..T", allow_hyphen_values = true)]
    pub pause: Vec<String>,
}

impl ViewArgs {
    /// Returns the overrides of a scenario.
    pub fn overrides(self) -> Overrides {
        let setting = |text| Setting { option: "--set", text };
        Overrides {
            link: LinkKind::Sim,
            seed: self.seed,
            kill: self.kill,
            pause: self.pause,
            settings: self.set.into_iter().map(setting).collect(),
            ..Overrides::default()
        }
    }
}

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

/// Arguments of `resume`.
#[derive(Debug, Args)]
pub struct ResumeArgs {
    /// The journal of the run
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
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
    /// Print errors only, and JSON if requested
    #[arg(short, long)]
    pub quiet: bool,
}

fn real_time(text: &str) -> Result<Duration, String> {
    let Span(nanos) = text.parse().map_err(|e: SpanError| e.to_string())?;
    Ok(Duration::from_nanos(nanos))
}

fn scenario_time(text: &str) -> Result<Time, String> {
    let span: Span = text.parse().map_err(|e: SpanError| e.to_string())?;
    Ok(Time::ZERO + span)
}

impl From<ReplayArgs> for replay::Request {
    fn from(args: ReplayArgs) -> replay::Request {
        replay::Request { file: args.file, until: args.until, agent: args.agent.map(ModuleId) }
    }
}

/// Arguments of `sweep`.
#[derive(Debug, Args)]
pub struct SweepArgs {
    /// The scenario, a TOML file (see deploy/scenarios for examples)
    #[arg(value_name = "SCENARIO")]
    pub scenario: PathBuf,
    /// The seeds, from A to B without B: 0..1000 are 1,000 runs
    #[arg(long, value_name = "A..B", allow_hyphen_values = true)]
    pub seeds: String,
    /// Run with each of these values of a key, for example link.loss=0%,1%,5% (repeatable: every
    /// combination is run)
    #[arg(long, value_name = "KEY=V1,V2,..", allow_hyphen_values = true)]
    pub vary: Vec<String>,
    /// Number of concurrent runs; default: the number of processors
    #[arg(long, value_name = "N")]
    pub jobs: Option<NonZeroUsize>,
    /// Write the results to files in this directory, which must be new or empty
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Resume an interrupted sweep in DIR
    #[arg(long, requires = "out")]
    pub resume: bool,
    /// Print errors only
    #[arg(short, long)]
    pub quiet: bool,
}

impl From<SweepArgs> for Request {
    fn from(args: SweepArgs) -> Request {
        Request {
            scenario: args.scenario,
            seeds: args.seeds,
            vary: args.vary,
            jobs: jobs(args.jobs),
            out: args.out,
            resume: args.resume,
            quiet: args.quiet,
        }
    }
}

/// Arguments of `reproduce`.
#[derive(Debug, Args)]
pub struct ReproduceArgs {
    /// Which tables and figures
    #[arg(value_enum, required = true, value_name = "EXPERIMENT")]
    pub experiments: Vec<Experiment>,
    /// Random starts for every kind, strategy and order of seeds
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub seeds: u64,
    /// Number of concurrent runs; default: the number of processors
    #[arg(long, value_name = "N")]
    pub jobs: Option<NonZeroUsize>,
    /// Write every run and a report to files in this directory, which must be new or empty
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Write the numbers as JSON to a file, or to standard output with `-` (text for people then goes
    /// to standard error)
    #[arg(long, value_name = "FILE|-", allow_hyphen_values = true)]
    pub json: Option<PathBuf>,
    /// Print errors only, and JSON if requested
    #[arg(short, long)]
    pub quiet: bool,
}

impl From<ReproduceArgs> for reproduce::Request {
    fn from(args: ReproduceArgs) -> reproduce::Request {
        reproduce::Request {
            experiments: args.experiments,
            seeds: args.seeds,
            jobs: jobs(args.jobs),
            out: args.out,
            json: args.json,
            quiet: args.quiet,
        }
    }
}

/// Arguments of `bench`.
#[derive(Debug, Args)]
pub struct BenchArgs {
    /// What to measure; default: everything
    #[arg(value_enum, value_name = "NAME")]
    pub names: Vec<bench::Name>,
    /// Skip swarms of more than N modules; default: no limit
    #[arg(long, value_name = "N")]
    pub most: Option<u64>,
    /// Write the numbers to this file
    #[arg(long, value_name = "FILE", default_value = "bench.json")]
    pub json: PathBuf,
    /// Print errors only
    #[arg(short, long)]
    pub quiet: bool,
}

impl From<BenchArgs> for bench::Request {
    fn from(args: BenchArgs) -> bench::Request {
        bench::Request { names: args.names, most: args.most, json: args.json, quiet: args.quiet }
    }
}

/// Scenarios explored by default.
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

impl From<ExploreArgs> for explore::Request {
    fn from(args: ExploreArgs) -> explore::Request {
        explore::Request {
            budget: match args.seconds {
                Some(seconds) => explore::Budget::Time(Duration::from_secs(seconds)),
                None => explore::Budget::Runs(args.runs.unwrap_or(EXPLORED)),
            },
            seed: args.seed,
            family: args.family.map(|family| family.0),
            jobs: jobs(args.jobs),
            out: args.out,
            json: args.json,
            quiet: args.quiet,
        }
    }
}

/// Threads at most; more are taken for a typing error.
const MAX_JOBS: NonZeroUsize = NonZeroUsize::new(1024).expect("invariant: 1024 is not 0");

/// Returns the number of concurrent runs.
fn jobs(typed: Option<NonZeroUsize>) -> NonZeroUsize {
    let all = || std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
    typed.unwrap_or_else(all).min(MAX_JOBS)
}

/// Arguments of `check`.
#[derive(Debug, Args)]
pub struct CheckArgs {
    /// The scenario and its overrides.
    #[command(flatten)]
    pub plan: PlanArgs,
}

/// Returns the help of an option that overrides a value of the scenario, which has its own default.
fn left_out(what: &str, default: impl Display) -> String {
    format!("{what}; default: the scenario's, or {default}")
}

/// The scenario and its overrides.
#[derive(Debug, Args)]
pub struct PlanArgs {
    /// The scenario, a TOML file (see deploy/scenarios for examples)
    #[arg(value_name = "SCENARIO")]
    pub scenario: PathBuf,
    /// The link: `ipc` starts one process per module, `sim` simulates all in virtual time,
    /// deterministically
    #[arg(long, value_enum, default_value_t = LinkArg::Ipc)]
    pub link: LinkArg,
    /// The seed of the run's randomness
    #[arg(long, value_name = "N", help = left_out("The seed of the run's randomness", SEED))]
    pub seed: Option<u64>,
    /// Kill the process of module ID at time T; its body stays where it is (repeatable)
    #[arg(long, value_name = "ID@T", allow_hyphen_values = true)]
    pub kill: Vec<String>,
    /// Stop the process of module ID from one time to another (repeatable)
    #[arg(long, value_name = "ID@T..T", allow_hyphen_values = true)]
    pub pause: Vec<String>,
    /// Restart the process of module ID at time T, without its memory; if it is alive, it is
    /// killed first (repeatable)
    #[arg(long, value_name = "ID@T", allow_hyphen_values = true)]
    pub restart: Vec<String>,
    /// Probability that a message is lost
    #[arg(long, value_name = "P", help = left_out("Probability that a message is lost", NEVER), allow_hyphen_values = true)]
    pub loss: Option<String>,
    /// Delay of messages, T or T..T; on `ipc` added to the real one. Default: the scenario's, or on
    /// `sim` from a hundredth to a tenth of a move, on `ipc` none
    #[arg(long, value_name = "D", allow_hyphen_values = true)]
    pub delay: Option<String>,
    /// Probability that a message arrives twice
    #[arg(long, value_name = "P", help = left_out("Probability that a message arrives twice", NEVER), allow_hyphen_values = true)]
    pub dup: Option<String>,
    /// Probability that a message is overtaken by later ones
    #[arg(long, value_name = "P", help = left_out("Probability that a message is overtaken by later ones", NEVER), allow_hyphen_values = true)]
    pub reorder: Option<String>,
    /// Set a value in the scenario, for example link.loss=5% or goal.0.growth=solid (repeatable)
    #[arg(long, value_name = "KEY=VALUE", allow_hyphen_values = true)]
    pub set: Vec<String>,
    /// Scenario seconds per real second on `ipc`; `sim` is always as fast as possible
    #[arg(long, value_name = "X", help = left_out("Scenario seconds per real second on `ipc`; `sim` is always as fast as possible", TIME_SCALE), allow_hyphen_values = true)]
    pub time_scale: Option<String>,
}

/// The link, as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LinkArg {
    /// One process per module, over shared memory
    Ipc,
    /// All modules in one thread, in virtual time
    Sim,
}

impl From<PlanArgs> for (PathBuf, Overrides) {
    fn from(args: PlanArgs) -> (PathBuf, Overrides) {
        let overrides = Overrides {
            link: match args.link {
                LinkArg::Ipc => LinkKind::Ipc,
                LinkArg::Sim => LinkKind::Sim,
            },
            seed: args.seed,
            kill: args.kill,
            pause: args.pause,
            restart: args.restart,
            loss: args.loss,
            delay: args.delay,
            duplicate: args.dup,
            reorder: args.reorder,
            time_scale: args.time_scale,
            settings: args.set.into_iter().map(|text| Setting { option: "--set", text }).collect(),
        };
        (args.scenario, overrides)
    }
}

/// Arguments of an agent process.
#[derive(Debug, Args)]
pub struct AgentArgs {
    /// Passed on unchanged.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    pub args: Vec<OsString>,
}
