//! The directory of one run: its name, the swarm file, counters, process identities, the controller's lease and
//! that of a daemon's share.

pub mod controller_lease;
pub mod counter_file;
pub mod identity;
pub mod run_name;
pub mod share_lease;
pub mod swarm_file;
