//! Whether a connection succeeds: bending, misalignment, and chance.
//!
//! The mechanism compensates for about 13° about the normal and 4 mm of shift (thesis 2.2.1). On a horizontal grid
//! 1 of 20 connections failed (thesis 6.3.1). On walls more failed, but no number is given, so users of the model
//! have to raise the failure rate there. The bending of a robot under its weight was studied without a usable result
//! (thesis 2.2.2): the compliance of the joints is a parameter, zero by default.
//!
//! Verdicts are drawn from integers only, so that a body that uses them is the same on every machine.

use super::chain::{Chain, Pose, rotation_vector};
use super::torque::{Load, torques};
use super::{CELL_METRES, Kind, KinematicsError};
use metamorph_core::ratio::Ratio;
use metamorph_core::rng::Rng;
use nalgebra::{Vector3, Vector6};
use serde::{Deserialize, Serialize};

/// The deviation of a plate from its target.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Misalignment {
    /// Distance of the plate centres in micrometres.
    pub shift_um: u32,
    /// Angle about the normal in thousandths of a degree.
    pub twist_mdeg: u32,
    /// Angle between the normals in thousandths of a degree.
    pub tilt_mdeg: u32,
}

/// The tolerances of connections and their failure rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ConnectionModel {
    /// Largest shift in micrometres.
    pub shift_um: u32,
    /// Largest angle about the normal in thousandths of a degree.
    pub twist_mdeg: u32,
    /// Largest angle between the normals in thousandths of a degree. The thesis gives none; this is the tilt
    /// at which the rim of a plate is 4 mm off.
    pub tilt_mdeg: u32,
    /// Probability that a connection within the tolerances fails.
    pub failure: Ratio,
    /// Further shift drawn evenly from 0 to this for every attempt, in micrometres.
    pub shift_noise_um: u32,
    /// Further angle about the normal, drawn in the same way, in thousandths of a degree.
    pub twist_noise_mdeg: u32,
}

/// The outcome of an attempt to connect.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Attempt {
    /// The grippers hold.
    Connected,
    /// The plates were too far apart or turned against each other.
    OutOfTolerance,
    /// Within the tolerances, but the grippers did not catch.
    Failed,
}

impl ConnectionModel {
    /// Returns the hardware of the thesis on a horizontal grid, without further noise.
    pub fn thesis() -> ConnectionModel {
        ConnectionModel {
            shift_um: 4_000,
            twist_mdeg: 13_000,
            tilt_mdeg: 7_000,
            failure: Ratio::new(1, 20).expect("one of twenty is a probability"),
            shift_noise_um: 0,
            twist_noise_mdeg: 0,
        }
    }
    /// Returns a mechanism that always holds.
    pub fn perfect() -> ConnectionModel {
        ConnectionModel { failure: Ratio::ZERO, ..ConnectionModel::thesis() }
    }

    /// Returns true if the mechanism makes up for the misalignment.
    pub fn tolerates(&self, m: &Misalignment) -> bool {
        m.shift_um <= self.shift_um && m.twist_mdeg <= self.twist_mdeg && m.tilt_mdeg <= self.tilt_mdeg
    }

    /// Tries to connect. Draws the same number of random numbers for every outcome.
    pub fn attempt(&self, m: &Misalignment, rng: &mut Rng) -> Attempt {
        let mut noise = |most: u32| rng.below(u64::from(most) + 1) as u32;
        let noisy = Misalignment {
            shift_um: m.shift_um.saturating_add(noise(self.shift_noise_um)),
            twist_mdeg: m.twist_mdeg.saturating_add(noise(self.twist_noise_mdeg)),
            tilt_mdeg: m.tilt_mdeg,
        };
        let fails = rng.below(self.failure.den().into()) < self.failure.num().into();
        match (self.tolerates(&noisy), fails) {
            (false, _) => Attempt::OutOfTolerance,
            (true, true) => Attempt::Failed,
            (true, false) => Attempt::Connected,
        }
    }
}

