//! Forward kinematics with any angles: the product of exponentials (thesis equation A.1).

use super::lattice_pose::{LatticePose, LatticeRotation};
use super::posture::is_middle;
use super::{Kind, KinematicsError};
use metamorph_core::rng::Rng;
use nalgebra::{Matrix3, Vector3, Vector6};
use std::f64::consts::PI;

/// A rigid pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// The rotation of the frame.
    pub rotation: Matrix3<f64>,
    /// The position of its origin, in cells.
    pub origin: Vector3<f64>,
}

impl Pose {
    /// Returns the foot frame itself.
    pub fn identity() -> Pose {
        Pose { rotation: Matrix3::identity(), origin: Vector3::zeros() }
    }
    /// Creates a pose from the rows of a 3×4 matrix. [`Pose::checked`] tells whether it is rigid.
    pub fn from_rows(rows: [[f64; 4]; 3]) -> Pose {
        Pose { rotation: Matrix3::from_fn(|r, c| rows[r][c]), origin: Vector3::from_fn(|r, _| rows[r][3]) }
    }
    /// Returns the rows of the 3×4 matrix of the pose.
    pub fn rows(&self) -> [[f64; 4]; 3] {
        let m = &self.rotation;
        [0, 1, 2].map(|r| [m[(r, 0)], m[(r, 1)], m[(r, 2)], self.origin[r]])
    }
    /// Transforms a point from this frame to the frame outside.
    pub fn point(&self, p: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * p + self.origin
    }
    /// Returns the pose in the outer frame of `inner`, which is given in this frame.
    pub fn compose(&self, inner: &Pose) -> Pose {
        Pose { rotation: self.rotation * inner.rotation, origin: self.point(&inner.origin) }
    }
    /// Returns the inverse pose.
    pub fn inverse(&self) -> Pose {
        let rotation = self.rotation.transpose();
        Pose { rotation, origin: -(rotation * self.origin) }
    }
    /// Returns the small motion from this pose to `target`: the difference of the origins and the rotation
    /// vector, both in the outer frame; cells and radians.
    pub fn error_to(&self, target: &Pose) -> Vector6<f64> {
        let turn = rotation_vector(&(target.rotation * self.rotation.transpose()));
        let shift = target.origin - self.origin;
        Vector6::new(shift.x, shift.y, shift.z, turn.x, turn.y, turn.z)
    }
    /// Refuses a pose that is not finite or whose matrix is not a rotation to within `tolerance`.
    pub fn checked(&self, tolerance: f64) -> Result<(), KinematicsError> {
        if !self.rotation.iter().chain(self.origin.iter()).all(|x| x.is_finite()) {
            return Err(KinematicsError::PoseNotFinite);
        }
        let off = (self.rotation.transpose() * self.rotation - Matrix3::identity()).amax();
        let error = off.max((self.rotation.determinant() - 1.0).abs());
        if error > tolerance { Err(KinematicsError::NotARotation { error }) } else { Ok(()) }
    }
}

impl From<LatticePose> for Pose {
    fn from(p: LatticePose) -> Pose {
        Pose { rotation: p.rotation.matrix(), origin: p.origin() }
    }
}

/// Returns the axis of a rotation times its angle, 0..π.
pub fn rotation_vector(r: &Matrix3<f64>) -> Vector3<f64> {
    let twice_sine = Vector3::new(r[(2, 1)] - r[(1, 2)], r[(0, 2)] - r[(2, 0)], r[(1, 0)] - r[(0, 1)]);
    let sine = twice_sine.norm() / 2.0;
    let cosine = (r.trace() - 1.0) / 2.0;
    let angle = sine.atan2(cosine);
    if sine > 1e-6 {
        return twice_sine * (angle / (2.0 * sine));
    }
    if cosine > 0.0 {
        return twice_sine / 2.0;
    }
    // Half a turn: R + I = 2 w wᵀ, and its longest column is the best conditioned.
    let sum = r + Matrix3::identity();
    let column = (0..3).max_by(|a, b| sum[(*a, *a)].total_cmp(&sum[(*b, *b)])).unwrap_or(0);
    let axis: Vector3<f64> = sum.column(column).into();
    let axis = axis.normalize();
    if axis.dot(&twice_sine) < 0.0 { -axis * angle } else { axis * angle }
}

/// Returns the rotation by `angle` about the unit vector `axis` (Rodrigues).
pub fn rotation(axis: &Vector3<f64>, angle: f64) -> Matrix3<f64> {
    let (s, c) = angle.sin_cos();
    let k = axis.cross_matrix();
    Matrix3::identity() + k * s + k * k * (1.0 - c)
}

/// A revolute joint in the zero posture: the twist (−w × p, w).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joint {
    /// Unit vector along the axis.
    pub axis: Vector3<f64>,
    /// The pivot, a point on the axis.
    pub pivot: Vector3<f64>,
}

impl Joint {
    /// Returns the motion of the part behind the joint when it turns by `angle`.
    pub fn exp(&self, angle: f64) -> Pose {
        let rotation = rotation(&self.axis, angle);
        Pose { rotation, origin: self.pivot - rotation * self.pivot }
    }
}

/// Any open chain of revolute joints, given in its zero posture.
#[derive(Clone, Debug, PartialEq)]
pub struct Chain {
    /// The joints from the foot on.
    pub joints: Vec<Joint>,
    /// The pose of the head with all joints at zero.
    pub home: Pose,
}

impl Chain {
    /// Returns the chain of a module or metamodule, foot to head plate.
    pub fn of(kind: Kind) -> Chain {
        let second = (kind.modules() == 2).then(|| kind.quarter_turns());
        Chain::of_modules(std::iter::once(0).chain(second))
    }

