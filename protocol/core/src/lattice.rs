//! The cubic lattice: cells, faces and the two motions of a sliding cube.
//!
//! Frame: right-handed, unit = one cell edge, +z up. A cell is a point of Z³; a module fills one.
//! Motions are those of the sliding-cube model (thesis 4.1.2 and 4.2.2, after Fitch and Butler).

use core::fmt;
use core::ops::{Add, Neg};
use serde::{Deserialize, Serialize};

/// A lattice cell. Coordinates stay within ±16,383 (see [`Cell::LIMIT`]), so that the sum of two never
/// overflows.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, Default)]
#[serde(from = "[i16; 3]", into = "[i16; 3]")]
pub struct Cell {
    /// Along +x.
    pub x: i16,
    /// Along +y.
    pub y: i16,
    /// Along +z, up.
    pub z: i16,
}

impl Cell {
    /// The largest absolute value of a coordinate in a scenario, in cells.
    pub const LIMIT: i16 = 16_383;

    /// Creates a cell from its coordinates.
    pub const fn new(x: i16, y: i16, z: i16) -> Cell {
        Cell { x, y, z }
    }
    /// Returns the neighbouring cell outside `face`.
    pub fn step(self, face: Face) -> Cell {
        self + face.offset()
    }
    /// Returns the six neighbouring cells in the order of the faces.
    pub fn neighbours(self) -> [Cell; 6] {
        Face::ALL.map(|f| self.step(f))
    }
    /// Returns the face of this cell that touches `other`, if they are neighbours.
    pub fn face_to(self, other: Cell) -> Option<Face> {
        Face::ALL.into_iter().find(|f| self.step(*f) == other)
    }
    /// Returns the Manhattan distance of two cells.
    pub fn manhattan(self, other: Cell) -> u32 {
        let d = |a: i16, b: i16| u32::from(a.abs_diff(b));
        d(self.x, other.x) + d(self.y, other.y) + d(self.z, other.z)
    }
    /// Returns true if every coordinate is within [`Cell::LIMIT`].
    pub fn in_range(self) -> bool {
        [self.x, self.y, self.z].iter().all(|c| c.unsigned_abs() <= Cell::LIMIT.unsigned_abs())
    }
}

impl Add for Cell {
    type Output = Cell;
    fn add(self, o: Cell) -> Cell {
        Cell::new(self.x.wrapping_add(o.x), self.y.wrapping_add(o.y), self.z.wrapping_add(o.z))
    }
}
impl Neg for Cell {
    type Output = Cell;
    fn neg(self) -> Cell {
        Cell::new(self.x.wrapping_neg(), self.y.wrapping_neg(), self.z.wrapping_neg())
    }
}
impl From<[i16; 3]> for Cell {
    fn from([x, y, z]: [i16; 3]) -> Cell {
        Cell { x, y, z }
    }
}
impl From<Cell> for [i16; 3] {
    fn from(c: Cell) -> [i16; 3] {
        [c.x, c.y, c.z]
    }
}
impl fmt::Display for Cell {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "[{}, {}, {}]", self.x, self.y, self.z)
    }
}
impl fmt::Debug for Cell {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

/// One of the six faces of a cube, and the direction that it looks in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[repr(u8)]
pub enum Face {
    /// +x
    East = 0,
    /// −x
    West = 1,
    /// +y
    North = 2,
    /// −y
    South = 3,
    /// +z
    Up = 4,
    /// −z
    Down = 5,
}

impl Face {
    /// All faces in the order of their numbers.
    pub const ALL: [Face; 6] = [Face::East, Face::West, Face::North, Face::South, Face::Up, Face::Down];

