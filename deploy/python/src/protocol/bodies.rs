//! The bodies of modules with a protocol in Python: cubes, or modules that do not move, with a graph of contacts.

use super::agent::PyAgent;
use metamorph_protocol::cube::body::{Move, Percept, Refusal};
use metamorph_protocol::ids::{Incarnation, ModuleId, Revision};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::runtime::Sensed;
use metamorph_protocol::time::Time;
use metamorph_sim_bridge::cube::bodies::CubeBodies;
use metamorph_sim_bridge::cube::world::CubeWorld;
use metamorph_sim_bridge::kernel::audited::{Agents, Audited};
use metamorph_sim_bridge::kernel::graph_world::GraphWorld;
use metamorph_sim_bridge::world::World;
use metamorph_sim_bridge::world::contact_graph::ContactGraph;
use metamorph_sim_bridge::world::invariants::{Invariant, Violation};
use std::hash::Hasher;

/// A check of a whole run. Returns what is wrong.
pub type Check = Box<dyn Fn(Time) -> Result<(), String> + Send + Sync>;

/// The bodies, whose checks are made after every input of an agent or at full audits only.
pub struct PyBodies {
    bodies: Bodies,
    checks: Vec<(Invariant, Check)>,
    only_at_audits: bool,
}

enum Bodies {
    Cubes(CubeBodies<PyAgent>),
    Graph(GraphWorld<PyAgent>),
}

/// Calls the same method of either kind of bodies.
macro_rules! of_either {
    ($this:expr, $bodies:ident => $call:expr) => {
        match &$this.bodies {
            Bodies::Cubes($bodies) => $call,
            Bodies::Graph($bodies) => $call,
        }
    };
    (mut $this:expr, $bodies:ident => $call:expr) => {
        match &mut $this.bodies {
            Bodies::Cubes($bodies) => $call,
            Bodies::Graph($bodies) => $call,
        }
    };
}

impl PyBodies {
    /// Creates the bodies of cubes.
    pub fn of_cubes(cubes: CubeWorld, checks: Vec<(Invariant, Check)>, only_at_audits: bool) -> PyBodies {
        PyBodies { bodies: Bodies::Cubes(CubeBodies::new(cubes)), checks, only_at_audits }
    }
    /// Creates bodies that refuse every move, with the contacts of a graph.
    pub fn of_graph(graph: &ContactGraph, checks: Vec<(Invariant, Check)>, only_at_audits: bool) -> PyBodies {
        let bodies = GraphWorld::refusing(graph, |_: &Move| Percept::Refused(Refusal::Blocked));
        PyBodies { bodies: Bodies::Graph(bodies), checks, only_at_audits }
    }
    /// Returns the cubes, if bodies are such.
    pub fn cubes(&self) -> Option<&CubeWorld> {
        match &self.bodies {
            Bodies::Cubes(bodies) => Some(&bodies.cubes),
            Bodies::Graph(_) => None,
        }
    }
    /// Returns the cubes, if bodies are such, to change them.
    pub fn cubes_mut(&mut self) -> Option<&mut CubeWorld> {
        match &mut self.bodies {
            Bodies::Cubes(bodies) => Some(&mut bodies.cubes),
            Bodies::Graph(_) => None,
        }
    }

    fn check(&self, now: Time, found: &mut Vec<Violation>) {
        for (invariant, check) in &self.checks {
            if let Err(what) = check(now) {
                found.push(Violation { invariant: *invariant, at: now, what });
            }
        }
    }
}

impl World for PyBodies {
    type Agent = PyAgent;

    fn len(&self) -> usize {
        of_either!(self, bodies => bodies.len())
    }
    fn place(&self, id: ModuleId) -> Cell {
        of_either!(self, bodies => bodies.place(id))
    }
    fn start(&mut self, now: Time, id: ModuleId, incarnation: Incarnation) {
        of_either!(mut self, bodies => bodies.start(now, id, incarnation));
    }
    fn act(&mut self, now: Time, id: ModuleId, sensed: Revision, action: &Move) {
        of_either!(mut self, bodies => bodies.act(now, id, sensed, action));
    }
    fn next_event(&self) -> Time {
        of_either!(self, bodies => bodies.next_event())
    }
    fn advance(&mut self, now: Time) {
        of_either!(mut self, bodies => bodies.advance(now));
    }
    fn digest(&self, hasher: &mut dyn Hasher) {
        of_either!(self, bodies => bodies.digest(hasher));
    }
    fn poll(&mut self) -> Option<(ModuleId, Sensed<Percept>)> {
        of_either!(mut self, bodies => bodies.poll())
    }
}

impl Audited for PyBodies {
    fn audit_agent(&mut self, now: Time, _: ModuleId, _: &Agents<'_, PyAgent>, found: &mut Vec<Violation>) {
        if !self.only_at_audits {
            self.check(now, found);
        }
    }
    fn audit_all(&mut self, now: Time, agents: &Agents<'_, PyAgent>, found: &mut Vec<Violation>) {
        of_either!(mut self, bodies => bodies.audit_all(now, agents, found));
        self.check(now, found);
    }
    fn take_violations(&mut self) -> Vec<Violation> {
        of_either!(mut self, bodies => bodies.take_violations())
    }
}
