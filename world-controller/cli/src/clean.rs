//! The command `clean`.

use crate::host;
use crate::scenario_args::{HostsArg, hosts};
use clap::Args;
use metamorph_console::command::{CommandOf, Group};
use metamorph_console::terminal::print_out;
use metamorph_processes::run::processes;
use metamorph_text::command_error::Failure;

/// Examples for the help.
const EXAMPLES: &str = "\
Removes shared memory, files and stopped processes of this user's runs whose controller was killed.
Active runs are not touched. The next `metamorph run` does the same.

Exit codes:
  0  nothing is left behind
  1  something could not be removed";

/// Arguments of `clean`.
#[derive(Debug, Args)]
pub struct CleanArgs {
    /// Have the daemons of this hosts file clean their hosts, too
    #[arg(long, value_name = "FILE", value_parser = hosts)]
    pub hosts: Option<HostsArg>,
}

fn clean(args: &CleanArgs) -> Result<u8, Failure> {
    print_out(&processes::clean_up()?);
    args.hosts.as_ref().map_or(Ok(0), host::clean)
}

/// The command.
pub static COMMAND: CommandOf<CleanArgs> = CommandOf {
    name: "clean",
    group: Some(Group::Machine),
    about: "Remove what killed runs left behind",
    after_help: || EXAMPLES.to_owned(),
    execute: |args, _| clean(&args),
};
