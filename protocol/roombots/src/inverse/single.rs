//! The single module: three angles cannot reach every pose; the solution of a reachable one is in closed
//! form.

use crate::HALF_EDGE;
use crate::chain::{Pose, diagonal, flip, rotation};
use nalgebra::Vector3;

/// Offers every candidate; the caller checks whether it reaches the whole pose.
pub(super) fn candidates(target: &Pose, offer: &mut impl FnMut(Vec<f64>)) {
    let w = diagonal();
    let last = target.rotation * flip();
    let second = target.origin - last.column(2) * HALF_EDGE;
    let d1 = second - Vector3::new(0.0, 0.0, HALF_EDGE);
    let q1 = super::paden_kahan::turn_about(&w, &Vector3::z(), &d1);
    // Rz(q2) C(q3) = C(q1)⁻¹ R
    let rest = rotation(&w, -q1) * last;
    let cosine = ((rest[(2, 2)] - 1.0 / 3.0) * 1.5).clamp(-1.0, 1.0);
    for sign in [1.0, -1.0] {
        let q3 = sign * cosine.acos();
        let middle = rest * rotation(&w, -q3);
        let q2 = (middle[(1, 0)] - middle[(0, 1)]).atan2(middle[(0, 0)] + middle[(1, 1)]);
        offer(vec![q1, q2, q3]);
    }
}
