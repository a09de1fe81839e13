//! The controller's view of one agent process: its current incarnation, and the messages that wait for it.
//!
//! Messages to an agent are reliable and in order. They wait here while the agent's inbox is full, for
//! example because its process is stopped. The queue is bounded: first, contact changes superseded by a later
//! one of the same port are dropped; if that is not enough, the process counts as unresponsive.

use crate::swarm::links::AgentLink;
use metamorph_module_agent::process::runtime_message::RuntimeMessage;
use metamorph_module_agent::transport::shared_frame::SharedFrame;
use metamorph_module_agent::transport::{AgentKey, Link, SendStatus};
use metamorph_protocol::agent::Agent;
use metamorph_protocol::counters::Class;
use metamorph_protocol::ids::{Incarnation, ModuleId, Port};
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::{CONTROLLER, Channel, Frame, Header, Wire};
use std::collections::{BTreeSet, VecDeque};

/// Number of messages that may wait for one agent.
pub const QUEUE_LIMIT: usize = 4_096;
/// The first and the longest wait before a full inbox is tried again, in nanoseconds.
const RETRY: (u64, u64) = (1_000_000, 200_000_000);

/// One message to an agent.
#[derive(Clone, Debug)]
pub enum ControlMessage<A: Agent> {
    /// Life cycle or contacts.
    Runtime(RuntimeMessage<A::Place>),
    /// From the body.
    Percept(A::Percept),
    /// From the director.
    Order(A::Order),
}

/// The stage of a process in its life cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Not started, or dead.
    Absent,
    /// Started, but not heard of yet.
    Starting,
    /// Up, waiting to begin.
    Up,
    /// Started under an earlier controller, and not heard of since.
    Lost,
    /// Its agent has started.
    Running,
    /// The run is over, and the agent sends no more.
    Silent,
    /// It has looked into its inbox since all others sent no more.
    Settled,
}

/// The process of one module.
pub struct Process<A: Agent, L> {
    /// The module.
    pub id: ModuleId,
    /// The current or latest incarnation.
    pub incarnation: Incarnation,
    /// The stage of this incarnation.
    pub stage: Stage,
    /// True if the process is to end.
    pub terminating: bool,
    /// Why the driver itself had to kill it.
    pub verdict: Option<&'static str>,
    /// True if it is restarted as soon as it is dead.
    pub restart: bool,
    /// True if it is stopped by a signal of this controller.
    pub paused: bool,
    /// When it was last continued after a stop.
    pub resumed_at: Time,
    /// True if it was stopped from outside.
    pub halted: bool,
    /// The next sequence number that it will use.
    pub expected: u32,
    /// Actions and reports of this incarnation that earlier controllers have taken.
    pub heard: u32,
    /// True if it is in the list of processes with waiting messages.
    pub listed: bool,
    link: Option<AgentLink<L>>,
    queue: VecDeque<ControlMessage<A>>,
    /// All messages of earlier controllers to this incarnation, from its beginning on, until it reports how
    /// many it has taken.
    backlog: VecDeque<ControlMessage<A>>,
    sequence: u32,
    retry_at: u64,
    retry_after: u64,
}

impl<A: Agent, L: Link> Process<A, L> {
    /// Returns a module without a process.
    pub fn new(id: ModuleId) -> Process<A, L> {
        Process {
            id,
            incarnation: Incarnation(0),
            stage: Stage::Absent,
            terminating: false,
            verdict: None,
            restart: false,
            paused: false,
            resumed_at: Time::ZERO,
            halted: false,
            expected: 0,
            heard: 0,
            listed: false,
            link: None,
            queue: VecDeque::new(),
            backlog: VecDeque::new(),
            sequence: 0,
            retry_at: 0,
            retry_after: RETRY.0,
        }
    }

    /// Returns its current or latest incarnation.
    pub fn key(&self) -> AgentKey {
        (self.id, self.incarnation)
    }

    /// Begins an incarnation.
    pub fn launch(&mut self, incarnation: Incarnation) {
        let listed = self.listed;
        *self = Process { incarnation, stage: Stage::Starting, listed, ..Process::new(self.id) };
    }

    /// Takes over a running incarnation from earlier controllers. `heard` is the number of actions and reports
    /// that they have taken from it; `backlog` holds all that they have sent to it.
    pub fn take_over(&mut self, incarnation: Incarnation, heard: u32, backlog: VecDeque<ControlMessage<A>>) {
        let listed = self.listed;
        *self = Process { incarnation, stage: Stage::Lost, heard, backlog, listed, ..Process::new(self.id) };
    }

