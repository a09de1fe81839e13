//! Inputs and commands that drivers carry between agents, bodies and the controller. Every driver uses these types,
//! and journals hold them over [`Blob`](crate::record::Blob).

use crate::ids::{HostId, Incarnation, ModuleId, Port, Revision, Session};
use crate::link::{HostChange, LinkChanges};
use serde::{Deserialize, Serialize};

/// The other end of a contact. Drivers open links by it; agents only see its session.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Contact {
    /// The session that both ends share.
    pub session: Session,
    /// The module on the other side.
    pub peer: ModuleId,
    /// The incarnation of the peer that the session belongs to.
    #[serde(rename = "peer_life")]
    pub peer_incarnation: Incarnation,
    /// The port of the peer.
    pub peer_port: Port,
}

/// An event that a body senses. `P` is the type of percepts.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Sensed<P> {
    /// The contact on a port changed.
    Contact {
        /// The port.
        port: Port,
        /// The number of contact changes of this body, including this one.
        revision: Revision,
        /// The contact from now on.
        contact: Option<Contact>,
    },
    /// The answer of the body to an action.
    Percept(P),
}

impl<P> Sensed<P> {
    /// Converts the percept.
    pub fn map<Q>(&self, convert: impl FnOnce(&P) -> Q) -> Sensed<Q> {
        match self {
            Sensed::Contact { port, revision, contact } => {
                Sensed::Contact { port: *port, revision: *revision, contact: *contact }
            }
            Sensed::Percept(percept) => Sensed::Percept(convert(percept)),
        }
    }
}

/// A command of the controller to a driver. `O` is the type of orders.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Command<O> {
    /// Kill the process of a module (SIGKILL). Its body stays where it is.
    Kill(ModuleId),
    /// Stop the process of a module (SIGSTOP).
    Pause(ModuleId),
    /// Continue a stopped process (SIGCONT).
    Resume(ModuleId),
    /// Restart the process of a dead module, with an empty memory.
    Restart(ModuleId),
    /// Hand an order to an agent. Lost if its process is dead.
    Order(ModuleId, O),
    /// The run is over; nothing follows.
    Finish,
    /// From now on this is changed about the links between modules, and nothing else.
    Links(LinkChanges),
    /// The scenario lets something happen to a host, besides the deaths of its processes.
    Host(HostId, HostChange),
}

impl<O> Command<O> {
    /// Converts the order.
    pub fn map<Q>(&self, convert: impl FnOnce(&O) -> Q) -> Command<Q> {
        match self {
            Command::Kill(id) => Command::Kill(*id),
            Command::Pause(id) => Command::Pause(*id),
            Command::Resume(id) => Command::Resume(*id),
            Command::Restart(id) => Command::Restart(*id),
            Command::Order(id, order) => Command::Order(*id, convert(order)),
            Command::Finish => Command::Finish,
            Command::Links(changes) => Command::Links(*changes),
            Command::Host(host, change) => Command::Host(*host, *change),
        }
    }
}
