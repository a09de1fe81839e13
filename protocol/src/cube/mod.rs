//! The cube: a module of the sliding-cube model with local messages only.
//!
//! Growth after Stoy (thesis 4.1.2) made safe for late, lost and doubled messages and for crashes:
//!
//! * `beacon` — everything a module tells its neighbours, as soft state;
//! * `field` — attraction towards unfilled goal cells, kept on faces of empty surface cells;
//! * `forest`, `cycles` — the connectivity checks;
//! * `negotiation` — locks and reservations along routes, with leases;
//! * `motion` — where to go, and going there.
//!
//! Deliberately absent: any knowledge of the world beyond contacts, messages and the own cell.

mod beacon;
pub mod body;
pub mod control;
mod cycles;
mod digest;
mod field;
mod forest;
pub mod message;
mod motion;
mod negotiation;
pub mod params;
pub mod route;

use crate::agent::{Agent, Birth, Class, Input, InputOf, Output, OutputOf};
use crate::goal::Goal;
use crate::ids::{Incarnation, ModuleId, Port, Session, Token};
use crate::journal::Summary;
use crate::lattice::{Cell, Face};
use crate::marks::{Mark, hit};
use crate::sabotage::Sabotage;
use crate::stream::Stream;
use crate::time::{Span, Time};
use body::{Move, Percept};
use control::{Order, Status};
use field::FaceField;
use message::{Beacon, Message, Rank, Role};
use motion::{Moving, Target};
use negotiation::{Attempt, Lock};
use params::{Connectivity, Setup};
use std::collections::VecDeque;
use std::hash::{Hash, Hasher};
use std::ops::Deref;
use std::sync::Arc;

/// The label of a module without a parent.
const UNLABELLED: u16 = u16::MAX;
/// The rank of whoever has never had a parent: everybody may be it.
const UNRANKED: Rank = Rank { rooted: Time::ZERO, label: UNLABELLED };

/// The shared setup; it never changes, so it is no part of an agent's state.
#[derive(Clone, Debug)]
struct Shared(Arc<Setup>);

impl Deref for Shared {
    type Target = Setup;
    fn deref(&self) -> &Setup {
        &self.0
    }
}
impl PartialEq for Shared {
    fn eq(&self, other: &Shared) -> bool {
        Arc::ptr_eq(&self.0, &other.0) || self.0 == other.0
    }
}
impl Eq for Shared {}
impl Hash for Shared {
    fn hash<H: Hasher>(&self, _: &mut H) {}
}

/// The last beacon of a neighbour.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Peer {
    beacon: Beacon,
    heard: Time,
}

/// Where following the attraction field leads from a face.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Successor {
    /// To another face of the same module.
    Own(Face),
    /// Along the neighbour in this direction: to its face of the same name or, if a further module
    /// stands out from it and touches the same cell, to that one's.
    Beside {
        /// Where the neighbour is.
        heading: Face,
        /// Whether a further module touches the same cell.
        same_cell: bool,
    },
}

/// Everything a module keeps per face.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Side {
    session: Option<Session>,
    /// The neighbour, once it has been heard in this session.
    peer: Option<Peer>,
    /// The neighbour is certified dead.
    condemned: bool,
    /// The goal in which it is certified to have been finalized, as it may never have been heard itself.
    died_final: Option<u16>,
    /// The neighbour is a registered child.
    child: Option<Token>,
    field: FaceField,
    /// Directions in which the corner over this face was found blocked, and until when to mind.
    corners: u8,
    corners_until: Time,
    /// The last beacon sent in this session.
    sent: Option<Beacon>,
    sent_at: Time,
    sequence: u32,
    /// Something may have changed since.
    stale: bool,
    /// When news that can wait is sent.
    later: Option<Time>,
    /// Since when the goal cell outside has been unfilled, as seen by a finalized module.
    unfilled_since: Option<Time>,
}

impl Side {
    fn new() -> Side {
        Side {
            session: None,
            peer: None,
            condemned: false,
            died_final: None,
            child: None,
            field: FaceField::new(),
            corners: 0,
            corners_until: Time::ZERO,
            sent: None,
            sent_at: Time::ZERO,
            sequence: 0,
            stale: true,
            later: None,
            unfilled_since: None,
        }
    }

