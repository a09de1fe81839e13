//! Static torque on the joints: the two estimates of thesis 5.1.3 (level 2) and the exact value.
//!
//! For joint i: m is the mass beyond it (every hemisphere at the centre of its cube), C the centre
//! of that mass, Q the pivot, u the axis, v the direction of gravity, P the last pivot of the chain.
//!
//! * T^w = m g times the horizontal distance from Q to C: as if every axis were horizontal and
//!   square to the lever.
//! * T^r = m g |(P − Q)·(u × v)| / |u × v| (thesis equations 5.1 and 5.2), with all mass at P. As
//!   printed it is *not* always below T^w; with C in the place of P it is.
//! * exact: m g |(C − Q)·(u × v)|.

use super::chain::{Chain, hemispheres};
use super::{CELL_METRES, HEMISPHERE_MASS, Kind, KinematicsError};
use nalgebra::Vector3;

/// Standard acceleration of gravity in m/s².
pub const GRAVITY: f64 = 9.81;

/// The load of a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load {
    /// Direction of gravity in the foot frame, of unit length; −z for a robot on the floor.
    pub gravity: Vector3<f64>,
    /// Mass of the payload in kilograms.
    pub payload: f64,
    /// Centre of mass of the payload in the head frame, in cells. The origin is the middle of the head plate.
    pub payload_at: Vector3<f64>,
}

impl Load {
    /// Returns the load of a robot on the floor without payload.
    pub fn floor() -> Load {
        Load { gravity: -Vector3::z(), payload: 0.0, payload_at: Vector3::zeros() }
    }
}

/// The largest torques of the joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Of the outer, diagonal joints in Nm.
    pub outer: f64,
    /// Of the middle joints in Nm.
    pub middle: f64,
}

impl Limits {
    /// The nominal torques of thesis table 2.1.
    pub const NOMINAL: Limits = Limits { outer: 4.9, middle: 3.6 };
    /// The nominal limits of the torque experiment of thesis 5.1.4.
    pub const EXPERIMENT: Limits = Limits { outer: 5.0, middle: 2.5 };
    /// The low limit of that experiment.
    pub const EXPERIMENT_LOW: Limits = Limits { outer: 4.0, middle: 2.0 };

    /// Returns the limit of joint `joint`, counted from 0.
    pub fn of(&self, joint: usize) -> f64 {
        if super::posture::is_middle(joint) { self.middle } else { self.outer }
    }
}

/// The torque on one joint, in Nm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Torque {
    /// The worst case T^w.
    pub worst: f64,
    /// T^r with the force at the last pivot, as printed. 0 where the axis is parallel to gravity
    /// and the printed formula is 0/0.
    pub printed: f64,
    /// T^r with the force at the centre of mass: an upper bound below T^w.
    pub reasonable: f64,
    /// The exact static value.
    pub exact: f64,
    /// The same with its sign: positive if gravity turns the joint towards larger angles.
    pub signed: f64,
}

/// Returns the torques on all joints of a posture.
pub fn torques(kind: Kind, q: &[f64], load: &Load) -> Result<Vec<Torque>, KinematicsError> {
    let all = hemispheres(kind, q)?;
    let chain = Chain::of(kind);
    let motions = chain.motions(q);
    let v = load.gravity;
    let payload_at = motions[kind.joints()].compose(&chain.home).point(&load.payload_at);
    let last = all[all.len() - 1].origin;
    let result = chain.joints.iter().enumerate().map(|(i, joint)| {
        let u = motions[i].rotation * joint.axis;
        let pivot = motions[i].point(&joint.pivot);
        // Hemisphere h of a module lies beyond the first h of its joints.
        let beyond = all.iter().enumerate().filter(|(h, _)| h / 4 * 3 + h % 4 > i);
        let (mut mass, mut moment) = (load.payload, payload_at * load.payload);
        for (_, h) in beyond {
            mass += HEMISPHERE_MASS;
            moment += h.origin * HEMISPHERE_MASS;
        }
        let lever = moment / mass - pivot;
        let force = mass * GRAVITY * CELL_METRES;
        let across = u.cross(&v);
        let length = across.norm();
        let unit = |r: Vector3<f64>| if length > 1e-9 { r.dot(&across).abs() / length } else { 0.0 };
        Torque {
            worst: force * (lever - v * lever.dot(&v)).norm(),
            printed: force * unit(last - pivot),
            reasonable: force * unit(lever),
            exact: force * lever.dot(&across).abs(),
            signed: -force * lever.dot(&across),
        }
    });
    Ok(result.collect())
}

/// Returns the first joint, counted from 0, whose exact torque is above its limit.
pub fn overloaded(
    kind: Kind,
    q: &[f64],
    load: &Load,
    limits: &Limits,
) -> Result<Option<usize>, KinematicsError> {
    Ok(torques(kind, q, load)?.iter().enumerate().find(|(i, t)| t.exact > limits.of(*i)).map(|(i, _)| i))
}
