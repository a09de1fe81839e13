//! Channels between the processes of a run.

pub mod iceoryx;
