//! A world in which nothing moves: a dense block of modules, each touching its six neighbours.
//!
//! For agents that only communicate, and for measuring the kernel: it stores nothing per module, not even
//! contacts, which follow from the number of a module. Not here: actions and their effects.

use crate::kernel::audited::Audited;
use crate::world::World;
use metamorph_core::agent::Agent;
use metamorph_core::ids::{Incarnation, ModuleId, Port, Revision, Session};
use metamorph_core::lattice::{Cell, Face};
use metamorph_core::runtime::{Contact, Sensed};
use metamorph_core::time::Time;
use metamorph_core::wire::Never;
use std::marker::PhantomData;

/// A block of modules, numbered along z, then y, then x. `A` is the agent in each.
pub struct StillWorld<A> {
    sides: [u32; 3],
    /// The number of modules started so far, in the order of their ids.
    started: u32,
    /// The number of faces whose contacts, if they have any, have been sent so far: six for each module.
    told: u32,
    agent: PhantomData<A>,
}

impl<A> StillWorld<A> {
    /// Creates a block with this number of modules along x, y and z; at most 1,000 along each.
    pub fn new(sides: [u16; 3]) -> StillWorld<A> {
        StillWorld { sides: sides.map(|n| n.min(1_000).into()), started: 0, told: 0, agent: PhantomData }
    }

    /// Returns the number of contacts between two modules.
    pub fn contacts(&self) -> u64 {
        let [x, y, z] = self.sides.map(u64::from);
        let along = |n: u64, area: u64| n.saturating_sub(1) * area;
        along(x, y * z) + along(y, x * z) + along(z, x * y)
    }

    fn cell(&self, id: ModuleId) -> Cell {
        let [_, y, z] = self.sides;
        Cell::new((id.0 / (y * z)) as i16, (id.0 / z % y) as i16, (id.0 % z) as i16)
    }

    fn module(&self, cell: Cell) -> Option<ModuleId> {
        let [x, y, z] = self.sides;
        let along = |c: i16, n: u32| u32::try_from(c).ok().filter(|c| *c < n);
        Some(ModuleId((along(cell.x, x)? * y + along(cell.y, y)?) * z + along(cell.z, z)?))
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
        self.sides.iter().product::<u32>() as usize
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

impl<A: Agent<Place = Cell, Action = Never, Percept = Never>> Audited for StillWorld<A> {}
