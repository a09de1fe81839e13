//! Grips off the lattice: how a cube changes its colour.
//!
//! With lattice angles an element keeps its colour ([`super::colour`]). A metamodule that holds a cube in a lattice posture
//! can put it down in a cell of the other colour by angles between: [`arm`] has the body and what it may touch, [`connect`]
//! the motions, and [`change`] the places where a cube changes its colour, and whole plans with one such change. Floats are
//! used here; agents have none, so such plans are made by the controller.

pub mod arm;
pub mod change;
pub mod connect;
#[cfg(test)]
mod tests;
