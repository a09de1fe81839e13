//! `metamorph room`: rooms with pieces of furniture and constraints; what is violated and how to put it right, the
//! scenario in which metamodules build it, and how precise a circle is.

pub mod constraint;
pub mod description;
pub mod document;
pub mod edit;
mod export;
mod form;
pub mod help;
pub mod measure;
pub mod model;
mod reach;
pub mod study;
pub mod study_actions;
pub mod study_format;
mod template;
#[cfg(test)]
mod tests;
mod text;
mod walkway;
mod wording;

use clap::{Args, ValueEnum};
use constraint::{Rule, Violation};
use document::MAX_BYTES;
use export::{ExportError, scenario};
use form::{Form, SHAPES};
use help::{Mended, put_right, snap};
use measure::{Precision, precision};
use metamorph_console::output::{Json, OutputError, Outputs};
use metamorph_console::terminal::Channel;
use metamorph_families::metamodule::motion_database::motions;
use metamorph_module_agent::regular_file;
use metamorph_processes::family::sources;
use metamorph_protocol::metamodule::motions::Motions;
use metamorph_protocol::roombots::Kind;
use metamorph_scenario::diagnostics::Diagnostics;
use metamorph_text::command_error::{BAD_USAGE, CommandError};
use metamorph_text::escape::{Shown as _, portable};
use model::{CELL_M, Placement, Room};
use reach::{Stage, order, order_while};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use study::{LogError, Session};
use template::{Template, fresh_names};
use thiserror::Error;

/// The end of the command's help.
pub const EXAMPLES: &str = "\
Examples:
  metamorph room deploy/rooms/circle.toml                      which constraints are violated
  metamorph room office.toml --put-right                       move pieces as little as possible
  metamorph room office.toml --snap desk                       the nearest place for one piece
  metamorph room deploy/rooms/circle.toml --write circle.toml  a scenario that builds it
  metamorph room deploy/rooms/circle.toml --measure            how precise its circles are
  metamorph room office.toml --measure --study session.jsonl   the session of a person
  metamorph room office.toml --template circle --count 10 --around 20,20 --radius 12

Room files are described in docs/rooms.md. Lengths are connectors of 0.11 m, or metres where it says so.

Exit codes:
  0  nothing that has to be kept is violated
  1  the program itself failed, for example because a file could not be written
  2  the command line or a file is wrong; the error names its place, reason and fix
  3  a constraint is violated; with --put-right or --snap, no place was found";

/// Exit code: a constraint is violated.
const VIOLATED: u8 = 3;
/// The version of the JSON output.
pub const SCHEMA: u32 = 1;

/// Arguments of `room`.
#[derive(Debug, Args)]
pub struct RoomArgs {
    /// A room file
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// List the violated constraints; this is what is done by default
    #[arg(long)]
    pub check: bool,
    /// Move pieces so that nothing is violated, by the least total displacement
    #[arg(long, conflicts_with_all = ["check", "snap", "template"])]
    pub put_right: bool,
    /// Find the nearest place for this piece at which it violates nothing. Default: none
    #[arg(long, value_name = "PIECE", conflicts_with_all = ["check", "template"])]
    pub snap: Option<String>,
    /// Write a scenario in which metamodules from the store build the room
    #[arg(long, value_name = "FILE", conflicts_with_all = ["snap", "template"])]
    pub write: Option<PathBuf>,
    /// Kind of the metamodules that build it: PAR, SRS, PER or SRZ
    #[arg(long, value_enum, default_value_t = KindArg::Srs)]
    pub kind: KindArg,
    /// Measure the circles of the room, or the session of --study: p_l and p_g of thesis 8.2, in metres
    #[arg(long)]
    pub measure: bool,
    /// A session log to be measured
    #[arg(long, value_name = "FILE", requires = "measure")]
    pub study: Option<PathBuf>,
    /// Print [[piece]] tables of an arrangement of equal pieces. Default: none
    #[arg(long, value_enum, requires = "count")]
    pub template: Option<TemplateArg>,
    /// How many pieces: N, or NxM in M rows. Default: none, --template needs it
    #[arg(long, value_name = "N|NxM", value_parser = count, requires = "template")]
    pub count: Option<(usize, usize)>,
    /// The middle of a circle or an auditorium, or the corner of a row or a grid
    #[arg(long, value_name = "X,Y", value_parser = connector, default_value = "0,0", requires = "template")]
    pub around: (i16, i16),
    /// The radius of a circle, or of the first arc of an auditorium
    #[arg(long, value_name = "CONNECTORS", value_parser = radius, default_value = "10", requires = "template")]
    pub radius: f64,
    /// Free connectors between pieces or rows
    #[arg(long, value_name = "CONNECTORS", default_value_t = 3, value_parser = clap::value_parser!(i16).range(0..=64), requires = "template")]
    pub gap: i16,
    /// The shape of the pieces: box or chair
    #[arg(long, value_name = "SHAPE", default_value = "chair", value_parser = shape, requires = "template")]
    pub shape: &'static str,
    /// Write the answer as JSON to a file, or to standard output with `-` (text for people then goes
    /// to standard error)
    #[arg(long, value_name = "FILE|-", allow_hyphen_values = true)]
    pub json: Option<PathBuf>,
}

