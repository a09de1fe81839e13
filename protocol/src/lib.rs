//! Vocabulary and protocols of a self-reconfigurable swarm.
//!
//! This crate holds the ids, units, lattice and messages that every part of Metamorph shares, and the protocols
//! themselves as sans-IO state machines: inputs and the current time go in, outputs are polled out, and one call
//! returns the next wake-up time.
//!
//! It uses no clock, thread, socket, file or global randomness, and no floating point in the state of an agent.

pub mod free_module;
pub mod metamodule;
pub mod on_grid;

pub use metamorph_core::{
    agent, counters, coverage, defects, digest, goal, host, ids, lattice, link, ratio, record, rng, runtime,
    shape, time, wire,
};
pub use metamorph_cube as cube;
pub use metamorph_host_link as host_link;
pub use metamorph_pairing as pairing;
pub use metamorph_planning::{assembly, manipulation, plan};
pub use metamorph_roombots as roombots;
