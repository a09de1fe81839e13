//! The goal compiler: from a shape and a seed to the growth order that agents follow.
//!
//! Every goal cell gets a level, its distance from the seed through goal cells (the seed has 1).
//! Growth goes up the levels, so that no cell is walled in before it is filled. Two modes:
//!
//! * **Scaffold** (after Stoy, thesis 4.1.2): of every 2×2×2 cells the corner and the three edges, about half
//!   of the volume. The other cells are tunnels that always lead outside, so a cell may be filled as soon as
//!   any lower neighbour is.
//! * **Solid**: all cells. A cell may be filled only after all its lower neighbours, so that filled cells
//!   never overhang unfilled ones.

use crate::lattice::{Cell, Face};
use crate::shape::components;
use alloc::collections::{BTreeMap, BTreeSet};
use alloc::vec;
use alloc::vec::Vec;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// The part of the shape that is filled, and the rule that growth follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Growth {
    /// Corners and edges of a cubic scaffold; any lower neighbour may start a cell. Leaves out about half of the shape, and
    /// all of it that is thinner than the scaffold's step of two cells, so it is chosen and never assumed.
    Scaffold,
    /// Every cell; all lower neighbours must be filled before a cell is started.
    #[default]
    Solid,
}

/// A compiled goal.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Goal {
    growth: Growth,
    seed: Cell,
    min: Cell,
    /// Cells along each axis of the grid that `levels` fills.
    extent: [usize; 3],
    /// Level of every cell of the grid, 0 outside the goal.
    levels: Vec<u16>,
    cells: usize,
    /// Cells that only this neighbour may start.
    only_from: BTreeMap<Cell, Cell>,
}

/// Why a shape cannot be a goal.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum GoalError {
    /// The seed is not a cell of the shape.
    #[error("the seed {0} is not a cell of the goal")]
    SeedOutside(Cell),
    /// Growth cannot reach all cells.
    #[error(
        "{count} goal cells, {example} among them, are not connected to the seed {seed}{hint}",
        hint = if *.scaffold { " by the scaffold; make the shape at least two cells thick there, or use growth = \"solid\"" } else { "" }
    )]
    Disconnected {
        /// The number of cells that are cut off.
        count: usize,
        /// One of them.
        example: Cell,
        /// The seed.
        seed: Cell,
        /// True if the scaffold is disconnected and the shape itself is not.
        scaffold: bool,
    },
    /// Growth from the seed takes too many steps; levels are stored in 16 bits.
    #[error("the goal is {0} steps deep; the maximum is 60,000")]
    TooDeep(usize),
}

impl Goal {
    /// Compiles a shape, given as its cells in ascending order. In scaffold mode corners of the scaffold are
    /// the cells at even distances from the seed on all three axes.
    ///
    /// # Errors
    /// Refuses a shape that does not contain the seed, that growth from the seed cannot fill, or that is too
    /// deep.
    pub fn compile(shape: &[Cell], seed: Cell, growth: Growth) -> Result<Goal, GoalError> {
        if shape.binary_search(&seed).is_err() {
            return Err(GoalError::SeedOutside(seed));
        }
        if let [_, cut, ..] = &components(shape)[..] {
            let (example, count) = (cut[0], shape.len() - components(shape)[0].len());
            return Err(GoalError::Disconnected { count, example, seed, scaffold: false });
        }
        let set: BTreeSet<Cell> = match growth {
            Growth::Solid => shape.iter().copied().collect(),
            Growth::Scaffold => scaffold(&shape.iter().copied().collect(), seed),
        };
        let (level_of, deepest) = levels(&set, seed);
        if let Some(cut) = set.iter().find(|c| !level_of.contains_key(c)) {
            let count = set.len() - level_of.len();
            return Err(GoalError::Disconnected { count, example: *cut, seed, scaffold: true });
        }
        if deepest > 60_000 {
            return Err(GoalError::TooDeep(deepest));
        }
        let fold = |f: fn(i16, i16) -> i16, start: Cell| {
            set.iter().fold(start, |a, c| Cell::new(f(a.x, c.x), f(a.y, c.y), f(a.z, c.z)))
        };
        let (min, max) = (fold(i16::min, seed), fold(i16::max, seed));
        let length = |a: i16, b: i16| usize::from(b.abs_diff(a)) + 1;
        let extent = [length(min.x, max.x), length(min.y, max.y), length(min.z, max.z)];
        let mut goal = Goal {
            growth,
            seed,
            min,
            extent,
            levels: vec![0; extent.iter().product()],
            cells: set.len(),
            only_from: BTreeMap::new(),
        };
        for (cell, level) in &level_of {
            let at = goal.index(*cell).expect("invariant: the grid spans every goal cell");
            goal.levels[at] = *level as u16;
        }
        if growth == Growth::Scaffold {
            goal.keep_meeting_points_open(&set);
        }
        Ok(goal)
    }

