//! The command `cluster`: the daemons on all machines of a hosts file at once. They are started over `ssh`, or as steps of a job
//! of SLURM. Not here: what a daemon does (`host`).

mod slurm;
mod ssh;

use crate::host;
use clap::{Args, ValueEnum};
use metamorph_console::command::{CommandOf, Group};
use metamorph_console::stopwatch::wait_until;
use metamorph_console::terminal::print_out;
use metamorph_processes::swarm::{
    Address, HostsFile, HostsFileError, KeysError, ReachError, Survey, build, renew_keys,
};
use metamorph_protocol::ids::HostId;
use metamorph_text::command_error::{CommandError, FAILED, Failure};
use metamorph_text::escape::Shown;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Duration;
use thiserror::Error;

/// Examples for the help.
const EXAMPLES: &str = "\
Examples:
  metamorph cluster up hosts.toml              (keys, program and daemon on each machine, over ssh)
  metamorph cluster up hosts.toml --metrics 9100
  metamorph run swarm --hosts hosts.toml
  metamorph cluster status hosts.toml
  metamorph cluster logs hosts.toml
  metamorph cluster down hosts.toml
  metamorph cluster up --slurm hosts.toml      (within a job of SLURM: the file is written)

`up` does what is missing, and nothing to a daemon that runs: it makes keys in the directory that the hosts file
names, copies to each machine its own, and this program if another one is there, and starts the daemon. Over ssh it
uses ~/.local/share/metamorph/cluster/NAME there, and the machine of the address, or `ssh = \"user@machine\"` of the
host. ssh must ask for nothing: use keys and an agent.

The key of the authority, DIR.ca.key beside the directory of the keys, stays on this machine, readable by you only. With it
`up` gives certificates to hosts that are new, that have moved, or whose certificates are valid for less than a
third of --days; the other hosts keep theirs, and runs go on. A daemon takes a new certificate when it is started.

With --slurm the nodes of the job but this one become h2, h3 and so on, each with a daemon at a free port that is a
step of the job (srun). Programs and keys have to be on a file system of all nodes.";

/// Longest time to wait for daemons that were started.
const START_WAIT_MAX: Duration = Duration::from_secs(30);

/// An action on all machines.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Action {
    /// Start the daemons
    Up,
    /// Say what each daemon does, and its room
    Status,
    /// Print the ends of their logs
    Logs,
    /// End the daemons, and with them their shares of runs
    Down,
}

/// Arguments of `cluster`.
#[derive(Debug, Args)]
pub struct ClusterArgs {
    /// The action
    #[arg(value_name = "ACTION", value_enum)]
    pub action: Action,
    /// The hosts file
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Start the daemons as steps of the job of SLURM in which this is run, and write FILE; default: over ssh
    #[arg(long)]
    pub slurm: bool,
    /// How long certificates are valid that are made
    #[arg(long, value_name = "DAYS", default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=3650))]
    pub days: u32,
    /// Lines of each log
    #[arg(long, value_name = "N", default_value_t = 20)]
    pub lines: u32,
    /// Serve the metrics of each daemon that `up` starts at this port of its machine; default: nowhere
    #[arg(long, value_name = "PORT")]
    pub metrics: Option<u16>,
}

