//! Walking structures: the director, the choice of gaits while they walk, and reasons for a standstill.

pub mod director;
pub mod goal;
mod measure;
pub mod reasons;
pub mod tuner;
