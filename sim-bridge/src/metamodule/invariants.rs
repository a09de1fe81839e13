//! Invariants of all runs of metamodules, besides those of all runs.

use crate::world::invariants::Invariant;
use metamorph_protocol::lattice::Cell;

/// A metamodule is attached to a connector of the floor by at least one end.
pub const ATTACHED: Invariant = Invariant::new("attached");
/// A cell is locked by one metamodule at a time.
pub const ONE_HOLDER_PER_LOCK: Invariant = Invariant::new("one-holder-per-lock");

/// Checks [`ATTACHED`] for one metamodule: for each end that grips, whether it lies on a connector.
pub fn attached(grips: &[bool]) -> Result<(), String> {
    match (grips.is_empty(), grips.iter().all(|on| *on)) {
        (true, _) => Err("no end grips".into()),
        (_, false) => Err("an end grips where there is no connector".into()),
        _ => Ok(()),
    }
}

/// Checks [`ONE_HOLDER_PER_LOCK`] for two metamodules: the cells that each holds locked, `mine` sorted.
pub fn one_holder_per_lock(mine: &[Cell], mut theirs: impl Iterator<Item = Cell>) -> Result<(), String> {
    match theirs.find(|c| mine.binary_search(c).is_ok()) {
        Some(cell) => Err(format!("both hold {cell}")),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn attached_fires() {
        assert!(attached(&[true]).is_ok() && attached(&[true, true]).is_ok());
        assert!(attached(&[]).is_err() && attached(&[true, false]).is_err());
    }

    #[test]
    fn one_holder_per_lock_fires() {
        let [a, b, c] = [0, 1, 2].map(|x| Cell::new(x, 0, 0));
        assert!(one_holder_per_lock(&[a, b], [c].into_iter()).is_ok());
        assert!(one_holder_per_lock(&[a, b], [c, b].into_iter()).is_err());
    }
}
