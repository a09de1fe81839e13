//! What exploration needs of a family: swarms and goals drawn at random, written as a scenario, and made
//! smaller. Absent: links and faults, which all families share (`explore`).

use crate::scenario::family::Swarm;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::rng::Stream;
use std::any::Any;
use std::fmt;
use std::ops::Range;

/// The family's part of a drawn scenario.
pub trait SwarmDraft: Any + fmt::Debug + Send + SwarmDraftClone {
    /// The number of modules.
    fn modules(&self) -> usize;
    /// The number of goal cells, or seeds, of all goals.
    fn goal_cells(&self) -> usize;
    /// The modules and how they decide, in a few words.
    fn summary(&self) -> String;
    /// Writes the keys of `[swarm]`, which has been begun, and the sections `[[goal]]` and `[protocol]`.
    /// `failed` is how often a move or connection fails, in percent.
    fn write(&self, f: &mut fmt::Formatter<'_>, failed: u8) -> fmt::Result;
    /// Takes over what the seed of the run has decided on. Returns whether that was anything.
    fn settle(&mut self, swarm: &Swarm) -> bool;
    /// Everything that is a little smaller or simpler, what gains most first.
    fn smaller(&self) -> Vec<Smaller>;
    /// Draws a cell for an obstacle; none if bodies of this family meet none.
    fn obstacle(&self, dice: &mut Dice) -> Option<Cell>;
}

/// Clones a draft whose type is not known.
pub trait SwarmDraftClone {
    /// The clone.
    fn boxed(&self) -> Box<dyn SwarmDraft>;
}

impl<D: SwarmDraft + Clone> SwarmDraftClone for D {
    fn boxed(&self) -> Box<dyn SwarmDraft> {
        Box::new(self.clone())
    }
}

impl Clone for Box<dyn SwarmDraft> {
    fn clone(&self) -> Self {
        (**self).boxed()
    }
}

/// A swarm that is a little smaller or simpler than another.
pub struct Smaller {
    /// The swarm.
    pub swarm: Box<dyn SwarmDraft>,
    /// The modules that are gone.
    pub gone: Range<usize>,
    /// Whether another module suffers the faults of the one that is gone.
    pub replaced: bool,
}

/// What is drawn from.
pub struct Dice(pub Stream);

impl Dice {
    /// From `low` to `high`, both included.
    pub fn within(&mut self, low: u64, high: u64) -> u64 {
        low + self.0.below(high - low + 1)
    }
    /// One of these.
    pub fn pick<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.0.below(of.len() as u64) as usize]
    }
    /// Once in `n`.
    pub fn once_in(&mut self, n: u64) -> bool {
        self.0.below(n) == 0
    }
}

/// Halves, quarters, and so on down to single elements.
pub fn parts(len: usize) -> Vec<std::ops::Range<usize>> {
    let (mut parts, mut size) = (Vec::new(), len);
    while size > 0 {
        parts.extend((0..len).step_by(size).map(|from| from..(from + size).min(len)));
        size /= 2;
    }
    parts
}

/// Cells as they are written in a scenario.
pub fn cells(cells: &[Cell]) -> String {
    let all: Vec<String> = cells.iter().map(|c| format!("[{}, {}, {}]", c.x, c.y, c.z)).collect();
    all.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_all_the_halves() {
        assert_eq!(parts(3), [0..3, 0..1, 1..2, 2..3]);
        assert!(parts(0).is_empty());
    }
}
