//! What passes between agents and the controller: bodies, orders and reports. In no time on the controller's host; from
//! and to other hosts by a stream that is late, in order and without loss.

use super::module::{Process, Waiting};
use super::{Event, Sim};
use crate::director::port::DirectorPort;
use crate::kernel::audited::{Agents, Audited};
use metamorph_protocol::agent::{Agent, Input};
use metamorph_protocol::counters::Tally;
use metamorph_protocol::ids::{HostId, Incarnation, ModuleId, Revision};
use metamorph_protocol::link::Hosts;
use metamorph_protocol::rng::Rng;
use metamorph_protocol::runtime::Sensed;
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::Wire;
use slab::Slab;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A message between an agent and the controller.
pub(super) enum BodyMessage<A: Agent> {
    Act(Revision, A::Action),
    Report(A::Report),
    Sensed(Sensed<A::Percept>),
    Order(A::Order),
}

impl<A: Agent> BodyMessage<A> {
    fn is_to_controller(&self) -> bool {
        matches!(self, BodyMessage::Act(..) | BodyMessage::Report(_))
    }
}

/// A message that a stream has not delivered yet.
struct Posted<A: Agent> {
    id: ModuleId,
    /// The incarnation that the message is from or for; it is dropped if that has ended.
    incarnation: Incarnation,
    message: BodyMessage<A>,
}

/// One direction of the stream between a host and the controller's.
struct Stream {
    rng: Rng,
    last: Time,
}

/// What has crossed from one host to another.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Crossed {
    /// Protocol messages, as the sender counts them: what was sent, lost, doubled or damaged.
    pub messages: Tally,
    /// Messages between agents and the controller.
    pub body_messages: u64,
}

/// What has crossed between hosts, by sender and receiver.
pub type Crossings = BTreeMap<(HostId, HostId), Crossed>;

/// The streams between the controller and the other hosts, and the counts of what crosses.
pub(super) struct HostStreams<A: Agent> {
    hosts: Arc<Hosts>,
    /// For each host the streams to the controller and from it.
    streams: Vec<[Stream; 2]>,
    waiting: Slab<Posted<A>>,
    crossings: Crossings,
}

impl<A: Agent> HostStreams<A> {
    pub fn new(hosts: Arc<Hosts>, seed: u64) -> HostStreams<A> {
        let stream =
            |number: usize| Stream { rng: Rng::named(seed, "hosts", number as u64), last: Time::ZERO };
        let streams = (0..hosts.len()).map(|host| [stream(host * 2), stream(host * 2 + 1)]).collect();
        HostStreams { hosts, streams, waiting: Slab::new(), crossings: Crossings::new() }
    }

    /// Returns the counts of what crosses from one module to another; `None` if both are on one host.
    pub fn crossed(&mut self, from: ModuleId, to: ModuleId) -> Option<&mut Crossed> {
        let pair = (self.hosts.home(from), self.hosts.home(to));
        (pair.0 != pair.1).then(|| self.crossings.entry(pair).or_default())
    }

    /// Takes a message for the stream of the module's host, and returns its delivery; gives it back if the module is
    /// on the controller's host.
    fn take(
        &mut self,
        now: Time,
        id: ModuleId,
        incarnation: Incarnation,
        message: BodyMessage<A>,
    ) -> Result<(Time, Event), BodyMessage<A>> {
        let home = self.hosts.home(id);
        if home == HostId::CONTROLLER {
            return Err(message);
        }
        let is_up = message.is_to_controller();
        let pair = if is_up { (home, HostId::CONTROLLER) } else { (HostId::CONTROLLER, home) };
        self.crossings.entry(pair).or_default().body_messages += 1;
        let Stream { rng, last } = &mut self.streams[home.index()][usize::from(!is_up)];
        let at = self.hosts.stream(home, now, rng, last);
        // Invariant: 2^32 messages under way would not fit into memory.
        let index = self.waiting.insert(Posted { id, incarnation, message }) as u32;
        Ok((at, Event::Stream(index)))
    }
}

impl<W: Audited, D: DirectorPort<W>> Sim<W, D> {
    /// Returns what has crossed between hosts; empty if there is only one.
    pub fn crossings(&self) -> Crossings {
        self.hosts.as_ref().map(|hosts| hosts.crossings.clone()).unwrap_or_default()
    }

    /// Passes a message between an agent and the controller: at once, or by the stream of the module's host.
    pub(super) fn pass(&mut self, id: ModuleId, message: BodyMessage<W::Agent>) {
        let Some(hosts) = &mut self.hosts else { return self.hand_over(id, message) };
        let module = &self.modules[id.index()];
        // What is meant for a dead process goes nowhere.
        if !module.is_alive() {
            return;
        }
        match hosts.take(self.now, id, module.incarnation, message) {
            Err(message) => self.hand_over(id, message),
            Ok((at, delivery)) => self.queue.push(at, delivery),
        }
    }

    /// Hands over what a stream delivers. The controller takes nothing from an incarnation that it knows to be dead,
    /// because neighbours of the dead module rely on its body standing still.
    pub(super) fn stream_delivers(&mut self, index: u32) {
        let Some(hosts) = &mut self.hosts else { return };
        let Posted { id, incarnation, message } = hosts.waiting.remove(index as usize);
        let module = &self.modules[id.index()];
        if module.is_alive() && module.incarnation == incarnation {
            self.hand_over(id, message);
        }
    }

    fn hand_over(&mut self, id: ModuleId, message: BodyMessage<W::Agent>) {
        match message {
            BodyMessage::Act(revision, action) => self.act(id, revision, &action),
            BodyMessage::Report(report) => {
                self.body_messages += 1;
                self.director.report(self.now, id, report);
            }
            BodyMessage::Sensed(sensed) => self.sense(id, sensed),
            BodyMessage::Order(order) => self.order(id, order),
        }
    }

    fn act(&mut self, id: ModuleId, revision: Revision, action: &<W::Agent as Agent>::Action) {
        self.body_messages += 1;
        self.trace.event(self.now, 2, id.0, u64::from(action.kind()));
        self.world.act(self.now, id, revision, action);
        self.checked += 1;
        let (agents, mut found) = (Agents::of(&self.modules), Vec::new());
        self.world.audit_action(self.now, id, &agents, &mut found);
        found.into_iter().for_each(|v| self.note(v));
    }

    pub(super) fn order(&mut self, id: ModuleId, order: <W::Agent as Agent>::Order) {
        match self.modules[id.index()].process {
            Process::Dead => {}
            Process::Stopped => {
                self.backlogs.entry(id).or_default().waiting.push_back(Waiting::Order(order));
            }
            Process::Running => {
                self.body_messages += 1;
                self.trace.event(self.now, 7, id.0, u64::from(order.kind()));
                self.feed(id, Input::Order(order));
            }
        }
    }
}
