//! One probe as a process, as the tests of the process driver start it; with `host` the daemon of a host of probes.

use metamorph_module_agent::{AgentArgs, run};
use metamorph_tests::probe::Probe;
use metamorph_world_controller::console::shutdown::Shutdown;
use metamorph_world_controller::swarm::{Address, DaemonOptions, MODULE_LIMIT, daemon};
use std::error::Error;
use std::ffi::OsString;
use std::path::Path;
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
    let args: Vec<OsString> = std::env::args_os().collect();
    if let [_, host, once, listen, socket] = &args[..]
        && host == "host"
        && once == "--once"
        && listen == "--listen"
    {
        let agents = |_: &str| Some((std::env::current_exe().ok()?, Vec::new()));
        let address = Address::unix(Path::new(socket))?;
        let (identity, most, shutdown) = (None, MODULE_LIMIT as u32, Shutdown::new());
        return Ok(daemon(
            &DaemonOptions { build: 0, address, identity, most, once: true, agents, metrics: None, shutdown },
            || (),
        )?);
    }
    Ok(run::<Probe>(&AgentArgs::parse(std::env::args_os().skip(1))?)?)
}
