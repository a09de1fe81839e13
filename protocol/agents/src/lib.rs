//! The agents of Roombots: metamodules that build a goal, and free modules that walk or change their structure.
//!
//! Each agent is a sans-IO state machine ([`metamorph_core::agent::Agent`]). [`on_grid`] has planners of one module on a
//! floor with obstacles.

pub mod free_module;
pub mod metamodule;
pub mod on_grid;
