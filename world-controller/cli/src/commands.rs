//! All commands: the arguments of each, and the function that executes it.

use crate::args::*;
use crate::assemblies;
use crate::doctor::{DoctorArgs, doctor};
use crate::examples::*;
use crate::figures::{RenderArgs, render};
use crate::host::{self, HostArgs};
use crate::learn::{self, LearnArgs};
use crate::modules::modules;
use crate::new::{NewArgs, new};
use crate::plan::{self, PlanArgs as ReconfigurationArgs};
use crate::reference::{CompletionArgs, ManArgs, PagesError, SchemaArgs, completions, man, schema};
use crate::robot::{self, RobotArgs};
use crate::runs::{self, resume, run, view};
use crate::scenarios::{ScenariosArgs, scenarios};
use crate::shape::{ShapeArgs, shape};
use crate::structure::{self, StructureArgs};
use crate::structures::{Format, export_structure};
use clap::{ArgAction, Parser, Subcommand};
use metamorph_bench as bench;
use metamorph_console::interrupt::Interrupt;
use metamorph_console::output::Outputs;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::{print_data, print_out};
use metamorph_experiments::diff::{DiffArgs, diff};
use metamorph_experiments::explore::explore;
use metamorph_experiments::sweep::sweep;
use metamorph_people::pointing::{self, PointArgs};
use metamorph_people::room::{self, RoomArgs};
use metamorph_people::studio::{self, StudioArgs};
use metamorph_processes::family::{self, families};
use metamorph_processes::record::journal::JournalFailure;
use metamorph_processes::run::processes;
use metamorph_processes::run::replay;
use metamorph_reproduce::reproduce;
use metamorph_scenario::plan_summary::overview;
use metamorph_text::command_error::{BAD_USAGE, DIFFERENT, Failure};
use metamorph_text::escape::Shown;
use metamorph_view::export::commands::export_commands;
use metamorph_view::export::{ExportArgs, export};

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
    /// Compare two sweeps, with intervals and tests, or two reports
    #[command(after_help = DIFF_EXAMPLES)]
    Diff(DiffArgs),
    /// Resume a run whose controller was killed
    #[command(after_help = format!("{RESUME_EXAMPLES}\n\n{EXIT_CODES}{DAMAGED_EXIT_CODE}"))]
    Resume(ResumeArgs),
    /// Serve as one of several hosts of a swarm: the daemon that starts and supervises its share
    #[command(after_help = host::EXAMPLES)]
    Host(HostArgs),
    /// Replay the journal of a run, and report the first difference
    #[command(after_help = REPLAY_EXAMPLES)]
    Replay(ReplayArgs),
    /// Run experiments of the thesis and print the published numbers beside ours
    #[command(after_help = REPRODUCE_EXAMPLES)]
    Reproduce(ReproduceArgs),
    /// Measure both links beside bare mechanisms, in tables and as JSON
    #[command(after_help = BENCH_EXAMPLES)]
    Bench(BenchArgs),
    /// Plan the reconfiguration of free modules, exactly, or a structure of metamodules and elements; check, compare and count
    #[command(after_help = plan::EXAMPLES)]
    Plan(Box<ReconfigurationArgs>),
    /// Find body and limbs of a structure, and its networks of oscillators
    #[command(after_help = structure::EXAMPLES)]
    Structure(StructureArgs),
    /// Learn a gait of a structure in simulation, with bodies
    #[command(after_help = learn::EXAMPLES)]
    Learn(Box<LearnArgs>),
    /// Find the floor tile that a tracked person points at
    #[command(after_help = pointing::EXAMPLES)]
    Point(PointArgs),
    /// Check a room with furniture against its constraints, put it right, measure it, or write the scenario that builds it
    #[command(after_help = room::EXAMPLES)]
    Room(Box<RoomArgs>),
    /// Generate random scenarios, run them, and shrink failures
    #[command(after_help = EXPLORE_EXAMPLES)]
    Explore(ExploreArgs),
    /// Check a scenario and show what would run
    #[command(after_help = CHECK_EXAMPLES)]
    Check(CheckArgs),
    /// Write a scenario to begin with: every key with its default and meaning
    #[command(after_help = NEW_EXAMPLES)]
    New(NewArgs),
    /// List the scenarios that ship with the program
    #[command(after_help = SCENARIOS_EXAMPLES)]
    Scenarios(ScenariosArgs),
    /// Convert a solid to cells, write it as a scenario, or pair the cells to modules
    #[command(after_help = SHAPE_EXAMPLES)]
    Shape(ShapeArgs),
    /// Draw a structure of cubes or furnish a room in the browser, start what builds it, command it
    #[command(after_help = studio::EXAMPLES)]
    Studio(StudioArgs),
    /// Check what of this machine limits a swarm of processes, and how to raise it
    #[command(after_help = DOCTOR_EXAMPLES)]
    Doctor(DoctorArgs),
    /// Remove what killed runs left behind
    #[command(after_help = CLEAN_EXAMPLES)]
    Clean(CleanArgs),
    /// Query the Roombots model: shapes, moves, kinematics, published tables
    Robot(RobotArgs),
    /// Draw figures of a run for papers: SVG, PNG, GIF and APNG, without a browser or a display
    #[command(after_help = RENDER_EXAMPLES)]
    Render(Box<RenderArgs>),
    /// Export a journal as a recording for other viewers, or its structure at an instant as URDF or SDF
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

