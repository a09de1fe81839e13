//! Rigid bodies of free modules: hemispheres, motors at joints, a floor, and the physics engine that moves them.
//!
//! Lengths are in metres, angles in radians, z points up and the floor is z = 0. An implementation of [`Physics`] gives the
//! same bits on every machine for the same calls. [`engine::Bodies`] is the one of the engine rapier3d. Without the feature
//! `rapier` it refuses every structure with [`PhysicsError::NoEngine`], so that no run of bodies begins.

#[cfg_attr(feature = "rapier", path = "rapier.rs")]
#[cfg_attr(not(feature = "rapier"), path = "absent.rs")]
pub mod engine;
#[cfg(feature = "rapier")]
mod floor;
pub mod hull;
#[cfg(feature = "rapier")]
#[cfg(test)]
mod rapier_tests;
#[cfg(feature = "rapier")]
pub mod work;

use metamorph_protocol::free_module::geometry::GeometryError;
use metamorph_protocol::free_module::structure::Joint;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::time::Span;
use std::fmt;
use std::hash::Hasher;
use std::str::FromStr;
use thiserror::Error;

/// Time between two states of the engine: 10 ms.
pub const TICK: Span = Span::millis(10);
/// Speed without load of q1, q2, q3 in rad/s: 26.6, 19.4 and 26.6 turns a minute (thesis table 2.1).
pub const NO_LOAD: [f32; 3] = [2.785_546, 2.031_563, 2.785_546];
/// Largest torque of q1, q2, q3 in Nm (thesis table 2.1).
pub const TORQUE: [f32; 3] = [4.9, 3.6, 4.9];
/// Speed command of a motor per error of its angle, 1/s.
pub const SERVO_GAIN: f32 = 10.0;
/// Friction between plates, and between plates and floor, unless a run says otherwise.
pub const FRICTION: f32 = 0.8;
/// Number of hemispheres of a module.
pub const HEMISPHERES: usize = 4;

/// A position and a unit quaternion (x, y, z, w).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placed {
    /// The centre of the cube that the hemisphere belongs to.
    pub position: [f32; 3],
    /// The rotation of its frame.
    pub rotation: [f32; 4],
}

impl Placed {
    /// Returns true if all numbers are finite.
    pub fn is_finite(&self) -> bool {
        self.position.iter().chain(&self.rotation).all(|x| x.is_finite())
    }
}

/// Bodies of a structure on a floor.
pub trait Physics {
    /// Advances by [`TICK`].
    fn step(&mut self);
    /// Sets the angle that the motor of a joint moves to, and holds.
    fn set_target(&mut self, joint: Joint, angle: f32);
    /// Returns the angle of a joint. It counts turns and does not wrap.
    fn angle(&self, joint: Joint) -> f32;
    /// Returns the pose of hemisphere 0 to 3 of a module.
    fn pose(&self, module: ModuleId, hemisphere: usize) -> Placed;
    /// Returns the centre of mass of all modules.
    fn centre_of_mass(&self) -> [f32; 3];
    /// Returns the kinetic energy of all bodies in joules.
    fn kinetic_energy(&self) -> f32;
    /// Returns the weight of all modules in newtons.
    fn weight(&self) -> f32;
    /// Returns the work of all motors since the start in joules; `None` if it is not known.
    fn work(&self) -> Option<f64>;
    /// Returns true if a module touches the floor.
    fn touches_floor(&self, module: ModuleId) -> bool;
    /// Returns the depth in metres of the deepest overlap of two modules; 0 if there is none.
    fn overlap(&self) -> f32;
    /// Feeds the bits of all poses and angles into a hash.
    fn digest(&self, hasher: &mut dyn Hasher);
}

/// The direction of the first module's foot frame that points to the floor at the start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Down {
    /// 0, 1, 2 for x, y, z.
    pub axis: usize,
    /// True if the negative direction points down.
    pub negative: bool,
}

impl Down {
    /// -y: the named structures are flat and lie on the floor.
    pub const DEFAULT: Down = Down { axis: 1, negative: true };
}

/// A direction that is none.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("`{0}` is not a direction; write one of +x, -x, +y, -y, +z, -z")]
pub struct NotADirection(String);

impl FromStr for Down {
    type Err = NotADirection;

    fn from_str(text: &str) -> Result<Down, NotADirection> {
        let wrong = || NotADirection(text.to_owned());
        let (sign, axis) = text.split_at_checked(1).ok_or_else(wrong)?;
        let axis = ["x", "y", "z"].iter().position(|a| *a == axis).ok_or_else(wrong)?;
        match sign {
            "+" => Ok(Down { axis, negative: false }),
            "-" => Ok(Down { axis, negative: true }),
            _ => Err(wrong()),
        }
    }
}

impl fmt::Display for Down {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", if self.negative { '-' } else { '+' }, ["x", "y", "z"][self.axis])
    }
}

/// Why bodies cannot be made of a structure.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PhysicsError {
    /// The structure has no place in space.
    #[error(transparent)]
    Geometry(#[from] GeometryError),
    /// The friction is negative or not a number.
    #[error("friction {0} is not a number of at least 0")]
    Friction(f32),
    /// The program has no physics engine.
    #[error("bodies need the feature `physics`, which this program was built without")]
    NoEngine,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_go_there_and_back() {
        for text in ["+x", "-x", "+y", "-y", "+z", "-z"] {
            assert_eq!(text.parse::<Down>().unwrap().to_string(), text);
        }
        for wrong in ["", "y", "-w", "*y", "--y", "ä"] {
            assert!(wrong.parse::<Down>().is_err(), "{wrong}");
        }
    }
}
