//! Statistics over many runs: intervals of rates, exact tests, spreads of values. Pure functions.

use metamorph_text::format::percent;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Number of standard deviations of a two-sided normal interval of 95 %.
pub(super) const Z95: f64 = 1.959_963_984_540_054;

/// A share of successes with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Rate {
    /// Successes divided by trials.
    pub rate: f64,
    /// The lower end of the interval.
    pub low: f64,
    /// The upper end of the interval.
    pub high: f64,
}

impl Rate {
    /// Computes the interval of Wilson (1927), without continuity correction. Unlike the normal approximation
    /// it is never empty and stays within 0 to 1, also without failures or without successes. `None` without
    /// trials.
    pub fn wilson(successes: u64, trials: u64) -> Option<Rate> {
        if trials == 0 {
            return None;
        }
        let (n, p, z2) = (trials as f64, successes as f64 / trials as f64, Z95 * Z95);
        let middle = p + z2 / (2.0 * n);
        let half = Z95 * (p * (1.0 - p) / n + z2 / (4.0 * n * n)).sqrt();
        let scale = 1.0 + z2 / n;
        // Rounding must not move an end away from the bound that it equals exactly.
        let low = if successes == 0 { 0.0 } else { (middle - half) / scale };
        let high = if successes == trials { 1.0 } else { (middle + half) / scale };
        Some(Rate { rate: p, low, high })
    }
}

/// Returns ln 0! to ln n!.
fn ln_factorials(n: u64) -> Vec<f64> {
    let mut sums = vec![0.0];
    for k in 1..=n {
        sums.push(sums[sums.len() - 1] + (k as f64).ln());
    }
    sums
}

/// Computes Fisher's exact test (two-sided) of two samples, each as successes and trials: the probability of
/// all tables with the same sums that are at most as probable as this one. `None` if a sample is empty.
pub fn fisher(a: (u64, u64), b: (u64, u64)) -> Option<f64> {
    let ((k, n), (other, others)) = (a, b);
    if n == 0 || others == 0 || k > n || other > others {
        return None;
    }
    let (all, successes) = (n + others, k + other);
    let ln = ln_factorials(all);
    let choose = |n: u64, k: u64| ln[n as usize] - ln[k as usize] - ln[(n - k) as usize];
    let probability = |k: u64| (choose(n, k) + choose(others, successes - k) - choose(all, successes)).exp();
    // Tables as probable as this one differ from it by rounding.
    let observed = probability(k) * (1.0 + 1e-7);
    let possible = successes.saturating_sub(others)..=n.min(successes);
    Some(possible.map(probability).filter(|p| *p <= observed).sum::<f64>().min(1.0))
}

/// Independent trials, and the probability of success to be tested.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observed {
    /// Successes.
    pub successes: u64,
    /// Trials.
    pub trials: u64,
    /// The probability of success.
    pub expected: f64,
}

impl Observed {
    /// Returns Pearson's X² for this number of successes.
    fn x2(self, successes: u64) -> f64 {
        let (n, p) = (self.trials as f64, self.expected);
        let away = successes as f64 - n * p;
        let variance = n * p * (1.0 - p);
        match away.abs() < 1e-9 {
            true => 0.0,
            false if variance > 0.0 => away * away / variance,
            false => f64::INFINITY,
        }
    }

    /// Returns X² and probability of each possible number of successes.
    fn results(self) -> Vec<(f64, f64)> {
        let (n, p) = (self.trials, self.expected.clamp(0.0, 1.0));
        let ln = ln_factorials(n);
        let probability = |k: u64| {
            let choose = (ln[n as usize] - ln[k as usize] - ln[(n - k) as usize]).exp();
            choose * p.powf(k as f64) * (1.0 - p).powf((n - k) as f64)
        };
        (0..=n).map(|k| (self.x2(k), probability(k))).filter(|(_, p)| *p > 0.0).collect()
    }
}

/// The deviation of results from their expectation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Discrepancy {
    /// Pearson's X² over all groups; infinite if something impossible was observed, and then null in JSON.
    pub x2: Option<f64>,
    /// The probability of an X² at least as large, over all possible results.
    pub p: f64,
}

impl Discrepancy {
    /// Enumerates all results of independent groups. Their number is the product of trials + 1 and has to be
    /// small: 11 million for the six groups of the thesis. `None` without groups.
    pub fn of(groups: &[Observed]) -> Option<Discrepancy> {
        if groups.is_empty() {
            return None;
        }
        let x2: f64 = groups.iter().map(|g| g.x2(g.successes)).sum();
        let results: Vec<Vec<(f64, f64)>> = groups.iter().map(|g| g.results()).collect();
        // Rounding must not separate equal results.
        let p = at_least(&results, x2 * (1.0 - 1e-9)).min(1.0);
        Some(Discrepancy { x2: Some(x2).filter(|x| x.is_finite()), p })
    }
}

