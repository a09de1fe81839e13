//! The precision of a circle of chairs around a table: the measures p_l and p_g of thesis 8.2.

use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

/// The least number of points of an ellipse.
const LEAST: usize = 6;

/// The measures, in the unit of the points.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Precision {
    /// The standard deviation (n - 1) of the distances to the centroid, and the distance from it to the table.
    pub p_l: f64,
    /// The standard deviation alone.
    pub deviation: f64,
    /// The distance from the centroid to the table.
    pub off: f64,
    /// The ratio of the axes of the ellipse; `None` if there are fewer than six points, or no ellipse fits.
    pub p_g: Option<f64>,
    /// The half axes, the long one first.
    pub axes: Option<[f64; 2]>,
}

/// Measures the chairs' middles around the table's; `None` for fewer than two.
pub fn precision(chairs: &[[f64; 2]], table: [f64; 2]) -> Option<Precision> {
    if chairs.len() < 2 {
        return None;
    }
    let many = chairs.len() as f64;
    let c = centroid(chairs);
    let distances: Vec<f64> = chairs.iter().map(|p| libm::hypot(p[0] - c[0], p[1] - c[1])).collect();
    let mean = distances.iter().sum::<f64>() / many;
    let squares: f64 = distances.iter().map(|d| (d - mean) * (d - mean)).sum();
    let deviation = libm::sqrt(squares / (many - 1.0));
    let off = libm::hypot(c[0] - table[0], c[1] - table[1]);
    let axes = axes(chairs);
    Some(Precision {
        p_l: deviation + off,
        deviation,
        off,
        p_g: axes.map(|[long, short]| long / short),
        axes,
    })
}

fn centroid(points: &[[f64; 2]]) -> [f64; 2] {
    let many = points.len() as f64;
    points.iter().fold([0.0; 2], |c, p| [c[0] + p[0] / many, c[1] + p[1] / many])
}

/// Returns the half axes of the ellipse with the least algebraic distance (Fitzgibbon, in the stable form of Halíř
/// and Flusser); points are centred and scaled to a mean square of 2 first.
fn axes(points: &[[f64; 2]]) -> Option<[f64; 2]> {
    if points.len() < LEAST {
        return None;
    }
    let many = points.len() as f64;
    let c = centroid(points);
    let square = |p: &[f64; 2]| (p[0] - c[0]) * (p[0] - c[0]) + (p[1] - c[1]) * (p[1] - c[1]);
    let scale = libm::sqrt(points.iter().map(square).sum::<f64>() / many / 2.0);
    if scale.is_nan() || scale <= 0.0 {
        return None;
    }
    let (mut s1, mut s2, mut s3) = (Matrix3::zeros(), Matrix3::zeros(), Matrix3::zeros());
    for p in points {
        let (x, y) = ((p[0] - c[0]) / scale, (p[1] - c[1]) / scale);
        let (quadratic, linear) = (Vector3::new(x * x, x * y, y * y), Vector3::new(x, y, 1.0));
        s1 += quadratic * quadratic.transpose();
        s2 += quadratic * linear.transpose();
        s3 += linear * linear.transpose();
    }
    // All on one line, or almost: what ellipse fits is then a matter of rounding.
    if s3[(0, 0)] * s3[(1, 1)] - s3[(0, 1)] * s3[(0, 1)] < 1e-9 * many * many {
        return None;
    }
    let t = -s3.try_inverse()? * s2.transpose();
    let m = s1 + s2 * t;
    // The inverse of the constraint 4ac - b² = 1, applied to the rows.
    let reduced = Matrix3::from_rows(&[m.row(2) / 2.0, -m.row(1), m.row(0) / 2.0]);
    let quadratic = ellipse(&reduced)?;
    let linear = t * quadratic;
    half_axes([quadratic[0], quadratic[1], quadratic[2], linear[0], linear[1], linear[2]])
        .map(|[long, short]| [long * scale, short * scale])
}

/// The eigenvector that is an ellipse: the only one with 4ac - b² above 0.
fn ellipse(reduced: &Matrix3<f64>) -> Option<Vector3<f64>> {
    let values = reduced.complex_eigenvalues();
    let vectors = values.iter().filter(|e| e.im.abs() < 1e-9).filter_map(|e| {
        let shifted = reduced - Matrix3::identity() * e.re;
        // Orthogonal to all rows: of the three products of two, the longest is the most exact.
        let rows = [0, 1, 2].map(|i| shifted.row(i).transpose());
        let products = [(0, 1), (0, 2), (1, 2)].map(|(i, j)| rows[i].cross(&rows[j]));
        let longest = products.into_iter().max_by(|a, b| a.norm().total_cmp(&b.norm()))?;
        longest.try_normalize(0.0)
    });
    let all: Vec<(f64, Vector3<f64>)> = vectors.map(|v| (4.0 * v[0] * v[2] - v[1] * v[1], v)).collect();
    let best = all.into_iter().max_by(|a, b| a.0.total_cmp(&b.0));
    best.filter(|(sign, _)| *sign > 0.0).map(|(_, v)| v)
}

