//! Exports of a journal: the structure at an instant as URDF or SDF ([`structure`], [`urdf`], [`sdf`]), and here the run
//! as a recording for robotics viewers such as Foxglove: an MCAP file with scene updates
//! and a log in Foxglove's schemas, as JSON.
//!
//! Bodies are drawn by their parts, in cells of one metre; the time of the recording is the scenario's. Every
//! update holds all modules, because a viewer that jumps to a time shows the last update before it and
//! nothing older. So updates have a minimum interval, and the file size grows with modules times time. Not
//! here: messages between modules, and the course of a body between two cells, which `metamorph view` shows.

pub mod commands;
pub mod csv;
mod foxglove;
mod ros2;
pub mod sdf;
pub mod shiviz;
pub mod structure;
pub mod urdf;
mod xml;

use clap::{Args, ValueEnum};
use foxglove::{Colour, Cube, Entity, Level, Log, Pair, SceneUpdate, schema_of};
use mcap::records::MessageHeader;
use mcap::{McapError, WriteOptions, Writer};
use metamorph_console::interrupt::Interrupt;
use metamorph_console::output::{OutputError, Outputs};
use metamorph_processes::record::journal::{Event, HeadError, Journal, JournalFailure, Record, Who, plan_of};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::record::Blob;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::{Span, Time};
use metamorph_scenario::Plan;
use metamorph_scenario::family::Families;
use metamorph_scene::bodies::ShownSwarm;
use metamorph_scene::figure::options::Moment;
use metamorph_scene::parts::{Part, Shape};
use metamorph_scene::visible::{self, Words};
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_text::command_error::{BAD_USAGE, CommandError, FAILED};
use metamorph_text::escape::Shown;
use metamorph_text::format::{many, seconds};
use ros2::{CloudPoint, Definition, Marker};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// The options of `export`.
#[derive(Debug, Args)]
pub struct ExportArgs {
    /// The journal of a run (see `run --journal`)
    #[arg(value_name = "JOURNAL")]
    pub journal: PathBuf,
    /// Write Foxglove's scene updates to this MCAP file, which must not exist yet
    #[arg(long, value_name = "FILE", required_unless_present_any = ["urdf", "sdf", "commands", "csv", "shiviz"], conflicts_with_all = ["urdf", "sdf", "commands", "csv", "shiviz"])]
    pub mcap: Option<PathBuf>,
    /// The messages of a recording: Foxglove's as JSON, or those of ROS 2 in CDR
    #[arg(long, value_enum, default_value_t = Schema::Foxglove, requires = "mcap")]
    pub schema: Schema,
    /// Shortest scenario time between two updates of a recording, in milliseconds
    #[arg(long, value_name = "MS", default_value_t = 100)]
    pub every: u32,
    /// Write the structure at one instant as URDF to this file, which must not exist yet
    #[arg(long, value_name = "FILE", conflicts_with = "sdf")]
    pub urdf: Option<PathBuf>,
    /// Write the structure at one instant as SDF 1.9 to this file, which must not exist yet
    #[arg(long, value_name = "FILE")]
    pub sdf: Option<PathBuf>,
    /// Write the scenario of the run with the commands that operators gave to it, to this file, which must not exist yet
    #[arg(long, value_name = "FILE", conflicts_with_all = ["urdf", "sdf"])]
    pub commands: Option<PathBuf>,
    /// Write modules.csv (a line for each module), time.csv (a line for each time bin) and latency.csv (a histogram of each
    /// class of messages) into this directory
    #[arg(long, value_name = "DIR", conflicts_with_all = ["urdf", "sdf", "commands"])]
    pub csv: Option<PathBuf>,
    /// Write the inputs of agents with vector clocks to this file, which must not exist yet: a log for ShiViz, which draws the
    /// happens-before order
    #[arg(long, value_name = "FILE", conflicts_with_all = ["urdf", "sdf", "commands", "csv"])]
    pub shiviz: Option<PathBuf>,
    /// The part of the run in such a log, from one scenario time to another; default: all of it
    #[arg(long, value_name = "T..T", value_parser = during, requires = "shiviz")]
    pub during: Option<(Time, Time)>,
    /// How the structure at an instant is written.
    #[command(flatten)]
    pub structure: StructureArgs,
}

