//! Executes commands: from parsed arguments to an exit code.

use crate::cli::args::{Command, CommandLine, ResumeArgs, RunArgs, ViewArgs};
use crate::cli::reference::{completions, man, schema};
use crate::console::escape::Shown;
use crate::console::interrupt::Interrupt;
use crate::console::output::{Json, Output, OutputError, Outputs};
use crate::console::stopwatch::Stopwatch;
use crate::console::terminal::{self, Channel, Live, note, print_data, print_error, print_out};
use crate::experiments::bench::{self, BenchError, PartError};
use crate::experiments::explore::{ExploreError, explore};
use crate::experiments::reproduce::reproduce;
use crate::experiments::sweep::{SweepError, sweep};
use crate::family::metamodule::robot::{self, RobotError};
use crate::family::{self, AgentProcessError, families, read_file, run_simulated, scene};
use crate::plan::{self as planning, PlanError};
use crate::record::journal::{Damage, Journal, JournalError, JournalSession, parts_of, plan_of};
use crate::report::human;
use crate::report::page::page;
use crate::report::schema::Report;
use crate::run::processes;
use crate::run::processes::Processes;
use crate::run::replay::{self, ReplayError};
use crate::scenario::mesh_import::shape::{ShapeError, shape};
use crate::scenario::plan_summary::overview;
use crate::scenario::{LinkKind, Overrides, Plan};
use crate::swarm;
use crate::view::export::{ExportError, export};
use crate::view::scene::Scene;
use crate::view::scene_builder::{self, Shared};
use crate::view::server::{Server, ServerError};
use clap::Parser;
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_sim_bridge::kernel::recording::Log;
use std::ffi::OsString;
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use thiserror::Error;

/// Exit code: the program itself failed.
const FAILED: u8 = 1;
/// Exit code: the command line or the scenario is wrong.
const BAD_USAGE: u8 = 2;
/// Exit code: a replay differs from the journal.
const DIFFERENT: u8 = 8;
/// Exit code: a journal is damaged.
const DAMAGED: u8 = 9;