/// Executes a command, and returns the exit code. `since` was started with the program.
pub fn execute(command: Command, since: Stopwatch, interrupt: &Interrupt) -> Result<u8, Failure> {
    match command {
        Command::Run(args) => run(args, since, interrupt),
        Command::View(args) => view(&args, since, interrupt),
        Command::Check(args) => {
            let hosts = args.plan.hosts.as_ref().and_then(|hosts| hosts.file.clone());
            let (path, overrides) = args.plan.into();
            let plan = runs::plan(&path, &overrides)?;
            print_out(&overview(&plan));
            hosts.map_or(Ok(0), |file| host::check(&file, &plan))
        }
        Command::New(args) => Ok(new(&args)?),
        Command::Scenarios(args) => scenarios(&args),
        Command::Sweep(args) => Ok(sweep(&args.into())?),
        Command::Diff(args) => Ok(diff(&args)?),
        Command::Resume(args) => resume(args, since, interrupt),
        Command::Host(args) => host::host(args, interrupt),
        Command::Replay(args) => {
            let quiet = args.quiet;
            let (plan, replayed) = family::replay(&args.into())?;
            if !quiet {
                print_out(&replay::text(&plan, &replayed));
            }
            match replayed.damage {
                Some(damage) => Err(JournalFailure::from(damage).into()),
                None => Ok(if replayed.difference.is_some() { DIFFERENT } else { 0 }),
            }
        }
        Command::Reproduce(args) => Ok(reproduce(&args.into())?),
        Command::Shape(args) if args.modules => Ok(modules(&args)?),
        Command::Shape(args) => {
            let shown = shape(&args, families())?;
            print_out(&shown.text);
            Ok(if shown.buildable { 0 } else { BAD_USAGE })
        }
        Command::Plan(args) => {
            if let Some(scenario) = &args.scenario {
                return assemblies::plan(scenario, &args);
            }
            let (exit_code, plan) = plan::plan(&args, interrupt)?;
            if let Some(plan) = plan.filter(|_| args.view) {
                runs::view_plan(&plan, args.port, interrupt)?;
            }
            Ok(exit_code)
        }
        Command::Structure(args) => Ok(structure::structure(&args)?),
        Command::Learn(args) => Ok(learn::learn(&args, interrupt)?),
        Command::Point(args) => {
            pointing::point(&args)?;
            Ok(0)
        }
        Command::Room(args) => Ok(room::room(&args)?),
        Command::Explore(args) => Ok(explore(&args.into())?),
        Command::Bench(args) => Ok(bench::bench(&args.into())?),
        Command::Studio(args) => Ok(studio::studio(&args, interrupt)?),
        Command::Doctor(args) => Ok(doctor(&args)),
        Command::Clean(args) => {
            print_out(&processes::clean_up()?);
            args.hosts.as_ref().map_or(Ok(0), host::clean)
        }
        Command::Robot(args) => {
            robot::run(args)?;
            Ok(0)
        }
        Command::Render(args) => render(*args, since, interrupt),
        Command::Export(args) => {
            let said = match (&args.mcap, &args.urdf, &args.sdf, &args.commands) {
                (Some(file), ..) => {
                    export(&args, file, families(), |plan| family::of(plan).shown(plan), interrupt)?
                }
                (None, Some(file), ..) => export_structure(&args, file, Format::Urdf)?,
                (None, None, Some(file), _) => export_structure(&args, file, Format::Sdf)?,
                (None, None, None, Some(file)) => export_commands(&args.journal, file, families())?,
                (None, None, None, None) => unreachable!("invariant: clap asks for one of them"),
            };
            print_out(&said);
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
            for (file, page) in man(&args).map_err(|error| PagesError { path, error })? {
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
