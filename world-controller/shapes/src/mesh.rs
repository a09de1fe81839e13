//! Reads triangles from STL and OBJ files. The crates `stl_io` and `tobj` parse the formats; this module adds
//! what they leave open: telling the two STL formats apart, several solids in one file, and the places of
//! errors. Absent: whether the triangles enclose a solid (see `voxel`).

use super::error::{MAX_GROUPS, MAX_TRIANGLES, SolidError};
use std::collections::HashMap;
use std::io::Cursor;

/// Three corners, each with three coordinates.
pub type Triangle = [[f32; 3]; 3];

/// Bytes before the first triangle of a binary STL: a text of 80 bytes and a count.
const HEADER: usize = 84;
/// Bytes of a triangle in a binary STL.
const RECORD: usize = 50;
/// Characters of another crate's error shown at most.
const SHOWN: usize = 160;

/// Reads the triangles of an STL file, binary or text.
pub fn stl(file: &str, mut bytes: Vec<u8>) -> Result<Vec<Triangle>, SolidError> {
    let promised = bytes.get(80..HEADER).and_then(|b| b.try_into().ok()).map_or(0, u32::from_le_bytes);
    let length = HEADER as u64 + u64::from(promised) * RECORD as u64;
    // Some programs begin the text of a binary file with `solid`, which only text files should.
    let text = bytes.starts_with(b"solid") && bytes.len() as u64 != length;
    if text {
        return stl_text(file, &bytes);
    }
    if bytes.len() < HEADER {
        return Err(SolidError::TooShort { file: file.to_owned(), bytes: bytes.len() });
    }
    if (bytes.len() as u64) < length {
        let found = (bytes.len() - HEADER) as u64 / RECORD as u64;
        let (file, bytes) = (file.to_owned(), bytes.len() as u64);
        return Err(SolidError::Truncated { file, found, expected: promised.into(), bytes });
    }
    if promised as usize > MAX_TRIANGLES {
        return Err(SolidError::TooManyTriangles { file: file.to_owned(), found: promised.into() });
    }
    bytes[..5].fill(b' ');
    let mut triangles = Vec::new();
    read_solid(&bytes, &mut triangles, |_, why| SolidError::Unreadable { file: file.to_owned(), why })?;
    finite(file, triangles)
}

/// Reads a text STL. It may contain several solids; the crate reads one.
fn stl_text(file: &str, bytes: &[u8]) -> Result<Vec<Triangle>, SolidError> {
    let mut triangles = Vec::new();
    let (mut start, mut line) = (0, 0);
    // Bytes and lines at which the solids begin.
    let mut begins = Vec::new();
    for text in bytes.split_inclusive(|b| *b == b'\n') {
        let word = text.trim_ascii_start().split(u8::is_ascii_whitespace).next();
        if word == Some(b"solid") {
            begins.push((start, line));
        }
        start += text.len();
        line += 1;
    }
    let ends = begins.iter().skip(1).map(|(start, _)| *start).chain([bytes.len()]);
    for ((start, line), end) in begins.iter().zip(ends) {
        let solid = bytes[*start..end].trim_ascii_start();
        // The crate requires a space after the word, which some programs do not write.
        let mut text = b"solid ".to_vec();
        text.extend_from_slice(&solid[5..]);
        let before = triangles.len();
        read_solid(&text, &mut triangles, |read, why| SolidError::Syntax {
            file: file.to_owned(),
            line: line + line_of_facet(solid, read - before),
            why: format!("in the facet that begins here: {why}"),
        })?;
        if triangles.len() > MAX_TRIANGLES {
            return Err(SolidError::TooManyTriangles {
                file: file.to_owned(),
                found: triangles.len() as u64,
            });
        }
    }
    finite(file, triangles)
}

/// Appends the triangles of one solid. `error` creates an error from the number of triangles read so far and
/// the cause.
fn read_solid(
    bytes: &[u8],
    triangles: &mut Vec<Triangle>,
    scenario_error: impl Fn(usize, String) -> SolidError,
) -> Result<(), SolidError> {
    let short = |error: std::io::Error| error.to_string().chars().take(SHOWN).collect::<String>();
    let mut cursor = Cursor::new(bytes);
    let reader =
        stl_io::create_stl_reader(&mut cursor).map_err(|e| scenario_error(triangles.len(), short(e)))?;
    for triangle in reader {
        let triangle = triangle.map_err(|e| scenario_error(triangles.len(), short(e)))?;
        triangles.push(triangle.vertices.map(|corner| corner.0));
        if triangles.len() > MAX_TRIANGLES {
            break;
        }
    }
    Ok(())
}

