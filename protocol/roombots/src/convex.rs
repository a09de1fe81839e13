//! Overlap of two convex bodies (Gilbert, Johnson and Keerthi, 1988), from support points only.

use nalgebra::Vector3;

/// A convex body, given by its support points.
pub trait Convex {
    /// Returns a point of the body that is farthest in `direction`, which need not be of unit length.
    fn support(&self, direction: &Vector3<f64>) -> Vector3<f64>;
    /// Returns some point inside.
    fn centre(&self) -> Vector3<f64>;
}

/// A box with faces along the axes: a lattice cell, possibly shrunk.
#[derive(Clone, Copy, Debug)]
pub struct Cuboid {
    /// The centre.
    pub centre: Vector3<f64>,
    /// Half of its edge.
    pub half: f64,
}

impl Convex for Cuboid {
    fn support(&self, d: &Vector3<f64>) -> Vector3<f64> {
        self.centre + d.map(|x| if x < 0.0 { -self.half } else { self.half })
    }
    fn centre(&self) -> Vector3<f64> {
        self.centre
    }
}

/// Distance in cells below which bodies count as touching.
const CONTACT_DISTANCE: f64 = 1e-7;
/// Largest number of iterations: smooth bodies converge geometrically; pairs that need more are touching.
const MAX_ITERATIONS: usize = 60;

/// Returns true if two bodies have a point in common.
pub fn overlap(a: &impl Convex, b: &impl Convex) -> bool {
    let mut v = a.centre() - b.centre();
    if v.norm_squared() < CONTACT_DISTANCE * CONTACT_DISTANCE {
        return true;
    }
    let mut simplex: Vec<Vector3<f64>> = Vec::with_capacity(4);
    for _ in 0..MAX_ITERATIONS {
        let w = a.support(&-v) - b.support(&v);
        let vw = v.dot(&w);
        // v is the normal of a plane with the whole difference body on its far side.
        if vw > 0.0 {
            return false;
        }
        if v.norm_squared() - vw < 1e-14 {
            return true;
        }
        simplex.push(w);
        v = reduce_to_closest(&mut simplex);
        if simplex.len() == 4 || v.norm_squared() < CONTACT_DISTANCE * CONTACT_DISTANCE {
            return true;
        }
    }
    true
}

/// Finds the point of the simplex closest to the origin; points it does not depend on are dropped. Four
/// points remain only if the origin is inside.
fn reduce_to_closest(points: &mut Vec<Vector3<f64>>) -> Vector3<f64> {
    let (closest, used) = match points[..] {
        [a] => (a, vec![a]),
        [a, b] => segment(a, b),
        [a, b, c] => triangle(a, b, c),
        [a, b, c, d] => tetrahedron(a, b, c, d),
        _ => (Vector3::zeros(), Vec::new()),
    };
    *points = used;
    closest
}

type Closest = (Vector3<f64>, Vec<Vector3<f64>>);

fn segment(a: Vector3<f64>, b: Vector3<f64>) -> Closest {
    let ab = b - a;
    let length = ab.norm_squared();
    let t = if length > 0.0 { -a.dot(&ab) / length } else { 0.0 };
    if t <= 0.0 {
        (a, vec![a])
    } else if t >= 1.0 {
        (b, vec![b])
    } else {
        (a + ab * t, vec![a, b])
    }
}

fn nearer(x: Closest, y: Closest) -> Closest {
    if y.0.norm_squared() < x.0.norm_squared() { y } else { x }
}

fn triangle(a: Vector3<f64>, b: Vector3<f64>, c: Vector3<f64>) -> Closest {
    let n = (b - a).cross(&(c - a));
    let area = n.norm_squared();
    if area > 1e-24 {
        // Barycentric coordinates of the projection of the origin.
        let u = b.cross(&c).dot(&n);
        let v = c.cross(&a).dot(&n);
        let w = a.cross(&b).dot(&n);
        if u >= 0.0 && v >= 0.0 && w >= 0.0 {
            return (n * (a.dot(&n) / area), vec![a, b, c]);
        }
    }
    nearer(nearer(segment(a, b), segment(b, c)), segment(c, a))
}

fn tetrahedron(a: Vector3<f64>, b: Vector3<f64>, c: Vector3<f64>, d: Vector3<f64>) -> Closest {
    let mut best: Option<Closest> = None;
    let volume = (b - a).cross(&(c - a)).dot(&(d - a));
    for (p, q, r, opposite) in [(a, b, c, d), (a, c, d, b), (a, d, b, c), (b, d, c, a)] {
        let n = (q - p).cross(&(r - p));
        let origin_side = -n.dot(&p);
        let inner_side = n.dot(&(opposite - p));
        if origin_side * inner_side < 0.0 || volume.abs() < 1e-18 {
            let candidate = triangle(p, q, r);
            best = Some(match best {
                Some(b) => nearer(b, candidate),
                None => candidate,
            });
        }
    }
    best.unwrap_or((Vector3::zeros(), vec![a, b, c, d]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_core::rng::Rng;

    struct Ball(Vector3<f64>, f64);
    impl Convex for Ball {
        fn support(&self, d: &Vector3<f64>) -> Vector3<f64> {
            self.0 + d.normalize() * self.1
        }
        fn centre(&self) -> Vector3<f64> {
            self.0
        }
    }

    /// Balls and boxes have closed formulas to compare with.
    #[test]
    fn agrees_with_closed_formulas() {
        let mut rng = Rng::named(1, "convex", 0);
        let mut number = || rng.below(1 << 20) as f64 / f64::from(1 << 19) - 1.0;
        let mut hits = 0;
        for _ in 0..20_000 {
            let ball = Ball(Vector3::new(number(), number(), number()) * 1.5, 0.6);
            let other = Ball(Vector3::zeros(), 0.5);
            let distance = ball.0.norm();
            if (distance - 1.1).abs() > 1e-5 {
                assert_eq!(overlap(&ball, &other), distance < 1.1, "{}", ball.0);
            }
            let cell = Cuboid { centre: Vector3::zeros(), half: 0.5 };
            let outside = ball.0.map(|x| (x.abs() - 0.5).max(0.0)).norm();
            if (outside - 0.6).abs() > 1e-5 {
                assert_eq!(overlap(&ball, &cell), outside < 0.6, "{}", ball.0);
                hits += u32::from(outside < 0.6);
            }
        }
        assert!((2_000..18_000).contains(&hits), "{hits}");
    }
}
