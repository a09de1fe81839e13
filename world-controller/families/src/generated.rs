//! Exploration support of a family: randomly generated swarms and goals that can be written as scenarios and made
//! smaller. Absent: links and faults, which all families share (`explore`).

use metamorph_protocol::lattice::Cell;
use metamorph_protocol::rng::Rng;
use metamorph_scenario::family::Swarm;
use std::any::Any;
use std::fmt;
use std::ops::Range;

/// How moves and connections fail.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Failing {
    /// Rate at which moves or connections fail, in percent.
    pub percent: u8,
    /// The model of connections: the largest error of a posture in millimetres, and thousandths of a degree by which a joint
    /// yields to each Nm; `None` if every connector is where it should be.
    pub model: Option<(u8, u16)>,
}

impl Failing {
    /// Writes the keys of `[swarm]`. Where nothing has weight, joints do not yield.
    ///
    /// # Errors
    /// If the formatter fails.
    pub fn write(self, f: &mut fmt::Formatter<'_>, has_weight: bool) -> fmt::Result {
        if self.percent > 0 {
            writeln!(f, "failed_connections = \"{}%\"", self.percent)?;
        }
        let Some((noise, yields)) = self.model else { return Ok(()) };
        let compliance = match has_weight {
            true => format!(", compliance_deg_per_nm = {}", f64::from(yields) / 1000.0),
            false => String::new(),
        };
        writeln!(f, "connection = {{ shift_noise_mm = {noise}{compliance} }}")
    }
}

/// The family's part of a generated scenario.
pub trait GeneratedSwarm: Any + fmt::Debug + Send + SwarmDraftClone {
    /// Returns the number of modules.
    fn modules(&self) -> usize;
    /// Returns the number of goal cells or seeds of all goals.
    fn goal_cells(&self) -> usize;
    /// Describes the modules and their protocol in a few words.
    fn summary(&self) -> String;
    /// Writes the remaining keys of `[swarm]`, and the sections `[[goal]]` and `[protocol]`.
    fn write(&self, f: &mut fmt::Formatter<'_>, failing: Failing) -> fmt::Result;
    /// Fixes what the seed of the run has decided. Returns true if that changed anything.
    fn settle(&mut self, swarm: &Swarm) -> bool;
    /// Returns all slightly smaller or simpler swarms, the most effective reductions first.
    fn smaller(&self) -> Vec<Smaller>;
    /// Draws a cell for an obstacle; `None` if obstacles do not affect this family.
    fn obstacle(&self, dice: &mut Dice) -> Option<Cell>;
    /// Returns the number of passive elements, which can be dropped.
    fn elements(&self) -> u16 {
        0
    }
}

/// Clones a draft behind a trait object.
pub trait SwarmDraftClone {
    /// Returns a clone.
    fn boxed(&self) -> Box<dyn GeneratedSwarm>;
}

impl<D: GeneratedSwarm + Clone> SwarmDraftClone for D {
    fn boxed(&self) -> Box<dyn GeneratedSwarm> {
        Box::new(self.clone())
    }
}

impl Clone for Box<dyn GeneratedSwarm> {
    fn clone(&self) -> Self {
        (**self).boxed()
    }
}

/// A slightly smaller or simpler swarm.
pub struct Smaller {
    /// The swarm.
    pub swarm: Box<dyn GeneratedSwarm>,
    /// The modules removed.
    pub gone: Range<usize>,
    /// True if another module takes over the faults of the one removed.
    pub replaced: bool,
}

/// A source of random choices.
pub struct Dice(pub Rng);

impl Dice {
    /// Draws a number from `low` to `high`, both included.
    pub fn within(&mut self, low: u64, high: u64) -> u64 {
        low + self.0.below(high - low + 1)
    }
    /// Draws one of these.
    pub fn pick<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.0.below(of.len() as u64) as usize]
    }
    /// Returns true with a probability of 1/`n`.
    pub fn once_in(&mut self, n: u64) -> bool {
        self.0.below(n) == 0
    }
}

/// Returns ranges of indices into a list of this length: all of it, its halves, its quarters, and so on down
/// to single elements.
pub fn parts(len: usize) -> Vec<std::ops::Range<usize>> {
    let (mut parts, mut size) = (Vec::new(), len);
    while size > 0 {
        parts.extend((0..len).step_by(size).map(|from| from..(from + size).min(len)));
        size /= 2;
    }
    parts
}

/// Formats cells as in a scenario.
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
