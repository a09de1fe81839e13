//! The agents that are at home on a host, as its daemon or controller sees them: the sending end to each, and frames
//! of the controller that wait while an inbox is full.

use metamorph_module_agent::transport::shared_frame::SharedFrame;
use metamorph_module_agent::transport::{Address, AgentKey, ConnectError, Link, SendStatus, Transport};
use metamorph_protocol::ids::{Incarnation, ModuleId};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

#[derive(Debug)]
struct Resident<L> {
    incarnation: Incarnation,
    /// Opened on first use.
    link: Option<L>,
    /// Frames of the controller, at most as many as it sends without an answer.
    waiting: VecDeque<SharedFrame>,
}

/// The agents of a host.
#[derive(Debug)]
pub struct Residents<L> {
    agents: BTreeMap<ModuleId, Resident<L>>,
    /// Agents to be woken.
    touched: BTreeSet<ModuleId>,
    /// Agents for which frames wait.
    behind: BTreeSet<ModuleId>,
}

impl<L: Link> Residents<L> {
    /// Creates a host without agents.
    pub fn new() -> Residents<L> {
        Residents { agents: BTreeMap::new(), touched: BTreeSet::new(), behind: BTreeSet::new() }
    }

    /// Notes that an incarnation is being started.
    pub fn arrive(&mut self, (id, incarnation): AgentKey) {
        self.agents.insert(id, Resident { incarnation, link: None, waiting: VecDeque::new() });
        self.behind.remove(&id);
    }

    /// Notes that an incarnation has ended.
    pub fn leave(&mut self, (id, incarnation): AgentKey) {
        if self.agents.get(&id).is_some_and(|agent| agent.incarnation == incarnation) {
            self.agents.remove(&id);
            self.behind.remove(&id);
        }
    }

    /// Puts a frame into the inbox of an agent.
    pub fn deliver<T: Transport<Link = L>>(
        &mut self,
        transport: &mut T,
        to: ModuleId,
        frame: SharedFrame,
    ) -> SendStatus {
        let Some(agent) = self.agents.get_mut(&to) else { return SendStatus::Gone };
        if agent.link.is_none() {
            match transport.connect(Address::Agent((to, agent.incarnation))) {
                Ok(link) => agent.link = Some(link),
                Err(ConnectError::Unreachable(_)) => return SendStatus::Gone,
                Err(e) => {
                    tracing::debug!("cannot reach module {to}: {e}");
                    return SendStatus::Full;
                }
            }
        }
        self.touched.insert(to);
        // Invariant: it was just opened if it was not open before.
        agent.link.as_mut().map_or(SendStatus::Gone, |link| link.send(frame))
    }

    /// Queues a frame of the controller. Returns false if that incarnation is not here.
    pub fn post(&mut self, (id, incarnation): AgentKey, frame: SharedFrame) -> bool {
        let agent = self.agents.get_mut(&id).filter(|agent| agent.incarnation == incarnation);
        let Some(agent) = agent else { return false };
        agent.waiting.push_back(frame);
        self.behind.insert(id);
        true
    }

    /// Puts frames of the controller into inboxes, as many as fit, and tells `taken` how many each agent got.
    pub fn catch_up<T: Transport<Link = L>>(
        &mut self,
        transport: &mut T,
        mut taken: impl FnMut(AgentKey, u32),
    ) {
        for id in self.behind.clone() {
            let mut count = 0;
            while let Some(frame) = self.agents.get(&id).and_then(|agent| agent.waiting.front().copied()) {
                // A full inbox is tried again. One that is gone belongs to an agent whose end is reported soon.
                if self.deliver(transport, id, frame) == SendStatus::Full {
                    break;
                }
                self.agents.get_mut(&id).map(|agent| agent.waiting.pop_front());
                count += 1;
            }
            let Some(agent) = self.agents.get(&id) else { continue };
            if agent.waiting.is_empty() {
                self.behind.remove(&id);
            }
            if count > 0 {
                taken((id, agent.incarnation), count);
            }
        }
    }

    /// True if frames of the controller wait.
    pub fn is_behind(&self) -> bool {
        !self.behind.is_empty()
    }

    /// Wakes the agents that have got frames.
    pub fn flush(&mut self) {
        for id in std::mem::take(&mut self.touched) {
            if let Some(link) = self.agents.get_mut(&id).and_then(|agent| agent.link.as_mut()) {
                link.flush();
            }
        }
    }
}
