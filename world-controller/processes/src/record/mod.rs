//! Journals of runs: writing, reading and joining their parts.

pub mod journal;
pub mod tee;
