//! The command `host`: the daemon of one host of a swarm, its keys, and a look at it; and the daemons of a hosts file, for
//! `check` and `clean`.

use crate::metrics::MetricsArg;
use crate::scenario_args::HostsArg;
use clap::Args;
use metamorph_console::command::{CommandOf, Group};
use metamorph_console::interrupt::Interrupt;
use metamorph_console::shutdown::Shutdown;
use metamorph_console::terminal::{print_error, print_out};
use metamorph_processes::family;
use metamorph_processes::swarm::{
    Address, AddressError, DaemonOptions, HostsFile, HostsFileError, MODULE_LIMIT, ReachError, Survey, build,
    daemon, host_status, room_of_daemon,
};
use metamorph_protocol::ids::HostId;
use metamorph_scenario::Plan;
use metamorph_text::command_error::{CommandError, FAILED, Failure};
use metamorph_text::program;
use std::ffi::OsString;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Examples for the help.
const EXAMPLES: &str = "\
Examples:
  metamorph host --listen /run/user/1000/h2.sock
  metamorph run swarm --hosts hosts.toml
  metamorph host --keys keys --make-keys hosts.toml
  metamorph host --listen 10.0.0.2:7447 --name h2 --keys keys
  metamorph host --status 10.0.0.2:7447 --name h2 --keys keys

The daemon serves one run after another until Ctrl-C or SIGTERM. In hosts.toml:

  version = 1
  keys = \"keys\"                               # beside this file; for hosts on other machines
  [[host]]
  name = \"h1\"                                 # where `metamorph run` is
  address = \"local\"
  [[host]]
  name = \"h2\"
  address = \"10.0.0.2:7447\"                   # or unix:/run/user/1000/h2.sock

Machines are connected with mutual TLS; this needs a program built with `--features hosts`.
`metamorph run SCENARIO --hosts N` starts N-1 daemons on this machine by itself.";

/// Arguments of `host`.
#[derive(Debug, Args)]
pub struct HostArgs {
    /// Where controllers and the daemons of other hosts connect: a machine and port such as 10.0.0.2:7447, or the path
    /// of a socket, whose directory's permissions control access; it must not be in use. Port 0 is a free one, which is printed.
    /// Default: none, it is needed
    /// unless keys are made or a daemon is asked
    #[arg(long, value_name = "ADDRESS|PATH", value_parser = address, required_unless_present_any = ["make_keys", "status"])]
    pub listen: Option<Address>,
    /// Which host this is, or which one is asked: h2, h3 and so on. Default: none, or h2 for --status
    #[arg(long, value_name = "HOST", value_parser = host_name)]
    pub name: Option<HostId>,
    /// The directory of keys, for links between machines
    #[arg(long, value_name = "DIR")]
    pub keys: Option<PathBuf>,
    /// The most modules that the daemon takes; the hard limit of open files may be lower
    #[arg(long, value_name = "N", default_value_t = MODULE_LIMIT as u32, value_parser = clap::value_parser!(u32).range(1..=MODULE_LIMIT as i64))]
    pub most: u32,
    /// Make an authority, a token, and certificates for the hosts of this hosts file in the new directory --keys; or for
    /// hosts with their machines, such as h1,h2=10.0.0.2,h3=rack3. Default: none
    #[arg(long, value_name = "FILE|HOSTS", requires = "keys", conflicts_with = "metrics")]
    pub make_keys: Option<String>,
    /// How long certificates are valid that are made
    #[arg(long, value_name = "DAYS", default_value_t = 30, value_parser = clap::value_parser!(u32).range(1..=3650))]
    pub days: u32,
    /// Print what the daemon there does, and its room. Default: none
    #[arg(long, value_name = "ADDRESS|PATH", value_parser = address, conflicts_with_all = ["listen", "make_keys", "metrics"])]
    pub status: Option<Address>,
    /// Metrics of this host.
    #[command(flatten)]
    pub metrics: MetricsArg,
    /// End after one run, or with the process that started this one
    #[arg(long, hide = true)]
    pub once: bool,
}

/// Why a command about hosts fails.
#[derive(Debug, Error)]
enum HostError {
    #[error("cannot listen on {0}: {1}\n  fix: name an address of this machine")]
    Port(String, std::io::Error),
    #[error(transparent)]
    Reach(#[from] ReachError),
    #[error(transparent)]
    File(#[from] HostsFileError),
    #[cfg(feature = "hosts")]
    #[error(transparent)]
    Keys(#[from] metamorph_processes::swarm::KeysError),
    #[cfg(feature = "hosts")]
    #[error(
        "--make-keys: `{0}` is no host\n  fix: write the path of a hosts file, or hosts such as h1,h2=10.0.0.2"
    )]
    Hosts(String),
    #[cfg(not(feature = "hosts"))]
    #[error(
        "this program is built without links between machines\n  fix: build it with `cargo build --release --features hosts`"
    )]
    NotBuilt,
}

impl CommandError for HostError {}

/// Reads an address or the path of a socket. A port may be 0 here: a free one.
fn address(text: &str) -> Result<Address, AddressError> {
    let path = Path::new(text);
    if let Some(machine) = text.strip_suffix(":0")
        && let Ok(Address::Net { machine, .. }) = format!("{machine}:1").parse()
    {
        return Ok(Address::Net { machine, port: 0 });
    }
    match text.parse() {
        Ok(address) if !text.starts_with('/') => Ok(address),
        Err(e) if !text.contains('/') && text.contains(':') => Err(e),
        _ => Address::unix(&std::path::absolute(path).map_err(|_| AddressError::Path)?),
    }
}

fn host_name(text: &str) -> Result<HostId, String> {
    HostId::from_name(text).ok_or_else(|| "hosts are called h1, h2 and so on".to_owned())
}

