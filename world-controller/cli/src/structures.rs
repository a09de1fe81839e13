//! The command `export` to URDF and SDF: the structure of modules at an instant of a recorded run.

use metamorph_console::output::{OutputError, Outputs};
use metamorph_processes::family::{self, Recorded, recorded};
use metamorph_processes::record::journal::JournalFailure;
use metamorph_processes::record::journal::ReadError;
use metamorph_scene::figure::snapshot::Playback;
use metamorph_text::command_error::{BAD_USAGE, CommandError};
use metamorph_text::escape::Shown;
use metamorph_text::format::{many, seconds};
use metamorph_view::export::sdf::sdf;
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

/// Writes the structure to a file, and returns what was written.
///
/// # Errors
/// If the journal cannot be read, there is no such instant or structure, or the file cannot be written.
pub fn export_structure(args: &ExportArgs, file: &Path, format: Format) -> Result<String, StructureError> {
    let option = if format == Format::Urdf { "--urdf" } else { "--sdf" };
    let output = Outputs::new().creates(option, file)?;
    let Recorded { plan, scene, damage } = recorded(&args.journal)?;
    let swarm = family::of(&plan).shown(&plan);
    if let Some(damage) = damage {
        return Err(JournalFailure::from(damage).into());
    }
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
