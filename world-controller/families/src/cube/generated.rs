//! A randomly generated swarm of cubes and its goals.

use super::name_of;
use crate::generated::{Dice, Failing, GeneratedSwarm, Smaller, cells, parts};
use metamorph_protocol::cube::params::Connectivity;
use metamorph_protocol::goal::Growth;
use metamorph_protocol::lattice::Cell;
use metamorph_scenario::family::Swarm;
use std::fmt;

/// A swarm of cubes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GeneratedCubes {
    /// The start cells, in ascending order: a module's number is its index.
    pub start: Vec<Cell>,
    /// The goals, one after the other; never empty.
    pub goals: Vec<CubeGoal>,
    /// The connectivity check.
    pub connectivity: Connectivity,
    /// Whether all neighbours of a cell are asked before it is entered.
    pub co_owners: bool,
}

/// A goal of cubes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CubeGoal {
    /// Its cells in ascending order.
    pub cells: Vec<Cell>,
    /// The seed of its growth.
    pub seed: Cell,
    /// Its growth.
    pub growth: Growth,
}

impl GeneratedSwarm for GeneratedCubes {
    fn modules(&self) -> usize {
        self.start.len()
    }
    fn goal_cells(&self) -> usize {
        self.goals.iter().map(|g| g.cells.len()).sum()
    }
    fn summary(&self) -> String {
        format!("{} cubes, {}", self.start.len(), name_of(self.connectivity))
    }
    fn settle(&mut self, _: &Swarm) -> bool {
        false
    }
    fn obstacle(&self, _: &mut Dice) -> Option<Cell> {
        None
    }
    fn write(&self, f: &mut fmt::Formatter<'_>, failing: Failing) -> fmt::Result {
        writeln!(f, "start = {{ cells = [{}] }}", cells(&self.start))?;
        failing.write(f, true)?;
        for goal in &self.goals {
            let growth = match goal.growth {
                Growth::Scaffold => "scaffold",
                Growth::Solid => "solid",
            };
            writeln!(f, "\n[[goal]]\nshape = {{ cells = [{}] }}", cells(&goal.cells))?;
            writeln!(f, "seed = {}\ngrowth = \"{growth}\"", cells(&[goal.seed]))?;
        }
        writeln!(f, "\n[protocol]\nconnectivity = \"{}\"", name_of(self.connectivity))?;
        writeln!(f, "co_owners = {}", self.co_owners)
    }
    fn smaller(&self) -> Vec<Smaller> {
        let (cubes, mut found) = (self, Vec::new());
        let mut add = |cubes: GeneratedCubes, gone| {
            found.push(Smaller { swarm: Box::new(cubes), gone, replaced: false });
        };
        for goal in (0..cubes.goals.len()).filter(|_| cubes.goals.len() > 1) {
            let mut fewer = cubes.clone();
            fewer.goals.remove(goal);
            add(fewer, 0..0);
        }
        for (i, goal) in cubes.goals.iter().enumerate() {
            for part in parts(goal.cells.len()) {
                let mut fewer = cubes.clone();
                fewer.goals[i].cells.drain(part);
                add(fewer, 0..0);
            }
        }
        for part in parts(cubes.start.len()) {
            let mut fewer = cubes.clone();
            fewer.start.drain(part.clone());
            add(fewer, part);
        }
        // One module and one goal cell less, if there are no more modules than cells.
        for (i, goal) in cubes.goals.iter().enumerate().filter(|(_, g)| g.cells.len() >= cubes.start.len()) {
            for (id, cell) in (0..cubes.start.len()).flat_map(|m| (0..goal.cells.len()).map(move |c| (m, c)))
            {
                let mut fewer = cubes.clone();
                fewer.start.remove(id);
                fewer.goals[i].cells.remove(cell);
                add(fewer, id..id + 1);
            }
        }
        if !cubes.co_owners {
            add(GeneratedCubes { co_owners: true, ..cubes.clone() }, 0..0);
        }
        for id in (0..cubes.start.len()).filter(|_| cubes.start.len() > 1) {
            let mut fewer = cubes.clone();
            fewer.start.remove(id);
            found.push(Smaller { swarm: Box::new(fewer), gone: id..id + 1, replaced: true });
        }
        found
    }
}