/// The messages of a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Schema {
    /// foxglove.SceneUpdate and foxglove.Log, as JSON
    Foxglove,
    /// visualization_msgs/MarkerArray, sensor_msgs/PointCloud2, tf2_msgs/TFMessage and rcl_interfaces/Log, in CDR
    Ros2,
}

/// How the structure at an instant is written.
#[derive(Debug, Args)]
pub struct StructureArgs {
    /// The instant of a structure: a scenario time, a share of the run (50%), or `end`
    #[arg(long, value_name = "T", default_value = "end", conflicts_with = "mcap")]
    pub at: Moment,
    /// Links of a structure: one for each module, or all merged in one; default: of URDF and of metamodules
    /// modules, of cubes in SDF merged
    #[arg(long, value_enum, conflicts_with = "mcap")]
    pub bodies: Option<Links>,
    /// The edge of a cell in metres
    #[arg(long, value_name = "M", default_value = "0.11", value_parser = positive, conflicts_with = "mcap")]
    pub cell: f64,
    /// The mass of a module in kilograms; the default is an assumption
    #[arg(long, value_name = "KG", default_value = "0.5", value_parser = positive, conflicts_with = "mcap")]
    pub mass: f64,
}

/// The links of a structure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Links {
    /// Each module has links of its own
    Modules,
    /// All modules are one link
    Merged,
}

fn during(text: &str) -> Result<(Time, Time), String> {
    let (from, until) = text.split_once("..").ok_or("write two times, such as 50s..60s")?;
    let time = |text: &str| text.parse::<Span>().map(|span| Time::ZERO + span).map_err(|e| e.to_string());
    let (from, until) = (time(from)?, time(until)?);
    if from < until { Ok((from, until)) } else { Err("the second time must be later".to_owned()) }
}

fn positive(text: &str) -> Result<f64, &'static str> {
    let number = text.parse::<f64>().ok().filter(|number| number.is_finite() && *number > 0.0);
    number.ok_or("say a number above 0, such as 0.11")
}

