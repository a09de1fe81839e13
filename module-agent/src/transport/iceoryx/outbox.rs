//! The sending end towards one inbox: the channel of its frames, and the bell that wakes its owner.

use crate::transport::iceoryx::rendezvous::{
    self, ChannelError, Frames, Notifier, Publisher, Rendezvous, Wakes,
};
use crate::transport::iceoryx::space;
use crate::transport::shared_frame::SharedFrame;
use crate::transport::{Link, SendStatus};
use metamorph_protocol::ids::{Incarnation, ModuleId};

/// Shared memory for the sending end of a channel, in bytes, with a margin for other processes that open one.
const ATTACHING: u64 = 32 << 10;

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
    /// Opens the sending end to one incarnation of an agent.
    ///
    /// # Errors
    /// If the channel is absent or cannot be used, or too little memory is free.
    pub fn to_agent(at: &Rendezvous, id: ModuleId, incarnation: Incarnation) -> Result<Outbox, ChannelError> {
        Outbox::over(at.open_inbox(id, incarnation)?, at.open_bell(id, incarnation)?)
    }

    /// Opens the sending end from agent `id` to the controller of this generation.
    ///
    /// # Errors
    /// If the channel is absent or cannot be used, or too little memory is free.
    pub fn to_controller(at: &Rendezvous, id: ModuleId, generation: u32) -> Result<Outbox, ChannelError> {
        Outbox::over(at.open_reports(id, generation)?, at.open_controller_bell(generation)?)
    }

    /// Opens the sending end from agent `id` to the agents of other hosts, by way of this host's daemon or controller.
    ///
    /// # Errors
    /// If the channel is absent or cannot be used, or too little memory is free.
    pub fn to_other_hosts(at: &Rendezvous, id: ModuleId, generation: u32) -> Result<Outbox, ChannelError> {
        Outbox::over(at.open_egress(id, generation)?, at.open_controller_bell(generation)?)
    }

    fn over(frames: Frames, bell: Wakes) -> Result<Outbox, ChannelError> {
        space::require(ATTACHING)?;
        let publisher = rendezvous::publish(&frames)?;
        let notifier = rendezvous::ring(&bell)?;
        Ok(Outbox { publisher, notifier, frames, _bell: bell, ring: false })
    }
}

impl Link for Outbox {
    fn send(&mut self, frame: SharedFrame) -> SendStatus {
        use iceoryx2::prelude::PortFactory as _;
        match self.publisher.send_copy(frame) {
            Ok(0) | Err(_) => {
                if self.frames.dynamic_config().number_of_subscribers() == 0 {
                    SendStatus::Gone
                } else {
                    // Earlier frames still wake the receiver.
                    self.ring = true;
                    SendStatus::Full
                }
            }
            Ok(_) => {
                self.ring = true;
                SendStatus::Sent
            }
        }
    }

    fn flush(&mut self) {
        if std::mem::take(&mut self.ring)
            && let Err(e) = self.notifier.notify()
        {
            // The receiver looks into its inbox every second or two anyway.
            tracing::debug!("cannot wake a receiver: {e:?}");
        }
    }
}
