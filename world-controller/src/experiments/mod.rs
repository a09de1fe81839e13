//! Commands that do many runs: sweeps, exploration, published experiments, benchmarks.

pub(crate) mod bench;
pub mod diff;
pub mod explore;
pub mod reproduce;
pub mod sweep;
