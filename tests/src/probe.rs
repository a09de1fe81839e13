//! A family of modules for testing drivers: bodies with ports that a test joins and separates, and
//! agents that send what they are ordered to and report all that happens to them.

use metamorph_protocol::agent::{Agent, Birth, Input, InputOf, Output, OutputOf};
use metamorph_protocol::counters::Class;
use metamorph_protocol::ids::{Incarnation, ModuleId, Port, Revision, Session};
use metamorph_protocol::runtime::{Contact, Sensed};
use metamorph_protocol::time::{Span, Time};
use metamorph_protocol::wire::{Decoder, Encoder, Wire, WireError};
use metamorph_sim_bridge::world::World;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, VecDeque};
use std::hash::Hasher;
use std::sync::Arc;

/// Ports of a probe.
pub const PORTS: usize = 6;

/// What all probes share: ballast, so that a swarm file has something to carry.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ProbeSetup {
    /// Anything.
    pub ballast: Vec<u8>,
}

/// Where a probe stands: on a line, at its own number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProbePlace(pub u32);

/// What probes say to each other: a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProbeMessage(pub u32);

/// The only action of a probe: a request to its body, with a number that the answer repeats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Touch(pub u32);

/// The answer of a body to a [`Touch`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Felt {
    /// The number of the touch.
    pub token: u32,
    /// Whether the agent knew all contact changes of its body when it acted.
    pub current: bool,
}

/// What a test wants of a probe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProbeOrder {
    /// Send `count` consecutive numbers from `first` on.
    Send {
        /// By this port.
        port: Port,
        /// The first number.
        first: u32,
        /// How many.
        count: u32,
    },
    /// Answer, so that the test knows that everything before has been handled.
    Ping(u32),
    /// Ask the body for something.
    Touch(u32),
    /// Send one message by every port with a contact in each period.
    Chat(Span),
    /// Break down.
    Panic,
    /// Take nothing any more.
    Hang,
}

/// What a probe tells the test.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ProbeReport {
    /// The agent has started.
    Born {
        /// Which incarnation it is.
        incarnation: Incarnation,
        /// Where it stands.
        place: u32,
    },
    /// The contact on a port changed.
    Contact {
        /// Which port.
        port: Port,
        /// The session, if there is one.
        session: Option<Session>,
    },
    /// A message arrived.
    Got {
        /// By this port.
        port: Port,
        /// The number.
        number: u32,
    },
    /// The answer to a ping.
    Pong(u32),
    /// The answer of the body.
    Felt(Felt),
}

/// The agent.
#[derive(Debug)]
pub struct Probe {
    contacts: [Option<Session>; PORTS],
    outputs: VecDeque<OutputOf<Probe>>,
    chat: Option<Span>,
    wake_at: Time,
    chatted: u32,
}

impl Agent for Probe {
    type Setup = ProbeSetup;
    type Place = ProbePlace;
    type Message = ProbeMessage;
    type Action = Touch;
    type Percept = Felt;
    type Order = ProbeOrder;
    type Report = ProbeReport;
    const PORTS: usize = PORTS;

    fn new(_: &Arc<ProbeSetup>, birth: Birth<ProbePlace>, _: Time) -> Probe {
        let born = ProbeReport::Born { incarnation: birth.incarnation, place: birth.place.0 };
        Probe {
            contacts: [None; PORTS],
            outputs: VecDeque::from([Output::Report(born)]),
            chat: None,
            wake_at: Time::NEVER,
            chatted: 0,
        }
    }

    fn handle(&mut self, now: Time, input: InputOf<Probe>) {
        match input {
            Input::Contact { port, session } => {
                self.contacts[port.index()] = session;
                self.report(ProbeReport::Contact { port, session });
            }
            Input::Message { port, message } => {
                // What is merely chatted is not worth a report.
                if self.chat.is_none() {
                    self.report(ProbeReport::Got { port, number: message.0 });
                }
            }
            Input::Percept(felt) => self.report(ProbeReport::Felt(felt)),
            Input::Order(ProbeOrder::Send { port, first, count }) => {
                for number in first..first.saturating_add(count) {
                    self.send(port, number);
                }
            }
            Input::Order(ProbeOrder::Ping(token)) => self.report(ProbeReport::Pong(token)),
            Input::Order(ProbeOrder::Touch(token)) => self.outputs.push_back(Output::Act(Touch(token))),
            Input::Order(ProbeOrder::Chat(period)) => {
                self.chat = Some(period);
                self.wake_at = now + period;
            }
            Input::Order(ProbeOrder::Panic) => panic!("a probe was ordered to break down"),
            Input::Order(ProbeOrder::Hang) => loop {
                std::thread::park();
            },
            Input::Wake => {
                if let Some(period) = self.chat {
                    self.wake_at = now + period;
                    self.chatted += 1;
                    for port in 0..PORTS {
                        if self.contacts[port].is_some() {
                            self.send(Port(port as u8), self.chatted);
                        }
                    }
                }
            }
        }
    }

