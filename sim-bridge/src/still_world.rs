//! Bodies that stand still on the cubic lattice and touch their neighbours with six faces: the world
//! for a protocol that only talks. Any agent whose place is a cell can live in it.
//!
//! Deliberately absent: motion. An agent cannot ask such a body for anything, so its actions and
//! percepts are [`Never`].

use crate::invariants::Violation;
use crate::sim::{Agents, Audited};
use crate::world::{Contact, Sensed, World};
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::{Incarnation, ModuleId, Port, Revision, Session};
use metamorph_protocol::lattice::{Cell, Face};
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::Never;
use std::collections::{BTreeMap, VecDeque};
use std::marker::PhantomData;

/// The world. A port is a face, by its number.
#[derive(Clone, Debug)]
pub struct StillWorld<A> {
    cells: Vec<Cell>,
    at: BTreeMap<Cell, ModuleId>,
    lives: Vec<Incarnation>,
    revisions: Vec<Revision>,
    sessions: u32,
    sensed: VecDeque<(ModuleId, Sensed<Never>)>,
    agents: PhantomData<A>,
}

impl<A: Agent<Place = Cell, Action = Never, Percept = Never>> StillWorld<A> {
    /// A body in each of these cells, numbered in their order. A cell that is named twice counts once.
    pub fn new(cells: &[Cell]) -> StillWorld<A> {
        let mut world = StillWorld {
            cells: Vec::new(),
            at: BTreeMap::new(),
            lives: Vec::new(),
            revisions: Vec::new(),
            sessions: 0,
            sensed: VecDeque::new(),
            agents: PhantomData,
        };
        for cell in cells {
            let id = ModuleId(world.cells.len() as u32);
            if let std::collections::btree_map::Entry::Vacant(free) = world.at.entry(*cell) {
                free.insert(id);
                world.cells.push(*cell);
                world.lives.push(Incarnation(0));
                world.revisions.push(Revision(0));
            }
        }
        world
    }

    /// The module outside a face.
    fn neighbour(&self, id: ModuleId, face: Face) -> Option<ModuleId> {
        self.at.get(&self.cells[id.index()].step(face)).copied()
    }

    fn sense(&mut self, id: ModuleId, face: Face, session: Session, peer: ModuleId) {
        self.revisions[id.index()].0 += 1;
        let contact = Some(Contact {
            session,
            peer,
            peer_incarnation: self.lives[peer.index()],
            peer_port: Port(face.opposite() as u8),
        });
        let revision = self.revisions[id.index()];
        self.sensed.push_back((id, Sensed::Contact { port: Port(face as u8), revision, contact }));
    }
}

impl<A: Agent<Place = Cell, Action = Never, Percept = Never>> World for StillWorld<A> {
    type Agent = A;

    fn len(&self) -> usize {
        self.cells.len()
    }
    fn place(&self, id: ModuleId) -> Cell {
        self.cells[id.index()]
    }
    fn start(&mut self, _: Time, id: ModuleId, incarnation: Incarnation) {
        self.lives[id.index()] = incarnation;
        for face in Face::ALL {
            if let Some(peer) = self.neighbour(id, face) {
                self.sessions += 1;
                let session = Session(self.sessions);
                self.sense(id, face, session, peer);
                self.sense(peer, face.opposite(), session, id);
            }
        }
    }
    fn act(&mut self, _: Time, _: ModuleId, _: Revision, action: &Never) {
        match *action {}
    }
    fn next_event(&self) -> Time {
        Time::NEVER
    }
    fn advance(&mut self, _: Time) {}
    fn poll(&mut self) -> Option<(ModuleId, Sensed<Never>)> {
        self.sensed.pop_front()
    }
}

/// Bodies that never move break no invariant.
impl<A: Agent<Place = Cell, Action = Never, Percept = Never>> Audited for StillWorld<A> {
    fn audit_agent(&self, _: Time, _: ModuleId, _: &Agents<'_, A>, _: &mut Vec<Violation>) {}
    fn audit_action(&self, _: Time, _: ModuleId, _: &Agents<'_, A>, _: &mut Vec<Violation>) {}
    fn audit_all(&mut self, _: Time, _: &Agents<'_, A>, _: &mut Vec<Violation>) {}
    fn take_violations(&mut self) -> Vec<Violation> {
        Vec::new()
    }
}
