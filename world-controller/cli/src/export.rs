//! The command `export` to URDF and SDF: the structure of modules at an instant of a recorded run.

use metamorph_console::command::{CommandOf, Group};
use metamorph_console::interrupt::Interrupt;
use metamorph_console::output::{OutputError, Outputs};
use metamorph_console::terminal::{print_error, print_out};
use metamorph_processes::family::{self, Recorded, families, recorded};
use metamorph_processes::record::journal::JournalFailure;
use metamorph_processes::record::journal::ReadError;
use metamorph_scenario::Plan;
use metamorph_scene::figure::snapshot::Playback;
use metamorph_scene::scene::Scene;
use metamorph_text::command_error::Failure;
use metamorph_text::command_error::{BAD_USAGE, CommandError};
use metamorph_text::escape::Shown;
use metamorph_text::format::{many, seconds};
use metamorph_view::export::commands::export_commands;
use metamorph_view::export::csv::Tables;
use metamorph_view::export::export;
use metamorph_view::export::sdf::sdf;
use metamorph_view::export::shiviz::export_shiviz;
use metamorph_view::export::structure::{Measures, NotConnected, Structure};
use metamorph_view::export::urdf::urdf;
use metamorph_view::export::{ExportArgs, Links};
use std::path::Path;
use thiserror::Error;

