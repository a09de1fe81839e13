//! Intervals of figures that come from samples, and tests of whether the published figure can come from the same source.

use metamorph_protocol::rng::Rng;
use metamorph_report::statistics::quantile;

/// Number of samples drawn with replacement for an interval or a test.
const DRAWS: u64 = 2_000;

/// Two counts of each trial, whose figure is the ratio of their sums, such as failed tries and minimal moves.
pub struct Ratios(Vec<(u64, u64)>);

impl Ratios {
    /// Collects the counts of each trial.
    pub fn new(counts: impl IntoIterator<Item = (u64, u64)>) -> Ratios {
        Ratios(counts.into_iter().collect())
    }

    /// Returns the number of trials.
    pub fn len(&self) -> u64 {
        self.0.len() as u64
    }

    /// Returns the ratio of the sums.
    pub fn ratio(&self) -> f64 {
        ratio(self.0.iter().copied())
    }

    /// Returns the 95 % interval of the ratio; `None` without trials.
    pub fn interval(&self) -> Option<[f64; 2]> {
        self.drawn(self.len()).map(|drawn| interval(&drawn))
    }

    /// Returns the two-sided probability that as few trials as were published show a ratio at least as far from ours as the
    /// published one; `None` without trials.
    pub fn p(&self, published: f64, trials: u64) -> Option<f64> {
        let drawn = self.drawn(trials)?;
        let share = |of: fn(f64, f64) -> bool| {
            // One is added to both, so that no probability is 0 that only so many draws support.
            (1 + drawn.iter().filter(|ratio| of(**ratio, published)).count()) as f64
                / (drawn.len() + 1) as f64
        };
        Some((2.0 * share(|r, p| r <= p).min(share(|r, p| r >= p))).min(1.0))
    }

    /// Draws samples of this size with replacement, and returns their ratios in increasing order.
    fn drawn(&self, size: u64) -> Option<Vec<f64>> {
        let one = |rng: &mut Rng| self.0[rng.below(self.len()) as usize];
        (!self.0.is_empty()).then(|| resampled(|rng| ratio((0..size).map(|_| one(rng)))))
    }
}

/// Returns the values of a statistic of samples that it draws, in increasing order (bootstrap; Efron 1979).
pub fn resampled(statistic: impl FnMut(&mut Rng) -> f64) -> Vec<f64> {
    let mut all = samples(statistic);
    all.sort_unstable_by(f64::total_cmp);
    all
}

/// Returns what is made of each sample, for several statistics of the same samples.
pub fn samples<T>(mut of: impl FnMut(&mut Rng) -> T) -> Vec<T> {
    (0..DRAWS).map(|i| of(&mut Rng::named(0, "bootstrap", i))).collect()
}

/// Returns the 95 % interval of values in increasing order, of which there is at least one.
pub fn interval(sorted: &[f64]) -> [f64; 2] {
    [0.025, 0.975].map(|q| quantile(sorted, q))
}

fn ratio(counts: impl Iterator<Item = (u64, u64)>) -> f64 {
    let (above, below) = counts.fold((0, 0), |sum, c| (sum.0 + c.0, sum.1 + c.1));
    above as f64 / below.max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interval_holds_the_ratio_and_shrinks_with_the_sample() {
        let of = |n: u64| Ratios::new((0..n).map(|i| (i % 5, 2)));
        let width = |r: &Ratios| {
            let [low, high] = r.interval().unwrap();
            assert!(low <= r.ratio() && r.ratio() <= high);
            high - low
        };
        assert_eq!(of(100).ratio(), 1.0);
        assert!(width(&of(1_000)) < 0.5 * width(&of(50)));
        assert_eq!((Ratios::new([]).interval(), Ratios::new([]).p(1.0, 24)), (None, None));
    }

    #[test]
    fn a_published_ratio_far_from_ours_is_improbable() {
        let ours = Ratios::new((0..1_000).map(|i| (i % 5, 2)));
        assert!(ours.p(1.0, 24).unwrap() > 0.5);
        assert!(ours.p(1.6, 24).unwrap() < 0.01);
        // The same difference is no surprise in two trials.
        assert!(ours.p(1.6, 2).unwrap() > 0.1);
    }
}
