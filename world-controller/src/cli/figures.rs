//! The command `render`: figures of a journal, or of a scenario that is simulated as far as it is needed.

use crate::cli::args::SimulatedArgs;
use crate::cli::{plots, runs};
use crate::console::command_error::{BAD_USAGE, CommandError, FAILED, Failure};
use crate::console::escape::{Shown, portable};
use crate::console::format::{bytes, many, seconds};
use crate::console::interrupt::Interrupt;
use crate::console::output::{Output, OutputError, Outputs};
use crate::console::stopwatch::Stopwatch;
use crate::console::terminal::{Channel, Live, print_data, print_error};
use crate::experiments::sweep::plot::Quantity;
use crate::family;
use crate::record::journal::{Journal, JournalError, plan_of};
use crate::report::progress;
use crate::run::simulated::Simulation;
use crate::scenario::Plan;
use crate::scenario::shipped::is_scenario;
use crate::view::bodies::ShownSwarm;
use crate::view::figure::animation::Format;
use crate::view::figure::camera::Camera;
use crate::view::figure::drawing::Provenance;
use crate::view::figure::options::{ColorBy, GoalStyle, Labels, Moment, Only, Section, Style, Width};
use crate::view::figure::palette::Theme;
use crate::view::figure::picture::Picture;
use crate::view::figure::{Figure, FigureError, raster};
use crate::view::scene::Scene;
use crate::view::scene_builder::{ReadError, Shared};
use clap::{ArgAction, Args, ValueEnum};
use metamorph_protocol::time::{Span, SpanError, Time};
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_sim_bridge::director::progress::Progress;
use std::io::IsTerminal;
use std::path::PathBuf;
use thiserror::Error;

/// Arguments of `render`.
#[derive(Debug, Args)]
pub struct RenderArgs {
    /// A journal that `run --journal` wrote; or a scenario (a file whose name ends in .toml, or a name that
    /// `metamorph scenarios` lists), which is simulated as far as it is needed; or a directory that `sweep --out`
    /// wrote, or a report that `run --json` wrote, which are plotted
    #[arg(value_name = "JOURNAL|SCENARIO|SWEEP|REPORT")]
    pub file: PathBuf,
    /// Write a figure (.svg, .png) or a moving picture (.gif, .apng) to this file; with --every and {i} in the name of
    /// a figure, one file for each moment, numbered from 0000; default: SVG on standard output
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// The moment to show: a scenario time, a share of the run (50%), or `end`; of a moving picture, the last one
    #[arg(long, value_name = "T", default_value = "end")]
    pub at: Moment,
    /// Scenario time from one frame of a moving picture, or one numbered figure, to the next; default: none, for one
    /// moment
    #[arg(long, value_name = "T", value_parser = span)]
    pub every: Option<Span>,
    /// Of a sweep or a report: what is plotted; default: built, of a report messages
    #[arg(long, value_enum, value_name = "WHAT")]
    pub plot: Option<Quantity>,
    /// Of a sweep or a report: write the table behind the plot to this file, as CSV
    #[arg(long, value_name = "FILE")]
    pub table: Option<PathBuf>,
    /// Frames per second of a moving picture
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=50))]
    pub fps: u32,
    /// How the figure is drawn.
    #[command(flatten)]
    pub style: StyleArgs,
    /// What is simulated.
    #[command(flatten)]
    pub simulated: SimulatedArgs,
    /// Print errors only
    #[arg(short, long)]
    pub quiet: bool,
}

