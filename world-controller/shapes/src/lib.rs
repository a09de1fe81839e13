//! Shapes from files: STL and OBJ solids from CAD programs, converted to cells, scenes of MagicaVoxel, configurations of
//! VisibleSim, and drawings.
//!
//! `mesh` reads triangles, `surface` finds where they are not closed, `voxel` finds the cells that they enclose, `vox`
//! reads scenes, `visiblesim` reads configurations, `csg` the solids in them, `drawing` reads and writes drawings, `printability` says what of a
//! shape cannot be built, `preview` shows it and writes it as a scenario, `error` has the errors.
//!
//! *Invariant.* No file makes this panic or exceed the memory and time that the limits in `error` allow.
//! Absent: repairing broken meshes, beyond the repairs of `surface`; a mesh with large holes has no inside.

pub mod analysis;
mod csg;
pub mod drawing;
pub mod error;
mod mesh;
pub mod preview;
pub mod printability;
mod surface;
mod visiblesim;
mod vox;
mod voxel;

use drawing::Drawing;
use error::{MAX_BOX, MAX_BYTES, SolidError};
use metamorph_core::lattice::Cell;
use metamorph_pairing::pins::Pin;
use metamorph_text::escape::Shown;
use metamorph_text::sources::Sources;
use std::collections::BTreeSet;
use std::path::Path;
pub use visiblesim::Part;
use visiblesim::in_range;

/// Which axis of a file points up.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub enum Up {
    /// As in scenarios.
    #[default]
    Z,
    /// As in many modelling programs.
    Y,
}

/// How to convert a file to cells.
#[derive(Clone, Debug, Default)]
pub struct Import {
    /// The edge of a cell in the units of the file. A mesh needs it, a configuration has none.
    pub pitch: Option<f64>,
    /// Which axis points up in a mesh.
    pub up: Option<Up>,
    /// The cell where the shape is placed: for a mesh, that of the centre of its lowest layer; for a
    /// configuration, that of its origin.
    pub at: Cell,
    /// The part of a configuration.
    pub part: Option<Part>,
    /// Whether parts of a mesh that are thinner than a cell may be lost.
    pub drop_thin: bool,
    /// Whether inner voids are filled.
    pub fill_voids: bool,
}

/// Cells read from a file.
#[derive(Clone, Debug)]
pub struct Imported {
    /// In ascending order; at least one.
    pub cells: Vec<Cell>,
    /// The parts of a mesh lost because they are thinner than a cell.
    pub thin: Option<SolidError>,
    /// The mesh they came from.
    pub mesh: Option<MeshFacts>,
    /// The pins of a drawing, in ascending order: cells that are one module each. Only pairing heeds them.
    pub pins: Vec<Pin>,
    /// Faults of the file that were read over, and content that was left out, each in one sentence.
    pub notes: Vec<String>,
}

/// Properties of a mesh.
#[derive(Clone, Debug)]
pub struct MeshFacts {
    /// Its triangles.
    pub triangles: usize,
    /// Its extent in the units of the file.
    pub size: [f64; 3],
    /// The edge of a cell.
    pub pitch: f64,
}

/// File formats, by the extension of the name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Triangles, binary or as text.
    Stl,
    /// Polygons as text.
    Obj,
    /// A configuration of VisibleSim.
    VisibleSim,
    /// A scene of MagicaVoxel.
    Vox,
    /// Listed cells.
    Drawing,
}

impl Format {
    /// Returns the format of a file with this name.
    pub fn of(path: &Path) -> Result<Format, SolidError> {
        let end = path.extension().and_then(|e| e.to_str()).unwrap_or_default().to_ascii_lowercase();
        match end.as_str() {
            "stl" => Ok(Format::Stl),
            "obj" => Ok(Format::Obj),
            "xml" => Ok(Format::VisibleSim),
            "vox" => Ok(Format::Vox),
            "toml" => Ok(Format::Drawing),
            _ => Err(SolidError::Format(path.shown())),
        }
    }
    /// Returns true for triangles and polygons, which need a pitch.
    pub fn is_mesh(self) -> bool {
        matches!(self, Format::Stl | Format::Obj)
    }
}

