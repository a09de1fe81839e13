//! Channels over iceoryx2: discovery, inboxes, outboxes, and the frames in shared memory.

pub mod inbox;
pub mod outbox;
pub mod reaper;
pub mod rendezvous;
pub(crate) mod service;
pub mod shared_frame;
pub mod space;
pub mod uplink;
