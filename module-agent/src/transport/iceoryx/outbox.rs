//! The sending end towards one inbox. Sending never blocks, and being handed over is not an
//! acknowledgement: a dead peer's inbox takes frames until it is full.

use crate::transport::iceoryx::rendezvous::{
    self, ChannelError, Frames, Notifier, Publisher, Rendezvous, Wakes,
};
use crate::transport::iceoryx::shared_frame::Packet;
use crate::transport::iceoryx::space;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::Frame;

/// Bytes of shared memory that the sending end of a channel takes, with room for others who open one.
const ATTACHING: u64 = 32 << 10;

/// What became of one frame at the sender.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Handed {
    /// It lies in the receiver's inbox.
    Over,
    /// The receiver's inbox is full.
    Full,
    /// Nobody listens any more.
    Nobody,
}

/// The sending end towards one inbox.
#[derive(Debug)]
pub struct Outbox {
    // Ports before the services that they belong to: fields are dropped in this order.
    publisher: Publisher,
    notifier: Notifier,
    frames: Frames,
    _bell: Wakes,
    ring: bool,
}

impl Outbox {
    /// Opens the way to one life of an agent.
    pub fn to_agent(at: &Rendezvous, id: ModuleId, life: Incarnation) -> Result<Outbox, ChannelError> {
        Outbox::over(at.open_inbox(id, life)?, at.open_bell(id, life)?)
    }

    /// Opens the way from agent `id` to a generation of controller.
    pub fn to_controller(at: &Rendezvous, id: ModuleId, generation: u32) -> Result<Outbox, ChannelError> {
        Outbox::over(at.open_reports(id, generation)?, at.open_controller_bell(generation)?)
    }

    fn over(frames: Frames, bell: Wakes) -> Result<Outbox, ChannelError> {
        space::require(ATTACHING)?;
        let publisher = rendezvous::publish(&frames)?;
        let notifier = rendezvous::ring(&bell)?;
        Ok(Outbox { publisher, notifier, frames, _bell: bell, ring: false })
    }

    /// Puts one frame into the inbox at `now`. The receiver is woken by [`Outbox::flush`].
    pub fn send(&mut self, frame: &Frame, now: Time) -> Handed {
        self.send_packet(Packet::new(frame, now))
    }

    /// Puts a packet into the inbox.
    pub fn send_packet(&mut self, packet: Packet) -> Handed {
        use iceoryx2::prelude::PortFactory as _;
        match self.publisher.send_copy(packet) {
            Ok(0) | Err(_) => {
                if self.frames.dynamic_config().number_of_subscribers() == 0 {
                    Handed::Nobody
                } else {
                    // What was sent before must still be heard of.
                    self.ring = true;
                    Handed::Full
                }
            }
            Ok(_) => {
                self.ring = true;
                Handed::Over
            }
        }
    }

    /// Wakes the receiver if anything was sent since the last call.
    pub fn flush(&mut self) {
        if std::mem::take(&mut self.ring)
            && let Err(e) = self.notifier.notify()
        {
            // The receiver looks into its inbox every second or two anyway.
            tracing::debug!("cannot wake a receiver: {e:?}");
        }
    }
}
