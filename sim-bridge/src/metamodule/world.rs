//! The world of metamodules: poses, grips, and steps under way.
//!
//! The world is the interlock: a joint turns only if all cells that the step sweeps, core and graze
//! (`roombots::sweep`), are free of other bodies and of the steps of other bodies; an end grips only a
//! connector of the floor; the last end does not detach. Ports are links to metamodules within communication
//! range. Elements are held and do not fall (`elements`). Bodies bend only as far as a model of connections says. Not
//! here: walls; gripping other metamodules; the torque of bodies without an element, which is within the limits in all postures.

mod counts;
mod drops;
mod elements;
mod safety;

use crate::connections::{ActionEnd, ConnectionCounts, Connections};
use crate::metamodule::invariants::{LINK_FOR_EACH_IN_RANGE, link_for_each_in_range};
use elements::ElementBody;
use metamorph_kernel::world::World;
use metamorph_kernel::world::body_queue::{BodyQueue, Ports};
use metamorph_kernel::world::grid::{Grid, Occupant};
use metamorph_kernel::world::invariants::Violation;

pub use counts::ActionCounts;
pub use drops::Drop;
use metamorph_protocol::agent::Agent;
use metamorph_protocol::digest::Portable;
use metamorph_protocol::ids::{Incarnation, ModuleId, Port, Revision};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::Metamodule;
use metamorph_protocol::metamodule::message::{Action, BodyAction, Percept, Refusal};
use metamorph_protocol::metamodule::motions::Sweep;
use metamorph_protocol::metamodule::params::Setup;
use metamorph_protocol::metamodule::pose::{Load, Pose};
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::roombots::connection::ConnectionModel;
use metamorph_protocol::roombots::torque;
use metamorph_protocol::runtime::{Contact, Sensed};
use metamorph_protocol::time::Time;
use std::collections::BTreeSet;
use std::hash::{Hash, Hasher};
use std::sync::Arc;

/// Number of ports that every body has in the hash, in use or not. It has more while it needs them.
const FEWEST_PORTS: usize = 24;

#[derive(Clone, Debug, Hash)]
struct ActionInProgress {
    to: Pose,
    /// All cells that the body may be in during the action.
    claimed: Vec<Cell>,
    body_action: BodyAction,
    end: ActionEnd,
}

#[derive(Clone, Debug, Hash)]
struct Body {
    pose: Pose,
    /// For the foot and the head, true if that end grips.
    grips: [bool; 2],
    cells: [Cell; 4],
    /// Contacts grow with the highest port in use.
    ports: Ports<Vec<Option<Contact>>>,
    under_way: Option<ActionInProgress>,
    stuck: bool,
}

impl Body {
    fn taken(&self) -> &[Cell] {
        self.under_way.as_ref().map_or(&self.cells, |u| &u.claimed)
    }
    /// Returns the first port without a contact, if there is one.
    fn free_port(&mut self) -> Option<Port> {
        let contacts = &mut self.ports.contacts;
        let port = contacts.iter().position(Option::is_none).unwrap_or(contacts.len());
        if port == contacts.len() && port < Metamodule::PORTS {
            contacts.push(None);
        }
        (port < Metamodule::PORTS).then_some(Port(port as u8))
    }
}

/// A simulated world of metamodules.
#[derive(Clone, Debug)]
pub struct MetamoduleWorld {
    setup: Arc<Setup>,
    bodies: Vec<Body>,
    elements: Vec<ElementBody>,
    /// Cells with a foreign object in them.
    obstacles: BTreeSet<Cell>,
    /// The body that is in a cell, or may be in it during its action: the record of the safety checks, which
    /// the interlock does not read.
    claims: Grid,
    queue: BodyQueue<Percept>,
    connections: Connections,
    action_counts: ActionCounts,
}

