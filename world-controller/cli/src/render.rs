//! The command `render`: figures of a journal, or of a scenario that is simulated as far as it is needed.

use crate::scenario_args::SimulatedArgs;
use crate::{plots, runs};
use clap::Args;
use metamorph_console::command::{CommandOf, Group};
use metamorph_console::interrupt::Interrupt;
use metamorph_console::output::{Output, OutputError, Outputs};
use metamorph_console::output_kind::OutputKind;
use metamorph_console::stopwatch::Stopwatch;
use metamorph_console::terminal::{Channel, Live, print_data, print_error};
use metamorph_experiments::sweep::plot::Quantity;
use metamorph_processes::family::{self, Recorded};
use metamorph_processes::record::journal::JournalFailure;
use metamorph_processes::record::journal::ReadError;
use metamorph_processes::run::PageChannels;
use metamorph_processes::run::simulated::{Simulation, simulate};
use metamorph_protocol::time::Time;
use metamorph_report::progress;
use metamorph_scenario::Plan;
use metamorph_scenario::shipped::is_scenario;
use metamorph_scene::beginning::Heading;
use metamorph_scene::bodies::ShownSwarm;
use metamorph_scene::figure::FigureError;
use metamorph_scene::figure::options::Moment;
use metamorph_scene::figure::palette::Theme;
use metamorph_scene::scene::Scene;
use metamorph_scene::shared::Shared;
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_sim_bridge::director::progress::Progress;
use metamorph_text::command_error::{BAD_USAGE, CommandError, FAILED, Failure};
use metamorph_text::escape::Shown;
use metamorph_text::format::{bytes, many, seconds};
use metamorph_view::request::{self, Kind, Request, Source, Still};
use std::io::IsTerminal;
use std::path::PathBuf;
use thiserror::Error;

/// Arguments of `render`.
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// A journal that `run --journal` wrote; or a scenario (a file whose name ends in .toml or .json, `-` for standard input, or a name that
    /// `metamorph scenarios` lists), which is simulated as far as it is needed; or a directory that `sweep --out`
    /// wrote, or a report that `run --json` wrote, which are plotted
    #[arg(value_name = "JOURNAL|SCENARIO|SWEEP|REPORT")]
    pub file: PathBuf,
    /// Write a figure (.svg, .pdf, .png) or a moving picture (.gif, .apng, or .mp4 by ffmpeg) to this file; with --every and {i} in the name of
    /// a figure, one file for each moment, numbered from 0000; default: SVG on standard output
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// What is drawn of the run, and how.
    #[command(flatten)]
    pub request: Request,
    /// Of a sweep or a report: what is plotted; default: built, of a report messages
    #[arg(long, value_enum, value_name = "WHAT")]
    pub plot: Option<Quantity>,
    /// Of a sweep or a report: write the table behind the plot to this file, as CSV
    #[arg(long, value_name = "FILE")]
    pub table: Option<PathBuf>,
    /// What is simulated.
    #[command(flatten)]
    pub simulated: SimulatedArgs,
    /// Print errors only
    #[arg(short, long)]
    pub quiet: bool,
}

/// Destination of the figures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Target {
    /// One file.
    File(Kind),
    /// Figures of many moments.
    Numbered(Still),
}

/// Stands for the number of a figure in the name of its file.
const NUMBER: &str = "{i}";

