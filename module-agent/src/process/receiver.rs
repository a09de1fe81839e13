//! The receiving half of an agent process: checks every frame of its inbox, counts those it refuses, and
//! turns the rest into inputs and life-cycle messages. Not here: handing them to the agent.

use crate::process::contacts::{Contacts, Place};
use crate::process::runtime_message::RuntimeMessage;
use crate::run_dir::counter_file::AgentCounters;
use crate::transport::shared_frame::SharedFrame;
use metamorph_protocol::agent::{Agent, Input, InputOf};
use metamorph_protocol::counters::Class;
use metamorph_protocol::ids::{ModuleId, Port, Revision};
use metamorph_protocol::link::LinkChanges;
use metamorph_protocol::record::MessageName;
use metamorph_protocol::runtime::Contact;
use metamorph_protocol::wire::{CONTROLLER, Channel, Frame, Header};

/// The stage of an agent process in its life cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Stage {
    /// Its agent has not begun.
    Waiting,
    /// The agent runs.
    Running,
    /// The run is over: nothing is handed in or sent any more.
    Silent,
    /// All other agents are silent too: the inbox is complete.
    Ending,
}

/// The meaning of a frame for the process.
pub enum Received<A: Agent> {
    /// Nothing to do: the frame has been counted, or waits for its contact.
    Nothing,
    /// An input for the agent; for a message from a peer, with its name and class.
    Input(InputOf<A>, Option<(MessageName, Class)>),
    /// The agent begins at this place.
    Begin(A::Place),
    /// The contact on a port changed.
    Contact {
        /// The port.
        port: Port,
        /// The count of contact changes of the body, this one included.
        revision: Revision,
        /// The other end of the port now.
        contact: Option<Contact>,
    },
    /// This is changed about its links from now on.
    Links(LinkChanges),
    /// The run is over.
    Stop,
    /// The inbox is complete, and the process ends.
    End,
    /// There may be a new controller.
    Return,
    /// The controller asks which messages have been taken.
    Leave,
}

/// The receiving half of one incarnation of an agent.
#[derive(Debug)]
pub struct Receiver {
    id: ModuleId,
    /// True if the link emulator may damage frames, so that a damaged frame may come from a member of the
    /// run.
    damage_expected: bool,
    /// The sequence number that the next frame of the controller must carry.
    expected: u32,
    stage: Stage,
}

impl Receiver {
    /// Creates a receiver whose agent has not begun.
    pub fn new(id: ModuleId, damage_expected: bool) -> Receiver {
        Receiver { id, damage_expected, expected: 0, stage: Stage::Waiting }
    }

    /// Returns the sequence number that the next frame of the controller must carry.
    pub fn expected(&self) -> u32 {
        self.expected
    }

    /// True if the run is over.
    pub fn is_silent(&self) -> bool {
        self.stage >= Stage::Silent
    }

    /// True if all agents are silent, so that no more frames come and the process is to end.
    pub fn is_ending(&self) -> bool {
        self.stage == Stage::Ending
    }

    /// Checks one frame and returns what it means. Calls `monotonic`, which reads the clock, only if the
    /// frame has to wait for its contact.
    pub fn accept<A: Agent, L>(
        &mut self,
        shared: &SharedFrame,
        contacts: &mut Contacts<L>,
        counters: &mut AgentCounters,
        monotonic: impl FnOnce() -> u64,
    ) -> Received<A> {
        let frame = &shared.frame();
        let Ok(header) = frame.open() else {
            match shared.damaged_class().filter(|_| self.damage_expected) {
                Some(class) if self.is_silent() => counters.left[class.index()] += 1,
                Some(class) => counters.tally[class].refused += 1,
                None => counters.foreign += 1,
            }
            return Received::Nothing;
        };
        let received = match header.channel {
            _ if header.destination != self.id => None,
            Channel::Peer => return self.accept_peer(header, shared, contacts, counters, monotonic),
            _ => self.accept_controller(&header, frame, contacts),
        };
        received.unwrap_or_else(|| {
            tracing::debug!(?header, "a frame that no member of the run would send");
            counters.foreign += 1;
            Received::Nothing
        })
    }

    fn accept_peer<A: Agent, L>(
        &mut self,
        header: Header,
        shared: &SharedFrame,
        contacts: &mut Contacts<L>,
        counters: &mut AgentCounters,
        monotonic: impl FnOnce() -> u64,
    ) -> Received<A> {
        match contacts.place(&header) {
            Place::Here(_) if self.is_silent() => counters.left[header.class.index()] += 1,
            Place::Here(port) => return self.message(port, &header, &shared.frame(), counters),
            Place::Ended => counters.tally[header.class].expired += 1,
            Place::Early => {
                if let Some(class) = contacts.keep(monotonic(), header, *shared) {
                    counters.tally[class].expired += 1;
                }
            }
            Place::Impostor => counters.foreign += 1,
        }
        Received::Nothing
    }

    /// Takes a message that belongs to the contact of this port.
    pub fn message<A: Agent>(
        &self,
        port: Port,
        header: &Header,
        frame: &Frame,
        counters: &mut AgentCounters,
    ) -> Received<A> {
        let Ok(message) = frame.message::<A::Message>() else {
            counters.foreign += 1;
            return Received::Nothing;
        };
        counters.tally[header.class].delivered += 1;
        let name =
            MessageName { from: header.source, incarnation: header.incarnation, number: header.sequence };
        Received::Input(Input::Message { port, message }, Some((name, header.class)))
    }

    /// Takes a frame from the controller; `None` if the controller cannot have sent it.
    fn accept_controller<A: Agent, L>(
        &mut self,
        header: &Header,
        frame: &Frame,
        contacts: &Contacts<L>,
    ) -> Option<Received<A>> {
        if header.source != CONTROLLER {
            return None;
        }
        let runtime = match header.channel {
            Channel::Runtime => Some(frame.message::<RuntimeMessage<A::Place>>().ok()?),
            _ => None,
        };
        match &runtime {
            Some(RuntimeMessage::Return) => return Some(Received::Return),
            Some(RuntimeMessage::Leave) => return Some(Received::Leave),
            _ if header.sequence != self.expected => return None,
            _ => {}
        }
        let received = match (runtime, header.channel) {
            (Some(message), _) => self.accept_runtime(message, contacts)?,
            (None, _) if self.stage == Stage::Waiting => return None,
            (None, Channel::Body) => Received::Input(Input::Percept(frame.message().ok()?), None),
            (None, _) => Received::Input(Input::Order(frame.message().ok()?), None),
        };
        self.expected = self.expected.wrapping_add(1);
        Some(received)
    }

    fn accept_runtime<A: Agent, L>(
        &mut self,
        message: RuntimeMessage<A::Place>,
        contacts: &Contacts<L>,
    ) -> Option<Received<A>> {
        match message {
            RuntimeMessage::Begin { place } if self.stage == Stage::Waiting => {
                self.stage = Stage::Running;
                Some(Received::Begin(place))
            }
            RuntimeMessage::Contact { port, revision, contact } if contacts.has_port(port) => {
                Some(Received::Contact { port, revision, contact })
            }
            RuntimeMessage::Links(changes) => Some(Received::Links(changes)),
            RuntimeMessage::Stop if !self.is_ending() => {
                self.stage = Stage::Silent;
                Some(Received::Stop)
            }
            RuntimeMessage::End if self.is_silent() => {
                self.stage = Stage::Ending;
                Some(Received::End)
            }
            _ => None,
        }
    }
}