impl MetamoduleWorld {
    /// Creates a world with a metamodule in each pose; their ids are the indices in the list.
    pub fn new(setup: Arc<Setup>, poses: &[Pose], seed: u64) -> MetamoduleWorld {
        let body = |pose: &Pose| Body {
            pose: *pose,
            grips: [pose.both; 2],
            cells: setup.motions.cells(*pose),
            ports: Ports::new(vec![None; FEWEST_PORTS]),
            under_way: None,
            stuck: false,
        };
        let mut world = MetamoduleWorld {
            bodies: poses.iter().map(body).collect(),
            elements: setup.elements.all().iter().map(|e| ElementBody::new(&e.start)).collect(),
            setup,
            obstacles: BTreeSet::new(),
            claims: Grid::default(),
            queue: BodyQueue::new(seed),
            connections: Connections::default(),
            action_counts: ActionCounts::default(),
        };
        for id in (0..poses.len() as u32).map(ModuleId) {
            let body = &mut world.bodies[id.index()];
            body.grips[body.pose.end as usize] = true;
            world.check(Time::ZERO, id);
            world.claim(id);
            world.hear(Time::ZERO, id, false);
        }
        world
    }

    /// Lets a model decide which connections close, if there is one.
    pub fn with_connections(self, model: Option<ConnectionModel>) -> MetamoduleWorld {
        MetamoduleWorld { connections: Connections::new(model), ..self }
    }
    /// Returns the counts of attempts to connect so far; `None` without a model of connections.
    pub fn connection_counts(&self) -> Option<ConnectionCounts> {
        self.connections.counts()
    }
    /// Sets the probability with which each later connection fails.
    pub fn set_failure(&mut self, p: Ratio) {
        self.queue.set_failure(p);
    }
    /// Returns true if the joints of a metamodule are stuck.
    pub fn is_stuck(&self, id: ModuleId) -> bool {
        self.bodies[id.index()].stuck
    }
    /// Makes the joints of this metamodule stick, or turn again.
    pub fn set_stuck(&mut self, id: ModuleId, stuck: bool) {
        self.bodies[id.index()].stuck = stuck;
    }
    /// Puts a foreign object into a cell, unless a body is there or about to be; returns true if it did.
    pub fn block(&mut self, cell: Cell) -> bool {
        let element = self.elements.iter().any(|e| e.cells.contains(&cell));
        let free = !element && !self.bodies.iter().any(|b| b.taken().contains(&cell));
        if free {
            self.obstacles.insert(cell);
        }
        free
    }
    /// Removes a foreign object; returns true if it was there.
    pub fn unblock(&mut self, cell: Cell) -> bool {
        self.obstacles.remove(&cell)
    }
    /// Returns the cells with a foreign object in them.
    pub fn obstacles(&self) -> &BTreeSet<Cell> {
        &self.obstacles
    }
    /// Returns the counts of actions so far.
    pub fn action_counts(&self) -> ActionCounts {
        self.action_counts
    }
    /// Returns the pose of a body; during an action, the one before.
    pub fn pose(&self, id: ModuleId) -> Pose {
        self.bodies[id.index()].pose
    }
    /// Returns the four cells of a body, from the attached end on.
    pub fn cells(&self, id: ModuleId) -> &[Cell] {
        &self.bodies[id.index()].cells
    }
    /// Returns all cells that a body is in, or may be in during its action.
    pub fn taken(&self, id: ModuleId) -> &[Cell] {
        self.bodies[id.index()].taken()
    }
    /// Returns when the current action of a body ends, if it acts.
    pub fn acting_until(&self, id: ModuleId) -> Option<Time> {
        self.queue.acting_until(id)
    }
    /// Returns true if a body is acting.
    pub fn is_acting(&self, id: ModuleId) -> bool {
        self.bodies[id.index()].under_way.is_some()
    }
    /// Returns the setup that all metamodules share.
    pub fn setup(&self) -> &Setup {
        &self.setup
    }
    /// Returns the invariants broken since the last call.
    pub fn take_violations(&mut self) -> Vec<Violation> {
        self.queue.take_violations()
    }

    fn set_contact(&mut self, id: ModuleId, port: Port, contact: Option<Contact>, tell: bool) {
        self.queue.set_contact((id, &mut self.bodies[id.index()].ports), port, contact, tell);
    }

    fn link(&self, id: ModuleId, peer: ModuleId) -> Option<Contact> {
        self.bodies[id.index()].ports.contacts.iter().flatten().find(|c| c.peer == peer).copied()
    }

