//! Collision checks of a posture: exact bodies against each other and against the floor z = 0.

use super::body::{Body, bodies};
use super::convex::overlap;
use super::{Kind, KinematicsError, OUTER_RADIUS};

/// Scale of bodies in comparisons: both are shrunk by 1 %, so that flush plates and contacts below 1.3 mm do
/// not count; the connectors tolerate 4 mm (thesis 2.2.1).
pub const SHRINK: f64 = 0.99;

/// Iterates over the pairs of cubes that are not direct neighbours in the chain.
pub fn distant_pairs(cubes: usize) -> impl Iterator<Item = (usize, usize)> {
    (0..cubes).flat_map(move |a| (a + 2..cubes).map(move |b| (a, b)))
}

/// Returns true if two cubes overlap after both are shrunk.
pub fn cubes_collide(a: &Body, b: &Body, shrink: f64) -> bool {
    (a.centre - b.centre).norm() < 2.0 * OUTER_RADIUS * shrink
        && overlap(&a.scaled(shrink), &b.scaled(shrink))
}

/// Returns how deep two cubes overlap, in cells, measured by how far both must shrink to come apart.
pub fn overlap_depth(a: &Body, b: &Body) -> f64 {
    let (mut apart, mut together) = (0.5, 1.0);
    if !cubes_collide(a, b, together) {
        return 0.0;
    }
    while together - apart > 1e-5 {
        let middle = (apart + together) / 2.0;
        if cubes_collide(a, b, middle) { together = middle } else { apart = middle }
    }
    (1.0 - together) * 2.0 * OUTER_RADIUS
}

/// Returns true if cubes of a robot that are not neighbours overlap.
pub fn self_collision(bodies: &[Body], shrink: f64) -> bool {
    distant_pairs(bodies.len()).any(|(a, b)| cubes_collide(&bodies[a], &bodies[b], shrink))
}

/// The contacts of a posture with any angles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Depth of the lowest cube below the floor, in cells; negative if all are above.
    pub floor: f64,
    /// True if two cubes that are not neighbours overlap.
    pub own_body: bool,
}

/// Finds the contacts of a posture.
pub fn contact(kind: Kind, q: &[f64]) -> Result<Contact, KinematicsError> {
    let bodies = bodies(kind, q)?;
    let floor = bodies.iter().map(|b| -b.lowest()).fold(f64::MIN, f64::max);
    Ok(Contact { floor, own_body: self_collision(&bodies, SHRINK) })
}
