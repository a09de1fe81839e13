//! Arguments that several commands share: a scenario and its overrides, hosts, the number of concurrent runs.

use clap::{Args, ValueEnum};
use metamorph_processes::swarm::{HostsFile, Placement};
use metamorph_protocol::time::{Span, SpanError};
use metamorph_scenario::settings::Setting;
use metamorph_scenario::{LinkKind, NEVER, Overrides, SEED, TIME_SCALE};
use metamorph_sim_bridge::director::rescue::Rescue;
use metamorph_text::command_error::{BAD_USAGE, CommandError};
use std::fmt::Display;
use std::num::NonZeroUsize;
use std::path::{Path, PathBuf};
use std::time::Duration;
use thiserror::Error;

/// Returns the help of an option that overrides a value of the scenario. `default` is the value that holds if
/// the scenario does not set it either.
fn left_out(what: &str, default: impl Display) -> String {
    format!("{what}; default: the scenario's, or {default}")
}

/// Changes of a scenario before it runs.
#[derive(Clone, Debug, Args)]
pub struct ChangeArgs {
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
    /// Cut the modules ID off from all others, from one time to another (repeatable)
    #[arg(long, value_name = "ID,..@T..T", allow_hyphen_values = true)]
    pub partition: Vec<String>,
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
    /// Change a simulated run after so many of its events: other random numbers from there on, of links only or of all that draws
    /// (links=N@EVENTS, all=N@EVENTS), another level of rescue (rescue=LEVEL@EVENTS), a message that is lost (lose=MESSAGE@EVENTS) or
    /// a process that sleeps (sleep=ID/T@EVENTS); see [[change]] (repeatable)
    #[arg(long, value_name = "KIND=VALUE@EVENTS", allow_hyphen_values = true)]
    pub change: Vec<String>,
    /// Set a value in the scenario, for example link.loss=5% or goal.0.growth=solid (repeatable)
    #[arg(long, value_name = "KEY=VALUE", allow_hyphen_values = true)]
    pub set: Vec<String>,
    /// How far the controller helps a broken swarm of cubes that stands still. Default: the scenario's, or plans
    #[arg(long, value_enum, value_name = "LEVEL")]
    pub rescue: Option<RescueArg>,
    /// Give the swarm an operator who helps it when it is stuck (metamodules). Default: the scenario's, or none
    #[arg(long, value_enum, value_name = "KIND")]
    pub operator: Option<OperatorArg>,
}

impl ChangeArgs {
    /// Returns the overrides, with the seed and the link that are left out here.
    pub fn overrides(self) -> Overrides {
        let operator = self.operator.map(|OperatorArg::Scripted| Setting {
            option: "--operator",
            text: "operator.kind=scripted".to_owned(),
        });
        let rescue = self.rescue.map(|level| format!("controller.rescue={}", Rescue::from(level)));
        let rescue = rescue.map(|text| Setting { option: "--rescue", text });
        let set = self.set.into_iter().map(|text| Setting { option: "--set", text });
        Overrides {
            kill: self.kill,
            pause: self.pause,
            restart: self.restart,
            partition: self.partition,
            loss: self.loss,
            delay: self.delay,
            duplicate: self.dup,
            reorder: self.reorder,
            change: self.change,
            settings: operator.into_iter().chain(rescue).chain(set).collect(),
            ..Overrides::default()
        }
    }
}

/// The scenario and its overrides.
#[derive(Debug, Args)]
pub struct PlanArgs {
    /// The scenario: a file of TOML or JSON, `-` for standard input, or a name that `metamorph scenarios` lists
    #[arg(value_name = "SCENARIO")]
    pub scenario: PathBuf,
    /// The link: `ipc` starts one process per module, `sim` simulates all in virtual time,
    /// deterministically
    #[arg(long, value_enum, default_value_t = LinkArg::Ipc)]
    pub link: LinkArg,
    /// The seed of the run's randomness
    #[arg(long, value_name = "N", help = left_out("The seed of the run's randomness", SEED))]
    pub seed: Option<u64>,
    /// The changes of the scenario.
    #[command(flatten)]
    pub changes: ChangeArgs,
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

/// The help of the controller, as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum RescueArg {
    /// None: what is measured is the local protocol alone
    Off,
    /// It calls single modules to unfilled cells
    Calls,
    /// If calls do not help, it also moves modules by a plan
    Plans,
}