    fn disconnect(&mut self, id: ModuleId, contact: Contact, tell: bool) {
        let mine = self.link(contact.peer, id);
        self.set_contact(contact.peer, contact.peer_port, None, tell);
        if let Some(mine) = mine {
            self.set_contact(id, mine.peer_port, None, tell);
        }
    }

    /// Opens links to all metamodules that have come into communication range, and closes those to
    /// metamodules that have left it.
    fn hear(&mut self, now: Time, id: ModuleId, tell: bool) {
        let (pose, range) = (self.bodies[id.index()].pose, self.setup.params.communication_range);
        for peer in (0..self.bodies.len() as u32).map(ModuleId).filter(|p| *p != id) {
            let near = pose.is_within(range, self.bodies[peer.index()].pose);
            match (near, self.link(id, peer)) {
                (true, None) => self.connect(now, id, peer, tell),
                (false, Some(contact)) => self.disconnect(id, contact, tell),
                _ => {}
            }
        }
    }

    fn connect(&mut self, now: Time, id: ModuleId, peer: ModuleId, tell: bool) {
        let (mine, theirs) = (self.bodies[id.index()].free_port(), self.bodies[peer.index()].free_port());
        let (mine, theirs) = match link_for_each_in_range(id, peer, mine.zip(theirs)) {
            Ok(ports) => ports,
            Err(what) => return self.queue.violate(LINK_FOR_EACH_IN_RANGE, now, what),
        };
        let session = self.queue.open_session();
        let end = |of: ModuleId, port| self.bodies[of.index()].ports.end(session, of, port);
        let (to_me, to_them) = (end(peer, theirs), end(id, mine));
        self.set_contact(id, mine, Some(to_me), tell);
        self.set_contact(peer, theirs, Some(to_them), tell);
    }

    fn refuse(&mut self, id: ModuleId, why: Refusal) {
        match why {
            Refusal::Blocked => self.action_counts.blocked += 1,
            Refusal::Late => self.action_counts.late += 1,
            Refusal::Stale => self.action_counts.stale += 1,
            Refusal::Busy | Refusal::Impossible => self.action_counts.impossible += 1,
        }
        self.queue.perceive(id, Percept::Refused(why));
    }

    /// Returns the pose that an action leads to and the cells that it needs, if the body is able to do it.
    fn judge(&self, id: ModuleId, body_action: BodyAction) -> Option<(Pose, Vec<Cell>)> {
        let (body, motions) = (&self.bodies[id.index()], &self.setup.motions);
        let pose = body.pose;
        match body_action {
            // A body held at both ends is a closed chain: its joints cannot turn by a step.
            BodyAction::Turn(_) if pose.both => None,
            BodyAction::Turn(number) => {
                let (posture, swept) = motions.graph().step(pose.posture, number)?;
                if pose.load != Load::NONE {
                    return self.judge_carry(id, posture);
                }
                let swept = motions.swept(pose.state, Sweep(swept));
                Some((Pose { posture, ..pose }, swept.chain(body.cells).collect()))
            }
            BodyAction::Grip(load) => self.judge_grip(id, load),
            BodyAction::LetGo => self.judge_let_go(id),
            // An end that holds an element grips nothing else.
            BodyAction::Attach | BodyAction::Detach if pose.load != Load::NONE => None,
            BodyAction::Attach => {
                motions.landing(pose).filter(|s| self.setup.floor.has(s.x, s.y) && !pose.both)?;
                Some((Pose { both: true, ..pose }, body.cells.to_vec()))
            }
            BodyAction::Detach => {
                let around = motions.turned_around(pose).filter(|_| pose.both)?;
                Some((Pose { both: false, ..around }, body.cells.to_vec()))
            }
        }
    }

    fn is_free(&self, id: ModuleId, cells: &[Cell]) -> bool {
        let others = self.bodies.iter().enumerate().filter(|(i, _)| *i != id.index());
        let mut taken = others.flat_map(|(_, b)| b.taken()).chain(&self.obstacles);
        !taken.any(|c| cells.contains(c)) && self.element_in(id, cells).is_none()
    }

