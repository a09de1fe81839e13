//! The place of the engine in a program without one: bodies that cannot be made.

use crate::{Down, Physics, PhysicsError, Placed};
use metamorph_protocol::free_module::structure::{Joint, Structure};
use metamorph_protocol::ids::ModuleId;
use std::hash::Hasher;

/// The name of the engine, as gait files have it.
pub const ENGINE: &str = "none";

/// The bodies of a structure: none, as there is no engine.
pub enum NoBodies {}

/// The bodies that the program's engine moves.
pub type Bodies = NoBodies;

impl NoBodies {
    /// Refuses every structure.
    ///
    /// # Errors
    /// Always, with [`PhysicsError::NoEngine`].
    pub fn new(_: &Structure, _: &[[f64; 3]], _: Down, _: f32) -> Result<NoBodies, PhysicsError> {
        Err(PhysicsError::NoEngine)
    }
    /// Lets the floor rise towards +x by an angle in radians.
    pub fn tilt(&mut self, _: f32) {
        match *self {}
    }
}

impl Physics for NoBodies {
    fn step(&mut self) {
        match *self {}
    }
    fn set_target(&mut self, _: Joint, _: f32) {
        match *self {}
    }
    fn angle(&self, _: Joint) -> f32 {
        match *self {}
    }
    fn pose(&self, _: ModuleId, _: usize) -> Placed {
        match *self {}
    }
    fn centre_of_mass(&self) -> [f32; 3] {
        match *self {}
    }
    fn kinetic_energy(&self) -> f32 {
        match *self {}
    }
    fn weight(&self) -> f32 {
        match *self {}
    }
    fn work(&self) -> Option<f64> {
        match *self {}
    }
    fn touches_floor(&self, _: ModuleId) -> bool {
        match *self {}
    }
    fn overlap(&self) -> f32 {
        match *self {}
    }
    fn digest(&self, _: &mut dyn Hasher) {
        match *self {}
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::free_module::named;

    #[test]
    fn every_structure_is_refused() {
        let structure = named::structure("quad5-sym").unwrap();
        let refused = NoBodies::new(&structure, &[[0.0; 3]; 5], Down::DEFAULT, 0.8);
        assert_eq!(refused.err(), Some(PhysicsError::NoEngine));
    }
}
