//! A world in which nothing moves: modules that touch each other as a graph says.
//!
//! Absent: actions and their effects. [`still_world`](super::still_world) is the same for a dense block, without memory.

use crate::kernel::audited::{Agents, Audited};
use crate::world::World;
use crate::world::body_queue::{BodyQueue, Ports};
use crate::world::contact_graph::ContactGraph;
use crate::world::invariants::{Invariant, Violation};
use metamorph_core::agent::Agent;
use metamorph_core::digest::Portable;
use metamorph_core::ids::{Incarnation, ModuleId, Port, Revision};
use metamorph_core::lattice::Cell;
use metamorph_core::runtime::{Contact, Sensed};
use metamorph_core::time::Time;
use metamorph_core::wire::Never;
use std::hash::{Hash, Hasher};

/// A check of all living agents after an input of one of them. Returns a description of the error.
pub type AgentCheck<A> = fn(&Agents<'_, A>, ModuleId) -> Result<(), String>;

/// Modules with the contacts of a graph, and the agent `A` in each.
pub struct GraphWorld<A: Agent> {
    cells: Vec<Cell>,
    ports: Vec<Ports<Box<[Option<Contact>]>>>,
    queue: BodyQueue<A::Percept>,
    refuse: fn(&A::Action) -> A::Percept,
    checks: &'static [(Invariant, AgentCheck<A>)],
}

impl<A: Agent<Action = Never>> GraphWorld<A> {
    /// Creates the world of a graph, which fits the ports of its agents. After each input of an agent the checks are made.
    pub fn new(graph: &ContactGraph, checks: &'static [(Invariant, AgentCheck<A>)]) -> GraphWorld<A> {
        GraphWorld { checks, ..GraphWorld::refusing(graph, |never| match *never {}) }
    }
}

impl<A: Agent> GraphWorld<A> {
    /// Creates the world of a graph for agents that may ask for actions, which their bodies refuse by these percepts.
    pub fn refusing(graph: &ContactGraph, refuse: fn(&A::Action) -> A::Percept) -> GraphWorld<A> {
        let mut queue = BodyQueue::new(0);
        let none = || Ports::new(vec![None; A::PORTS].into_boxed_slice());
        let mut ports: Vec<_> = graph.cells().iter().map(|_| none()).collect();
        for [a, b] in graph.contacts() {
            let session = queue.open_session();
            for ((id, port), (peer, peer_port)) in [(*a, *b), (*b, *a)] {
                let end = ports[peer.index()].end(session, peer, peer_port);
                ports[id.index()].contacts[port.index()] = Some(end);
            }
        }
        let cells = graph.cells().to_vec();
        GraphWorld { cells, ports, queue, refuse, checks: &[] }
    }

    /// Opens new sessions for all contacts of a module, of which both ends hear.
    fn renew(&mut self, id: ModuleId) {
        for port in 0..A::PORTS {
            let Some(contact) = self.ports[id.index()].contacts[port] else { continue };
            let port = Port(port as u8);
            let session = self.queue.open_session();
            for ((id, port), (peer, peer_port)) in [
                ((id, port), (contact.peer, contact.peer_port)),
                ((contact.peer, contact.peer_port), (id, port)),
            ] {
                let end = self.ports[peer.index()].end(session, peer, peer_port);
                self.queue.set_contact((id, &mut self.ports[id.index()]), port, Some(end), true);
            }
        }
    }
}

impl<A: Agent<Place = Cell>> World for GraphWorld<A> {
    type Agent = A;

    fn len(&self) -> usize {
        self.cells.len()
    }
    fn place(&self, id: ModuleId) -> Cell {
        self.cells[id.index()]
    }
    fn start(&mut self, _: Time, id: ModuleId, incarnation: Incarnation) {
        if self.queue.start((id, &mut self.ports[id.index()]), incarnation) {
            self.renew(id);
        }
    }
    fn act(&mut self, _: Time, id: ModuleId, _: Revision, action: &A::Action) {
        self.queue.perceive(id, (self.refuse)(action));
    }
    fn next_event(&self) -> Time {
        Time::NEVER
    }
    fn advance(&mut self, _: Time) {}
    fn digest(&self, hasher: &mut dyn Hasher) {
        (&self.ports, &self.queue).hash(&mut Portable::new(hasher));
    }
    fn poll(&mut self) -> Option<(ModuleId, Sensed<A::Percept>)> {
        self.queue.poll()
    }
}

impl<A: Agent<Place = Cell>> Audited for GraphWorld<A> {
    fn audit_agent(&mut self, now: Time, id: ModuleId, agents: &Agents<'_, A>, found: &mut Vec<Violation>) {
        for (invariant, check) in self.checks {
            if let Err(what) = check(agents, id) {
                found.push(Violation { invariant: *invariant, at: now, what });
            }
        }
    }
}
