//! The command `metamorph` as a library.

pub mod robot;