/// A kind of metamodule, as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Deserialize)]
#[value(rename_all = "UPPER")]
#[serde(rename_all = "UPPERCASE")]
#[allow(missing_docs, reason = "the names are those of the thesis")]
pub enum KindArg {
    Par,
    Srs,
    Per,
    Srz,
}

impl From<KindArg> for Kind {
    fn from(kind: KindArg) -> Kind {
        match kind {
            KindArg::Par => Kind::Par,
            KindArg::Srs => Kind::Srs,
            KindArg::Per => Kind::Per,
            KindArg::Srz => Kind::Srz,
        }
    }
}

/// An arrangement, as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TemplateArg {
    /// In a circle, fronts inwards
    Circle,
    /// In a row from west to east
    Row,
    /// In rows, one behind the other
    Grid,
    /// In arcs around a stage in the south
    Auditorium,
}

impl TemplateArg {
    fn of(self, (n, m): (usize, usize), around: (i16, i16), radius: f64, gap: i16) -> Template {
        match self {
            TemplateArg::Circle => Template::Circle { count: n * m, around, radius },
            TemplateArg::Row => Template::Row { count: n * m, at: around, gap },
            TemplateArg::Grid => Template::Grid { count: (n, m), at: around, gap },
            TemplateArg::Auditorium => Template::Auditorium { count: (n, m), around, radius, gap },
        }
    }
}

fn count(text: &str) -> Result<(usize, usize), String> {
    let (n, m) = text.split_once('x').unwrap_or((text, "1"));
    let number = |text: &str| text.parse::<usize>().ok().filter(|n| (1..=model::MAX_PIECES).contains(n));
    number(n)
        .zip(number(m))
        .ok_or_else(|| format!("write a number from 1 to {}, or two as 4x3", model::MAX_PIECES))
}

fn connector(text: &str) -> Result<(i16, i16), String> {
    let number = |text: &str| text.trim().parse::<i16>().ok().filter(|n| (0..model::MAX_SIDE).contains(n));
    let both = text.split_once(',').and_then(|(x, y)| number(x).zip(number(y)));
    both.ok_or_else(|| "write a connector, such as 20,14".to_owned())
}

fn radius(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|r| (0.0..=f64::from(model::MAX_SIDE)).contains(r));
    number.ok_or_else(|| format!("write a number from 0 to {}", model::MAX_SIDE))
}

fn shape(text: &str) -> Result<&'static str, String> {
    let names = SHAPES.map(|(name, _)| name);
    names.into_iter().find(|name| *name == text).ok_or_else(|| format!("write {}", names.join(" or ")))
}

/// Why there is no answer.
#[derive(Debug, Error)]
pub enum RoomError {
    /// The room file cannot be read.
    #[error("{file}: cannot read the room: {why}\n  fix: name a room file; deploy/rooms has some")]
    Read {
        /// The file.
        file: String,
        /// The reason.
        why: String,
    },
    /// The room file is wrong.
    #[error("{0}")]
    Wrong(Box<Diagnostics>),
    /// The session log.
    #[error(transparent)]
    Study(#[from] LogError),
    /// There is no such piece.
    #[error("--snap {0}: the room has no such piece\n  fix: name a piece of the room")]
    NoPiece(String),
    /// The room cannot be built in any order.
    #[error(
        "the room cannot be built: {0}\n  fix: `metamorph room FILE` with a constraint `kind = \"reach\"` names the places; move pieces apart, or move the store"
    )]
    NoOrder(String),
    /// The search for an order takes too long.
    #[error(
        "the search for an order of building has ended without one\n  fix: `metamorph room FILE --write` has no limit of time"
    )]
    Late,
    /// The room is no scenario.
    #[error("{0}")]
    Export(#[from] ExportError),
    /// An output cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
}

impl CommandError for RoomError {
    fn exit_code(&self) -> u8 {
        match self {
            RoomError::Output(error) => error.exit_code(),
            RoomError::NoOrder(_) | RoomError::Late => VIOLATED,
            _ => BAD_USAGE,
        }
    }
    fn text(&self) -> String {
        match self {
            RoomError::Wrong(_) => self.to_string(),
            _ => format!("metamorph: {self}"),
        }
    }
}

