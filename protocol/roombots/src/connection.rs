//! Whether a connection closes: bending, misalignment, and chance.
//!
//! The mechanism compensates for about 13° about the normal and 4 mm of shift (thesis 2.2.1). Beyond that "only one or
//! two of the four grippers" catch (thesis 6.3.1). The bending of a robot under its weight was studied without a usable
//! result (thesis 2.2.2), so the compliance of the joints is a parameter, zero by default.
//!
//! A deviation is rounded to micrometres and thousandths of a degree, and everything that is drawn is an integer, so
//! that the last bits of floating-point numbers hardly ever decide. Noise adds to the deviation by bending, which is the worst direction.

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

/// The tolerances of a connection mechanism, and what takes a plate away from its target.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ConnectionModel {
    /// Largest shift in micrometres.
    pub shift_um: u32,
    /// Largest angle about the normal in thousandths of a degree.
    pub twist_mdeg: u32,
    /// Largest angle between the normals in thousandths of a degree. The thesis gives none; this is the tilt
    /// at which the rim of a plate is 4 mm off.
    pub tilt_mdeg: u32,
    /// Further shift drawn evenly from 0 to this for every attempt, in micrometres: the error of the posture.
    pub shift_noise_um: u32,
    /// Further angle about the normal, drawn in the same way, in thousandths of a degree.
    pub twist_noise_mdeg: u32,
    /// Thousandths of a degree by which a joint yields to each Nm of torque.
    pub compliance_mdeg: u32,
}

/// The outcome of an attempt to connect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Attempt {
    /// The grippers hold.
    Connected,
    /// The plates were too far apart or turned against each other.
    OutOfTolerance,
    /// Within the tolerances, but the grippers did not catch.
    Failed,
}

impl ConnectionModel {
    /// The mechanism of thesis 2.2.1, on joints that do not yield and postures without an error.
    pub const THESIS: ConnectionModel = ConnectionModel {
        shift_um: 4_000,
        twist_mdeg: 13_000,
        tilt_mdeg: 7_000,
        shift_noise_um: 0,
        twist_noise_mdeg: 0,
        compliance_mdeg: 0,
    };

    /// Returns true if the mechanism makes up for the misalignment.
    pub fn tolerates(&self, m: &Misalignment) -> bool {
        m.shift_um <= self.shift_um && m.twist_mdeg <= self.twist_mdeg && m.tilt_mdeg <= self.tilt_mdeg
    }

    /// Tries to connect plates with this deviation; within the tolerances the grippers fail with the probability `failure`.
    /// Draws the same number of random numbers for every outcome.
    pub fn attempt(&self, m: &Misalignment, failure: Ratio, rng: &mut Rng) -> Attempt {
        let mut noise = |most: u32| rng.below(u64::from(most) + 1) as u32;
        let noisy = Misalignment {
            shift_um: m.shift_um.saturating_add(noise(self.shift_noise_um)),
            twist_mdeg: m.twist_mdeg.saturating_add(noise(self.twist_noise_mdeg)),
            tilt_mdeg: m.tilt_mdeg,
        };
        let fails = rng.chance(failure);
        match (self.tolerates(&noisy), fails) {
            (false, _) => Attempt::OutOfTolerance,
            (true, true) => Attempt::Failed,
            (true, false) => Attempt::Connected,
        }
    }

    /// Returns how far the weight of a robot that is held at its foot takes its head plate from the target of a posture.
    ///
    /// # Errors
    /// If the posture has another number of joints than the kind, or an angle is not finite.
    pub fn bending(&self, kind: Kind, q: &[f64], load: &Load) -> Result<Misalignment, KinematicsError> {
        if self.compliance_mdeg == 0 {
            return Ok(Misalignment::default());
        }
        let wanted = super::chain::forward(kind, q)?;
        Ok(Misalignment::between(&self.bent_head(kind, q, load)?, &wanted))
    }