impl From<RescueArg> for Rescue {
    fn from(level: RescueArg) -> Rescue {
        match level {
            RescueArg::Off => Rescue::Off,
            RescueArg::Calls => Rescue::Calls,
            RescueArg::Plans => Rescue::Plans,
        }
    }
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

/// Reads the hosts file of this path.
pub fn hosts_file(text: &str) -> Result<HostsFile, String> {
    HostsFile::read(Path::new(text)).map_err(|e| e.to_string())
}

/// Reads a number of hosts, or the path of a hosts file.
pub fn hosts(text: &str) -> Result<HostsArg, String> {
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
        let sizes = file.and_then(|file| file.sizes.as_ref()).map(|sizes| format!("hosts={sizes:?}"));
        let hosts = args.hosts.as_ref().map(|hosts| format!("hosts={}", hosts.count));
        let hosts = sizes.or(hosts);
        let hosts = hosts
            .into_iter()
            .chain(error)
            .chain(placement)
            .map(|text| Setting { option: "--set", text: format!("link.between_hosts.{text}") });
        let mut overrides = args.changes.overrides();
        overrides.link = match args.link {
            LinkArg::Ipc => LinkKind::Ipc,
            LinkArg::Sim => LinkKind::Sim,
        };
        overrides.seed = args.seed;
        overrides.time_scale = args.time_scale;
        overrides.settings.extend(hosts);
        (args.scenario, overrides)
    }
}

/// Options of commands that simulate a scenario if they are given one.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Options of a scenario")]
pub struct SimulatedArgs {
    /// The seed of the run's randomness
    #[arg(long, value_name = "N", help = left_out("The seed of the run's randomness", SEED))]
    pub seed: Option<u64>,
    /// Its changes.
    #[command(flatten)]
    pub changes: ChangeArgs,
}

/// An option of a scenario was given for a journal.
#[derive(Debug, Error)]
#[error("{0}: a journal holds a run that is over\n  fix: leave it out, or name a scenario")]
pub struct OfScenario(String);

impl CommandError for OfScenario {
    fn exit_code(&self) -> u8 {
        BAD_USAGE
    }
}

impl SimulatedArgs {
    /// Returns the overrides of a scenario.
    pub fn overrides(&self) -> Overrides {
        Overrides { link: LinkKind::Sim, seed: self.seed, ..self.changes.clone().overrides() }
    }
    /// Refuses options of a scenario where a journal is read.
    pub fn must_be_left_out(&self) -> Result<(), OfScenario> {
        let setting = self.overrides().settings.first().map(|setting| setting.option.to_owned());
        setting.or_else(|| self.options().into_iter().next()).map_or(Ok(()), |option| Err(OfScenario(option)))
    }
    /// Returns the options that give the same overrides when typed.
    pub fn options(&self) -> Vec<String> {
        let seed = self.seed.map(|seed| ["--seed".to_owned(), seed.to_string()]);
        let changes = self.overrides().options();
        seed.into_iter().flatten().chain(changes).collect()
    }
}

/// Largest number of concurrent runs. A larger --jobs is reduced to it, as probably mistyped.
const MAX_JOBS: NonZeroUsize = NonZeroUsize::new(1024).expect("invariant: 1024 is not 0");

/// Returns the number of concurrent runs: the typed one, or else the number of processors; at most
/// [`MAX_JOBS`].
pub fn jobs(typed: Option<NonZeroUsize>) -> NonZeroUsize {
    let all = || std::thread::available_parallelism().unwrap_or(NonZeroUsize::MIN);
    typed.unwrap_or_else(all).min(MAX_JOBS)
}

/// Reads a real time with a unit.
pub fn real_time(text: &str) -> Result<Duration, String> {
    let Span(nanos) = text.parse().map_err(|e: SpanError| e.to_string())?;
    Ok(Duration::from_nanos(nanos))
}
