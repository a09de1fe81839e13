//! Invariants of rigid bodies, which a broken engine or an impossible command would violate.

use super::physics::{HEMISPHERES, NO_LOAD, Physics, TICK};
use metamorph_kernel::world::invariants::Invariant;
use metamorph_protocol::free_module::structure::{JOINTS, Joint, Structure};

/// Poses are finite numbers.
pub const POSE_FINITE: Invariant = Invariant::new("pose-finite");
/// No module is more than 10 mm below the floor.
pub const ABOVE_FLOOR: Invariant = Invariant::new("above-floor");
/// No joint is faster than 4 times its speed without load. Other motors may drive it faster than its own one would.
pub const JOINT_SPEED: Invariant = Invariant::new("joint-speed");
/// The kinetic energy stays below 50 J.
pub const KINETIC_ENERGY: Invariant = Invariant::new("kinetic-energy");

/// The least height in metres of the centre of a cube: its plates are 55 mm from the centre.
const LOWEST: f32 = 0.045;
/// The largest kinetic energy in joules.
const KINETIC_ENERGY_MAX: f32 = 50.0;
/// The largest speed of a joint, as a multiple of that without load.
const FASTEST: f32 = 4.0;

/// Checks the bodies after a tick, by the angles of all joints before it, and replaces these.
///
/// # Errors
/// Returns the first invariant that does not hold, with what was seen.
pub fn check(
    physics: &impl Physics,
    structure: &Structure,
    before: &mut [f32],
) -> Result<(), (Invariant, String)> {
    for module in structure.modules() {
        for h in 0..HEMISPHERES {
            let pose = physics.pose(module, h);
            if !pose.is_finite() {
                return Err((POSE_FINITE, format!("hemisphere {h} of module {module} is at {pose:?}")));
            }
            if pose.position[2] < LOWEST {
                let depth = 55.0 - 1000.0 * pose.position[2];
                return Err((ABOVE_FLOOR, format!("module {module} is {depth:.1} mm below the floor")));
            }
        }
        for j in 0..JOINTS {
            let joint = Joint::new(module, j);
            let angle = physics.angle(joint);
            let last = std::mem::replace(&mut before[joint.index()], angle);
            let speed = (angle - last).abs() / TICK.as_secs_f64() as f32;
            // A comparison that is false for NaN must not pass.
            if speed.is_nan() || speed > FASTEST * NO_LOAD[usize::from(j)] {
                return Err((JOINT_SPEED, format!("joint {joint} turns at {speed:.2} rad/s")));
            }
        }
    }
    let energy = physics.kinetic_energy();
    if energy.is_nan() || energy > KINETIC_ENERGY_MAX {
        return Err((KINETIC_ENERGY, format!("{energy:.1} J")));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::super::physics::Placed;
    use super::*;
    use metamorph_protocol::ids::ModuleId;
    use std::hash::Hasher;

    /// Bodies at rest that are wrong in one way.
    struct Broken {
        position: [f32; 3],
        angle: f32,
        energy: f32,
    }

    impl Physics for Broken {
        fn step(&mut self) {}
        fn set_target(&mut self, _: Joint, _: f32) {}
        fn angle(&self, _: Joint) -> f32 {
            self.angle
        }
        fn pose(&self, _: ModuleId, _: usize) -> Placed {
            Placed { position: self.position, rotation: [0.0, 0.0, 0.0, 1.0] }
        }
        fn centre_of_mass(&self) -> [f32; 3] {
            self.position
        }
        fn kinetic_energy(&self) -> f32 {
            self.energy
        }
        fn weight(&self) -> f32 {
            1.0
        }
        fn work(&self) -> Option<f64> {
            None
        }
        fn touches_floor(&self, _: ModuleId) -> bool {
            true
        }
        fn overlap(&self) -> f32 {
            0.0
        }
        fn digest(&self, _: &mut dyn Hasher) {}
    }

    #[test]
    fn each_invariant_fires() {
        let structure = Structure::new(1, &[]).unwrap();
        let found = |height, angle, energy| {
            let broken = Broken { position: [0.0, 0.0, height], angle, energy };
            check(&broken, &structure, &mut [0.0; 3]).err().map(|(invariant, _)| invariant)
        };
        assert_eq!(found(0.055, 0.01, 0.1), None);
        assert_eq!(found(f32::NAN, 0.0, 0.0), Some(POSE_FINITE));
        assert_eq!(found(0.044, 0.0, 0.0), Some(ABOVE_FLOOR));
        assert_eq!(found(0.055, 0.12, 0.0), Some(JOINT_SPEED));
        assert_eq!(found(0.055, f32::NAN, 0.0), Some(JOINT_SPEED));
        assert_eq!(found(0.055, 0.0, 51.0), Some(KINETIC_ENERGY));
        assert_eq!(found(0.055, 0.0, f32::NAN), Some(KINETIC_ENERGY));
    }
}