/// Errors of an export.
#[derive(Debug, Error)]
pub enum ExportError {
    /// The journal cannot be read.
    #[error(transparent)]
    Journal(#[from] JournalFailure),
    /// Its scenario cannot be read.
    #[error("{0}\n  fix: use the program that wrote the journal")]
    Head(#[from] HeadError),
    /// It holds commands that this program does not know.
    #[error("{0}\n  fix: use the program that wrote the journal")]
    Commands(String),
    /// Too many inputs for a viewer that draws all at once.
    #[error("--shiviz: more than {inputs} inputs of agents between {from} and {until}\n  fix: name a shorter time, such as --during {}..{}", Span(from.0), Span(until.0))]
    TooManyInputs {
        /// Number of inputs up to where there are too many.
        inputs: usize,
        /// When the part of the run begins.
        from: Time,
        /// When there are too many.
        until: Time,
    },
    /// No input in the part of the run.
    #[error("--during: no agent took an input then\n  fix: name a time within the run")]
    NoInput,
    /// The recording cannot be written to its file.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// Interrupted by a signal.
    #[error("--mcap {}: interrupted; nothing is written there", .path.shown())]
    Interrupted {
        /// The file.
        path: PathBuf,
    },
    /// The recording cannot be finished.
    #[error("--mcap {}: the recording could not be written to its end: {error}", .path.shown())]
    Write {
        /// The file.
        path: PathBuf,
        /// The cause.
        error: McapError,
    },
}

impl CommandError for ExportError {
    fn exit_code(&self) -> u8 {
        match self {
            ExportError::Output(error) => error.exit_code(),
            ExportError::Journal(error) => error.exit_code(),
            ExportError::Head(_) | ExportError::Commands(_) => BAD_USAGE,
            ExportError::TooManyInputs { .. } | ExportError::NoInput => BAD_USAGE,
            ExportError::Interrupted { .. } => Outcome::Aborted.exit_code(),
            ExportError::Write { .. } => FAILED,
        }
    }
    fn text(&self) -> String {
        format!("metamorph: {self}")
    }
}

/// The drawn state of a module.
#[derive(Clone, Debug, Default, PartialEq)]
struct Body {
    parts: Vec<Part>,
    role: String,
    process: Process,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Process {
    #[default]
    Alive,
    Paused,
    Dead,
}

impl Process {
    fn name(self) -> &'static str {
        match self {
            Process::Alive => "alive",
            Process::Paused => "paused",
            Process::Dead => "dead",
        }
    }
}

impl Body {
    /// Returns the colour that the page uses in its light theme.
    fn colour(&self, words: &Words) -> Colour {
        match self.process {
            Process::Dead => return Colour::rgb(0x43, 0x47, 0x4d),
            Process::Paused => return Colour::rgb(0x8f, 0x86, 0xc9),
            Process::Alive => {}
        }
        let role = words.roles.iter().find(|role| role.name == self.role);
        match role.map_or(visible::Colour::Idle, |role| role.colour) {
            visible::Colour::Idle => Colour::rgb(0xb4, 0xc0, 0xcb),
            visible::Colour::Active => Colour::rgb(0xf0, 0x99, 0x3e),
            visible::Colour::Done => Colour::rgb(0x3d, 0x83, 0xc0),
        }
    }
    /// Returns the boxes of a body with a small gap between them. The two halves of a ball make one.
    fn boxes(&self) -> Vec<(Part, [f64; 3])> {
        const SHARE: f64 = 0.95;
        let mut halves = Vec::new();
        let mut boxes = Vec::new();
        for part in &self.parts {
            let size = match part.shape {
                Shape::Box { size } => size,
                Shape::HalfCube { half_edge, .. } => {
                    if halves.contains(&part.centre()) {
                        continue;
                    }
                    halves.push(part.centre());
                    [2.0 * half_edge; 3]
                }
            };
            boxes.push((*part, size.map(|edge| edge * SHARE)));
        }
        boxes
    }
    fn entity(&self, id: ModuleId, at: Time, words: &Words) -> Entity<'_> {
        let about =
            [Pair { key: "role", value: &self.role }, Pair { key: "process", value: self.process.name() }];
        let colour = self.colour(words);
        let cubes = self.boxes().into_iter().map(|(part, size)| Cube::new(&part, size, colour)).collect();
        Entity::new(at, format!("module {id}"), about, cubes)
    }
    /// Returns the middle of all parts.
    fn point(&self, id: ModuleId, words: &Words) -> Option<CloudPoint> {
        let centres: Vec<[f64; 3]> = self.parts.iter().map(|part| part.centre().into()).collect();
        let share = 1.0 / centres.len().max(1) as f64;
        let at = [0, 1, 2].map(|axis| centres.iter().map(|centre| centre[axis]).sum::<f64>() * share);
        (!centres.is_empty()).then(|| CloudPoint { module: id, at, colour: self.colour(words) })
    }
    fn markers(&self, id: ModuleId, words: &Words) -> impl Iterator<Item = Marker> {
        let colour = self.colour(words);
        self.boxes().into_iter().enumerate().map(move |(number, (part, size))| Marker {
            name: format!("module_{id}"),
            number: number as u32,
            part,
            size,
            colour,
        })
    }
}

/// The channels of a recording.
#[derive(Clone, Copy, Debug)]
enum Channels {
    Foxglove { scene: u16, log: u16 },
    Ros2 { markers: u16, cloud: u16, frames: u16, diagnostics: u16, log: u16 },
}

type Output = Writer<BufWriter<File>>;

impl Channels {
    fn foxglove(writer: &mut Output) -> Result<Channels, McapError> {
        let none = BTreeMap::new();
        let scene = writer.add_schema("foxglove.SceneUpdate", "jsonschema", &schema_of::<SceneUpdate>())?;
        let log = writer.add_schema("foxglove.Log", "jsonschema", &schema_of::<Log>())?;
        Ok(Channels::Foxglove {
            scene: writer.add_channel(scene, "/modules", "json", &none)?,
            log: writer.add_channel(log, "/log", "json", &none)?,
        })
    }