    /// Starts a session, or none; forgets all that belonged to the one before.
    fn begin(&mut self, session: Option<Session>) {
        self.session = session;
        self.peer = None;
        self.condemned = false;
        self.died_final = None;
        self.child = None;
        self.sent = None;
        self.sequence = 0;
        self.stale = true;
        self.later = None;
    }
}

/// The agent of one cube.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Cube {
    setup: Shared,
    id: ModuleId,
    cell: Cell,
    settled: Time,
    epoch: u16,
    role: Role,
    sides: [Side; 6],
    /// The place in the parent forest; without a parent, what a parent's has to be better than.
    rank: Rank,
    /// Neighbours are asked for ways to the finalized modules that are known anew, no earlier than this;
    /// zero if none is needed.
    renew: Time,
    parent: Option<Face>,
    /// The neighbour asked to be the next parent.
    want: Option<(Face, Token)>,
    /// The neighbour that made this module finalized.
    activator: Option<Face>,
    /// The support a walker hangs on.
    anchor: Option<Face>,
    attempt: Option<Attempt>,
    moving: Option<Moving>,
    /// A goal heard of during a move, taken up after it.
    next_epoch: Option<u16>,
    locks: Vec<Lock>,
    /// Searches seen lately, so that each is passed on once.
    searches: VecDeque<message::RequestId>,
    stream: Stream,
    tokens: u32,
    decide_at: Time,
    back_off_until: Time,
    /// Since when this module has been wanting to move.
    waiting_since: Option<Time>,
    waits_for: Option<ModuleId>,
    patience: u16,
    /// Attempts that failed in a row.
    denied: u8,
    /// Actions of the body that failed in a row.
    failed: u8,
    immobile: bool,
    /// How often a reservation was turned down because somebody else had the cell.
    prevented: u32,
    reborn: bool,
    quarantine_until: Time,
    corners_seen: [u8; 6],
    /// Targets heard of while in reserve.
    targets: Vec<Target>,
    /// Since it has heard of no target, as a walker.
    roaming: Option<motion::Roaming>,
    reported: Option<Status>,
    reported_at: Time,
    field_stale: bool,
    wake: Time,
    out: VecDeque<OutputOf<Cube>>,
}

impl Agent for Cube {
    type Setup = Setup;
    type Place = Cell;
    type Message = Message;
    type Action = Move;
    type Percept = Percept;
    type Order = Order;
    type Report = Status;

    const PORTS: usize = 6;

    fn new(setup: &Arc<Setup>, birth: Birth<Cell>, now: Time) -> Cube {
        let reborn = birth.incarnation > Incarnation(0);
        Cube {
            setup: Shared(Arc::clone(setup)),
            id: birth.id,
            cell: birth.place,
            settled: now,
            epoch: 0,
            role: Role::Reserve,
            sides: std::array::from_fn(|_| Side::new()),
            // Whoever an earlier life carried may still hang on this module: only a way that is known
            // anew since certainly does not lead over it.
            rank: if reborn { Rank { rooted: now, label: 0 } } else { UNRANKED },
            renew: Time::ZERO,
            parent: None,
            want: None,
            activator: None,
            anchor: None,
            attempt: None,
            moving: None,
            next_epoch: None,
            locks: Vec::new(),
            searches: VecDeque::new(),
            stream: Stream::named(
                birth.seed,
                "cube",
                u64::from(birth.id.0) << 16 | u64::from(birth.incarnation.0),
            ),
            // Tokens of earlier lives may still be under way.
            tokens: u32::from(birth.incarnation.0) << 20,
            decide_at: now,
            back_off_until: now,
            waiting_since: None,
            waits_for: None,
            patience: 0,
            denied: 0,
            failed: 0,
            immobile: false,
            prevented: 0,
            reborn,
            quarantine_until: if reborn && setup.params.sabotage != Some(Sabotage::NoListening) {
                now + setup.params.quarantine
            } else {
                now
            },
            corners_seen: [0; 6],
            targets: Vec::new(),
            roaming: None,
            reported: None,
            reported_at: now,
            field_stale: true,
            wake: now,
            out: VecDeque::new(),
        }
    }

