//! The simulated world and the simulated network.
pub mod world;
