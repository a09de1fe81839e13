//! Simulated worlds, the simulated network, and the directors of the world-controller.
//!
//! `kernel` drives agents in virtual time. `world` and `director` hold what the worlds and directors of all
//! families have in common; `cube`, `metamodule` and
//! `free_module` those of one family each.

pub mod cube;
pub mod director;
pub mod free_module;
pub mod kernel;
pub mod metamodule;
pub mod testing;
pub mod world;