/// The answer, as JSON.
#[derive(Debug, Default, Serialize)]
struct Answer {
    schema: u32,
    version: &'static str,
    file: String,
    name: Option<String>,
    /// Connectors along x and y.
    size: (i16, i16),
    pieces: Vec<PieceAnswer>,
    /// Metamodules of all pieces.
    metamodules: usize,
    violations: Vec<Violation>,
    /// With `--put-right`: where pieces stand then; `null` if no way was found.
    put_right: Option<Mended>,
    /// With `--snap`: the nearest place; `null` if there is none.
    snap: Option<Placement>,
    /// With `--write`: the pieces in the order in which they are built.
    order: Vec<String>,
    /// With `--measure`: the circles.
    circles: Vec<CircleAnswer>,
    /// With `--study`: the session.
    session: Option<Session>,
    /// With `--study`: what differs from the room, which is the task.
    errors: Vec<String>,
}

#[derive(Debug, Serialize)]
struct PieceAnswer {
    name: String,
    #[serde(flatten)]
    place: Placement,
    colour: model::Colour,
    metamodules: usize,
}

#[derive(Debug, Serialize)]
struct CircleAnswer {
    /// The piece in the middle.
    around: String,
    pieces: usize,
    /// In metres.
    #[serde(flatten)]
    precision: Precision,
}

/// Answers, prints and returns the exit code.
///
/// # Errors
/// If a file or an option is wrong, the room cannot be built, or an output cannot be written.
pub fn room(args: &RoomArgs) -> Result<u8, RoomError> {
    let mut outputs = Outputs::new();
    outputs.reads("the room", &args.file);
    if let Some(study) = &args.study {
        outputs.reads("--study", study);
    }
    let written = args.write.as_ref().map(|path| outputs.creates("--write", path)).transpose()?;
    let json = Json::of(args.json.as_deref(), &mut outputs)?;
    let mut room = read(&args.file)?;
    let mut answer = Answer::of(&args.file, &room);
    let mut exit = 0;
    if let Some(template) = args.template {
        let tables = tables(template, args, &room);
        Channel::beside(json.is_out(), false).say(&tables);
        json.write(&answer)?;
        return Ok(0);
    }
    if let Some(name) = &args.snap {
        let piece = room.find(name).ok_or_else(|| RoomError::NoPiece(name.escape_debug().to_string()))?;
        answer.snap = snap(&room, piece, &|| true);
        exit = if answer.snap.is_some() { 0 } else { VIOLATED };
    } else if args.put_right {
        answer.put_right = put_right(&room, &|| true, &|| true);
        match &answer.put_right {
            Some(mended) => room.place(&mended.placements),
            None => exit = VIOLATED,
        }
    }
    let motions = motions_of(args.kind);
    answer.violations = violations(&room, &motions);
    if args.snap.is_none() && answer.violations.iter().any(|v| !v.wish) {
        exit = VIOLATED;
    }
    if args.measure {
        answer.circles = circles(&room);
        if let Some(path) = &args.study {
            let session = study::read(path)?;
            answer.errors = errors(&room, &session);
            answer.session = Some(session);
        }
    }
    if let Some(file) = written.filter(|_| exit == 0) {
        let stages = order(&room, &motions).map_err(|blocked| RoomError::NoOrder(why(&room, &blocked)))?;
        file.write(scenario(&room, &stages, args.kind.into(), &portable(&args.file))?)?;
        answer.order = stages.iter().map(|Stage { piece, .. }| room.pieces[*piece].name.clone()).collect();
    }
    json.write(&answer)?;
    Channel::beside(json.is_out(), false).say(&text::text(&answer, args));
    Ok(exit)
}

/// Reads a room file.
///
/// # Errors
/// If it cannot be read, or is wrong.
fn read(path: &Path) -> Result<Room, RoomError> {
    let fail = |why: String| RoomError::Read { file: path.shown(), why };
    let bytes = regular_file::read(path, MAX_BYTES).map_err(|e| fail(e.to_string()))?;
    let text = String::from_utf8(bytes).map_err(|_| fail("it is not UTF-8 text".to_owned()))?;
    document::read(&path.to_string_lossy(), &text).map_err(|wrong| RoomError::Wrong(Box::new(wrong)))
}

/// Returns all violations, those of `reach` last, which are looked for only if no piece is in another or outside.
fn violations(room: &Room, motions: &Motions) -> Vec<Violation> {
    let mut all = constraint::check(room);
    if !is_impossible(&all) {
        all.extend(reach::check(room, motions));
    }
    all
}

