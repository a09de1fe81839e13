//! The command `metamorph`.
fn main() {}