    /// Asks an incarnation that an earlier controller has started to turn to this one.
    pub fn call(&mut self, now: Time) {
        self.say_aside(RuntimeMessage::Return, now);
    }

    /// Sends a message out of sequence. Returns true if it was sent.
    fn say_aside(&mut self, message: RuntimeMessage<A::Place>, now: Time) -> bool {
        let Some(AgentLink { link, .. }) = &mut self.link else { return false };
        let frame = seal::<A>(&ControlMessage::Runtime(message), self.id, u32::MAX);
        let status = link.send(SharedFrame::new(&frame, now));
        link.flush();
        status == SendStatus::Sent
    }

    /// Returns when the link to the process was last used; `None` if it is closed or has to stay open.
    pub fn idle_since(&self) -> Option<u64> {
        let link = self.link.as_ref()?;
        // A stopped process would not answer.
        let idle =
            self.stage == Stage::Running && self.queue.is_empty() && !self.is_stopped() && !link.is_asked();
        idle.then_some(link.used)
    }

    /// Asks the process which messages it has taken, in order to close the link: those not taken would be
    /// lost.
    pub fn leave(&mut self, now: Time) {
        if self.say_aside(RuntimeMessage::Leave, now)
            && let Some(link) = &mut self.link
        {
            link.ask();
        }
    }

    /// Notes that it has taken all messages before this number. The link is closed if those are all.
    pub fn has_taken(&mut self, expected: u32) {
        let Some(link) = &mut self.link else { return };
        if link.answer() && self.queue.is_empty() && expected == self.sequence {
            self.link = None;
        }
    }

    /// Notes that it has turned to this controller and expects the message of this number. Messages from
    /// there on are sent again. Returns false if it claims to have taken more messages than were sent to it.
    pub fn found(&mut self, expected: u32) -> bool {
        if expected as usize > self.backlog.len() {
            return false;
        }
        self.backlog.drain(..expected as usize);
        self.backlog.append(&mut self.queue);
        self.queue = std::mem::take(&mut self.backlog);
        self.sequence = expected;
        self.stage = Stage::Running;
        true
    }

    /// Sets the open link to the process.
    pub fn connect(&mut self, link: AgentLink<L>) {
        self.link = Some(link);
    }
    /// True if messages wait for it, but it has no link.
    pub fn needs_link(&self) -> bool {
        self.link.is_none()
            && !self.queue.is_empty()
            && matches!(self.stage, Stage::Up | Stage::Running | Stage::Silent | Stage::Settled)
    }

    /// Notes that it has taken all messages and sends no more, or has settled after that. The link is closed, as other
    /// processes may need one.
    pub fn fall_silent(&mut self) {
        self.stage = if self.stage == Stage::Silent { Stage::Settled } else { Stage::Silent };
        if self.queue.is_empty() {
            self.link = None;
        }
    }

    /// True if it is stopped, by this controller or from outside.
    pub fn is_stopped(&self) -> bool {
        self.paused || self.halted
    }

    /// Ends the incarnation and drops the messages that waited for it.
    pub fn end(&mut self) {
        self.stage = Stage::Absent;
        self.link = None;
        self.queue.clear();
        (self.paused, self.halted) = (false, false);
    }

    /// Queues a message. Returns false if too many wait, which happens only if the process does not run.
    pub fn tell(&mut self, message: ControlMessage<A>) -> bool {
        if self.queue.len() >= QUEUE_LIMIT {
            self.drop_overtaken();
        }
        if self.queue.len() >= QUEUE_LIMIT {
            return false;
        }
        self.queue.push_back(message);
        true
    }

    fn drop_overtaken(&mut self) {
        let mut later: BTreeSet<Port> = BTreeSet::new();
        let mut kept: VecDeque<ControlMessage<A>> = VecDeque::with_capacity(self.queue.len());
        while let Some(message) = self.queue.pop_back() {
            let overtaken = match &message {
                ControlMessage::Runtime(RuntimeMessage::Contact { port, .. }) => !later.insert(*port),
                _ => false,
            };
            if !overtaken {
                kept.push_front(message);
            }
        }
        self.queue = kept;
    }

