//! Shapes as data: start bodies and goals.

use crate::lattice::{Cell, Face};
use alloc::format;
use alloc::vec;
use alloc::vec::Vec;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};
use thiserror::Error;

/// The largest number of cells of one shape.
pub const MAX_CELLS: usize = 4_000_000;

/// A description of a set of lattice cells. Boxes include both corners; a cell belongs to a round shape if
/// its centre does.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum Shape {
    /// All cells from one corner to the other, both included.
    Box {
        /// The corner with the smallest coordinates.
        min: Cell,
        /// The corner with the largest coordinates.
        max: Cell,
    },
    /// All cells within a distance of a centre.
    Sphere {
        /// The centre.
        center: Cell,
        /// The radius in cells; 0 is one cell.
        radius: Radius,
    },
    /// A disc one cell thick.
    Disc {
        /// The centre.
        center: Cell,
        /// The radius in cells.
        radius: Radius,
        /// The normal of the disc.
        #[serde(default)]
        axis: Axis,
    },
    /// A stack of discs.
    Cylinder {
        /// The centre of the first disc.
        base: Cell,
        /// The radius in cells.
        radius: Radius,
        /// The number of discs, along the positive axis.
        height: u16,
        /// The direction of the stack.
        #[serde(default)]
        axis: Axis,
    },
    /// Listed cells, each named once.
    Cells(Vec<Cell>),
    /// Every cell of any of these shapes.
    Union(Vec<Shape>),
    /// Every cell of the first shape that is in none of the others.
    Difference(Vec<Shape>),
    /// Every cell that is in all of these shapes.
    Intersection(Vec<Shape>),
}

/// An axis of the lattice.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Axis {
    /// Along x.
    X,
    /// Along y.
    Y,
    /// Along z, up.
    #[default]
    Z,
}

impl Axis {
    fn step(self) -> Cell {
        match self {
            Axis::X => Face::East.offset(),
            Axis::Y => Face::North.offset(),
            Axis::Z => Face::Up.offset(),
        }
    }
}

/// A radius in thousandths of a cell, written as a number of cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Radius(u32);

impl Radius {
    /// Creates a radius of a whole number of cells.
    pub const fn cells(n: u16) -> Radius {
        Radius(n as u32 * 1_000)
    }
    fn reach(self) -> i16 {
        (self.0 / 1_000) as i16
    }
    fn contains(self, dx: i16, dy: i16, dz: i16) -> bool {
        let squared = |d: i16| i64::from(d) * i64::from(d);
        (squared(dx) + squared(dy) + squared(dz)) * 1_000_000 <= i64::from(self.0).pow(2)
    }
}

impl Serialize for Radius {
    fn serialize<S: serde::Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.serialize_f64(f64::from(self.0) / 1_000.0)
    }
}
impl<'de> Deserialize<'de> for Radius {
    fn deserialize<D: Deserializer<'de>>(d: D) -> Result<Radius, D::Error> {
        let cells = f64::deserialize(d)?;
        if (0.0..=f64::from(Cell::LIMIT)).contains(&cells) {
            // Rounding of floats needs std; this is the same for what is not negative.
            let thousandths = cells * 1_000.0;
            let whole = thousandths as u32;
            Ok(Radius(whole + u32::from(thousandths - f64::from(whole) >= 0.5)))
        } else {
            Err(D::Error::custom(format!("radius {cells} is not between 0 and {} cells", Cell::LIMIT)))
        }
    }
}

/// Why a shape has no set of cells.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ShapeError {
    /// A list of cells names one twice.
    #[error("the cell {0} is listed twice; two modules cannot share a cell")]
    Twice(Cell),
    /// A box with a corner on the wrong side.
    #[error("the box from {min} to {max} is inside out; `min` must not exceed `max` on any axis")]
    InsideOut {
        /// The first corner.
        min: Cell,
        /// The second corner.
        max: Cell,
    },
    /// A coordinate too large.
    #[error("the cell {0} is out of range; coordinates go from -16383 to 16383")]
    OutOfRange(Cell),
    /// More than [`MAX_CELLS`].
    #[error("the shape has more than {MAX_CELLS} cells")]
    TooLarge,
    /// The shape has no cell.
    #[error("the shape has no cell")]
    Empty,
    /// A difference without operands.
    #[error("`difference` needs at least one shape, the one to take the others from")]
    NoMinuend,
    /// An intersection without operands.
    #[error("`intersection` needs at least one shape")]
    NoOperand,
}

impl Shape {
    /// Returns the cells in ascending order.
    ///
    /// # Errors
    /// Refuses a shape that is malformed, empty, too large or out of range.
    pub fn cells(&self) -> Result<Vec<Cell>, ShapeError> {
        let cells = self.collect()?;
        if cells.is_empty() {
            return Err(ShapeError::Empty);
        }
        match cells.iter().find(|c| !c.in_range()) {
            Some(far) => Err(ShapeError::OutOfRange(*far)),
            None => Ok(cells),
        }
    }