    /// Returns the face with this number, if there is one.
    pub const fn from_index(index: u8) -> Option<Face> {
        if index < 6 { Some(Face::ALL[index as usize]) } else { None }
    }
    /// Returns the index of the face in arrays of six.
    pub const fn index(self) -> usize {
        self as usize
    }
    /// Returns the face on the other side of the cube.
    pub const fn opposite(self) -> Face {
        Face::ALL[(self as usize) ^ 1]
    }
    /// Returns the four faces at right angles to this one, in the order of their numbers.
    pub const fn perpendicular(self) -> [Face; 4] {
        use Face::{Down, East, North, South, Up, West};
        match self {
            East | West => [North, South, Up, Down],
            North | South => [East, West, Up, Down],
            Up | Down => [East, West, North, South],
        }
    }
    /// Returns the index of `self` in `of.perpendicular()`, if the two are at right angles.
    pub const fn slot_in(self, of: Face) -> Option<usize> {
        let (index, of) = (self.index(), of.index());
        // Of six in a row, the two of one axis are left out.
        if index / 2 == of / 2 { None } else { Some(if index > of { index - 2 } else { index }) }
    }
    /// Returns faces as a mask, a bit for each.
    pub fn mask(faces: impl IntoIterator<Item = Face>) -> u8 {
        faces.into_iter().fold(0, |mask, face| mask | face.bit())
    }
    /// Iterates over the faces of a mask of [`Face::bit`], in the order of their numbers.
    pub const fn in_mask(mask: u8) -> Faces {
        Faces(mask & 0b11_1111)
    }
    /// Returns the unit step in this direction.
    pub const fn offset(self) -> Cell {
        match self {
            Face::East => Cell::new(1, 0, 0),
            Face::West => Cell::new(-1, 0, 0),
            Face::North => Cell::new(0, 1, 0),
            Face::South => Cell::new(0, -1, 0),
            Face::Up => Cell::new(0, 0, 1),
            Face::Down => Cell::new(0, 0, -1),
        }
    }
    /// Returns this face as one bit of a mask.
    pub const fn bit(self) -> u8 {
        1 << self as u8
    }
}

/// The faces of a mask, in the order of their numbers.
#[derive(Clone, Debug)]
pub struct Faces(u8);

impl Iterator for Faces {
    type Item = Face;

    fn next(&mut self) -> Option<Face> {
        if self.0 == 0 {
            return None;
        }
        let face = Face::ALL[self.0.trailing_zeros() as usize];
        self.0 &= self.0 - 1;
        Some(face)
    }
}

/// How a cube moves over its support.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[repr(u8)]
pub enum MotionKind {
    /// From cell `a` to `a+d` over the modules at `a+s` and `a+d+s`; `d` is the heading, `s` the side of the support.
    Slide = 0,
    /// From cell `a` to `a+s+d` around the edge of the module at `a+s`; the corner `a+d` must be free.
    Convex = 1,
}

/// One elementary motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Motion {
    /// Slide or convex transition.
    pub kind: MotionKind,
    /// The side of the support.
    pub support: Face,
    /// The direction of the motion, at right angles to the support.
    pub heading: Face,
}

impl Motion {
    /// Returns the cell in which the motion ends if it starts in `from`.
    pub fn destination(self, from: Cell) -> Cell {
        match self.kind {
            MotionKind::Slide => from.step(self.heading),
            MotionKind::Convex => from.step(self.heading).step(self.support),
        }
    }
    /// Returns the corner cell that a convex transition sweeps.
    pub fn corner(self, from: Cell) -> Option<Cell> {
        (self.kind == MotionKind::Convex).then(|| from.step(self.heading))
    }
    /// Returns the side of the support at the end of the motion.
    pub fn landing_support(self) -> Face {
        match self.kind {
            MotionKind::Slide => self.support,
            MotionKind::Convex => self.heading.opposite(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_are_consistent() {
        for f in Face::ALL {
            assert_eq!(f.opposite().opposite(), f);
            assert_eq!(f.offset() + f.opposite().offset(), Cell::default());
            assert_eq!(Face::from_index(f as u8), Some(f));
            assert_eq!(Cell::default().face_to(f.offset()), Some(f));
            for (i, p) in f.perpendicular().into_iter().enumerate() {
                assert!(p != f && p != f.opposite());
                assert_eq!(p.slot_in(f), Some(i));
            }
            assert_eq!(f.slot_in(f), None);
            assert_eq!(Face::in_mask(f.bit()).collect::<Vec<_>>(), [f]);
        }
        assert!(Face::in_mask(u8::MAX).eq(Face::ALL) && Face::in_mask(0b110).eq([Face::West, Face::North]));
        assert_eq!(Face::mask([Face::North, Face::West]), 0b110);
        assert_eq!(Face::from_index(6), None);
    }

    /// Both motions end in contact with the support they name.
    #[test]
    fn motions_end_on_their_support() {
        let from = Cell::new(3, -2, 5);
        for support in Face::ALL {
            for heading in support.perpendicular() {
                let slide = Motion { kind: MotionKind::Slide, support, heading };
                assert_eq!(
                    slide.destination(from).step(slide.landing_support()),
                    from.step(heading).step(support)
                );
                let convex = Motion { kind: MotionKind::Convex, support, heading };
                assert_eq!(convex.destination(from).step(convex.landing_support()), from.step(support));
                assert_eq!(convex.corner(from), Some(from.step(heading)));
            }
        }
    }
}
