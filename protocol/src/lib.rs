//! Vocabulary and protocols of a self-reconfigurable swarm.
//!
//! This crate has no code of its own. It gives the crates below `protocol/` one name, so that a program depends on one
//! crate and finds the ids, units, lattice and messages that every part of Metamorph shares beside the protocols, which
//! are sans-IO state machines: inputs and the current time go in, outputs are polled out, and one call returns the next
//! wake-up time.
//!
//! None of them uses a clock, thread, socket, file or global randomness, or floating point in the state of an agent.

pub use metamorph_agents::{free_module, metamodule, on_grid};
pub use metamorph_core::{
    agent, counters, coverage, defects, digest, goal, host, ids, lattice, link, ratio, record, rng, runtime,
    shape, time, wire,
};
pub use metamorph_cube as cube;
pub use metamorph_host_link as host_link;
pub use metamorph_pairing as pairing;
pub use metamorph_planning::{assembly, manipulation, plan};
pub use metamorph_roombots as roombots;
