//! Random structures, for tests and experiments.

use metamorph_core::lattice::{Cell, Face};
use metamorph_core::rng::Rng;
use std::collections::BTreeSet;

/// How a structure grows from one cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Each free neighbouring cell is as likely (Eden's model).
    Eden,
    /// The same, but a cell that would touch two drawn ones is passed over with a probability of 70 %.
    Tree,
}

/// Draws a connected structure of `cells` cells: in one layer, or in space.
pub fn structure(kind: Kind, flat: bool, cells: usize, rng: &mut Rng) -> Vec<Cell> {
    let faces = if flat { &Face::ALL[..4] } else { &Face::ALL[..] };
    let mut drawn = BTreeSet::from([Cell::default()]);
    // Free neighbours in the order in which they appeared, each once.
    let mut free: Vec<Cell> = faces.iter().map(|f| f.offset()).collect();
    let mut known: BTreeSet<Cell> = free.iter().copied().chain(drawn.iter().copied()).collect();
    while drawn.len() < cells {
        let at = rng.below(free.len() as u64) as usize;
        let cell = free[at];
        let touches = cell.neighbours().iter().filter(|n| drawn.contains(n)).count();
        if kind == Kind::Tree && touches > 1 && rng.below(10) < 7 {
            continue;
        }
        free.swap_remove(at);
        drawn.insert(cell);
        free.extend(faces.iter().map(|f| cell.step(*f)).filter(|n| known.insert(*n)));
    }
    drawn.into_iter().collect()
}
