//! The directory of one run: its name, the swarm file, counters, process identities and the controller's
//! lease.

pub mod controller_lease;
pub mod counter_file;
pub mod identity;
pub mod run_name;
pub mod swarm_file;
