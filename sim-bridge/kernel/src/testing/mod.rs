//! Agents and worlds that exist for tests and benchmarks.

pub mod flood;
