//! The convex hull of a hemisphere of a module, as points: half of a ball cut by the plates of a cube.

use metamorph_protocol::roombots::{CELL_METRES, HALF_EDGE, OUTER_RADIUS};

/// Number of points on the rim of a plate.
const RIM: usize = 8;
/// Number of points on the cut between the two hemispheres of a cube.
const CUT: usize = 12;

/// Cosines and sines of multiples of 30 degrees from 0 to 90, which make those of all points: the same on every machine,
/// as those of the standard library need not be.
const HALF_ROOT_3: f64 = 0.866_025_403_784_438_6;
/// Cosine and sine of an angle of 45 degrees.
const HALF_ROOT_2: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// Returns the 40 points of a hemisphere about the centre of its cube, in metres, in its own frame: plates of a lower
/// hemisphere (H0, H2) face -x, -y and -z, those of an upper one +x, +y and +z.
pub fn points(hemisphere: usize) -> Vec<[f32; 3]> {
    let rim = (OUTER_RADIUS * OUTER_RADIUS - HALF_EDGE * HALF_EDGE).sqrt();
    let mut points: Vec<[f64; 3]> = Vec::with_capacity(3 * RIM + CUT + 4);
    for axis in 0..3 {
        for (c, s) in EIGHTHS {
            let mut point = [0.0; 3];
            point[axis] = HALF_EDGE;
            point[(axis + 1) % 3] = rim * c;
            point[(axis + 2) % 3] = rim * s;
            points.push(point);
        }
    }
    // The circle about the diagonal (1, 1, 1), spanned by (1, -1, 0)/√2 and (1, 1, -2)/√6.
    let (u, v) = (OUTER_RADIUS * HALF_ROOT_2, OUTER_RADIUS / 6f64.sqrt());
    points.extend(TWELFTHS.map(|(c, s)| [u * c + v * s, v * s - u * c, -2.0 * v * s]));
    let (edge, corner) = (OUTER_RADIUS * HALF_ROOT_2, OUTER_RADIUS / 3f64.sqrt());
    points.extend([[corner; 3], [0.0, edge, edge], [edge, 0.0, edge], [edge, edge, 0.0]]);
    let sign = if hemisphere.is_multiple_of(2) { -CELL_METRES } else { CELL_METRES };
    points.into_iter().map(|p| p.map(|x| (sign * x) as f32)).collect()
}

const EIGHTHS: [(f64, f64); RIM] = [
    (1.0, 0.0),
    (HALF_ROOT_2, HALF_ROOT_2),
    (0.0, 1.0),
    (-HALF_ROOT_2, HALF_ROOT_2),
    (-1.0, 0.0),
    (-HALF_ROOT_2, -HALF_ROOT_2),
    (0.0, -1.0),
    (HALF_ROOT_2, -HALF_ROOT_2),
];

const TWELFTHS: [(f64, f64); CUT] = [
    (1.0, 0.0),
    (HALF_ROOT_3, 0.5),
    (0.5, HALF_ROOT_3),
    (0.0, 1.0),
    (-0.5, HALF_ROOT_3),
    (-HALF_ROOT_3, 0.5),
    (-1.0, 0.0),
    (-HALF_ROOT_3, -0.5),
    (-0.5, -HALF_ROOT_3),
    (0.0, -1.0),
    (0.5, -HALF_ROOT_3),
    (HALF_ROOT_3, -0.5),
];

#[cfg(test)]
mod tests {
    use super::*;

    /// All points are on the ball or on a plate, and on the side of the hemisphere.
    #[test]
    fn hulls_are_half_of_the_rounded_cube() {
        let (radius, half) = ((OUTER_RADIUS * CELL_METRES) as f32, (HALF_EDGE * CELL_METRES) as f32);
        for hemisphere in 0..4 {
            let side = if hemisphere % 2 == 0 { -1.0 } else { 1.0 };
            let points = points(hemisphere);
            assert_eq!(points.len(), 40);
            for p in &points {
                let norm = p.iter().map(|x| x * x).sum::<f32>().sqrt();
                assert!((norm - radius).abs() < 1e-6, "{p:?}: {norm}");
                assert!(p.iter().all(|x| x.abs() <= half + 1e-6), "{p:?} is beyond a plate");
                assert!(side * p.iter().sum::<f32>() > -1e-6, "{p:?} is on the other side");
            }
        }
    }
}
