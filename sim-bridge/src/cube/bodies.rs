//! Bodies of cubes for agents of any protocol: the world of cubes, without the audits of the built-in protocol. Space, support
//! and connection are checked as ever.

use crate::cube::world::CubeWorld;
use metamorph_kernel::kernel::audited::{Agents, Audited};
use metamorph_kernel::world::World;
use metamorph_kernel::world::invariants::Violation;
use metamorph_protocol::agent::Agent;
use metamorph_protocol::cube::body::{Move, Percept};
use metamorph_protocol::ids::{Incarnation, ModuleId, Revision};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::runtime::Sensed;
use metamorph_protocol::time::Time;
use std::hash::Hasher;
use std::marker::PhantomData;

/// A world of cubes whose agents are `A`.
pub struct CubeBodies<A> {
    /// The bodies.
    pub cubes: CubeWorld,
    agent: PhantomData<fn() -> A>,
}

impl<A> CubeBodies<A> {
    /// Gives the bodies of a world to agents of another protocol.
    pub fn new(cubes: CubeWorld) -> CubeBodies<A> {
        CubeBodies { cubes, agent: PhantomData }
    }
}

impl<A: Agent<Place = Cell, Action = Move, Percept = Percept>> World for CubeBodies<A> {
    type Agent = A;

    fn len(&self) -> usize {
        self.cubes.len()
    }
    fn place(&self, id: ModuleId) -> Cell {
        self.cubes.place(id)
    }
    fn start(&mut self, now: Time, id: ModuleId, incarnation: Incarnation) {
        self.cubes.start(now, id, incarnation);
    }
    fn act(&mut self, now: Time, id: ModuleId, sensed: Revision, action: &Move) {
        self.cubes.act(now, id, sensed, action);
    }
    fn next_event(&self) -> Time {
        self.cubes.next_event()
    }
    fn advance(&mut self, now: Time) {
        self.cubes.advance(now);
    }
    fn digest(&self, hasher: &mut dyn Hasher) {
        self.cubes.digest(hasher);
    }
    fn poll(&mut self) -> Option<(ModuleId, Sensed<Percept>)> {
        self.cubes.poll()
    }
}

impl<A: Agent<Place = Cell, Action = Move, Percept = Percept>> Audited for CubeBodies<A> {
    fn audit_all(&mut self, now: Time, _: &Agents<'_, A>, _: &mut Vec<Violation>) {
        self.cubes.check_connected(now);
    }
    fn take_violations(&mut self) -> Vec<Violation> {
        self.cubes.take_violations()
    }
}