/// Returns the probability that independent results sum to at least `bound`.
fn at_least(groups: &[Vec<(f64, f64)>], bound: f64) -> f64 {
    match groups {
        [] => f64::from(u8::from(bound <= 0.0)),
        [last] => last.iter().filter(|(x2, _)| *x2 >= bound).map(|(_, p)| p).sum(),
        [first, rest @ ..] => first.iter().map(|(x2, p)| p * at_least(rest, bound - x2)).sum(),
    }
}

/// The distribution of values.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Spread {
    /// Number of values.
    pub count: u64,
    /// Mean.
    pub mean: f64,
    /// Minimum.
    pub min: f64,
    /// 5 % quantile.
    pub p5: f64,
    /// First quartile.
    pub q1: f64,
    /// Median.
    pub median: f64,
    /// Third quartile.
    pub q3: f64,
    /// 95 % quantile.
    pub p95: f64,
    /// Maximum.
    pub max: f64,
}

impl Spread {
    /// Returns the spread of finite values; `None` without values. Sorts them first, so that the result does
    /// not depend on their order.
    pub fn of(values: &mut [f64]) -> Option<Spread> {
        values.sort_unstable_by(f64::total_cmp);
        let (min, max) = (*values.first()?, *values.last()?);
        let mean = values.iter().sum::<f64>() / values.len() as f64;
        let at = |q| quantile(values, q);
        Some(Spread {
            count: values.len() as u64,
            mean,
            min,
            p5: at(0.05),
            q1: at(0.25),
            median: at(0.5),
            q3: at(0.75),
            p95: at(0.95),
            max,
        })
    }
}

/// Growth of `y` with `x`: the exponent of the best-fitting power law, and how well it fits.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PowerLaw {
    /// The exponent.
    pub exponent: f64,
    /// The share of the variance of the logarithms that it explains.
    pub r_squared: f64,
}

impl PowerLaw {
    /// Fits a least-squares line through the logarithms; `None` for fewer than three points.
    pub fn of(points: &[(f64, f64)]) -> Option<PowerLaw> {
        let logs: Vec<(f64, f64)> =
            points.iter().filter(|(x, y)| *x > 0.0 && *y > 0.0).map(|(x, y)| (x.ln(), y.ln())).collect();
        if logs.len() < 3 {
            return None;
        }
        let n = logs.len() as f64;
        let mean = |f: fn(&(f64, f64)) -> f64| logs.iter().map(f).sum::<f64>() / n;
        let (mx, my) = (mean(|p| p.0), mean(|p| p.1));
        let sum = |f: &dyn Fn(f64, f64) -> f64| logs.iter().map(|(x, y)| f(x - mx, y - my)).sum::<f64>();
        let (xx, xy, yy) = (sum(&|x, _| x * x), sum(&|x, y| x * y), sum(&|_, y| y * y));
        if xx == 0.0 || yy == 0.0 {
            return None;
        }
        Some(PowerLaw { exponent: xy / xx, r_squared: xy * xy / (xx * yy) })
    }
}

/// Returns the quantile of sorted values by linear interpolation: type 7 of Hyndman and Fan (1996), the
/// default of R and NumPy. `sorted` must not be empty.
pub fn quantile(sorted: &[f64], q: f64) -> f64 {
    let at = q * (sorted.len() - 1) as f64;
    let below = at.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (at - below as f64) * (sorted[above] - sorted[below])
}