    /// Returns the pose of the head under the weight of the robot, to first order: each joint yields by its torque.
    ///
    /// # Errors
    /// If the posture has another number of joints than the kind, or an angle is not finite.
    pub fn bent_head(&self, kind: Kind, q: &[f64], load: &Load) -> Result<Pose, KinematicsError> {
        let torques = torques(kind, q, load)?;
        let (head, columns) = Chain::of(kind).head_and_jacobian(q);
        let radians = (f64::from(self.compliance_mdeg) / 1000.0).to_radians();
        let mut motion = Vector6::zeros();
        for (torque, column) in torques.iter().zip(&columns) {
            motion += column * (torque.signed * radians);
        }
        let turn = Vector3::new(motion[3], motion[4], motion[5]);
        let angle = turn.norm();
        let rotation = match angle > 0.0 {
            true => super::chain::rotation(&(turn / angle), angle) * head.rotation,
            false => head.rotation,
        };
        Ok(Pose { rotation, origin: head.origin + Vector3::new(motion[0], motion[1], motion[2]) })
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

#[cfg(test)]
mod tests {
    use super::*;

    const EDGE: Misalignment = Misalignment { shift_um: 4_000, twist_mdeg: 13_000, tilt_mdeg: 7_000 };

    fn failure() -> Ratio {
        Ratio::new(1, 20).unwrap()
    }

    #[test]
    fn one_of_twenty_fails_within_the_tolerances() {
        let model = ConnectionModel::THESIS;
        let mut rng = Rng::named(3, "connection", 0);
        let tries = 20_000;
        let failed =
            (0..tries).filter(|_| model.attempt(&EDGE, failure(), &mut rng) == Attempt::Failed).count();
        assert!((900..1_100).contains(&failed), "{failed}");
        assert_eq!(model.attempt(&EDGE, Ratio::ZERO, &mut rng), Attempt::Connected);
        let beyond = [
            Misalignment { shift_um: 4_001, ..EDGE },
            Misalignment { twist_mdeg: 13_001, ..EDGE },
            Misalignment { tilt_mdeg: 7_001, ..EDGE },
        ];
        for beyond in beyond {
            assert_eq!(model.attempt(&beyond, Ratio::ZERO, &mut rng), Attempt::OutOfTolerance, "{beyond:?}");
        }
    }

    /// Outcomes follow from the seed, and an attempt out of tolerance draws as many numbers.
    #[test]
    fn attempts_are_seeded() {
        let model = ConnectionModel { shift_noise_um: 3_000, ..ConnectionModel::THESIS };
        let run = |first: u32| {
            let mut rng = Rng::named(8, "connection", 1);
            let shifts = [first].into_iter().chain([2_000; 49]);
            let of = |shift| Misalignment { shift_um: shift, ..Misalignment::default() };
            shifts.map(|shift| model.attempt(&of(shift), failure(), &mut rng)).collect::<Vec<_>>()
        };
        assert_eq!(run(2_000), run(2_000));
        assert_eq!(run(2_000)[1..], run(9_000)[1..]);
    }

    /// A robot straight out of a wall sags downwards, an upright one does not bend.
    #[test]
    fn weight_bends_the_lever() {
        let wall = Load { gravity: -Vector3::x(), ..Load::floor() };
        let of = |compliance_mdeg| ConnectionModel { compliance_mdeg, ..ConnectionModel::THESIS };
        let head = of(60).bent_head(Kind::Par, &[0.0; 6], &wall).unwrap();
        assert!(head.origin.x < -1e-3, "{}", head.origin);
        let up = of(60).bending(Kind::Par, &[0.0; 6], &Load::floor()).unwrap();
        assert_eq!(up, Misalignment::default());
        let stiff = of(0).bending(Kind::Par, &[0.0; 6], &wall).unwrap();
        assert_eq!(stiff, Misalignment::default());
        let soft = of(600).bending(Kind::Par, &[0.0; 6], &wall).unwrap();
        assert!(!of(600).tolerates(&soft), "{soft:?}");
    }
}
