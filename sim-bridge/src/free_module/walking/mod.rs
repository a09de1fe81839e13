//! Walking structures: the director, the choice of gaits while they walk, and reasons for a standstill.

pub mod director;
mod measure;
pub mod reasons;
pub mod tuner;
