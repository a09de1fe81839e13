//! Gaussian process regression with a Matérn kernel (5/2): what some values of a function tell about all others.
//!
//! Rasmussen and Williams, "Gaussian processes for machine learning", 2006, algorithm 2.1.

use super::ask_tell::Point;
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use std::f64::consts::TAU;

/// Variance of a value about the function, as a ratio to the variance of the function.
const NOISE: f64 = 0.01;

/// A function with mean 0 and variance 1, as far as it is known.
pub struct Process {
    points: Vec<Point>,
    length: f64,
    factor: Cholesky<f64, Dyn>,
    weights: DVector<f64>,
    likelihood: f64,
}

/// Returns how much two points of this distance have in common.
fn kernel(distance: f64, length: f64) -> f64 {
    let d = 5.0_f64.sqrt() * distance / length;
    (1.0 + d + d * d / 3.0) * libm::exp(-d)
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt()
}

impl Process {
    /// Learns the values at some points; `length` is the distance in which the function changes.
    pub fn new(points: Vec<Point>, values: &[f64], length: f64) -> Process {
        let n = points.len();
        let covariance = DMatrix::from_fn(n, n, |i, j| {
            kernel(distance(&points[i], &points[j]), length) + if i == j { NOISE } else { 0.0 }
        });
        // Invariant: the kernel is positive definite, and the noise outweighs rounding.
        let factor = Cholesky::new(covariance).expect("a covariance with noise has a factor");
        let values = DVector::from_column_slice(values);
        let weights = factor.solve(&values);
        let determinant: f64 = factor.l_dirty().diagonal().iter().map(|x| libm::log(*x)).sum();
        let likelihood = -0.5 * values.dot(&weights) - determinant - 0.5 * n as f64 * libm::log(TAU);
        Process { points, length, factor, weights, likelihood }
    }

    /// Learns the values with the one of some lengths that explains them best.
    pub fn of_best_length(points: &[Point], values: &[f64], lengths: &[f64]) -> Process {
        let all = lengths.iter().map(|length| Process::new(points.to_vec(), values, *length));
        let best = all.reduce(|a, b| if b.likelihood > a.likelihood { b } else { a });
        best.unwrap_or_else(|| Process::new(points.to_vec(), values, 1.0))
    }

    /// Returns the mean and the standard deviation of the function at a point.
    pub fn predict(&self, at: &[f64]) -> (f64, f64) {
        let near = self.points.iter().map(|point| kernel(distance(point, at), self.length));
        let near = DVector::from_iterator(self.points.len(), near);
        let mean = near.dot(&self.weights);
        let explained = near.dot(&self.factor.solve(&near));
        (mean, (1.0 - explained).max(0.0).sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points(n: usize) -> Vec<Point> {
        (0..n).map(|i| vec![i as f64 / (n - 1) as f64]).collect()
    }

    #[test]
    fn values_are_known_where_they_were_told_and_unknown_far_away() {
        let at = points(9);
        let values: Vec<f64> = at.iter().map(|p| libm::sin(TAU * p[0])).collect();
        let process = Process::new(at.clone(), &values, 0.3);
        for (point, value) in at.iter().zip(&values) {
            let (mean, spread) = process.predict(point);
            assert!((mean - value).abs() < 0.05 && spread < 0.12, "{point:?}: {mean} {spread}, not {value}");
        }
        let (between, _) = process.predict(&[0.4375]);
        assert!((between - libm::sin(TAU * 0.4375)).abs() < 0.05, "{between}");
        let (mean, spread) = process.predict(&[9.0]);
        assert!(mean.abs() < 1e-6 && (spread - 1.0).abs() < 1e-6, "{mean} {spread}");
    }

    /// A fast function has a short length, a slow one a long one.
    #[test]
    fn the_length_follows_the_function() {
        let at = points(25);
        let length = |periods: f64| {
            let values: Vec<f64> = at.iter().map(|p| libm::sin(TAU * periods * p[0])).collect();
            Process::of_best_length(&at, &values, &[0.05, 0.1, 0.3, 1.0]).length
        };
        assert!(length(5.0) < length(0.7), "{} {}", length(5.0), length(0.7));
    }

    #[test]
    fn nothing_told_is_nothing_known() {
        let process = Process::of_best_length(&[], &[], &[0.3]);
        assert_eq!(process.predict(&[0.5]), (0.0, 1.0));
    }
}
