//! Comparison of two samples, by the two-sample test of Kolmogorov and Smirnov, and the seeds of tests that draw them.
//!
//! For counts, where many values are equal, the test is conservative: it finds a difference too rarely rather
//! than too often.

use std::ops::Range;

/// Returns the seeds that the environment variable `METAMORPH_SEEDS` names, such as `20..40`, or else `default`.
///
/// # Panics
/// If the variable is not a range.
pub fn seeds_or(default: Range<u64>) -> Range<u64> {
    let Ok(text) = std::env::var("METAMORPH_SEEDS") else { return default };
    let range = text.split_once("..").and_then(|(from, until)| Some(from.parse().ok()?..until.parse().ok()?));
    range.unwrap_or_else(|| panic!("METAMORPH_SEEDS is `{text}`, not a range such as 20..40"))
}

/// Returns the largest distance between the two empirical distribution functions: 0 if the samples are the
/// same, 1 if they do not overlap.
pub fn kolmogorov_smirnov(a: &[u64], b: &[u64]) -> f64 {
    let share = |of: &[u64], at: u64| of.iter().filter(|v| **v <= at).count() as f64 / of.len().max(1) as f64;
    // The distance changes only at values of the samples.
    a.iter().chain(b).map(|at| (share(a, *at) - share(b, *at)).abs()).fold(0.0, f64::max)
}

/// Returns the distance that samples of these sizes from one distribution exceed with a probability of 1 %:
/// `sqrt(-ln(0.01 / 2) / 2) · sqrt((a + b) / (a · b))`, valid from a dozen values on.
pub fn critical_distance(a: usize, b: usize) -> f64 {
    let (a, b) = (a as f64, b as f64);
    (-(0.005f64.ln()) / 2.0).sqrt() * ((a + b) / (a * b)).sqrt()
}

/// Returns the mean; 0 for an empty sample.
pub fn mean(values: &[u64]) -> f64 {
    values.iter().sum::<u64>() as f64 / values.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: up to 2 there are 2/4 of the first sample and none of the second; up to 3, 3/4 and 1/5;
    /// up to 5, 4/4 and 2/5, which is the largest distance: 3/5.
    #[test]
    fn is_the_largest_distance_between_the_steps() {
        let (a, b) = ([1, 2, 3, 5], [3, 5, 6, 6, 9]);
        assert!((kolmogorov_smirnov(&a, &b) - 0.6).abs() < 1e-12);
        assert_eq!(kolmogorov_smirnov(&a, &b), kolmogorov_smirnov(&b, &a));
        assert_eq!(kolmogorov_smirnov(&a, &a), 0.0);
        assert_eq!(kolmogorov_smirnov(&[1, 2], &[3, 4]), 1.0);
        assert_eq!(mean(&a), 2.75);
    }

    /// The tables give 1.63 · sqrt((n + m) / (n · m)).
    #[test]
    fn the_critical_distance_is_that_of_the_tables() {
        assert!((critical_distance(50, 50) - 1.63 * 0.2).abs() < 1e-3);
        let same: Vec<u64> = (0..50).collect();
        let moved = |by: u64| -> Vec<u64> { same.iter().map(|v| v + by).collect() };
        assert!(kolmogorov_smirnov(&same, &moved(16)) < critical_distance(50, 50));
        assert!(kolmogorov_smirnov(&same, &moved(17)) > critical_distance(50, 50));
    }
}
