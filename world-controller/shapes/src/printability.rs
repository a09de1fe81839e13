//! Checks before a run what of a shape cannot be built, and why.
//!
//! Absent: what a mesh lost in the conversion (see `voxel`).

use metamorph_core::goal::{Goal, GoalError, Growth};
use metamorph_core::lattice::Cell;
use metamorph_core::shape::components;
use metamorph_text::format::{count, many};
use std::fmt;

/// A problem of a shape, or a note about it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Finding {
    /// Parts that do not touch by a face.
    Disconnected {
        /// The largest parts: a cell and the size of each.
        parts: Vec<(Cell, usize)>,
    },
    /// Enclosed empty cells.
    Voids {
        /// Number of voids.
        count: usize,
        /// Cells of all voids.
        cells: usize,
        /// One of them.
        example: Cell,
        /// The growth of the goal.
        growth: Growth,
    },
    /// The growth cannot reach all cells.
    Growth(GoalError),
}

impl Finding {
    /// Returns true if this makes the shape unbuildable; otherwise it is a note.
    pub fn forbids(&self) -> bool {
        !matches!(self, Finding::Voids { .. })
    }
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Finding::Disconnected { parts } => {
                let shown =
                    parts.iter().take(4).map(|(cell, n)| format!("{} with {cell}", many(*n as u64, "cell")));
                let dots = if parts.len() > 4 { ", …" } else { "" };
                write!(
                    f,
                    "it is in {} parts that do not touch with a face ({}{dots}), and what does not touch cannot be reached\n  fix: join the parts, or choose a smaller pitch",
                    count(parts.len() as u64),
                    shown.collect::<Vec<_>>().join(", ")
                )
            }
            Finding::Voids { count, cells, example, growth } => {
                let (voids, cells) = (many(*count as u64, "inner void"), many(*cells as u64, "cell"));
                write!(f, "it has {voids} with {cells}, such as {example}")?;
                match growth {
                    Growth::Scaffold => write!(f, "; the tunnels of the scaffold lead into them"),
                    Growth::Solid => write!(
                        f,
                        "; such shapes can be built, but this is not guaranteed: a module inside a void when it closes stays there\n  fix: fill them (`voids = \"fill\"`, --fill-voids), or grow a scaffold"
                    ),
                }
            }
            Finding::Growth(error) => write!(f, "{error}"),
        }
    }
}

/// Checks a shape, given as cells in ascending order.
pub fn printability(cells: &[Cell], seed: Cell, growth: Growth) -> Vec<Finding> {
    let mut findings = Vec::new();
    let mut parts: Vec<(Cell, usize)> = components(cells).iter().map(|part| (part[0], part.len())).collect();
    if parts.len() > 1 {
        parts.sort_by_key(|(cell, count)| (std::cmp::Reverse(*count), *cell));
        findings.push(Finding::Disconnected { parts });
    } else if let Err(error) = Goal::compile(cells, seed, growth) {
        findings.push(Finding::Growth(error));
    }
    let voids = voids(cells);
    let empty: Vec<Cell> = voids.iter().flatten().copied().collect();
    if let Some(example) = empty.first() {
        findings.push(Finding::Voids { count: voids.len(), cells: empty.len(), example: *example, growth });
    }
    findings
}

/// Returns the enclosed empty cells, each void in ascending order. Uses memory for every cell of the bounding
/// box.
pub fn voids(cells: &[Cell]) -> Vec<Vec<Cell>> {
    let Some((min, max)) = corners(cells) else { return Vec::new() };
    // One cell of margin makes the outside one piece.
    let side = |low: i16, high: i16| (i32::from(high) - i32::from(low)) as usize + 3;
    let (nx, ny, nz) = (side(min.x, max.x), side(min.y, max.y), side(min.z, max.z));
    let place = |cell: &Cell| {
        let along = |c: i16, low: i16| (i32::from(c) - i32::from(low)) as usize + 1;
        (along(cell.x, min.x) * ny + along(cell.y, min.y)) * nz + along(cell.z, min.z)
    };
    let mut seen = vec![false; nx * ny * nz];
    for cell in cells {
        seen[place(cell)] = true;
    }
    let mut front = vec![0];
    seen[0] = true;
    while let Some(at) = front.pop() {
        let mut step = |stride: usize, length: usize| {
            let along = at / stride % length;
            let before = (along > 0).then(|| at - stride);
            let behind = (along + 1 < length).then_some(at + stride);
            for next in before.into_iter().chain(behind) {
                if !std::mem::replace(&mut seen[next], true) {
                    front.push(next);
                }
            }
        };
        step(1, nz);
        step(nz, ny);
        step(ny * nz, nx);
    }
    let cell = |i: usize| {
        let along = |n: usize, low: i16| (n as i32 - 1 + i32::from(low)) as i16;
        Cell::new(along(i / (ny * nz), min.x), along(i / nz % ny, min.y), along(i % nz, min.z))
    };
    let empty: Vec<Cell> =
        seen.iter().enumerate().filter(|(_, seen)| !**seen).map(|(i, _)| cell(i)).collect();
    components(&empty)
}

/// Returns the cells of the bounding box.
pub fn volume(cells: &[Cell]) -> u64 {
    let side = |low: i16, high: i16| u64::from(low.abs_diff(high)) + 1;
    corners(cells).map_or(0, |(a, b)| side(a.x, b.x) * side(a.y, b.y) * side(a.z, b.z))
}

/// Returns the corners of the bounding box.
pub fn corners(cells: &[Cell]) -> Option<(Cell, Cell)> {
    let first = *cells.first()?;
    let fold = |f: fn(i16, i16) -> i16| {
        cells.iter().fold(first, |a, c| Cell::new(f(a.x, c.x), f(a.y, c.y), f(a.z, c.z)))
    };
    Some((fold(i16::min), fold(i16::max)))
}
