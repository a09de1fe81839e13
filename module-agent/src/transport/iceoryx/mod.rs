//! The transport between processes over iceoryx2: discovery, inboxes, outboxes, and cleaning up after dead
//! processes.

pub mod inbox;
pub mod outbox;
pub mod reaper;
pub mod rendezvous;
pub(crate) mod service;
pub mod space;

use crate::transport::iceoryx::inbox::Inbox;
use crate::transport::iceoryx::outbox::Outbox;
use crate::transport::iceoryx::rendezvous::{ChannelError, Rendezvous};
use crate::transport::shared_frame::SharedFrame;
use crate::transport::{Address, AgentKey, ConnectError, Transport, TransportError};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::wire::CONTROLLER;
use std::time::Duration;

/// The inbox of one process of a run, and its membership of the run.
#[derive(Debug)]
pub struct IceoryxTransport {
    inbox: Inbox,
    owner: ModuleId,
    // Last, so that all ports are gone before the process leaves the run.
    membership: Rendezvous,
}

impl IceoryxTransport {
    /// Creates the inbox of one agent that has `ports` ports.
    ///
    /// # Errors
    /// If a channel cannot be created.
    pub fn agent(at: Rendezvous, agent: AgentKey, ports: usize) -> Result<IceoryxTransport, ChannelError> {
        let inbox = Inbox::create(&at, agent.0, agent.1, ports)?;
        Ok(IceoryxTransport { inbox, owner: agent.0, membership: at })
    }

    /// Creates the inbox of the controller of this generation: `shards` channels of `senders` agents each.
    ///
    /// # Errors
    /// If a channel cannot be created.
    pub fn controller(
        at: Rendezvous,
        generation: u32,
        shards: u32,
        senders: usize,
    ) -> Result<IceoryxTransport, ChannelError> {
        let inbox = Inbox::create_for_controller(&at, generation, shards, senders)?;
        Ok(IceoryxTransport { inbox, owner: CONTROLLER, membership: at })
    }
}

impl Transport for IceoryxTransport {
    type Link = Outbox;

    fn connect(&mut self, to: Address) -> Result<Outbox, ConnectError> {
        let outbox = match to {
            Address::Agent((id, incarnation)) => Outbox::to_agent(&self.membership, id, incarnation),
            Address::Controller(generation) => {
                Outbox::to_controller(&self.membership, self.owner, generation)
            }
        };
        outbox.map_err(|e| match e {
            ChannelError::OutOfSpace(shortage) => ConnectError::OutOfSpace(shortage),
            e if e.is_absent() => ConnectError::Unreachable(e.into()),
            e => ConnectError::Failed(e.into()),
        })
    }

    fn receive(&mut self) -> Result<Option<SharedFrame>, TransportError> {
        self.inbox.receive()
    }

    fn wait(&mut self, timeout: Duration) -> Result<(), TransportError> {
        self.inbox.wait(timeout)
    }
}
