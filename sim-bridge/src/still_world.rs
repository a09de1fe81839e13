//! A world in which nothing moves: a dense block of modules, each touching its six neighbours.
//!
//! For agents that only talk, and for measuring the kernel: it keeps nothing per module, not even
//! contacts, which follow from the number of a module. Absent: actions and whatever they change.

use crate::invariants::Violation;
use crate::sim::{Agents, Audited};
use crate::world::{Contact, Sensed, World};
use metamorph_protocol::agent::Agent;
use metamorph_protocol::ids::{Incarnation, ModuleId, Port, Revision, Session};
use metamorph_protocol::lattice::{Cell, Face};
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::Never;
use std::marker::PhantomData;

/// A block of `side`³ modules, numbered along z, then y, then x. `A` is the agent in each.
pub struct StillWorld<A> {
    side: i16,
    /// Modules started so far, in the order of their numbers, and how many contacts were told of.
    started: u32,
    told: u32,
    agent: PhantomData<A>,
}

impl<A> StillWorld<A> {
    /// A block of `side`³ modules, at most 1,000 along a side.
    pub fn new(side: u16) -> StillWorld<A> {
        StillWorld { side: side.min(1_000) as i16, started: 0, told: 0, agent: PhantomData }
    }

    /// The number of contacts between two modules.
    pub fn contacts(&self) -> u64 {
        let n = self.side as u64;
        3 * n * n * n.saturating_sub(1)
    }

    fn cell(&self, id: ModuleId) -> Cell {
        let n = self.side as u32;
        Cell::new((id.0 / (n * n)) as i16, (id.0 / n % n) as i16, (id.0 % n) as i16)
    }

    fn module(&self, cell: Cell) -> Option<ModuleId> {
        let inside = |c: i16| (0..self.side).contains(&c);
        let n = self.side as u32;
        (inside(cell.x) && inside(cell.y) && inside(cell.z))
            .then(|| ModuleId((cell.x as u32 * n + cell.y as u32) * n + cell.z as u32))
    }

    fn contact(&self, id: ModuleId, face: Face) -> Option<Contact> {
        let peer = self.module(self.cell(id).step(face))?;
        // Named by the end that looks in a positive direction; faces of one axis come in pairs.
        let (low, axis) = (id.min(peer), face as u32 / 2);
        Some(Contact {
            session: Session(low.0 * 3 + axis + 1),
            peer,
            peer_incarnation: Incarnation(0),
            peer_port: Port(face.opposite() as u8),
        })
    }
}

impl<A: Agent<Place = Cell, Action = Never, Percept = Never>> World for StillWorld<A> {
    type Agent = A;

    fn len(&self) -> usize {
        (self.side as usize).pow(3)
    }
    fn place(&self, id: ModuleId) -> Cell {
        self.cell(id)
    }
    fn start(&mut self, _now: Time, id: ModuleId, _incarnation: Incarnation) {
        self.started = self.started.max(id.0 + 1);
    }
    fn act(&mut self, _now: Time, _id: ModuleId, _sensed: Revision, action: &Never) {
        match *action {}
    }
    fn next_event(&self) -> Time {
        Time::NEVER
    }
    fn advance(&mut self, _now: Time) {}

    fn poll(&mut self) -> Option<(ModuleId, Sensed<Never>)> {
        while self.told < self.started * 6 {
            let (id, face) = (ModuleId(self.told / 6), Face::ALL[self.told as usize % 6]);
            self.told += 1;
            if let Some(contact) = self.contact(id, face) {
                let sensed =
                    Sensed::Contact { port: Port(face as u8), revision: Revision(0), contact: Some(contact) };
                return Some((id, sensed));
            }
        }
        None
    }
}

impl<A: Agent<Place = Cell, Action = Never, Percept = Never>> Audited for StillWorld<A> {
    fn audit_agent(&self, _: Time, _: ModuleId, _: &Agents<'_, A>, _: &mut Vec<Violation>) {}
    fn audit_action(&self, _: Time, _: ModuleId, _: &Agents<'_, A>, _: &mut Vec<Violation>) {}
    fn audit_all(&mut self, _: Time, _: &Agents<'_, A>, _: &mut Vec<Violation>) {}
    fn take_violations(&mut self) -> Vec<Violation> {
        Vec::new()
    }
}
