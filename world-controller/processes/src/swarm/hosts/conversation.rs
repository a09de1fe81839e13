//! Conversations between the agents of a host and their controller, as far as their daemon has passed them on. When
//! another controller takes over, the daemon answers for its agents from this record, so that they need not notice.

use metamorph_module_agent::process::runtime_message::RuntimeMessage;
use metamorph_module_agent::transport::AgentKey;
use metamorph_module_agent::transport::shared_frame::SharedFrame;
use metamorph_protocol::counters::Class;
use metamorph_protocol::ids::{Incarnation, ModuleId, Port};
use metamorph_protocol::wire::{CONTROLLER, Channel, Frame, Header, Never, Wire};
use std::collections::{BTreeMap, BTreeSet};

/// The sequence number of messages of a controller that are out of sequence.
const ASIDE: u32 = u32::MAX;

type Message = RuntimeMessage<Never>;

/// The conversation of one incarnation of an agent.
#[derive(Debug)]
struct Conversation {
    /// Number of its actions and reports.
    told: u32,
    /// The sequence number of its next frame.
    next: u32,
    /// The sequence number that it expects next from a controller, once it has taken all that was put into its inbox.
    expected: u32,
    /// True if the present controller hears it.
    is_heard: bool,
}

/// The conversations of all agents of a host that have been started and have not ended.
#[derive(Debug, Default)]
pub struct Conversations {
    agents: BTreeMap<AgentKey, Conversation>,
    latest: BTreeMap<ModuleId, Incarnation>,
    /// Agents that have ended.
    ended: BTreeSet<AgentKey>,
    /// Agents that no controller wants any more.
    unwanted: BTreeSet<AgentKey>,
}

impl Conversations {
    /// Notes that an agent is being started.
    pub fn begin(&mut self, agent: AgentKey) {
        self.latest.insert(agent.0, agent.1);
        self.agents.insert(agent, Conversation { told: 0, next: 0, expected: 0, is_heard: true });
    }

    /// Notes that an agent has ended. Returns false if the controller does not know of it.
    pub fn end(&mut self, agent: AgentKey) -> bool {
        self.agents.remove(&agent);
        self.ended.insert(agent);
        !self.unwanted.remove(&agent)
    }

    /// Returns the number of agents.
    pub fn count(&self) -> usize {
        self.agents.len()
    }

    /// Notes a frame of an agent for the controller. Returns false if the controller finds what it says in the journal.
    pub fn hear(&mut self, frame: &Frame) -> bool {
        let Ok(header) = frame.open() else { return true };
        let Some(agent) = self.agents.get_mut(&(header.source, header.incarnation)) else { return true };
        agent.next = header.sequence.wrapping_add(1);
        agent.told += u32::from(matches!(header.channel, Channel::Body | Channel::Control));
        agent.is_heard
    }

    /// Notes a frame of the controller for an agent. Returns the answer if this is the call of a controller that has taken
    /// over: then the frame is not for the agent itself.
    pub fn tell(&mut self, key: AgentKey, shared: &SharedFrame) -> Option<SharedFrame> {
        let (header, agent) = (shared.frame().open().ok()?, self.agents.get_mut(&key)?);
        if header.sequence != ASIDE {
            agent.expected = header.sequence.wrapping_add(1);
            return None;
        }
        if (header.channel, header.kind) != (Channel::Runtime, Message::Return.kind()) {
            return None;
        }
        agent.is_heard = true;
        let here = Message::Here { told: agent.told, expected: agent.expected };
        let header = Header {
            channel: Channel::Runtime,
            kind: here.kind(),
            class: Class::World,
            port: Port(0),
            incarnation: key.1,
            source: key.0,
            destination: CONTROLLER,
            session: 0,
            sequence: agent.next.wrapping_sub(1),
        };
        Some(SharedFrame::new(&Frame::seal(header, &here), shared.sent()))
    }

    /// Notes that another controller has taken over, which wants these agents. Returns those that it does not want.
    pub fn take_over(&mut self, wanted: &BTreeSet<AgentKey>) -> Vec<AgentKey> {
        self.agents.values_mut().for_each(|agent| agent.is_heard = false);
        let unwanted: Vec<AgentKey> =
            self.agents.keys().copied().filter(|agent| !wanted.contains(agent)).collect();
        self.unwanted.extend(&unwanted);
        unwanted
    }

    /// Returns those of `wanted` that live.
    pub fn present(&self, wanted: &BTreeSet<AgentKey>) -> Vec<AgentKey> {
        wanted.iter().copied().filter(|agent| self.agents.contains_key(agent)).collect()
    }

    /// Iterates over the agents that have ended here.
    pub fn ended(&self) -> impl Iterator<Item = AgentKey> {
        self.ended.iter().copied()
    }

    /// Returns the latest incarnation of each module that has been started here.
    pub fn latest(&self) -> Vec<AgentKey> {
        self.latest.iter().map(|(id, incarnation)| (*id, *incarnation)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::lattice::Cell;
    use metamorph_protocol::time::Time;

    const AGENT: AgentKey = (ModuleId(7), Incarnation(1));

    fn frame(channel: Channel, sequence: u32, from_agent: bool) -> Frame {
        let (source, destination) = if from_agent { (AGENT.0, CONTROLLER) } else { (CONTROLLER, AGENT.0) };
        let (class, port, session) = (Class::World, Port(0), 0);
        let (kind, incarnation) = (Cell::default().kind(), AGENT.1);
        let header =
            Header { channel, kind, class, port, incarnation, source, destination, session, sequence };
        Frame::seal(header, &Cell::default())
    }

    fn call() -> SharedFrame {
        let (header, kind) = (frame(Channel::Runtime, ASIDE, false).open().unwrap(), Message::Return.kind());
        SharedFrame::new(&Frame::seal(Header { kind, ..header }, &Message::Return), Time(9))
    }

    #[test]
    fn a_daemon_answers_for_an_agent_when_another_controller_calls() {
        let mut talk = Conversations::default();
        talk.begin(AGENT);
        // Hello, an action, a report; then two messages of the controller.
        for (sequence, channel) in [Channel::Runtime, Channel::Body, Channel::Control].into_iter().enumerate()
        {
            assert!(talk.hear(&frame(channel, sequence as u32, true)));
        }
        for sequence in 0..2 {
            let shared = SharedFrame::new(&frame(Channel::Runtime, sequence, false), Time(5));
            assert!(talk.tell(AGENT, &shared).is_none());
        }
        let other = (ModuleId(8), Incarnation(0));
        talk.begin(other);
        let wanted = BTreeSet::from([AGENT, (ModuleId(9), Incarnation(0))]);
        assert_eq!((talk.take_over(&wanted), talk.present(&wanted)), (vec![other], vec![AGENT]));
        assert_eq!((talk.latest(), talk.ended().count()), (vec![AGENT, other], 0));
        // What it says before it is called is found in the journal.
        assert!(!talk.hear(&frame(Channel::Body, 3, true)));
        let here = talk.tell(AGENT, &call()).unwrap();
        let header = here.frame().open().unwrap();
        assert_eq!((header.source, header.incarnation, header.sequence), (AGENT.0, AGENT.1, 3));
        assert_eq!(here.frame().message(), Ok(Message::Here { told: 3, expected: 2 }));
        assert!(talk.hear(&frame(Channel::Body, 4, true)), "from now on it is heard");
        assert!(talk.end(AGENT) && !talk.end(other), "the end of an unwanted agent is not reported");
        assert!(talk.tell(AGENT, &call()).is_none());
        assert_eq!(talk.ended().collect::<Vec<_>>(), [AGENT, other]);
    }
}
