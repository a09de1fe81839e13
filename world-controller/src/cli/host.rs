//! The command `host`: the daemon of one host of a swarm.

use crate::console::command_error::{CommandError, Failure};
use crate::console::interrupt::Interrupt;
use crate::console::shutdown::Shutdown;
use crate::console::terminal::print_error;
use crate::family;
use crate::swarm::{DaemonError, DaemonOptions, build, daemon};
use clap::Args;
use std::ffi::OsString;
use std::path::PathBuf;

/// Examples for the help.
pub const EXAMPLES: &str = "\
Examples:
  metamorph host --listen /run/user/1000/h2.sock
  metamorph run deploy/scenarios/swarm.toml --hosts hosts.toml

The daemon serves one run after another until Ctrl-C or SIGTERM. In hosts.toml:

  version = 1
  [[host]]
  name = \"h1\"                                 # where `metamorph run` is
  address = \"local\"
  [[host]]
  name = \"h2\"
  address = \"unix:/run/user/1000/h2.sock\"

`metamorph run SCENARIO --hosts N` starts N-1 daemons by itself.";

/// Arguments of `host`.
#[derive(Debug, Args)]
pub struct HostArgs {
    /// The socket on which controllers and the daemons of other hosts connect; it must not be in use. Access is
    /// controlled by the permissions of its directory
    #[arg(long, value_name = "PATH")]
    pub listen: PathBuf,
    /// End after one run, or with the process that started this one
    #[arg(long, hide = true)]
    pub once: bool,
}

impl CommandError for DaemonError {}

/// Serves runs until a signal asks the daemon to end.
pub fn host(args: HostArgs, interrupt: &Interrupt) -> Result<u8, Failure> {
    let shutdown = Shutdown::new();
    interrupt.begin();
    interrupt.pass_on(&shutdown);
    if !args.once {
        print_error(&format!("listening on {}; Ctrl-C ends it", args.listen.display()));
    }
    daemon(&DaemonOptions { build: build(), socket: args.listen, once: args.once, agents, shutdown })?;
    Ok(0)
}

/// Returns the command line of the agents of a family.
fn agents(family: &str) -> Option<(PathBuf, Vec<OsString>)> {
    let name = family::named(family)?.name();
    Some((std::env::current_exe().ok()?, vec!["agent".into(), "--".into(), name.into()]))
}
