//! The world of cubes: occupied cells, contacts, and moves under way.
//!
//! The world is the interlock: a move starts only if all cells it needs are free, the agent had seen the
//! present contacts, and it is not too late. It does *not* check whether a move is safe for the structure:
//! the protocol keeps the structure connected, and an invariant here (`safety`) checks that.

mod safety;

use crate::cube::audit::AuditKey;
use crate::cube::custody_audit::Announced;
use metamorph_kernel::world::World;
use metamorph_kernel::world::body_queue::{BodyQueue, Ports};
use metamorph_kernel::world::grid::{Grid, Occupant};
use metamorph_kernel::world::invariants::ONE_MODULE_PER_CELL;
use metamorph_kernel::world::invariants::Violation;
use metamorph_protocol::cube::Cube;
use metamorph_protocol::cube::body::{Move, Percept, Refusal};
use metamorph_protocol::digest::Portable;
use metamorph_protocol::ids::{Incarnation, ModuleId, Port, Revision};
use metamorph_protocol::lattice::{Cell, Face, Motion, MotionKind};
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::runtime::{Contact, Sensed};
use metamorph_protocol::time::{Span, Time};
use std::hash::{Hash, Hasher};

#[derive(Clone, Copy, Debug, Hash)]
struct MotionInProgress {
    motion: Motion,
    fails: bool,
}

#[derive(Clone, Debug)]
struct Body {
    cell: Cell,
    ports: Ports<[Option<Contact>; 6]>,
    under_way: Option<MotionInProgress>,
    stuck: bool,
    /// The audit key of the module when it was last audited and found sound; no part of the state of the world.
    audited: Option<AuditKey>,
}

impl Hash for Body {
    fn hash<H: Hasher>(&self, state: &mut H) {
        let Body { cell, ports, under_way, stuck, audited: _ } = self;
        (cell, ports, under_way, stuck).hash(state);
    }
}

/// Counts of the bodies' moves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct MotionCounts {
    /// Moves begun.
    pub started: u64,
    /// Moves that ended at their destination.
    pub completed: u64,
    /// Moves that failed and were rolled back.
    pub failed: u64,
    /// Moves refused because a cell was taken or a support missing.
    pub blocked: u64,
    /// Moves refused because they came too late.
    pub late: u64,
    /// Moves refused because the contacts had changed.
    pub stale: u64,
}

/// A simulated world of cubes.
#[derive(Clone, Debug)]
pub struct CubeWorld {
    grid: Grid,
    bodies: Vec<Body>,
    pub(super) queue: BodyQueue<Percept>,
    move_time: Span,
    motions: MotionCounts,
    pub(super) announced: Announced,
    /// For each module, the number of the last search that reached it, and the index of the start that it was reached
    /// from (see `neighbours_connected`).
    marks: Vec<(u64, u32)>,
    search: u64,
}

impl CubeWorld {
    /// Creates a world with a module in each cell; their ids are the indices in the list.
    pub fn new(cells: &[Cell], move_time: Span, seed: u64) -> CubeWorld {
        let mut world = CubeWorld {
            grid: Grid::default(),
            bodies: Vec::with_capacity(cells.len()),
            queue: BodyQueue::new(seed),
            move_time,
            motions: MotionCounts::default(),
            announced: Announced::default(),
            marks: vec![(0, 0); cells.len()],
            search: 0,
        };
        for (i, cell) in cells.iter().enumerate() {
            let id = ModuleId(i as u32);
            if let Some(other) = world.grid.body(*cell) {
                world.queue.violate(ONE_MODULE_PER_CELL, Time::ZERO, format!("{other} and {id} at {cell}"));
            }
            world.grid.set(*cell, Some(Occupant::Body(id)));
            world.bodies.push(Body {
                cell: *cell,
                ports: Ports::new([None; 6]),
                under_way: None,
                stuck: false,
                audited: None,
            });
        }
        for i in 0..cells.len() {
            world.open_contacts(ModuleId(i as u32), false);
        }
        world
    }

