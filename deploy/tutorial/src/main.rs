//! The command `metamorph` with one more family: elections.

use metamorph_tutorial::family::ELECTION;
use metamorph_world_controller::{cli, family};
use std::process::ExitCode;

fn main() -> ExitCode {
    family::install(&[&ELECTION]).expect("invariant: nothing was read before");
    cli::dispatch::main(std::env::args_os())
}