    /// Collects the cells in ascending order, each once. A list takes six bytes a cell; sets of nested shapes
    /// would take many times as much memory.
    fn collect(&self) -> Result<Vec<Cell>, ShapeError> {
        match self {
            Shape::Box { min, max } => {
                if min.x > max.x || min.y > max.y || min.z > max.z {
                    return Err(ShapeError::InsideOut { min: *min, max: *max });
                }
                scan(*min, *max, |_| true)
            }
            Shape::Sphere { center, radius } => {
                let r = radius.reach();
                let (min, max) = span(*center, Cell::new(r, r, r))?;
                scan(min, max, |c| radius.contains(c.x - center.x, c.y - center.y, c.z - center.z))
            }
            Shape::Disc { center, radius, axis } => cylinder(*center, *radius, 1, *axis),
            Shape::Cylinder { base, radius, height, axis } => cylinder(*base, *radius, *height, *axis),
            Shape::Cells(cells) => {
                let mut cells = cells.clone();
                cells.sort_unstable();
                match cells.windows(2).find(|pair| pair[0] == pair[1]) {
                    Some(pair) => Err(ShapeError::Twice(pair[0])),
                    None => Ok(cells),
                }
            }
            Shape::Union(_) => {
                let mut all = Vec::new();
                self.gather(&mut all)?;
                tidy(&mut all)?;
                Ok(all)
            }
            Shape::Difference(parts) => {
                let (first, rest) = parts.split_first().ok_or(ShapeError::NoMinuend)?;
                let mut cells = first.collect()?;
                for part in rest {
                    let other = part.collect()?;
                    cells.retain(|cell| other.binary_search(cell).is_err());
                }
                Ok(cells)
            }
            Shape::Intersection(parts) => {
                let (first, rest) = parts.split_first().ok_or(ShapeError::NoOperand)?;
                let mut cells = first.collect()?;
                for part in rest {
                    let other = part.collect()?;
                    cells.retain(|cell| other.binary_search(cell).is_ok());
                }
                Ok(cells)
            }
        }
    }

    /// Appends the cells; those of unions within unions go to one list.
    fn gather(&self, all: &mut Vec<Cell>) -> Result<(), ShapeError> {
        let Shape::Union(parts) = self else {
            all.extend(self.collect()?);
            return if all.len() > 2 * MAX_CELLS { tidy(all) } else { Ok(()) };
        };
        parts.iter().try_for_each(|part| part.gather(all))
    }
}

/// Sorts cells and removes duplicates.
fn tidy(cells: &mut Vec<Cell>) -> Result<(), ShapeError> {
    cells.sort_unstable();
    cells.dedup();
    if cells.len() > MAX_CELLS { Err(ShapeError::TooLarge) } else { Ok(()) }
}

fn span(center: Cell, reach: Cell) -> Result<(Cell, Cell), ShapeError> {
    if !center.in_range() {
        return Err(ShapeError::OutOfRange(center));
    }
    Ok((center + -reach, center + reach))
}

fn scan(min: Cell, max: Cell, inside: impl Fn(Cell) -> bool) -> Result<Vec<Cell>, ShapeError> {
    for corner in [min, max] {
        if !corner.in_range() {
            return Err(ShapeError::OutOfRange(corner));
        }
    }
    let length = |a: i16, b: i16| (i64::from(b) - i64::from(a) + 1).unsigned_abs();
    let volume = length(min.x, max.x) * length(min.y, max.y) * length(min.z, max.z);
    if volume > 8 * MAX_CELLS as u64 {
        return Err(ShapeError::TooLarge);
    }
    let mut cells = Vec::new();
    for x in min.x..=max.x {
        for y in min.y..=max.y {
            for z in min.z..=max.z {
                let cell = Cell::new(x, y, z);
                if inside(cell) {
                    cells.push(cell);
                }
            }
        }
    }
    if cells.len() > MAX_CELLS { Err(ShapeError::TooLarge) } else { Ok(cells) }
}

fn cylinder(base: Cell, radius: Radius, height: u16, axis: Axis) -> Result<Vec<Cell>, ShapeError> {
    let r = radius.reach();
    let along = axis.step();
    let mut disc = Cell::new(r, r, r);
    match axis {
        Axis::X => disc.x = 0,
        Axis::Y => disc.y = 0,
        Axis::Z => disc.z = 0,
    }
    let (min, mut max) = span(base, disc)?;
    for _ in 1..height.min(2 * Cell::LIMIT.unsigned_abs()) {
        max = max + along;
    }
    if height == 0 {
        return Ok(Vec::new());
    }
    scan(min, max, |c| {
        let (dx, dy, dz) = (c.x - base.x, c.y - base.y, c.z - base.z);
        match axis {
            Axis::X => radius.contains(0, dy, dz),
            Axis::Y => radius.contains(dx, 0, dz),
            Axis::Z => radius.contains(dx, dy, 0),
        }
    })
}

