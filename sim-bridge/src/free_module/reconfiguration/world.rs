//! The world of free modules on the lattice: bodies, connectors, and turns that carry whole branches.
//!
//! The world is the interlock: a joint turns only if no loop locks it and no body is in the way, on the way or at the
//! end; a connector closes only if it faces another one; one whose opening would part the structure stays closed. It
//! judges by the checker of plans (`assembly::checker`), which shares nothing with the planner. What other modules are
//! about to do a body cannot know: that is what branch locks are for. Two modules are in contact while both sides of a
//! connection are closed. Absent: gravity, torque, a floor.

mod safety;

use crate::connections::{ActionEnd, ConnectionCounts, Connections};
use metamorph_kernel::world::World;
use metamorph_kernel::world::body_queue::{BodyQueue, Ports};
use metamorph_protocol::assembly::checker::{
    PhysicalAction, Physics, Place as Site, Refusal as Reason, World as Bodies,
};
use metamorph_protocol::assembly::collision::Model;
use metamorph_protocol::digest::Portable;
use metamorph_protocol::free_module::reconfiguration::message::{
    LatticeAction, LatticeBodyAction, LatticePercept, LatticeRefusal, Swing,
};
use metamorph_protocol::free_module::reconfiguration::place::{CONNECTORS, LatticePlace};
use metamorph_protocol::free_module::reconfiguration::{LatticeModule, LatticeSetup};
use metamorph_protocol::ids::{Incarnation, ModuleId, Port, Revision};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::roombots::connection::{ConnectionModel, Misalignment};
use metamorph_protocol::roombots::connector::Connector;
use metamorph_protocol::runtime::{Contact, Sensed};
use metamorph_protocol::time::Time;
use std::collections::BTreeSet;
use std::hash::{Hash, Hasher};
use std::sync::Arc;

/// Cells from the origin within which modules stay.
const FARTHEST: i16 = Cell::LIMIT / 2;

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Turn {
    joint: usize,
    positive: bool,
    /// The other modules behind the joint.
    moving: Vec<usize>,
    /// The box that they can reach, in half cells.
    reach: [[i16; 3]; 2],
}

#[derive(Clone, Debug)]
struct ActionInProgress {
    action: LatticeAction,
    end: ActionEnd,
    turn: Option<Turn>,
}

#[derive(Clone, Debug)]
struct Body {
    /// The closed connectors, as bits.
    closed: u16,
    ports: Ports<[Option<Contact>; CONNECTORS]>,
    under_way: Option<ActionInProgress>,
    carried_by: Option<ModuleId>,
    stuck: bool,
}

/// Counts of the bodies' actions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct StepCounts {
    /// Actions begun.
    pub started: u64,
    /// Steps of joints completed.
    pub turns: u64,
    /// Connections made.
    pub attached: u64,
    /// Connections given up.
    pub detached: u64,
    /// Sides of connections closed or opened.
    pub sides: u64,
    /// Actions that failed: stuck joints and failed connections.
    pub failed: u64,
    /// Actions refused because of another body.
    pub blocked: u64,
    /// Actions refused because they came too late.
    pub late: u64,
    /// Actions refused because the contacts had changed.
    pub stale: u64,
    /// Actions refused because the body was not able to, or was busy.
    pub impossible: u64,
}

/// A simulated world of free modules.
#[derive(Clone, Debug)]
pub struct FreeModuleWorld {
    setup: Arc<LatticeSetup>,
    physics: Physics,
    /// Where modules are; `held` are the connections that both sides hold.
    state: Bodies,
    bodies: Vec<Body>,
    /// Connections that one side has begun to make or to give up: the record of the safety checks.
    pending: BTreeSet<(Site, Site)>,
    /// Actions carried out: epoch and index, and the module.
    done: BTreeSet<(u32, u16, ModuleId)>,
    /// Actions confirmed, of the latest epoch.
    confirmed: (u32, BTreeSet<usize>),
    queue: BodyQueue<LatticePercept>,
    connections: Connections,
    counts: StepCounts,
}

/// Returns a pair in the order of the checker.
fn pair(a: Site, b: Site) -> (Site, Site) {
    (a.min(b), a.max(b))
}

