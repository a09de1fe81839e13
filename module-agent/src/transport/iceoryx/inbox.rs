//! The receiving ends of a process: frames come out of channels, and one bell wakes it.

use crate::transport::iceoryx::rendezvous::{
    self, ChannelError, Frames, Listener, Rendezvous, Subscriber, Wakes,
};
use crate::transport::iceoryx::shared_frame::Packet;
use iceoryx2::port::listener::ListenerWaitError;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use std::time::Duration;
use thiserror::Error;

/// Why receiving or waiting failed for good.
#[derive(Debug, Error)]
pub enum InboxError {
    /// Reading shared memory failed.
    #[error("cannot read the inbox: {0}; was the run's directory removed?")]
    Receive(String),
    /// Waiting failed.
    #[error("cannot wait for messages: {0:?}")]
    Wait(ListenerWaitError),
}

/// Everything that one process receives.
#[derive(Debug)]
pub struct Inbox {
    // Ports before the services that they belong to: fields are dropped in this order.
    subscribers: Vec<Subscriber>,
    listener: Listener,
    _services: (Vec<Frames>, Wakes),
    next: usize,
}

impl Inbox {
    /// Creates the inbox of one life of an agent that has so many ports.
    pub fn create(
        at: &Rendezvous,
        id: ModuleId,
        incarnation: Incarnation,
        ports: usize,
    ) -> Result<Inbox, ChannelError> {
        Inbox::over(vec![at.create_inbox(id, incarnation, ports)?], at.create_bell(id, incarnation, ports)?)
    }

    /// Creates the inbox of a generation of controller: `shards` channels, `senders` agent lives in each.
    pub fn create_for_controller(
        at: &Rendezvous,
        generation: u32,
        shards: u32,
        senders: usize,
    ) -> Result<Inbox, ChannelError> {
        let frames: Result<Vec<_>, _> =
            (0..shards).map(|s| at.create_reports(s, generation, senders)).collect();
        Inbox::over(frames?, at.create_controller_bell(generation, senders * shards as usize)?)
    }

    fn over(frames: Vec<Frames>, bell: Wakes) -> Result<Inbox, ChannelError> {
        let subscribers = frames.iter().map(rendezvous::subscribe).collect::<Result<_, _>>()?;
        Ok(Inbox { subscribers, listener: rendezvous::listen(&bell)?, _services: (frames, bell), next: 0 })
    }

    /// The next packet, unchecked; none when all channels are empty.
    pub fn receive(&mut self) -> Result<Option<Packet>, InboxError> {
        for _ in 0..self.subscribers.len() {
            let subscriber = &self.subscribers[self.next];
            // A sender that was killed while it attached cannot be connected to. That is reported
            // once, and the others have been connected by then.
            let sample = subscriber.receive().or_else(|e| {
                tracing::debug!("a sender could not be connected: {e:?}");
                subscriber.receive()
            });
            match sample {
                Ok(Some(sample)) => return Ok(Some(*sample.payload())),
                Ok(None) => self.next = (self.next + 1) % self.subscribers.len(),
                Err(e) => return Err(InboxError::Receive(format!("{e:?}"))),
            }
        }
        Ok(None)
    }

    /// Blocks until the bell rings or `timeout` has passed. Bells rung before count.
    pub fn wait(&self, timeout: Duration) -> Result<(), InboxError> {
        // The socket below counts in microseconds, and takes none of them to mean for ever.
        match self.listener.timed_wait(|_| {}, timeout.max(Duration::from_micros(1))) {
            // A signal such as SIGCONT: look around, then wait again.
            Ok(_) | Err(ListenerWaitError::InterruptSignal) => Ok(()),
            Err(e) => Err(InboxError::Wait(e)),
        }
    }
}
