//! The other process of a measurement: `metamorph bench-part ROLE ...`, started by `bench` only.

use super::wire::{self, Mechanism, Mode};
use super::{BenchError, busy, flood};
use metamorph_console::terminal::print_data;
use metamorph_module_agent::process::args::ArgsError;
use metamorph_module_agent::{AgentArgs, AgentError, run};
use metamorph_processes::run::processes::ProcessError;
use metamorph_sim_bridge::testing::flood::Flooded;
use metamorph_text::command_error::CommandError;
use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::process::{Child, Command, Stdio};
use thiserror::Error;

/// The hidden subcommand.
pub const SUBCOMMAND: &str = "bench-part";
/// The role of an agent of a swarm.
pub const AGENT: &str = "agent";

/// Why a part failed.
#[derive(Debug, Error)]
pub enum PartError {
    /// Not started by `bench`.
    #[error("bench-part is started by `metamorph bench` only")]
    Role,
    /// The measurement failed.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// The arguments of an agent are invalid.
    #[error(transparent)]
    Args(#[from] ArgsError),
    /// The agent failed.
    #[error(transparent)]
    Agent(#[from] AgentError),
}

impl CommandError for PartError {}

/// Runs a part.
pub fn part(args: &[OsString]) -> Result<(), PartError> {
    // A part must not outlive its measurement.
    let _ = rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::KILL));
    let texts: Vec<&str> = args.iter().filter_map(|a| a.to_str()).collect();
    match texts.as_slice() {
        ["flood", side] => {
            let row = flood::row(side.parse().map_err(|_| PartError::Role)?)?;
            print_data(&serde_json::to_string(&row).map_err(|_| PartError::Role)?);
            Ok(())
        }
        ["echo", mechanism, mode, root] => {
            let mechanism = Mechanism::named(mechanism).ok_or(PartError::Role)?;
            let mode = Mode::named(mode).ok_or(PartError::Role)?;
            Ok(wire::echo(mechanism, mode, root)?)
        }
        ["ring", mechanism, root, id, next] => {
            let mechanism = Mechanism::named(mechanism).ok_or(PartError::Role)?;
            let number = |text: &str| text.parse().map_err(|_| PartError::Role);
            Ok(busy::member(mechanism, root, number(id)?, number(next)?)?)
        }
        [AGENT, ..] => Ok(run::<Flooded>(&AgentArgs::parse(args[1..].iter().cloned())?)?),
        _ => Err(PartError::Role),
    }
}

/// Returns the command for a process that runs a part.
pub fn command(args: &[&str]) -> Result<Command, BenchError> {
    let program = std::env::current_exe().map_err(ProcessError::Program)?;
    let mut command = Command::new(program);
    // Ctrl-C must only reach the measurement, which ends its parts.
    command.arg(SUBCOMMAND).args(args).stdin(Stdio::null()).process_group(0);
    Ok(command)
}

/// Runs a part, and returns its output.
pub fn output(args: &[&str]) -> Result<String, BenchError> {
    let output = command(args)?.stderr(Stdio::inherit()).output();
    let output = output.map_err(|e| BenchError::System("start another process of this program", e))?;
    if !output.status.success() {
        return Err(BenchError::Part(format!("ended with {}", output.status)));
    }
    String::from_utf8(output.stdout).map_err(|_| BenchError::Part("said no text".to_owned()))
}

/// A child process that is killed and waited for when dropped.
pub struct Peer(pub Child);

impl Drop for Peer {
    fn drop(&mut self) {
        // It has ended by itself unless an error occurred.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
