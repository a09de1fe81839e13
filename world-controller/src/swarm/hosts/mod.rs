//! A swarm of processes on several hosts: one daemon (`metamorph host`) for each host but the controller's, connected
//! by host links ([`metamorph_protocol::host_link`]).
//!
//! An agent sends frames for agents of other hosts to the egress inbox of its own host, whose daemon or controller
//! forwards them. The controller's conversation with agents elsewhere is on the stream of the link to their host. Not
//! here: protocols between hosts, which are in `protocol`, and the controller loop, which is the same for all backends.

mod backend;
mod carrier;
mod daemon;
mod fleet;
mod hosts_file;
mod messages;
mod node;
mod residents;

pub use backend::{Hosts, backend};
pub use daemon::{DaemonError, DaemonOptions, daemon};
pub use fleet::{Fleet, FleetError};
pub use hosts_file::{HostsFile, HostsFileError};
pub use node::build;

use metamorph_protocol::host_link::Timing;
use std::path::PathBuf;

/// How a controller gets the daemons of the other hosts.
#[derive(Clone, Debug, Default)]
pub struct HostsOptions {
    /// The sockets of the daemons of h2, h3, ...; empty if the controller starts them itself.
    pub sockets: Vec<PathBuf>,
    /// The build of the program (see [`build`]); daemons of another build refuse the run.
    pub build: u64,
    /// The times of the links between hosts.
    pub timing: Timing,
    /// The family of the agents, by which a daemon chooses what to start.
    pub family: String,
}
