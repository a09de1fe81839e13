//! The command line as typed values. Absent: executing commands (see `dispatch`).

use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{Args, ValueEnum};
use metamorph_bench as bench;
use metamorph_experiments::explore;
use metamorph_experiments::explore::draw::Drawn;
use metamorph_experiments::sweep::Request;
use metamorph_processes::family::{self, Family};
use metamorph_processes::run::replay;
use metamorph_processes::swarm::{HostsFile, Placement};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::time::{Span, SpanError, Time};
use metamorph_reproduce::{self, Experiment};
use metamorph_scenario::settings::Setting;
use metamorph_scenario::{LinkKind, NEVER, Overrides, SEED, TIME_SCALE};
use std::ffi::OsString;
use std::fmt;
use std::fmt::Display;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::time::Duration;

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

/// Arguments of `view`.
#[derive(Debug, Args)]
pub struct ViewArgs {
    /// A journal that `run --journal` wrote; or a scenario (a file whose name ends in .toml, or a name that
    /// `metamorph scenarios` lists), which is simulated and shown
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// What is simulated.
    #[command(flatten)]
    pub simulated: SimulatedArgs,
    /// The port of the page's address, for example one that is forwarded; default: any free one
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub port: Option<u16>,
}

/// Options of commands that simulate a scenario if they are given one.
#[derive(Debug, Args)]
pub struct SimulatedArgs {
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

impl SimulatedArgs {
    /// Returns the overrides of a scenario.
    pub fn overrides(&self) -> Overrides {
        let setting = |text: &String| Setting { option: "--set", text: text.clone() };
        Overrides {
            link: LinkKind::Sim,
            seed: self.seed,
            kill: self.kill.clone(),
            pause: self.pause.clone(),
            settings: self.set.iter().map(setting).collect(),
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
    /// Let the page command the run; a second address, with the secret for that, is printed
    #[arg(long, requires = "view")]
    pub control: bool,
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
    /// The scenario: a TOML file, or a name that `metamorph scenarios` lists
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

impl From<ReproduceArgs> for metamorph_reproduce::Request {
    fn from(args: ReproduceArgs) -> metamorph_reproduce::Request {
        metamorph_reproduce::Request {
            experiments: args.experiments,
            seeds: args.seeds,
            gaits: args.gaits,
            studies: args.study,
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
            drawn: Drawn { family: args.family.map(|family| family.0), elements: args.elements },
            jobs: jobs(args.jobs),
            out: args.out,
            json: args.json,
            quiet: args.quiet,
        }
    }
}

/// Largest number of concurrent runs. A larger --jobs is reduced to it, as probably mistyped.
const MAX_JOBS: NonZeroUsize = NonZeroUsize::new(1024).expect("invariant: 1024 is not 0");

/// Returns the number of concurrent runs: the typed one, or else the number of processors; at most
/// [`MAX_JOBS`].
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

/// Arguments of `clean`.
#[derive(Debug, Args)]
pub struct CleanArgs {
    /// Have the daemons of this hosts file clean their hosts, too
    #[arg(long, value_name = "FILE", value_parser = hosts)]
    pub hosts: Option<HostsArg>,
}

/// Returns the help of an option that overrides a value of the scenario. `default` is the value that holds if
/// the scenario does not set it either.
fn left_out(what: &str, default: impl Display) -> String {
    format!("{what}; default: the scenario's, or {default}")
}

/// The scenario and its overrides.
#[derive(Debug, Args)]
pub struct PlanArgs {
    /// The scenario: a TOML file, or a name that `metamorph scenarios` lists
    #[arg(value_name = "SCENARIO")]
    pub scenario: PathBuf,
    /// The link: `ipc` starts one process per module, `sim` simulates all in virtual time,
    /// deterministically
    #[arg(long, value_enum, default_value_t = LinkArg::Ipc)]
    pub link: LinkArg,
    /// The seed of the run's randomness
    #[arg(long, value_name = "N", help = left_out("The seed of the run's randomness", SEED))]
    pub seed: Option<u64>,
    /// Kill the process of module ID at time T; its body stays where it is. ID may be a host of the scenario, such as
    /// h2: all its processes (repeatable)
    #[arg(long, value_name = "ID@T", allow_hyphen_values = true)]
    pub kill: Vec<String>,
    /// Stop the process of module ID, or all of a host, from one time to another (repeatable)
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
    /// Give the swarm an operator who helps it when it is stuck (metamodules). Default: the scenario's, or none
    #[arg(long, value_enum, value_name = "KIND")]
    pub operator: Option<OperatorArg>,
    /// Divide the swarm among several hosts: their number, for daemons that this command starts on this machine, or a
    /// file that names running ones (see `metamorph host --help`). Default: the scenario's, or one
    #[arg(long, value_name = "N|FILE", value_parser = hosts)]
    pub hosts: Option<HostsArg>,
    /// Scenario seconds per real second on `ipc`; `sim` is always as fast as possible
    #[arg(long, value_name = "X", help = left_out("Scenario seconds per real second on `ipc`; `sim` is always as fast as possible", TIME_SCALE), allow_hyphen_values = true)]
    pub time_scale: Option<String>,
}

/// The kind of operator, as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum OperatorArg {
    /// A program
    Scripted,
}

/// The link, as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LinkArg {
    /// One process per module, over shared memory
    Ipc,
    /// All modules in one thread, in virtual time
    Sim,
}

/// The hosts, as typed.
#[derive(Clone, Debug)]
pub struct HostsArg {
    count: u64,
    /// The hosts file; `None` if daemons are to be started.
    pub file: Option<HostsFile>,
}

fn hosts_file(text: &str) -> Result<HostsFile, String> {
    HostsFile::read(Path::new(text)).map_err(|e| e.to_string())
}

fn hosts(text: &str) -> Result<HostsArg, String> {
    if let Ok(count) = text.parse() {
        return Ok(HostsArg { count, file: None });
    }
    let file = hosts_file(text)?;
    Ok(HostsArg { count: file.count() as u64, file: Some(file) })
}

impl From<PlanArgs> for (PathBuf, Overrides) {
    fn from(args: PlanArgs) -> (PathBuf, Overrides) {
        let file = args.hosts.as_ref().and_then(|hosts| hosts.file.as_ref());
        let error = file.and_then(|file| file.clock_error).map(|error| format!("clock_error=\"{error}\""));
        let placement = file.and_then(|file| file.placement).map(|by| match by {
            Placement::Blocks => "placement=\"blocks\"".to_owned(),
            Placement::Cut => "placement=\"cut\"".to_owned(),
        });
        let scripted = |OperatorArg::Scripted| "operator.kind=scripted".to_owned();
        let operator = args.operator.map(scripted).map(|text| Setting { option: "--operator", text });
        let sizes = file.and_then(|file| file.sizes.as_ref()).map(|sizes| format!("hosts={sizes:?}"));
        let hosts = args.hosts.as_ref().map(|hosts| format!("hosts={}", hosts.count));
        let hosts = sizes.or(hosts);
        let hosts = hosts
            .into_iter()
            .chain(error)
            .chain(placement)
            .map(|text| Setting { option: "--set", text: format!("link.between_hosts.{text}") });
        let set = args.set.into_iter().map(|text| Setting { option: "--set", text });
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
            settings: operator.into_iter().chain(set).chain(hosts).collect(),
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
