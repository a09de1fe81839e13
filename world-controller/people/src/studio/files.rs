//! Reading of files that a person opens: on the command line, under `--dir`, or sent by the page.

use super::StudioError;
use super::analyses::MAX_CELLS;
use super::directory::{MAX_FILE, is_name};
use super::rooms::{Drawings, MAX_TEXT, OpenedRoom};
use crate::room::document::read_with;
use metamorph_module_agent::regular_file;
use metamorph_processes::family::sources;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::pairing::pins::Pin;
use metamorph_scenario::shipped::resolve;
use metamorph_shapes::{Format, Import, Imported, import, pitch_for};
use metamorph_text::escape::Shown as _;
use serde::Serialize;
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use toml::de::DeTable;

/// Length of the longest side of a solid, in cells.
const CELLS: u16 = 16;

/// Content of an opened file.
#[derive(Clone, Debug)]
pub enum Opened {
    /// Cells.
    Drawing(OpenedDrawing),
    /// A room.
    Room(OpenedRoom),
}

/// A drawing made of a file.
#[derive(Clone, Debug, Serialize)]
pub struct OpenedDrawing {
    /// The name of the file, without its path and ending.
    pub name: String,
    /// The cells.
    pub cells: Vec<Cell>,
    /// The pins of a drawing.
    pub pins: Vec<Pin>,
    /// Note about content that was left out.
    pub note: Option<String>,
}

/// Opens a file of the command line. Drawings that a room names are read beside it, and added to `given`.
///
/// # Errors
/// If it cannot be read, or is wrong.
pub fn open(path: &Path, given: &mut BTreeMap<String, Vec<u8>>) -> Result<Opened, StudioError> {
    match room_text(path) {
        Some(text) => {
            let (origin, found) = (path.to_string_lossy(), RefCell::new(BTreeMap::new()));
            let beside = |name: &str| {
                let content = regular_file::read(&resolve(&origin, name), MAX_FILE);
                let content = content.map_err(|error| error.to_string())?;
                found.borrow_mut().insert(name.to_owned(), content.clone());
                Ok(content)
            };
            read_with(&origin, &text, &beside).map_err(|wrong| StudioError::Room(Box::new(wrong)))?;
            for (name, content) in found.into_inner() {
                given.entry(name).or_insert(content);
            }
            Ok(Opened::Room(OpenedRoom { name: stem(path), text }))
        }
        None => open_drawing(path).map(Opened::Drawing),
    }
}

/// Returns the text of a file that is a room file: TOML with a table `room`.
fn room_text(path: &Path) -> Option<String> {
    let is_toml = path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("toml"));
    let content = is_toml.then(|| regular_file::read(path, MAX_TEXT as u64).ok()).flatten()?;
    String::from_utf8(content).ok().filter(|text| is_room(text))
}

fn is_room(text: &str) -> bool {
    DeTable::parse(text).is_ok_and(|table| table.get_ref().contains_key("room"))
}

fn stem(path: &Path) -> String {
    path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default()
}

fn open_drawing(path: &Path) -> Result<OpenedDrawing, StudioError> {
    let pitch = if Format::of(path)?.is_mesh() { Some(pitch_for(sources(), path, CELLS)?) } else { None };
    let Imported { cells, pins, thin, mut notes, .. } =
        import(sources(), path, &Import { pitch, ..Import::default() })?;
    if cells.len() > MAX_CELLS {
        return Err(StudioError::TooLarge { file: path.shown(), cells: cells.len() });
    }
    let name = stem(path);
    notes.extend(thin.map(|thin| format!("left out: {thin}")));
    Ok(OpenedDrawing { name, cells, pins, note: (!notes.is_empty()).then(|| notes.join("; ")) })
}

/// Opens the content of a file of this name, whose room finds its drawings by `drawings`.
///
/// # Errors
/// What is wrong with it, for the page.
pub fn open_content(name: &str, content: &[u8], drawings: &Drawings) -> Result<Opened, String> {
    if !is_name(name) {
        return Err(super::directory::DirectoryError::Name.to_string());
    }
    let text = str::from_utf8(content).ok().filter(|text| name.ends_with(".toml") && is_room(text));
    if let Some(text) = text {
        if text.len() > MAX_TEXT {
            return Err(format!("{name}: a room file has at most {} KiB here", MAX_TEXT >> 10));
        }
        let read = |drawing: &str| drawings.read(drawing);
        read_with(name, text, &read).map_err(|wrong| wrong.to_string().trim_end().to_owned())?;
        return Ok(Opened::Room(OpenedRoom { name: stem(Path::new(name)), text: text.to_owned() }));
    }
    // The readers of solids take files.
    let directory = tempfile::tempdir().map_err(|error| format!("no room for the file: {error}"))?;
    let path = directory.path().join(name);
    fs::write(&path, content).map_err(|error| format!("no room for the file: {error}"))?;
    let place = format!("{}/", directory.path().display());
    let opened = open_drawing(&path).map_err(|error| error.to_string().replace(&place, ""));
    opened.map(Opened::Drawing)
}