/// Returns whether a piece is in another or outside of the room.
fn is_impossible(violations: &[Violation]) -> bool {
    violations.iter().any(|v| [Rule::Inside.name(), Rule::Apart.name()].contains(&v.rule))
}

/// Returns the text of the scenario in which metamodules of a kind build the room. `going` bounds the search for the
/// order of building; `origin` names the room file.
///
/// # Errors
/// If no order is found, or the room is no scenario.
pub fn scenario_of(
    room: &Room,
    kind: KindArg,
    origin: &str,
    going: &dyn Fn() -> bool,
) -> Result<String, RoomError> {
    let motions = motions_of(kind);
    let stages = order_while(room, &motions, going);
    let stages = stages.map_err(|blocked| match going() {
        true => RoomError::NoOrder(why(room, &blocked)),
        false => RoomError::Late,
    })?;
    Ok(scenario(room, &stages, kind.into(), origin)?)
}

/// Returns the motions of a kind.
pub fn motions_of(kind: KindArg) -> Motions {
    // Invariant: a kind that can be typed has motions, and the database is small enough for them.
    motions(sources(), kind.into()).expect("invariant: kinds of metamodules have motions")
}

fn why(room: &Room, blocked: &reach::Blocked) -> String {
    let names: Vec<&str> = blocked.pieces.iter().map(|p| room.pieces[*p].name.as_str()).collect();
    match names.is_empty() {
        true => "it has no store".to_owned(),
        false => format!("metamodules do not reach all places of {}", names.join(", ")),
    }
}

/// Measures the circles of the room, in metres.
fn circles(room: &Room) -> Vec<CircleAnswer> {
    let metres = |p: usize| room.pieces[p].centre().map(|c| c * CELL_M);
    let all = room.constraints.iter().filter_map(|c| match &c.rule {
        Rule::Circle { pieces, around, .. } => Some((pieces, *around)),
        _ => None,
    });
    let measured = all.filter_map(|(pieces, around)| {
        let chairs: Vec<[f64; 2]> = pieces.iter().map(|p| metres(*p)).collect();
        let precision = precision(&chairs, metres(around))?;
        let around = room.pieces[around].name.clone();
        Some(CircleAnswer { around, pieces: pieces.len(), precision })
    });
    measured.collect()
}

/// What of a session differs from the task: pieces that are missing or too many, and colours.
fn errors(room: &Room, session: &Session) -> Vec<String> {
    let missing = room.pieces.iter().filter(|piece| !session.pieces.contains_key(&piece.name));
    let missing = missing.map(|piece| format!("{} is missing", piece.name));
    let more = session.pieces.keys().filter(|name| room.find(name).is_none());
    let more = more.map(|name| format!("{name} is not part of the task"));
    let wrong = room.pieces.iter().filter_map(|piece| {
        let colour = session.pieces.get(&piece.name)?.colour.as_deref()?;
        (colour != piece.colour.name()).then(|| format!("{} is {colour}", piece.name))
    });
    missing.chain(more).chain(wrong).collect()
}

/// Returns the `[[piece]]` tables of an arrangement.
fn tables(template: TemplateArg, args: &RoomArgs, room: &Room) -> String {
    let template = template.of(args.count.unwrap_or((1, 1)), args.around, args.radius, args.gap);
    // Invariant: only names of shapes can be typed.
    let make = SHAPES.iter().find(|(name, _)| *name == args.shape).map_or(SHAPES[0].1, |(_, make)| *make);
    let places = template.places(&Form::library(make));
    let mut names = fresh_names(args.shape, |name| room.find(name).is_some());
    let table = |place: &Placement| {
        let (name, (x, y)) = (names.next().unwrap_or_default(), place.at);
        format!(
            "[[piece]]\nname = \"{name}\"\nshape = \"{}\"\nat = [{x}, {y}]\nturn = {}\n\n",
            args.shape, place.turn
        )
    };
    places.iter().map(table).collect()
}

impl Answer {
    fn of(file: &Path, room: &Room) -> Answer {
        let piece = |piece: &model::Piece| PieceAnswer {
            name: piece.name.clone(),
            place: piece.place,
            colour: piece.colour,
            metamodules: piece.form.metamodules(),
        };
        Answer {
            schema: SCHEMA,
            version: metamorph_text::version::version(),
            file: file.shown(),
            name: room.name.clone(),
            size: room.size,
            pieces: room.pieces.iter().map(piece).collect(),
            metamodules: room.pieces.iter().map(|p| p.form.metamodules()).sum(),
            ..Answer::default()
        }
    }
}
