//! Vocabulary of a self-reconfigurable swarm, for every agent, driver and planner.
//!
//! It has the ids, units and lattice, the [`agent::Agent`] trait that every protocol implements, the host that carries an
//! agent, the wire layout and the model of links. Agents are sans-IO state machines: inputs and the current time go in,
//! outputs are polled out, and one call returns the next wake-up time.
//!
//! It needs no operating system, only an allocator. The feature `std`, on by default, adds the coverage points of an
//! exploration, and lets check sums use what the processor has. No result depends on it.

#![cfg_attr(not(test), no_std)]

extern crate alloc;
#[cfg(feature = "std")]
extern crate std;

pub mod agent;
pub mod counters;
pub mod coverage;
pub mod defects;
pub mod digest;
pub mod goal;
pub mod host;
pub mod ids;
pub mod latency;
pub mod lattice;
pub mod link;
mod names;
pub mod ratio;
pub mod record;
pub mod rng;
pub mod runtime;
pub mod shape;
pub mod time;
pub mod wire;
