//! Tests of the program that need nothing of other crates; the rest is in `tests/`.

mod binary;
mod robot;
