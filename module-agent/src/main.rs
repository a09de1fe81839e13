//! One agent as a process: `module-agent FAMILY ARGS` does what `metamorph agent` does, on a machine that
//! only hosts agents. Not here: anything but the command line and the exit code.

use metamorph_module_agent::registry;
use std::fmt::Display;
use std::process::ExitCode;

fn main() -> ExitCode {
    let (family, args) = match registry::parse(std::env::args_os().skip(1)) {
        Ok(parsed) => parsed,
        Err(error) => return fail(&error, 2),
    };
    match family.run(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => fail(&error, error.exit_code()),
    }
}

fn fail(error: &dyn Display, code: u8) -> ExitCode {
    #[allow(clippy::print_stderr, reason = "the supervisor keeps it for its report")]
    {
        eprintln!("module-agent: {error}");
    }
    ExitCode::from(code)
}
