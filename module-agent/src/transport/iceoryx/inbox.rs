//! The receiving end of a process: the channels of its frames, and one bell that wakes it.

use crate::transport::TransportError;
use crate::transport::iceoryx::rendezvous::{
    self, ChannelError, Frames, Listener, Rendezvous, Subscriber, Wakes,
};
use crate::transport::shared_frame::SharedFrame;
use iceoryx2::port::ReceiveError;
use iceoryx2::port::listener::ListenerWaitError;
use iceoryx2::port::update_connections::ConnectionFailure;
use iceoryx2_cal::shared_memory::SharedMemoryOpenError;
use iceoryx2_cal::zero_copy_connection::ZeroCopyCreationError;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use std::time::Duration;

/// Number of times that a channel is read while senders of it cannot be connected. Each is reported once.
const READS: usize = 64;

/// Takes the next frame out of a channel.
///
/// # Errors
/// If the channel cannot be read, or the operating system refuses what connects a sender: its frames would never be received.
fn take(subscriber: &Subscriber) -> Result<Option<SharedFrame>, TransportError> {
    use ConnectionFailure::{FailedToEstablishConnection, UnableToMapSendersDataSegment};
    for _ in 0..READS {
        let e = match subscriber.receive() {
            Ok(sample) => return Ok(sample.map(|sample| *sample.payload())),
            Err(ReceiveError::ConnectionFailure(e)) => e,
            Err(e) => return Err(TransportError::Receive(format!("{e:?}"))),
        };
        if let FailedToEstablishConnection(ZeroCopyCreationError::InternalError)
        | UnableToMapSendersDataSegment(SharedMemoryOpenError::InternalError) = e
        {
            return Err(TransportError::Lack(format!("{e:?}")));
        }
        // A sender that was killed while it attached cannot be connected to. The others have been connected by then.
        tracing::debug!("a sender could not be connected: {e:?}");
    }
    Err(TransportError::Receive("too many senders cannot be connected".to_owned()))
}

/// The inbox of one process.
#[derive(Debug)]
pub struct Inbox {
    // Ports before the services that they belong to: fields are dropped in this order.
    subscribers: Vec<Subscriber>,
    listener: Listener,
    _services: (Vec<Frames>, Wakes),
    next: usize,
}

impl Inbox {
    /// Creates the inbox of one incarnation of an agent that has up to `neighbours` neighbours at a time.
    ///
    /// # Errors
    /// If a channel cannot be created.
    pub fn create(
        at: &Rendezvous,
        id: ModuleId,
        incarnation: Incarnation,
        neighbours: usize,
    ) -> Result<Inbox, ChannelError> {
        Inbox::over(
            vec![at.create_inbox(id, incarnation, neighbours)?],
            at.create_bell(id, incarnation, neighbours)?,
        )
    }

    /// Creates the inbox of the controller of this generation: `shards` channels of `senders` agents each; with
    /// `egress` as many again for frames to agents of other hosts.
    ///
    /// # Errors
    /// If a channel cannot be created.
    pub fn create_for_controller(
        at: &Rendezvous,
        generation: u32,
        shards: u32,
        senders: usize,
        egress: bool,
    ) -> Result<Inbox, ChannelError> {
        let reports = (0..shards).map(|s| at.create_reports(s, generation, senders));
        let egress = (0..if egress { shards } else { 0 }).map(|s| at.create_egress(s, generation, senders));
        let frames = reports.chain(egress).collect::<Result<Vec<_>, _>>()?;
        let ringers = senders * frames.len();
        Inbox::over(frames, at.create_controller_bell(generation, ringers)?)
    }

    fn over(frames: Vec<Frames>, bell: Wakes) -> Result<Inbox, ChannelError> {
        let subscribers = frames.iter().map(rendezvous::subscribe).collect::<Result<_, _>>()?;
        Ok(Inbox { subscribers, listener: rendezvous::listen(&bell)?, _services: (frames, bell), next: 0 })
    }

    /// Takes the next frame, unchecked; `None` if all channels are empty.
    ///
    /// # Errors
    /// If a channel cannot be read.
    pub fn receive(&mut self) -> Result<Option<SharedFrame>, TransportError> {
        for _ in 0..self.subscribers.len() {
            if let Some(frame) = take(&self.subscribers[self.next])? {
                return Ok(Some(frame));
            }
            self.next = (self.next + 1) % self.subscribers.len();
        }
        Ok(None)
    }

    /// Blocks until the bell rings or `timeout` has passed. Returns at once if it has rung since the last
    /// wait.
    ///
    /// # Errors
    /// If waiting is not possible.
    pub fn wait(&self, timeout: Duration) -> Result<(), TransportError> {
        // The socket below counts in microseconds, and would wait forever on zero.
        match self.listener.timed_wait(|_| {}, timeout.max(Duration::from_micros(1))) {
            // A signal such as SIGCONT: the caller checks its state and waits again.
            Ok(_) | Err(ListenerWaitError::InterruptSignal) => Ok(()),
            Err(e) => Err(TransportError::Wait(format!("{e:?}"))),
        }
    }
}
