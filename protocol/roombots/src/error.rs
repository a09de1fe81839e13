//! Errors of questions to the kinematic model.

use super::Kind;
use thiserror::Error;

/// Why the kinematic model rejects its input. Unreachable poses are not errors of this kind: the solvers report
/// them in their result.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum KinematicsError {
    /// The name of a kind that does not exist.
    #[error("`{0}` is not a kind of robot; write one of single, PAR, SRS, PER, SRZ")]
    UnknownKind(String),
    /// The name of a connector that does not exist.
    #[error(
        "`{0}` is not a connector; write one of C0X, C0Y, C0Z, C1Y, C1Z, C2Y, C2Z, C3X, C3Y, C3Z, \
         for the second module of a metamodule with `2:` in front, such as 2:C3X"
    )]
    UnknownConnector(String),
    /// A connector of a second module that a single module does not have.
    #[error("a single module has no second module; leave out the `2:`")]
    NoSecondModule,
    /// Too few or too many joint angles.
    #[error("{kind} has {} joints, but {got} angles were given", kind.joints())]
    JointCount {
        /// The kind of robot.
        kind: Kind,
        /// The number of angles given.
        got: usize,
    },
    /// NaN or infinity.
    #[error("the angle of joint {joint} is {value}; every angle must be a finite number")]
    NotFinite {
        /// The joint, counted from 1 at the foot.
        joint: usize,
        /// The angle given.
        value: f64,
    },
    /// An angle that is not a lattice angle of its joint.
    #[error(
        "joint {joint} at {degrees}° is not on the lattice; {} are",
        if joint % 3 == 2 { "0, 90, 180 and -90" } else { "0, 120 and -120" }
    )]
    OffLattice {
        /// The joint, counted from 1 at the foot.
        joint: usize,
        /// The angle given.
        degrees: f64,
    },
    /// A pose whose numbers are not finite.
    #[error("the pose holds a number that is not finite")]
    PoseNotFinite,
    /// A pose whose matrix is not a rotation.
    #[error(
        "the pose is not a rigid one: its rotation is {error:.1e} away from a right-handed orthonormal matrix"
    )]
    NotARotation {
        /// The largest deviation of RᵀR from the identity, or of the determinant from 1.
        error: f64,
    },
}