    /// Decides how the free end of a body connects to what it faces. The body stands on a floor, held at its other end.
    fn draw_connection(&mut self, id: ModuleId) -> ActionEnd {
        let motions = &self.setup.motions;
        let posture = self.bodies[id.index()].pose.posture;
        self.connections.attempt(&mut self.queue, |model| {
            let table = motions.table();
            let q = table.postures()[usize::from(posture)].posture.radians();
            let bent = model.bending(table.kind(), &q, &torque::Load::floor());
            bent.expect("invariant: a posture of the table has all joints and finite angles")
        })
    }

    fn complete(&mut self, now: Time, id: ModuleId) {
        let motions = &self.setup.motions;
        let is_shared = self.is_shared(id);
        let body = &mut self.bodies[id.index()];
        let Some(ActionInProgress { to, claimed, body_action, end }) = body.under_way.take() else {
            return;
        };
        if end != ActionEnd::Done {
            self.check_end(now, id, &claimed);
            self.action_counts.failed += 1;
            let is_misaligned = end == ActionEnd::Misaligned;
            self.queue.perceive(id, if is_misaligned { Percept::Misaligned } else { Percept::Failed });
            return;
        }
        match body_action {
            BodyAction::Turn(_) => {
                self.action_counts.turns += 1;
                self.action_counts.carries += u64::from(body.pose.load != Load::NONE);
            }
            BodyAction::Attach => {
                self.action_counts.moves += 1;
                body.grips[body.pose.end.other() as usize] = true;
            }
            BodyAction::Detach => {
                self.action_counts.released += 1;
                body.grips[body.pose.end as usize] = false;
            }
            BodyAction::Grip(_) => self.action_counts.grips += 1,
            BodyAction::LetGo => {
                self.action_counts.let_go += 1;
                self.action_counts.hand_overs += u64::from(is_shared);
            }
        }
        body.pose = to;
        body.cells = motions.cells(to);
        self.carry_along(id);
        self.fall_on();
        if matches!(body_action, BodyAction::Grip(_)) {
            self.count_carried();
        }
        self.queue.perceive(id, Percept::Done(to));
        self.check_end(now, id, &claimed);
        if body_action == BodyAction::Detach {
            self.hear(now, id, true);
        }
    }
}

/// The state that later events depend on; counts are left out.
impl Hash for MetamoduleWorld {
    fn hash<H: Hasher>(&self, state: &mut H) {
        (&self.bodies, &self.obstacles).hash(state);
        self.elements.iter().for_each(|element| element.hash(state));
        self.queue.hash(state);
    }
}

impl World for MetamoduleWorld {
    type Agent = Metamodule;

    fn len(&self) -> usize {
        self.bodies.len()
    }

    fn place(&self, id: ModuleId) -> Pose {
        self.pose(id)
    }

    fn start(&mut self, now: Time, id: ModuleId, incarnation: Incarnation) {
        let ports = &mut self.bodies[id.index()].ports;
        if self.queue.start((id, ports), incarnation) {
            ports.contacts.clone().into_iter().flatten().for_each(|c| self.disconnect(id, c, true));
            self.hear(now, id, true);
        }
    }

