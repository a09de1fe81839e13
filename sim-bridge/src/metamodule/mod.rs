//! Metamodules of Roombots: their world, the director that owns their goals, and what is checked of them.

pub mod audit;
pub mod director;
pub mod invariants;
pub mod reasons;
pub mod relocation;
pub mod world;
