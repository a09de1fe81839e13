//! Statistics of two samples: differences with 95 % intervals, and tests. Pure functions.

use super::statistics::{Rate, Z95};

/// Largest number of values per sample for which the distribution of U is enumerated, if there are no ties.
const ENUMERATED_MAX: usize = 20;

/// A difference with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Difference {
    /// The estimate.
    pub by: f64,
    /// The lower end of the interval.
    pub low: f64,
    /// The upper end of the interval.
    pub high: f64,
}

/// Returns the difference of two shares, `b` − `a`, each as successes and trials: method 10 of Newcombe (1998,
/// Statistics in Medicine 17, 873–890), from the intervals of Wilson. `None` without trials.
pub fn newcombe(a: (u64, u64), b: (u64, u64)) -> Option<Difference> {
    let (a, b) = (Rate::wilson(a.0, a.1)?, Rate::wilson(b.0, b.1)?);
    let by = b.rate - a.rate;
    let low = by - (b.rate - b.low).hypot(a.high - a.rate);
    let high = by + (b.high - b.rate).hypot(a.rate - a.low);
    Some(Difference { by, low, high })
}

/// Two samples of numbers.
#[derive(Clone, Debug)]
pub struct Samples {
    a: Vec<f64>,
    b: Vec<f64>,
}

/// The comparison of two samples.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Compared {
    /// The shift from `a` to `b`.
    pub shift: Difference,
    /// The probability that a value of `b` is larger than one of `a`, with half of the equal ones.
    pub larger: f64,
    /// The probability of samples that differ at least as much, if both have one distribution (Mann–Whitney,
    /// two-sided).
    pub p: f64,
}

impl Samples {
    /// Creates samples of finite values; `None` if one is empty.
    pub fn new(mut a: Vec<f64>, mut b: Vec<f64>) -> Option<Samples> {
        a.sort_unstable_by(f64::total_cmp);
        b.sort_unstable_by(f64::total_cmp);
        (!a.is_empty() && !b.is_empty()).then_some(Samples { a, b })
    }

    /// Compares them.
    pub fn compare(&self) -> Compared {
        let (n, m) = (self.a.len() as f64, self.b.len() as f64);
        let u = self.u();
        Compared { shift: self.shift(), larger: u / (n * m), p: self.p(u) }
    }

    /// Counts the pairs in which the value of `b` is larger; equal ones count half.
    fn u(&self) -> f64 {
        let below = |x: f64| self.a.partition_point(|a| *a < x) + self.a.partition_point(|a| *a <= x);
        self.b.iter().map(|b| below(*b) as f64 / 2.0).sum()
    }

    /// Returns the estimate of Hodges and Lehmann (1963), the median of all differences, and the interval
    /// between those order statistics of the differences that the test would not reject, by the normal
    /// approximation.
    fn shift(&self) -> Difference {
        let (n, m) = (self.a.len() as f64, self.b.len() as f64);
        let last = self.a.len() as u64 * self.b.len() as u64 - 1;
        let spread = Z95 * (n * m * (n + m + 1.0) / 12.0).sqrt();
        let c = ((n * m / 2.0 - spread).floor().max(0.0) as u64).min(last);
        let by = f64::midpoint(self.difference(last / 2), self.difference(last.div_ceil(2)));
        Difference { by, low: self.difference(c), high: self.difference(last - c) }
    }

    /// Returns the difference of this rank, from 0, by bisection: all of them may be too many to list.
    fn difference(&self, rank: u64) -> f64 {
        let (mut below, mut above) = (key(f64::MIN), key(f64::MAX));
        while below < above {
            let middle = below + (above - below) / 2;
            if self.up_to(of_key(middle)) > rank { above = middle } else { below = middle + 1 }
        }
        of_key(above)
    }

    /// Counts the differences up to a bound.
    fn up_to(&self, bound: f64) -> u64 {
        let (mut from, mut count) = (0, 0);
        for b in &self.b {
            while self.a.get(from).is_some_and(|a| b - a > bound) {
                from += 1;
            }
            count += (self.a.len() - from) as u64;
        }
        count
    }

    /// Returns the sizes of groups of equal values in both samples together.
    fn ties(&self) -> Vec<f64> {
        let mut all = [self.a.as_slice(), self.b.as_slice()].concat();
        all.sort_unstable_by(f64::total_cmp);
        all.chunk_by(|x, y| x == y).map(|group| group.len() as f64).collect()
    }

