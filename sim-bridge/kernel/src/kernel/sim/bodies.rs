//! Orders and reports between agents and the controller, and the inputs of bodies. They take no time, unless orders
//! and reports have a link of their own; from and to other hosts they pass a stream with delay, in order and without
//! loss.

use super::module::{Process, Waiting};
use super::{Event, Sim};
use crate::director::port::DirectorPort;
use crate::kernel::audited::{Agents, Audited};
use metamorph_core::agent::{Agent, Input};
use metamorph_core::counters::Tally;
use metamorph_core::ids::{HostId, Incarnation, ModuleId, Revision};
use metamorph_core::link::{ControllerLink, Hosts};
use metamorph_core::rng::Rng;
use metamorph_core::runtime::Sensed;
use metamorph_core::time::Time;
use metamorph_core::wire::Wire;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A message between an agent and the controller.
#[derive(Clone)]
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
    /// Returns the bytes on the wire of an order or a report.
    fn control_bytes(&self) -> Option<u64> {
        match self {
            BodyMessage::Report(report) => Some(report.wire_len() as u64),
            BodyMessage::Order(order) => Some(order.wire_len() as u64),
            BodyMessage::Act(..) | BodyMessage::Sensed(_) => None,
        }
    }
}

/// A message that has not been delivered yet.
#[derive(Clone)]
pub(super) struct Posted<A: Agent> {
    id: ModuleId,
    /// The incarnation that the message is from or for; it is dropped if that has ended.
    incarnation: Incarnation,
    message: BodyMessage<A>,
}

#[derive(Clone)]
pub(super) struct Stream {
    rng: Rng,
    last: Time,
}

impl Stream {
    /// Returns the streams of this number in both directions.
    fn both(seed: u64, name: &'static str, number: usize) -> [Stream; 2] {
        [0, 1].map(|way| Stream { rng: Stream::random(seed, name, number, way), last: Time::ZERO })
    }
    fn random(seed: u64, name: &'static str, number: usize, way: usize) -> Rng {
        Rng::named(seed, name, (2 * number + way) as u64)
    }
    /// Lets all streams draw from another seed. Messages still arrive in order.
    pub fn renew(all: &mut [[Stream; 2]], seed: u64, name: &'static str) {
        for (number, both) in all.iter_mut().enumerate() {
            for (way, stream) in both.iter_mut().enumerate() {
                stream.rng = Stream::random(seed, name, number, way);
            }
        }
    }
}

/// Counts of the messages from one host to another.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Crossed {
    /// Protocol messages, as the sender counts them: what was sent, lost, doubled or damaged.
    pub messages: Tally,
    /// Messages between agents and the controller.
    pub body_messages: u64,
}

/// Counts of the messages between hosts, by sender and receiver.
pub type Crossings = BTreeMap<(HostId, HostId), Crossed>;

/// The streams between the controller and the other hosts, and the counts of what crosses.
#[derive(Clone)]
pub(super) struct HostStreams {
    pub hosts: Arc<Hosts>,
    /// For each host the streams to the controller and from it.
    pub streams: Vec<[Stream; 2]>,
    crossings: Crossings,
}

impl HostStreams {
    pub fn new(hosts: Arc<Hosts>, seed: u64) -> HostStreams {
        let streams = (0..hosts.len()).map(|host| Stream::both(seed, "hosts", host)).collect();
        HostStreams { hosts, streams, crossings: Crossings::new() }
    }

    /// Returns the counts of what crosses from one module to another; `None` if both are on one host.
    pub fn crossed(&mut self, from: ModuleId, to: ModuleId) -> Option<&mut Crossed> {
        let pair = (self.hosts.home(from), self.hosts.home(to));
        (pair.0 != pair.1).then(|| self.crossings.entry(pair).or_default())
    }

