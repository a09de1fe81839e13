//! A request for a figure of a run: the options of `render`, which the page that shows a run sends as a query. Both
//! are answered by [`file`], so that a picture that the page saves is the one that `render` writes.

use crate::mp4;
use clap::{ArgAction, Args, CommandFactory, FromArgMatches, Parser, ValueEnum};
use metamorph_protocol::time::{Span, SpanError, Time};
use metamorph_scenario::quote;
use metamorph_scene::bodies::ShownSwarm;
use metamorph_scene::figure::animation::Format;
use metamorph_scene::figure::camera::Camera;
use metamorph_scene::figure::drawing::Provenance;
use metamorph_scene::figure::options::{
    ColorBy, GoalStyle, Labels, Links, Moment, Only, Section, Style, Width,
};
use metamorph_scene::figure::palette::Theme;
use metamorph_scene::figure::pdf::pdf;
use metamorph_scene::figure::picture::Picture;
use metamorph_scene::figure::{Figure, FigureError, raster};
use metamorph_scene::scene::Scene;
use metamorph_text::escape::portable;
use metamorph_text::format::{many, seconds};
use metamorph_text::program;
use percent_encoding::percent_decode_str;
use std::path::Path;

/// Which moments of a run are drawn, and how.
#[derive(Clone, Debug, Args)]
pub struct Request {
    /// The moment to show: a scenario time, a share of the run (50%), or `end`; of a moving picture, the last one
    #[arg(long, value_name = "T", default_value = "end")]
    pub at: Moment,
    /// Scenario time from one frame of a moving picture, or one numbered figure, to the next; default: none, for one
    /// moment
    #[arg(long, value_name = "T", value_parser = span)]
    pub every: Option<Span>,
    /// Frames per second of a moving picture
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..=50))]
    pub fps: u32,
    /// How the figure is drawn.
    #[command(flatten)]
    pub style: StyleArgs,
}

/// How a figure is drawn.
#[derive(Clone, Debug, Args)]
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
    /// Lines between modules, drawn over the structure (several with commas between them); default: none
    #[arg(long, value_enum, value_delimiter = ',')]
    pub links: Vec<Links>,
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

/// Kind of file to write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// It shows one moment.
    Still(Still),
    /// It is a moving picture.
    Moving(Film),
}

/// Format of a figure of one moment.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Still {
    /// Vectors.
    Svg,
    /// Vectors on a page.
    Pdf,
    /// Pixels.
    Png,
}

/// Format of a moving picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Film {
    /// A picture of one palette.
    Palette(Format),
    /// A film that ffmpeg makes.
    Mp4,
}

/// All kinds, with how the names of their files end and the types of their contents.
const KINDS: [(Kind, &str, &str); 6] = [
    (Kind::Still(Still::Svg), "svg", "image/svg+xml"),
    (Kind::Still(Still::Pdf), "pdf", "application/pdf"),
    (Kind::Still(Still::Png), "png", "image/png"),
    (Kind::Moving(Film::Palette(Format::Gif)), "gif", "image/gif"),
    (Kind::Moving(Film::Palette(Format::Apng)), "apng", "image/apng"),
    (Kind::Moving(Film::Mp4), "mp4", "video/mp4"),
];

impl Kind {
    /// Returns how the names of its files end, and the type of its content.
    pub fn names(self) -> (&'static str, &'static str) {
        let found = KINDS.iter().find(|(kind, ..)| *kind == self);
        found.map_or(("bin", "application/octet-stream"), |(_, end, content)| (end, content))
    }
    /// Returns the kind of files whose names end so.
    pub fn of_extension(extension: &str) -> Option<Kind> {
        KINDS.iter().find(|(_, end, _)| *end == extension).map(|(kind, ..)| *kind)
    }
}

/// A query of the page.
#[derive(Parser)]
#[command(no_binary_name = true, disable_help_flag = true)]
struct Query {
    #[command(flatten)]
    request: Request,
}

impl Request {
    /// Reads a request from a query of an address, `at=2s&camera=top`: its keys are the options of `render`.
    ///
    /// # Errors
    ///
    /// What is wrong with the first option that is not understood.
    pub fn of_query(query: &str) -> Result<Request, String> {
        let decoded = |text: &str| percent_decode_str(text).decode_utf8_lossy().into_owned();
        let words =
            query.split('&').filter(|pair| !pair.is_empty()).map(|pair| format!("--{}", decoded(pair)));
        let matches = Query::command().try_get_matches_from(words.collect::<Vec<String>>());
        let query = matches.and_then(|matches| Query::from_arg_matches(&matches));
        query.map(|query| query.request).map_err(|error| {
            let text = error.to_string();
            let first = text.lines().next().unwrap_or_default();
            first.strip_prefix("error: ").unwrap_or(first).to_owned()
        })
    }