    fn ros2(writer: &mut Output) -> Result<Channels, McapError> {
        let none = BTreeMap::new();
        let mut add = |Definition { name, text }, topic| {
            let schema = writer.add_schema(name, "ros2msg", text.as_bytes())?;
            writer.add_channel(schema, topic, "cdr", &none)
        };
        Ok(Channels::Ros2 {
            markers: add(ros2::MARKERS, "/modules")?,
            cloud: add(ros2::CLOUD, "/cloud")?,
            frames: add(ros2::FRAMES, "/tf")?,
            diagnostics: add(ros2::DIAGNOSTICS, "/diagnostics")?,
            log: add(ros2::LOG, "/rosout")?,
        })
    }
}

/// Returns a message as JSON.
fn json(message: &impl Serialize) -> Vec<u8> {
    serde_json::to_vec(message)
        .expect("invariant: messages are made of plain values, text keys and finite numbers")
}

/// The file, and the state of the modules at the current time.
struct Recording {
    writer: Writer<BufWriter<File>>,
    words: &'static Words,
    channels: Channels,
    sequence: u32,
    updates: u64,
    bodies: BTreeMap<ModuleId, Body>,
    /// True if a module has changed since the last update.
    changed: bool,
    every: Span,
    /// The earliest time of the next update.
    due: Time,
    now: Time,
}

/// Writes the recording, and returns a summary of it for the terminal.
///
/// # Errors
/// If the journal cannot be read, or the file cannot be written.
pub fn export(
    args: &ExportArgs,
    file: &Path,
    families: Families,
    shown: fn(&Plan) -> Box<dyn ShownSwarm>,
    interrupt: &Interrupt,
) -> Result<String, ExportError> {
    let output = Outputs::new().creates("--mcap", file)?;
    let mut journal = Journal::open(&args.journal).map_err(JournalFailure::from)?;
    let plan = plan_of(families, journal.head())?;
    let swarm = shown(&plan);
    let parts = |place: &Blob| swarm.parts(place);
    let path = || file.to_owned();
    interrupt.begin();
    let write = |error| ExportError::Write { path: path(), error };
    let draft = output.begin()?;
    let handle = draft.handle().map_err(|error| write(error.into()))?;
    let mut recording = Recording::begin(handle, swarm.words(), Span::millis(args.every.into()), args.schema)
        .map_err(write)?;
    let mut records = 0;
    for record in journal.by_ref() {
        // Half a recording would look like a whole one, so the file gets its name at the end.
        let record = record.map_err(JournalFailure::from)?;
        records += 1;
        if interrupt.is_set() {
            return Err(ExportError::Interrupted { path: path() });
        }
        recording.take(&record, &parts).map_err(write)?;
    }
    let troubles = journal.troubles();
    recording.end(&troubles).map_err(write)?;
    output.finish(draft)?;
    let mut said = format!(
        "{}: {} in {} until {}, from {}\n",
        file.shown(),
        many(recording.bodies.len() as u64, "module"),
        many(recording.updates, "update"),
        seconds(recording.now.as_secs_f64()),
        many(records, "record"),
    );
    for trouble in troubles {
        said.push_str(&format!("note: {trouble}\n"));
    }
    Ok(said)
}

impl Recording {
    fn begin(file: File, words: &'static Words, every: Span, schema: Schema) -> Result<Recording, McapError> {
        let library = format!("metamorph {}", metamorph_text::version::version());
        let profile = if schema == Schema::Ros2 { "ros2" } else { "" };
        let options = WriteOptions::new().compression(None).library(library).profile(profile);
        let mut writer = options.create(BufWriter::new(file))?;
        Ok(Recording {
            channels: match schema {
                Schema::Foxglove => Channels::foxglove(&mut writer)?,
                Schema::Ros2 => Channels::ros2(&mut writer)?,
            },
            writer,
            words,
            sequence: 0,
            updates: 0,
            bodies: BTreeMap::new(),
            changed: false,
            every,
            due: Time::ZERO,
            now: Time::ZERO,
        })
    }

