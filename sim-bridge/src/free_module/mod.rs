//! Free modules: off the grid a world of fixed connections, with rigid bodies if wanted, the director that hands out a gait,
//! and trials of gaits; [`reconfiguration`] on the lattice.

pub mod audit;
pub mod director;
mod falls;
mod floor;
pub mod hull;
pub mod members;
pub mod physics;
pub mod physics_world;
pub mod rapier;
#[cfg(test)]
mod rapier_tests;
pub mod reconfiguration;
pub mod structure_world;
#[cfg(test)]
mod tests;
pub mod trial;
#[cfg(test)]
mod trial_tests;
pub mod walking;
pub mod work;