    /// Returns how the figure is drawn.
    pub fn style(&self, is_moving: bool) -> Style {
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
            links,
            theme,
        } = &self.style;
        Style {
            camera: *camera,
            width: *width,
            dpi: dpi.unwrap_or(if is_moving { 150 } else { 300 }),
            only: only.clone(),
            sections: section.clone(),
            color: *color,
            goal: *goal,
            axes: *axes,
            scale: *scale,
            legend: *legend,
            title: title.clone().or_else(|| is_moving.then(|| "{t}".to_owned())),
            labels: *labels,
            links: links.iter().copied().collect(),
            theme: *theme,
        }
    }

    /// Returns the options that are not the default, as they are typed.
    pub fn options(&self) -> Vec<String> {
        let style = &self.style;
        let mut words = Vec::new();
        let mut add = |option: &str, value: String, default: &str| {
            if value != default {
                words.extend([option.to_owned(), quote(value)]);
            }
        };
        add("--at", self.at.to_string(), "end");
        add("--every", self.every.map(|every| every.to_string()).unwrap_or_default(), "");
        add("--fps", self.fps.to_string(), "20");
        add("--camera", style.camera.to_string(), "iso");
        add("--width", style.width.to_string(), "85mm");
        add("--dpi", style.dpi.map(|dpi| dpi.to_string()).unwrap_or_default(), "");
        add("--only", style.only.to_string(), "all");
        style.section.iter().for_each(|section| add("--section", section.to_string(), ""));
        add("--color", name(style.color), "state");
        add("--goal", name(style.goal), "outline");
        for (option, on) in [("--axes", style.axes), ("--scale", style.scale), ("--legend", style.legend)] {
            add(option, if on { "on" } else { "off" }.to_owned(), "on");
        }
        add("--title", style.title.clone().unwrap_or_default(), "");
        add("--labels", name(style.labels), "off");
        add("--links", style.links.iter().map(|links| name(*links)).collect::<Vec<_>>().join(","), "");
        add("--theme", name(style.theme), "paper");
        words
    }
}

/// Returns the name of a value of an option.
fn name<T: ValueEnum>(value: T) -> String {
    value.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
}

/// Where a run comes from, for the text that says how a figure was made.
#[derive(Clone, Debug)]
pub struct Origin {
    /// The title of the scenario.
    pub title: String,
    /// The seed of the run.
    pub seed: u64,
    /// How the run is named again.
    pub command: Command,
}

/// How a run is named in a command.
#[derive(Clone, Debug)]
pub enum Command {
    /// By the source of `render` and the options after those of the figure.
    Render {
        /// The scenario or the journal.
        source: String,
        /// Options that change the scenario.
        options: Vec<String>,
    },
    /// By the command that repeats it; the figure cannot be made from a file.
    Run(String),
}

impl Command {
    /// Returns the command that draws what a file holds.
    pub fn of_file(file: &Path) -> Command {
        Command::Render { source: quote(portable(file)), options: Vec::new() }
    }
}

/// A run that is drawn.
pub struct Source<'a> {
    /// Its scene.
    pub scene: &'a Scene,
    /// Its bodies.
    pub swarm: &'a dyn ShownSwarm,
    /// Where it comes from.
    pub origin: &'a Origin,
    /// The trace hash of the run, if it was simulated here to its end.
    pub trace: Option<String>,
}

impl<'a> Source<'a> {
    /// Returns the time of a moment.
    ///
    /// # Errors
    ///
    /// The run has ended before it, or its events were too many to keep.
    pub fn time(&self, at: Moment) -> Result<Time, FigureError> {
        let end = self.scene.now();
        let time = at
            .within(end)
            .ok_or_else(|| FigureError::Late { at: at.to_string(), end: seconds(end.as_secs_f64()) })?;
        match (self.scene.forgotten(), self.scene.events().last()) {
            (1.., Some((last, _))) if *last < time => {
                let kept = self.scene.events().len() as u64;
                Err(FigureError::Forgotten(kept, seconds(last.as_secs_f64())))
            }
            _ => Ok(time),
        }
    }

