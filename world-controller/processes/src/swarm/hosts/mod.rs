//! A swarm of processes on several hosts: one daemon (`metamorph host`) for each host but the controller's, connected
//! by host links ([`metamorph_protocol::host_link`]).
//!
//! An agent sends frames for agents of other hosts to the egress inbox of its own host, whose daemon or controller
//! forwards them. The controller's conversation with agents elsewhere is on the stream of the link to their host. Not
//! here: protocols between hosts, which are in `protocol`, and the controller loop, which is the same for all backends.

mod absence;
mod address;
mod backend;
mod carrier;
mod connection;
mod conversation;
mod costs;
mod daemon;
mod fleet;
mod follower;
mod gate;
mod hosts_file;
mod loss;
mod messages;
#[cfg(feature = "hosts")]
mod net;
mod node;
mod notify;
mod parts;
mod reach;
mod remains;
mod residents;
mod returning;
mod shared;
mod succession;
mod survey;

pub use address::{Address, AddressError};
pub use backend::{Hosts, backend};
pub use costs::{NetCost, NetCosts};
pub use daemon::{DaemonError, DaemonOptions, daemon};
pub use fleet::{Fleet, FleetError, Inherited};
pub use hosts_file::{HostsFile, HostsFileError, Placement, VERSION as HOSTS_FILE_VERSION};
#[cfg(feature = "hosts")]
pub use net::bench::{NetBenchError, measure as measure_net};
#[cfg(feature = "hosts")]
pub use net::{KeysError, keep_zenoh_on_one_thread, make as make_keys, renew as renew_keys};
pub use node::build;
pub use reach::ReachError;
pub use succession::Succession;
pub use survey::{Survey, status as host_status};

use metamorph_protocol::host_link::Timing;
use metamorph_protocol::time::Span;
use std::path::PathBuf;

/// How a controller gets the daemons of the other hosts.
#[derive(Clone, Debug, Default)]
pub struct HostsOptions {
    /// The addresses of the daemons of h2, h3, ...; empty if the controller starts them itself.
    pub addresses: Vec<Address>,
    /// The directory of this host's keys, which hosts on other machines need.
    pub keys: Option<PathBuf>,
    /// The build of the program (see [`build`]); daemons of another build refuse the run.
    pub build: u64,
    /// The times of the links between hosts.
    pub timing: Timing,
    /// The family of the agents, by which a daemon chooses what to start.
    pub family: String,
    /// How far the clock of another machine may be off (real time).
    pub clock_error: Span,
}
