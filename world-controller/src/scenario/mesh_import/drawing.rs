//! Drawings: the cells of a structure as a TOML file, which shapes of scenarios may name.

use super::error::SolidError;
use metamorph_protocol::lattice::Cell;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;

/// The version of the format.
const VERSION: u32 = 1;
/// Bytes of a drawing at most: several times what 200,000 cells take.
const MAX_DRAWING: usize = 8 << 20;

/// A drawing as written.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Drawing {
    version: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    name: Option<String>,
    cells: Vec<Cell>,
}

/// The version alone, read first: other versions may have other keys.
#[derive(Deserialize)]
struct Versioned {
    version: Option<u32>,
}

/// Reads the cells of a drawing.
pub fn cells(file: &str, text: &str) -> Result<BTreeSet<Cell>, SolidError> {
    let wrong = |line, why| SolidError::Syntax { file: file.to_owned(), line, why };
    if text.len() > MAX_DRAWING {
        return Err(wrong(1, format!("a drawing has at most {} MiB", MAX_DRAWING >> 20)));
    }
    let syntax = |error: toml::de::Error| {
        let before = error.span().map_or("", |span| text.get(..span.start).unwrap_or_default());
        wrong(before.matches('\n').count() + 1, error.message().to_owned())
    };
    match toml::from_str::<Versioned>(text).map_err(syntax)?.version {
        Some(VERSION) => {}
        Some(other) => {
            return Err(wrong(1, format!("the drawing has version {other}; this program reads {VERSION}")));
        }
        None => {
            return Err(wrong(
                1,
                format!("the drawing has no version; it begins with `version = {VERSION}`"),
            ));
        }
    }
    let drawing: Drawing = toml::from_str(text).map_err(syntax)?;
    let mut cells = BTreeSet::new();
    for cell in drawing.cells {
        if !cells.insert(cell) {
            return Err(wrong(1, format!("the cell {cell} is listed twice")));
        }
    }
    if cells.is_empty() {
        return Err(wrong(1, "the drawing has no cell".to_owned()));
    }
    Ok(cells)
}

/// Returns the text of a drawing.
pub fn text(origin: &str, name: Option<&str>, cells: &[Cell]) -> String {
    let origin: String = origin.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    let name = name.map(|name| format!("name = {}\n", toml::Value::String(name.to_owned())));
    let list: String = cells.iter().map(|c| format!("    [{}, {}, {}],\n", c.x, c.y, c.z)).collect();
    format!(
        "# Written by `metamorph shape --modules` from {origin}.\nversion = {VERSION}\n{}cells = [\n{list}]\n",
        name.unwrap_or_default()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drawing_is_read_as_written() {
        let all = vec![Cell::new(-1, 0, 2), Cell::new(0, 0, 2)];
        let read = cells("a.toml", &text("b\n.toml", Some("a \"chair\""), &all));
        assert_eq!(read, Ok(all.into_iter().collect()));
    }

    #[test]
    fn wrong_drawings_are_refused_with_their_place() {
        for (text, line, why) in [
            ("version = 2\nlegs = 3\n", 1, "version 2"),
            ("cells = [[0, 0, 0]]", 1, "begins with `version = 1`"),
            ("version = 1\ncells = [[0, 0, 0], [0, 0, 0]]", 1, "[0, 0, 0] is listed twice"),
            ("version = 1\ncells = []", 1, "no cell"),
            ("version = 1\ncells = [\n  [0, 0],\n]", 3, "length"),
            ("version = 1\ncells = [[0, 0, 0]]\npins = []", 3, "pins"),
            ("version = 1\ncells = [[0, 0, 40000]]", 2, "40000"),
            ("version = \n", 1, ""),
        ] {
            let Err(SolidError::Syntax { line: at, why: found, .. }) = cells("a.toml", text) else {
                panic!("{text} is accepted");
            };
            assert!(at == line && found.contains(why), "{text}: {at}: {found}");
        }
    }
}