/// Errors of the export of a structure.
#[derive(Debug, Error)]
pub enum StructureError {
    /// The run had ended before the instant.
    #[error("--at: the run ended at {0}\n  fix: name an earlier time, a share such as 50%, or `end`")]
    Late(String),
    /// Bodies with joints cannot be one link.
    #[error("--bodies merged: metamodules have joints, so they are not one link\n  fix: leave it out")]
    Joints,
    /// The structure is not one piece.
    #[error(transparent)]
    NotConnected(#[from] NotConnected),
    /// The file cannot be written.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// The journal is damaged.
    #[error(transparent)]
    Journal(#[from] JournalFailure),
    /// The journal cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
}

impl CommandError for StructureError {
    fn exit_code(&self) -> u8 {
        match self {
            StructureError::Output(error) => error.exit_code(),
            StructureError::Journal(error) => error.exit_code(),
            StructureError::Read(error) => error.exit_code(),
            _ => BAD_USAGE,
        }
    }
    fn text(&self) -> String {
        match self {
            StructureError::Journal(error) => error.text(),
            StructureError::Read(error) => error.text(),
            _ => format!("metamorph: {self}"),
        }
    }
}

/// A format of structures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// URDF.
    Urdf,
    /// SDF.
    Sdf,
}

/// Reads the plan and the scene of a journal, and prints what is to be noted about it.
fn whole(journal: &Path) -> Result<(Plan, Scene), StructureError> {
    let Recorded { plan, scene, damage } = recorded(journal)?;
    damage.map_or(Ok(()), |damage| Err(JournalFailure::from(damage)))?;
    scene.troubles().iter().for_each(|trouble| print_error(&format!("note: {trouble}")));
    Ok((plan, scene))
}

/// Writes the structure to a file, and returns what was written.
///
/// # Errors
/// If the journal cannot be read, there is no such instant or structure, or the file cannot be written.
pub fn export_structure(args: &ExportArgs, file: &Path, format: Format) -> Result<String, StructureError> {
    let option = if format == Format::Urdf { "--urdf" } else { "--sdf" };
    let output = Outputs::new().creates(option, file)?;
    let (plan, scene) = whole(&args.journal)?;
    let swarm = family::of(&plan).shown(&plan);
    let at = args.structure.at.within(scene.now());
    let at = at.ok_or_else(|| StructureError::Late(seconds(scene.now().as_secs_f64())))?;
    let snapshot = Playback::new(&scene, &*swarm).advance(at);
    let grounded = swarm.stage().floor.is_some();
    let measures = Measures { cell: args.structure.cell, mass: args.structure.mass };
    let structure = match (args.structure.bodies, format) {
        (Some(Links::Merged), _) if grounded => return Err(StructureError::Joints),
        (Some(Links::Merged), _) => Structure::merged(&snapshot, measures),
        (None, Format::Sdf) if !grounded => Structure::merged(&snapshot, measures),
        _ => Structure::of(&snapshot, grounded, measures)?,
    };
    let time = seconds(at.as_secs_f64());
    let title = plan.title();
    let comment =
        format!("{title}, seed {}, at {time}. Made by metamorph {}.", plan.seed, env!("CARGO_PKG_VERSION"));
    let text = match format {
        Format::Urdf => urdf(&structure, &title, &comment),
        Format::Sdf => sdf(&structure, &title, &comment, grounded),
    };
    output.write(text)?;
    Ok(format!(
        "{}: {} at {time}, {}, {}\n",
        file.shown(),
        many(snapshot.bodies.len() as u64, "module"),
        many(structure.links.len() as u64, "link"),
        many((structure.tree.len() + structure.loops.len()) as u64, "connection"),
    ))
}

/// Writes the tables of the run that a journal holds.
///
/// # Errors
/// If the journal cannot be read or is damaged, or a file cannot be written.
pub fn write_tables(journal: &Path, tables: &Tables) -> Result<(), Failure> {
    let (_, scene) = whole(journal)?;
    Ok(tables.write(journal, &scene)?)
}

/// Examples for the help.
const EXAMPLES: &str = "\
Examples:
  metamorph run swarm --link sim --journal run.journal
  metamorph export run.journal --mcap run.mcap
  metamorph export run.journal --mcap run.mcap --schema ros2
  metamorph export run.journal --csv tables
  metamorph export run.journal --shiviz run.log --during 50s..60s
  metamorph export run.journal --at 50% --urdf half.urdf
  metamorph export run.journal --sdf end.sdf --cell 0.05 --mass 0.2

The recording has Foxglove's SceneUpdate on /modules and Log on /log. Open it in Foxglove or in Lichtblick
and show /modules in a 3D panel whose frame is `world`. With --schema ros2 it has MarkerArray on
/modules, TFMessage on /tf and Log on /rosout.

A log for ShiViz (https://bestchai.bitbucket.io/shiviz) has a line for each module and an arrow for each
message; incarnations after the first are modules of their own.

A structure is in metres, kilograms and radians with z up. URDF has a tree of connections and names how
many are left out; SDF has all of them.

Exit codes:
  0  the recording or the structure is written
  1  it could not be written completely
  2  the command line is wrong, or the file is not a journal of this version
  9  the journal is damaged; no recording is left behind";

fn execute(args: &ExportArgs, interrupt: &Interrupt) -> Result<u8, Failure> {
    let said = match (&args.mcap, &args.urdf, &args.sdf, &args.commands, &args.csv) {
        (Some(file), ..) => export(args, file, families(), |plan| family::of(plan).shown(plan), interrupt)?,
        (None, Some(file), ..) => export_structure(args, file, Format::Urdf)?,
        (None, None, Some(file), ..) => export_structure(args, file, Format::Sdf)?,
        (None, None, None, Some(file), _) => export_commands(&args.journal, file, families())?,
        (None, None, None, None, Some(directory)) => {
            write_tables(&args.journal, &Tables::new(directory, &mut Outputs::new())?)?;
            format!("{}: modules.csv, time.csv and latency.csv\n", directory.shown())
        }
        (None, None, None, None, None) => {
            let file = args.shiviz.as_ref().expect("invariant: clap asks for one of them");
            export_shiviz(args, file, families(), |plan, step| family::of(plan).brief(plan, step))?
        }
    };
    print_out(&said);
    Ok(0)
}

/// The command.
pub static COMMAND: CommandOf<ExportArgs> = CommandOf {
    name: "export",
    group: Some(Group::Look),
    about: "Export a journal as a recording for other viewers, or its structure at an instant as URDF or SDF",
    after_help: || EXAMPLES.to_owned(),
    execute: |args, call| execute(&args, call.interrupt),
};
