//! The simulated network, and the parts that the worlds and directors of all families have in common.
//!
//! `kernel` drives agents of any protocol in virtual time, as a deterministic twin of the process link; `world` has the trait of
//! worlds and the invariants, `director` faults, commands, outcomes and the port between drivers and directors; `testing` has
//! agents for tests and benchmarks. Absent: agents and bodies of a family.

pub mod director;
pub mod kernel;
pub mod testing;
pub mod world;