    /// Finds the corners at which growth fronts meet from all six sides, and reserves one of the neighbouring edges
    /// of each: only the corner may start that edge. So the corner stays reachable until it is filled.
    fn keep_meeting_points_open(&mut self, set: &BTreeSet<Cell>) {
        for cell in set {
            let level = self.level(*cell);
            let surrounded =
                cell.neighbours().iter().all(|n| (1..level).contains(&self.level(*n)) && level > 1);
            if surrounded {
                let last = cell.neighbours().into_iter().max_by_key(|n| (self.level(*n), *n));
                self.only_from.extend(last.map(|edge| (edge, *cell)));
            }
        }
    }

    fn index(&self, cell: Cell) -> Option<usize> {
        let along =
            |c: i16, m: i16, n: usize| usize::try_from(i32::from(c) - i32::from(m)).ok().filter(|i| *i < n);
        let x = along(cell.x, self.min.x, self.extent[0])?;
        let y = along(cell.y, self.min.y, self.extent[1])?;
        let z = along(cell.z, self.min.z, self.extent[2])?;
        Some((x * self.extent[1] + y) * self.extent[2] + z)
    }

    /// Returns the level of a cell; 0 if it is not a goal cell.
    pub fn level(&self, cell: Cell) -> u16 {
        self.index(cell).map_or(0, |i| self.levels[i])
    }
    /// Returns true if the cell is to be filled.
    pub fn contains(&self, cell: Cell) -> bool {
        self.level(cell) != 0
    }
    /// Returns the number of goal cells.
    pub fn len(&self) -> usize {
        self.cells
    }
    /// Returns false: a goal has at least its seed.
    pub fn is_empty(&self) -> bool {
        false
    }
    /// Returns the cell that growth starts from.
    pub fn seed(&self) -> Cell {
        self.seed
    }
    /// Returns the rule of growth.
    pub fn growth(&self) -> Growth {
        self.growth
    }
    /// Returns all goal cells in ascending order.
    pub fn cells(&self) -> impl Iterator<Item = Cell> + '_ {
        let [nx, ny, nz] = self.extent;
        (0..nx * ny * nz)
            .filter(|i| self.levels[*i] != 0)
            .map(move |i| self.min + Cell::new((i / (ny * nz)) as i16, (i / nz % ny) as i16, (i % nz) as i16))
    }

    /// Returns true if the levels allow the module in goal cell `from` to start the neighbouring cell outside
    /// `face`. Which cells must be filled first is up to [`Goal::lower_neighbours`].
    pub fn may_start(&self, from: Cell, face: Face) -> bool {
        let cell = from.step(face);
        let (mine, its) = (self.level(from), self.level(cell));
        match self.only_from.get(&cell) {
            Some(only) => *only == from,
            None => mine != 0 && its > mine,
        }
    }

    /// Returns the faces of a goal cell outside which there is a goal cell of a lower level.
    pub fn lower_neighbours(&self, cell: Cell) -> impl Iterator<Item = Face> + '_ {
        let level = self.level(cell);
        Face::ALL.into_iter().filter(move |f| (1..level).contains(&self.level(cell.step(*f))))
    }
}

fn scaffold(shape: &BTreeSet<Cell>, seed: Cell) -> BTreeSet<Cell> {
    let odd = |a: i16, b: i16| a.abs_diff(b) % 2 == 1;
    let odd_axes =
        |c: Cell| [odd(c.x, seed.x), odd(c.y, seed.y), odd(c.z, seed.z)].iter().filter(|o| **o).count();
    shape
        .iter()
        .copied()
        .filter(|c| match odd_axes(*c) {
            0 => true,
            1 => Face::ALL
                .into_iter()
                .filter(|f| odd_axes(c.step(*f)) == 0)
                .all(|f| shape.contains(&c.step(f))),
            _ => false,
        })
        .collect()
}

