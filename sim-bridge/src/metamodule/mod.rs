//! Metamodules of Roombots: their world, the director of their goals, and their invariants.

pub mod audit;
pub mod director;
pub mod faults;
pub mod invariants;
pub mod reasons;
pub mod relocation;
pub mod world;