    fn poll(&mut self) -> Option<OutputOf<Probe>> {
        self.outputs.pop_front()
    }

    fn wake_at(&self) -> Time {
        self.wake_at
    }

    fn digest(&self, hasher: &mut dyn Hasher) {
        for session in self.contacts {
            hasher.write_u32(session.map_or(0, |s| s.0.wrapping_add(1)));
        }
        hasher.write_u64(self.wake_at.0);
        hasher.write_u32(self.chatted);
    }
}

impl Probe {
    fn report(&mut self, report: ProbeReport) {
        self.outputs.push_back(Output::Report(report));
    }
    fn send(&mut self, port: Port, number: u32) {
        let message = ProbeMessage(number);
        self.outputs.push_back(Output::Send { port, class: Class::Gradient, message });
    }
}

/// Bodies whose contacts a test changes.
#[derive(Clone, Debug)]
pub struct ProbeWorld {
    incarnations: Vec<Incarnation>,
    revisions: Vec<Revision>,
    joints: BTreeMap<(ModuleId, Port), (ModuleId, Port, Session)>,
    sessions: u32,
    sensed: VecDeque<(ModuleId, Sensed<Felt>)>,
}

impl ProbeWorld {
    /// Creates `count` bodies without contacts.
    pub fn new(count: u32) -> ProbeWorld {
        ProbeWorld {
            incarnations: vec![Incarnation(0); count as usize],
            revisions: vec![Revision(0); count as usize],
            joints: BTreeMap::new(),
            sessions: 0,
            sensed: VecDeque::new(),
        }
    }

    /// `count` bodies in a line: port 1 of each touches port 0 of the next.
    pub fn line(count: u32) -> ProbeWorld {
        let mut world = ProbeWorld::new(count);
        for i in 1..count {
            world.join((ModuleId(i - 1), Port(1)), (ModuleId(i), Port(0)));
        }
        world
    }

    /// Joins two free ports.
    pub fn join(&mut self, a: (ModuleId, Port), b: (ModuleId, Port)) {
        assert!(!self.joints.contains_key(&a) && !self.joints.contains_key(&b), "a port is taken");
        self.sessions += 1;
        let session = Session(self.sessions);
        self.joints.insert(a, (b.0, b.1, session));
        self.joints.insert(b, (a.0, a.1, session));
        self.sense(a);
        self.sense(b);
    }

    /// Separates a port from whatever touches it.
    pub fn part(&mut self, a: (ModuleId, Port)) {
        let (peer, port, _) = self.joints.remove(&a).expect("the script parts what is joined");
        self.joints.remove(&(peer, port));
        self.sense(a);
        self.sense((peer, port));
    }

    fn sense(&mut self, (id, port): (ModuleId, Port)) {
        self.revisions[id.index()].0 += 1;
        let contact = self.joints.get(&(id, port)).map(|&(peer, peer_port, session)| Contact {
            session,
            peer,
            peer_incarnation: self.incarnations[peer.index()],
            peer_port,
        });
        let revision = self.revisions[id.index()];
        self.sensed.push_back((id, Sensed::Contact { port, revision, contact }));
    }
}

impl World for ProbeWorld {
    type Agent = Probe;

    fn len(&self) -> usize {
        self.incarnations.len()
    }
    fn place(&self, id: ModuleId) -> ProbePlace {
        ProbePlace(id.0)
    }
    fn start(&mut self, _: Time, id: ModuleId, incarnation: Incarnation) {
        self.incarnations[id.index()] = incarnation;
        for port in (0..PORTS as u8).map(Port) {
            if let Some(&(peer, peer_port, _)) = self.joints.get(&(id, port)) {
                self.sessions += 1;
                let session = Session(self.sessions);
                self.joints.insert((id, port), (peer, peer_port, session));
                self.joints.insert((peer, peer_port), (id, port, session));
                self.sense((id, port));
                self.sense((peer, peer_port));
            }
        }
    }
    fn act(&mut self, _: Time, id: ModuleId, sensed: Revision, action: &Touch) {
        let current = sensed == self.revisions[id.index()];
        self.sensed.push_back((id, Sensed::Percept(Felt { token: action.0, current })));
    }
    fn next_event(&self) -> Time {
        Time::NEVER
    }
    fn advance(&mut self, _: Time) {}
    fn poll(&mut self) -> Option<(ModuleId, Sensed<Felt>)> {
        self.sensed.pop_front()
    }
}