    fn p(&self, u: f64) -> f64 {
        let (n, m) = (self.a.len(), self.b.len());
        let ties = self.ties();
        if n <= ENUMERATED_MAX && m <= ENUMERATED_MAX && ties.iter().all(|t| *t == 1.0) {
            return exact(n, m, u.round() as usize);
        }
        let (n, m) = (n as f64, m as f64);
        let all = n + m;
        let tied: f64 = ties.iter().map(|t| t * t * t - t).sum();
        let variance = n * m / 12.0 * (all + 1.0 - tied / (all * (all - 1.0)));
        if variance <= 0.0 {
            return 1.0;
        }
        let away = ((u - n * m / 2.0).abs() - 0.5).max(0.0);
        (2.0 * upper_tail(away / variance.sqrt())).min(1.0)
    }
}

/// Returns an integer that orders finite numbers as they are.
fn key(x: f64) -> i128 {
    let bits = i128::from(x.to_bits() & (u64::MAX >> 1));
    if x.is_sign_negative() { -bits } else { bits }
}

fn of_key(key: i128) -> f64 {
    let size = f64::from_bits(key.unsigned_abs() as u64);
    if key < 0 { -size } else { size }
}

/// Returns the two-sided probability of U by enumerating all orders of two samples without ties.
fn exact(n: usize, m: usize, u: usize) -> f64 {
    // Orders of i values of one and j of the other sample with each U: the largest value is of either sample.
    let mut ways = vec![vec![Vec::<f64>::new(); m + 1]; n + 1];
    for i in 0..=n {
        for j in 0..=m {
            let mut here = vec![0.0; i * j + 1];
            if i == 0 || j == 0 {
                here[0] = 1.0;
            } else {
                ways[i - 1][j].iter().enumerate().for_each(|(k, w)| here[k] += w);
                ways[i][j - 1].iter().enumerate().for_each(|(k, w)| here[k + i] += w);
            }
            ways[i][j] = here;
        }
    }
    let all = &ways[n][m];
    let total: f64 = all.iter().sum();
    let tail = u.min(n * m - u);
    (2.0 * all[..=tail].iter().sum::<f64>() / total).min(1.0)
}

/// Returns the probability that a standard normal number is larger than `z`, which is not negative.
fn upper_tail(z: f64) -> f64 {
    libm::erfc(z / std::f64::consts::SQRT_2) / 2.0
}

