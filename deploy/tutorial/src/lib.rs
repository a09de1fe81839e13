//! A protocol outside the crates of the runtime: see README.md of this crate.
//!
//! [`leader`] is the protocol, [`family`] says when a run is over, what must hold, and how to show it.

pub mod family;
pub mod leader;