    /// Sets the probability with which each later move fails (a failed connection).
    pub fn set_failure(&mut self, p: Ratio) {
        self.queue.set_failure(p);
    }
    /// Returns true if the joint of a module sticks.
    pub fn is_stuck(&self, id: ModuleId) -> bool {
        self.bodies[id.index()].stuck
    }
    /// Makes this module's moves fail (a stuck joint), or succeed again.
    pub fn set_stuck(&mut self, id: ModuleId, stuck: bool) {
        self.bodies[id.index()].stuck = stuck;
    }
    /// Returns the counts of moves so far.
    pub fn motions(&self) -> MotionCounts {
        self.motions
    }
    /// Returns the cell of a module's body; during a move, its start.
    pub fn cell(&self, id: ModuleId) -> Cell {
        self.bodies[id.index()].cell
    }
    /// Returns the module whose body is in a cell.
    pub fn body_at(&self, cell: Cell) -> Option<ModuleId> {
        self.grid.body(cell)
    }
    /// Returns true if a module is moving.
    pub fn is_moving(&self, id: ModuleId) -> bool {
        self.bodies[id.index()].under_way.is_some()
    }
    /// Returns the module that a mover lands on.
    pub fn landing(&self, id: ModuleId) -> Option<ModuleId> {
        let motion = self.motion(id)?;
        self.grid.body(motion.destination(self.cell(id)).step(motion.landing_support()))
    }
    /// Returns true if the body stays connected without a module, if all others stand still.
    pub fn is_removable(&mut self, id: ModuleId) -> bool {
        let body = &mut self.bodies[id.index()];
        let cell = body.cell;
        let motion = Motion { kind: MotionKind::Slide, support: Face::Down, heading: Face::East };
        let before = body.under_way.replace(MotionInProgress { motion, fails: true });
        let connected = self.neighbours_connected(cell);
        self.bodies[id.index()].under_way = before;
        connected
    }
    /// Returns the motion of a module under way.
    pub fn motion(&self, id: ModuleId) -> Option<Motion> {
        self.bodies[id.index()].under_way.map(|progress| progress.motion)
    }
    /// Returns the duration of a move.
    pub fn move_time(&self) -> Span {
        self.move_time
    }
    /// Returns the contact on a face of a module.
    pub fn contact(&self, id: ModuleId, face: Face) -> Option<Contact> {
        self.bodies[id.index()].ports.contacts[face.index()]
    }
    /// Returns the invariants broken since the last call.
    pub fn take_violations(&mut self) -> Vec<Violation> {
        self.queue.take_violations()
    }

    /// Returns how often the contacts of a module have changed.
    pub(super) fn revision(&self, id: ModuleId) -> Revision {
        self.bodies[id.index()].ports.revision
    }
    /// Returns true if a module was like this when it was audited last, and found sound.
    pub(super) fn is_audited(&self, id: ModuleId, key: &AuditKey) -> bool {
        self.bodies[id.index()].audited.as_ref() == Some(key)
    }
    pub(super) fn note_audit(&mut self, id: ModuleId, key: AuditKey) {
        self.bodies[id.index()].audited = Some(key);
    }
    /// Makes the next audit of a module check it again.
    pub(super) fn forget_audit(&mut self, id: ModuleId) {
        self.bodies[id.index()].audited = None;
    }

    fn set_contact(&mut self, id: ModuleId, face: Face, contact: Option<Contact>, tell: bool) {
        let ports = &mut self.bodies[id.index()].ports;
        self.queue.set_contact((id, ports), Port(face as u8), contact, tell);
    }

    /// Opens a new session on every face of a module that touches another.
    fn open_contacts(&mut self, id: ModuleId, tell: bool) {
        let cell = self.bodies[id.index()].cell;
        for face in Face::ALL {
            let Some(peer) = self.grid.body(cell.step(face)) else { continue };
            if !tell && peer > id {
                continue; // At the start each pair meets once.
            }
            let session = self.queue.open_session();
            let end = |of: ModuleId, at: Face| self.bodies[of.index()].ports.end(session, of, Port(at as u8));
            let (mine, theirs) = (end(peer, face.opposite()), end(id, face));
            self.set_contact(id, face, Some(mine), tell);
            self.set_contact(peer, face.opposite(), Some(theirs), tell);
        }
    }

    fn refuse(&mut self, id: ModuleId, why: Refusal) {
        match why {
            Refusal::Blocked => self.motions.blocked += 1,
            Refusal::Late => self.motions.late += 1,
            Refusal::Stale => self.motions.stale += 1,
            Refusal::Moving => {}
        }
        self.queue.perceive(id, Percept::Refused(why));
    }

    fn is_possible(&self, from: Cell, motion: Motion) -> bool {
        let supports_hold = self.grid.body(from.step(motion.support)).is_some()
            && self.grid.body(motion.destination(from).step(motion.landing_support())).is_some();
        let free = |cell: Cell| self.grid.get(cell).is_none();
        supports_hold && free(motion.destination(from)) && motion.corner(from).is_none_or(free)
    }