/// How a figure is drawn.
#[derive(Debug, Args)]
pub struct StyleArgs {
    /// The direction to look from: iso, true-iso, front, side, top, or azimuth and elevation in degrees (30,24)
    #[arg(long, value_name = "CAMERA", default_value = "iso", allow_hyphen_values = true)]
    pub camera: Camera,
    /// The width, in mm or px
    #[arg(long, value_name = "W", default_value = "85mm")]
    pub width: Width,
    /// Pixels per inch; default: 300, of moving pictures 150
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(20..=2400))]
    pub dpi: Option<u32>,
    /// The modules to draw: all, goal (those in its cells), level=N, modules=1,4,7..9
    #[arg(long, value_name = "WHICH", default_value = "all")]
    pub only: Only,
    /// Keep only cells on one side of a plane, such as x<11 or z>=2; cut faces are hatched (repeatable);
    /// default: none
    #[arg(long, value_name = "PLANE")]
    pub section: Vec<Section>,
    /// What colours mean
    #[arg(long, value_enum, default_value_t = ColorBy::State)]
    pub color: ColorBy,
    /// How the goal is drawn
    #[arg(long, value_enum, default_value_t = GoalStyle::Outline)]
    pub goal: GoalStyle,
    /// Draw the directions x, y and z
    #[arg(long, value_name = "on|off", default_value = "on", value_parser = switch, action = ArgAction::Set)]
    pub axes: bool,
    /// Draw a scale bar; lengths in the plane of the picture can be measured
    #[arg(long, value_name = "on|off", default_value = "on", value_parser = switch, action = ArgAction::Set)]
    pub scale: bool,
    /// Explain the colours
    #[arg(long, value_name = "on|off", default_value = "on", value_parser = switch, action = ArgAction::Set)]
    pub legend: bool,
    /// A title; {t} stands for the scenario time; default: none, of moving pictures the time
    #[arg(long, value_name = "TEXT")]
    pub title: Option<String>,
    /// What is written on modules
    #[arg(long, value_enum, default_value_t = Labels::Off)]
    pub labels: Labels,
    /// Background and colours
    #[arg(long, value_enum, default_value_t = Theme::Paper)]
    pub theme: Theme,
}

fn span(text: &str) -> Result<Span, String> {
    let span: Span = text.parse().map_err(|error: SpanError| error.to_string())?;
    if span.0 == 0 { Err("the time from one frame to the next is more than 0".to_owned()) } else { Ok(span) }
}

fn switch(text: &str) -> Result<bool, &'static str> {
    match text {
        "on" => Ok(true),
        "off" => Ok(false),
        _ => Err("say `on` or `off`"),
    }
}

/// What kind of file is written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Svg,
    Png,
    Moving(Format),
    /// Figures of many moments; true for PNG.
    Numbered(bool),
}

/// Stands for the number of a figure in the name of its file.
const NUMBER: &str = "{i}";

