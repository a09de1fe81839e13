//! The cells of files that a person opens: on the command line, under `--dir`, or sent by the page.

use super::StudioError;
use super::analyses::MAX_CELLS;
use super::directory::is_name;
use crate::console::escape::Shown as _;
use crate::scenario::mesh_import::{Format, Import, Imported, import, pitch_for};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::pairing::pins::Pin;
use serde::Serialize;
use std::fs;
use std::path::Path;

/// Length of the longest side of a solid, in cells.
const CELLS: u16 = 16;

/// A drawing made of a file.
#[derive(Clone, Debug, Serialize)]
pub struct OpenedDrawing {
    /// The name of the file, without its path and ending.
    pub name: String,
    /// The cells.
    pub cells: Vec<Cell>,
    /// The pins of a drawing.
    pub pins: Vec<Pin>,
    /// What was left out, as text.
    pub note: Option<String>,
}

/// Opens a file.
pub fn open(path: &Path) -> Result<OpenedDrawing, StudioError> {
    let pitch = if Format::of(path)?.is_mesh() { Some(pitch_for(path, CELLS)?) } else { None };
    let Imported { cells, pins, thin, .. } = import(path, &Import { pitch, ..Import::default() })?;
    if cells.len() > MAX_CELLS {
        return Err(StudioError::TooLarge { file: path.shown(), cells: cells.len() });
    }
    let name = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    Ok(OpenedDrawing { name, cells, pins, note: thin.map(|thin| format!("left out: {thin}")) })
}

/// Makes cells of the content of a file of this name.
///
/// # Errors
/// What is wrong with it, for the page.
pub fn open_content(name: &str, content: &[u8]) -> Result<OpenedDrawing, String> {
    if !is_name(name) {
        return Err(super::directory::DirectoryError::Name.to_string());
    }
    // The readers of solids take files.
    let directory = tempfile::tempdir().map_err(|error| format!("no room for the file: {error}"))?;
    let path = directory.path().join(name);
    fs::write(&path, content).map_err(|error| format!("no room for the file: {error}"))?;
    let place = format!("{}/", directory.path().display());
    open(&path).map_err(|error| error.to_string().replace(&place, ""))
}
