//! The exact body of a cube: a ball cut by the six planes of its plates.
//!
//! A cube of a module is two hemispheres that turn against each other about a body diagonal. The
//! circle in which a plate cuts the ball lies on one side of the plane between the hemispheres, so
//! at any joint angle the cube is the ball cut by the three planes of either hemisphere: convex.

use super::chain::{Pose, hemispheres};
use super::convex::Convex;
use super::{HALF_EDGE, Kind, KinematicsError, OUTER_RADIUS};
use nalgebra::Vector3;

/// A cube of a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Body {
    /// The centre, in cells.
    pub centre: Vector3<f64>,
    /// The outward normals of the six plates.
    pub normals: [Vector3<f64>; 6],
    /// 1, or less for a body shrunk towards its centre.
    pub scale: f64,
}

impl Body {
    /// Returns the cube made of a lower hemisphere (H0, H2) and an upper one (H1, H3).
    pub fn of_hemispheres(lower: &Pose, upper: &Pose) -> Body {
        let column = |p: &Pose, i: usize| -> Vector3<f64> { p.rotation.column(i).into() };
        let normals = [
            -column(lower, 0),
            -column(lower, 1),
            -column(lower, 2),
            column(upper, 0),
            column(upper, 1),
            column(upper, 2),
        ];
        Body { centre: lower.origin, normals, scale: 1.0 }
    }

    /// Returns a cube that fills a cell of the lattice; the twist of its halves has no effect.
    pub fn aligned(centre: Vector3<f64>) -> Body {
        let [x, y, z] = [Vector3::x(), Vector3::y(), Vector3::z()];
        Body { centre, normals: [-x, -y, -z, x, y, z], scale: 1.0 }
    }

    /// Returns the same body shrunk towards its centre.
    pub fn scaled(mut self, scale: f64) -> Body {
        self.scale = scale;
        self
    }

    /// Returns how far the body reaches from its centre in a unit direction.
    pub fn extent(&self, u: &Vector3<f64>) -> f64 {
        let cosine = self.normals.iter().map(|n| n.dot(u)).fold(f64::MIN, f64::max);
        let flat = HALF_EDGE / OUTER_RADIUS;
        let reach = if cosine <= flat {
            OUTER_RADIUS
        } else {
            HALF_EDGE * cosine + plate_radius() * (1.0 - cosine * cosine).max(0.0).sqrt()
        };
        reach * self.scale
    }

    /// Returns the height of the lowest point of the body.
    pub fn lowest(&self) -> f64 {
        self.centre.z - self.extent(&-Vector3::z())
    }
}

/// Returns the radius of the flat circular plates in cells: 32.68 mm.
pub fn plate_radius() -> f64 {
    (OUTER_RADIUS * OUTER_RADIUS - HALF_EDGE * HALF_EDGE).sqrt()
}

impl Convex for Body {
    fn support(&self, direction: &Vector3<f64>) -> Vector3<f64> {
        let u = direction.normalize();
        // The circles of neighbouring plates never meet, so at most one plate cuts off u.
        let mut best = self.normals[0];
        let mut cosine = best.dot(&u);
        for n in &self.normals[1..] {
            let c = n.dot(&u);
            if c > cosine {
                (best, cosine) = (*n, c);
            }
        }
        let from_centre = if cosine * OUTER_RADIUS <= HALF_EDGE {
            u * OUTER_RADIUS
        } else {
            let side = u - best * cosine;
            let length = side.norm();
            let rim = if length > 1e-12 { side * (plate_radius() / length) } else { Vector3::zeros() };
            best * HALF_EDGE + rim
        };
        self.centre + from_centre * self.scale
    }
    fn centre(&self) -> Vector3<f64> {
        self.centre
    }
}

/// Returns the bodies of all cubes of a robot, angles in radians.
pub fn bodies(kind: Kind, q: &[f64]) -> Result<Vec<Body>, KinematicsError> {
    let all = hemispheres(kind, q)?;
    Ok(all.chunks_exact(2).map(|h| Body::of_hemispheres(&h[0], &h[1])).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reaches_are_those_of_the_rounded_cube() {
        let body = Body::aligned(Vector3::zeros());
        let corner = Vector3::repeat(1.0).normalize();
        let edge = Vector3::new(1.0, 1.0, 0.0).normalize();
        assert!((body.extent(&Vector3::x()) - 0.5).abs() < 1e-12);
        assert!((body.extent(&corner) - OUTER_RADIUS).abs() < 1e-12);
        assert!((body.extent(&edge) - OUTER_RADIUS).abs() < 1e-12);
        assert!((plate_radius() * 110.0 - 32.68).abs() < 0.01);
        // The support point and the extent agree everywhere.
        for i in 0..500 {
            let t = f64::from(i);
            let u = Vector3::new((t * 0.37).sin(), (t * 0.91).cos(), (t * 0.53).sin() + 0.1).normalize();
            assert!((body.support(&u).dot(&u) - body.extent(&u)).abs() < 1e-12);
        }
    }

    /// The plate circles of the two halves stay apart at every angle of the joint between them.
    #[test]
    fn plates_never_meet() {
        for degree in 0..360 {
            let q = [f64::from(degree).to_radians(), 0.0, 0.0];
            let n = bodies(Kind::Single, &q).unwrap()[0].normals;
            let twice = 2.0 * (HALF_EDGE / OUTER_RADIUS).acos();
            for (i, a) in n.iter().enumerate() {
                assert!(n[i + 1..].iter().all(|b| a.dot(b).clamp(-1.0, 1.0).acos() > twice));
            }
        }
    }
}
