//! Sliding cubes: their world, the director that owns their goals, and what is checked of them.

pub mod audit;
pub mod diagnosis;
pub mod director;

pub mod invariants;
pub mod reachability;
pub mod reasons;
pub mod world;