/// Why daemons cannot be started, asked or ended.
#[derive(Debug, Error)]
pub enum ClusterError {
    /// The hosts file.
    #[error(transparent)]
    File(#[from] HostsFileError),
    /// Keys.
    #[error(transparent)]
    Keys(#[from] KeysError),
    /// The daemons are not reached.
    #[error(transparent)]
    Reach(#[from] ReachError),
    /// The hosts are sockets of this machine.
    #[error("{}: {host} has a socket of this machine\n  fix: give each host but h1 an address on the network, such as 10.0.0.2:7447", .file.shown())]
    Socket {
        /// The host.
        host: HostId,
        /// The hosts file.
        file: PathBuf,
    },
    /// A command cannot be started here.
    #[error("`{0}` cannot be started: {1}\n  fix: install it, and see that it is in PATH")]
    Start(&'static str, io::Error),
    /// A command on a machine fails.
    #[error("{host} ({machine}): {what} fails: {why}\n  fix: {fix}")]
    Machine {
        /// The host.
        host: HostId,
        /// Its machine.
        machine: String,
        /// The step that fails.
        what: &'static str,
        /// The cause.
        why: String,
        /// The remedy.
        fix: &'static str,
    },
    /// A file cannot be read or written.
    #[error("{}: {error}", .path.shown())]
    Io {
        /// The file.
        path: PathBuf,
        /// The cause.
        error: io::Error,
    },
    /// Two daemons on one machine are to serve metrics at one port.
    #[error(
        "--metrics: {0} and {1} are on one machine, {2}, where one port serves one of them\n  fix: leave --metrics out, or start one of the daemons yourself with `metamorph host --metrics`"
    )]
    OnePort(HostId, HostId, String),
    /// There is no job.
    #[error(
        "--slurm: this is not within a job of SLURM, since {0} is not set\n  fix: use salloc or sbatch, and give the command there"
    )]
    NoJob(&'static str),
    /// SLURM does not say what is needed.
    #[error("--slurm: {0}")]
    Slurm(String),
    /// Another cluster uses the file.
    #[error("{}: the file is there\n  fix: `metamorph cluster down` ends its daemons and removes what --slurm has written; or name another file", .0.shown())]
    There(PathBuf),
}

impl CommandError for ClusterError {}

/// Executes the action, and returns the exit code.
fn cluster(args: &ClusterArgs) -> Result<u8, ClusterError> {
    let ClusterArgs { action, file, slurm, days, lines, metrics } = args;
    let valid = Duration::from_secs(u64::from(*days) * 86_400);
    if *slurm && *action == Action::Up {
        print_out(&slurm::up(file, valid, *metrics)?.join("\n"));
        return status(file, START_WAIT_MAX);
    }
    let of_slurm = slurm::Steps::read(file);
    match (action, of_slurm) {
        (Action::Status, _) => status(file, Duration::ZERO),
        (Action::Logs, Some(steps)) => Ok(said(&steps.logs(*lines)?)),
        (Action::Down, Some(steps)) => Ok(said(&steps.down()?)),
        (Action::Up, Some(_)) => Err(ClusterError::There(file.clone())),
        (action, None) => {
            let hosts = HostsFile::read(file)?;
            let machines = ssh::machines(file, &hosts, *metrics)?;
            match action {
                Action::Up => {
                    for renewed in keys(&hosts, valid)? {
                        print_out(&format!("{renewed}: a new certificate, in {}", directory(&hosts).shown()));
                    }
                    print_out(&ssh::on_all(&machines, |machine| machine.up(&directory(&hosts)))?.join("\n"));
                    status(file, START_WAIT_MAX)
                }
                Action::Logs => Ok(said(&ssh::on_all(&machines, |machine| machine.log(*lines))?)),
                _ => Ok(said(&ssh::on_all(&machines, ssh::Machine::down)?)),
            }
        }
    }
}

fn said(lines: &[String]) -> u8 {
    print_out(&lines.join("\n"));
    0
}

/// Returns the directory of the keys.
fn directory(hosts: &HostsFile) -> PathBuf {
    // Invariant: hosts on a network have keys.
    hosts.keys.clone().unwrap_or_default()
}

/// Makes all keys, or those that are missing or end soon. Returns the hosts with new ones.
fn keys(hosts: &HostsFile, valid: Duration) -> Result<Vec<HostId>, ClusterError> {
    let (directory, machines) = (directory(hosts), host::machines(hosts));
    if directory.exists() {
        return Ok(renew_keys(&directory, &machines, valid)?);
    }
    metamorph_processes::swarm::make_keys(&directory, &machines, valid)?;
    Ok(machines.into_iter().map(|(host, _)| host).collect())
}

/// Says what each daemon does. Daemons that were just started get some time to listen.
fn status(file: &Path, patience: Duration) -> Result<u8, ClusterError> {
    let hosts = HostsFile::read(file)?;
    let survey = Survey::new(&hosts, build())?;
    let (mut lines, mut all) = survey.check(&[]);
    let is_awaited = |lines: &[String]| lines.iter().any(|line| line.contains("no connection"));
    wait_until(patience, || {
        if is_awaited(&lines) {
            (lines, all) = survey.check(&[]);
        }
        !is_awaited(&lines)
    });
    print_out(&lines.join("\n"));
    Ok(if all { 0 } else { FAILED })
}

/// Returns the options of a daemon on a machine that serve its metrics at a port.
fn metrics_of(machine: &str, port: Option<u16>) -> Vec<String> {
    let address = port.map(|port| Address::Net { machine: machine.to_owned(), port }.to_string());
    address.map_or(Vec::new(), |address| vec!["--metrics".to_owned(), address])
}

/// Returns the machine and the port of an address on a network.
fn on_network(file: &Path, host: HostId, address: &Address) -> Result<(String, u16), ClusterError> {
    match address {
        Address::Net { machine, port } => Ok((machine.clone(), *port)),
        Address::Unix(_) => Err(ClusterError::Socket { host, file: file.to_owned() }),
    }
}

/// The command.
pub static COMMAND: CommandOf<ClusterArgs> = CommandOf {
    name: "cluster",
    group: Some(Group::Machine),
    about: "Start, ask and end the daemons on all machines of a hosts file, over ssh or in a job of SLURM",
    after_help: || EXAMPLES.to_owned(),
    execute: |args, _| cluster(&args).map_err(Failure::from),
};
