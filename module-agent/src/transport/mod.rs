//! The transports of frames between the agents of a swarm and its controller: one trait, and one folder or
//! file for each implementation. [`iceoryx`] connects processes by shared memory; [`memory`] connects agents
//! within one process, for tests and for users of the library.
//!
//! A transport has one receiving end, its inbox, and opens sending ends, one for each receiver. A sending end
//! costs memory and descriptors, too many for a large swarm to keep all of them open, so it is a value that
//! its user opens and drops.
//!
//! Sending never blocks and is not acknowledged: the inbox of a dead or stopped receiver accepts frames until
//! it is full. Frames of one sending end arrive in order. Not here: sequence numbers, check sums and retries,
//! which both ends add (`process`).

pub mod iceoryx;
pub mod memory;
pub mod shared_frame;

use crate::run_dir::run_name::HOME;
use crate::transport::shared_frame::SharedFrame;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use std::error::Error;
use std::fmt::Debug;
use std::time::Duration;
use thiserror::Error;

/// Number of frames of each sender that an agent's inbox holds.
pub const INBOX_DEPTH: usize = 32;
/// Number of senders that an agent's inbox admits beside one per port: the controller, and dead ones until
/// they are reaped. Each costs every agent 4.4 kB of shared memory.
pub const INBOX_SPARE: usize = 10;
/// Number of frames of each agent that the controller's inbox holds.
pub const REPORTS_DEPTH: usize = 16;

/// Number of frames of each agent to agents of other hosts that the inbox of its host's daemon holds.
pub const EGRESS_DEPTH: usize = 64;

/// One incarnation of one module.
pub type AgentKey = (ModuleId, Incarnation);

/// The owner of an inbox.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Address {
    /// An agent.
    Agent(AgentKey),
    /// The controller of this generation: a run that is resumed gets the next one.
    Controller(u32),
}

/// The fate of one frame at its sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SendStatus {
    /// It is in the receiver's inbox.
    Sent,
    /// The receiver's inbox is full.
    Full,
    /// The receiver's inbox is gone.
    Gone,
}

/// The sending end towards one inbox.
pub trait Link: Debug {
    /// Puts a frame into the inbox. The receiver is woken by [`Link::flush`].
    fn send(&mut self, frame: SharedFrame) -> SendStatus;

    /// Wakes the receiver if anything was sent since the last call.
    fn flush(&mut self);
}

/// One inbox, and the means to reach others.
pub trait Transport {
    /// The type of its sending ends.
    type Link: Link;

    /// Opens a sending end.
    ///
    /// # Errors
    /// [`ConnectError::Unreachable`] if the receiver has no inbox (any more).
    fn connect(&mut self, to: Address) -> Result<Self::Link, ConnectError>;

    /// Takes the next frame out of the inbox, unchecked; `None` if the inbox is empty.
    ///
    /// # Errors
    /// If the inbox has failed permanently.
    fn receive(&mut self) -> Result<Option<SharedFrame>, TransportError>;

    /// Blocks until a sender flushes or `timeout` has passed. Returns at once if a sender has flushed
    /// since the last call. May also return early, without a flush.
    ///
    /// # Errors
    /// If the inbox has failed permanently.
    fn wait(&mut self, timeout: Duration) -> Result<(), TransportError>;
}

/// Too little shared memory is free.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
#[error(
    "shared memory is full: {} kB are free in {HOME}, and {} kB are needed; something else fills it, or it is too small (mount -o remount,size=..., docker: --shm-size)",
    .free >> 10, .needed >> 10
)]
pub struct SpaceShortage {
    /// Number of bytes needed.
    pub needed: u64,
    /// Number of bytes free.
    pub free: u64,
}

/// Errors of opening a sending end.
#[derive(Debug, Error)]
pub enum ConnectError {
    /// The receiver has no inbox (any more).
    #[error(transparent)]
    Unreachable(Box<dyn Error + Send + Sync>),
    /// Too little memory is free.
    #[error(transparent)]
    OutOfSpace(SpaceShortage),
    /// All slots of the inbox are taken, by senders that leave soon.
    #[error(transparent)]
    NoSlot(Box<dyn Error + Send + Sync>),
    /// The inbox exists, but cannot be used.
    #[error(transparent)]
    Failed(Box<dyn Error + Send + Sync>),
}

/// The resources that a process lacks if the operating system refuses it a file or a mapping, and their limits.
pub const LACK: &str = "this process may lack memory (ulimit -v) or file descriptors (ulimit -n)";

/// Errors of an inbox that has failed permanently.
#[derive(Debug, Error)]
pub enum TransportError {
    /// Frames cannot be read.
    #[error("cannot read the inbox: {0}; was the run's directory removed?")]
    Receive(String),
    /// This process lacks memory or descriptors.
    #[error("cannot receive from a sender: {0}; {reason}", reason = LACK)]
    Lack(String),
    /// Waiting is not possible.
    #[error("cannot wait for messages: {0}")]
    Wait(String),
    /// The owner of the inbox was killed ([`memory::Control::kill`]).
    #[error("this agent was killed")]
    Killed,
}