    fn act(&mut self, now: Time, id: ModuleId, sensed: Revision, action: &Action) {
        let body = &self.bodies[id.index()];
        if body.under_way.is_some() {
            return self.refuse(id, Refusal::Busy);
        }
        if sensed != body.ports.revision {
            return self.refuse(id, Refusal::Stale);
        }
        if now > action.not_after {
            return self.refuse(id, Refusal::Late);
        }
        let Some((to, claimed)) = self.judge(id, action.body_action) else {
            self.count_prevented(id, action.body_action);
            return self.refuse(id, Refusal::Impossible);
        };
        if !self.is_free(id, &claimed) {
            return self.refuse(id, Refusal::Blocked);
        }
        let is_stuck = body.stuck;
        let (takes, end) = match action.body_action {
            BodyAction::Turn(_) => (self.setup.params.turn_time, ActionEnd::of(is_stuck)),
            BodyAction::Attach | BodyAction::Grip(_) => {
                (self.setup.params.connect_time, self.draw_connection(id))
            }
            BodyAction::Detach | BodyAction::LetGo => (self.setup.params.connect_time, ActionEnd::Done),
        };
        self.action_counts.started += 1;
        self.queue.begin(now + takes, id);
        self.bodies[id.index()].under_way =
            Some(ActionInProgress { to, claimed, body_action: action.body_action, end });
        self.check_begin(now, id);
        self.check_torque(now, id);
        self.check_elements(now);
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
            let Body { pose, grips, cells: _, ports, under_way, stuck } = body;
            (pose, grips, ports, stuck).hash(&mut hasher);
            let under_way = under_way.as_ref();
            under_way
                .map(|ActionInProgress { to, claimed: _, body_action, end }| (to, body_action, *end as u8))
                .hash(&mut hasher);
        }
        (&self.obstacles, &self.queue).hash(&mut hasher);
        self.elements.iter().for_each(|element| element.hash(&mut hasher));
    }

    fn poll(&mut self) -> Option<(ModuleId, Sensed<Percept>)> {
        self.queue.poll()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_kernel::world::invariants::ONE_MODULE_PER_CELL;
    use metamorph_protocol::metamodule::blueprint::{Blueprint, SeedOrder, box_of_four};
    use metamorph_protocol::metamodule::elements::Elements;
    use metamorph_protocol::metamodule::motions::Motions;
    use metamorph_protocol::metamodule::params::{Floor, Params, Strategy};
    use metamorph_protocol::metamodule::pose::End;
    use metamorph_protocol::roombots::Kind;
    use metamorph_protocol::roombots::database::{CellSet, Database};
    use metamorph_protocol::roombots::grid::GridState;
    use metamorph_protocol::roombots::posture::Posture;
    use metamorph_protocol::time::Span;

    pub(super) fn setup() -> Arc<Setup> {
        Arc::new(Setup {
            params: Params::scaled(Strategy::Greedy, Span::secs(1), Span::millis(10)),
            floor: Floor { min: (0, 0), max: (12, 12) },
            goals: vec![Blueprint::new(&box_of_four(5, 5), SeedOrder::Circular).unwrap()],
            motions: Motions::new(Arc::new(Database::build()), Kind::Srs).unwrap(),
            elements: Elements::NONE,
        })
    }

    pub(super) fn upright(setup: &Setup, x: i16, y: i16) -> Pose {
        let posture = setup.motions.table().find(Posture::zero(Kind::Srs)).unwrap();
        Pose::standing(GridState::new(x, y, 0), posture)
    }

    pub(super) fn act(world: &mut MetamoduleWorld, body_action: BodyAction) -> Percept {
        act_of(world, 0, body_action)
    }

    pub(super) fn act_of(world: &mut MetamoduleWorld, of: u32, body_action: BodyAction) -> Percept {
        let (now, id) =
            (Some(world.queue.next_end()).filter(|at| *at < Time::NEVER).unwrap_or(Time::ZERO), ModuleId(of));
        let revision = world.bodies[id.index()].ports.revision;
        world.act(now, id, revision, &Action { body_action, not_after: now });
        world.advance(Time(u64::MAX - 1));
        let percept = |(by, s)| if let (true, Sensed::Percept(p)) = (by == id, s) { Some(p) } else { None };
        std::iter::from_fn(|| world.poll()).filter_map(percept).last().unwrap()
    }

    #[test]
    fn the_last_end_does_not_let_go_and_air_cannot_be_gripped() {
        let setup = setup();
        let mut world = MetamoduleWorld::new(Arc::clone(&setup), &[upright(&setup, 3, 3)], 1);
        for body_action in [BodyAction::Detach, BodyAction::Attach, BodyAction::Turn(u16::MAX)] {
            assert_eq!(act(&mut world, body_action), Percept::Refused(Refusal::Impossible));
        }
    }

    /// Every landing, from upright, step by step; then the other end holds.
    #[test]
    fn makes_every_landing() {
        let setup = setup();
        let (motions, table) = (&setup.motions, setup.motions.table());
        let from = upright(&setup, 6, 6);
        let reach = table.reach(from.posture, &CellSet::default());
        for landing in table.landings() {
            let (to, _) = reach.postures().find(|(p, _)| landing.postures.contains(p)).unwrap();
            let mut world = MetamoduleWorld::new(Arc::clone(&setup), &[from], 1);
            for (step, _) in table.path_within(&reach, from.posture, to).unwrap().steps {
                assert!(matches!(act(&mut world, BodyAction::Turn(step)), Percept::Done(_)));
            }
            assert!(matches!(act(&mut world, BodyAction::Attach), Percept::Done(p) if p.both));
            assert_eq!(act(&mut world, BodyAction::Turn(0)), Percept::Refused(Refusal::Impossible));
            let Percept::Done(pose) = act(&mut world, BodyAction::Detach) else { panic!() };
            assert_eq!((pose.state, pose.end, pose.both), (from.state.then(landing.state), End::Head, false));
            let mut cells = motions.cells(Pose { posture: to, ..from });
            cells.reverse();
            assert_eq!(world.cells(ModuleId(0)), cells, "the body is where it was, seen from its other end");
            assert_eq!((world.action_counts().moves, world.take_violations().len()), (1, 0));
        }
    }

    #[test]
    fn a_step_into_another_body_is_refused() {
        let setup = setup();
        let from = upright(&setup, 6, 6);
        let mut refused = 0;
        for number in 0..setup.motions.table().steps().len() as u16 {
            let Some((_, swept)) = setup.motions.graph().step(from.posture, number) else { continue };
            let swept: Vec<Cell> = setup.motions.swept(from.state, Sweep(swept)).collect();
            for (dx, dy) in [(1, 0), (0, 1), (-1, 0), (0, -1), (3, 3)] {
                let other = upright(&setup, 6 + dx, 6 + dy);
                let mut world = MetamoduleWorld::new(Arc::clone(&setup), &[from, other], 1);
                let meets = world.cells(ModuleId(1)).iter().any(|c| swept.contains(c));
                let blocked = act(&mut world, BodyAction::Turn(number)) == Percept::Refused(Refusal::Blocked);
                assert_eq!(blocked, meets, "step {number}, other at {dx}, {dy}");
                refused += u32::from(blocked);
            }
        }
        assert!(refused > 0);
    }

    #[test]
    fn obstacles_and_bodies_exclude_each_other() {
        let setup = setup();
        let from = upright(&setup, 6, 6);
        let mut world = MetamoduleWorld::new(Arc::clone(&setup), &[from], 1);
        assert!(!world.block(Cell::new(6, 6, 3)), "a body is there");
        let steps = 0..setup.motions.table().steps().len() as u16;
        let swept = |n| setup.motions.graph().step(from.posture, n).map(|(_, s)| (n, s));
        let (number, swept) = steps.filter_map(swept).next().unwrap();
        let cell = setup.motions.swept(from.state, Sweep(swept)).find(|c| (c.x, c.y) != (6, 6)).unwrap();
        assert!(world.block(cell));
        assert_eq!(act(&mut world, BodyAction::Turn(number)), Percept::Refused(Refusal::Blocked));
        assert!(world.unblock(cell) && !world.unblock(cell));
        assert!(matches!(act(&mut world, BodyAction::Turn(number)), Percept::Done(_)));
        world.obstacles.insert(world.cells(ModuleId(0))[2]);
        world.check_all(Time::ZERO);
        assert_eq!(world.take_violations()[0].invariant, ONE_MODULE_PER_CELL);
    }

    #[test]
    fn hears_only_metamodules_in_range() {
        let setup = setup();
        let far = setup.params.communication_range as i16;
        let poses = [upright(&setup, 0, 0), upright(&setup, far, 0), upright(&setup, far + 1, 0)];
        let world = MetamoduleWorld::new(Arc::clone(&setup), &poses, 1);
        let linked = |a, b| world.link(ModuleId(a), ModuleId(b)).is_some();
        assert!(linked(0, 1) && linked(1, 0) && linked(1, 2) && !linked(0, 2));
    }
}
