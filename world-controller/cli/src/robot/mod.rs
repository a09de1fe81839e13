//! `metamorph robot`: queries the kinematic model of the Roombots.
//!
//! Answers are written as text, or as one JSON value with `--json`. Not here: running a swarm.

mod colour;
mod elements;
mod motions;
mod order;
mod poses;
mod report;
mod svg;

use clap::{Args, Subcommand};
use metamorph_console::command::{CommandOf, Group};
use metamorph_console::output::OutputError;
use metamorph_families::metamodule::motion_database::database;
use metamorph_processes::family::sources;
use metamorph_protocol::roombots::inverse::InverseError;
use metamorph_protocol::roombots::{Kind, KinematicsError};
use metamorph_text::command_error::{BAD_USAGE, CommandError, FAILED};
use metamorph_text::sources::{NoFiles, Sources};
use serde_json::Value;
use std::io::{self, Write};
use std::path::PathBuf;
use thiserror::Error;

/// Query the exact kinematic model of the Roombots
#[derive(Args, Clone, Debug)]
pub struct RobotArgs {
    #[command(subcommand)]
    command: RobotCommand,
    /// Print one JSON value instead of text
    #[arg(long, global = true)]
    json: bool,
    /// Rebuild the motion database instead of reading the cached one
    #[arg(long, global = true)]
    no_cache: bool,
}

#[derive(Subcommand, Clone, Debug)]
enum RobotCommand {
    /// Print a table of the thesis beside the results of the model: 2.2 or 6.1
    Table {
        /// Number of the table
        number: String,
    },
    /// List the shapes that each kind can take
    Shapes {
        /// single, PAR, SRS, PER or SRZ; default: all metamodules
        kind: Option<Kind>,
    },
    /// List the landings and steps of a kind, or a plan to a shape
    Moves(motions::MovesArgs),
    /// The order in which the parts of a scenario's goals can be assembled
    Order(order::OrderArgs),
    /// The postures in which a metamodule carries a passive element
    #[command(after_help = "Example: metamorph robot carry SRS --element plate3x3 --mass 0.5")]
    Carry(elements::CarryArgs),
    /// The pairs of postures in which one metamodule hands a cube to another
    #[command(after_help = "Example: metamorph robot handover SRS --json")]
    Handover(elements::HandoverArgs),
    /// Changes of the colour (x + y + z) mod 2 of a carried cell: none on the lattice, and plans off it
    #[command(after_help = "Example: metamorph robot colour --lattice --walks 10000")]
    Colour(colour::ColourArgs),
    /// Pose of the head: forward kinematics
    Fk(poses::FkArgs),
    /// Joint angles for a pose of the head: inverse kinematics
    Ik(poses::IkArgs),
    /// Draw a posture with its cells and connectors
    Svg(svg::SvgArgs),
    /// Build the motion database and describe its contents
    Database {
        /// Write its bytes to this file
        #[arg(long)]
        out: Option<PathBuf>,
    },
}

/// Why a query was not answered.
#[derive(Debug, Error)]
pub enum RobotError {
    /// The query is invalid.
    #[error("{0}")]
    Usage(String),
    /// The query is invalid for the kinematic model.
    #[error(transparent)]
    Kinematics(#[from] KinematicsError),
    /// No posture has the pose.
    #[error("{0}")]
    OutOfReach(String),
    /// Goals that cannot be assembled.
    #[error("no order of assembly: {0}")]
    NoOrder(String),
    /// Cells that changed colour, which no lattice motion can do.
    #[error("{0} cells changed colour; a lattice motion cannot do that, so the model is wrong")]
    Colour(usize),
    /// A file cannot be written.
    #[error(transparent)]
    File(#[from] OutputError),
    /// The answer could not be written.
    #[error("cannot write the answer: {0}")]
    Output(io::Error),
}

impl CommandError for RobotError {
    fn exit_code(&self) -> u8 {
        match self {
            RobotError::Usage(_) | RobotError::Kinematics(_) => BAD_USAGE,
            RobotError::File(error) => error.exit_code(),
            RobotError::OutOfReach(_)
            | RobotError::NoOrder(_)
            | RobotError::Colour(_)
            | RobotError::Output(_) => FAILED,
        }
    }
    fn text(&self) -> String {
        format!("metamorph: {self}")
    }
}

impl From<InverseError> for RobotError {
    fn from(error: InverseError) -> RobotError {
        match error {
            InverseError::Question(q) => RobotError::Kinematics(q),
            other => RobotError::OutOfReach(other.to_string()),
        }
    }
}

/// The answer to a query.
struct Answer {
    text: String,
    json: Value,
    /// An error to report after the answer.
    failure: Option<RobotError>,
}

impl Answer {
    fn new(text: String, json: Value) -> Answer {
        Answer { text, json, failure: None }
    }
}

/// Answers a query on standard output. A closed pipe is not an error.
pub fn run(args: RobotArgs) -> Result<(), RobotError> {
    run_to(args, &mut io::stdout().lock())
}

/// Answers a query on a writer.
pub fn run_to(args: RobotArgs, out: &mut dyn Write) -> Result<(), RobotError> {
    let kept: &dyn Sources = if args.no_cache { &NoFiles } else { sources() };
    let database = || database(kept);
    let answer = match args.command {
        RobotCommand::Table { number } => report::table(&number)?,
        RobotCommand::Shapes { kind } => motions::shapes(&database(), kind),
        RobotCommand::Moves(moves) => motions::moves(&database(), &moves)?,
        RobotCommand::Order(order) => order::order(&order)?,
        RobotCommand::Carry(carry) => elements::carry(&database(), &carry)?,
        RobotCommand::Handover(handover) => elements::handover(&database(), &handover)?,
        RobotCommand::Colour(colour) => colour::colour(database, &colour)?,
        RobotCommand::Fk(fk) => poses::fk(&fk)?,
        RobotCommand::Ik(ik) => poses::ik(&ik)?,
        RobotCommand::Svg(svg) => svg::answer(&svg)?,
        RobotCommand::Database { out } => motions::database_summary(&database(), out)?,
    };
    let text = if args.json { format!("{:#}\n", answer.json) } else { answer.text };
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => Err(RobotError::Output(e)),
        _ => answer.failure.map_or(Ok(()), Err),
    }
}

/// The command.
pub static COMMAND: CommandOf<RobotArgs> = CommandOf {
    name: "robot",
    group: Some(Group::Study),
    about: "Query the Roombots model: shapes, moves, kinematics, published tables",
    after_help: String::new,
    execute: |args, _| run(args).map(|()| 0).map_err(Into::into),
};