/// Adjusts the probabilities of several tests by the method of Holm (1979): each as the smallest level at which
/// its test would be rejected while the probability of any false rejection stays below the level.
pub fn holm(p: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|i, j| p[*i].total_cmp(&p[*j]).then(i.cmp(j)));
    let mut adjusted = vec![0.0; p.len()];
    let mut least = 0.0f64;
    for (rank, i) in order.into_iter().enumerate() {
        least = least.max(p[i] * (p.len() - rank) as f64).min(1.0);
        adjusted[i] = least;
    }
    adjusted
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_core::rng::Rng;

    fn close(a: f64, b: f64, tolerance: f64) {
        assert!((a - b).abs() <= tolerance, "{a} is not {b}");
    }

    /// Newcombe (1998), table II, method 10: 56/70 − 48/80, 9/10 − 3/10, 10/10 − 0/20, 10/10 − 0/10.
    #[test]
    fn differences_of_shares_are_the_published_ones() {
        for (a, b, low, high) in [
            ((48, 80), (56, 70), 0.0524, 0.3339),
            ((3, 10), (9, 10), 0.1705, 0.8090),
            ((0, 20), (10, 10), 0.6791, 1.0),
            ((0, 10), (10, 10), 0.6075, 1.0),
        ] {
            let difference = newcombe(a, b).unwrap();
            close(difference.low, low, 0.000_05);
            close(difference.high, high, 0.000_05);
            let other = newcombe(b, a).unwrap();
            close(other.low, -difference.high, 1e-12);
            close(other.by, -difference.by, 1e-12);
        }
        assert_eq!(newcombe((0, 0), (1, 2)), None);
    }

    /// The depression scores of R's help of `wilcox.test` are paired; its unpaired example is the permeability
    /// of the chorioamnion (Hollander and Wolfe 1973, 69 f.): W = 35, p = 0.2544 (two-sided), exact.
    #[test]
    fn the_test_gives_the_published_values() {
        let term = [0.80, 0.83, 1.89, 1.04, 1.45, 1.38, 1.91, 1.64, 0.73, 1.46];
        let early = [1.15, 0.88, 0.90, 0.74, 1.21];
        let samples = Samples::new(early.into(), term.into()).unwrap();
        assert_eq!(samples.u(), 35.0);
        let compared = samples.compare();
        close(compared.p, 0.254_412, 1e-6);
        close(compared.larger, 0.7, 1e-12);
        // The estimate of `wilcox.test(conf.int = TRUE)`.
        close(compared.shift.by, 0.305, 1e-9);
        let other = Samples::new(term.into(), early.into()).unwrap().compare();
        close(other.p, compared.p, 1e-12);
        close(other.shift.by, -compared.shift.by, 1e-12);
    }

    /// Differences by rank are those of the sorted list of all.
    #[test]
    fn differences_have_their_ranks() {
        let mut random = Rng::named(2, "samples", 0);
        let mut draw =
            |n: usize| -> Vec<f64> { (0..n).map(|_| random.below(40) as f64 / 4.0 - 5.0).collect() };
        let samples = Samples::new(draw(13), draw(17)).unwrap();
        let mut all: Vec<f64> = samples.b.iter().flat_map(|b| samples.a.iter().map(move |a| b - a)).collect();
        all.sort_by(f64::total_cmp);
        for (rank, expected) in all.iter().enumerate() {
            assert_eq!(samples.difference(rank as u64), *expected, "{rank}");
        }
    }

    /// By hand: of 1, 2, 2 and 2, 3 four pairs are larger and two equal, so U is 5; the normal approximation has
    /// the variance 6/12 · (6 − 24/20) = 2.4 and the distance |5 − 3| − ½.
    #[test]
    fn ties_are_corrected() {
        let samples = Samples::new(vec![1.0, 2.0, 2.0], vec![2.0, 3.0]).unwrap();
        assert_eq!(samples.u(), 5.0);
        let z = 1.5 / 2.4f64.sqrt();
        close(samples.compare().p, libm::erfc(z / 2f64.sqrt()), 1e-12);
        let equal = Samples::new(vec![5.0; 30], vec![5.0; 30]).unwrap().compare();
        assert_eq!((equal.p, equal.larger, equal.shift.by, equal.shift.low), (1.0, 0.5, 0.0, 0.0));
    }

    /// The exact distribution and the approximation agree for samples of medium size.
    #[test]
    fn exact_and_approximate_agree() {
        for u in [100usize, 150, 200, 260] {
            let (n, m) = (20usize, 20usize);
            let away = (u as f64 - 200.0).abs() - 0.5;
            let z = away.max(0.0) / (n as f64 * m as f64 * 41.0 / 12.0).sqrt();
            close(exact(n, m, u), (2.0 * upper_tail(z)).min(1.0), 0.003);
        }
        assert_eq!(exact(1, 1, 0), 1.0);
        close(exact(3, 3, 0), 0.1, 1e-12);
    }

    /// Of 400 comparisons of equal distributions about 5 % are found to differ; a planted shift is found.
    #[test]
    fn false_findings_are_rare_and_shifts_are_found() {
        let mut random = Rng::named(1, "samples", 0);
        let mut draw = |n: usize, plus: u64| -> Vec<f64> {
            (0..n).map(|_| (random.below(1_000) + random.below(1_000) + plus) as f64).collect()
        };
        let (mut found, mut covered) = (0, 0);
        for _ in 0..400 {
            let compared = Samples::new(draw(40, 0), draw(40, 0)).unwrap().compare();
            found += u32::from(compared.p < 0.05);
            covered += u32::from(compared.shift.low <= 0.0 && 0.0 <= compared.shift.high);
        }
        assert!((6..=32).contains(&found), "{found} of 400");
        assert!((368..=394).contains(&covered), "{covered} of 400");
        let planted = Samples::new(draw(200, 0), draw(200, 300)).unwrap().compare();
        assert!(planted.p < 1e-6 && (200.0..400.0).contains(&planted.shift.by), "{planted:?}");
    }

    /// Holm's own order: the smallest times the number of tests, and never less than the one before.
    #[test]
    fn several_tests_are_adjusted() {
        let adjusted = holm(&[0.04, 0.01, 0.03, 0.5]);
        [0.09, 0.04, 0.09, 0.5].iter().zip(&adjusted).for_each(|(a, b)| close(*a, *b, 1e-12));
        assert_eq!(holm(&[]), Vec::<f64>::new());
        assert_eq!(holm(&[0.9, 0.8]), [1.0, 1.0]);
    }
}
