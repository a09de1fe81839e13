//! Contacts of convex hulls with the floor, a half-space: every vertex near the plane is one, and the normal is that of the
//! plane.
//!
//! The engine's own contacts are not used. Against a large box it iterates, which in 32 bits now and then ends with a normal
//! that points sideways and a depth of metres; against a half-space it takes four vertices of one face, which need not be
//! the lowest ones.

use rapier3d::geometry::{ContactData, ContactManifoldData};
use rapier3d::parry::query::details::{ContactManifoldsWorkspace, NormalConstraints, ShapeCastOptions};
use rapier3d::parry::query::{
    ClosestPoints, Contact, ContactManifold, NonlinearRigidMotion, PersistentQueryDispatcher,
    QueryDispatcher, ShapeCastHit, ShapeDistance, ShapeIntersection, TrackedContact, Unsupported,
};
use rapier3d::parry::shape::{ConvexPolyhedron, HalfSpace, PackedFeatureId, Shape};
use rapier3d::prelude::{Pose, Real, Vector};

type Manifold = ContactManifold<ContactManifoldData, ContactData>;

/// Finds contacts of hulls with the floor, and leaves all other shapes to the next dispatcher of a chain.
pub struct FloorContacts;

/// Which of two shapes is the floor.
enum Pair<'a> {
    FloorFirst(&'a HalfSpace, &'a ConvexPolyhedron),
    HullFirst(&'a ConvexPolyhedron, &'a HalfSpace),
}

impl<'a> Pair<'a> {
    fn of(first: &'a dyn Shape, second: &'a dyn Shape) -> Result<Pair<'a>, Unsupported> {
        if let (Some(floor), Some(hull)) = (first.as_halfspace(), second.as_convex_polyhedron()) {
            Ok(Pair::FloorFirst(floor, hull))
        } else if let (Some(hull), Some(floor)) = (first.as_convex_polyhedron(), second.as_halfspace()) {
            Ok(Pair::HullFirst(hull, floor))
        } else {
            Err(Unsupported)
        }
    }

    /// Replaces the points of a manifold by those not farther than `prediction` from the floor. `pose` is that of the second
    /// shape in the frame of the first.
    fn update(&self, pose: &Pose, prediction: Real, manifold: &mut Manifold) {
        let (floor, hull, pose, is_flipped) = match self {
            Pair::FloorFirst(floor, hull) => (floor, hull, *pose, false),
            Pair::HullFirst(hull, floor) => (floor, hull, pose.inverse(), true),
        };
        let old = std::mem::take(&mut manifold.points);
        for (vertex, point) in (0..).zip(hull.points()) {
            let at = pose * *point;
            let height = at.dot(floor.normal);
            if height <= prediction {
                let below: Vector = at - floor.normal * height;
                let (plane, vertex) = (PackedFeatureId::face(0), PackedFeatureId::vertex(vertex));
                let contact = TrackedContact::flipped(below, *point, plane, vertex, height, is_flipped);
                manifold.points.push(contact);
            }
        }
        let into_floor = -(pose.rotation.inverse() * floor.normal);
        (manifold.local_n1, manifold.local_n2) =
            if is_flipped { (into_floor, floor.normal) } else { (floor.normal, into_floor) };
        // Impulses of the last tick are where the solver begins.
        manifold.match_contacts(&old);
    }
}

impl PersistentQueryDispatcher<ContactManifoldData, ContactData> for FloorContacts {
    fn contact_manifolds(
        &self,
        pos12: &Pose,
        g1: &dyn Shape,
        g2: &dyn Shape,
        prediction: Real,
        manifolds: &mut Vec<Manifold>,
        _: &mut Option<ContactManifoldsWorkspace>,
    ) -> Result<(), Unsupported> {
        let pair = Pair::of(g1, g2)?;
        manifolds.resize_with(1, Manifold::new);
        manifolds.iter_mut().for_each(|manifold| pair.update(pos12, prediction, manifold));
        Ok(())
    }
    fn contact_manifold_convex_convex(
        &self,
        pos12: &Pose,
        g1: &dyn Shape,
        g2: &dyn Shape,
        _: Option<&dyn NormalConstraints>,
        _: Option<&dyn NormalConstraints>,
        prediction: Real,
        manifold: &mut Manifold,
    ) -> Result<(), Unsupported> {
        Pair::of(g1, g2)?.update(pos12, prediction, manifold);
        Ok(())
    }
}