    fn take(&mut self, record: &Record, parts: &dyn Fn(&Blob) -> Option<Vec<Part>>) -> Result<(), McapError> {
        // Records of several files are in causal order; their times are not always.
        if record.at > self.now {
            if self.changed && self.now >= self.due {
                self.update()?;
            }
            self.now = record.at;
        }
        match &record.event {
            Event::Start { id, place, .. } => self.change(*id, |body| {
                *body = Body { parts: parts(place).unwrap_or_default(), ..Body::default() };
            }),
            Event::Advance { ended } => {
                for (id, place) in ended {
                    self.change(*id, |body| {
                        if let Some(parts) = parts(place) {
                            body.parts = parts;
                        }
                    });
                }
            }
            Event::Started { id } if record.at > Time::ZERO => self.process(*id, Process::Alive)?,
            Event::Died { id } => self.process(*id, Process::Dead)?,
            Event::Command(Command::Pause(id)) => self.process(*id, Process::Paused)?,
            Event::Command(Command::Resume(id)) => self.process(*id, Process::Alive)?,
            Event::State(summary) => {
                if let Who::Agent(id, _) = record.who {
                    self.change(id, |body| body.role.clone_from(&summary.role));
                }
            }
            Event::Injected { fault, by, effect, .. } => {
                self.say(Level::Warning, &format!("{fault} ({by}): {effect}"))?
            }
            Event::Violated { invariant, what } => {
                self.say(Level::Error, &format!("{invariant} broke: {what}"))?;
            }
            Event::Ended { outcome, .. } => self.say(Level::Info, &format!("the run ended: {outcome}"))?,
            _ => {}
        }
        Ok(())
    }

    /// Notes what has become of the process of a module.
    fn process(&mut self, id: ModuleId, process: Process) -> Result<(), McapError> {
        self.change(id, |body| body.process = process);
        let Channels::Ros2 { diagnostics, .. } = self.channels else { return Ok(()) };
        let level = match process {
            Process::Alive => Level::Info,
            Process::Paused => Level::Warning,
            Process::Dead => Level::Error,
        };
        self.write(diagnostics, &ros2::diagnostics(self.now, id, level, process.name()))
    }

    fn change(&mut self, id: ModuleId, change: impl FnOnce(&mut Body)) {
        let body = self.bodies.entry(id).or_default();
        let before = body.clone();
        change(body);
        self.changed |= *body != before;
    }

    fn update(&mut self) -> Result<(), McapError> {
        match self.channels {
            Channels::Foxglove { scene, .. } => {
                let entities = self.bodies.iter().map(|(id, body)| body.entity(*id, self.now, self.words));
                let update = json(&SceneUpdate::new(entities.collect()));
                self.write(scene, &update)?;
            }
            Channels::Ros2 { markers, cloud, frames, .. } => {
                let boxes = self.bodies.iter().flat_map(|(id, body)| body.markers(*id, self.words));
                let boxes: Vec<Marker> = boxes.collect();
                let firsts = self.bodies.iter().filter_map(|(id, body)| Some((id, body.parts.first()?)));
                let firsts: Vec<_> = firsts.map(|(id, part)| (format!("module_{id}"), part)).collect();
                let (marked, framed) =
                    (ros2::markers(self.now, &boxes), ros2::frames(self.now, firsts.into_iter()));
                let points = self.bodies.iter().filter_map(|(id, body)| body.point(*id, self.words));
                let points = ros2::cloud(self.now, &points.collect::<Vec<_>>());
                self.write(markers, &marked)?;
                self.write(cloud, &points)?;
                self.write(frames, &framed)?;
            }
        }
        self.changed = false;
        self.updates += 1;
        self.due = self.now + self.every;
        Ok(())
    }

    /// Writes the final state, and what was missing.
    fn end(&mut self, troubles: &[String]) -> Result<(), McapError> {
        if self.changed {
            self.update()?;
        }
        for trouble in troubles {
            self.say(Level::Warning, trouble)?;
        }
        self.writer.finish().map(drop)
    }

    fn say(&mut self, level: Level, message: &str) -> Result<(), McapError> {
        match self.channels {
            Channels::Foxglove { log, .. } => self.write(log, &json(&Log::new(self.now, level, message))),
            Channels::Ros2 { log, .. } => self.write(log, &ros2::log(self.now, level, message)),
        }
    }

    fn write(&mut self, channel_id: u16, data: &[u8]) -> Result<(), McapError> {
        let (sequence, log_time) = (self.sequence, self.now.0);
        self.sequence += 1;
        let header = MessageHeader { channel_id, sequence, log_time, publish_time: log_time };
        self.writer.write_to_known_channel(&header, data)
    }
}
