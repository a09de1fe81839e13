//! One module on the simulated link: its process, its ports, and its messages under way.

use crate::kernel::audited::Swarm;
use metamorph_core::agent::Agent;
use metamorph_core::counters::{Class, Tally};
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::host::AgentHost;
use metamorph_core::ids::{Incarnation, ModuleId, Port, Revision, Session};
use metamorph_core::link::{ClockOffset, LinkModel, LinkState};
use metamorph_core::rng::Rng;
use metamorph_core::runtime::{Contact, Sensed};
use metamorph_core::time::Time;
use metamorph_core::wire::{Channel, Frame, Header, Wire, WireError};
use std::collections::VecDeque;

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Process {
    Dead,
    Running,
    Stopped,
}

/// The state of a module besides its links.
#[derive(Clone)]
pub(super) struct Module<A: Agent> {
    pub rng: Rng,
    /// The clock of the module's host.
    pub clock: ClockOffset,
    /// The time of the wake-up that is in the queue, by the controller's clock.
    pub wake: Time,
    /// When the process was started last.
    pub started: Time,
    pub revision: Revision,
    /// The number of messages sent in this incarnation.
    pub sent: u32,
    pub incarnation: Incarnation,
    pub process: Process,
    /// The agent, or its last state if its process died; `None` before the start.
    pub agent: Option<AgentHost<A>>,
}

impl<A: Agent> Module<A> {
    pub fn is_alive(&self) -> bool {
        self.process != Process::Dead
    }

    /// Returns the wake-up to schedule, if the agent wants another one than the one that is in the queue.
    pub fn plan_wake(&mut self, now: Time) -> Option<Time> {
        let at = self.clock.global(self.agent.as_ref().map(AgentHost::wake_at)?);
        if at == self.wake {
            return None;
        }
        self.wake = if at == Time::NEVER { at } else { at.max(now) };
        (at != Time::NEVER).then_some(self.wake)
    }

    /// Draws the fate of a message, counts it, and schedules its arrivals.
    pub fn send(
        &mut self,
        on: &LinkModel,
        now: Time,
        Sent { from, port, class, message }: Sent<A::Message>,
        link: &mut Link,
        tally: &mut Tally,
        mut put: impl FnMut(Time, InFlight<A::Message>),
    ) {
        let counts = &mut tally[class];
        counts.sent += 1;
        counts.bytes += message.wire_len() as u64;
        let number = self.sent;
        self.sent = number.wrapping_add(1);
        let Some(contact) = link.contact else {
            counts.expired += 1;
            return;
        };
        let fate = on.carry(now, from, contact.peer, &mut self.rng, &mut link.state);
        let mut copies = 0;
        for arrival in fate.arrivals.into_iter().flatten() {
            copies += 1;
            let message = match arrival.flipped_bit {
                None => Ok(message.clone()),
                Some(bit) => damaged(from, contact, port, class, &message, bit),
            };
            let Ok(message) = message else {
                hit(CoveragePoint::DriverDamaged);
                counts.refused += 1;
                continue;
            };
            let Contact { session, peer: to, peer_port: port, .. } = contact;
            put(arrival.at, InFlight { to, session, port, class, number, sent: now, message });
        }
        match copies {
            0 => counts.lost += 1,
            n => counts.duplicated += n - 1,
        }
    }
}

#[derive(Clone, Copy)]
pub(super) struct Link {
    pub contact: Option<Contact>,
    pub state: LinkState,
}

/// The inputs that wait for a stopped process, in order.
#[derive(Clone)]
pub(super) struct Backlog<A: Agent> {
    pub waiting: VecDeque<Waiting<A>>,
    pub messages: usize,
}

impl<A: Agent> Default for Backlog<A> {
    fn default() -> Self {
        Backlog { waiting: VecDeque::new(), messages: 0 }
    }
}

/// An input to a stopped process.
#[derive(Clone)]
pub(super) enum Waiting<A: Agent> {
    Sensed(Sensed<A::Percept>),
    Message(InFlight<A::Message>),
    Order(A::Order),
}

/// A message at its port, before its fate is known.
pub(super) struct Sent<M> {
    pub from: ModuleId,
    pub port: Port,
    pub class: Class,
    pub message: M,
}

#[derive(Clone)]
pub(super) struct InFlight<M> {
    pub to: ModuleId,
    pub session: Session,
    pub port: Port,
    pub class: Class,
    /// Its number among all messages of its sender's incarnation.
    pub number: u32,
    /// When it was sent.
    pub sent: Time,
    pub message: M,
}

impl<A: Agent> Swarm<A> for Vec<Module<A>> {
    fn modules(&self) -> usize {
        self.len()
    }
    fn living(&self, index: usize) -> Option<&A> {
        self.get(index).filter(|m| m.is_alive()).and_then(|m| m.agent.as_ref()).map(AgentHost::agent)
    }
    fn last(&self, index: usize) -> Option<&A> {
        self.get(index).and_then(|m| m.agent.as_ref()).map(AgentHost::agent)
    }
    fn clock(&self, index: usize) -> ClockOffset {
        self.get(index).map_or(ClockOffset::default(), |m| m.clock)
    }
}

/// Returns a message after a bit of its frame has flipped: refused almost always.
fn damaged<M: Wire>(
    from: ModuleId,
    contact: Contact,
    port: Port,
    class: Class,
    message: &M,
    bit: u64,
) -> Result<M, WireError> {
    let header = Header {
        channel: Channel::Peer,
        kind: message.kind(),
        class,
        port,
        incarnation: Incarnation(0),
        source: from,
        destination: contact.peer,
        session: contact.session.0,
        sequence: 0,
    };
    let mut frame = Frame::seal(header, message);
    frame.flip(bit);
    frame.open()?;
    frame.message()
}
