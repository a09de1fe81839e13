//! The sphere model of thesis 5.1.4: fast and coarse, for comparison with the thesis.
//!
//! A hemisphere is one sphere tangent to its plates and small spheres of 9 mm diameter on its ribs, tangent
//! from inside to the sphere of 128 mm diameter around the cube. The thesis gives the main sphere a
//! *diameter* of 0.055 m; tangent to the plates it must have that *radius*, which is used here. The positions
//! of the small spheres along a rib are in a figure only (figure 5.6) and are a convention here: evenly from
//! one end of the rib to the other.

use super::collision::distant_pairs;
use super::{CELL_METRES, HALF_EDGE, Kind, KinematicsError, OUTER_RADIUS, chain};
use nalgebra::Vector3;

/// Radius of the small spheres in cells.
const RIB_RADIUS: f64 = 0.0045 / CELL_METRES;
/// Overlap in cells below which spheres only touch: 0.2 mm.
const TOLERANCE: f64 = 0.0002 / CELL_METRES;

/// A sphere of the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sphere {
    /// Its centre, in cells.
    pub centre: Vector3<f64>,
    /// Its radius, in cells.
    pub radius: f64,
}

/// Returns the spheres of every cube of a robot, with `per_rib` small ones on each of the three ribs of a
/// hemisphere (the thesis has five).
pub fn spheres(kind: Kind, q: &[f64], per_rib: u32) -> Result<Vec<Vec<Sphere>>, KinematicsError> {
    let hemispheres = chain::hemispheres(kind, q)?;
    let cubes = hemispheres.chunks_exact(2).map(|halves| {
        let mut all = vec![Sphere { centre: halves[0].origin, radius: HALF_EDGE }];
        for (half, side) in halves.iter().zip([-1.0, 1.0]) {
            for direction in rib_directions(per_rib) {
                let out = half.rotation * direction * (side * (OUTER_RADIUS - RIB_RADIUS));
                all.push(Sphere { centre: half.origin + out, radius: RIB_RADIUS });
            }
        }
        all
    });
    Ok(cubes.collect())
}

/// Returns the directions of the spheres on the ribs of an upper hemisphere: each rib lies between two
/// plates.
fn rib_directions(per_rib: u32) -> Vec<Vector3<f64>> {
    // A rib runs from the corner (1,1,1) to the corner (1,1,−1): 35.26° to either side.
    let half_length = (1.0 / 3f64.sqrt()).asin();
    let mut all = Vec::new();
    for rib in 0..3 {
        for i in 0..per_rib {
            let share = if per_rib > 1 { f64::from(2 * i) / f64::from(per_rib - 1) - 1.0 } else { 0.0 };
            let (s, c) = (share * half_length).sin_cos();
            let mut v = Vector3::repeat(c * std::f64::consts::FRAC_1_SQRT_2);
            v[rib] = s;
            all.push(v);
        }
    }
    all
}

/// Returns true if spheres of cubes that are not neighbours overlap.
pub fn self_collision(cubes: &[Vec<Sphere>]) -> bool {
    distant_pairs(cubes.len()).any(|(a, b)| {
        let apart = (cubes[a][0].centre - cubes[b][0].centre).norm();
        apart < 2.0 * OUTER_RADIUS
            && cubes[a].iter().any(|s| {
                let overlaps = |t: &Sphere| {
                    let reach = s.radius + t.radius - TOLERANCE;
                    (s.centre - t.centre).norm_squared() < reach * reach
                };
                cubes[b].iter().any(overlaps)
            })
    })
}

/// Returns true if a sphere is below the floor.
pub fn floor_collision(cubes: &[Vec<Sphere>]) -> bool {
    cubes.iter().flatten().any(|s| s.centre.z - s.radius < -TOLERANCE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spheres_are_tangent_to_plates_and_outer_sphere() {
        let all = spheres(Kind::Per, &[0.3, 0.2, -0.4, 1.0, 2.0, 3.0], 5).unwrap();
        assert_eq!(all.iter().map(Vec::len).collect::<Vec<_>>(), [31; 4]);
        for cube in all {
            let centre = cube[0].centre;
            for s in &cube[1..] {
                // 59.5 mm from the centre, as half of 128 mm less half of 9 mm.
                assert!(((s.centre - centre).norm() * 110.0 - 59.5).abs() < 0.03);
                assert!((s.radius * 110.0 - 4.5).abs() < 1e-12);
            }
        }
    }

    #[test]
    fn a_straight_robot_touches_nothing() {
        let all = spheres(Kind::Par, &[0.0; 6], 5).unwrap();
        assert!(!self_collision(&all) && !floor_collision(&all));
        let folded: Vec<f64> = [120.0, 0.0, 120.0, 120.0, 0.0, 120.0].map(f64::to_radians).into();
        let all = spheres(Kind::Par, &folded, 5).unwrap();
        assert!(floor_collision(&all) || !self_collision(&all));
    }
}
