//! The command `metamorph`. Everything it does is in the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    metamorph_world_controller::cli::dispatch::main(std::env::args_os())
}