    /// Returns a chain of any number of modules, each given by the quarter turns by which it is turned
    /// against the one before it (the first against the foot frame).
    pub fn of_modules(turns: impl IntoIterator<Item = u8>) -> Chain {
        let mut joints = Vec::new();
        let mut turn = 0;
        let mut height = 0.0;
        for k in turns {
            turn = (turn + k) % 4;
            let turned = LatticeRotation::QUARTER.power(turn).matrix();
            for joint in 0..3 {
                let axis = if is_middle(joint) { Vector3::z() } else { turned * diagonal() };
                joints.push(Joint { axis, pivot: Vector3::new(0.0, 0.0, height + [0.5, 1.0, 1.5][joint]) });
            }
            height += 2.0;
        }
        let rotation = (LatticeRotation::QUARTER.power(turn) * LatticeRotation::FLIP).matrix();
        Chain { joints, home: Pose { rotation, origin: Vector3::new(0.0, 0.0, height) } }
    }

    /// Refuses a wrong number of angles and angles that are not finite.
    pub fn checked(kind: Kind, q: &[f64]) -> Result<(), KinematicsError> {
        if q.len() != kind.joints() {
            return Err(KinematicsError::JointCount { kind, got: q.len() });
        }
        match q.iter().position(|a| !a.is_finite()) {
            Some(i) => Err(KinematicsError::NotFinite { joint: i + 1, value: q[i] }),
            None => Ok(()),
        }
    }

    /// Returns the motions of the parts of the robot: entry i moves the part between joints i−1 and i, the
    /// last one the head. Angles beyond the joints are ignored, missing ones count as zero.
    pub fn motions(&self, q: &[f64]) -> Vec<Pose> {
        let mut motion = Pose::identity();
        let mut all = Vec::with_capacity(self.joints.len() + 1);
        all.push(motion);
        for (i, joint) in self.joints.iter().enumerate() {
            motion = motion.compose(&joint.exp(q.get(i).copied().unwrap_or(0.0)));
            all.push(motion);
        }
        all
    }

    /// Returns the pose of the head.
    pub fn head(&self, q: &[f64]) -> Pose {
        let mut motion = Pose::identity();
        for (joint, angle) in self.joints.iter().zip(q) {
            motion = motion.compose(&joint.exp(*angle));
        }
        motion.compose(&self.home)
    }

    /// Returns the head and, for every joint, the motion of the head per radian: velocity of its origin
    /// above, angular velocity below, in the outer frame.
    pub fn head_and_jacobian(&self, q: &[f64]) -> (Pose, Vec<Vector6<f64>>) {
        let mut motion = Pose::identity();
        let mut axes = Vec::with_capacity(self.joints.len());
        for (joint, angle) in self.joints.iter().zip(q) {
            axes.push((motion.rotation * joint.axis, motion.point(&joint.pivot)));
            motion = motion.compose(&joint.exp(*angle));
        }
        let head = motion.compose(&self.home);
        let columns = axes
            .into_iter()
            .map(|(w, p)| {
                let v = w.cross(&(head.origin - p));
                Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
            })
            .collect();
        (head, columns)
    }
}

/// Returns the unit vector along (1,1,1), at 54.7356° to the long axis.
pub fn diagonal() -> Vector3<f64> {
    Vector3::repeat(1.0 / 3f64.sqrt())
}

/// Returns the head frame of a robot, angles in radians (thesis equation A.1).
pub fn forward(kind: Kind, q: &[f64]) -> Result<Pose, KinematicsError> {
    Chain::checked(kind, q)?;
    Ok(Chain::of(kind).head(q))
}

/// Returns the frames of the hemispheres, four per module, H0 H1 H2 H3: rotation and centre of the cube.
pub fn hemispheres(kind: Kind, q: &[f64]) -> Result<Vec<Pose>, KinematicsError> {
    Chain::checked(kind, q)?;
    let chain = Chain::of(kind);
    let motions = chain.motions(q);
    let mut all = Vec::with_capacity(4 * kind.modules());
    for module in 0..kind.modules() {
        let turn = if module == 0 { 0 } else { kind.quarter_turns() };
        let turned = LatticeRotation::QUARTER.power(turn).matrix();
        for h in 0..4 {
            let motion = &motions[3 * module + h];
            let centre = chain.joints[3 * module + if h < 2 { 0 } else { 2 }].pivot;
            all.push(Pose { rotation: motion.rotation * turned, origin: motion.point(&centre) });
        }
    }
    Ok(all)
}

/// Brings an angle into (−π, π].
pub fn wrapped(angle: f64) -> f64 {
    let turned = angle.rem_euclid(2.0 * PI);
    if turned > PI { turned - 2.0 * PI } else { turned }
}

/// Returns the largest difference between two joint vectors, angles taken modulo a full turn.
pub fn joint_distance(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| wrapped(x - y).abs()).fold(0.0, f64::max)
}

/// Returns the matrix that turns the foot frame into a head frame: x' = −y, y' = −x, z' = −z.
pub fn flip() -> Matrix3<f64> {
    LatticeRotation::FLIP.matrix()
}

/// Draws the joint angles of a robot, each evenly from (−π, π].
pub fn random_angles(kind: Kind, rng: &mut Rng) -> Vec<f64> {
    (0..kind.joints()).map(|_| random_angle(rng)).collect()
}

/// Draws an angle evenly from (−π, π].
pub fn random_angle(rng: &mut Rng) -> f64 {
    PI - rng.below(1 << 32) as f64 * (2.0 * PI / (1u64 << 32) as f64)
}

/// Returns the matrix of the mirror x↔y.
pub fn mirror() -> Matrix3<f64> {
    Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0)
}