    fn resting(&self, cell: Cell) -> Option<ModuleId> {
        self.grid.body(cell).filter(|id| !self.is_moving(*id))
    }

    fn begin(&mut self, now: Time, id: ModuleId, motion: Motion) {
        let from = self.bodies[id.index()].cell;
        let fails = self.bodies[id.index()].stuck | self.queue.draw_failure();
        self.bodies[id.index()].under_way = Some(MotionInProgress { motion, fails });
        self.grid.set(motion.destination(from), Some(Occupant::Path(id)));
        if let Some(corner) = motion.corner(from) {
            self.grid.set(corner, Some(Occupant::Path(id)));
        }
        self.motions.started += 1;
        self.queue.begin(now + self.move_time, id);
        self.check_departure(now, id);
    }

    fn complete(&mut self, now: Time, id: ModuleId) {
        let Some(MotionInProgress { motion, fails }) = self.bodies[id.index()].under_way.take() else {
            return;
        };
        let from = self.bodies[id.index()].cell;
        let to = motion.destination(from);
        self.check_path(now, id, from, motion);
        if let Some(corner) = motion.corner(from) {
            self.grid.set(corner, None);
        }
        if fails {
            self.grid.set(to, None);
            self.check_arrival(now, id, motion.support);
            self.motions.failed += 1;
            self.queue.perceive(id, Percept::Failed);
            return;
        }
        self.grid.set(from, None);
        self.grid.set(to, Some(Occupant::Body(id)));
        self.motions.completed += 1;
        self.bodies[id.index()].cell = to;
        self.queue.perceive(id, Percept::Arrived(to));
        for face in Face::ALL {
            let Some(contact) = self.contact(id, face) else { continue };
            self.set_contact(id, face, None, true);
            if let Some(face) = Face::from_index(contact.peer_port.0) {
                self.set_contact(contact.peer, face, None, true);
            }
        }
        self.open_contacts(id, true);
        self.check_arrival(now, id, motion.landing_support());
    }
}

/// The state that later events depend on; counts and scratch space are left out.
impl Hash for CubeWorld {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.bodies.hash(state);
        (&self.queue, &self.announced).hash(state);
    }
}

impl World for CubeWorld {
    type Agent = Cube;

    fn len(&self) -> usize {
        self.bodies.len()
    }

    fn place(&self, id: ModuleId) -> Cell {
        self.cell(id)
    }

    fn start(&mut self, _now: Time, id: ModuleId, incarnation: Incarnation) {
        self.forget_audit(id);
        self.forget_announced(id);
        if self.queue.start((id, &mut self.bodies[id.index()].ports), incarnation) {
            self.open_contacts(id, true);
        }
    }

    fn act(&mut self, now: Time, id: ModuleId, sensed: Revision, action: &Move) {
        let body = &self.bodies[id.index()];
        if body.under_way.is_some() {
            return self.refuse(id, Refusal::Moving);
        }
        if sensed != body.ports.revision {
            return self.refuse(id, Refusal::Stale);
        }
        if now > action.not_after {
            return self.refuse(id, Refusal::Late);
        }
        if !self.is_possible(body.cell, action.motion) {
            return self.refuse(id, Refusal::Blocked);
        }
        self.begin(now, id, action.motion);
    }

    fn next_event(&self) -> Time {
        self.queue.next_end()
    }

    fn advance(&mut self, now: Time) {
        while let Some((at, id)) = self.queue.pop(now) {
            self.complete(at, id);
        }
    }

    fn reseed(&mut self, seed: u64) {
        self.queue.reseed(seed);
    }
    fn digest(&self, hasher: &mut dyn Hasher) {
        let mut hasher = Portable::new(hasher);
        for body in &self.bodies {
            let Body { cell, ports, under_way, stuck, audited: _ } = body;
            (cell, ports, stuck).hash(&mut hasher);
            under_way.map(|MotionInProgress { motion, fails }| (motion, fails)).hash(&mut hasher);
        }
        self.queue.hash(&mut hasher);
    }

    fn look_ahead(&self, id: ModuleId) -> u64 {
        let body = &self.bodies[id.index()];
        body.cell.x as u64 ^ u64::from(body.audited.is_some())
    }

    fn poll(&mut self) -> Option<(ModuleId, Sensed<Percept>)> {
        self.queue.poll()
    }
}
