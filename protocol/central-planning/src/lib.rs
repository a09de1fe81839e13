//! Central planning for all metamodules of a swarm: the moves of all until a goal is built, the transports of
//! elements, and the order in which the parts of a goal can be assembled.
//!
//! It stands above the agents, whose poses and searches it uses. No agent calls it.

pub mod assembly_order;
pub mod bundles;
pub mod centralized;
pub mod transport;
pub mod transports;