impl FreeModuleWorld {
    /// Creates a world with a module at each place; their ids are the indices in the list.
    pub fn new(
        setup: Arc<LatticeSetup>,
        physics: Physics,
        places: &[LatticePlace],
        seed: u64,
    ) -> FreeModuleWorld {
        let body = |place: &LatticePlace| Body {
            closed: place.closed,
            ports: Ports::new([None; CONNECTORS]),
            under_way: None,
            carried_by: None,
            stuck: false,
        };
        let robots = places.iter().map(LatticePlace::robot).collect();
        let mut world = FreeModuleWorld {
            setup,
            physics,
            state: Bodies { robots, held: BTreeSet::new() },
            bodies: places.iter().map(body).collect(),
            pending: BTreeSet::new(),
            done: BTreeSet::new(),
            confirmed: (0, BTreeSet::new()),
            queue: BodyQueue::new(seed),
            connections: Connections::default(),
            counts: StepCounts::default(),
        };
        for (module, place) in places.iter().enumerate() {
            let closed = Connector::ALL.into_iter().filter(|c| place.is_closed(*c as u8));
            for site in closed.map(|c| (module, c)) {
                world.connect(site, false);
            }
        }
        world.check_all(Time::ZERO);
        world
    }

    /// Lets a model decide which connectors close, if there is one. Without gravity nothing bends.
    pub fn with_connections(self, model: Option<ConnectionModel>) -> FreeModuleWorld {
        FreeModuleWorld { connections: Connections::new(model), ..self }
    }
    /// Returns the counts of attempts to connect so far; `None` without a model of connections.
    pub fn connection_counts(&self) -> Option<ConnectionCounts> {
        self.connections.counts()
    }
    /// Sets the probability with which each later closing of a connector fails.
    pub fn set_failure(&mut self, p: Ratio) {
        self.queue.set_failure(p);
    }
    /// Makes the joints of this module stick, or turn again.
    pub fn set_stuck(&mut self, id: ModuleId, stuck: bool) {
        self.bodies[id.index()].stuck = stuck;
    }
    /// Returns the counts of actions so far.
    pub fn counts(&self) -> StepCounts {
        self.counts
    }
    /// Returns the setup that all modules share.
    pub fn setup(&self) -> &LatticeSetup {
        &self.setup
    }
    /// Returns true if a module acts or is carried.
    pub fn is_acting(&self, id: ModuleId) -> bool {
        let body = &self.bodies[id.index()];
        body.under_way.is_some() || body.carried_by.is_some()
    }
    /// Returns the places of all modules, with the connections that both sides hold. `None` while a turn is under way
    /// or a connection is held by one side only.
    pub fn at_rest(&self) -> Option<Vec<LatticePlace>> {
        let acts = |id| self.is_acting(ModuleId(id));
        let rests = !(0..self.bodies.len() as u32).any(acts) && self.half_open().next().is_none();
        rests.then(|| (0..self.bodies.len() as u32).map(|id| self.place(ModuleId(id))).collect())
    }
    /// Returns the modules that the turn of a module moves, if it turns.
    pub fn carried_by(&self, id: ModuleId) -> Option<&[usize]> {
        let under_way = self.bodies[id.index()].under_way.as_ref()?;
        under_way.turn.as_ref().map(|turn| &*turn.moving)
    }
    /// Returns when the current action of a module ends, if it acts.
    pub fn acting_until(&self, id: ModuleId) -> Option<Time> {
        self.queue.acting_until(id)
    }

    fn is_closed(&self, (module, connector): Site) -> bool {
        self.bodies[module].closed >> connector as u16 & 1 != 0
    }
    fn set_closed(&mut self, (module, connector): Site, closed: bool) {
        let bits = &mut self.bodies[module].closed;
        *bits = *bits & !(1 << connector as u16) | u16::from(closed) << connector as u16;
    }
    /// Iterates over the connections that one side holds: the closed side and the open one.
    fn half_open(&self) -> impl Iterator<Item = (Site, Site)> {
        let all = (0..self.bodies.len()).flat_map(|m| Connector::ALL.map(|c| (m, c)));
        let closed = all.filter(|site| self.is_closed(*site));
        closed.filter_map(|site| Some((site, self.state.partner(site)?))).filter(|(_, p)| !self.is_closed(*p))
    }
    /// Returns the bodies with every connection that at least one side holds.
    fn bound(&self) -> Bodies {
        let mut state = self.state.clone();
        state.held.extend(self.half_open().map(|(a, b)| pair(a, b)));
        state
    }

    fn set_contact(&mut self, (module, connector): Site, contact: Option<Contact>, tell: bool) {
        let of = (ModuleId(module as u32), &mut self.bodies[module].ports);
        self.queue.set_contact(of, Port(connector as u8), contact, tell);
    }
    fn is_in_contact(&self, (module, connector): Site) -> bool {
        self.bodies[module].ports.contacts[connector as usize].is_some()
    }

