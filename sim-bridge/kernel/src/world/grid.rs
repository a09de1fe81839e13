//! The occupant of each cell: a dense box of cells that grows as bodies move.

use metamorph_core::ids::ModuleId;
use metamorph_core::lattice::Cell;

/// How a module occupies a cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Occupant {
    /// Its body is in the cell, at rest or about to leave.
    Body(ModuleId),
    /// It moves into the cell, or sweeps it.
    Path(ModuleId),
}

/// Occupied cells. A lookup is an array access; memory is a box around all cells ever occupied.
#[derive(Clone, Debug, Default)]
pub struct Grid {
    min: [i32; 3],
    extent: [usize; 3],
    /// 0 is empty; otherwise `2·module + 1`, and one more for a path.
    slots: Vec<u32>,
}

/// Width of the margin on a side that grows.
const MARGIN_CELLS: i32 = 4;

impl Grid {
    fn index(&self, cell: Cell) -> Option<usize> {
        let at = [cell.x, cell.y, cell.z];
        let mut index = 0;
        for (i, c) in at.into_iter().enumerate() {
            let along = usize::try_from(i32::from(c) - self.min[i]).ok().filter(|o| *o < self.extent[i])?;
            index = index * self.extent[i] + along;
        }
        Some(index)
    }

    /// Returns the occupant of a cell.
    pub fn get(&self, cell: Cell) -> Option<Occupant> {
        match self.slots[self.index(cell)?] {
            0 => None,
            n if n % 2 == 1 => Some(Occupant::Body(ModuleId(n / 2))),
            n => Some(Occupant::Path(ModuleId(n / 2 - 1))),
        }
    }

    /// Returns the module whose body is in a cell.
    pub fn body(&self, cell: Cell) -> Option<ModuleId> {
        match self.get(cell) {
            Some(Occupant::Body(id)) => Some(id),
            _ => None,
        }
    }

    /// Sets the occupant of a cell.
    pub fn set(&mut self, cell: Cell, occupant: Option<Occupant>) {
        let value = match occupant {
            None => 0,
            Some(Occupant::Body(id)) => 2 * id.0 + 1,
            Some(Occupant::Path(id)) => 2 * id.0 + 2,
        };
        match self.index(cell) {
            Some(i) => self.slots[i] = value,
            None if value == 0 => {}
            None => {
                self.grow(cell);
                let i = self.index(cell).expect("invariant: the grid has just grown around the cell");
                self.slots[i] = value;
            }
        }
    }

    fn grow(&mut self, cell: Cell) {
        let old = std::mem::take(self);
        let at = [i32::from(cell.x), i32::from(cell.y), i32::from(cell.z)];
        let empty = old.slots.is_empty();
        for (i, at) in at.into_iter().enumerate() {
            let low = if empty { at } else { old.min[i].min(at) };
            let high = if empty { at } else { (old.min[i] + old.extent[i] as i32 - 1).max(at) };
            // Extra room on the side that had to grow, so that growing is rare.
            let room = MARGIN_CELLS + (high - low) / 4;
            self.min[i] = if empty || at <= old.min[i] { low - room } else { low };
            let top = if empty || high == at { high + room } else { high };
            self.extent[i] = (top - self.min[i] + 1) as usize;
        }
        self.slots = vec![0; self.extent.iter().product()];
        let [_, ny, nz] = old.extent;
        for (i, value) in old.slots.iter().enumerate().filter(|(_, v)| **v != 0) {
            let c = [i / (ny * nz), i / nz % ny, i % nz];
            let mut index = 0;
            for (axis, c) in c.into_iter().enumerate() {
                let along = (old.min[axis] + c as i32 - self.min[axis]) as usize;
                index = index * self.extent[axis] + along;
            }
            self.slots[index] = *value;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;

    /// The grid behaves like a map, on whichever side it has to grow.
    #[test]
    fn behaves_like_a_map() {
        let mut rng = metamorph_core::rng::Rng::named(3, "grid", 0);
        let (mut grid, mut map) = (Grid::default(), BTreeMap::new());
        for step in 0..3_000u32 {
            let mut c = || rng.below(61) as i16 - 30;
            let cell = Cell::new(c(), c(), c());
            let occupant = match step % 3 {
                0 => None,
                1 => Some(Occupant::Body(ModuleId(step))),
                _ => Some(Occupant::Path(ModuleId(step))),
            };
            grid.set(cell, occupant);
            match occupant {
                Some(o) => map.insert(cell, o),
                None => map.remove(&cell),
            };
            assert_eq!(grid.get(cell), occupant);
        }
        for x in -31..=31 {
            for y in -31..=31 {
                for z in -31..=31 {
                    let cell = Cell::new(x, y, z);
                    assert_eq!(grid.get(cell), map.get(&cell).copied());
                }
            }
        }
    }
}
