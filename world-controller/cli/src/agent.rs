//! The command `agent`: one agent process, started by `run`.

use clap::Args;
use metamorph_console::command::CommandOf;
use metamorph_processes::family;
use std::ffi::OsString;

/// Arguments of an agent process.
#[derive(Debug, Args)]
pub struct AgentArgs {
    /// Passed on unchanged.
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    pub args: Vec<OsString>,
}

/// The command.
pub static COMMAND: CommandOf<AgentArgs> = CommandOf {
    name: "agent",
    group: None,
    about: "One agent process; started by `run`",
    after_help: String::new,
    execute: |args, _| family::agent(&args.args).map(|()| 0).map_err(Into::into),
};