    /// Opens the contact of a connection if both sides hold it and there is none yet.
    fn connect(&mut self, site: Site, tell: bool) {
        let Some(partner) = self.state.partner(site).filter(|p| self.is_closed(*p)) else { return };
        self.state.held.insert(pair(site, partner));
        if self.is_in_contact(site) {
            return;
        }
        let session = self.queue.open_session();
        for (own, other) in [(site, partner), (partner, site)] {
            let contact =
                self.bodies[other.0].ports.end(session, ModuleId(other.0 as u32), Port(other.1 as u8));
            self.set_contact(own, Some(contact), tell);
        }
    }

    fn disconnect(&mut self, site: Site) {
        let held = self.state.held.iter().find(|(a, b)| *a == site || *b == site).copied();
        if let Some((a, b)) = held {
            self.state.held.remove(&(a, b));
            self.set_contact(a, None, true);
            self.set_contact(b, None, true);
        }
    }

    fn refuse(&mut self, id: ModuleId, why: LatticeRefusal) {
        match why {
            LatticeRefusal::Blocked => self.counts.blocked += 1,
            LatticeRefusal::Late => self.counts.late += 1,
            LatticeRefusal::Stale => self.counts.stale += 1,
            LatticeRefusal::Busy | LatticeRefusal::Impossible => self.counts.impossible += 1,
        }
        self.queue.perceive(id, LatticePercept::Refused(why));
    }

    /// Returns what a turn moves, if the body is able to do the action.
    fn judge(&self, id: ModuleId, body_action: LatticeBodyAction) -> Result<Option<Turn>, LatticeRefusal> {
        let module = id.index();
        match body_action {
            LatticeBodyAction::Attach(connector) => {
                let site = (module, Connector::ALL[usize::from(connector)]);
                let partner = self.state.partner(site).ok_or(LatticeRefusal::Impossible)?;
                let passive = self.physics.active && !site.1.is_active() && !partner.1.is_active();
                match (self.is_closed(site) || passive, self.bodies[partner.0].carried_by) {
                    (true, _) => Err(LatticeRefusal::Impossible),
                    (false, Some(_)) => Err(LatticeRefusal::Busy),
                    (false, None) => Ok(None),
                }
            }
            LatticeBodyAction::Detach(connector) => {
                let site = (module, Connector::ALL[usize::from(connector)]);
                let mut rest = self.state.clone();
                rest.held.retain(|held| !self.is_opening(*held) && held.0 != site && held.1 != site);
                let parts = rest.whole().is_err();
                if !self.is_closed(site) || parts { Err(LatticeRefusal::Impossible) } else { Ok(None) }
            }
            LatticeBodyAction::Turn { joint, positive } => {
                self.turn(module, joint.into(), positive).map(Some)
            }
        }
    }

    /// Returns true if a side of a connection is opening.
    fn is_opening(&self, (a, b): (Site, Site)) -> bool {
        [a, b].into_iter().any(|(module, connector)| {
            let body_action = self.bodies[module].under_way.as_ref().map(|u| u.action.body_action);
            body_action == Some(LatticeBodyAction::Detach(connector as u8))
        })
    }

    /// Decides how a connector closes. Both sides of a connection are as far from each other, so the first one decides whether they
    /// meet, and each may miss.
    fn draw_connection(&mut self, site: Site) -> ActionEnd {
        let Some(partner) = self.state.partner(site) else {
            return ActionEnd::of(self.queue.draw_failure());
        };
        let attaches = LatticeBodyAction::Attach(partner.1 as u8);
        let under_way = self.bodies[partner.0].under_way.as_ref();
        let theirs = under_way.filter(|under_way| under_way.action.body_action == attaches).map(|u| u.end);
        match theirs {
            Some(ActionEnd::Misaligned) => ActionEnd::Misaligned,
            Some(ActionEnd::Done | ActionEnd::Failed) => ActionEnd::of(self.queue.draw_failure()),
            None if self.is_closed(partner) => ActionEnd::of(self.queue.draw_failure()),
            None => self.connections.attempt(&mut self.queue, |_| Misalignment::default()),
        }
    }