/// Formats a rate and its interval, in percent.
pub fn rate(rate: Option<Rate>) -> (String, String) {
    match rate {
        Some(r) => (percent(r.rate), format!("{} to {}", percent(r.low), percent(r.high))),
        None => ("–".to_owned(), "–".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_power_law_is_found() {
        let points: Vec<(f64, f64)> =
            [10.0, 100.0, 500.0].iter().map(|x: &f64| (*x, 3.0 * x.powf(1.5))).collect();
        let found = PowerLaw::of(&points).unwrap();
        assert!((found.exponent - 1.5).abs() < 1e-9 && (found.r_squared - 1.0).abs() < 1e-9);
        assert_eq!(PowerLaw::of(&points[..2]), None);
        assert_eq!(PowerLaw::of(&[(1.0, 1.0); 5]), None);
    }

    fn close(a: f64, b: f64, tolerance: f64) {
        assert!((a - b).abs() <= tolerance, "{a} is not {b}");
    }

    /// Newcombe, "Two-sided confidence intervals for the single proportion", Statistics in Medicine 17
    /// (1998), table I, method 3.
    #[test]
    fn wilson_intervals_are_the_published_ones() {
        for (successes, trials, low, high) in [
            (81, 263, 0.2553, 0.3662),
            (15, 148, 0.0624, 0.1605),
            (0, 20, 0.0, 0.1611),
            (1, 29, 0.0061, 0.1718),
        ] {
            let rate = Rate::wilson(successes, trials).unwrap();
            close(rate.low, low, 0.000_05);
            close(rate.high, high, 0.000_05);
            close(rate.rate, successes as f64 / trials as f64, 0.0);
            // Failures are the mirror image of successes.
            let mirror = Rate::wilson(trials - successes, trials).unwrap();
            close(mirror.low, 1.0 - rate.high, 1e-12);
            close(mirror.high, 1.0 - rate.low, 1e-12);
        }
    }

    /// Fisher's lady tasting tea, 3 of 4 against 1 of 4: 0.4857; and the published example of R's
    /// `fisher.test`, 10 of 12 against 2 of 17 twins of convicts: 0.0005367.
    #[test]
    fn fishers_test_gives_the_published_values() {
        close(fisher((3, 4), (1, 4)).unwrap(), 0.485_714, 1e-6);
        close(fisher((10, 13), (2, 17)).unwrap(), 0.000_536_724, 1e-8);
        close(fisher((2, 17), (10, 13)).unwrap(), 0.000_536_724, 1e-8);
        assert_eq!((fisher((0, 0), (1, 2)), fisher((5, 5), (9, 9))), (None, Some(1.0)));
        // A sample as large as those of `reproduce`.
        let p = fisher((4, 12), (7_920, 12_000)).unwrap();
        assert!((0.02..0.04).contains(&p), "{p}");
    }

    /// A fair coin: 0, 1, 5 or 6 of 6 are 14 of 64 results. Two coins: by enumeration.
    #[test]
    fn discrepancies_count_every_possible_result() {
        let coin = |successes, trials| Observed { successes, trials, expected: 0.5 };
        let one = Discrepancy::of(&[coin(1, 6)]).unwrap();
        close(one.p, 14.0 / 64.0, 1e-12);
        close(one.x2.unwrap(), 4.0 / 1.5, 1e-12);
        // (k - 3)² / 1.5 + (j - 1)² / 0.5 of at least 4 / 1.5: all but j = 1 with 2 to 4 of 6.
        let two = Discrepancy::of(&[coin(1, 6), coin(1, 2)]).unwrap();
        let excluded = [(2, 1), (3, 1), (4, 1), (3, 0), (3, 2)];
        let ways =
            |k: u64, j: u64| [1.0, 6.0, 15.0, 20.0, 15.0, 6.0, 1.0][k as usize] * [1.0, 2.0, 1.0][j as usize];
        let less: f64 = excluded.into_iter().map(|(k, j)| ways(k, j)).sum();
        close(two.p, 1.0 - less / 256.0, 1e-12);
        let impossible = Observed { successes: 1, trials: 3, expected: 0.0 };
        assert_eq!(Discrepancy::of(&[impossible]), Some(Discrepancy { x2: None, p: 0.0 }));
        assert_eq!(Discrepancy::of(&[]), None);
    }

    /// Without failures the lower end is n / (n + z²): 1 / (1 + 3.8415) for a single success.
    #[test]
    fn wilson_intervals_touch_their_bounds() {
        let one = Rate::wilson(1, 1).unwrap();
        close(one.low, 0.206_549, 1e-6);
        assert_eq!((one.rate, one.high), (1.0, 1.0));
        assert_eq!(Rate::wilson(0, 1_000_000).unwrap().low, 0.0);
        assert_eq!(Rate::wilson(0, 0), None);
    }

    /// The example of NumPy's and R's documentation of type 7, and one by hand: between 1 and 9 in five
    /// values, the 95 % quantile lies 0.8 of the way from the fourth to the fifth.
    #[test]
    fn quantiles_interpolate() {
        let spread = Spread::of(&mut [9.0, 1.0, 3.0, 7.0, 5.0]).unwrap();
        assert_eq!((spread.count, spread.mean, spread.median), (5, 5.0, 5.0));
        assert_eq!((spread.min, spread.q1, spread.q3, spread.max), (1.0, 3.0, 7.0, 9.0));
        close(spread.p95, 8.6, 1e-12);
        close(spread.p5, 1.4, 1e-12);
        let even = Spread::of(&mut [4.0, 1.0, 3.0, 2.0]).unwrap();
        assert_eq!((even.median, even.q1, even.q3), (2.5, 1.75, 3.25));
        let one = Spread::of(&mut [2.5]).unwrap();
        assert_eq!((one.p5, one.median, one.p95), (2.5, 2.5, 2.5));
        assert_eq!(Spread::of(&mut []), None);
    }
}
