//! The command `metamorph`. Everything it does is in the library.

use std::process::ExitCode;

fn main() -> ExitCode {
    #[cfg(feature = "hosts")]
    metamorph_processes::swarm::keep_zenoh_on_one_thread();
    metamorph_world_controller::cli::dispatch::main(std::env::args_os())
}