    fn turn(&self, module: usize, joint: usize, positive: bool) -> Result<Turn, LatticeRefusal> {
        let bound = self.bound();
        let moving = bound.moving_side(module, joint).ok_or(LatticeRefusal::Impossible)?;
        match bound.act(PhysicalAction::Turn(module, joint, positive), self.physics) {
            Err(Reason::Collision(..) | Reason::Touch(..)) => return Err(LatticeRefusal::Blocked),
            Err(_) => return Err(LatticeRefusal::Impossible),
            Ok(next) => {
                let cells = next.robots.iter().map(|robot| LatticePlace::of_robot(robot, 0).cell);
                let far = |c: Cell| [c.x, c.y, c.z].into_iter().any(|x| x.abs() > FARTHEST);
                if cells.into_iter().any(far) {
                    return Err(LatticeRefusal::Impossible);
                }
            }
        }
        let reach = bound.reach(module, joint, &moving);
        let turns = self.bodies.iter().flat_map(|b| &b.under_way).flat_map(|u| &u.turn);
        let meets =
            |[low, high]: [[i16; 3]; 2]| (0..3).all(|i| reach[0][i] <= high[i] && low[i] <= reach[1][i]);
        // The cells swept by two turns at once are not sampled, so the turns must be out of each other's reach.
        match turns.into_iter().any(|turn| meets(turn.reach) || turn.moving.contains(&module)) {
            true => Err(LatticeRefusal::Busy),
            false => Ok(Turn { joint, positive, moving, reach }),
        }
    }

    /// Tells the modules that a turn moves, from the frame of the joint before it.
    fn carry(&mut self, id: ModuleId, turn: &Turn) {
        let (axis, pivot) = self.place(id).axis(turn.joint as u8);
        let step = if turn.joint == 1 { 90 } else { 120 };
        let degrees = if turn.positive { step } else { -step };
        let swing = Swing { pivot, axis: axis.map(|a| a as i8), degrees };
        for module in &turn.moving {
            self.bodies[*module].carried_by = Some(id);
            self.queue.perceive(ModuleId(*module as u32), LatticePercept::Carried(swing));
        }
    }

    fn complete(&mut self, now: Time, id: ModuleId) {
        let Some(ActionInProgress { action, end, turn }) = self.bodies[id.index()].under_way.take() else {
            return;
        };
        let moved = match (action.body_action, &turn) {
            _ if end != ActionEnd::Done => false,
            (LatticeBodyAction::Turn { .. }, Some(turn)) => self.turned(now, id, turn),
            (LatticeBodyAction::Attach(connector), _) => {
                self.attached((id.index(), Connector::ALL[usize::from(connector)]))
            }
            (LatticeBodyAction::Detach(connector), _) => {
                self.detached((id.index(), Connector::ALL[usize::from(connector)]));
                true
            }
            (LatticeBodyAction::Turn { .. }, None) => false,
        };
        for module in turn.iter().flat_map(|turn| &turn.moving) {
            self.bodies[*module].carried_by = None;
            let other = ModuleId(*module as u32);
            let percept = LatticePercept::Settled { place: self.place(other), moved };
            self.queue.perceive(other, percept);
        }
        let percept = match (moved, end) {
            (true, _) => LatticePercept::Done(self.place(id)),
            (false, ActionEnd::Misaligned) => LatticePercept::Misaligned,
            (false, ActionEnd::Done | ActionEnd::Failed) => LatticePercept::Failed,
        };
        self.queue.perceive(id, percept);
        if moved {
            self.note_done(now, id, action.step);
        } else {
            self.counts.failed += 1;
        }
        self.forget_pending();
        self.check_all(now);
    }

    /// Turns a joint. Other turns may have ended meanwhile, out of its reach.
    fn turned(&mut self, now: Time, id: ModuleId, turn: &Turn) -> bool {
        let physics = Physics { collision: Model::Final, ..self.physics };
        let action = PhysicalAction::Turn(id.index(), turn.joint, turn.positive);
        match self.bound().act(action, physics) {
            Ok(next) => {
                self.state.robots = next.robots;
                self.counts.turns += 1;
                true
            }
            Err(reason) => {
                self.check_turned(now, id, &reason);
                false
            }
        }
    }

    /// Closes a connector, unless what it faced has moved away.
    fn attached(&mut self, site: Site) -> bool {
        if self.state.partner(site).is_none() {
            return false;
        }
        self.set_closed(site, true);
        self.counts.sides += 1;
        let before = self.state.held.len();
        self.connect(site, true);
        self.counts.attached += (self.state.held.len() > before) as u64;
        true
    }

