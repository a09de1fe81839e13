//! One agent as a process: how it starts, its wait loop, what it receives, what it sends, and what it does
//! when its controller is gone. Runs over any [`Transport`](crate::transport::Transport) and any
//! [`ClockSource`](crate::clock::source::ClockSource).

pub mod agent_process;
pub mod args;
pub mod contacts;
pub mod orphan_watch;
pub mod receiver;
pub mod runtime_message;
pub mod sender;
pub mod start;
pub mod uplink;
pub mod write_ahead;