/// Serves runs until a signal asks the daemon to end, makes keys, or asks a daemon.
pub fn host(args: HostArgs, interrupt: &Interrupt) -> Result<u8, Failure> {
    if let Some(hosts) = &args.make_keys {
        let keys = args.keys.as_deref().unwrap_or(Path::new("keys"));
        print_out(&make_keys(keys, hosts, args.days)?);
        return Ok(0);
    }
    if let Some(address) = &args.status {
        let host = args.name.unwrap_or(HostId(1));
        let status = host_status(host, address, args.keys.as_deref(), build()).map_err(HostError::from)?;
        print_out(&status);
        return Ok(0);
    }
    let Some(address) = args.listen else { return Ok(FAILED) };
    let metrics = args.metrics.serve(args.once)?;
    let address = free_port(address)?;
    let shutdown = Shutdown::new();
    interrupt.begin();
    interrupt.pass_on(&shutdown);
    let shown = match &address {
        Address::Unix(path) => path.display().to_string(),
        Address::Net { .. } => address.to_string(),
    };
    let identity = args.name.zip(args.keys);
    // Invariant: the room is at most what was asked for.
    let (once, most) = (args.once, room_of_daemon(u64::from(args.most)) as u32);
    let ready = || {
        if !once {
            print_error(&format!("listening on {shown}; Ctrl-C ends it"));
        }
    };
    daemon(
        &DaemonOptions { build: build(), address, identity, most, once, agents, metrics, shutdown },
        ready,
    )?;
    Ok(0)
}

/// Returns an address with a port that was free a moment ago in place of port 0.
fn free_port(address: Address) -> Result<Address, HostError> {
    match address {
        Address::Net { machine, port: 0 } => {
            let bound = TcpListener::bind((machine.as_str(), 0)).and_then(|listener| listener.local_addr());
            let port = bound.map_err(|e| HostError::Port(machine.clone(), e))?.port();
            Ok(Address::Net { machine, port })
        }
        address => Ok(address),
    }
}

/// Returns the command line of the agents of a family.
fn agents(family: &str) -> Option<(PathBuf, Vec<OsString>)> {
    let name = family::named(family)?.name();
    Some((std::env::current_exe().ok()?, program::again(["agent".into(), "--".into(), name.into()])))
}

/// Returns the hosts of a file, each with the machines under which it is reached.
#[cfg(feature = "hosts")]
pub fn machines(file: &HostsFile) -> Vec<(HostId, Vec<String>)> {
    let machines = file.addresses.iter().map(|address| match address {
        Address::Net { machine, .. } => vec![machine.clone()],
        Address::Unix(_) => Vec::new(),
    });
    (0u16..).map(HostId).zip(std::iter::once(Vec::new()).chain(machines)).collect()
}

#[cfg(feature = "hosts")]
fn make_keys(directory: &Path, hosts: &str, days: u32) -> Result<String, HostError> {
    let path = Path::new(hosts);
    let hosts: Vec<(HostId, Vec<String>)> = if path.is_file() {
        machines(&HostsFile::read(path)?)
    } else {
        let one = |text: &str| {
            let (name, machine) = text.split_once('=').map_or((text, None), |(n, m)| (n, Some(m.to_owned())));
            let host = HostId::from_name(name).ok_or_else(|| HostError::Hosts(text.to_owned()))?;
            Ok((host, machine.into_iter().collect()))
        };
        hosts.split(',').map(one).collect::<Result<_, HostError>>()?
    };
    let valid = std::time::Duration::from_secs(u64::from(days) * 86_400);
    metamorph_processes::swarm::make_keys(directory, &hosts, valid)?;
    let shown = directory.display();
    let names: Vec<String> = hosts.iter().map(|(host, _)| host.to_string()).collect();
    Ok(format!(
        "keys of {} are in {shown}, valid for {days} days\ncopy to each host its own: ca.pem, token, NAME.pem, NAME.key\n{shown}.ca.key stays here: further certificates are made with it",
        names.join(", ")
    ))
}

#[cfg(not(feature = "hosts"))]
fn make_keys(_: &Path, _: &str, _: u32) -> Result<String, HostError> {
    Err(HostError::NotBuilt)
}

/// Asks the daemons of a hosts file whether they can take part in a run of the plan. Returns the exit code.
pub fn check(file: &HostsFile, plan: &Plan) -> Result<u8, Failure> {
    let hosts = plan.link.hosts.as_ref();
    // Invariant: there are fewer than 2^16 hosts.
    let all = hosts.map_or(0, |hosts| hosts.len() as u16);
    let modules: Vec<usize> = (0..all).filter_map(|i| Some(hosts?.modules(HostId(i)).count())).collect();
    let (lines, all) = Survey::new(file, build()).map_err(HostError::from)?.check(&modules);
    print_out(&lines.join("\n"));
    Ok(if all { 0 } else { FAILED })
}

/// Has the daemons of a hosts file remove what killed runs have left. Returns the exit code.
pub fn clean(hosts: &HostsArg) -> Result<u8, Failure> {
    let Some(file) = &hosts.file else { return Ok(0) };
    let (lines, all) = Survey::new(file, build()).map_err(HostError::from)?.clean();
    print_out(&lines.join("\n"));
    Ok(if all { 0 } else { FAILED })
}

/// The command.
pub static COMMAND: CommandOf<HostArgs> = CommandOf {
    name: "host",
    group: Some(Group::Machine),
    about: "Serve as one of several hosts of a swarm: the daemon that starts and supervises its share",
    after_help: || EXAMPLES.to_owned(),
    execute: |args, call| host(args, call.interrupt),
};
