//! Bodies of cubes for agents of any protocol: the world of cubes, with checks that its user gives instead of the
//! audits of the built-in protocol. Space, support and connection are checked as ever.

use crate::cube::world::CubeWorld;
use metamorph_kernel::kernel::audited::{Agents, Audited};
use metamorph_kernel::world::World;
use metamorph_kernel::world::invariants::{Invariant, Violation};
use metamorph_protocol::agent::Agent;
use metamorph_protocol::cube::body::{Move, Percept};
use metamorph_protocol::ids::{Incarnation, ModuleId, Revision};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::runtime::Sensed;
use metamorph_protocol::time::Time;
use std::hash::Hasher;
use std::marker::PhantomData;

/// A check of a whole run. Returns what is wrong.
pub type Check = Box<dyn Fn(Time) -> Result<(), String> + Send + Sync>;

/// A world of cubes whose agents are `A`.
pub struct CubeBodies<A> {
    /// The bodies.
    pub cubes: CubeWorld,
    checks: Vec<(Invariant, Check)>,
    /// Whether the checks are made at full audits only.
    only_at_audits: bool,
    agent: PhantomData<fn() -> A>,
}

impl<A> CubeBodies<A> {
    /// Gives the bodies of a world to agents of another protocol. The checks are made after every input of an agent, so that
    /// no state of the agents is missed, and at every full audit.
    pub fn new(cubes: CubeWorld, checks: Vec<(Invariant, Check)>) -> CubeBodies<A> {
        CubeBodies { cubes, checks, only_at_audits: false, agent: PhantomData }
    }

    /// Makes the checks at full audits only.
    #[must_use]
    pub fn checked_at_audits(self) -> CubeBodies<A> {
        CubeBodies { only_at_audits: true, ..self }
    }

    fn check(&self, now: Time, found: &mut Vec<Violation>) {
        for (invariant, check) in &self.checks {
            if let Err(what) = check(now) {
                found.push(Violation { invariant: *invariant, at: now, what });
            }
        }
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
    fn audit_agent(&mut self, now: Time, _: ModuleId, _: &Agents<'_, A>, found: &mut Vec<Violation>) {
        if !self.only_at_audits {
            self.check(now, found);
        }
    }
    fn audit_all(&mut self, now: Time, _: &Agents<'_, A>, found: &mut Vec<Violation>) {
        self.cubes.check_connected(now);
        self.check(now, found);
    }
    fn take_violations(&mut self) -> Vec<Violation> {
        self.cubes.take_violations()
    }
}
