//! One probe as a process, as the tests of the process driver start it.

use metamorph_module_agent::{AgentArgs, run};
use metamorph_tests::probe::Probe;
use std::error::Error;
use std::process::ExitCode;

fn main() -> ExitCode {
    match try_main() {
        Ok(()) => ExitCode::SUCCESS,
        Err(e) => {
            #[allow(clippy::print_stderr, reason = "the supervisor keeps it for its report")]
            {
                eprintln!("{e}");
            }
            ExitCode::FAILURE
        }
    }
}

fn try_main() -> Result<(), Box<dyn Error>> {
    Ok(run::<Probe>(&AgentArgs::parse(std::env::args_os().skip(1))?)?)
}
