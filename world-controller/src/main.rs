//! The command `metamorph`. Everything it does is in the library.

use std::process::ExitCode;

/// The commit that the program is built from; empty outside of a repository.
const COMMIT: &str = git_version::git_version!(
    args = ["--always", "--exclude=*", "--abbrev=12", "--dirty=.changed"],
    fallback = ""
);

fn main() -> ExitCode {
    metamorph_text::version::set_commit(COMMIT);
    #[cfg(feature = "hosts")]
    metamorph_processes::swarm::keep_zenoh_on_one_thread();
    metamorph_world_controller::cli::dispatch::main(std::env::args_os())
}
