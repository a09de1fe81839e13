//! The command `metamorph` with one more family.

mod family;
mod leader;

use family::ELECTION;
use metamorph_world_controller::{cli, family as families};
use std::process::ExitCode;

fn main() -> ExitCode {
    families::install(&[&ELECTION]).expect("invariant: nothing was read before");
    cli::dispatch::main(std::env::args_os())
}
