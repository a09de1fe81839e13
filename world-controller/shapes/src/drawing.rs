//! Drawings: the cells of a structure as a TOML file, which shapes of scenarios may name, and the pins of its modules.

use super::error::SolidError;
use metamorph_core::lattice::Cell;
use metamorph_pairing::PairingError;
use metamorph_pairing::pins::{self, Pin};
use serde::Deserialize;
use std::collections::BTreeSet;
use toml::Spanned;

/// The version of the format.
pub const VERSION: u32 = 1;
/// Bytes of a drawing at most: several times what 200,000 cells take.
const MAX_DRAWING: usize = 8 << 20;

/// A drawing as written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    #[expect(dead_code, reason = "has been read before")]
    version: u32,
    #[expect(dead_code, reason = "is for people")]
    name: Option<String>,
    cells: Vec<Cell>,
    #[serde(default)]
    pins: Vec<Spanned<Pin>>,
}

/// Content of a drawing file.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Drawing {
    /// At least one.
    pub cells: BTreeSet<Cell>,
    /// The cells that are one module each, in ascending order.
    pub pins: Vec<Pin>,
}

impl From<BTreeSet<Cell>> for Drawing {
    fn from(cells: BTreeSet<Cell>) -> Drawing {
        Drawing { cells, pins: Vec::new() }
    }
}

/// The version alone, read first: other versions may have other keys.
#[derive(Deserialize)]
struct Versioned {
    version: Option<u32>,
}

/// Reads a drawing.
pub fn read(file: &str, text: &str) -> Result<Drawing, SolidError> {
    let wrong = |line, why| SolidError::Syntax { file: file.to_owned(), line, why };
    if text.len() > MAX_DRAWING {
        return Err(wrong(1, format!("a drawing has at most {} MiB", MAX_DRAWING >> 20)));
    }
    let line_at = |place: usize| text.get(..place).unwrap_or_default().matches('\n').count() + 1;
    let syntax = |error: toml::de::Error| {
        wrong(error.span().map_or(1, |span| line_at(span.start)), error.message().to_owned())
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
    let written: Written = toml::from_str(text).map_err(syntax)?;
    let mut cells = BTreeSet::new();
    for cell in written.cells {
        if !cells.insert(cell) {
            return Err(wrong(1, format!("the cell {cell} is listed twice")));
        }
    }
    if cells.is_empty() {
        return Err(wrong(1, "the drawing has no cell".to_owned()));
    }
    let listed: Vec<Pin> = written.pins.iter().map(|pin| *pin.get_ref()).collect();
    let pins = pins::checked(&cells, &listed).map_err(|error| {
        let at = listed.iter().rposition(|pin| is_about(&error, pin)).map(|i| written.pins[i].span().start);
        wrong(at.map_or(1, line_at), error.to_string())
    })?;
    Ok(Drawing { cells, pins })
}

/// Returns whether an error may be about this pin.
fn is_about(error: &PairingError, pin: &Pin) -> bool {
    match error {
        PairingError::PinWithoutCell { pin: wrong, .. } | PairingError::PinApart(wrong) => {
            wrong.iter().all(|cell| pin.contains(cell)) && pin.iter().all(|cell| wrong.contains(cell))
        }
        PairingError::PinnedTwice(cell) => pin.contains(cell),
        _ => false,
    }
}

/// Returns the text of a drawing.
pub fn text(origin: &str, name: Option<&str>, cells: &[Cell], pins: &[Pin]) -> String {
    let origin: String = origin.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    let name = name.map(|name| format!("name = {}\n", toml::Value::String(name.to_owned())));
    let list: String = cells.iter().map(|c| format!("    {c},\n")).collect();
    let pinned: String = pins.iter().map(|[a, b]| format!("    [{a}, {b}],\n")).collect();
    let pins = if pins.is_empty() { String::new() } else { format!("pins = [\n{pinned}]\n") };
    format!(
        "# Written by `metamorph shape --modules` from {origin}.\nversion = {VERSION}\n{}cells = [\n{list}]\n{pins}",
        name.unwrap_or_default()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drawing_is_read_as_written() {
        let all = vec![Cell::new(-1, 0, 2), Cell::new(0, 0, 2)];
        let cells: BTreeSet<Cell> = all.iter().copied().collect();
        for pins in [vec![], vec![[all[0], all[1]]]] {
            let read = read("a.toml", &text("b\n.toml", Some("a \"chair\""), &all, &pins));
            assert_eq!(read, Ok(Drawing { cells: cells.clone(), pins }));
        }
    }

    #[test]
    fn wrong_drawings_are_refused_with_their_place() {
        for (text, line, why) in [
            ("version = 2\nlegs = 3\n", 1, "version 2"),
            ("cells = [[0, 0, 0]]", 1, "begins with `version = 1`"),
            ("version = 1\ncells = [[0, 0, 0], [0, 0, 0]]", 1, "[0, 0, 0] is listed twice"),
            ("version = 1\ncells = []", 1, "no cell"),
            ("version = 1\ncells = [\n  [0, 0],\n]", 3, "length"),
            ("version = 1\ncells = [[0, 0, 0]]\npens = []", 3, "pens"),
            ("version = 1\ncells = [[0, 0, 0]]\npins = [[0, 0, 0]]", 3, "expected an array"),
            (
                "version = 1\ncells = [[0, 0, 0], [1, 0, 0]]\npins = [\n  [[0, 0, 0], [1, 0, 0]],\n  [[2, 0, 0], [1, 0, 0]],\n]",
                5,
                "names the cell [2, 0, 0], which is not there",
            ),
            (
                "version = 1\npins = [[[0, 0, 0], [2, 0, 0]]]\ncells = [[0, 0, 0], [2, 0, 0]]",
                2,
                "share no face",
            ),
            (
                "version = 1\ncells = [[0, 0, 0], [1, 0, 0], [2, 0, 0]]\npins = [[[0, 0, 0], [1, 0, 0]],\n[[1, 0, 0], [2, 0, 0]]]",
                4,
                "[1, 0, 0] is in two pins",
            ),
            ("version = 1\ncells = [[0, 0, 40000]]", 2, "40000"),
            ("version = \n", 1, ""),
        ] {
            let Err(SolidError::Syntax { line: at, why: found, .. }) = read("a.toml", text) else {
                panic!("{text} is accepted");
            };
            assert!(at == line && found.contains(why), "{text}: {at}: {found}");
        }
    }
}
