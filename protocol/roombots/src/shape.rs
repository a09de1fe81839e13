//! Shapes of a metamodule on the lattice.

use metamorph_core::lattice::{Cell, Face};
use metamorph_core::names;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Shape of four cubes in a chain, from the directions d1, d2, d3 between their centres.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[repr(u8)]
pub enum Shape {
    /// Straight: d1 = d2 = d3.
    I = 0,
    /// One bend: d1 = d2 or d2 = d3.
    L = 1,
    /// Two bends, d3 = d1.
    S = 2,
    /// Two bends, d3 = −d1.
    U = 3,
    /// All three at right angles.
    #[serde(rename = "3D-S")]
    Twisted = 4,
}

names!(Shape { I => "I", L => "L", S => "S", U => "U", Twisted => "3D-S" });

impl Shape {
    /// Returns the shape of three directions; `None` if the chain folds back onto itself.
    pub fn of(d: [Face; 3]) -> Option<Shape> {
        let bend = |a: Face, b: Face| a != b && a != b.opposite();
        match (d[0] == d[1], d[1] == d[2]) {
            (true, true) => Some(Shape::I),
            (true, false) => bend(d[1], d[2]).then_some(Shape::L),
            (false, true) => bend(d[0], d[1]).then_some(Shape::L),
            (false, false) if !bend(d[0], d[1]) || !bend(d[1], d[2]) => None,
            _ if d[0] == d[2] => Some(Shape::S),
            _ if d[0] == d[2].opposite() => Some(Shape::U),
            _ => Some(Shape::Twisted),
        }
    }
    /// Returns the shape with this number, if there is one.
    pub fn from_index(index: u8) -> Option<Shape> {
        Shape::ALL.get(usize::from(index)).copied()
    }
}

impl fmt::Display for Shape {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

/// Returns d1·(d2 × d3) of three directions: +1 or −1 for a twisted shape, 0 for a flat one.
pub fn hand(d: [Face; 3]) -> i8 {
    let [a, b, c] = d.map(|f| {
        let Cell { x, y, z } = f.offset();
        [x, y, z]
    });
    let volume = a[0] * (b[1] * c[2] - b[2] * c[1])
        + a[1] * (b[2] * c[0] - b[0] * c[2])
        + a[2] * (b[0] * c[1] - b[1] * c[0]);
    volume as i8
}

#[cfg(test)]
mod tests {
    use super::*;
    use Face::{Down, East, North, South, Up, West};

    #[test]
    fn shapes_by_their_directions() {
        for (d, shape, side) in [
            ([Up, Up, Up], Some(Shape::I), 0),
            ([Up, Up, East], Some(Shape::L), 0),
            ([Up, East, East], Some(Shape::L), 0),
            ([Up, East, Up], Some(Shape::S), 0),
            ([Up, East, Down], Some(Shape::U), 0),
            ([Up, East, North], Some(Shape::Twisted), 1),
            ([Up, East, South], Some(Shape::Twisted), -1),
            ([Up, Down, East], None, 0),
            ([East, North, South], None, 0),
            ([West, Up, Down], None, 0),
        ] {
            assert_eq!(Shape::of(d), shape, "{d:?}");
            assert_eq!(hand(d), side, "{d:?}");
        }
    }
}
