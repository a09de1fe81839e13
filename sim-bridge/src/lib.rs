//! Simulated worlds and the directors of the world-controller, by family: `cube`, `metamodule` and `free_module`.
//!
//! All families have `kernel`, `world` and `director` in common, which are a crate of their own and keep their paths here.

pub mod connections;
pub mod cube;
pub mod free_module;
pub mod metamodule;

pub use metamorph_kernel::{director, kernel, testing, world};