/// Returns the number, from 1, of the line at which the facet after the first `before` facets begins, or of
/// the last line.
fn line_of_facet(text: &[u8], before: usize) -> usize {
    let lines = || text.split(|b| *b == b'\n');
    let facet = |line: &&[u8]| line.trim_ascii_start().starts_with(b"facet");
    let begins = lines().enumerate().filter(|(_, line)| facet(line)).nth(before);
    begins.map_or_else(|| text.trim_ascii_end().split(|b| *b == b'\n').count(), |(i, _)| i + 1)
}

/// Reads the triangles of an OBJ file; polygons are triangulated, lines, points and materials ignored.
pub fn obj(file: &str, bytes: &[u8]) -> Result<Vec<Triangle>, SolidError> {
    check_size(file, bytes)?;
    let options = tobj::LoadOptions {
        triangulate: true,
        ignore_points: true,
        ignore_lines: true,
        ..tobj::LoadOptions::default()
    };
    let mut cursor = Cursor::new(bytes);
    let read = tobj::load_obj_buf(&mut cursor, &options, |_| Ok((Vec::new(), HashMap::new())));
    let (models, _) = read.map_err(|error| {
        let read = &bytes[..(cursor.position() as usize).min(bytes.len())];
        let ended = usize::from(!read.ends_with(b"\n"));
        let line = read.iter().filter(|b| **b == b'\n').count() + ended;
        // Indices are checked at the end of a group.
        let late = matches!(error, tobj::LoadError::FaceVertexOutOfBounds);
        let why = if late { format!("in a group that ends here: {error}") } else { error.to_string() };
        SolidError::Syntax { file: file.to_owned(), line: line.max(1), why }
    })?;
    let mut triangles = Vec::new();
    for mesh in models.iter().map(|model| &model.mesh) {
        let corner = |i: &u32| {
            let at = *i as usize * 3;
            mesh.positions.get(at..at + 3).and_then(|p| p.try_into().ok()).unwrap_or([f32::NAN; 3])
        };
        triangles.extend(mesh.indices.chunks_exact(3).map(|t| [corner(&t[0]), corner(&t[1]), corner(&t[2])]));
        if triangles.len() > MAX_TRIANGLES {
            return Err(SolidError::TooManyTriangles {
                file: file.to_owned(),
                found: triangles.len() as u64,
            });
        }
    }
    finite(file, triangles)
}

/// Counts the elements of an OBJ file before it is read: the crate keeps a hundred bytes per corner and a
/// thousand per group.
fn check_size(file: &str, bytes: &[u8]) -> Result<(), SolidError> {
    let (mut triangles, mut groups) = (0, 0);
    for (i, line) in bytes.split(|b| *b == b'\n').enumerate() {
        let mut words = line.split(u8::is_ascii_whitespace).filter(|word| !word.is_empty());
        match words.next() {
            // Lines and points are read before they are ignored.
            Some(b"f" | b"l" | b"p") => triangles += words.count().saturating_sub(2).max(1),
            Some(b"g" | b"o" | b"usemtl") => groups += 1,
            _ => {}
        }
        if groups > MAX_GROUPS {
            let (file, line, what) = (file.to_owned(), i + 1, "groups, objects and materials");
            return Err(SolidError::TooManyParts { file, line, what, most: MAX_GROUPS });
        }
    }
    if triangles > MAX_TRIANGLES {
        return Err(SolidError::TooManyTriangles { file: file.to_owned(), found: triangles as u64 });
    }
    Ok(())
}

fn finite(file: &str, triangles: Vec<Triangle>) -> Result<Vec<Triangle>, SolidError> {
    if triangles.is_empty() {
        return Err(SolidError::Empty(file.to_owned()));
    }
    match triangles.iter().position(|t| t.as_flattened().iter().any(|c| !c.is_finite())) {
        Some(i) => Err(SolidError::NotFinite { file: file.to_owned(), triangle: i + 1 }),
        None => Ok(triangles),
    }
}