    fn handle(&mut self, now: Time, input: InputOf<Cube>) {
        match input {
            Input::Contact { port, session } => self.on_contact(now, port, session),
            Input::Message { port, message } => {
                if let Some(face) = Face::from_index(port.0).filter(|f| self.side(*f).session.is_some()) {
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
        self.out.pop_front()
    }

    fn wake_at(&self) -> Time {
        self.wake
    }

    fn digest(&self, hasher: &mut dyn Hasher) {
        self.digest_state(hasher);
    }

    fn summary(&self, now: Time) -> Summary {
        let role = match self.role {
            Role::Reserve => "reserve",
            Role::Walker => "walker",
            Role::Final => "final",
        };
        let nearest = self.sides.iter().map(|s| s.field.value().distance).min();
        let keeps = |l: &&Lock| l.id.origin != self.id;
        Summary {
            role: role.to_owned(),
            activity: self.activity(now).to_owned(),
            goal: self.epoch,
            level: Some(self.label()).filter(|l| *l != UNLABELLED),
            gradient: nearest.filter(|d| *d != message::Entry::FAR).map(u32::from),
            lock: self.locks.iter().find(keeps).map(|l| l.id.origin),
            waits_for: self.waits_for,
        }
    }
}

impl Cube {
    fn side(&self, face: Face) -> &Side {
        &self.sides[face.index()]
    }
    fn side_mut(&mut self, face: Face) -> &mut Side {
        &mut self.sides[face.index()]
    }
    /// Whether a test has switched this defect on.
    fn has(&self, defect: Sabotage) -> bool {
        self.setup.params.sabotage == Some(defect)
    }
    fn goal(&self) -> &Goal {
        // Invariant: epochs are only taken up if there is a goal for them, and there is a first goal.
        &self.setup.goals[usize::from(self.epoch)]
    }

    /// The neighbour on a face, if it has been heard in this session.
    fn peer(&self, face: Face) -> Option<&Beacon> {
        self.side(face).peer.as_ref().map(|p| &p.beacon)
    }

    /// The neighbour on a face, if it is believed alive.
    fn live(&self, now: Time, face: Face) -> Option<&Beacon> {
        let side = self.side(face);
        let peer = side.peer.as_ref()?;
        let silent = now.since(peer.heard) > self.setup.params.suspect;
        (!silent && !side.condemned).then_some(&peer.beacon)
    }

    /// The neighbour on a face, if it is a live module that can carry a walker.
    fn terrain(&self, now: Time, face: Face) -> Option<&Beacon> {
        self.live(now, face).filter(|b| b.role != Role::Walker)
    }

    /// Whether the cell outside a face can hold a walker: it is empty, or holds one that moves on.
    fn is_open(&self, now: Time, face: Face) -> bool {
        self.side(face).session.is_none()
            || self.live(now, face).is_some_and(|b| b.role == Role::Walker && !b.immobile)
    }

    fn is_idle(&self) -> bool {
        self.attempt.is_none() && self.moving.is_none()
    }
    fn is_quarantined(&self, now: Time) -> bool {
        now < self.quarantine_until
    }

    fn token(&mut self) -> Token {
        // The largest one is set apart for claims to a parent.
        self.tokens = self.tokens.checked_add(1).filter(|t| *t != u32::MAX).unwrap_or(0);
        Token(self.tokens)
    }

    fn send(&mut self, face: Face, class: Class, message: Message) {
        if self.side(face).session.is_some() {
            self.out.push_back(Output::Send { port: Port(face as u8), class, message });
        }
    }

    /// The module in the seed cell is finalized from the start, in every life: everything else
    /// grows from there.
    fn take_root(&mut self, now: Time) {
        if self.is_root() && self.role != Role::Final && self.moving.is_none() && !self.is_quarantined(now) {
            self.abort_attempt(now, None);
            self.become_final(None);
        }
    }

    fn become_final(&mut self, activator: Option<Face>) {
        self.role = Role::Final;
        self.activator = activator;
        self.rank.label = 0;
        self.renew = Time::ZERO;
        self.parent = None;
        self.want = None;
        self.anchor = None;
        self.waiting_since = None;
        self.waits_for = None;
        self.touch();
    }

    /// Everything may look different now.
    fn touch(&mut self) {
        self.field_stale = true;
        for side in &mut self.sides {
            side.stale = true;
        }
    }

    fn on_contact(&mut self, now: Time, port: Port, session: Option<Session>) {
        let Some(face) = Face::from_index(port.0) else { return };
        if self.side(face).session == session {
            return;
        }
        let lost = self.peer(face).map(|b| b.id);
        self.side_mut(face).begin(session);
        if session.is_none() {
            // Nothing touches this face any more. A restarted neighbour is a new session instead,
            // and what hangs on it stays so.
            if self.parent == Some(face) {
                hit(Mark::CubeParentLost);
                self.parent = None;
                self.rank.label = 0;
            }
            self.activator = self.activator.filter(|f| *f != face);
            self.anchor = self.anchor.filter(|f| *f != face);
            // What a restarted neighbour was granted stays until the lease is up: the body may be on
            // its way.
            if let Some(id) = lost {
                if self.locks.iter().any(|lock| lock.id.origin == id) {
                    hit(Mark::CubeReleasedByLoss);
                }
                self.release_locks(|lock| lock.id.origin == id);
            }
        }
        self.want = self.want.filter(|(f, _)| *f != face);
        if self.role == Role::Reserve && self.setup.params.connectivity == Connectivity::Cycles {
            // Whoever has come may hang on this module alone, and nobody has asked it.
            self.abort_attempt(now, None);
        }
        self.touch();
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
                self.release_locks(|lock| lock.id.origin == origin && lock.id.token == token);
                self.decide_soon(now);
            }
            Message::Search { id, ttl, route } => self.on_search(now, face, id, ttl, route),
            Message::Found { id, hop, back, route } => self.on_found(now, face, id, hop, back, route),
        }
    }

    fn on_order(&mut self, now: Time, order: Order) {
        match order {
            Order::Goal { epoch } => self.follow_epoch(now, epoch),
            Order::Condemn { port, session, epoch, finalized } => {
                self.follow_epoch(now, epoch);
                if let Some(face) = Face::from_index(port.0)
                    && self.side(face).session == Some(session)
                {
                    let side = self.side_mut(face);
                    side.condemned = true;
                    side.died_final = finalized.then_some(epoch);
                    if self.died_finalized(face) {
                        self.side_mut(face).child = None;
                    }
                    self.touch();
                    self.decide_soon(now);
                }
            }
        }
    }

    /// Takes up a later goal. All modules start over in reserve, unattached; until they are attached
    /// again nobody leaves, so the body is as safe as at the start of a run.
    fn follow_epoch(&mut self, now: Time, epoch: u16) {
        if epoch <= self.epoch || usize::from(epoch) >= self.setup.goals.len() {
            return;
        }
        if self.moving.is_some() {
            hit(Mark::CubeEpochAfterMove);
            self.next_epoch = self.next_epoch.max(Some(epoch));
            return;
        }
        self.abort_attempt(now, None);
        self.epoch = epoch;
        self.role = Role::Reserve;
        self.rank = if self.rank.rooted > Time::ZERO { Rank { label: 0, ..self.rank } } else { UNRANKED };
        self.renew = Time::ZERO;
        self.parent = None;
        self.want = None;
        self.activator = None;
        self.anchor = None;
        self.patience = 0;
        self.waiting_since = None;
        self.roaming = None;
        for side in &mut self.sides {
            side.child = None;
            side.unfilled_since = None;
            side.field = FaceField::new();
        }
        self.touch();
    }

    /// Registered children.
    pub fn children(&self) -> usize {
        self.sides.iter().filter(|s| s.child.is_some()).count()
    }

    /// Brings everything that depends on time and on what was heard up to date, and plans the next
    /// wake-up.
    fn step(&mut self, now: Time) {
        self.expire_locks(now);
        if self.moving.is_none()
            && let Some(epoch) = self.next_epoch.take()
        {
            self.follow_epoch(now, epoch);
        }
        self.take_root(now);
        self.finalize_if_wanted(now);
        match self.setup.params.connectivity {
            Connectivity::Forest => self.tend_forest(now),
            // With cycles the gradient only tells who is farther out, and should leave first.
            Connectivity::Gradient | Connectivity::Cycles => self.tend_gradient(now),
        }
        self.tend_field(now);
        self.tend_attempt(now);
        if now >= self.decide_at {
            self.decide(now);
        }
        self.tend_beacons(now);
        self.tend_report(now);
        self.wake = self.next_wake(now);
    }

    fn next_wake(&self, now: Time) -> Time {
        let p = &self.setup.params;
        let mut wake = self.decide_at;
        if let Some(attempt) = &self.attempt {
            wake = wake.min(attempt.timeout);
        }
        for side in self.sides.iter().filter(|s| s.session.is_some()) {
            let again = if side.stale { p.advertise } else { p.heartbeat };
            wake = wake.min(side.sent_at + again).min(side.later.unwrap_or(Time::NEVER));
        }
        for side in &self.sides {
            wake = wake.min(side.field.expires(p.hold));
        }
        if self.wanted_faces(now).next().is_some() {
            wake = wake.min(self.next_refresh(now));
        }
        if let Some(lock) = self.locks.iter().map(|l| l.expires).min() {
            wake = wake.min(lock);
        }
        if self.is_quarantined(now) {
            wake = wake.min(self.quarantine_until);
        }
        // Never now: whatever was due has been done, so this cannot spin.
        wake.max(now + Span(1))
    }

    /// The module's part in the growth.
    pub fn role(&self) -> Role {
        self.role
    }
    /// The module's cell, as it believes.
    pub fn cell(&self) -> Cell {
        self.cell
    }
    /// Depth in the parent forest; 65,535 without a parent.
    pub fn label(&self) -> u16 {
        self.told_rank().label
    }
    /// The place in the parent forest; without a parent, what a parent's has to be better than.
    pub fn rank(&self) -> Rank {
        self.rank
    }
    /// The face behind which the parent is.
    pub fn parent(&self) -> Option<Face> {
        self.parent
    }
    /// Whether the neighbour on a face is a registered child.
    pub fn has_child(&self, face: Face) -> bool {
        self.side(face).child.is_some()
    }
    /// Whether the neighbour on a face has been heard in this contact session.
    pub fn has_heard(&self, face: Face) -> bool {
        self.side(face).peer.is_some()
    }
    /// Whether the module has asked its body to move and has not heard how it went.
    pub fn is_moving(&self) -> bool {
        self.moving.is_some()
    }
    /// The session the module believes to have on a face.
    pub fn session(&self, face: Face) -> Option<Session> {
        self.side(face).session
    }
    /// The goal the module works for.
    pub fn epoch(&self) -> u16 {
        self.epoch
    }
    /// The field value of a face, where following it leads, and when its version was first heard of.
    pub fn attraction(&self, face: Face) -> (message::Entry, Option<Successor>, Time) {
        let field = &self.side(face).field;
        let (heading, kind) = (Face::from_index(field.via() % 6), field.via() / 6 * 6);
        let successor = heading.and_then(|heading| match kind {
            0 => Some(Successor::Beside { heading, same_cell: false }),
            beacon::OWN => Some(Successor::Own(heading)),
            beacon::SAME_CELL => Some(Successor::Beside { heading, same_cell: true }),
            _ => None,
        });
        (field.value(), successor, field.heard())
    }
    /// Since when the module has been at its cell with its memory.
    pub fn settled(&self) -> Time {
        self.settled
    }
    /// What the module is busy with, for people.
    pub fn activity(&self, now: Time) -> &'static str {
        match self.role {
            Role::Final => "finalized",
            _ if self.immobile => "immobile",
            _ if self.moving.is_some() => "moving",
            _ if self.attempt.is_some() => "asking",
            _ if self.is_quarantined(now) => "listening",
            _ if now < self.back_off_until => "backing off",
            Role::Reserve if self.may_leave(now).is_err() => "holding",
            _ if self.waits_for.is_some() => "waiting",
            _ => "idle",
        }
    }
    /// Until when the module stays because of a lock of `origin`.
    pub fn locked_for(&self, origin: ModuleId) -> Option<Time> {
        self.locks.iter().filter(|l| l.id.origin == origin).map(|l| l.expires).max()
    }
    /// Whether the module has restarted and is still listening.
    pub fn is_listening(&self, now: Time) -> bool {
        self.is_quarantined(now)
    }
    /// Whether the module has restarted and cannot know what it was before.
    pub fn has_restarted(&self) -> bool {
        self.reborn
    }
    /// Whether the module has no place in the parent forest.
    pub fn is_unlabelled(&self) -> bool {
        self.label() == UNLABELLED
    }
    /// The connectivity check in use.
    pub fn connectivity(&self) -> Connectivity {
        self.setup.params.connectivity
    }
    /// Faces outside which the cell is kept free, and for whom.
    pub fn reservations(&self) -> Vec<(Face, ModuleId)> {
        self.locks.iter().filter_map(|l| l.reserved.map(|f| (f, l.id.origin))).collect()
    }
    /// Whether the module stands where its goal begins.
    pub fn is_root(&self) -> bool {
        self.cell == self.goal().seed()
    }
    /// The finalized neighbour that made this module finalized; none for the seed.
    pub fn activator(&self) -> Option<Face> {
        self.activator
    }
}