/// Reads a file of `sources` and converts it to cells. Lost thin parts are not an error here.
pub fn import(sources: &dyn Sources, path: &Path, how: &Import) -> Result<Imported, SolidError> {
    let file = path.shown();
    let refuse = |wrong: bool, option, what| {
        let file = file.clone();
        if wrong { Err(SolidError::Option { file, option, what }) } else { Ok(()) }
    };
    let mut imported = match Format::of(path)? {
        format @ (Format::VisibleSim | Format::Drawing | Format::Vox) => {
            let what = match format {
                Format::Vox => "a scene of MagicaVoxel, which is made of cells",
                Format::Drawing => "a drawing, which is made of cells",
                _ => "a configuration of VisibleSim, which is made of cells",
            };
            refuse(how.pitch.is_some(), "pitch", what)?;
            refuse(how.up.is_some(), "up", what)?;
            refuse(how.drop_thin, "thin", what)?;
            let part = match format {
                Format::Vox => Some("a scene of MagicaVoxel, which is one shape"),
                Format::Drawing => Some("a drawing, which is one shape"),
                _ => None,
            };
            part.map_or(Ok(()), |what| refuse(how.part.is_some(), "part", what))?;
            let bytes = load(sources, path)?;
            let mut notes = Vec::new();
            let Drawing { cells, pins } = match format {
                Format::Vox => vox::cells(&file, &bytes)?.into(),
                Format::Drawing => drawing::read(&file, text(&file, &bytes)?)?,
                _ => {
                    let (cells, left_out) = visiblesim::cells(&file, &bytes, how.part.unwrap_or_default())?;
                    notes = left_out;
                    cells.into()
                }
            };
            let at: [i16; 3] = how.at.into();
            let moved = |cell: Cell| {
                let cell: [i16; 3] = cell.into();
                in_range(&file, [0, 1, 2].map(|axis| i64::from(cell[axis]) + i64::from(at[axis])))
            };
            let pins = pins.into_iter().map(|[a, b]| Ok([moved(a)?, moved(b)?])).collect::<Result<_, _>>()?;
            let cells = cells.into_iter().map(moved).collect::<Result<_, _>>()?;
            Imported { cells, thin: None, mesh: None, pins, notes }
        }
        format => {
            refuse(how.part.is_some(), "part", "a mesh, which is one shape")?;
            let pitch = how.pitch.ok_or_else(|| SolidError::NoPitch(file.clone()))?;
            let mut triangles = match format {
                Format::Stl => mesh::stl(&file, &load(sources, path)?)?,
                _ => mesh::obj(&file, &load(sources, path)?)?,
            };
            if how.up == Some(Up::Y) {
                for [_, y, z] in triangles.as_flattened_mut() {
                    (*y, *z) = (-*z, *y);
                }
            }
            place(&file, &triangles, pitch, how.at)?
        }
    };
    let volume = printability::volume(&imported.cells);
    if volume > MAX_BOX {
        return Err(SolidError::TooWide { file, cells: volume });
    }
    if how.fill_voids {
        let voids = printability::voids(&imported.cells);
        let cells: BTreeSet<Cell> = imported.cells.iter().chain(voids.iter().flatten()).copied().collect();
        imported.cells = cells.into_iter().collect();
    }
    Ok(imported)
}

/// Returns bytes as the text that they are.
fn text<'a>(file: &str, bytes: &'a [u8]) -> Result<&'a str, SolidError> {
    std::str::from_utf8(bytes).map_err(|error| {
        let before = &bytes[..error.valid_up_to()];
        let line = before.iter().filter(|b| **b == b'\n').count() + 1;
        SolidError::Syntax { file: file.to_owned(), line, why: "this is not UTF-8 text".into() }
    })
}

/// Returns the pitch at which the longest side of a mesh has `cells` cells.
pub fn pitch_for(sources: &dyn Sources, path: &Path, cells: u16) -> Result<f64, SolidError> {
    let file = path.shown();
    let triangles = match Format::of(path)? {
        Format::Stl => mesh::stl(&file, &load(sources, path)?)?,
        _ => mesh::obj(&file, &load(sources, path)?)?,
    };
    let (min, max) = voxel::bounds(&triangles);
    let longest = (0..3).map(|axis| max[axis] - min[axis]).fold(0.0, f64::max);
    Ok(longest / f64::from(cells.max(1)))
}

