//! The cube: a module of the sliding-cube model with local messages only.
//!
//! Growth after Stoy (thesis 4.1.2) made safe against late, lost and duplicated messages and against crashes.
//! An agent is made of parts, each with a state of its own that no other part writes:
//!
//! * `sides` — the six contacts, and the last beacon of each neighbour;
//! * `attraction` — the field towards unfilled goal cells, on faces of empty surface cells;
//! * `parent_forest`, `custody`, `cycles` — the connectivity checks, and which module stays for a dead neighbour;
//! * `finalization` — when a module becomes part of the finalized structure;
//! * `lock_table`, `negotiation` — locks and reservations along routes, with leases;
//! * `motion_planner` — where to go, and when; `survey`, `turns` — over dead modules; `call`, `steering` — where the
//!   controller leads it;
//! * `beacon` — telling the neighbours; `reporter` — telling the world-controller;
//! * `epoch` — which goal it works for, and whether it is built now;
//! * `view` — what the parts read: the module itself, its neighbours, the time of the step.
//!
//! This file holds them together: which parts an input concerns, and in which order the parts work in a step;
//! `queries` answers audits and viewers. Not here: any knowledge of the world beyond contacts, messages and
//! the module's own cell.

#![cfg_attr(not(test), no_std)]

extern crate alloc;

mod attraction;
mod beacon;
pub mod body;
pub mod call;
pub mod control;
mod custody;
mod cycles;
mod digest;
pub mod epoch;
mod finalization;
mod lock_table;
pub mod message;
mod motion_planner;
mod negotiation;
pub mod params;
mod parent_forest;
mod queries;
mod relays;
mod reporter;
mod retransmission;
pub mod route;
mod sides;
pub mod steering;
mod survey;
mod turns;
mod view;

#[cfg(all(test, debug_assertions))]
mod comparison_tests;
#[cfg(test)]
mod edge_tests;

pub use attraction::Successor;

use alloc::borrow::ToOwned;
use alloc::boxed::Box;
use alloc::collections::VecDeque;
use alloc::sync::Arc;
use attraction::Attraction;
use beacon::Beacons;
use body::{Move, Percept};
use call::Called;
use control::{Order, Status};
use core::hash::Hasher;
use epoch::{Epoch, Opening};
use lock_table::{Lock, LockTable};
use message::{Beacon, Message, RequestId, Role};
use metamorph_core::agent::Summary;
use metamorph_core::agent::{Agent, Birth, Input, InputOf, Output, OutputOf};
use metamorph_core::counters::Class;
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::defects::Defect;
use metamorph_core::ids::{Incarnation, Port, Session};
use metamorph_core::lattice::{Cell, Face};
use metamorph_core::rng::Rng;
use metamorph_core::time::{Span, Time};
use motion_planner::MotionPlanner;
use negotiation::Attempt;
use params::{Connectivity, Setup};
use parent_forest::{Effect, Held, ParentForest, Tokens};
use relays::Relays;
use reporter::Reporter;
use retransmission::Retransmission;
use sides::Sides;
use steering::Steered;
use survey::Surveyor;
use view::{GoalMasks, Own, Shared, View};

/// The agent of one cube.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Cube {
    own: Own,
    sides: Sides,
    forest: ParentForest,
    attraction: Attraction,
    locks: LockTable,
    planner: MotionPlanner,
    /// The move that this module is requesting locks and a reservation for.
    attempt: Option<Attempt>,
    /// The attempt whose motion the body has been asked for, until the percept arrives.
    moving: Option<Attempt>,
    /// The searches that this module saw last; it passes each of them on only once.
    searches: VecDeque<RequestId>,
    /// Messages of searches, which are repeated until they are acknowledged.
    retransmission: Retransmission,
    /// Requests of others that this module has passed on, and that have not been answered.
    relays: Relays,
    /// The number of this module's reservation requests that were denied because the cell was occupied or reserved.
    prevented: u32,
    /// An epoch that was heard of during a move; taken up when the move has ended.
    next_epoch: Option<Box<Opening>>,
    beacons: Beacons,
    reporter: Reporter,
    rng: Rng,
    tokens: Tokens,
    /// The command of an operator.
    steered: Option<Steered>,
    /// Where the controller leads it, when nothing moves any more.
    called: Option<Box<Called>>,
    /// Its own search for a goal cell beyond the dead.
    surveyor: Surveyor,
    /// Faces outside which this finalized module wants the cell filled; computed in every step.
    wanted: u8,
    /// Faces with a live neighbour that is finalized for the same goal; computed in every step.
    finals: u8,
    /// Faces outside which a goal cell is filled permanently, by a live finalized module or by a dead one; computed in
    /// every step.
    filled: u8,
    wake: Time,
    out: Outbox,
}

