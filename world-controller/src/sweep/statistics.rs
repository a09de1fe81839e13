//! Numbers about many runs: intervals of rates and the spread of counts. Plain functions of numbers.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The normal quantile of a two-sided interval of 95 %.
const Z95: f64 = 1.959_963_984_540_054;

/// A share of successes with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Rate {
    /// Successes by trials.
    pub rate: f64,
    /// The lower end of the interval.
    pub low: f64,
    /// The upper end of the interval.
    pub high: f64,
}

impl Rate {
    /// The interval of Wilson (1927), without continuity correction. Unlike the interval around the
    /// rate itself it is never empty and never leaves 0 to 1, also for no or only successes. None
    /// without trials.
    pub fn wilson(successes: u64, trials: u64) -> Option<Rate> {
        if trials == 0 {
            return None;
        }
        let (n, p, z2) = (trials as f64, successes as f64 / trials as f64, Z95 * Z95);
        let middle = p + z2 / (2.0 * n);
        let half = Z95 * (p * (1.0 - p) / n + z2 / (4.0 * n * n)).sqrt();
        let scale = 1.0 + z2 / n;
        // Rounding must not move an end off the bound that it touches exactly.
        let low = if successes == 0 { 0.0 } else { (middle - half) / scale };
        let high = if successes == trials { 1.0 } else { (middle + half) / scale };
        Some(Rate { rate: p, low, high })
    }
}

/// How values are spread.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Spread {
    /// How many values.
    pub count: u64,
    /// Their mean.
    pub mean: f64,
    /// The smallest.
    pub min: f64,
    /// Below this are 5 %.
    pub p5: f64,
    /// Below this is a quarter.
    pub q1: f64,
    /// Below this is half.
    pub median: f64,
    /// Below this are three quarters.
    pub q3: f64,
    /// Below this are 95 %.
    pub p95: f64,
    /// The largest.
    pub max: f64,
}

impl Spread {
    /// The spread of finite values; none without values. Sorts them first, so that the result does
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

/// The quantile of sorted values by linear interpolation: type 7 of Hyndman and Fan (1996), which is
/// what R and NumPy do unless told otherwise. Not empty.
fn quantile(sorted: &[f64], q: f64) -> f64 {
    let at = q * (sorted.len() - 1) as f64;
    let below = at.floor() as usize;
    let above = (below + 1).min(sorted.len() - 1);
    sorted[below] + (at - below as f64) * (sorted[above] - sorted[below])
}

#[cfg(test)]
mod tests {
    use super::*;

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
            // What fails is the mirror image of what succeeds.
            let mirror = Rate::wilson(trials - successes, trials).unwrap();
            close(mirror.low, 1.0 - rate.high, 1e-12);
            close(mirror.high, 1.0 - rate.low, 1e-12);
        }
    }

    /// With nothing but successes the lower end is n / (n + z²): 1 / (1 + 3.8415) for a single one.
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
