//! The body of one agent process: its iceoryx2 links, its clock and its wait loop.
//!
//! [`run`] turns any [`Agent`](metamorph_protocol::agent::Agent) into a process of a swarm. The
//! parts that the world-controller needs too (names, outboxes, the swarm file, ledgers, the clock)
//! live here, so that both ends of every channel are the same code.
//!
//! Deliberately absent: protocol decisions, and, outside of [`family`], knowledge of which family of
//! units it runs.

pub mod args;
pub mod clock;
pub mod clock_page;
pub mod contacts;
mod drive;
pub mod family;
pub mod impair;
pub mod inbox;
pub mod journal;
pub mod lateness;
pub mod ledger;
pub mod outbox;
pub mod packet;
pub mod process;
pub mod regular;
pub mod rendezvous;
pub mod run_name;
pub mod runtime;
pub mod seat;
mod service;
pub mod space;
pub mod swarm_file;
pub mod undertaker;
pub mod uplink;

pub use args::AgentArgs;
pub use drive::{AgentError, in_hand, pid_directory, pid_file, run};
pub use family::Family;
