//! One agent as a process: its start, its wait loop, its receiving and sending halves, and its behaviour
//! without a controller. Runs over any [`Transport`](crate::transport::Transport) and any
//! [`ClockSource`](crate::clock::source::ClockSource).

pub mod agent_process;
pub mod args;
pub mod bounds;
pub mod contacts;
pub mod orphan_watch;
pub mod receiver;
pub mod runtime_message;
pub mod sender;
pub mod start;
pub mod uplink;
pub mod write_ahead;