/// Implements [`Wire`] for a type that consists of one number, with a single kind.
macro_rules! number {
    ($name:ident) => {
        impl Wire for $name {
            fn kind(&self) -> u8 {
                0
            }
            fn encode(&self, out: &mut Encoder) {
                out.u32(self.0);
            }
            fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<$name, WireError> {
                if kind == 0 { Ok($name(from.u32()?)) } else { Err(WireError::Kind(kind)) }
            }
        }
    };
}
number!(ProbePlace);
number!(ProbeMessage);
number!(Touch);

impl Wire for Felt {
    fn kind(&self) -> u8 {
        0
    }
    fn encode(&self, out: &mut Encoder) {
        out.u32(self.token);
        out.bool(self.current);
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<Felt, WireError> {
        if kind != 0 {
            return Err(WireError::Kind(kind));
        }
        Ok(Felt { token: from.u32()?, current: from.bool("current")? })
    }
}

impl Wire for ProbeOrder {
    fn kind(&self) -> u8 {
        match self {
            ProbeOrder::Send { .. } => 0,
            ProbeOrder::Ping(_) => 1,
            ProbeOrder::Touch(_) => 2,
            ProbeOrder::Chat(_) => 3,
            ProbeOrder::Panic => 4,
            ProbeOrder::Hang => 5,
        }
    }
    fn encode(&self, out: &mut Encoder) {
        match self {
            ProbeOrder::Send { port, first, count } => {
                out.u8(port.0);
                out.u32(*first);
                out.u32(*count);
            }
            ProbeOrder::Ping(token) | ProbeOrder::Touch(token) => out.u32(*token),
            ProbeOrder::Chat(period) => out.u64(period.0),
            ProbeOrder::Panic | ProbeOrder::Hang => {}
        }
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<ProbeOrder, WireError> {
        match kind {
            0 => Ok(ProbeOrder::Send { port: port(from)?, first: from.u32()?, count: from.u32()? }),
            1 => Ok(ProbeOrder::Ping(from.u32()?)),
            2 => Ok(ProbeOrder::Touch(from.u32()?)),
            3 => Ok(ProbeOrder::Chat(Span(from.u64()?))),
            4 => Ok(ProbeOrder::Panic),
            5 => Ok(ProbeOrder::Hang),
            _ => Err(WireError::Kind(kind)),
        }
    }
}

impl Wire for ProbeReport {
    fn kind(&self) -> u8 {
        match self {
            ProbeReport::Born { .. } => 0,
            ProbeReport::Contact { .. } => 1,
            ProbeReport::Got { .. } => 2,
            ProbeReport::Pong(_) => 3,
            ProbeReport::Felt(_) => 4,
        }
    }
    fn encode(&self, out: &mut Encoder) {
        match self {
            ProbeReport::Born { incarnation, place } => {
                out.u16(incarnation.0);
                out.u32(*place);
            }
            ProbeReport::Contact { port, session } => {
                out.u8(port.0);
                out.bool(session.is_some());
                out.u32(session.map_or(0, |s| s.0));
            }
            ProbeReport::Got { port, number } => {
                out.u8(port.0);
                out.u32(*number);
            }
            ProbeReport::Pong(token) => out.u32(*token),
            ProbeReport::Felt(felt) => felt.encode(out),
        }
    }
    fn decode(kind: u8, from: &mut Decoder<'_>) -> Result<ProbeReport, WireError> {
        match kind {
            0 => Ok(ProbeReport::Born { incarnation: Incarnation(from.u16()?), place: from.u32()? }),
            1 => {
                let (port, present, session) = (port(from)?, from.bool("session")?, from.u32()?);
                Ok(ProbeReport::Contact { port, session: present.then_some(Session(session)) })
            }
            2 => Ok(ProbeReport::Got { port: port(from)?, number: from.u32()? }),
            3 => Ok(ProbeReport::Pong(from.u32()?)),
            4 => Ok(ProbeReport::Felt(Felt::decode(0, from)?)),
            _ => Err(WireError::Kind(kind)),
        }
    }
}

fn port(from: &mut Decoder<'_>) -> Result<Port, WireError> {
    match from.u8()? {
        port if usize::from(port) < PORTS => Ok(Port(port)),
        _ => Err(WireError::Field("port")),
    }
}
