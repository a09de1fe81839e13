//! Common arrangements: places for equal pieces in a circle, a row, a grid, or rows before a stage.

use super::form::Form;
use super::model::Placement;
use std::f64::consts::TAU;

/// An arrangement. Lengths are connectors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Template {
    /// Around a connector, all fronts inwards.
    Circle {
        /// How many.
        count: usize,
        /// The middle.
        around: (i16, i16),
        /// The radius.
        radius: f64,
    },
    /// From west to east.
    Row {
        /// How many.
        count: usize,
        /// The first one's corner.
        at: (i16, i16),
        /// Free connectors between two.
        gap: i16,
    },
    /// Rows, one behind the other to the north.
    Grid {
        /// How many from west to east, and how many rows.
        count: (usize, usize),
        /// The first one's corner.
        at: (i16, i16),
        /// Free connectors between two.
        gap: i16,
    },
    /// Rows of arcs around a stage in the south, all fronts towards it.
    Auditorium {
        /// How many in the first arc, and how many arcs; each has two more than the one before.
        count: (usize, usize),
        /// The stage.
        around: (i16, i16),
        /// The radius of the first arc.
        radius: f64,
        /// By how much an arc is farther away than the one before.
        gap: i16,
    },
}

/// Returns names that no piece has: the stem with a number.
pub fn fresh_names(stem: &str, is_taken: impl Fn(&str) -> bool) -> impl Iterator<Item = String> {
    (1u32..).map(move |i| format!("{stem} {i}")).filter(move |name| !is_taken(name))
}

impl Template {
    /// Returns the places of this form.
    pub fn places(&self, form: &Form) -> Vec<Placement> {
        match *self {
            Template::Circle { count, around, radius } => {
                let angle = |i: usize| TAU * i as f64 / count as f64;
                (0..count).map(|i| at_angle(form, around, radius, angle(i))).collect()
            }
            Template::Row { count, at, gap } => Template::Grid { count: (count, 1), at, gap }.places(form),
            Template::Grid { count: (along, rows), at, gap } => {
                let (wide, deep) = form.turned(0).size;
                let one = move |i: usize, j: usize| Placement {
                    at: (at.0 + i as i16 * (wide + gap), at.1 + j as i16 * (deep + gap)),
                    turn: 0,
                };
                (0..rows).flat_map(|j| (0..along).map(move |i| one(i, j))).collect()
            }
            Template::Auditorium { count: (first, arcs), around, radius, gap } => {
                let arc = |row: usize| {
                    let many = first + 2 * row;
                    let radius = radius + row as f64 * f64::from(gap);
                    // A third of a turn, from 30 to 150 degrees: north is in its middle.
                    let angle = move |i: usize| TAU / 12.0 + TAU / 3.0 * (i as f64 + 0.5) / many as f64;
                    (0..many).map(move |i| at_angle(form, around, radius, angle(i))).collect::<Vec<_>>()
                };
                (0..arcs).flat_map(arc).collect()
            }
        }
    }
}

/// The place whose middle is nearest to the point at this angle, turned inwards.
fn at_angle(form: &Form, around: (i16, i16), radius: f64, angle: f64) -> Placement {
    let (dx, dy) = (radius * libm::cos(angle), radius * libm::sin(angle));
    let turn = match (dx.abs() > dy.abs(), dx > 0.0, dy > 0.0) {
        (true, true, _) => 3,
        (true, false, _) => 1,
        (false, _, true) => 0,
        (false, _, false) => 2,
    };
    let (wide, deep) = form.turned(turn).size;
    let corner = |middle: i16, off: f64, size: i16| {
        libm::floor(f64::from(middle) + off - f64::from(size - 1) / 2.0 + 0.5) as i16
    };
    Placement { at: (corner(around.0, dx, wide), corner(around.1, dy, deep)), turn }
}