    fn detached(&mut self, site: Site) {
        self.disconnect(site);
        self.set_closed(site, false);
        self.counts.sides += 1;
        let is_last = self.state.partner(site).is_none_or(|p| !self.is_closed(p));
        self.counts.detached += u64::from(is_last);
    }
}

impl World for FreeModuleWorld {
    type Agent = LatticeModule;

    fn len(&self) -> usize {
        self.bodies.len()
    }

    fn place(&self, id: ModuleId) -> LatticePlace {
        LatticePlace::of_robot(&self.state.robots[id.index()], self.bodies[id.index()].closed)
    }

    fn start(&mut self, _now: Time, id: ModuleId, incarnation: Incarnation) {
        if !self.queue.start((id, &mut self.bodies[id.index()].ports), incarnation) {
            return;
        }
        for site in Connector::ALL.map(|connector| (id.index(), connector)) {
            if self.is_in_contact(site) {
                self.disconnect(site);
                self.connect(site, true);
            }
        }
    }

    fn act(&mut self, now: Time, id: ModuleId, sensed: Revision, action: &LatticeAction) {
        let body = &self.bodies[id.index()];
        if self.is_acting(id) {
            return self.refuse(id, LatticeRefusal::Busy);
        }
        if sensed != body.ports.revision {
            return self.refuse(id, LatticeRefusal::Stale);
        }
        if now > action.not_after {
            return self.refuse(id, LatticeRefusal::Late);
        }
        let stuck = body.stuck;
        let turn = match self.judge(id, action.body_action) {
            Ok(turn) => turn,
            Err(why) => return self.refuse(id, why),
        };
        let (takes, end) = match action.body_action {
            LatticeBodyAction::Turn { .. } => (self.setup.turn_time, ActionEnd::of(stuck)),
            LatticeBodyAction::Attach(connector) => (
                self.setup.connect_time,
                self.draw_connection((id.index(), Connector::ALL[usize::from(connector)])),
            ),
            LatticeBodyAction::Detach(_) => (self.setup.connect_time, ActionEnd::Done),
        };
        self.counts.started += 1;
        self.queue.begin(now + takes, id);
        if let LatticeBodyAction::Attach(connector) | LatticeBodyAction::Detach(connector) =
            action.body_action
        {
            let site = (id.index(), Connector::ALL[usize::from(connector)]);
            self.pending.extend(self.state.partner(site).map(|partner| pair(site, partner)));
        }
        if let Some(turn) = &turn {
            self.check_turn(now, id, turn);
            self.carry(id, turn);
        }
        self.bodies[id.index()].under_way = Some(ActionInProgress { action: *action, end, turn });
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
        for (i, body) in self.bodies.iter().enumerate() {
            let Body { closed: _, ports, under_way, carried_by, stuck } = body;
            self.place(ModuleId(i as u32)).hash(&mut hasher);
            (ports, carried_by, stuck).hash(&mut hasher);
            under_way
                .as_ref()
                .map(|ActionInProgress { action, end, turn }| (action, *end as u8, turn))
                .hash(&mut hasher);
        }
        self.queue.hash(&mut hasher);
    }

    fn poll(&mut self) -> Option<(ModuleId, Sensed<LatticePercept>)> {
        self.queue.poll()
    }
}

/// Changes of bodies that bypass the interlock, for tests of the checks.
#[cfg(test)]
impl FreeModuleWorld {
    pub(super) fn revision(&self, id: ModuleId) -> Revision {
        self.bodies[id.index()].ports.revision
    }
    pub(super) fn is_behind(&self, of: ModuleId, other: ModuleId) -> bool {
        self.state.moving_side(of.index(), 1).is_some_and(|side| side.contains(&other.index()))
    }
    pub(super) fn let_go_of_everything(&mut self, id: ModuleId) {
        for site in Connector::ALL.map(|connector| (id.index(), connector)) {
            if let Some(partner) = self.state.partner(site) {
                self.disconnect(site);
                self.set_closed(site, false);
                self.set_closed(partner, false);
            }
        }
    }
    pub(super) fn open_without_telling(&mut self, id: ModuleId) {
        self.bodies[id.index()].closed = 0;
    }
    pub(super) fn put_on_top(&mut self, id: ModuleId, other: ModuleId) {
        self.state.robots[id.index()] = self.state.robots[other.index()].clone();
    }
    pub(super) fn make_pending(&mut self, id: ModuleId) {
        self.pending.insert(((id.index(), Connector::C0X), (id.index(), Connector::C0Y)));
    }
}
