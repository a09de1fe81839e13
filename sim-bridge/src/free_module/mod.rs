//! Free modules: off the grid a world of fixed connections, with rigid bodies if wanted, the director that hands out a gait,
//! and trials of gaits; [`reconfiguration`] on the lattice.

pub mod audit;
pub mod director;
mod falls;
pub mod members;
pub mod physics_world;
pub mod reconfiguration;
pub mod structure_world;
#[cfg(test)]
mod tests;
pub mod trial;
#[cfg(feature = "physics")]
#[cfg(test)]
mod trial_tests;
pub mod walking;

pub use metamorph_physics as physics;
pub use metamorph_physics::engine as rapier;
pub use metamorph_physics::hull;
#[cfg(feature = "physics")]
pub use metamorph_physics::work;
