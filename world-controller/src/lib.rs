//! The world-controller: launches a swarm, owns its world, injects failures, measures.

pub mod robot;
pub mod swarm;