/// Outputs that have not been polled yet.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Default)]
struct Outbox(VecDeque<OutputOf<Cube>>);

impl Outbox {
    fn push(&mut self, output: OutputOf<Cube>) {
        self.0.push_back(output);
    }
    /// Sends a message over a face, if there is a contact.
    fn send(&mut self, sides: &Sides, face: Face, class: Class, message: Message) {
        if sides.is_touching(face) {
            self.push(Output::Send { port: Port(face as u8), class, message });
        }
    }
}

/// How a beacon differs from the one before.
enum News {
    /// Possibly in everything.
    All,
    /// Only in the distances of the cells outside these faces.
    Field(u8),
}

/// Returns the faces outside which the distances of two beacons of a neighbour differ.
fn slots_that_differ(face: Face, before: &Beacon, after: &Beacon) -> u8 {
    let slots = before.field.iter().zip(&after.field).zip(face.perpendicular());
    Face::mask(slots.filter(|((b, a), _)| b != a).map(|(_, f)| f))
}

/// Returns the faces at right angles to any face of a mask.
fn beside_any(faces: u8) -> u8 {
    Face::in_mask(faces).fold(0, |mask, f| mask | attraction::beside(f))
}

/// An event that an agent waits for.
#[derive(Clone, Copy, Debug)]
enum Timer {
    /// The next decision whether to move.
    Decision,
    /// Answers to the requests of an attempt.
    Answers,
    /// The next beacon on any face.
    Beacon,
    /// The end of the validity of a field value.
    Field,
    /// The next version of this module's own targets.
    Refresh,
    /// The end of a lease.
    Lease,
    /// The end of listening after a restart.
    Quarantine,
    /// The end of a call.
    Call,
    /// The next repetition for others.
    Repeat,
}

impl Timer {
    const ALL: [Timer; 9] = [
        Timer::Decision,
        Timer::Answers,
        Timer::Beacon,
        Timer::Field,
        Timer::Refresh,
        Timer::Lease,
        Timer::Quarantine,
        Timer::Call,
        Timer::Repeat,
    ];
}

#[cfg(test)]
impl Cube {
    /// Creates the module with number 0 at the origin, at time zero.
    fn first(setup: Setup) -> Cube {
        let (id, place, born) = (metamorph_core::ids::ModuleId(0), Cell::default(), Time::ZERO);
        let birth = Birth { id, place, incarnation: Incarnation(0), seed: 1, born };
        Cube::new(&Arc::new(setup), birth, born)
    }

    /// Takes the outputs, and returns the messages among them that are no beacons.
    fn sent(&mut self) -> alloc::vec::Vec<(Port, Message)> {
        let outputs = core::iter::from_fn(|| self.poll());
        let message = |output| match output {
            Output::Send { port, message, .. } => Some((port, message)),
            _ => None,
        };
        outputs.filter_map(message).filter(|(_, m)| !matches!(m, Message::Beacon(_))).collect()
    }
}

impl Agent for Cube {
    type Setup = Setup;
    type Place = Cell;
    type Message = Message;
    type Action = Move;
    type Percept = Percept;
    type Order = Order;
    type Report = Status;

    /// The number of ports: one for each face.
    const PORTS: usize = 6;

