//! Generates random swarms of cubes and their goals.

use super::generated::{CubeGoal, GeneratedCubes};
use crate::generated::Dice;
use metamorph_protocol::cube::params::Connectivity;
use metamorph_protocol::goal::{Goal, Growth};
use metamorph_protocol::lattice::{Cell, Face};
use std::collections::BTreeSet;

/// Returns two modules with a minimal goal.
pub fn smallest() -> GeneratedCubes {
    GeneratedCubes {
        start: vec![Cell::new(0, 0, 0), Cell::new(1, 0, 0)],
        goals: vec![CubeGoal {
            cells: vec![Cell::new(0, 0, 0), Cell::new(0, 0, 1)],
            seed: Cell::new(0, 0, 0),
            growth: Growth::Solid,
        }],
        connectivity: Connectivity::Forest,
        co_owners: true,
    }
}

/// Returns the bounds for a standstill and for moves without progress, in seconds, or `None` for the
/// defaults, which are for links that are faster than moves: a cube whose moves fail repeatedly rests for 150
/// moves. `delay` is the longest, in milliseconds.
pub fn patience(fails: bool, delay: u64) -> Option<(u64, u64)> {
    match delay {
        0..500 if !fails => None,
        0..1_000 => Some((1_000, 4_000)),
        _ => Some((3_000, 12_000)),
    }
}

impl Dice {
    /// Draws a block thick enough to have an inside, which must be filled before it is closed.
    fn thick(&mut self) -> GeneratedCubes {
        let (modules, sides) = (self.within(29, 36) as usize, self.pick(&[[3, 3, 3], [4, 3, 3], [3, 5, 3]]));
        let start = self.blob(Cell::new(0, 0, 0), modules, true);
        let seed = start[self.0.below(modules as u64) as usize];
        let corner = sides.map(|side| if self.once_in(2) { 0 } else { self.0.below(side) as i16 });
        let mut cells = Vec::new();
        for (x, y) in (0..sides[0] as i16).flat_map(|x| (0..sides[1] as i16).map(move |y| (x, y))) {
            let cell = |z| Cell::new(seed.x + x - corner[0], seed.y + y - corner[1], seed.z + z - corner[2]);
            cells.extend((0..sides[2] as i16).map(cell));
        }
        let goals = vec![CubeGoal { cells, seed, growth: Growth::Solid }];
        GeneratedCubes { start, goals, connectivity: Connectivity::Forest, co_owners: true }
    }

    /// Draws a swarm of cubes and its goals.
    pub fn cubes(&mut self) -> GeneratedCubes {
        if self.once_in(100) {
            return self.thick();
        }
        let modules = match self.0.below(10) {
            0..=2 => self.within(2, 4),
            3..=7 => self.within(4, 10),
            _ => self.within(8, 24),
        } as usize;
        let flat = self.once_in(2);
        let start = self.blob(Cell::new(0, 0, 0), modules, flat);
        let mut goals: Vec<CubeGoal> = Vec::new();
        for _ in 0..if self.once_in(6) { 2 } else { 1 } {
            // A later goal grows from a cell filled by the previous one.
            let filled = match goals.last() {
                None => start.clone(),
                Some(goal) => Goal::compile(&goal.cells, goal.seed, goal.growth)
                    .map_or_else(|_| vec![goal.seed], |g| g.cells().collect()),
            };
            let seed = filled[self.0.below(filled.len() as u64) as usize];
            goals.push(self.cube_goal(seed, modules));
        }
        GeneratedCubes {
            start,
            goals,
            connectivity: self.pick(&[Connectivity::Forest, Connectivity::Forest, Connectivity::Cycles]),
            co_owners: !self.once_in(3),
        }
    }

    fn cube_goal(&mut self, seed: Cell, modules: usize) -> CubeGoal {
        let size = self.within(1 + u64::from(modules > 2), modules as u64) as usize;
        if self.once_in(3) {
            let flat = self.once_in(2);
            return CubeGoal { cells: self.blob(seed, size, flat), seed, growth: Growth::Solid };
        }
        // A box around the seed; a scaffold fills about half of it.
        let growth = self.pick(&[Growth::Scaffold, Growth::Solid]);
        let sides = [0; 3].map(|_| self.within(1, 5) as i16);
        let corner = sides.map(|side| self.0.below(side as u64) as i16);
        let mut cells = Vec::new();
        for x in 0..sides[0] {
            for y in 0..sides[1] {
                let column = (0..sides[2]).map(|z| Cell::new(x, y, z));
                cells.extend(column.map(|c| {
                    Cell::new(seed.x + c.x - corner[0], seed.y + c.y - corner[1], seed.z + c.z - corner[2])
                }));
            }
        }
        CubeGoal { cells, seed, growth }
    }

    /// Draws connected cells around `from`.
    fn blob(&mut self, from: Cell, size: usize, flat: bool) -> Vec<Cell> {
        let mut cells = BTreeSet::from([from]);
        let mut list = vec![from];
        // Continuing from the latest cell gives lines, from any cell gives clumps.
        let straight = self.once_in(3);
        let faces = if flat { &Face::ALL[..4] } else { &Face::ALL[..] };
        while list.len() < size {
            let last = straight && !self.once_in(4);
            let at = if last { list[list.len() - 1] } else { self.pick(&list) };
            let next = at.step(self.pick(faces));
            if cells.insert(next) {
                list.push(next);
            }
        }
        cells.into_iter().collect()
    }
}
