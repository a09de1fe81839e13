//! The simulated world and the simulated network.
pub mod direct;
pub mod world;
