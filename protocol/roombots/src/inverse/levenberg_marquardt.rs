//! Damped least squares for any chain: one solution near a start, as thesis 5.1.3 (level 1) uses.
//!
//! Incomplete by nature: from a random start about three of four targets of a metamodule are found.

use super::damped_step;
use crate::chain::{Chain, Pose, random_angle, wrapped};
use metamorph_core::rng::Rng;
use nalgebra::{Matrix3x6, Matrix6, Vector3, Vector6};
use std::f64::consts::PI;

/// The conditions to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// The largest number of steps tried, accepted or not.
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

/// The end of a search.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// The best angles found, brought into (−π, π].
    pub q: Vec<f64>,
    /// The distance between the head and the target.
    pub residual: f64,
    /// The number of steps tried.
    pub iterations: u32,
    /// True if the residual is within the tolerance. If not, this start does not lead to the target; the
    /// target may be out of reach, or another start may lead to it.
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
        // Beyond a quarter turn the linear model is meaningless.
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

/// Applies damped least squares with constant damping and full steps, from four points of the head (its
/// origin and points half a cell along its axes) to their targets: 50 steps, damping 0.01. This is the plain
/// form in dynamics libraries, such as the one that thesis 5.1.3 names. It reaches fewer targets than
/// [`solve`] and is here for comparisons with the thesis.
pub fn solve_plainly(chain: &Chain, target: &Pose, start: &[f64]) -> Outcome {
    const STEPS: u32 = 50;
    /// Factor of the damping.
    const DAMPING: f64 = 0.01;
    /// Largest distance from the target, in cells and radians, at which it counts as reached.
    const REACHED: f64 = 1e-3;
    /// Distance from the target, in cells and radians, at which the iteration stops.
    const DONE: f64 = 1e-9;
    let points = |p: &Pose| -> [Vector3<f64>; 4] {
        [0, 1, 2, 3].map(|i| if i == 0 { p.origin } else { p.origin + p.rotation.column(i - 1) * 0.5 })
    };
    let goals = points(target);
    let mut q = start.to_vec();
    let mut iterations = 0;
    let mut residual = f64::MAX;
    while iterations < STEPS && residual > DONE {
        iterations += 1;
        let (head, columns) = chain.head_and_jacobian(&q);
        // In the six coordinates of the head's motion the points weigh position and rotation:
        // JᵀJ of the points is Cᵀ W C with the columns C, and W gathers the four points.
        let (mut weight, mut pull) = (Matrix6::zeros(), Vector6::zeros());
        for (point, goal) in points(&head).iter().zip(&goals) {
            let across = -(point - head.origin).cross_matrix();
            let mut move_point = Matrix3x6::zeros();
            move_point.fixed_view_mut::<3, 3>(0, 0).fill_with_identity();
            move_point.fixed_view_mut::<3, 3>(0, 3).copy_from(&across);
            weight += move_point.transpose() * move_point;
            pull += move_point.transpose() * (goal - point);
        }
        let Some(step) = weighted_step(&columns, &weight, &pull, DAMPING * DAMPING) else { break };
        for (angle, d) in q.iter_mut().zip(&step) {
            *angle += d;
        }
        residual = chain.head(&q).error_to(target).norm();
    }
    Outcome { q: q.into_iter().map(wrapped).collect(), residual, iterations, reached: residual <= REACHED }
}

/// Returns (Cᵀ W C + λ)⁻¹ Cᵀ p as Cᵀ (λ + W C Cᵀ)⁻¹ p.
fn weighted_step(
    columns: &[Vector6<f64>],
    weight: &Matrix6<f64>,
    pull: &Vector6<f64>,
    damping: f64,
) -> Option<Vec<f64>> {
    let gram: Matrix6<f64> = columns.iter().map(|c| c * c.transpose()).sum();
    let solved = (Matrix6::identity() * damping + weight * gram).lu().solve(pull)?;
    Some(columns.iter().map(|c| c.dot(&solved)).collect())
}

/// Tries random starts, all drawn from `rng`, until one leads to the target; returns the best outcome
/// otherwise.
pub fn solve_from_random_starts(
    chain: &Chain,
    target: &Pose,
    starts: u32,
    rng: &mut Rng,
    options: &Options,
) -> Outcome {
    let mut best: Option<Outcome> = None;
    for _ in 0..starts.max(1) {
        let start: Vec<f64> = chain.joints.iter().map(|_| random_angle(rng)).collect();
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
