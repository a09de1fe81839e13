//! Damped least squares for any chain: one solution near a start, as thesis 5.1.3 (level 1) uses.
//!
//! Incomplete by nature: from a random start about three of four targets of a metamodule are found.

use super::damped_step;
use crate::roombots::chain::{Chain, Pose, random_angle, wrapped};
use crate::stream::Stream;
use std::f64::consts::PI;

/// When to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Steps tried at most, accepted or not.
    pub iterations: u32,
    /// Residual at which the target counts as reached, in cells and radians.
    pub tolerance: f64,
    /// The first damping; it is lowered after a good step and raised after a bad one.
    pub damping: f64,
}

impl Default for Options {
    fn default() -> Options {
        Options { iterations: 100, tolerance: 1e-9, damping: 1e-2 }
    }
}

/// Where the search ended.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// The best angles found, brought into (−π, π].
    pub q: Vec<f64>,
    /// What is left between the head and the target.
    pub residual: f64,
    /// Steps tried.
    pub iterations: u32,
    /// Whether the residual is within the tolerance. If not, this start does not lead to the
    /// target; the target may be out of reach or another start may do.
    pub reached: bool,
}

/// Improves the angles from `start` on; missing start angles count as zero.
pub fn solve(chain: &Chain, target: &Pose, start: &[f64], options: &Options) -> Outcome {
    let finite = |a: &f64| if a.is_finite() { *a } else { 0.0 };
    let mut q: Vec<f64> =
        start.iter().map(finite).chain(std::iter::repeat(0.0)).take(chain.joints.len()).collect();
    let mut damping = options.damping;
    let (head, mut columns) = chain.head_and_jacobian(&q);
    let mut error = head.error_to(target);
    let mut residual = error.norm();
    let mut iterations = 0;
    while iterations < options.iterations && residual > options.tolerance {
        iterations += 1;
        let Some(step) = damped_step(&columns, &error, damping) else { break };
        // More than a quarter turn at once is beyond what the linear model says anything about.
        let largest = step.iter().fold(0.0f64, |m, s| m.max(s.abs()));
        let shorten = if largest > PI / 2.0 { PI / 2.0 / largest } else { 1.0 };
        let next: Vec<f64> = q.iter().zip(&step).map(|(a, s)| a + s * shorten).collect();
        let (next_head, next_columns) = chain.head_and_jacobian(&next);
        let next_error = next_head.error_to(target);
        let next_residual = next_error.norm();
        if next_residual < residual {
            (q, columns, error, residual) = (next, next_columns, next_error, next_residual);
            damping = (damping / 5.0).max(1e-14);
        } else {
            damping *= 4.0;
            if damping > 1e6 {
                break;
            }
        }
    }
    let reached = residual <= options.tolerance;
    Outcome { q: q.into_iter().map(wrapped).collect(), residual, iterations, reached }
}

/// Tries random starts, all drawn from `stream`, until one leads to the target; the best outcome
/// otherwise.
pub fn solve_from_random_starts(
    chain: &Chain,
    target: &Pose,
    starts: u32,
    stream: &mut Stream,
    options: &Options,
) -> Outcome {
    let mut best: Option<Outcome> = None;
    for _ in 0..starts.max(1) {
        let start: Vec<f64> = chain.joints.iter().map(|_| random_angle(stream)).collect();
        let outcome = solve(chain, target, &start, options);
        if best.as_ref().is_none_or(|b| outcome.residual < b.residual) {
            best = Some(outcome);
        }
        if best.as_ref().is_some_and(|b| b.reached) {
            break;
        }
    }
    best.expect("at least one start is tried")
}