fn place(file: &str, triangles: &[mesh::Triangle], pitch: f64, at: Cell) -> Result<Imported, SolidError> {
    let voxels = voxel::voxelise(file, triangles, pitch)?;
    let (min, max) = voxel::bounds(triangles);
    // The lowest layer with a filled cell stands on the floor.
    let floor = voxels.cells().map(|[_, _, z]| z).min().unwrap_or(0);
    let [nx, ny, _] = voxels.extent;
    let cells: Result<BTreeSet<Cell>, SolidError> = voxels
        .cells()
        .map(|[x, y, z]| {
            let along = |n: usize, zero: usize, at: i16| n as i64 - zero as i64 + i64::from(at);
            in_range(file, [along(x, nx / 2, at.x), along(y, ny / 2, at.y), along(z, floor, at.z)])
        })
        .collect();
    Ok(Imported {
        cells: cells?.into_iter().collect(),
        thin: voxels.thin,
        mesh: Some(MeshFacts {
            triangles: triangles.len(),
            size: [0, 1, 2].map(|axis| max[axis] - min[axis]),
            pitch,
        }),
        pins: Vec::new(),
        notes: voxels.notes,
    })
}

/// Reads the bytes of a file of limited size that can be a shape.
fn load(sources: &dyn Sources, path: &Path) -> Result<Vec<u8>, SolidError> {
    let file = path.shown();
    let bytes = sources.read(path, MAX_BYTES).map_err(|error| match error.kind() {
        std::io::ErrorKind::InvalidInput => SolidError::NoFile(file.clone()),
        std::io::ErrorKind::FileTooLarge => SolidError::TooLarge(file.clone()),
        _ => SolidError::Unreadable { file: file.clone(), why: error.to_string() },
    })?;
    match foreign(&bytes) {
        Some((what, instead)) => Err(SolidError::Foreign { file, what, instead }),
        None => Ok(bytes),
    }
}

/// Ends the error for numbers with more commas than separate them.
const COMMA_HINT: &str = "; a point is wanted, not a decimal comma";

/// Returns [`COMMA_HINT`] if a text has more commas than separate this many numbers.
fn comma_hint(text: &[u8], numbers: usize) -> &'static str {
    let commas = text.iter().filter(|byte| **byte == b',').count();
    if commas >= numbers { COMMA_HINT } else { "" }
}

/// Returns the name of a content that is no shape whatever the file is called, and what to do about it.
fn foreign(bytes: &[u8]) -> Option<(&'static str, &'static str)> {
    let text = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes).trim_ascii_start();
    let begins = |start: &[u8]| text.get(..start.len()).is_some_and(|b| b.eq_ignore_ascii_case(start));
    let graphic = |a: u8, b: u8| a.is_ascii_graphic() && !b.is_ascii_control();
    let wide = match bytes {
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] => true,
        [a, 0, b, 0, ..] | [0, a, 0, b, ..] => graphic(*a, *b),
        _ => false,
    };
    if begins(b"version https://git-lfs.github.com/spec/") {
        Some(("a pointer of Git LFS, not the file that it stands for", "fetch the file with `git lfs pull`"))
    } else if begins(b"<!doctype html") || begins(b"<html") {
        Some(("an HTML page", "download the file itself, not the page that shows it"))
    } else if wide {
        Some(("text in UTF-16", "save it as UTF-8"))
    } else if begins(b"PK\x03\x04") {
        Some(("a ZIP archive", "unpack it and name the file in it"))
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn content_of_another_kind_is_named() {
        let wide = |text: &str| text.encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<u8>>();
        for (bytes, part) in [
            (b"version https://git-lfs.github.com/spec/v1\noid sha256:4d\nsize 684\n".to_vec(), "Git LFS"),
            (b"\n<!DOCTYPE html>\n<html>".to_vec(), "HTML"),
            (b"\xef\xbb\xbf<html lang='en'>".to_vec(), "HTML"),
            (wide("\u{feff}v 0 0 0"), "UTF-16"),
            (wide("v 0 0 0"), "UTF-16"),
            (wide("solid a"), "UTF-16"),
            ("\u{feff}v".encode_utf16().flat_map(u16::to_be_bytes).collect(), "UTF-16"),
            (b"PK\x03\x04".to_vec(), "ZIP"),
        ] {
            assert!(foreign(&bytes).unwrap().0.contains(part), "{part}");
        }
        for bytes in
            [&b"solid a"[..], b"v 0 0 0", b"<?xml version='1.0'?>", b"", b"\0", b"VOX \x96\0\0\0", &[0; 84]]
        {
            assert_eq!(foreign(bytes), None);
        }
    }
}
