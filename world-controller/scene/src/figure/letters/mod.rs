//! Letters of pictures in pixels: widths and outlines of a part of DejaVu Sans (`licence.txt`). They are read from
//! `table.txt`, which `make` writes from the font, so that no font is parsed here.

use std::collections::BTreeMap;
use std::sync::LazyLock;

/// Units of the table per em, the size of a font.
pub const UNITS_PER_EM: u16 = 2048;

/// First line of the table: version of its format, font, and units per em.
const HEAD: &str = "letters 1: DejaVu Sans 2.37, 2048 units";

static TABLE: LazyLock<Table> = LazyLock::new(|| {
    read(include_str!("table.txt")).expect("invariant: the table in the program is whole, as a test shows")
});

/// A piece of an outline. Points are in units of the table, y upwards.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Piece {
    /// Begins a closed contour, which ends where the next one begins.
    Begin([f32; 2]),
    /// Draws a straight line.
    Line([f32; 2]),
    /// Draws a quadratic curve: its control point, and its end.
    Curve([f32; 2], [f32; 2]),
}

/// The form of a letter.
#[derive(Debug, Default)]
pub struct Letter {
    /// Distance to the next letter, in units of the table.
    pub advance: u16,
    /// The outline, whose inside has a winding number other than zero.
    pub outline: Vec<Piece>,
}

struct Table {
    letters: BTreeMap<char, Letter>,
    /// Stands for characters without a letter.
    none: Letter,
}

/// Returns the letter of a character; a box if it has none.
pub fn letter(of: char) -> &'static Letter {
    TABLE.letters.get(&of).unwrap_or(&TABLE.none)
}

fn read(table: &str) -> Option<Table> {
    let mut lines = table.lines();
    if lines.next() != Some(HEAD) {
        return None;
    }
    let none = lines.next()?.strip_prefix("none ").and_then(read_letter)?;
    let letters = lines.map(|line| {
        let (code, letter) = line.split_once(' ')?;
        Some((char::from_u32(u32::from_str_radix(code, 16).ok()?)?, read_letter(letter)?))
    });
    Some(Table { letters: letters.collect::<Option<_>>()?, none })
}

fn read_letter(text: &str) -> Option<Letter> {
    let mut words = text.split(' ');
    let mut letter = Letter { advance: words.next()?.parse().ok()?, outline: Vec::new() };
    for word in words {
        let (operation, numbers) = word.split_at_checked(1)?;
        let numbers: Vec<f32> = numbers.split(',').map(|n| n.parse().ok()).collect::<Option<_>>()?;
        match (operation, numbers.as_chunks::<2>()) {
            ("M", ([point], [])) => letter.outline.push(Piece::Begin(*point)),
            ("L", ([point], [])) => letter.outline.push(Piece::Line(*point)),
            ("Q", ([controls @ .., end], [])) if !controls.is_empty() => {
                for (i, control) in controls.iter().enumerate() {
                    // Between two control points the curve passes through their middle.
                    let next = controls.get(i + 1);
                    let to = next.map_or(*end, |next| [0, 1].map(|axis| (control[axis] + next[axis]) / 2.0));
                    letter.outline.push(Piece::Curve(*control, to));
                }
            }
            _ => return None,
        }
    }
    Some(letter)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_has_the_letters_that_titles_use() {
        for c in ('!'..='~').chain("°µ×–…−äéñøß≤≥λπ→\u{fffd}".chars()) {
            let letter = TABLE.letters.get(&c).unwrap_or_else(|| panic!("{c} has no letter"));
            assert!(letter.advance > 0 && matches!(letter.outline[..], [Piece::Begin(_), ..]), "{c}");
        }
        assert!(letter(' ').outline.is_empty() && letter(' ').advance > 0);
        assert_eq!(letter('\u{1f600}').outline.len(), 8, "unknown letters are drawn as a box");
    }

    #[test]
    fn curves_pass_between_their_control_points() {
        let letter = read_letter("9 M0,0 L2,0 Q4,0,4,3,0,4").unwrap();
        let (first, second) = (Piece::Curve([4.0, 0.0], [4.0, 1.5]), Piece::Curve([4.0, 3.0], [0.0, 4.0]));
        assert_eq!(letter.outline, [Piece::Begin([0.0, 0.0]), Piece::Line([2.0, 0.0]), first, second]);
        for wrong in ["", "x", "9 M0", "9 L1,2,3,4", "9 Q1,2", "9 Z", "9 M0,x"] {
            assert!(read_letter(wrong).is_none(), "{wrong}");
        }
    }
}