/// Why a command ended without an outcome.
#[derive(Debug, Error)]
enum Failure {
    /// The scenario or an option is wrong.
    #[error("{0}")]
    Input(String),
    /// A file cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// Man pages cannot be written.
    #[error("{path}: cannot write man pages there: {error}\n  fix: name a directory that is yours")]
    Pages {
        /// The path.
        path: String,
        /// The cause.
        error: std::io::Error,
    },
    /// Signals cannot be caught.
    #[error("cannot listen for Ctrl-C: {0}")]
    Signals(std::io::Error),
    /// The remains of a killed controller cannot be removed.
    #[error("cannot remove what a killed controller left behind: {0}")]
    Watch(std::io::Error),
    /// The process link failed.
    #[error(transparent)]
    Processes(#[from] processes::ProcessError),
    /// The journal cannot be created.
    #[error("--journal: {0}")]
    Journal(JournalError),
    /// A journal cannot be replayed.
    #[error("metamorph: {0}")]
    Replay(#[from] ReplayError),
    /// A sweep failed.
    #[error(transparent)]
    Sweep(#[from] SweepError),
    /// A file cannot be shown.
    #[error("metamorph: {0}, or a scenario that ends in .toml")]
    NoJournal(scene_builder::ReadError),
    /// A journal is damaged; what comes before the damage was shown.
    #[error("metamorph: {0}")]
    Damaged(#[from] Damage),
    /// A run cannot be shown.
    #[error(transparent)]
    Server(#[from] ServerError),
    /// The recording cannot be made.
    #[error("metamorph: {0}")]
    Export(#[from] ExportError),
    /// An agent process ended with an error.
    #[error(transparent)]
    Agent(#[from] AgentProcessError),
    /// A shape cannot be read or shown.
    #[error(transparent)]
    Shape(#[from] ShapeError),
    /// There is no plan to speak of.
    #[error("metamorph: {0}")]
    Plan(#[from] PlanError),
    /// An exploration failed.
    #[error(transparent)]
    Explore(#[from] ExploreError),
    /// A measurement failed.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// A measurement's other process failed.
    #[error(transparent)]
    BenchPart(#[from] PartError),
    /// The Roombots model cannot answer.
    #[error("metamorph: {0}")]
    Robot(#[from] RobotError),
}

impl Failure {
    /// Returns the journal error that caused this, if any.
    fn journal(&self) -> Option<&JournalError> {
        match self {
            Failure::Replay(ReplayError::Journal(error))
            | Failure::Export(ExportError::Journal(error))
            | Failure::Processes(processes::ProcessError::Journal(error)) => Some(error),
            _ => None,
        }
    }

    fn exit_code(&self) -> u8 {
        if self.journal().is_some_and(JournalError::is_damage) {
            return DAMAGED;
        }
        match self {
            Failure::Damaged(_) => DAMAGED,
            Failure::Robot(error) => error.exit_code(),
            Failure::Sweep(error) if error.is_input() => BAD_USAGE,
            Failure::Shape(error) if error.is_input() => BAD_USAGE,
            Failure::Plan(error) if error.is_input() => BAD_USAGE,
            Failure::Export(ExportError::Interrupted { .. }) => Outcome::Aborted.exit_code(),
            Failure::Export(error) if error.is_input() => BAD_USAGE,
            Failure::Output(error) | Failure::Bench(BenchError::Json(error)) if error.is_input() => BAD_USAGE,
            Failure::Explore(ExploreError::Output(error)) if error.is_input() => BAD_USAGE,
            Failure::Plan(_)
            | Failure::Shape(_)
            | Failure::Sweep(_)
            | Failure::Export(_)
            | Failure::Explore(_) => FAILED,
            Failure::Input(_) | Failure::Journal(_) | Failure::Replay(_) | Failure::NoJournal(_) => BAD_USAGE,
            Failure::Output(_) | Failure::Pages { .. } | Failure::Signals(_) | Failure::Watch(_) => FAILED,
            Failure::Processes(_) | Failure::Agent(_) | Failure::Server(_) => FAILED,
            Failure::Bench(BenchError::Interrupted(_)) => Outcome::Aborted.exit_code(),
            Failure::Bench(_) | Failure::BenchPart(_) => FAILED,
        }
    }
}

/// Executes the command given by the arguments (the first is the program's name).
pub fn main(args: impl IntoIterator<Item = OsString>) -> ExitCode {
    let since = Stopwatch::start();
    let args: Vec<OsString> = args.into_iter().collect();
    // Agents are started by the thousand: parsing the full command line costs each of them milliseconds, and
    // memory that it keeps.
    if let Some(done) = short_cut(&args) {
        return match done {
            Ok(()) => ExitCode::SUCCESS,
            Err(failure) => {
                print_error(&failure.to_string());
                ExitCode::from(failure.exit_code())
            }
        };
    }
    let line = match CommandLine::try_parse_from(&args) {
        Ok(line) => line,
        Err(error) => return ExitCode::from(refuse(&error, &args)),
    };
    log_to_stderr(line.verbose);
    let carried_out = Interrupt::listen()
        .map_err(Failure::Signals)
        .and_then(|interrupt| carry_out(line.command, since, &interrupt));
    match carried_out {
        Ok(code) => ExitCode::from(unless_out_failed(code)),
        Err(failure) => {
            print_error(&failure.to_string());
            ExitCode::from(failure.exit_code())
        }
    }
}

/// Prints help or a usage error. Clap chooses the stream and the colours.
fn refuse(error: &clap::Error, args: &[OsString]) -> u8 {
    if !error.use_stderr() {
        note(error.print().and_then(|()| std::io::stdout().flush()));
        return unless_out_failed(0);
    }
    // Clap quotes the arguments, so let it report on their escaped form.
    let shown = args.iter().map(|arg| arg.to_string_lossy().shown());
    let harmless = CommandLine::try_parse_from(shown).err().filter(clap::Error::use_stderr);
    match harmless {
        // A failure here cannot be reported anywhere.
        Some(error) => drop(error.print()),
        None => print_error(&error.to_string()),
    }
    BAD_USAGE
}

/// Returns the exit code, or [`FAILED`] if standard output could not be written: then the result was not
/// seen.
fn unless_out_failed(code: u8) -> u8 {
    let Some(why) = terminal::failure() else { return code };
    print_error(&format!(
        "metamorph: standard output could not be written: {why}\n  fix: let it go to a file with room, or to a program"
    ));
    FAILED
}

/// Runs as an agent if the arguments are those that a swarm starts its agents with.
fn short_cut(args: &[OsString]) -> Option<Result<(), Failure>> {
    match args {
        [_, agent, dashes, rest @ ..] if agent == "agent" && dashes == "--" => {
            Some(family::agent(rest).map_err(Failure::from))
        }
        [_, watch, root] if watch == swarm::WATCH => {
            Some(swarm::watch(Path::new(root)).map_err(Failure::Watch))
        }
        [_, part, rest @ ..] if part == bench::SUBCOMMAND => Some(bench::part(rest).map_err(Failure::from)),
        _ => None,
    }
}

fn carry_out(command: Command, since: Stopwatch, interrupt: &Interrupt) -> Result<u8, Failure> {
    match command {
        Command::Run(args) => run(args, since, interrupt),
        Command::View(args) => view(args, since, interrupt),
        Command::Check(args) => {
            let (path, overrides) = args.plan.into();
            print_out(&overview(&plan(&path, &overrides)?));
            Ok(0)
        }
        Command::Sweep(args) => Ok(sweep(&args.into())?),
        Command::Resume(args) => resume(args, since, interrupt),
        Command::Replay(args) => {
            let quiet = args.quiet;
            let (plan, replayed) = family::replay(&args.into())?;
            if !quiet {
                print_out(&replay::text(&plan, &replayed));
            }
            match replayed.damage {
                Some(damage) => Err(damage.into()),
                None => Ok(if replayed.difference.is_some() { DIFFERENT } else { 0 }),
            }
        }
        Command::Reproduce(args) => Ok(reproduce(&args.into())?),
        Command::Shape(args) => {
            let shown = shape(&args, families())?;
            print_out(&shown.text);
            Ok(if shown.buildable { 0 } else { BAD_USAGE })
        }
        Command::Plan(args) => Ok(planning::plan(&args, interrupt)?),
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
            print_out(&export(&args, families(), |plan| family::of(plan).shown(plan), interrupt)?);
            Ok(0)
        }
        Command::Schema(args) => {
            print_data(&schema(args.of));
            Ok(0)
        }
        Command::Completions(args) => {
            print_data(&completions(args.shell));
            Ok(0)
        }
        Command::Man(args) => {
            let path = args.dir.shown();
            for (file, page) in man(&args).map_err(|error| Failure::Pages { path, error })? {
                Outputs::new().writes("man", &file)?.write(page)?;
            }
            Ok(0)
        }
        Command::Agent(args) => {
            family::agent(&args.args)?;
            Ok(0)
        }
    }
}

fn plan(path: &Path, overrides: &Overrides) -> Result<Plan, Failure> {
    read_file(path, overrides).map_err(|diagnostics| Failure::Input(diagnostics.to_string()))
}

fn run(args: RunArgs, since: Stopwatch, interrupt: &Interrupt) -> Result<u8, Failure> {
    let (path, overrides) = args.plan.into();
    let plan = plan(&path, &overrides)?;
    let mut outputs = Outputs::new();
    outputs.reads("the scenario", &path);
    plan.files.iter().for_each(|file| outputs.reads("a file that the scenario names,", file));
    if let Some(file) = &args.journal {
        // The journal is written during the run; only its permission is checked here.
        outputs.writes("--journal", file)?;
    }
    let asked = Asked { json: args.json, html: args.html, view: args.view, quiet: args.quiet };
    let show = Show::begin(&plan, asked, &mut outputs, interrupt)?;
    let mut live = Live::new(!args.quiet);
    let begin = match overrides.link {
        LinkKind::Sim => JournalSession::simulated,
        LinkKind::Ipc => JournalSession::of_processes,
    };
    let keeping = args.journal.as_deref().map(|file| begin(file, &plan)).transpose();
    let keeping = keeping.map_err(Failure::Journal)?;
    let log = show.log(&plan);
    let report = match overrides.link {
        LinkKind::Sim => run_simulated(&plan, &show.interrupt, &mut live, since, keeping, log),
        LinkKind::Ipc => {
            let (patience, live) = (args.patience, &mut live);
            let processes = Processes { live, since, keeping, patience, scribe: log };
            family::of(&plan).run_processes(&plan, processes)?
        }
    };
    drop(live);
    show.end(&plan, &report, args.journal.as_deref())
}

fn resume(args: ResumeArgs, since: Stopwatch, interrupt: &Interrupt) -> Result<u8, Failure> {
    let left = processes::left_behind(families(), &args.file)?;
    let plan = left.plan.clone();
    let mut outputs = Outputs::new();
    outputs.reads("the scenario", Path::new(&plan.origin));
    plan.files.iter().for_each(|file| outputs.reads("a file that the scenario names,", file));
    outputs.reads_directory("a part of the journal,", &parts_of(&args.file));
    outputs.writes("the journal", &args.file)?;
    let asked = Asked { json: args.json, html: args.html, view: args.view, quiet: args.quiet };
    let show = Show::begin(&plan, asked, &mut outputs, interrupt)?;
    let mut live = Live::new(!args.quiet);
    let report = family::of(&plan).resume(left, &mut live, since, show.log(&plan))?;
    drop(live);
    show.end(&plan, &report, Some(&args.file))
}

/// The requested outputs of a run.
struct Asked {
    json: Option<PathBuf>,
    html: Option<PathBuf>,
    view: bool,
    quiet: bool,
}

/// Observers of a run: the page during it, the reports afterwards.
struct Show {
    json: Json,
    html: Option<Output>,
    view: bool,
    quiet: bool,
    scene: Option<Shared>,
    interrupt: Interrupt,
}

impl Show {
    fn begin(
        plan: &Plan,
        asked: Asked,
        outputs: &mut Outputs,
        interrupt: &Interrupt,
    ) -> Result<Show, Failure> {
        interrupt.begin();
        let Asked { json, html, view, quiet } = asked;
        let json = Json::of(json.as_deref(), outputs)?;
        let html = html.map(|file| outputs.writes("--html", &file)).transpose()?;
        let watched = view || html.is_some();
        let messages = plan.overrides.link == LinkKind::Sim;
        let scene = watched.then(|| Shared::new(scene(plan, messages)));
        if let Some(scene) = scene.as_ref().filter(|_| view) {
            // Standard output is for the report.
            print_error(&address(scene)?);
        }
        Ok(Show { json, html, view, quiet, scene, interrupt: interrupt.clone() })
    }

    /// Returns the log that records go to so that they are shown.
    fn log(&self, plan: &Plan) -> Option<Log> {
        self.scene.as_ref().map(|scene| family::of(plan).shown(plan).scribe(scene.clone()))
    }

    fn end(self, plan: &Plan, report: &Report, journal: Option<&Path>) -> Result<u8, Failure> {
        let Show { json, html, view, quiet, scene, interrupt } = self;
        if let Some(scene) = &scene {
            finish(scene, plan, report, journal);
        }
        let channel = Channel::beside(json.is_out(), quiet);
        // The terminal repeats the command as typed here; files may be read elsewhere.
        let here = Report { repeat: plan.repeat_here(), ..report.clone() };
        channel.say(&human(&here, plan.swarm.words(), channel.paint()));
        // Write each, even if another fails.
        let written = json.write(report);
        if let (Some(file), Some(scene)) = (&html, &scene) {
            let scene = scene.lock();
            let (width, bins) = scene.bins();
            file.write(page(report, plan, width, bins))?;
        }
        written?;
        if view {
            interrupt.wait();
        }
        let outcome = Outcome::ALL.into_iter().find(|o| o.name() == report.outcome);
        Ok(outcome.map_or(FAILED, Outcome::exit_code))
    }
}

/// Serves a scene, and returns the text with its address.
fn address(scene: &Shared) -> Result<String, ServerError> {
    let server = Server::start(scene.clone())?;
    Ok(format!("open {} in a browser\nCtrl-C ends it", server.address()))
}

/// Ends a scene with the report. Messages between processes are in the journal only.
fn finish(scene: &Shared, plan: &Plan, report: &Report, journal: Option<&Path>) {
    if plan.overrides.link == LinkKind::Ipc
        && let Some(journal) = journal
    {
        match recorded(journal) {
            Ok((mut whole, None)) => {
                // First complete the scene: a page stops asking once a run is over.
                whole.finish(report.clone());
                return scene.replace(whole);
            }
            Ok((_, Some(damage))) => tracing::warn!("the page shows no messages: {damage}"),
            Err(error) => tracing::warn!("the page shows no messages: {error}"),
        }
    }
    scene.lock().finish(report.clone());
}

/// Reads the scene of a journal, up to its damage.
fn recorded(file: &Path) -> Result<(Scene, Option<Damage>), scene_builder::ReadError> {
    let mut journal = Journal::open(file)?;
    let plan = plan_of(families(), journal.head())?;
    let scene = Shared::new(scene(&plan, true));
    let log = family::of(&plan).shown(&plan).scribe(scene.clone());
    let whole = journal.by_ref().try_for_each(|record| {
        log.borrow_mut().put(&record?);
        Ok(())
    });
    drop(log);
    let (mut scene, damage) = (scene.into_inner(), whole.err());
    let troubles = journal.troubles().into_iter().chain(damage.as_ref().map(Damage::to_string));
    scene.end(troubles.collect());
    Ok((scene, damage))
}

fn view(args: ViewArgs, since: Stopwatch, interrupt: &Interrupt) -> Result<u8, Failure> {
    if args.file.extension().is_none_or(|extension| extension != "toml") {
        let (scene, damage) = recorded(&args.file).map_err(|error| match error {
            scene_builder::ReadError::Journal(JournalError::Damaged(damage)) => Failure::Damaged(damage),
            error => Failure::NoJournal(error),
        })?;
        for trouble in scene.troubles() {
            print_error(&format!("note: {trouble}"));
        }
        interrupt.begin();
        print_out(&address(&Shared::new(scene))?);
        wait_for_end(interrupt);
        return damage.map_or(Ok(0), |damage| Err(damage.into()));
    }
    let file = args.file.clone();
    let plan = plan(&file, &args.overrides())?;
    let scene = Shared::new(scene(&plan, true));
    interrupt.begin();
    print_out(&address(&scene)?);
    let scribe = Some(family::of(&plan).shown(&plan).scribe(scene.clone()));
    let report = run_simulated(&plan, interrupt, &mut Live::new(true), since, None, scribe);
    scene.lock().finish(report);
    wait_for_end(interrupt);
    Ok(0)
}

/// Waits until the page is no longer wanted. Returns at once if its address cannot be printed.
fn wait_for_end(interrupt: &Interrupt) {
    if terminal::failure().is_none() {
        interrupt.wait();
    }
}

fn log_to_stderr(verbose: u8) {
    let level = ["warn", "info", "debug", "trace"][usize::from(verbose.min(3))];
    let filter = tracing_subscriber::EnvFilter::try_from_env("METAMORPH_LOG")
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new(level));
    // Fails only if a subscriber is already installed.
    let _ = tracing_subscriber::fmt()
        .with_env_filter(filter)
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal() && std::env::var_os("NO_COLOR").is_none())
        .try_init();
}