/// Returns the connected parts of a set of cells in ascending order, each in ascending order.
pub fn components(cells: &[Cell]) -> Vec<Vec<Cell>> {
    let mut cells = cells.to_vec();
    cells.sort_unstable();
    cells.dedup();
    let mut is_left = vec![true; cells.len()];
    let mut parts = Vec::new();
    for (first, cell) in cells.iter().enumerate() {
        if !core::mem::take(&mut is_left[first]) {
            continue;
        }
        let mut part = vec![*cell];
        let mut next = 0;
        while next < part.len() {
            for neighbour in part[next].neighbours() {
                let known = cells.binary_search(&neighbour);
                if known.is_ok_and(|at| core::mem::take(&mut is_left[at])) {
                    part.push(neighbour);
                }
            }
            next += 1;
        }
        part.sort_unstable();
        parts.push(part);
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Shape {
        serde_json::from_str(text).unwrap()
    }

    #[test]
    fn counts_cells() {
        for (text, count) in [
            (r#"{"box":{"min":[0,0,0],"max":[2,1,0]}}"#, 6),
            (r#"{"sphere":{"center":[0,0,0],"radius":0}}"#, 1),
            (r#"{"sphere":{"center":[5,5,5],"radius":1}}"#, 7),
            (r#"{"sphere":{"center":[0,0,0],"radius":1.5}}"#, 19),
            (r#"{"disc":{"center":[0,0,0],"radius":1}}"#, 5),
            (r#"{"disc":{"center":[0,0,0],"radius":1,"axis":"x"}}"#, 5),
            (r#"{"cylinder":{"base":[0,0,0],"radius":1,"height":4}}"#, 20),
            (r#"{"cells":[[0,0,0],[1,0,0]]}"#, 2),
            (r#"{"union":[{"cells":[[0,0,0]]},{"box":{"min":[0,0,0],"max":[1,0,0]}}]}"#, 2),
            (r#"{"union":[{"union":[{"cells":[[5,0,0]]},{"cells":[[1,0,0]]}]},{"cells":[[5,0,0]]}]}"#, 2),
            (r#"{"difference":[{"box":{"min":[0,0,0],"max":[2,2,2]}},{"cells":[[1,1,1]]}]}"#, 26),
            (r#"{"intersection":[{"box":{"min":[0,0,0],"max":[2,2,2]}},{"cells":[[1,1,1],[3,3,3]]}]}"#, 1),
        ] {
            assert_eq!(read(text).cells().map(|c| c.len()), Ok(count), "{text}");
        }
    }

    #[test]
    fn refuses_invalid_shapes() {
        for (text, part) in [
            (r#"{"cells":[[0,0,0],[0,0,0]]}"#, "twice"),
            (r#"{"cells":[]}"#, "no cell"),
            (r#"{"box":{"min":[1,0,0],"max":[0,0,0]}}"#, "inside out"),
            (r#"{"box":{"min":[0,0,0],"max":[9999,9999,9999]}}"#, "more than"),
            (r#"{"sphere":{"center":[16383,0,0],"radius":4}}"#, "out of range"),
            (r#"{"cylinder":{"base":[0,0,0],"radius":1,"height":0}}"#, "no cell"),
            (r#"{"cylinder":{"base":[0,0,0],"radius":1,"height":65535}}"#, "out of range"),
            (
                r#"{"union":[{"union":[{"box":{"min":[0,0,0],"max":[157,157,157]}}]},{"box":{"min":[0,0,200],"max":[157,157,250]}}]}"#,
                "more than",
            ),
            (r#"{"difference":[]}"#, "at least one"),
            (r#"{"intersection":[]}"#, "at least one"),
            (r#"{"intersection":[{"cells":[[0,0,0]]},{"cells":[[1,1,1]]}]}"#, "no cell"),
        ] {
            let error = read(text).cells().unwrap_err().to_string();
            assert!(error.contains(part), "{text}: {error}");
        }
        for text in [r#"{"sphere":{"center":[0,0,0],"radius":-1}}"#, r#"{"ball":{}}"#] {
            assert!(serde_json::from_str::<Shape>(text).is_err(), "{text}");
        }
    }

    #[test]
    fn finds_components() {
        let shape = read(r#"{"cells":[[0,0,0],[1,0,0],[3,0,0],[3,1,0],[9,9,9]]}"#);
        let sizes: Vec<_> = components(&shape.cells().unwrap()).iter().map(Vec::len).collect();
        assert_eq!(sizes, [2, 2, 1]);
    }
}
