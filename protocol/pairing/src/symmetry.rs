//! The mirrors and turns of a structure that keep the vertical.

use super::Surroundings;
use metamorph_core::lattice::Cell;

/// A map of the floor to itself: about the centre of the structure, by quarter turns after a mirror.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Symmetry {
    /// Whether x is mirrored first.
    mirror: bool,
    /// Quarter turns.
    turns: u8,
    /// The sums of the least and greatest x and y.
    twice_centre: [i32; 2],
}

impl Symmetry {
    /// Returns the symmetries of the drawn cells except the identity.
    pub fn all(around: &Surroundings) -> Vec<Symmetry> {
        let drawn = || around.cells.iter().zip(&around.drawn).filter(|(_, d)| **d).map(|(c, _)| *c);
        let sum = |along: fn(Cell) -> i16| {
            let ends = drawn().map(along).fold((i16::MAX, i16::MIN), |(a, b), x| (a.min(x), b.max(x)));
            i32::from(ends.0) + i32::from(ends.1)
        };
        let twice_centre = [sum(|c| c.x), sum(|c| c.y)];
        let maps = (0..8).map(|i| Symmetry { mirror: i >= 4, turns: i % 4, twice_centre });
        let keeps = |map: &Symmetry| {
            drawn()
                .all(|c| map.image(c).and_then(|c| around.index(c)).is_some_and(|i| around.drawn[i as usize]))
        };
        maps.skip(1).filter(keeps).collect()
    }
    /// Returns the image of a cell; `None` if it is not a cell.
    pub fn image(&self, cell: Cell) -> Option<Cell> {
        let [cx, cy] = self.twice_centre;
        let (mut x, mut y) = (2 * i32::from(cell.x) - cx, 2 * i32::from(cell.y) - cy);
        if self.mirror {
            x = -x;
        }
        for _ in 0..self.turns {
            (x, y) = (-y, x);
        }
        let whole = |twice: i32| (twice % 2 == 0).then_some(twice / 2).and_then(|c| i16::try_from(c).ok());
        Some(Cell { x: whole(x + cx)?, y: whole(y + cy)?, z: cell.z })
    }
}
