//! Latencies of protocol messages, by class: scenario time from sending to the input of the receiver.
//!
//! They are counted in cells whose widths grow with the latency, so that memory is bounded, sums are exact, and
//! quantiles have a relative error of at most one cell, a sixteenth. All of it is integers, so that results are the same
//! on every machine and histograms can be added.

use crate::counters::Class;
use crate::time::Span;
use alloc::vec::Vec;
use core::ops::{AddAssign, Index, IndexMut};
use serde::{Deserialize, Serialize};

/// Number of cells for each power of two, as a power of two itself.
const STEP_BITS: u32 = 4;
/// Number of cells for each power of two.
const STEPS: u64 = 1 << STEP_BITS;

/// Counts of durations in cells of growing width.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
pub struct Histogram {
    /// Counts by cell, up to the last one that is not empty.
    cells: Vec<u64>,
}

impl Histogram {
    /// Counts a duration.
    pub fn record(&mut self, span: Span) {
        self.add_to(cell_of(span), 1);
    }

    fn add_to(&mut self, cell: usize, n: u64) {
        if self.cells.len() <= cell {
            self.cells.resize(cell + 1, 0);
        }
        self.cells[cell] += n;
    }

    /// Returns the number of durations.
    pub fn count(&self) -> u64 {
        self.cells.iter().sum()
    }

    /// Iterates over the cells that are not empty, from the shortest: the least and the greatest duration of each, and how
    /// many fell into it.
    pub fn cells(&self) -> impl Iterator<Item = (Span, Span, u64)> {
        let used = self.cells.iter().enumerate().filter(|(_, n)| **n > 0);
        used.map(|(cell, n)| (least_of(cell), Span(least_of(cell + 1).0 - 1), *n))
    }

    /// Returns a duration that at least `per_mille` of a thousand do not exceed: the greatest of the cell in which the
    /// quantile lies. `None` if nothing was counted. At zero it is the cell of the shortest duration.
    pub fn quantile(&self, per_mille: u64) -> Option<Span> {
        let needed = (u128::from(self.count()) * u128::from(per_mille)).div_ceil(1_000).max(1);
        let mut seen = 0;
        self.cells().find_map(|(_, greatest, n)| {
            seen += u128::from(n);
            (seen >= needed).then_some(greatest)
        })
    }
}

impl AddAssign<&Histogram> for Histogram {
    fn add_assign(&mut self, other: &Histogram) {
        for (cell, n) in other.cells.iter().enumerate().rev().filter(|(_, n)| **n > 0) {
            self.add_to(cell, *n);
        }
    }
}

/// Returns the cell of a duration. Those below [`STEPS`] ns have one each.
fn cell_of(span: Span) -> usize {
    let octave = span.0.checked_ilog2().unwrap_or(0).saturating_sub(STEP_BITS);
    // Below 16 · 61, so it fits.
    (u64::from(octave) * STEPS + (span.0 >> octave)) as usize
}

/// Returns the least duration of a cell.
fn least_of(cell: usize) -> Span {
    let octave = (cell as u64 / STEPS).saturating_sub(1);
    let step = cell as u64 - octave * STEPS;
    Span(u64::try_from(u128::from(step) << octave).unwrap_or(u64::MAX))
}

/// The latencies of the messages delivered, by class.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
pub struct Latencies {
    by_class: [Histogram; Class::ALL.len()],
    /// The part of these latencies for which messages were in a channel between processes: all of it is the machine's, and
    /// the rest the link model's. Empty if there are no processes.
    pub channel: Histogram,
}

impl Latencies {
    /// Returns the histogram of all classes together.
    pub fn total(&self) -> Histogram {
        let mut sum = Histogram::default();
        self.by_class.iter().for_each(|histogram| sum += histogram);
        sum
    }
    /// Iterates over the classes and their histograms.
    pub fn iter(&self) -> impl Iterator<Item = (Class, &Histogram)> {
        Class::ALL.into_iter().zip(&self.by_class)
    }
}

impl Index<Class> for Latencies {
    type Output = Histogram;
    fn index(&self, class: Class) -> &Histogram {
        &self.by_class[class.index()]
    }
}
impl IndexMut<Class> for Latencies {
    fn index_mut(&mut self, class: Class) -> &mut Histogram {
        &mut self.by_class[class.index()]
    }
}
impl AddAssign<&Latencies> for Latencies {
    fn add_assign(&mut self, other: &Latencies) {
        for (mine, theirs) in self.by_class.iter_mut().zip(&other.by_class) {
            *mine += theirs;
        }
        self.channel += &other.channel;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rng::Rng;

    /// Every duration lies in its cell, cells follow each other without a gap, and none is wider than a sixteenth.
    #[test]
    fn cells_cover_all_durations() {
        let mut rng = Rng::named(1, "durations", 0);
        let drawn = (0..64).flat_map(|bits| {
            let low = 1_u64 << bits;
            [low - 1, low, low + rng.below(low), u64::MAX]
        });
        for n in drawn.collect::<Vec<u64>>() {
            let (cell, next) = (cell_of(Span(n)), least_of(cell_of(Span(n)) + 1).0);
            let least = least_of(cell).0;
            assert!(least <= n && (n < next || n == u64::MAX), "{n}: {least}..{next}");
            assert!(next - least <= (least / STEPS).max(1), "{n}: {least}..{next}");
        }
        assert!((1..2_000).all(|cell| least_of(cell) >= least_of(cell - 1)));
    }

    /// Quantiles are those of the sorted durations, to one cell; added histograms are the histogram of all.
    #[test]
    fn quantiles_are_those_of_the_durations() {
        let mut rng = Rng::named(2, "durations", 0);
        let (mut parts, mut all) = ([Histogram::default(), Histogram::default()], Vec::new());
        for i in 0..10_000 {
            let longest = 1 << rng.below(40);
            let span = Span(rng.below(1 + longest));
            parts[i % 2].record(span);
            all.push(span);
        }
        all.sort_unstable();
        let [mut sum, other] = parts;
        sum += &other;
        assert_eq!(sum.count(), 10_000);
        for per_mille in [0, 1, 500, 900, 990, 999, 1_000] {
            let exact = all[(per_mille as usize * 10).max(1) - 1].0;
            let found = sum.quantile(per_mille).unwrap().0;
            assert!((exact..=exact + exact / STEPS).contains(&found), "{per_mille}: {exact}, {found}");
        }
        assert_eq!(Histogram::default().quantile(500), None);
    }
}
