//! One agent process: its transport, its clock and its wait loop.
//!
//! [`run`] turns any [`Agent`](metamorph_protocol::agent::Agent) into a process of a swarm. The parts that
//! the world-controller needs too (names, outboxes, the swarm file, counter files, the clock) are in this
//! crate, so that both ends of every channel share their code.
//!
//! Not here: protocol decisions, and, outside of [`registry`], the names of the families.

pub mod clock;
pub mod journal_file;
pub mod link_emulator;
pub mod process;
pub mod registry;
pub mod regular_file;
pub mod run_dir;
pub mod transport;

pub use crate::process::args::AgentArgs;
pub use crate::process::bounds::{in_hand, most_neighbours};
pub use crate::process::start::{AgentError, pid_directory, pid_file, run};
pub use crate::registry::Family;