impl QueryDispatcher for FloorContacts {
    fn intersection_test(
        &self,
        _: &Pose,
        _: &dyn Shape,
        _: &dyn Shape,
    ) -> Result<ShapeIntersection, Unsupported> {
        Err(Unsupported)
    }
    fn distance(&self, _: &Pose, _: &dyn Shape, _: &dyn Shape) -> Result<ShapeDistance, Unsupported> {
        Err(Unsupported)
    }
    fn contact(
        &self,
        _: &Pose,
        _: &dyn Shape,
        _: &dyn Shape,
        _: Real,
    ) -> Result<Option<Contact>, Unsupported> {
        Err(Unsupported)
    }
    fn closest_points(
        &self,
        _: &Pose,
        _: &dyn Shape,
        _: &dyn Shape,
        _: Real,
    ) -> Result<ClosestPoints, Unsupported> {
        Err(Unsupported)
    }
    fn cast_shapes(
        &self,
        _: &Pose,
        _: Vector,
        _: &dyn Shape,
        _: &dyn Shape,
        _: ShapeCastOptions,
    ) -> Result<Option<ShapeCastHit>, Unsupported> {
        Err(Unsupported)
    }
    fn cast_shapes_nonlinear(
        &self,
        _: &NonlinearRigidMotion,
        _: &dyn Shape,
        _: &NonlinearRigidMotion,
        _: &dyn Shape,
        _: Real,
        _: Real,
        _: bool,
    ) -> Result<Option<ShapeCastHit>, Unsupported> {
        Err(Unsupported)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hull;
    use rapier3d::prelude::{Rotation, SharedShape};

    /// In any attitude the deepest contact is the lowest vertex, and the normal points upwards, in either order.
    #[test]
    fn the_lowest_vertex_touches_first() {
        let points: Vec<Vector> = hull::points(0).into_iter().map(Vector::from_array).collect();
        let hull = SharedShape::convex_hull(&points).unwrap();
        let floor = SharedShape::halfspace(Vector::Z);
        for step in 0..200_u16 {
            let turn = f32::from(step) * 0.37;
            let axis = Vector::new(1.0, 0.3 * turn, 2.0 - turn).normalize();
            let far = 100.0 * f32::from(step);
            let pose = Pose::from_parts(Vector::new(far, -far, 0.054), Rotation::from_axis_angle(axis, turn));
            let lowest = points.iter().map(|p| (pose * *p).z).fold(f32::MAX, f32::min);
            for is_flipped in [false, true] {
                let (mut manifolds, mut workspace) = (Vec::new(), None);
                let found = if is_flipped {
                    let pos12 = pose.inverse();
                    FloorContacts.contact_manifolds(
                        &pos12,
                        &*hull,
                        &*floor,
                        0.01,
                        &mut manifolds,
                        &mut workspace,
                    )
                } else {
                    FloorContacts.contact_manifolds(
                        &pose,
                        &*floor,
                        &*hull,
                        0.01,
                        &mut manifolds,
                        &mut workspace,
                    )
                };
                assert!(found.is_ok() && manifolds.len() == 1);
                let manifold = &manifolds[0];
                let deepest = manifold.points.iter().map(|p| p.dist).fold(f32::MAX, f32::min);
                let expected = if lowest <= 0.01 { lowest } else { f32::MAX };
                // Far away the inverse of a pose is exact to a part of 2^24.
                let off = 1e-6 + far * 3e-7;
                assert!((deepest - expected).abs() <= off, "step {step}: {deepest} m, not {expected} m");
                let normal = if is_flipped { manifold.local_n2 } else { manifold.local_n1 };
                assert_eq!(normal, Vector::Z);
            }
        }
    }

    #[test]
    fn other_shapes_are_left_to_others() {
        let ball = SharedShape::ball(0.1);
        let (mut manifolds, mut workspace) = (Vec::new(), None);
        let found = FloorContacts.contact_manifolds(
            &Pose::IDENTITY,
            &*ball,
            &*SharedShape::halfspace(Vector::Z),
            0.01,
            &mut manifolds,
            &mut workspace,
        );
        assert!(found.is_err() && manifolds.is_empty());
    }
}
