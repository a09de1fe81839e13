//! Inverse kinematics: joint angles for a pose of the head plate.
//!
//! [`solve`] finds all solutions of a module or metamodule from the structure of its chain
//! ([`paden_kahan`]); [`levenberg_marquardt`] finds one solution of any chain, as thesis 5.1.3
//! (level 1) does.

pub mod levenberg_marquardt;
pub mod paden_kahan;
mod single;

use super::chain::{Chain, Pose, joint_distance, wrapped};
use super::posture::Posture;
use super::{Kind, KinematicsError};
use nalgebra::{Matrix6, Vector6};
use thiserror::Error;

/// Joint angles in radians, brought into (−π, π], that put the head at the target.
#[derive(Clone, Debug, PartialEq)]
pub struct Solution {
    /// The angles from the foot on.
    pub q: Vec<f64>,
    /// The distance between the head and the target: length of the vector of cells and radians.
    pub residual: f64,
}

/// Why there are no joint angles for a pose.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum InverseError {
    /// The question itself is invalid.
    #[error(transparent)]
    Question(#[from] KinematicsError),
    /// Too far away for any posture.
    #[error(
        "out of reach: the last pivot would be {distance:.3} cells from the first, at most {limit} are possible"
    )]
    TooFar {
        /// Distance between the centres of the first and the last cube that the pose asks for.
        distance: f64,
        /// The longest possible one.
        limit: f64,
    },
    /// Near enough, but no posture has this position and orientation.
    #[error("out of reach: no posture of {kind} puts the head at the requested position and orientation")]
    Unreachable {
        /// The kind of robot.
        kind: Kind,
    },
}

/// Residual, in cells and radians, below which a candidate is a solution.
pub const ACCEPTED: f64 = 1e-9;
/// The largest number of solutions kept; a target that a whole curve of postures reaches has more.
const MOST: usize = 200;
/// Difference in radians, in every joint, below which two solutions are the same.
const SAME: f64 = 1e-6;
/// The largest distance of a matrix in a question from a rotation.
const RIGID: f64 = 1e-6;

/// Finds all postures of a module or metamodule that put the head at `target`.
///
/// If a whole curve of postures does, as happens on the lattice, some of its points are returned, among them
/// every lattice posture.
///
/// # Errors
/// Refuses a pose that is not rigid, and one that no posture reaches.
pub fn solve(kind: Kind, target: &Pose) -> Result<Vec<Solution>, InverseError> {
    target.checked(RIGID)?;
    let last = target.origin + target.rotation.column(2) * super::HALF_EDGE;
    let first = nalgebra::Vector3::new(0.0, 0.0, super::HALF_EDGE);
    let distance = (last - first).norm();
    let limit = (kind.cubes() - 1) as f64;
    if distance > limit + 1e-6 {
        return Err(InverseError::TooFar { distance, limit });
    }
    let mut found = Found::new(kind, target);
    // First, so that the exact angles replace those found near them.
    found.offer_lattice();
    if kind == Kind::Single {
        single::candidates(target, &mut |q| found.offer(q));
    } else {
        paden_kahan::candidates(kind, target, &mut |q| found.offer(q));
        // Straight first sections are ill-conditioned from the foot, straight last ones from the
        // head; the reversed robot is the same chain.
        paden_kahan::candidates(kind, &target.inverse(), &mut |mut q| {
            q.reverse();
            found.offer(q);
        });
    }
    let mut solutions = found.solutions;
    if solutions.is_empty() {
        return Err(InverseError::Unreachable { kind });
    }
    solutions.sort_by(|a, b| {
        let order = a.q.iter().zip(&b.q).map(|(x, y)| x.total_cmp(y));
        order.fold(std::cmp::Ordering::Equal, std::cmp::Ordering::then)
    });
    Ok(solutions)
}

/// Candidates, improved, checked and without duplicates.
struct Found<'a> {
    kind: Kind,
    chain: Chain,
    target: &'a Pose,
    solutions: Vec<Solution>,
}

impl<'a> Found<'a> {
    fn new(kind: Kind, target: &'a Pose) -> Found<'a> {
        Found { kind, chain: Chain::of(kind), target, solutions: Vec::new() }
    }

    fn offer(&mut self, q: Vec<f64>) {
        let near = |s: &Solution, q: &[f64]| joint_distance(&s.q, q) < SAME;
        if self.solutions.len() >= MOST || self.solutions.iter().any(|s| near(s, &q)) {
            return;
        }
        let Some(solution) = polished(&self.chain, self.target, q) else { return };
        if !self.solutions.iter().any(|s| near(s, &solution.q)) {
            self.solutions.push(solution);
        }
    }

    /// Offers the lattice postures that reach the target. They are enumerated, since most of them are singular.
    fn offer_lattice(&mut self) {
        /// Largest distance from the lattice, in half cells or as an entry of a rotation, at which a pose counts as
        /// on it.
        const ON_LATTICE: f64 = 1e-7;
        let twice = self.target.origin * 2.0;
        let Some(rotation) = super::lattice_pose::LatticeRotation::nearest(&self.target.rotation, ON_LATTICE)
        else {
            return;
        };
        if twice.iter().any(|x| (x - x.round()).abs() > ON_LATTICE || x.abs() > 100.0) {
            return;
        }
        let half = [0, 1, 2].map(|i| twice[i].round() as i16);
        for posture in Posture::all(self.kind) {
            let head = posture.placement().head;
            if head.rotation == rotation && head.half == half {
                self.offer(posture.radians());
            }
        }
    }
}

/// Improves a candidate by Newton's method, damped so little that it matters at singular postures only.
fn polished(chain: &Chain, target: &Pose, mut q: Vec<f64>) -> Option<Solution> {
    /// Factor of the damping.
    const DAMPING: f64 = 1e-13;
    /// Distance from the target, in cells and radians, at which the iteration stops.
    const GOOD: f64 = 1e-13;
    let mut best: Option<Solution> = None;
    for _ in 0..12 {
        let (head, columns) = chain.head_and_jacobian(&q);
        let error = head.error_to(target);
        let residual = error.norm();
        let better = best.as_ref().is_none_or(|b| residual < b.residual);
        if better {
            let angles = q.iter().map(|a| wrapped(*a)).collect();
            best = Some(Solution { q: angles, residual });
        }
        if !better || !(GOOD..=0.1).contains(&residual) {
            break;
        }
        let step = damped_step(&columns, &error, DAMPING)?;
        for (angle, d) in q.iter_mut().zip(step) {
            *angle += d;
        }
    }
    best.filter(|b| b.residual <= ACCEPTED)
}

/// Returns the joint step Jᵀ (J Jᵀ + λ)⁻¹ e of damped least squares; entries beyond the joints are zero.
fn damped_step(columns: &[Vector6<f64>], error: &Vector6<f64>, damping: f64) -> Option<Vec<f64>> {
    let mut gram = Matrix6::identity() * damping;
    for c in columns {
        gram += c * c.transpose();
    }
    let solved = gram.cholesky()?.solve(error);
    Some(columns.iter().map(|c| c.dot(&solved)).collect())
}