/// Errors of `render`.
#[derive(Debug, Error)]
enum RenderError {
    #[error("--out {}: the name says no format\n  fix: name a file that ends in .svg, .png, .gif or .apng", .0.shown())]
    Format(PathBuf),
    #[error("standard output is a terminal\n  fix: name a file with --out, or redirect it")]
    Terminal,
    #[error("--out {}: a moving picture needs the time from one frame to the next\n  fix: add --every 1s, or name a file that ends in .svg or .png", .0.shown())]
    NoEvery(PathBuf),
    #[error(
        "--every: a file that ends in .svg or .png shows one moment\n  fix: name numbered files such as --out 'frames/{{i}}.png', or one that ends in .gif or .apng, or leave out --every"
    )]
    Every,
    #[error(
        "{0}: only sweeps and reports are plotted\n  fix: leave it out, or name the directory of a sweep or a report"
    )]
    OfPlot(&'static str),
    #[error("--theme transparent: moving pictures have a background\n  fix: choose another theme")]
    Transparent,
    #[error("--at {at}: the run ended at {end}\n  fix: name an earlier time, a share such as 50%, or `end`")]
    Late { at: String, end: String },
    #[error("{option}: a journal holds a run that is over\n  fix: leave it out, or name a scenario")]
    OfScenario { option: &'static str },
    #[error(
        "the run has more than {0} events; only the first ones are kept, until {1}\n  fix: name a time before that"
    )]
    Forgotten(u64, String),
    #[error(transparent)]
    Figure(#[from] FigureError),
    #[error(transparent)]
    Output(#[from] OutputError),
    #[error(transparent)]
    Journal(#[from] JournalError),
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
struct Source {
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
    let kind = kind(&args)?;
    let mut outputs = Outputs::new();
    outputs.reads("the run", &args.file);
    let output = args.out.as_deref().filter(|_| !matches!(kind, Kind::Numbered(_)));
    let output = output.map(|file| outputs.writes("--out", file)).transpose()?;
    interrupt.begin();
    let source = if is_scenario(&args.file) { simulated(&args, since, interrupt)? } else { read(&args)? };
    let Some(at) = args.at.within(source.scene.now()) else {
        let (at, end) = (args.at.to_string(), seconds(source.scene.now().as_secs_f64()));
        return Err(RenderError::Late { at, end }.into());
    };
    if let (1.., Some((last, _))) = (source.scene.forgotten(), source.scene.events().last())
        && *last < at
    {
        let kept = source.scene.events().len() as u64;
        return Err(RenderError::Forgotten(kept, seconds(last.as_secs_f64())).into());
    }
    let style = style(&args, kind);
    let provenance = provenance(&args, &style, &source, at);
    let figure = Figure::new(&source.scene, &*source.swarm, &style, provenance);
    let said = match kind {
        Kind::Numbered(png) => Some(write_series(&args, png, &figure, &style, at, &mut outputs, interrupt)?),
        _ => write(&args, kind, &figure, &style, at, output.as_ref(), interrupt)?,
    };
    if let (Some(file), Some(said)) = (&args.out, said) {
        let modules = many(source.plan.swarm.len() as u64, "module");
        Channel::beside(false, args.quiet).say(&format!("{}: {modules} {said}\n", file.shown()));
    }
    Ok(0)
}

fn kind(args: &RenderArgs) -> Result<Kind, RenderError> {
    let Some(file) = &args.out else {
        if std::io::stdout().is_terminal() {
            return Err(RenderError::Terminal);
        }
        return if args.every.is_some() { Err(RenderError::Every) } else { Ok(Kind::Svg) };
    };
    let kind = match file.extension().and_then(|extension| extension.to_str()) {
        Some("svg") => Kind::Svg,
        Some("png") => Kind::Png,
        Some("gif") => Kind::Moving(Format::Gif),
        Some("apng") => Kind::Moving(Format::Apng),
        _ => return Err(RenderError::Format(file.clone())),
    };
    let is_numbered = file.file_name().is_some_and(|name| name.to_string_lossy().contains(NUMBER));
    match (kind, args.every) {
        (Kind::Svg | Kind::Png, Some(_)) if is_numbered => Ok(Kind::Numbered(kind == Kind::Png)),
        (Kind::Moving(_), None) => Err(RenderError::NoEvery(file.clone())),
        (Kind::Svg | Kind::Png, Some(_)) => Err(RenderError::Every),
        (Kind::Moving(_), _) if args.style.theme == Theme::Transparent => Err(RenderError::Transparent),
        _ => Ok(kind),
    }
}

fn style(args: &RenderArgs, kind: Kind) -> Style {
    let StyleArgs {
        camera,
        width,
        dpi,
        only,
        section,
        color,
        goal,
        axes,
        scale,
        legend,
        title,
        labels,
        theme,
    } = &args.style;
    let moving = matches!(kind, Kind::Moving(_));
    Style {
        camera: *camera,
        width: *width,
        dpi: dpi.unwrap_or(if moving { 150 } else { 300 }),
        only: only.clone(),
        sections: section.clone(),
        color: *color,
        goal: *goal,
        axes: *axes,
        scale: *scale,
        legend: *legend,
        title: title.clone().or_else(|| moving.then(|| "{t}".to_owned())),
        labels: *labels,
        theme: *theme,
    }
}

/// Simulates a scenario, no longer than needed.
fn simulated(args: &RenderArgs, since: Stopwatch, interrupt: &Interrupt) -> Result<Source, Failure> {
    let plan = runs::plan(&args.file, &args.simulated.overrides())?;
    let until = match args.at {
        Moment::At(at) => Some(at),
        Moment::Share(_) => None,
    };
    let swarm = family::of(&plan).shown(&plan);
    let scene = Shared::new(Scene::new(&plan, &*swarm, true));
    let scribe = Some(family::of(&plan).shown(&plan).scribe(scene.clone()));
    let mut live = Live::new(!args.quiet);
    let mut reached = false;
    let mut watch = |now: Time, so_far: &dyn Fn() -> Progress| {
        live.show(|| progress(&plan, now, &so_far()));
        reached = until.is_some_and(|until| now > until);
        !reached && !interrupt.is_set()
    };
    let simulation = Simulation { since, watch: &mut watch, keeping: None, scribe, search: false };
    let (report, _) = family::of(&plan).simulate(&plan, simulation);
    live.clear();
    if interrupt.is_set() {
        return Err(RenderError::Figure(FigureError::Interrupted).into());
    }
    let trace = report.trace_hash.clone().filter(|_| !reached);
    let mut scene = scene.into_inner();
    scene.finish(report);
    Ok(Source { scene, swarm, trace, plan })
}

/// Reads a journal.
fn read(args: &RenderArgs) -> Result<Source, RenderError> {
    let SimulatedArgs { seed, set, kill, pause } = &args.simulated;
    let given = [
        ("--seed", seed.is_some()),
        ("--set", !set.is_empty()),
        ("--kill", !kill.is_empty()),
        ("--pause", !pause.is_empty()),
    ];
    if let Some((option, _)) = given.into_iter().find(|(_, given)| *given) {
        return Err(RenderError::OfScenario { option });
    }
    let plan = {
        let journal = Journal::open(&args.file)?;
        plan_of(family::families(), journal.head()).map_err(ReadError::from)?
    };
    let (scene, damage) = family::recorded(&args.file)?;
    if let Some(damage) = damage {
        return Err(JournalError::from(damage).into());
    }
    for trouble in scene.troubles() {
        print_error(&format!("note: {trouble}"));
    }
    Ok(Source { swarm: family::of(&plan).shown(&plan), plan, scene, trace: None })
}

/// Describes how the figure was made.
fn provenance(args: &RenderArgs, style: &Style, source: &Source, at: Time) -> Provenance {
    let mut description = format!(
        "{}, seed {}, at {at}. Made by metamorph {}: metamorph render {}",
        source.plan.title(),
        source.plan.seed,
        env!("CARGO_PKG_VERSION"),
        command(args, style),
    );
    if let Some(trace) = &source.trace {
        description.push_str(&format!(". Trace hash of the run: {trace}"));
    }
    Provenance { title: format!("{}, at {at}", source.plan.title()), description }
}

/// Returns the arguments that make the same figure, without the name of the output.
fn command(args: &RenderArgs, style: &Style) -> String {
    let named = |value: &dyn Fn() -> Option<clap::builder::PossibleValue>| {
        value().map_or_else(String::new, |value| value.get_name().to_owned())
    };
    let mut line = vec![portable(&args.file)];
    let mut add = |option: &str, value: String, default: &str| {
        if value != default {
            let quoted = value.contains(|c: char| c.is_whitespace() || "<>%*'\"${}()[];&|".contains(c));
            let value = if quoted { format!("'{}'", value.replace('\'', r"'\''")) } else { value };
            line.push(format!("{option} {value}"));
        }
    };
    add("--at", args.at.to_string(), "end");
    add("--every", args.every.map(|every| every.to_string()).unwrap_or_default(), "");
    add("--fps", args.fps.to_string(), "20");
    add("--camera", style.camera.to_string(), "iso");
    add("--width", style.width.to_string(), "85mm");
    add("--dpi", args.style.dpi.map(|dpi| dpi.to_string()).unwrap_or_default(), "");
    add("--only", style.only.to_string(), "all");
    style.sections.iter().for_each(|section| add("--section", section.to_string(), ""));
    add("--color", named(&|| style.color.to_possible_value()), "state");
    add("--goal", named(&|| style.goal.to_possible_value()), "outline");
    for (option, on) in [("--axes", style.axes), ("--scale", style.scale), ("--legend", style.legend)] {
        add(option, if on { "on" } else { "off" }.to_owned(), "on");
    }
    add("--title", args.style.title.clone().unwrap_or_default(), "");
    add("--labels", named(&|| style.labels.to_possible_value()), "off");
    add("--theme", named(&|| style.theme.to_possible_value()), "paper");
    let SimulatedArgs { seed, set, kill, pause } = &args.simulated;
    add("--seed", seed.map(|seed| seed.to_string()).unwrap_or_default(), "");
    for (option, values) in [("--set", set), ("--kill", kill), ("--pause", pause)] {
        values.iter().for_each(|value| add(option, value.clone(), ""));
    }
    line.join(" ")
}

/// Writes the figure, and returns what was written; `None` if it went to standard output.
fn write(
    args: &RenderArgs,
    kind: Kind,
    figure: &Figure<'_>,
    style: &Style,
    at: Time,
    output: Option<&Output>,
    interrupt: &Interrupt,
) -> Result<Option<String>, RenderError> {
    let time = seconds(at.as_secs_f64());
    let (data, shown) = match kind {
        Kind::Svg | Kind::Numbered(_) => (figure.still(at)?.svg().into_bytes(), format!("at {time}")),
        Kind::Png => {
            let (data, [width, height]) = png(figure, &figure.still(at)?, style)?;
            (data, format!("at {time}, {width} × {height} pixels"))
        }
        Kind::Moving(format) => {
            let every = args.every.ok_or(RenderError::Every)?;
            let mut data = Vec::new();
            let going = || !interrupt.is_set();
            let frames = figure.animate(format, every, at, args.fps, &going, &mut data)?;
            (data, format!("until {time}, {}", many(frames.into(), "frame")))
        }
    };
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

/// Returns a picture as a PNG file, with its width and height.
fn png(figure: &Figure<'_>, picture: &Picture, style: &Style) -> Result<(Vec<u8>, [u32; 2]), FigureError> {
    let pixmap = figure.pixels(picture)?;
    let mut data = Vec::new();
    raster::png(picture, style.dpi, &pixmap, &mut data)?;
    Ok((data, [pixmap.width(), pixmap.height()]))
}

/// Writes the figures of many moments, and returns what was written.
fn write_series(
    args: &RenderArgs,
    is_png: bool,
    figure: &Figure<'_>,
    style: &Style,
    end: Time,
    outputs: &mut Outputs,
    interrupt: &Interrupt,
) -> Result<String, RenderError> {
    let (Some(file), Some(every)) = (&args.out, args.every) else { return Err(RenderError::Every) };
    let name = file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    if let Some(directory) = file.parent().filter(|directory| !directory.as_os_str().is_empty()) {
        std::fs::create_dir_all(directory).map_err(FigureError::from)?;
    }
    let written = figure.series(every, end, &|| !interrupt.is_set(), |number, picture| {
        let path = file.with_file_name(name.replace(NUMBER, &format!("{number:04}")));
        let data = if is_png { png(figure, picture, style)?.0 } else { picture.svg().into_bytes() };
        Ok::<_, RenderError>(outputs.writes("--out", &path)?.write(&data)?)
    })?;
    Ok(format!("until {}, {}", seconds(end.as_secs_f64()), many(written.into(), "file")))
}
