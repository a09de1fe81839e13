//! Carries commands out: from what was typed to an exit code.

use crate::bench::{self, BenchError, PartError};
use crate::command::{Command, CommandLine, ResumeArgs, RunArgs, ViewArgs};
use crate::explore::{ExploreError, explore};
use crate::export::{ExportError, export};
use crate::interrupt::Interrupt;
use crate::journal::{Journal, JournalError, Keeping, plan_of};
use crate::overview::overview;
use crate::processes;
use crate::reference::{completions, man, schema};
use crate::replay::{self, ReplayError, replay};
use crate::report::human;
use crate::report::page::page;
use crate::report::schema::Report;
use crate::reproduce::reproduce;
use crate::robot::{self, RobotError};
use crate::scenario::{LinkKind, Overrides, Plan, read_file};
use crate::simulated::run_simulated;
use crate::solid::shape::{ShapeError, shape};
use crate::stopwatch::Stopwatch;
use crate::sweep::{SweepError, sweep};
use crate::terminal::{Channel, Live, complain, print_out};
use crate::view::scene::Scene;
use crate::view::scribe::{self, Shared};
use crate::view::server::{Server, ServerError};
use clap::Parser;
use metamorph_sim_bridge::chronicle::Log;
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
        "{option} {path}: cannot write there: {error}\n  fix: name a file in a directory that exists and is yours{or}"
    )]
    Unwritable {
        /// What asked for it.
        option: &'static str,
        /// What else could be named.
        or: &'static str,
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
    /// Man pages could not be written.
    #[error("{path}: cannot write man pages there: {error}\n  fix: name a directory that is yours")]
    Pages {
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
    /// A file cannot be shown.
    #[error(
        "metamorph: {0}\n  fix: name a whole journal that `metamorph run --journal` of this version wrote, or a scenario that ends in .toml"
    )]
    NoJournal(scribe::ReadError),
    /// A run cannot be shown.
    #[error(transparent)]
    Server(#[from] ServerError),
    /// There is no recording.
    #[error("metamorph: {0}")]
    Export(#[from] ExportError),
    /// There is no shape.
    #[error(transparent)]
    Shape(#[from] ShapeError),
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
            Failure::Shape(error) if error.is_input() => BAD_USAGE,
            Failure::Export(error) if error.is_input() => BAD_USAGE,
            Failure::Shape(_) | Failure::Sweep(_) | Failure::Export(_) | Failure::Explore(_) => FAILED,
            Failure::Input(_) | Failure::Unwritable { .. } | Failure::Journal(_) | Failure::Replay(_) => {
                BAD_USAGE
            }
            Failure::NoJournal(_) => BAD_USAGE,
            Failure::Report { .. } | Failure::Pages { .. } | Failure::Signals(_) => FAILED,
            Failure::Processes(_) | Failure::Server(_) => FAILED,
            Failure::Bench(BenchError::Json { .. }) => BAD_USAGE,
            Failure::Bench(_) | Failure::BenchPart(_) => FAILED,
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
        Command::View(args) => view(args, since),
        Command::Check(args) => {
            let (path, overrides) = args.plan.into();
            print_out(&overview(&plan(&path, &overrides)?));
            Ok(0)
        }
        Command::Sweep(args) => Ok(sweep(&args.into())?),
        Command::Resume(args) => resume(args, since),
        Command::Replay(args) => {
            let quiet = args.quiet;
            let (plan, replayed) = replay(&args.into())?;
            if !quiet {
                print_out(&replay::text(&plan, &replayed));
            }
            Ok(if replayed.difference.is_some() { DIFFERENT } else { 0 })
        }
        Command::Reproduce(args) => Ok(reproduce(&args.into())?),
        Command::Shape(args) => {
            let shown = shape(&args)?;
            print_out(&shown.text);
            Ok(if shown.buildable { 0 } else { BAD_USAGE })
        }
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
        Command::Export(args) => {
            print_out(&export(&args)?);
            Ok(0)
        }
        Command::Schema(args) => {
            print_out(&schema(args.of));
            Ok(0)
        }
        Command::Completions(args) => {
            print_out(&completions(args.shell));
            Ok(0)
        }
        Command::Man(args) => {
            let path = args.dir.display().to_string();
            man(&args).map_err(|error| Failure::Pages { path, error })?;
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
    let asked = Asked { json: args.json, html: args.html, view: args.view, quiet: args.quiet };
    let show = Show::begin(&plan, asked)?;
    let mut live = Live::new(!args.quiet);
    let begin = match overrides.link {
        LinkKind::Sim => Keeping::simulated,
        LinkKind::Ipc => Keeping::of_processes,
    };
    let keeping = args.journal.as_deref().map(|file| begin(file, &plan)).transpose();
    let keeping = keeping.map_err(Failure::Journal)?;
    let log = show.log(&plan);
    let report = match overrides.link {
        LinkKind::Sim => run_simulated(&plan, &show.interrupt, &mut live, since, keeping, log),
        LinkKind::Ipc => processes::run_processes(&plan, &mut live, since, keeping, args.patience, log)?,
    };
    drop(live);
    show.end(&plan, &report, args.journal.as_deref())
}

fn resume(args: ResumeArgs, since: Stopwatch) -> Result<u8, Failure> {
    let left = processes::left_behind(&args.file)?;
    let plan = left.plan.clone();
    let asked = Asked { json: args.json, html: args.html, view: args.view, quiet: args.quiet };
    let show = Show::begin(&plan, asked)?;
    let mut live = Live::new(!args.quiet);
    let report = processes::resume_processes(left, &mut live, since, show.log(&plan))?;
    drop(live);
    show.end(&plan, &report, Some(&args.file))
}

/// What shall become of a run, besides its end.
struct Asked {
    json: Option<PathBuf>,
    html: Option<PathBuf>,
    view: bool,
    quiet: bool,
}

/// Whoever looks at a run: the page while it goes on, the reports afterwards.
struct Show {
    asked: Asked,
    scene: Option<Shared>,
    interrupt: Interrupt,
}

impl Show {
    fn begin(plan: &Plan, asked: Asked) -> Result<Show, Failure> {
        may_write(&asked.json)?;
        if let Some(file) = &asked.html {
            check_writable("--html", "", file)?;
        }
        let interrupt = Interrupt::listen().map_err(Failure::Signals)?;
        let watched = asked.view || asked.html.is_some();
        let messages = plan.overrides.link == LinkKind::Sim;
        let scene = watched.then(|| Shared::new(Scene::new(plan, messages)));
        if let Some(scene) = scene.as_ref().filter(|_| asked.view) {
            // Standard output is for the report.
            complain(&shown(scene)?);
        }
        Ok(Show { asked, scene, interrupt })
    }

    /// Where records go so that they are seen.
    fn log(&self, plan: &Plan) -> Option<Log> {
        self.scene.as_ref().map(|scene| scribe::log(plan, scene))
    }

    fn end(self, plan: &Plan, report: &Report, journal: Option<&Path>) -> Result<u8, Failure> {
        let Show { asked, scene, interrupt } = self;
        if let Some(scene) = &scene {
            finish(scene, plan, report, journal);
        }
        let code = deliver(report, &asked.json, asked.quiet)?;
        if let (Some(file), Some(scene)) = (&asked.html, &scene) {
            let scene = scene.lock();
            let (width, bins) = scene.bins();
            write(file, &page(report, plan, width, bins))?;
        }
        if asked.view {
            interrupt.wait();
        }
        Ok(code)
    }
}

/// Finds out now, and not after a long run, whether a file can be written. What it holds is kept.
fn check_writable(option: &'static str, or: &'static str, file: &Path) -> Result<(), Failure> {
    let path = || file.display().to_string();
    let opened = OpenOptions::new().append(true).create(true).open(file);
    opened.map(drop).map_err(|error| Failure::Unwritable { option, or, path: path(), error })
}

fn write(file: &Path, text: &str) -> Result<(), Failure> {
    let path = file.display().to_string();
    std::fs::write(file, text).map_err(|error| Failure::Report { path, error })
}

/// Serves a scene, and says where.
fn shown(scene: &Shared) -> Result<String, ServerError> {
    let server = Server::start(scene.clone())?;
    Ok(format!("look at it at {}\nCtrl-C ends it", server.address()))
}

/// Ends a scene with the report. What processes have said to each other is in their journal only.
fn finish(scene: &Shared, plan: &Plan, report: &Report, journal: Option<&Path>) {
    if plan.overrides.link == LinkKind::Ipc
        && let Some(journal) = journal
    {
        match recorded(journal) {
            Ok(mut whole) => {
                // Before a page can see it: a page asks no more once a run is over.
                whole.finish(report.clone());
                return scene.replace(whole);
            }
            Err(error) => tracing::warn!("the page goes without messages: {error}"),
        }
    }
    scene.lock().finish(report.clone());
}

/// The scene of a journal.
fn recorded(file: &Path) -> Result<Scene, scribe::ReadError> {
    let mut journal = Journal::open(file)?;
    let plan = plan_of(journal.head())?;
    let scene = Shared::new(Scene::new(&plan, true));
    let log = scribe::log(&plan, &scene);
    journal.by_ref().for_each(|record| log.borrow_mut().put(&record));
    drop(log);
    let mut scene = scene.into_inner();
    scene.end(journal.troubles());
    Ok(scene)
}

fn view(args: ViewArgs, since: Stopwatch) -> Result<u8, Failure> {
    let interrupt = Interrupt::listen().map_err(Failure::Signals)?;
    if args.file.extension().is_none_or(|extension| extension != "toml") {
        let scene = recorded(&args.file).map_err(Failure::NoJournal)?;
        for trouble in scene.troubles() {
            complain(&format!("note: {trouble}"));
        }
        print_out(&shown(&Shared::new(scene))?);
    } else {
        let file = args.file.clone();
        let plan = plan(&file, &args.overrides())?;
        let scene = Shared::new(Scene::new(&plan, true));
        print_out(&shown(&scene)?);
        let scribe = Some(scribe::log(&plan, &scene));
        let report = run_simulated(&plan, &interrupt, &mut Live::new(true), since, None, scribe);
        scene.lock().finish(report);
    }
    interrupt.wait();
    Ok(0)
}

/// Finds out now whether the JSON can be written.
fn may_write(json: &Option<PathBuf>) -> Result<(), Failure> {
    json_file(json).map_or(Ok(()), |file| check_writable("--json", ", or `-`", file))
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
        write(file, &(text + "\n"))?;
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