    /// Sends the messages that fit. Returns when to try again, in nanoseconds of CLOCK_MONOTONIC, if any is
    /// left. Nothing is sent in [`Stage::Lost`]: the agent's next sequence number is not known yet.
    pub fn flush(&mut self, now: u64, time: Time) -> Option<u64> {
        let AgentLink { link, used, .. } = self.link.as_mut()?;
        if self.queue.is_empty() || self.stage == Stage::Lost {
            return None;
        }
        *used = now;
        if self.retry_at > now {
            return Some(self.retry_at);
        }
        let mut sent = false;
        while let Some(message) = self.queue.front() {
            let frame = seal(message, self.id, self.sequence);
            if link.send(SharedFrame::new(&frame, time)) != SendStatus::Sent {
                break;
            }
            sent = true;
            self.sequence = self.sequence.wrapping_add(1);
            self.queue.pop_front();
        }
        link.flush();
        if self.queue.is_empty() {
            (self.retry_at, self.retry_after) = (0, RETRY.0);
            return None;
        }
        self.retry_after = if sent { RETRY.0 } else { (self.retry_after * 2).min(RETRY.1) };
        self.retry_at = now + self.retry_after;
        Some(self.retry_at)
    }

    /// Makes the next flush try at once, because the process was just continued.
    pub fn hurry(&mut self) {
        self.retry_at = 0;
    }
}

fn seal<A: Agent>(message: &ControlMessage<A>, destination: ModuleId, sequence: u32) -> Frame {
    let header = |channel, kind| Header {
        channel,
        kind,
        class: Class::World,
        port: Port(0),
        incarnation: Incarnation(0),
        source: CONTROLLER,
        destination,
        session: 0,
        sequence,
    };
    match message {
        ControlMessage::Runtime(m) => Frame::seal(header(Channel::Runtime, m.kind()), m),
        ControlMessage::Percept(m) => Frame::seal(header(Channel::Body, m.kind()), m),
        ControlMessage::Order(m) => Frame::seal(header(Channel::Control, m.kind()), m),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_module_agent::transport::memory::MemoryLink;
    use metamorph_protocol::agent::{Birth, InputOf, OutputOf};
    use metamorph_protocol::ids::{Revision, Session};
    use metamorph_protocol::lattice::Cell;
    use metamorph_protocol::runtime::Contact;
    use metamorph_protocol::wire::Never;
    use std::hash::Hasher;
    use std::sync::Arc;

    struct Idle;
    impl Agent for Idle {
        type Setup = ();
        type Place = Cell;
        type Message = Never;
        type Action = Never;
        type Percept = Never;
        type Order = Cell;
        type Report = Never;
        const PORTS: usize = 6;
        fn new(_: &Arc<()>, _: Birth<Cell>, _: Time) -> Idle {
            Idle
        }
        fn handle(&mut self, _: Time, _: InputOf<Idle>) {}
        fn poll(&mut self) -> Option<OutputOf<Idle>> {
            None
        }
        fn wake_at(&self) -> Time {
            Time::NEVER
        }
        fn digest(&self, _: &mut dyn Hasher) {}
    }

    fn contact(revision: u32) -> ControlMessage<Idle> {
        let contact = Contact {
            session: Session(revision),
            peer: ModuleId(1),
            peer_incarnation: Incarnation(0),
            peer_port: Port(0),
        };
        let (port, revision) = (Port((revision % 6) as u8), Revision(revision));
        ControlMessage::Runtime(RuntimeMessage::Contact { port, revision, contact: Some(contact) })
    }

    #[test]
    fn contact_changes_of_a_stopped_process_never_pile_up() {
        let mut process: Process<Idle, MemoryLink> = Process::new(ModuleId(0));
        let last = QUEUE_LIMIT as u32 * 5;
        for revision in 1..=last {
            assert!(process.tell(contact(revision)));
            assert!(process.queue.len() <= QUEUE_LIMIT);
        }
        // The rest ends with the latest change of each port, in order.
        process.drop_overtaken();
        let left: Vec<u32> = process
            .queue
            .iter()
            .filter_map(|message| match message {
                ControlMessage::Runtime(RuntimeMessage::Contact { revision, .. }) => Some(revision.0),
                _ => None,
            })
            .collect();
        assert_eq!(left, (last - 5..=last).collect::<Vec<_>>());
    }

    #[test]
    fn a_process_that_takes_nothing_for_ever_is_noticed() {
        let mut process: Process<Idle, MemoryLink> = Process::new(ModuleId(0));
        let told =
            (0..QUEUE_LIMIT * 2).take_while(|_| process.tell(ControlMessage::Order(Cell::default()))).count();
        assert_eq!(told, QUEUE_LIMIT);
    }
}
