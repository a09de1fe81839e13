//! Carries commands out: from what was typed to an exit code.

use crate::bench::{self, BenchError, PartError};
use crate::command::{Command, CommandLine, RunArgs};
use crate::explore::{ExploreError, explore};
use crate::interrupt::Interrupt;
use crate::journal::{JournalError, Keeping};
use crate::overview::overview;
use crate::processes;
use crate::replay::{self, ReplayError, replay};
use crate::report::human;
use crate::report::schema::Report;
use crate::reproduce::reproduce;
use crate::robot::{self, RobotError};
use crate::scenario::{LinkKind, Overrides, Plan, read_file};
use crate::simulated::run_simulated;
use crate::stopwatch::Stopwatch;
use crate::sweep::{SweepError, sweep};
use crate::terminal::{Channel, Live, complain, print_out};
use clap::Parser;
use metamorph_sim_bridge::outcome::Outcome;
use std::ffi::OsString;
use std::fs::OpenOptions;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use thiserror::Error;

/// The program itself failed.
const FAILED: u8 = 1;
/// What was typed, or the scenario, is wrong.
const BAD_USAGE: u8 = 2;
/// A replay did not come as recorded.
const DIFFERENT: u8 = 8;

/// Why a command did not get as far as an outcome.
#[derive(Debug, Error)]
enum Failure {
    /// The scenario or an option is wrong; the text says all.
    #[error("{0}")]
    Input(String),
    /// The report cannot go where it shall.
    #[error(
        "--json {path}: cannot write there: {error}\n  fix: name a file in a directory that exists and is yours, or `-`"
    )]
    Json {
        /// Where.
        path: String,
        /// Why.
        error: std::io::Error,
    },
    /// The report could not be written after the run.
    #[error("the report could not be written to {path}: {error}")]
    Report {
        /// Where.
        path: String,
        /// Why.
        error: std::io::Error,
    },
    /// Signals cannot be caught.
    #[error("cannot listen for Ctrl-C: {0}")]
    Signals(std::io::Error),
    /// The process link failed.
    #[error(transparent)]
    Processes(#[from] processes::ProcessError),
    /// The journal cannot be begun.
    #[error("--journal: {0}")]
    Journal(JournalError),
    /// A journal cannot be replayed.
    #[error("metamorph: {0}")]
    Replay(#[from] ReplayError),
    /// A sweep failed.
    #[error(transparent)]
    Sweep(#[from] SweepError),
    /// An exploration failed.
    #[error(transparent)]
    Explore(#[from] ExploreError),
    /// A measurement failed.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// A measurement's other process failed.
    #[error(transparent)]
    BenchPart(#[from] PartError),
    /// The Roombots model has no answer.
    #[error("metamorph: {0}")]
    Robot(#[from] RobotError),
}

impl Failure {
    fn exit_code(&self) -> u8 {
        match self {
            Failure::Robot(error) => error.exit_code(),
            Failure::Sweep(error) if error.is_input() => BAD_USAGE,
            Failure::Sweep(_) | Failure::Explore(_) => FAILED,
            Failure::Input(_) | Failure::Json { .. } | Failure::Journal(_) | Failure::Replay(_) => BAD_USAGE,
            Failure::Bench(BenchError::Json { .. }) => BAD_USAGE,
            Failure::Bench(_) | Failure::BenchPart(_) => FAILED,
            Failure::Report { .. } | Failure::Signals(_) | Failure::Processes(_) => FAILED,
        }
    }
}

/// Does what these arguments (the program's name first) ask for.
pub fn main(args: impl IntoIterator<Item = OsString>) -> ExitCode {
    let since = Stopwatch::start();
    let args: Vec<OsString> = args.into_iter().collect();
    // Thousands of these are started at a time: reading a command line for people costs each of them
    // milliseconds, and memory that it keeps.
    if let Some(done) = short_cut(&args) {
        return match done {
            Ok(()) => ExitCode::SUCCESS,
            Err(failure) => {
                complain(&failure.to_string());
                ExitCode::from(failure.exit_code())
            }
        };
    }
    let line = match CommandLine::try_parse_from(args) {
        Ok(line) => line,
        Err(error) => {
            // Help and version are no errors; clap knows which stream and which colours they get.
            let _ = error.print();
            return ExitCode::from(if error.use_stderr() { BAD_USAGE } else { 0 });
        }
    };
    log_to_stderr(line.verbose);
    match carry_out(line.command, since) {
        Ok(code) => ExitCode::from(code),
        Err(failure) => {
            complain(&failure.to_string());
            ExitCode::from(failure.exit_code())
        }
    }
}

/// Becomes an agent if the arguments are those that a swarm of this program starts its agents with.
fn short_cut(args: &[OsString]) -> Option<Result<(), Failure>> {
    match args {
        [_, agent, dashes, rest @ ..] if agent == "agent" && dashes == "--" => {
            Some(processes::agent(rest).map_err(Failure::from))
        }
        [_, part, rest @ ..] if part == bench::SUBCOMMAND => Some(bench::part(rest).map_err(Failure::from)),
        _ => None,
    }
}

fn carry_out(command: Command, since: Stopwatch) -> Result<u8, Failure> {
    match command {
        Command::Run(args) => run(args, since),
        Command::Check(args) => {
            let (path, overrides) = args.plan.into();
            print_out(&overview(&plan(&path, &overrides)?));
            Ok(0)
        }
        Command::Sweep(args) => Ok(sweep(&args.into())?),
        Command::Resume(args) => {
            may_write(&args.json)?;
            let mut live = Live::new(!args.quiet);
            let report = processes::resume_processes(&args.file, &mut live, since)?;
            drop(live);
            deliver(&report, &args.json, args.quiet)
        }
        Command::Replay(args) => {
            let quiet = args.quiet;
            let (plan, replayed) = replay(&args.into())?;
            if !quiet {
                print_out(&replay::text(&plan, &replayed));
            }
            Ok(if replayed.difference.is_some() { DIFFERENT } else { 0 })
        }
        Command::Reproduce(args) => Ok(reproduce(&args.into())?),
        Command::Explore(args) => Ok(explore(&args.into())?),
        Command::Bench(args) => Ok(bench::bench(&args.into())?),
        Command::Clean => {
            print_out(&processes::clean_up()?);
            Ok(0)
        }
        Command::Robot(args) => {
            robot::run(args)?;
            Ok(0)
        }
        Command::Agent(args) => {
            processes::agent(&args.args)?;
            Ok(0)
        }
    }
}

fn plan(path: &Path, overrides: &Overrides) -> Result<Plan, Failure> {
    read_file(path, overrides).map_err(|problems| Failure::Input(problems.to_string()))
}

fn run(args: RunArgs, since: Stopwatch) -> Result<u8, Failure> {
    let (path, overrides) = args.plan.into();
    let plan = plan(&path, &overrides)?;
    may_write(&args.json)?;
    let interrupt = Interrupt::listen().map_err(Failure::Signals)?;
    let mut live = Live::new(!args.quiet);
    let begin = match overrides.link {
        LinkKind::Sim => Keeping::simulated,
        LinkKind::Ipc => Keeping::of_processes,
    };
    let keeping = args.journal.as_deref().map(|file| begin(file, &plan)).transpose();
    let keeping = keeping.map_err(Failure::Journal)?;
    let report = match overrides.link {
        LinkKind::Sim => run_simulated(&plan, &interrupt, &mut live, since, keeping),
        LinkKind::Ipc => processes::run_processes(&plan, &mut live, since, keeping, args.patience)?,
    };
    drop(live);
    deliver(&report, &args.json, args.quiet)
}

/// Found out before a run, and not after a long one. What the file holds is kept until then.
fn may_write(json: &Option<PathBuf>) -> Result<(), Failure> {
    let Some(file) = json_file(json) else { return Ok(()) };
    let opened = OpenOptions::new().append(true).create(true).open(file);
    opened.map(drop).map_err(|error| Failure::Json { path: file.display().to_string(), error })
}

fn json_file(json: &Option<PathBuf>) -> Option<&Path> {
    json.as_deref().filter(|path| *path != Path::new("-"))
}

fn deliver(report: &Report, json: &Option<PathBuf>, quiet: bool) -> Result<u8, Failure> {
    let to_stdout = json.as_deref() == Some(Path::new("-"));
    let channel = Channel::beside(to_stdout, quiet);
    channel.say(&human(report, channel.paint()));
    let text = serde_json::to_string_pretty(report)
        .expect("invariant: a report is made of plain values, text keys and finite numbers");
    if to_stdout {
        print_out(&text);
    }
    if let Some(file) = json_file(json) {
        std::fs::write(file, text + "\n")
            .map_err(|error| Failure::Report { path: file.display().to_string(), error })?;
    }
    let outcome = Outcome::ALL.into_iter().find(|o| o.name() == report.outcome);
    Ok(outcome.map_or(FAILED, Outcome::exit_code))
}

fn log_to_stderr(verbose: u8) {
    let level = ["warn", "info", "debug", "trace"][usize::from(verbose.min(3))];
    let filter = tracing_subscriber::EnvFilter::try_from_env("METAMORPH_LOG")
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new(level));
    // Fails only if a subscriber is there already, which then does the job.
    let _ = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none())
        .try_init();
}
