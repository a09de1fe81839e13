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
use crate::transport::{Address, AgentKey, ConnectError, Link, SendStatus, Transport, TransportError};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::link::Hosts;
use metamorph_protocol::wire::CONTROLLER;
use std::cell::RefCell;
use std::rc::Rc;
use std::sync::Arc;
use std::time::Duration;

/// A sending end of a process.
#[derive(Debug)]
pub enum IceoryxLink {
    /// To one inbox of this host.
    Direct(Box<Outbox>),
    /// To agents of other hosts: all such links of an agent share one sending end.
    Egress(Rc<RefCell<Outbox>>),
}

impl Link for IceoryxLink {
    fn send(&mut self, frame: SharedFrame) -> SendStatus {
        match self {
            IceoryxLink::Direct(outbox) => outbox.send(frame),
            IceoryxLink::Egress(outbox) => outbox.borrow_mut().send(frame),
        }
    }
    fn flush(&mut self) {
        match self {
            IceoryxLink::Direct(outbox) => outbox.flush(),
            IceoryxLink::Egress(outbox) => outbox.borrow_mut().flush(),
        }
    }
}

/// The way from one agent to the agents of other hosts.
#[derive(Debug)]
struct Egress {
    hosts: Arc<Hosts>,
    generation: u32,
    /// Opened on first use.
    outbox: Option<Rc<RefCell<Outbox>>>,
}

/// The inbox of one process of a run, and its membership of the run.
#[derive(Debug)]
pub struct IceoryxTransport {
    inbox: Inbox,
    owner: ModuleId,
    /// Of an agent of a swarm on several hosts.
    egress: Option<Egress>,
    // Last, so that all ports are gone before the process leaves the run.
    membership: Rendezvous,
}

impl IceoryxTransport {
    /// Creates the inbox of one agent that has up to `neighbours` neighbours at a time.
    ///
    /// # Errors
    /// If a channel cannot be created.
    pub fn agent(
        at: Rendezvous,
        agent: AgentKey,
        neighbours: usize,
    ) -> Result<IceoryxTransport, ChannelError> {
        let inbox = Inbox::create(&at, agent.0, agent.1, neighbours)?;
        Ok(IceoryxTransport { inbox, owner: agent.0, egress: None, membership: at })
    }

    /// Sends frames to agents of other hosts by way of the daemon or controller of this host.
    pub fn on_hosts(mut self, hosts: Arc<Hosts>, generation: u32) -> IceoryxTransport {
        self.egress = Some(Egress { hosts, generation, outbox: None });
        self
    }

    /// Creates the inbox of the controller of this generation: `shards` channels of `senders` agents each. With
    /// `egress` it also takes frames to agents of other hosts.
    ///
    /// # Errors
    /// If a channel cannot be created.
    pub fn controller(
        at: Rendezvous,
        generation: u32,
        shards: u32,
        senders: usize,
        egress: bool,
    ) -> Result<IceoryxTransport, ChannelError> {
        let inbox = Inbox::create_for_controller(&at, generation, shards, senders, egress)?;
        Ok(IceoryxTransport { inbox, owner: CONTROLLER, egress: None, membership: at })
    }

    /// Opens the shared sending end if the agent is at home on another host.
    fn egress(&mut self, to: ModuleId) -> Result<Option<IceoryxLink>, ChannelError> {
        let Some(egress) = &mut self.egress else { return Ok(None) };
        if egress.hosts.home(to) == egress.hosts.home(self.owner) {
            return Ok(None);
        }
        let outbox = match &egress.outbox {
            Some(outbox) => Rc::clone(outbox),
            None => {
                let outbox = Outbox::to_other_hosts(&self.membership, self.owner, egress.generation)?;
                Rc::clone(egress.outbox.insert(Rc::new(RefCell::new(outbox))))
            }
        };
        Ok(Some(IceoryxLink::Egress(outbox)))
    }

    /// Sends frames for agents of other hosts to the controller of this generation, if it is not the one before.
    fn redirect(&mut self, generation: u32) -> Result<(), ChannelError> {
        let Some(egress) = self.egress.as_mut().filter(|egress| egress.generation != generation) else {
            return Ok(());
        };
        if let Some(outbox) = &egress.outbox {
            *outbox.borrow_mut() = Outbox::to_other_hosts(&self.membership, self.owner, generation)?;
        }
        egress.generation = generation;
        Ok(())
    }

    fn open(&mut self, to: Address) -> Result<IceoryxLink, ChannelError> {
        let outbox = match to {
            Address::Agent((id, incarnation)) => {
                if let Some(link) = self.egress(id)? {
                    return Ok(link);
                }
                Outbox::to_agent(&self.membership, id, incarnation)
            }
            Address::Controller(generation) => {
                self.redirect(generation)?;
                Outbox::to_controller(&self.membership, self.owner, generation)
            }
        };
        outbox.map(|outbox| IceoryxLink::Direct(Box::new(outbox)))
    }
}

impl Transport for IceoryxTransport {
    type Link = IceoryxLink;

    fn connect(&mut self, to: Address) -> Result<IceoryxLink, ConnectError> {
        self.open(to).map_err(|e| match e {
            ChannelError::OutOfSpace(shortage) => ConnectError::OutOfSpace(shortage),
            e if e.is_absent() => ConnectError::Unreachable(e.into()),
            e if e.is_full() => ConnectError::NoSlot(e.into()),
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