    fn new(setup: &Arc<Setup>, birth: Birth<Cell>, now: Time) -> Cube {
        let restarted = birth.incarnation > Incarnation(0);
        let listens = restarted && setup.params.defect != Some(Defect::NoListening);
        // The time is compared with those of other restarted modules, so it comes from the controller's clock.
        let by_own_clock = setup.params.defect == Some(Defect::OwnBirthTime);
        let restarted_at = if by_own_clock { now } else { birth.born };
        let mut own = Own {
            setup: Shared(Arc::clone(setup)),
            id: birth.id,
            cell: birth.place,
            settled: now,
            epoch: Epoch::first(0),
            is_closed: false,
            born: restarted_at,
            role: Role::Reserve,
            restarted,
            quarantine_until: if listens { now + setup.params.quarantine } else { now },
            activator: None,
            support: None,
            immobile: false,
            knows_of_death: false,
            masks: GoalMasks::default(),
        };
        own.look_up();
        Cube {
            own,
            sides: Sides::new(),
            forest: ParentForest::new(restarted.then_some(restarted_at)),
            attraction: Attraction::new(),
            locks: LockTable::default(),
            planner: MotionPlanner::new(now),
            attempt: None,
            moving: None,
            searches: VecDeque::new(),
            retransmission: Retransmission::default(),
            relays: Relays::default(),
            prevented: 0,
            next_epoch: None,
            beacons: Beacons::new(),
            reporter: Reporter::new(now),
            rng: Rng::named(birth.seed, "cube", u64::from(birth.id.0) << 16 | u64::from(birth.incarnation.0)),
            // Tokens of earlier incarnations may still be under way.
            tokens: Tokens(u32::from(birth.incarnation.0) << 20),
            steered: None,
            called: None,
            surveyor: Surveyor::new(now),
            wanted: 0,
            finals: 0,
            filled: 0,
            wake: now,
            out: Outbox::default(),
        }
    }

    fn handle(&mut self, now: Time, input: InputOf<Cube>) {
        self.sides.pass_time(now, self.own.params().suspect);
        match input {
            Input::Contact { port, session } => self.on_contact(now, port, session),
            Input::Message { port, message } => {
                if let Some(face) = Face::from_index(port.0).filter(|f| self.sides.is_touching(*f)) {
                    self.on_message(now, face, message);
                }
            }
            Input::Percept(percept) => self.on_percept(now, percept),
            Input::Order(order) => self.on_order(now, order),
            Input::Wake => {}
        }
        self.step(now);
    }

    fn poll(&mut self) -> Option<OutputOf<Cube>> {
        self.out.0.pop_front()
    }

    fn wake_at(&self) -> Time {
        self.wake
    }

    fn reseed(&mut self, seed: u64) {
        self.rng = Rng::named(seed, "cube, reseeded", self.own.id.0.into());
    }

    fn digest(&self, hasher: &mut dyn Hasher) {
        self.digest_state(hasher);
    }

    fn look_ahead(&self, port: Port) -> u64 {
        let Cube { own, sides, attraction, beacons, .. } = self;
        own.settled.0 ^ self.wake.0 ^ sides.look_ahead(port) ^ attraction.look_ahead() ^ beacons.look_ahead()
    }

    fn summary(&self, now: Time) -> Summary {
        let role = match self.own.role {
            Role::Reserve => "reserve",
            Role::Walker => "walker",
            Role::Final => "final",
        };
        Summary {
            role: role.to_owned(),
            activity: self.activity(now).to_owned(),
            goal: self.own.epoch.goal(),
            level: Some(self.label()).filter(|_| !self.is_unlabelled()),
            gradient: self.attraction.nearest().filter(|d| *d != message::Entry::FAR).map(u32::from),
            lock: self.locks.iter().find(|l| l.id.origin != self.own.id).map(|l| l.id.origin),
            waits_for: self.planner.waits_for,
        }
    }
}

