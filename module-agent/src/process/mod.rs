//! The wait loop of one agent process, and what it and the controller say to each other.

pub(crate) mod agent_process;
pub mod args;
pub mod contacts;
pub mod control_message;