/// The half axes of a x² + b xy + c y² + d x + e y + f = 0, the long one first.
fn half_axes([a, b, c, d, e, f]: [f64; 6]) -> Option<[f64; 2]> {
    let determinant = 4.0 * a * c - b * b;
    // The middle, and the value of the form there.
    let (x, y) = ((b * e - 2.0 * c * d) / determinant, (b * d - 2.0 * a * e) / determinant);
    let value = f + (d * x + e * y) / 2.0;
    let spread = libm::hypot(a - c, b);
    let axis = |curvature: f64| -value / (curvature / 2.0);
    let squares = [axis(a + c - spread), axis(a + c + spread)];
    let [long, short] = if a + c > 0.0 { squares } else { [squares[1], squares[0]] };
    (long.is_finite() && short > 0.0).then(|| [libm::sqrt(long), libm::sqrt(short)])
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Vector {
        chairs: [[f64; 2]; 10],
        table: [f64; 2],
        /// p_l, deviation, off, p_g, long, short.
        expected: [f64; 6],
    }

    /// Computed by another program.
    const VECTORS: [Vector; 3] = [
        // Perfect circle.
        Vector {
            chairs: [
                [1.0, 0.0],
                [0.809, 0.5878],
                [0.309, 0.9511],
                [-0.309, 0.9511],
                [-0.809, 0.5878],
                [-1.0, 0.0],
                [-0.809, -0.5878],
                [-0.309, -0.9511],
                [0.309, -0.9511],
                [0.809, -0.5878],
            ],
            table: [0.0, 0.0],
            expected: [2.0487e-05, 2.0487e-05, 0.0, 1.000049246, 1.000037032, 0.999987787],
        },
        // Ellipse 1.2 to 1, table beside the middle.
        Vector {
            chairs: [
                [3.8489, 2.8456],
                [3.2562, 3.086],
                [2.5656, 2.9117],
                [2.0409, 2.3891],
                [1.8826, 1.7179],
                [2.1511, 1.1544],
                [2.7438, 0.914],
                [3.4344, 1.0883],
                [3.9591, 1.6109],
                [4.1174, 2.2821],
            ],
            table: [3.3, 2.4],
            expected: [0.574473179, 0.074473179, 0.5, 1.199997953, 1.200001484, 1.000002943],
        },
        // A person, roughly.
        Vector {
            chairs: [
                [3.1012, 2.5481],
                [2.5175, 2.9131],
                [1.8118, 3.358],
                [1.1926, 2.7751],
                [0.723, 2.0749],
                [0.884, 1.4418],
                [1.4917, 1.0085],
                [2.1963, 1.0373],
                [2.8328, 1.4654],
                [3.2504, 1.8966],
            ],
            table: [2.1, 1.8],
            expected: [0.391076232, 0.120119499, 0.270956733, 1.099338215, 1.223251285, 1.112716057],
        },
    ];

    #[test]
    fn measures_are_those_of_another_program() {
        for Vector { chairs, table, expected } in &VECTORS {
            let p = precision(chairs, *table).unwrap();
            let [long, short] = p.axes.unwrap();
            let ours = [p.p_l, p.deviation, p.off, p.p_g.unwrap(), long, short];
            for (ours, expected) in ours.into_iter().zip(expected) {
                assert!((ours - expected).abs() < 1e-6, "{ours} is not {expected}");
            }
        }
    }

    #[test]
    fn what_is_no_ellipse_has_no_ratio() {
        let ratio = |points: &[[f64; 2]]| precision(points, [0.0, 0.0]).and_then(|p| p.p_g);
        let line: Vec<[f64; 2]> = (0..9).map(|i| [f64::from(i), 2.0 * f64::from(i)]).collect();
        assert_eq!((ratio(&line), ratio(&[[1.0, 2.0]; 8]), ratio(&line[..5])), (None, None, None));
        assert!(precision(&line[..1], [0.0, 0.0]).is_none());
        assert!(precision(&line, [0.0, 0.0]).is_some_and(|p| p.p_l > 0.0));
        // An ellipse three times as long as wide, turned.
        let ellipse: Vec<[f64; 2]> = (0..7)
            .map(|i| f64::from(i) * 0.9)
            .map(|a| (3.0 * libm::cos(a), libm::sin(a)))
            .map(|(u, v)| [5.0 + 0.6 * u - 0.8 * v, 0.8 * u + 0.6 * v])
            .collect();
        assert!((ratio(&ellipse).unwrap() - 3.0).abs() < 1e-9);
    }
}