/// Errors of `render`.
#[derive(Debug, Error)]
enum RenderError {
    #[error("--out {}: the name says no format\n  fix: name a file that ends in .svg, .pdf, .png, .gif, .apng or .mp4", .0.shown())]
    Format(PathBuf),
    #[error("standard output is a terminal\n  fix: name a file with --out, or redirect it")]
    Terminal,
    #[error(
        "{0}: only sweeps and reports are plotted\n  fix: leave it out, or name the directory of a sweep or a report"
    )]
    OfPlot(&'static str),
    #[error(transparent)]
    Figure(#[from] FigureError),
    #[error(transparent)]
    Output(#[from] OutputError),
    #[error(transparent)]
    Journal(#[from] JournalFailure),
    #[error(transparent)]
    Read(#[from] ReadError),
}

impl CommandError for RenderError {
    fn exit_code(&self) -> u8 {
        match self {
            RenderError::Figure(FigureError::Interrupted) => Outcome::Aborted.exit_code(),
            RenderError::Figure(FigureError::Write(_)) => FAILED,
            RenderError::Output(error) => error.exit_code(),
            RenderError::Journal(error) => error.exit_code(),
            RenderError::Read(error) => error.exit_code(),
            _ => BAD_USAGE,
        }
    }
    fn text(&self) -> String {
        match self {
            RenderError::Read(error) => error.text(),
            RenderError::Journal(error) => error.text(),
            _ => format!("metamorph: {self}"),
        }
    }
}

/// A run to draw.
struct Drawn {
    plan: Plan,
    scene: Scene,
    swarm: Box<dyn ShownSwarm>,
    /// The hash of the whole run, if it was simulated to its end.
    trace: Option<String>,
}

/// Draws figures.
pub fn render(args: RenderArgs, since: Stopwatch, interrupt: &Interrupt) -> Result<u8, Failure> {
    if plots::is_plotted(&args.file) {
        return plots::render(&args);
    }
    if let Some(option) = [("--plot", args.plot.is_some()), ("--table", args.table.is_some())]
        .into_iter()
        .find_map(|(option, given)| given.then_some(option))
    {
        return Err(RenderError::OfPlot(option).into());
    }
    let target = target(&args)?;
    let mut outputs = Outputs::new();
    outputs.reads("the run", &args.file);
    let output = args.out.as_deref().filter(|_| !matches!(target, Target::Numbered(_)));
    let output = output.map(|file| outputs.writes("--out", file, OutputKind::Picture)).transpose()?;
    interrupt.begin();
    let drawn = if is_scenario(family::sources(), &args.file) {
        simulated(&args, since, interrupt)?
    } else {
        read(&args)?
    };
    let origin = runs::origin(&drawn.plan, &args.file, &args.simulated);
    let source =
        Source { scene: &drawn.scene, swarm: &*drawn.swarm, origin: &origin, trace: drawn.trace.clone() };
    let shown = match target {
        Target::File(kind) => {
            let file = request::file(&source, &args.request, kind, &|| !interrupt.is_set());
            write(file.map_err(RenderError::from)?, output.as_ref())?
        }
        Target::Numbered(format) => Some(write_series(&args, format, &source, &mut outputs, interrupt)?),
    };
    if let (Some(file), Some(shown)) = (&args.out, shown) {
        let modules = many(drawn.plan.swarm.len() as u64, "module");
        Channel::beside(false, args.quiet).say(&format!("{}: {modules} {shown}\n", file.shown()));
    }
    Ok(0)
}

/// Returns what is written, before anything is simulated for it.
fn target(args: &RenderArgs) -> Result<Target, RenderError> {
    let every = args.request.every;
    let Some(file) = &args.out else {
        if std::io::stdout().is_terminal() {
            return Err(RenderError::Terminal);
        }
        return if every.is_some() {
            Err(FigureError::Every.into())
        } else {
            Ok(Target::File(Kind::Still(Still::Svg)))
        };
    };
    let kind = file.extension().and_then(|extension| Kind::of_extension(extension.to_str()?));
    let kind = kind.ok_or_else(|| RenderError::Format(file.clone()))?;
    let is_numbered = file.file_name().is_some_and(|name| name.to_string_lossy().contains(NUMBER));
    match (kind, every) {
        (Kind::Still(format), Some(_)) if is_numbered => Ok(Target::Numbered(format)),
        (Kind::Still(_), Some(_)) => Err(FigureError::Every.into()),
        (Kind::Moving(_), None) => Err(FigureError::NoEvery.into()),
        (Kind::Moving(_), _) if args.request.style.theme == Theme::Transparent => {
            Err(FigureError::Transparent.into())
        }
        _ => Ok(Target::File(kind)),
    }
}

/// Simulates a scenario, no longer than needed.
fn simulated(args: &RenderArgs, since: Stopwatch, interrupt: &Interrupt) -> Result<Drawn, Failure> {
    let plan = runs::plan(&args.file, &args.simulated.overrides())?;
    let swarm = family::of(&plan).shown(&plan);
    let until = match args.request.at {
        // Messages and distances are known by time bins, so the last bin is completed.
        Moment::At(at) => Some(swarm.stage().time_step.0.max(1)).map(|bin| Time((at.0 / bin + 1) * bin)),
        Moment::Share(_) => None,
    };
    let scene = Shared::new(Scene::new(Heading::of(&plan), &*swarm, true));
    let scribe = Some(family::of(&plan).shown(&plan).scribe(scene.clone()));
    let mut live = Live::new(!args.quiet);
    let mut watch = |now: Time, so_far: &dyn Fn() -> Progress| {
        live.show(|| progress(&plan, now, &so_far()));
        until.is_none_or(|until| now <= until) && !interrupt.is_set()
    };
    let page = PageChannels { scribe, ..PageChannels::default() };
    let simulation = Simulation { since, watch: &mut watch, keeping: None, page, search: false };
    let (report, _) = simulate(&plan, simulation);
    live.clear();
    if interrupt.is_set() {
        return Err(RenderError::Figure(FigureError::Interrupted).into());
    }
    let trace = report.trace_hash.clone();
    let mut scene = scene.into_inner();
    scene.finish(report);
    Ok(Drawn { scene, swarm, trace, plan })
}

/// Reads a journal.
fn read(args: &RenderArgs) -> Result<Drawn, Failure> {
    args.simulated.must_be_left_out()?;
    let Recorded { plan, scene, damage } = family::recorded(&args.file).map_err(RenderError::from)?;
    if let Some(damage) = damage {
        return Err(RenderError::from(JournalFailure::from(damage)).into());
    }
    for trouble in scene.troubles() {
        print_error(&format!("note: {trouble}"));
    }
    Ok(Drawn { swarm: family::of(&plan).shown(&plan), plan, scene, trace: None })
}

/// Writes a figure, and returns what was written; `None` if it went to standard output.
fn write(file: request::File, output: Option<&Output>) -> Result<Option<String>, RenderError> {
    let request::File { data, shown } = file;
    match output {
        Some(output) => {
            output.write(&data)?;
            Ok(Some(format!("{shown}, {}", bytes(data.len() as u64))))
        }
        None => {
            print_data(&String::from_utf8_lossy(&data));
            Ok(None)
        }
    }
}

/// Writes the figures of many moments, and returns what was written.
fn write_series(
    args: &RenderArgs,
    format: Still,
    source: &Source<'_>,
    outputs: &mut Outputs,
    interrupt: &Interrupt,
) -> Result<String, RenderError> {
    let (Some(file), Some(every)) = (&args.out, args.request.every) else {
        return Err(FigureError::Every.into());
    };
    let name = file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    if let Some(directory) = file.parent().filter(|directory| !directory.as_os_str().is_empty()) {
        std::fs::create_dir_all(directory).map_err(FigureError::from)?;
    }
    let style = args.request.style(false);
    let end = source.time(args.request.at)?;
    let figure = source.figure(&args.request, &style, end);
    let written = figure.series(every, end, &|| !interrupt.is_set(), |number, picture| {
        let path = file.with_file_name(name.replace(NUMBER, &format!("{number:04}")));
        let (data, _) = request::still(&figure, picture, format, &style)?;
        Ok::<_, RenderError>(outputs.writes("--out", &path, OutputKind::Picture)?.write(&data)?)
    })?;
    Ok(format!("until {}, {}", seconds(end.as_secs_f64()), many(written.into(), "file")))
}

/// Examples for the help.
const EXAMPLES: &str = "\
Examples:
  metamorph render slab-to-sphere --at 50% --out slab-to-sphere.svg
  metamorph render slab-to-sphere --section 'x<11' --color level --width 180mm --out cut.png
  metamorph render swarm --every 250ms --out swarm.gif
  metamorph render swarm --every 5s --out 'frames/{i}.png'
  metamorph render swarm --at 3s --links waits,messages --out links.svg
  metamorph run swarm --journal run.journal
  metamorph render run.journal --at 12s --camera top --only goal --goal ghost > top.svg
  metamorph render results --plot makespan --out makespan.svg --table makespan.csv

Projections are parallel: lengths in the plane of the picture can be measured with the scale bar. In an SVG
every module is a group with its number, role and cell. A figure says in itself how it was made. The same run
and options give the same bytes, but for an MP4, which ffmpeg makes.

Exit codes:
  0  the figure is written
  1  it could not be written completely
  2  the command line or the scenario is wrong, or there is nothing to draw
  7  stopped by Ctrl-C, SIGTERM or SIGHUP; nothing is written
  9  the journal is damaged";

/// The command.
pub static COMMAND: CommandOf<RenderArgs> = CommandOf {
    name: "render",
    group: Some(Group::Look),
    about: "Draw figures of a run for papers: SVG, PDF, PNG, GIF, APNG and MP4, without a browser or a display",
    after_help: || EXAMPLES.to_owned(),
    execute: |args, call| render(args, call.since, call.interrupt),
};
