//! Sliding cubes: their world, the director of their goals, and their invariants.

pub mod audit;
pub mod bodies;
mod calls;
mod custody_audit;
pub mod diagnosis;
pub mod director;
mod global_plan;
pub mod invariants;
pub mod reachability;
pub mod reasons;
#[cfg(test)]
mod recording_tests;
pub mod registrar;
mod sequential_plan;
pub mod world;