fn levels(set: &BTreeSet<Cell>, seed: Cell) -> (BTreeMap<Cell, usize>, usize) {
    let mut level_of = BTreeMap::from([(seed, 1)]);
    let (mut front, mut level) = (vec![seed], 1);
    while !front.is_empty() {
        level += 1;
        let mut next = Vec::new();
        for neighbour in front.iter().flat_map(|c| c.neighbours()) {
            if set.contains(&neighbour) && !level_of.contains_key(&neighbour) {
                level_of.insert(neighbour, level);
                next.push(neighbour);
            }
        }
        front = next;
    }
    (level_of, level - 1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shape::{Radius, Shape};

    fn ball(radius: u16) -> Vec<Cell> {
        Shape::Sphere { center: Cell::default(), radius: Radius::cells(radius) }.cells().unwrap()
    }

    #[test]
    fn levels_are_distances_from_the_seed() {
        let goal = Goal::compile(&ball(5), Cell::default(), Growth::Solid).unwrap();
        assert_eq!(goal.len(), ball(5).len());
        assert_eq!(goal.cells().collect::<Vec<_>>(), ball(5));
        for cell in goal.cells() {
            assert_eq!(u32::from(goal.level(cell)), cell.manhattan(Cell::default()) + 1);
        }
        assert_eq!(goal.level(Cell::new(6, 0, 0)), 0);
        assert_eq!(goal.level(Cell::new(-600, 0, 0)), 0);
    }

    /// Lemma 1 of the scaffold: from the seed upwards, in any order in which cells are filled from lower
    /// neighbours, an unfilled goal cell keeps an empty neighbour.
    #[test]
    fn scaffold_never_encloses_an_unfilled_cell() {
        for seed_cell in [Cell::default(), Cell::new(0, 0, -5), Cell::new(1, 2, 3)] {
            let goal = Goal::compile(&ball(5), seed_cell, Growth::Scaffold).unwrap();
            for order in 0..20u64 {
                let mut rng = crate::rng::Rng::named(order, "fill", 0);
                let mut filled = BTreeSet::from([seed_cell]);
                while filled.len() < goal.len() {
                    let open: Vec<Cell> = goal
                        .cells()
                        .filter(|c| {
                            let starts = |f: Face| {
                                let from = c.step(f);
                                filled.contains(&from) && goal.may_start(from, f.opposite())
                            };
                            !filled.contains(c) && Face::ALL.into_iter().any(starts)
                        })
                        .collect();
                    for cell in goal.cells().filter(|c| !filled.contains(c)) {
                        let enclosed = cell.neighbours().iter().all(|n| filled.contains(n));
                        assert!(!enclosed, "{cell} is enclosed in order {order}");
                    }
                    filled.insert(open[rng.below(open.len() as u64) as usize]);
                }
            }
        }
    }

    #[test]
    fn a_corner_where_fronts_meet_stays_open() {
        // A hollow box: growth goes around both sides of the hole and meets behind it.
        let full = Shape::Box { min: Cell::new(0, 0, 0), max: Cell::new(8, 8, 8) };
        let hole = Shape::Box { min: Cell::new(3, 3, 3), max: Cell::new(5, 5, 5) };
        let shape = Shape::Difference(vec![full, hole]).cells().unwrap();
        let goal = Goal::compile(&shape, Cell::new(0, 0, 0), Growth::Scaffold).unwrap();
        for cell in goal.cells() {
            let startable = Face::ALL.iter().any(|f| goal.may_start(cell.step(*f), f.opposite()));
            assert!(startable || cell == goal.seed(), "{cell} can never be started");
        }
    }

    #[test]
    fn refuses_shapes_that_cannot_grow() {
        let line: Vec<Cell> = (0..4).map(|x| Cell::new(x, 0, 0)).collect();
        assert_eq!(
            Goal::compile(&line, Cell::new(9, 0, 0), Growth::Solid),
            Err(GoalError::SeedOutside(Cell::new(9, 0, 0)))
        );
        let apart = [Cell::new(0, 0, 0), Cell::new(2, 0, 0)];
        let error = Goal::compile(&apart, apart[0], Growth::Solid).unwrap_err();
        assert!(error.to_string().contains("not connected"), "{error}");
        // One step around a corner has no scaffold edge that reaches it.
        let staircase = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [2, 1, 0], [2, 2, 0]].map(Cell::from);
        let error = Goal::compile(&staircase, staircase[0], Growth::Scaffold).unwrap_err();
        assert!(error.to_string().contains("scaffold"), "{error}");
    }
}
