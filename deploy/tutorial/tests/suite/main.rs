//! The tests of the tutorial: one program, so that it is linked once.

mod family;
mod tutorial;
mod twin;
