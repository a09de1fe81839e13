//! Reconfiguration of free modules on the lattice: their world, and the director that plans and orders.

pub mod audit;
pub mod director;
pub mod invariants;
mod plan_execution;
pub mod reasons;
#[cfg(test)]
mod tests;
pub mod world;