impl Misalignment {
    /// Returns the deviation of a plate at `actual` from one at `wanted`; both with +z along their normal.
    pub fn between(actual: &Pose, wanted: &Pose) -> Misalignment {
        let shift = (actual.origin - wanted.origin).norm() * CELL_METRES * 1e6;
        // Tilt first takes one normal to the other; the remaining rotation is about the normal.
        let normal: Vector3<f64> = wanted.rotation.column(2).into();
        let other: Vector3<f64> = actual.rotation.column(2).into();
        let tilt = normal.cross(&other).norm().atan2(normal.dot(&other));
        let turn = rotation_vector(&(actual.rotation * wanted.rotation.transpose()));
        let twist = turn.dot(&normal).abs();
        let mdeg = |a: f64| (a.to_degrees() * 1000.0).round() as u32;
        Misalignment { shift_um: shift.round() as u32, twist_mdeg: mdeg(twist), tilt_mdeg: mdeg(tilt) }
    }
}

/// Returns the pose of the head under the weight of the robot, to first order: every joint yields by its
/// torque times `compliance` (radians per Nm).
pub fn bent_head(kind: Kind, q: &[f64], load: &Load, compliance: f64) -> Result<Pose, KinematicsError> {
    let torques = torques(kind, q, load)?;
    let chain = Chain::of(kind);
    let (head, columns) = chain.head_and_jacobian(q);
    let mut motion = Vector6::zeros();
    for (torque, column) in torques.iter().zip(&columns) {
        motion += column * (torque.signed * compliance);
    }
    let turn = Vector3::new(motion[3], motion[4], motion[5]);
    let angle = turn.norm();
    let rotation = if angle > 0.0 {
        super::chain::rotation(&(turn / angle), angle) * head.rotation
    } else {
        head.rotation
    };
    Ok(Pose { rotation, origin: head.origin + Vector3::new(motion[0], motion[1], motion[2]) })
}

/// Returns how far bending takes the head plate from its target.
pub fn bending(kind: Kind, q: &[f64], load: &Load, compliance: f64) -> Result<Misalignment, KinematicsError> {
    let wanted = super::chain::forward(kind, q)?;
    Ok(Misalignment::between(&bent_head(kind, q, load, compliance)?, &wanted))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_of_twenty_fails_within_the_tolerances() {
        let model = ConnectionModel::thesis();
        let mut rng = Rng::named(3, "connection", 0);
        let edge = Misalignment { shift_um: 4_000, twist_mdeg: 13_000, tilt_mdeg: 0 };
        let tries = 20_000;
        let failed = (0..tries).filter(|_| model.attempt(&edge, &mut rng) == Attempt::Failed).count();
        assert!((900..1_100).contains(&failed), "{failed}");
        let beyond = Misalignment { shift_um: 4_001, ..edge };
        assert_eq!(model.attempt(&beyond, &mut rng), Attempt::OutOfTolerance);
        let beyond = Misalignment { twist_mdeg: 13_001, ..edge };
        assert_eq!(model.attempt(&beyond, &mut rng), Attempt::OutOfTolerance);
        assert_eq!(ConnectionModel::perfect().attempt(&edge, &mut rng), Attempt::Connected);
    }

    /// Outcomes follow from the seed, and an attempt out of tolerance draws as many numbers.
    #[test]
    fn attempts_are_seeded() {
        let model = ConnectionModel { shift_noise_um: 3_000, ..ConnectionModel::thesis() };
        let run = |first: u32| {
            let mut rng = Rng::named(8, "connection", 1);
            let mut shift = first;
            (0..50)
                .map(|_| {
                    let m = Misalignment { shift_um: shift, ..Misalignment::default() };
                    shift = 2_000;
                    model.attempt(&m, &mut rng)
                })
                .collect::<Vec<_>>()
        };
        assert_eq!(run(2_000), run(2_000));
        assert_eq!(run(2_000)[1..], run(9_000)[1..]);
    }

    /// A robot straight out of a wall sags downwards, an upright one does not bend.
    #[test]
    fn weight_bends_the_lever() {
        let wall = Load { gravity: -Vector3::x(), ..Load::floor() };
        let head = bent_head(Kind::Par, &[0.0; 6], &wall, 1e-3).unwrap();
        assert!(head.origin.x < -1e-3, "{}", head.origin);
        let up = bending(Kind::Par, &[0.0; 6], &Load::floor(), 1e-3).unwrap();
        assert_eq!(up, Misalignment::default());
        let stiff = bending(Kind::Par, &[0.0; 6], &wall, 0.0).unwrap();
        assert_eq!(stiff, Misalignment::default());
        let soft = bending(Kind::Par, &[0.0; 6], &wall, 1e-2).unwrap();
        assert!(!ConnectionModel::thesis().tolerates(&soft), "{soft:?}");
    }
}
