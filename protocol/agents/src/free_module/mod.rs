//! Free Roombots modules: off-grid locomotion, and [`reconfiguration`] on the lattice.
//!
//! Locomotion has structures, body and limbs, and networks of oscillators.
//! A [`structure`] is a graph of modules with connectors; [`geometry`] places it in space. [`limbs`] divides it into
//! body and limbs, [`network`] puts oscillators on joints and couples them, [`symmetry`] finds limbs that share
//! parameters; [`oscillator`] moves joints. Everything but `geometry` is integers in a fixed order, so that every agent
//! that knows the same structure computes the same network.
//!
//! Citations are to S. Bonardi, EPFL thesis, 2014, chapter 7.

pub mod gait;
pub mod geometry;
pub mod graph;
pub mod lattice;
pub mod limbs;
pub mod named;
pub mod network;
pub mod oscillator;
pub mod reconfiguration;
pub mod structure;
pub mod symmetry;