    /// Returns the figures of a request up to a time.
    pub fn figure(&self, request: &Request, style: &'a Style, at: Time) -> Figure<'a> {
        Figure::new(self.scene, self.swarm, style, self.provenance(request, at))
    }

    /// Describes how a figure is made. The trace hash is of the whole run, so it is given if all of the run was needed.
    fn provenance(&self, request: &Request, at: Time) -> Provenance {
        let Origin { title, seed, command } = self.origin;
        let command = match command {
            Command::Render { source, options } => {
                let words = [vec![source.clone()], request.options(), options.clone()].concat();
                format!("{} render {}", quote(program::name().to_owned()), words.join(" "))
            }
            Command::Run(line) => format!("{line} --view"),
        };
        let version = env!("CARGO_PKG_VERSION");
        let mut description =
            format!("{title}, seed {seed}, at {at}. Made by metamorph {version}: {command}");
        if let Some(trace) = self.trace.as_ref().filter(|_| matches!(request.at, Moment::Share(_))) {
            description.push_str(&format!(". Trace hash of the run: {trace}"));
        }
        Provenance { title: format!("{title}, at {at}"), description }
    }
}

/// A figure as the content of a file.
pub struct File {
    /// The content.
    pub data: Vec<u8>,
    /// Short description of the content.
    pub shown: String,
}

/// Draws a figure. `going` is asked before each frame of a moving picture whether to continue.
///
/// # Errors
///
/// The figure cannot be drawn.
pub fn file(
    source: &Source<'_>,
    request: &Request,
    kind: Kind,
    going: &dyn Fn() -> bool,
) -> Result<File, FigureError> {
    let style = request.style(matches!(kind, Kind::Moving(_)));
    let at = source.time(request.at)?;
    let figure = source.figure(request, &style, at);
    let time = seconds(at.as_secs_f64());
    let (data, shown) = match (kind, request.every) {
        (Kind::Still(format), None) => {
            let (data, size) = still(&figure, &figure.still(at)?, format, &style)?;
            let size = size.map_or(String::new(), |[width, height]| format!(", {width} × {height} pixels"));
            (data, format!("at {time}{size}"))
        }
        (Kind::Still(_), Some(_)) => return Err(FigureError::Every),
        (Kind::Moving(_), None) => return Err(FigureError::NoEvery),
        (Kind::Moving(_), _) if style.theme == Theme::Transparent => return Err(FigureError::Transparent),
        (Kind::Moving(film), Some(every)) => {
            let (data, frames) = match film {
                Film::Palette(format) => {
                    let mut data = Vec::new();
                    let frames = figure.animate(format, every, at, request.fps, going, &mut data)?;
                    (data, frames)
                }
                Film::Mp4 => mp4::mp4(&figure, every, at, request.fps, going)?,
            };
            (data, format!("until {time}, {}", many(frames.into(), "frame")))
        }
    };
    Ok(File { data, shown })
}

/// Returns a picture as a file, and its size in pixels if it consists of them.
///
/// # Errors
///
/// Its pixels are too many.
pub fn still(
    figure: &Figure<'_>,
    picture: &Picture,
    format: Still,
    style: &Style,
) -> Result<(Vec<u8>, Option<[u32; 2]>), FigureError> {
    Ok(match format {
        Still::Svg => (picture.svg().into_bytes(), None),
        Still::Pdf => (pdf(picture)?, None),
        Still::Png => {
            let pixmap = figure.pixels(picture)?;
            let mut data = Vec::new();
            raster::png(picture, style.dpi, &pixmap, &mut data)?;
            (data, Some([pixmap.width(), pixmap.height()]))
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the page sends is read as what is typed, and the options of a request give the same request.
    #[test]
    fn a_query_is_read_as_options_are() {
        let request = Request::of_query(
            "at=2s&camera=-51.57,28&section=x%3C4&title=at%20%7Bt%7D%20%26%20more&links=waits,contacts&theme=dark",
        );
        let request = request.unwrap_or_else(|error| panic!("{error}"));
        let options = "--at 2s --camera -51.57,28 --section 'x<=3' --title 'at {t} & more' \
                       --links waits,contacts --theme dark";
        assert_eq!(request.options().join(" "), options);
        let none = Request::of_query("").unwrap_or_else(|error| panic!("{error}"));
        assert!(none.options().is_empty(), "{:?}", none.options());
    }

    #[test]
    fn a_wrong_query_says_what_is_wrong() {
        for (query, part) in [
            ("at=soon", "'soon' for '--at"),
            ("colour=state", "unexpected argument '--colour'"),
            ("theme=%ff", "for '--theme"),
            ("out=x", "unexpected argument '--out'"),
            ("help", "unexpected argument '--help'"),
            ("every=0s", "more than 0"),
            ("=&&at", "unexpected argument"),
        ] {
            let error = Request::of_query(query).map(|request| request.options()).unwrap_err();
            assert!(error.contains(part) && !error.contains('\n'), "{query}: {error}");
        }
    }
}