impl Cube {
    fn view(&self, now: Time) -> View<'_> {
        View { now, own: &self.own, sides: &self.sides }
    }
    fn is_idle(&self) -> bool {
        self.attempt.is_none() && self.moving.is_none()
    }

    /// Marks all derived state as out of date.
    fn invalidate(&mut self) {
        self.attraction.invalidate();
        self.beacons.invalidate();
    }

    fn on_contact(&mut self, now: Time, port: Port, session: Option<Session>) {
        let Some(face) = Face::from_index(port.0) else { return };
        if self.sides.session(face) == session {
            return;
        }
        let lost = self.sides.peer(face).map(|b| b.id);
        self.sides.begin(now, face, session);
        self.surveyor.on_contact(now);
        self.beacons.on_contact(face);
        self.retransmission.on_contact(face);
        self.forest.on_contact(face, session.is_none());
        if session.is_none() {
            let own = &mut self.own;
            own.activator = own.activator.filter(|f| *f != face);
            own.support = own.support.filter(|f| *f != face);
            // Locks granted to a restarted neighbour last until their lease ends: its body may be moving.
            if let Some(id) = lost {
                if self.locks.iter().any(|lock| lock.id.origin == id) {
                    hit(CoveragePoint::CubeReleasedByLoss);
                }
                self.release_locks(|lock| lock.id.origin == id);
            }
        }
        if self.own.role == Role::Reserve && self.own.connectivity() == Connectivity::Cycles {
            // A new neighbour may hang on this module alone, and has not been asked.
            self.abort_attempt(now, None);
        }
        self.invalidate();
        self.decide_soon(now);
    }

    fn on_message(&mut self, now: Time, face: Face, message: Message) {
        match message {
            Message::Beacon(beacon) => self.on_beacon(now, face, beacon),
            Message::Request { id, age, hop, ask, route } => {
                self.on_request(now, face, id, age, hop, ask, route);
            }
            Message::Response { .. } => self.on_response(now, face, message),
            Message::Release { origin, token } => {
                let is_of = |lock: &Lock| lock.id.origin == origin && lock.id.token == token;
                self.release_locks(|lock| is_of(lock) && !lock.is_of_controller());
                self.decide_soon(now);
            }
            Message::Search { id, ttl, dead, route, number } => {
                if self.acknowledge(face, number) {
                    self.on_search(now, face, id, (ttl, dead), route);
                }
            }
            Message::Found { id, hop, reached, route, number } => {
                if self.acknowledge(face, number) {
                    self.on_found(now, face, id, hop, reached, route);
                }
            }
            Message::Heard { number } => self.retransmission.on_heard(face, number),
        }
    }

    fn on_beacon(&mut self, now: Time, face: Face, beacon: Beacon) {
        let is_dead = self.sides.is_certified_dead(face);
        if is_dead && custody::is_announced(self.view(now)) && !self.own.has(Defect::ForgetSaid) {
            // It was sent before the death, and must not end what the certificate began.
            return hit(CoveragePoint::CubeDeadSpoke);
        }
        let suspect = self.own.params().suspect;
        let mut news = News::All;
        if let Some(before) = self.sides.peer(face) {
            // One session has one neighbour; any other sender is garbage.
            if before.sequence >= beacon.sequence || before.id != beacon.id {
                return hit(CoveragePoint::CubeBeaconLate);
            }
            let is_known = before.repeating(&beacon) == beacon;
            if before.taken & !beacon.taken != 0 && !self.own.immobile {
                // It may have been denied the cell that is free now.
                self.planner.end_back_off(now);
            }
            if self.sides.missed() & face.bit() != 0 {
                let v = View { now, own: &self.own, sides: &self.sides };
                self.attraction.wait_for_news(v);
            }
            if is_known {
                return self.sides.hear(now, suspect, face, beacon);
            }
            if beacon.differs_in_field_only(before) {
                news = News::Field(slots_that_differ(face, before, &beacon));
            }
        }
        if beacon.id == self.own.id {
            return;
        }
        self.sides.hear(now, suspect, face, beacon);
        let v = View { now, own: &self.own, sides: &self.sides };
        self.attraction.note_corners(v, face, beacon.corners);
        if beacon.epoch > self.own.epoch {
            self.hear_of_epoch(now, beacon.epoch);
        }
        // A walker that has arrived needs its reservation no more: it is held by contact now.
        self.release_locks(|lock| lock.id.origin == beacon.id && lock.reserved == Some(face));
        self.own.knows_of_death |= beacon.knows_of_death;
        let (is_idle, v) = (self.is_idle(), View { now, own: &self.own, sides: &self.sides });
        self.forest.register_child(v, is_idle, face, &beacon);
        if self.own.role == Role::Reserve {
            for entry in beacon.field.iter().filter(|e| e.is_known()) {
                self.planner.hear_of(now, entry.source);
            }
        }
        match news {
            News::All => self.invalidate(),
            News::Field(faces) => {
                self.attraction.invalidate_faces(faces);
                // The neighbour may have become a child.
                self.beacons.invalidate_faces(faces | face.bit());
            }
        }
        self.decide_soon(now);
    }

    fn on_order(&mut self, now: Time, order: Order) {
        match order {
            Order::Goal(opening) => self.follow_epoch(now, opening),
            Order::Condemn { port, session, epoch, finalized, died } => {
                self.hear_of_epoch(now, epoch);
                if let Some(face) = Face::from_index(port.0)
                    && self.sides.session(face) == Some(session)
                {
                    self.sides.certify_dead(face, finalized.then_some(epoch));
                    self.own.knows_of_death = true;
                    let v = View { now, own: &self.own, sides: &self.sides };
                    self.forest.begin_custody(v, face, died);
                    self.invalidate();
                    self.decide_soon(now);
                }
            }
            Order::Steer { steering, until } => self.on_steering(now, steering, until),
            Order::Call { epoch, until, way } => self.on_call(now, epoch, until, way),
            Order::Carry { epoch, mover, token, face } => {
                self.on_carry(now, epoch, mover, token, face);
            }
            Order::Custody(announcement) => {
                self.hear_of_epoch(now, announcement.epoch);
                let v = View { now, own: &self.own, sides: &self.sides };
                self.forest.hear_of_custody(v, &announcement);
                self.invalidate();
                self.decide_soon(now);
            }
        }
    }

    /// Takes up a later goal that others work for. If another epoch of it is closed, only the controller tells.
    fn hear_of_epoch(&mut self, now: Time, epoch: Epoch) {
        if epoch.opening() == 0 {
            self.follow_epoch(now, Opening::of(epoch, Time::ZERO));
        }
    }

    /// Takes up a later epoch. All modules start over in reserve, unattached; until they are attached again
    /// none leaves, so the body is as safe as at the start of a run.
    fn follow_epoch(&mut self, now: Time, opening: Opening) {
        let Opening { epoch, opened, is_closed } = opening;
        if epoch <= self.own.epoch || usize::from(epoch.goal()) >= self.own.setup.goals.len() {
            return;
        }
        if self.moving.is_some() {
            hit(CoveragePoint::CubeEpochAfterMove);
            if self.next_epoch.as_ref().is_none_or(|next| (next.epoch, next.opened) < (epoch, opened)) {
                self.next_epoch = Some(Box::new(opening));
            }
            return;
        }
        if epoch.opening() > 0 {
            hit(CoveragePoint::CubeReopened);
        }
        self.abort_attempt(now, None);
        let own = &mut self.own;
        (own.epoch, own.role, own.activator, own.support) = (epoch, Role::Reserve, None, None);
        // In an epoch that began after its birth, no earlier incarnation was finalized.
        (own.is_closed, own.restarted) = (is_closed, own.restarted && opened <= own.born);
        own.look_up();
        self.forest.on_goal();
        self.planner.on_goal();
        self.attraction.on_goal();
        self.called = None;
        self.surveyor.reset(now);
        self.invalidate();
    }

    /// Checks whether a module in reserve may leave the body, as far as it knows: it is attached, or at the end of a
    /// branch, no other module holds a lock on it, and no neighbour hangs on it. Walkers grant no locks, and a module that grants
    /// one gives up its own attempt: so a module that moves has promised no other to stay, and it is enough to look at the locks at launch.
    fn may_leave(&self, now: Time) -> Result<(), Held> {
        let v = self.view(now);
        let is_free = self.forest.is_attached(v) || self.forest.is_end(v);
        if !is_free || v.is_quarantined() || v.may_be_final() {
            return Err(Held(None));
        }
        let holder = self.locks.holder(now).filter(|_| !v.has(Defect::IgnoreLocks));
        holder.map_or(Ok(()), |origin| Err(Held(Some(origin))))?;
        self.forest.may_leave(v)
    }

    /// Brings all that depends on time and on messages up to date, and plans the next wake-up.
    fn step(&mut self, now: Time) {
        if self.locks.expire(now) {
            hit(CoveragePoint::CubeLockExpired);
            self.beacons.invalidate();
            self.decide_soon(now);
        }
        if self.moving.is_none()
            && let Some(opening) = self.next_epoch.take()
        {
            self.follow_epoch(now, *opening);
        }
        self.tend_call(now);
        self.take_root(now);
        self.finalize_if_wanted(now);
        self.tend_forest(now);
        let v = View { now, own: &self.own, sides: &self.sides };
        let tended = self.attraction.tend(v);
        if tended.changed != 0 {
            self.beacons.invalidate_faces(beside_any(tended.changed));
        }
        self.wanted = tended.wanted;
        let is_final = |f: &Face| v.support(*f).is_some_and(|b| v.is_final(b));
        self.finals = Face::mask(Face::in_mask(v.sides.support_mask()).filter(is_final));
        self.filled = self.finals | (v.sides.certified_mask() & v.own.masks.cells);
        self.tend_attempt(now);
        self.repeat_for_others(now);
        if now >= self.planner.decide_at {
            self.decide(now);
        }
        self.tend_beacons(now);
        self.tend_report(now);
        let next = Timer::ALL.into_iter().map(|timer| self.due(timer, now)).min();
        // Never now: all that was due has been done, so this cannot loop without progress.
        self.wake = next.unwrap_or(Time::NEVER).max(now + Span(1));
    }

    /// Returns true if this is a walker that another one rests on, or that has rested for long and hears of no target. It takes
    /// a place in the forest, so that it carries others and passes distances on.
    fn parks(&self, now: Time) -> bool {
        let rests = || {
            now.since(self.own.settled) > self.own.params().parks_after()
                && !self.own.masks.own
                && !self.surveyor.is_surveying()
                && !self.is_attracted(now)
        };
        self.own.role == Role::Walker
            && self.is_idle()
            && self.called.is_none()
            && (self.is_ridden() || rests())
    }

    fn tend_forest(&mut self, now: Time) {
        let (is_idle, v) = (self.is_idle(), View { now, own: &self.own, sides: &self.sides });
        let is_fixed = self.forest.tend_fixed(v);
        let effect = match v.own.connectivity() {
            Connectivity::Forest => self.forest.tend(v, is_idle, self.parks(now), &mut self.tokens),
            // With cycles the gradient only tells which modules are farther out, and should leave first.
            Connectivity::Gradient | Connectivity::Cycles => self.forest.tend_gradient(v),
        };
        let parks = v.own.connectivity() == Connectivity::Cycles && self.parks(now);
        let is_news = self.forest.tend_custody(v, self.moving.is_some());
        let is_parked = self.own.role == Role::Walker && (self.forest.parent().is_some() || parks);
        if is_parked {
            hit(CoveragePoint::CubeParked);
            (self.own.role, self.own.support) = (Role::Reserve, None);
            self.surveyor.settle(now);
        }
        if effect != Effect::None || is_news || is_parked || is_fixed {
            self.invalidate();
        }
        if effect == Effect::TellAndDecide || is_fixed {
            self.decide_soon(now);
        }
    }

    /// Returns when the event of a timer is due.
    fn due(&self, timer: Timer, now: Time) -> Time {
        match timer {
            Timer::Decision => self.planner.decide_at,
            Timer::Answers => self.attempt.as_ref().map_or(Time::NEVER, |a| a.timeout),
            Timer::Beacon => self.beacons_due(),
            Timer::Field => self.attraction.expires(),
            Timer::Refresh if self.wanted != 0 => attraction::next_refresh(self.view(now)),
            Timer::Quarantine if self.own.is_quarantined(now) => self.own.quarantine_until,
            Timer::Refresh | Timer::Quarantine => Time::NEVER,
            Timer::Lease => self.locks.next_expiry(),
            Timer::Call => self.call_ends().unwrap_or(Time::NEVER),
            Timer::Repeat => self.retransmission.due().min(self.relays.due()),
        }
    }
}