    /// Returns when a message between the controller and a module arrives that the stream of the module's host takes at
    /// `at`; `None` if the module is on the controller's host.
    fn delivery(&mut self, at: Time, id: ModuleId, is_up: bool) -> Option<Time> {
        let home = self.hosts.home(id);
        if home == HostId::CONTROLLER {
            return None;
        }
        let pair = if is_up { (home, HostId::CONTROLLER) } else { (HostId::CONTROLLER, home) };
        self.crossings.entry(pair).or_default().body_messages += 1;
        let Stream { rng, last } = &mut self.streams[home.index()][usize::from(!is_up)];
        Some(self.hosts.stream(home, at, rng, last))
    }
}

/// Counts of the messages between the controller and the agents.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ControlCounts {
    /// Orders to living agents.
    pub orders: u64,
    /// Reports.
    pub reports: u64,
    /// Bytes of orders and reports, headers included; what was sent again counts once.
    pub bytes: u64,
    /// Sendings of orders and reports that were lost, after each of which they were sent again.
    pub lost: u64,
}

/// The link of orders and reports, and the streams of each module on it.
#[derive(Clone)]
pub(super) struct ControlStreams {
    link: ControllerLink,
    /// For each module the streams to the controller and from it.
    pub streams: Vec<[Stream; 2]>,
}

impl ControlStreams {
    pub fn new(link: ControllerLink, modules: usize, seed: u64) -> ControlStreams {
        let streams = (0..modules).map(|module| Stream::both(seed, "controller link", module)).collect();
        ControlStreams { link, streams }
    }
}

impl<W: Audited, D: DirectorPort<W>> Sim<W, D> {
    /// Returns what has crossed between hosts; empty if there is only one.
    pub fn crossings(&self) -> Crossings {
        self.hosts.as_ref().map(|hosts| hosts.crossings.clone()).unwrap_or_default()
    }

    /// Returns what has passed between the controller and the agents.
    pub fn control(&self) -> ControlCounts {
        self.control
    }

    /// Passes a message between an agent and the controller: at once, or by the links that it has to take.
    pub(super) fn pass(&mut self, id: ModuleId, message: BodyMessage<W::Agent>) {
        let module = &self.modules[id.index()];
        let (is_up, control) = (message.is_to_controller(), message.control_bytes());
        if let Some(bytes) = control.filter(|_| module.is_alive()) {
            let count = if is_up { &mut self.control.reports } else { &mut self.control.orders };
            *count += 1;
            self.control.bytes += bytes;
        }
        // An agent starts with its first contacts, which its start and they have on one stream.
        let is_first = module.started == self.now && matches!(message, BodyMessage::Sensed(_));
        if is_first || (self.hosts.is_none() && self.controller.is_none()) {
            return self.hand_over(id, message);
        }
        // A message for a dead process is dropped.
        if !module.is_alive() {
            return;
        }
        let mut delivery = None;
        if let Some(ControlStreams { link, streams }) = self.controller.as_mut().filter(|_| control.is_some())
        {
            let Stream { rng, last } = &mut streams[id.index()][usize::from(!is_up)];
            let (at, lost) = link.carry(self.now, rng, last);
            self.control.lost += u64::from(lost);
            delivery = Some(at);
        }
        if let Some(hosts) = &mut self.hosts {
            delivery = hosts.delivery(delivery.unwrap_or(self.now), id, is_up).or(delivery);
        }
        let Some(at) = delivery else { return self.hand_over(id, message) };
        let posted = Posted { id, incarnation: module.incarnation, message };
        // Invariant: 2^32 messages under way would not fit into memory.
        let index = self.posted.insert(posted) as u32;
        self.queue.push(at, Event::Posted(index));
    }

    /// Hands over what a link delivers. The controller takes nothing from an incarnation that it knows to be dead,
    /// because neighbours of the dead module rely on its body standing still.
    pub(super) fn posted_arrives(&mut self, index: u32) {
        let Posted { id, incarnation, message } = self.posted.remove(index as usize);
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
        self.findings.checked += 1;
        let (agents, mut found) = (Agents::of(&self.modules), Vec::new());
        self.world.audit_action(self.now, id, &agents, &mut found);
        found.into_iter().for_each(|v| self.findings.note(v));
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
