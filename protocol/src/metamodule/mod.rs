//! The metamodule's protocol: the thesis's experiment (4.1.3) as a sans-IO agent.
//!
//! A metamodule is two Roombots modules with two ends that can grip. It stands on one connector of
//! the floor, knows its absolute position, hears others within [`params::Params::hearing`], and learns from
//! the world-controller (or from its neighbours) which seeds are open. It chooses the landing that the
//! force field likes best (`choice`, `field`), locks the cells of the whole motion with everybody in
//! hearing, does it step by step, grips, lets go, tells where it is, and starts again. On an open
//! seed's connector it takes the seed's shape and stays.
//!
//! *Safety.* A lock is granted by every neighbour in hearing or not at all; nobody waits for one while
//! it holds another. Grants end by themselves, after the holder's own time is up, and the body does
//! not begin what it is asked to begin too late. The interlock of the body is below all that.
//!
//! *Progress* is not promised by the strategies of the thesis: the force field has local minima, and
//! that is what the experiment measures. `negotiated` has no field; what it promises is in
//! `docs/negotiated.md`. Deliberately absent: gripping other metamodules; walls.

pub mod blueprint;
mod detector;
mod digest;
mod lead;
pub mod message;
pub mod motions;
mod negotiation;
mod neighbour_table;
pub mod params;
pub mod planning;
pub mod pose;
mod precedence;
pub mod start;
pub mod strategy;

use crate::agent::Summary;
use crate::agent::{Agent, Birth, Input, InputOf, Output, OutputOf};
use crate::counters::Class;
use crate::coverage::{Mark, hit};
use crate::defects::Sabotage;
use crate::ids::{ModuleId, Port, Token};
use crate::lattice::Cell;
use crate::metamodule::neighbour_table::{Grant, Peer, Peers};
use crate::metamodule::planning::paths::{Course, Ground};
use crate::metamodule::strategy::greedy_policy::{Aim, Plan, View, middle};
use crate::rng::Stream;
use crate::time::{Span, Time};
use blueprint::{Blueprint, SeedSet, Task};
use detector::Watch;
use lead::Lead;
use message::{Action, Deed, Denial, Message, Order, Percept, Rank, Refusal, State, Status};
use motions::Sweep;
use negotiation::Intent;
use params::{Setup, Strategy, Teller};
use pose::Pose;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::hash::{Hash, Hasher};
use std::sync::Arc;

/// After so many failures in a row an action is given up for now.
const TRIES: u8 = 5;

/// What the metamodule is about.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Phase {
    /// Nothing. It looks for something to do at this time, or earlier if it hears something new.
    Idle { look_at: Time },
    /// Waiting for answers of these ports to its request.
    Asking { plan: Plan, pending: u32, asked: Time, again: Time },
    /// In motion, up to the step `next`; the lock holds until `until`.
    Moving { plan: Plan, next: usize, tries: u8, until: Time },
}

/// All that changes in an agent.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Core {
    id: ModuleId,
    pose: Pose,
    peers: Peers,
    /// Bodies without a living process.
    dead: BTreeMap<ModuleId, Pose>,
    /// Cells with something foreign in them.
    obstacles: BTreeSet<Cell>,
    task: Task,
    open: SeedSet,
    filled: SeedSet,
    settled: Option<u8>,
    /// Where it means to go next.
    course: Course,
    /// What it is about, under `negotiated`.
    intent: Intent,
    /// What it leads, and who leads it, under `negotiated`.
    lead: Lead,
    /// Its joints have not turned when they should; not before this time they are tried again.
    stuck: Option<Time>,
    phase: Phase,
    token: Token,
    /// Since when it has not got on; those who have waited longer go first.
    waiting_since: Time,
    /// Not before this time it looks for something to do.
    rest_until: Time,
    /// Until then a restarted agent asks and grants nothing: it may have granted something.
    quarantine: Time,
    repeat_at: Time,
    sequence: u32,
    prevented: u32,
    waits_for: Option<ModuleId>,
    reported: Option<Status>,
    watch: Watch,
    chance: Stream,
}

/// What a lock is asked for.
struct Asked {
    rank: Rank,
    age: Span,
    origin: ModuleId,
    pose: Pose,
    sweep: Sweep,
}

/// A metamodule's agent.
#[derive(Clone, Debug)]
pub struct Metamodule {
    setup: Arc<Setup>,
    core: Core,
    out: VecDeque<OutputOf<Metamodule>>,
}

/// All of its state, unlike [`Agent::digest`]: two that hash alike do the same from now on.
impl Hash for Metamodule {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.core.hash(state);
    }
}

impl Metamodule {
    /// Where it believes to be.
    pub fn pose(&self) -> Pose {
        self.core.pose
    }
    /// The seed it fills.
    pub fn settled(&self) -> Option<u8> {
        self.core.settled
    }
    /// The cells that it holds a lock on, for audits; none while it holds no lock.
    pub fn held(&self, now: Time) -> impl Iterator<Item = Cell> + '_ {
        let plan = match &self.core.phase {
            Phase::Moving { plan, until, .. } if now <= *until => Some(plan),
            _ => None,
        };
        plan.into_iter().flat_map(|plan| self.setup.motions.swept(plan.from.state, plan.sweep))
    }
    /// Until when the lock holds that its motion rests on, for audits; none while it does not move.
    pub fn locked_until(&self) -> Option<Time> {
        match &self.core.phase {
            Phase::Moving { until, .. } => Some(*until),
            _ => None,
        }
    }

    /// Whether a test has switched this defect on.
    fn has(&self, defect: Sabotage) -> bool {
        self.setup.params.sabotage == Some(defect)
    }

    fn broadcast(&mut self, class: Class, message: Message) {
        for (port, _) in self.core.peers.iter() {
            self.out.push_back(Output::Send { port, class, message });
        }
    }

    fn state(&mut self) -> Message {
        let c = &mut self.core;
        c.sequence += 1;
        Message::State(State {
            id: c.id,
            sequence: c.sequence,
            pose: c.pose,
            settled: c.settled.is_some(),
            stuck: c.stuck.is_some(),
            blocked: c.intent.is_cornered(),
            task: c.task,
            filled: c.filled,
            claim: c.intent.claim,
            unreachable: c.intent.barred,
        })
    }

    fn tell(&mut self, now: Time, class: Class) {
        self.core.repeat_at = now + self.setup.params.repeat;
        let state = self.state();
        self.broadcast(class, state);
    }

    /// What is built, unmoved.
    fn goal(&self) -> &Blueprint {
        self.setup.goal(self.core.task)
    }

    fn open(&self) -> SeedSet {
        let c = &self.core;
        match self.setup.params.teller {
            Teller::Controller => c.open.without(c.filled),
            Teller::Neighbours => self.goal().open(c.filled),
        }
    }

    /// The seed of the task whose cells whoever stands like this fills.
    fn fits(&self, pose: Pose) -> Option<u8> {
        let cells = self.setup.motions.cells(pose);
        Some(self.setup.seeds(self.core.task).find(|(_, seed)| seed.cells() == cells)?.0)
    }

    /// What the dead fill stays filled, and they cannot say so themselves.
    fn count_dead(&mut self) {
        let filled = self.core.dead.values().filter_map(|pose| self.fits(*pose));
        self.core.filled = filled.fold(self.core.filled, SeedSet::with);
    }

    /// Something else is to be built from now on.
    fn take_task(&mut self, now: Time, task: Task) {
        if task.epoch <= self.core.task.epoch {
            return;
        }
        self.core.task = task;
        (self.core.open, self.core.filled) = (SeedSet::default(), SeedSet::default());
        self.withdraw();
        self.lead_afresh();
        let settled = self.core.settled.take().and_then(|_| self.fits(self.core.pose));
        if let Some(seed) = settled {
            self.core.settled = settled;
            hit(Mark::MetaStaysForNewTask);
            self.core.filled = self.core.filled.with(seed);
        }
        self.count_dead();
        self.core.waiting_since = now;
        self.tell(now, Class::Gradient);
        self.look_again(now);
    }

    /// Something new is known: whoever has nothing to do looks again.
    fn look_again(&mut self, now: Time) {
        let rest = self.core.rest_until;
        if let Phase::Idle { look_at } = &mut self.core.phase {
            *look_at = (*look_at).min(now.max(rest));
        }
    }

    /// Whether a neighbour stays where it is while the task is what it is. Before it leaves for another
    /// task, it asks us; two of whom each takes the other for settled in an old one would both not ask.
    fn stays(&self, state: &State) -> bool {
        state.settled && state.task == self.core.task
    }

    /// Whether somebody in hearing has said nothing yet and need not be dead. However long it says nothing,
    /// it may be about to move, and would not be asked. Of the dead it is known where they are.
    fn is_anybody_strange(&self) -> bool {
        let core = &self.core;
        let strangers = core.peers.iter().filter(|(_, p)| p.state.is_none()).count();
        let foot = core.pose.foot();
        let hears = |p: &Pose| {
            let at = p.foot();
            at.0.abs_diff(foot.0).max(at.1.abs_diff(foot.1)) <= self.setup.params.hearing
        };
        let is_known = |id: ModuleId| core.peers.iter().any(|(_, p)| p.state.is_some_and(|s| s.id == id));
        strangers > core.dead.iter().filter(|(id, pose)| hears(pose) && !is_known(**id)).count()
    }

    fn is_dead(&self, peer: &Peer) -> bool {
        peer.state.is_some_and(|s| self.core.dead.contains_key(&s.id))
    }

    /// Looks for something to do.
    fn look(&mut self, now: Time) {
        let next_expiry = self.core.peers.expire(now);
        let idle = |look_at| Phase::Idle { look_at };
        if self.core.settled.is_some() {
            self.core.phase = idle(Time::NEVER);
            return;
        }
        if now < self.core.quarantine {
            self.core.phase = idle(self.core.quarantine);
            return;
        }
        if let Some(seed) = self.fits(self.core.pose).filter(|s| self.core.filled.has(*s)) {
            // It is known to be filled, and nobody else can be in its cells: an earlier life did it.
            hit(Mark::MetaEarlierLifeSettled);
            self.core.settled = Some(seed);
            self.withdraw();
            self.stop_leading();
            self.core.phase = idle(Time::NEVER);
            return self.tell(now, Class::Gradient);
        }
        if self.core.pose.both {
            // An earlier life has gripped and not let go. Letting go sweeps nothing.
            hit(Mark::MetaEarlierLifeGripped);
            let from = self.core.pose;
            let (steps, sweep, ends) = (Vec::new(), Sweep::default(), from.posture);
            let plan = Plan { from, steps, sweep, ends, aim: Aim::Land, harmless: false };
            return self.begin(now, now, plan);
        }
        if self.is_anybody_strange() {
            self.core.phase = idle(Time::NEVER);
            return;
        }
        if let Some(again) = self.core.stuck {
            self.core.phase = idle(again);
            if now >= again {
                hit(Mark::MetaJointsTried);
                self.try_joints(now);
            }
            return;
        }
        match self.setup.params.strategy {
            Strategy::Negotiated => self.negotiate(now, next_expiry),
            _ => self.follow_field(now, next_expiry),
        }
    }

    /// Looks for something to do by the force field.
    fn follow_field(&mut self, now: Time, next_expiry: Time) {
        let motions = &self.setup.motions;
        let (mut fixed, mut moving) = (self.fixed(), Vec::new());
        let (mut feet, mut neighbours) = (Vec::new(), Vec::new());
        feet.extend(self.core.dead.values().map(|p| p.foot()));
        for (_, peer) in self.core.peers.iter() {
            let Some(state) = peer.state else { continue };
            feet.push(state.pose.foot());
            let dead = self.core.dead.contains_key(&state.id);
            let fixes = self.stays(&state) || dead;
            if fixes {
                fixed.extend(motions.cells(state.pose));
            } else {
                moving.extend(motions.cells(state.pose));
            }
            if !fixes || (self.setup.params.settled_repel && !dead) {
                neighbours.push(middle(motions, state.pose));
            }
        }
        if let Some(first) = self.goes_before(&fixed) {
            // That one tells when it has moved, settled or got stuck, which starts a new look here.
            hit(Mark::MetaLetFirst);
            self.core.waits_for = Some(first);
            self.core.phase = Phase::Idle { look_at: next_expiry };
            return;
        }
        moving.extend(self.core.peers.granted(motions));
        let taken = [&fixed[..], &moving].concat();
        let view = View {
            setup: &self.setup,
            task: self.core.task,
            pose: self.core.pose,
            open: self.open(),
            ground: &Ground { motions, floor: self.setup.floor, taken: &taken },
            fixed: &fixed,
            feet: &feet,
            neighbours: &neighbours,
        };
        match view.choose() {
            Some(plan) => self.ask(now, plan),
            // A grant that runs out may open a way; everything else that may is heard.
            None => {
                self.core.waits_for = None;
                self.core.phase = Phase::Idle { look_at: next_expiry };
            }
        }
    }

    /// Cells of the dead and of what is foreign.
    fn fixed(&self) -> Vec<Cell> {
        let dead = self.core.dead.values().flat_map(|p| self.setup.motions.cells(*p));
        self.core.obstacles.iter().copied().chain(dead).collect()
    }

    /// Tries whether the joints turn again, by any step that is free.
    fn try_joints(&mut self, now: Time) {
        let motions = &self.setup.motions;
        let mut taken = self.fixed();
        taken.extend(self.core.peers.iter().filter_map(|(_, p)| p.state).flat_map(|s| motions.cells(s.pose)));
        taken.extend(self.core.peers.granted(motions));
        let ground = Ground { motions, floor: self.setup.floor, taken: &taken };
        let pose = self.core.pose;
        let free = |at: Pose| motions.graph().neighbour(at.posture, ground.taken_at(at));
        let turn = free(pose).and_then(|posture| Plan::to(&ground, pose, posture, Aim::Shift));
        // Whoever lies where nothing turns may have the other end to turn around.
        let other_end = || {
            ground.landed(pose, pose.posture).and_then(free)?;
            Plan::to(&ground, pose, pose.posture, Aim::Land)
        };
        let later = now + self.setup.params.patience * 3;
        let again = if turn.is_none() { now } else { later };
        let plan = turn.or_else(other_end);
        self.core.stuck = Some(if plan.is_some() { again } else { later });
        if let Some(plan) = plan {
            self.ask(now, plan);
        }
    }

    fn ask(&mut self, now: Time, plan: Plan) {
        let asked: Vec<Port> = self
            .core
            .peers
            .iter()
            .filter(|(_, p)| p.state.is_some_and(|s| !self.stays(&s)) && !self.is_dead(p))
            .filter(|_| !self.has(Sabotage::AskNobody))
            .map(|(p, _)| p)
            .collect();
        self.core.token.0 += 1;
        let pending = asked.iter().fold(0, |mask, p| mask | 1u32 << p.0);
        if pending == 0 {
            return self.begin(now, now, plan);
        }
        let again = now + self.setup.params.resend;
        self.core.phase = Phase::Asking { plan, pending, asked: now, again };
        self.send_requests(now);
    }

    /// Sends the request to all who have not answered.
    fn send_requests(&mut self, now: Time) {
        let Phase::Asking { plan, pending, .. } = &self.core.phase else { return };
        let message = Message::Request {
            origin: self.core.id,
            token: self.core.token,
            rank: self.core.intent.rank,
            age: now.since(self.core.waiting_since),
            pose: plan.from,
            sweep: plan.sweep,
            ends: plan.ends,
        };
        let pending = *pending;
        for port in (0..Self::PORTS as u8).filter(|p| pending >> p & 1 == 1).map(Port) {
            self.out.push_back(Output::Send { port, class: Class::Negotiation, message });
        }
    }

    fn granted(&mut self, now: Time, port: Port) {
        let Phase::Asking { pending, .. } = &mut self.core.phase else { return };
        *pending &= !(1 << port.0);
        if *pending == 0 {
            self.set_out(now);
        }
    }

    /// Everybody who had to be asked has granted the way.
    fn set_out(&mut self, now: Time) {
        let idle = Phase::Idle { look_at: Time::NEVER };
        let over = std::mem::replace(&mut self.core.phase, idle);
        let Phase::Asking { plan, asked, .. } = over else { return };
        if (plan.harmless && !self.is_harmless(plan.ends)) || self.meets_the_dead(&plan) {
            // Others have set out meanwhile, or have died where nobody knew them to be, and this one knows
            // only now where they are.
            self.core.phase = Phase::Asking { plan, pending: 0, asked, again: now };
            let rest = self.back_off();
            return self.stop(now, rest);
        }
        self.begin(now, asked, plan);
    }

    /// Whether somebody who cannot say so any more stands in the way.
    fn meets_the_dead(&self, plan: &Plan) -> bool {
        let motions = &self.setup.motions;
        let dead: Vec<Cell> = self.core.dead.values().flat_map(|pose| motions.cells(*pose)).collect();
        motions.swept(plan.from.state, plan.sweep).any(|cell| dead.contains(&cell))
    }

    /// The way is locked since `asked`.
    fn begin(&mut self, now: Time, asked: Time, plan: Plan) {
        self.core.waits_for = None;
        let until = asked + self.setup.params.lease;
        self.core.phase = Phase::Moving { plan, next: 0, tries: 0, until };
        self.go_on(now);
    }

    /// Does the next thing of the motion.
    fn go_on(&mut self, now: Time) {
        let Phase::Moving { plan, next, until, .. } = &self.core.phase else { return };
        let params = &self.setup.params;
        let (deed, takes) = match (plan.steps.get(*next), plan.aim) {
            (Some(step), _) => (Deed::Turn(*step), params.turn_time),
            (None, Aim::Settle(_)) => return self.settle(now),
            (None, Aim::Shift) => {
                self.core.course.advance();
                return self.stop(now, Span::ZERO);
            }
            (None, Aim::Land) if self.core.pose.both => (Deed::Detach, params.connect_time),
            (None, Aim::Land) => (Deed::Attach, params.connect_time),
        };
        let not_after = *until - takes;
        let late = now > not_after;
        if late {
            hit(Mark::MetaLockRanOut);
        }
        let (late, not_after) =
            if self.has(Sabotage::OutstayLease) { (false, Time::NEVER) } else { (late, not_after) };
        if late {
            // The lock would run out on the way. Where we are is a place like any other.
            return self.stop(now, Span::ZERO);
        }
        self.out.push_back(Output::Act(Action { deed, not_after }));
    }

    fn settle(&mut self, now: Time) {
        // The task may have changed on the way.
        if let Some(seed) = self.fits(self.core.pose) {
            self.core.settled = Some(seed);
            self.core.filled = self.core.filled.with(seed);
        }
        self.withdraw();
        self.stop_leading();
        self.core.waiting_since = now;
        self.stop(now, Span::ZERO);
    }

    /// Ends a motion or an attempt, tells everybody, and looks for something else after `rest`.
    fn stop(&mut self, now: Time, rest: Span) {
        let origin = self.core.id;
        let over = std::mem::replace(&mut self.core.phase, Phase::Idle { look_at: now + rest });
        self.core.rest_until = now + rest;
        if matches!(over, Phase::Moving { .. }) {
            self.tell(now, Class::Gradient);
        }
        if !matches!(over, Phase::Idle { .. }) {
            let (token, pose) = (self.core.token, self.core.pose);
            self.broadcast(Class::Negotiation, Message::Release { origin, token, pose });
        }
    }

    fn back_off(&mut self) -> Span {
        let most = self.setup.params.back_off;
        most + Span(self.core.chance.below(most.0 + 1))
    }

    fn percept(&mut self, now: Time, percept: Percept) {
        let back_off = self.back_off();
        if let Percept::Done(pose) = percept {
            let before = std::mem::replace(&mut self.core.pose, pose);
            match &mut self.core.phase {
                Phase::Moving { plan, next, tries, .. } => {
                    *tries = 0;
                    if *next < plan.steps.len() {
                        *next += 1;
                        self.core.stuck = None;
                        return self.go_on(now);
                    }
                    if pose.both {
                        return self.go_on(now);
                    }
                    // The old end has let go: the move is complete.
                    self.core.course.advance();
                    self.core.intent.cornered = 0;
                    self.core.waiting_since = now;
                    self.stop(now, Span::ZERO);
                }
                // An action of an earlier life has ended.
                _ if before != pose => {
                    hit(Mark::MetaEarlierLifeActed);
                    self.tell(now, Class::Gradient);
                    self.look_again(now);
                }
                _ => {}
            }
            return;
        }
        let Phase::Moving { plan, next, tries, .. } = &mut self.core.phase else { return };
        *tries += 1;
        let again = match percept {
            Percept::Failed => *tries < TRIES,
            // Whoever came into hearing on the way is too far away to be met; at the start it must
            // be asked.
            Percept::Refused(Refusal::Stale) => *next > 0 && *tries < TRIES,
            _ => false,
        };
        if percept == Percept::Refused(Refusal::Stale) {
            hit(if *next > 0 { Mark::MetaStaleOnTheWay } else { Mark::MetaStaleAtStart });
        }
        let is_stuck = percept == Percept::Failed && *next < plan.steps.len();
        if again {
            self.go_on(now);
        } else {
            hit(if is_stuck { Mark::MetaStuck } else { Mark::MetaActionGivenUp });
            if is_stuck {
                self.core.stuck = Some(now + self.setup.params.patience * 3);
                self.withdraw();
                self.stop_leading();
            }
            self.stop(now, back_off);
        }
    }

    /// Whether a neighbour may have all cells of a motion.
    fn judge(&mut self, now: Time, asked: Asked) -> Option<Denial> {
        let Asked { rank, age, origin, pose, sweep } = asked;
        let motions = &self.setup.motions;
        if self.has(Sabotage::GrantEverything) {
            return None;
        }
        if now < self.core.quarantine && !self.has(Sabotage::GrantAfterRestart) {
            return Some(Denial::Quarantined);
        }
        let meets = |cells: &[Cell]| motions.swept(pose.state, sweep).any(|c| cells.contains(&c));
        if meets(&motions.cells(self.core.pose)) {
            return Some(Denial::Occupied);
        }
        match &self.core.phase {
            Phase::Moving { .. } if self.has(Sabotage::ForgetLocks) => None,
            Phase::Moving { plan, .. } => {
                let own: Vec<Cell> = motions.swept(plan.from.state, plan.sweep).collect();
                meets(&own).then_some(Denial::Held)
            }
            Phase::Asking { plan, .. } => {
                let own: Vec<Cell> = motions.swept(plan.from.state, plan.sweep).collect();
                if !meets(&own) {
                    return None;
                }
                let mine = (self.core.intent.rank, Reverse(now.since(self.core.waiting_since)), self.core.id);
                if mine < (rank, Reverse(age), origin) {
                    return Some(Denial::Younger);
                }
                hit(Mark::MetaYielded);
                self.core.prevented += 1;
                self.core.waits_for = Some(origin);
                let rest = self.back_off();
                self.stop(now, rest);
                None
            }
            Phase::Idle { .. } => None,
        }
    }

    fn message(&mut self, now: Time, port: Port, message: Message) {
        match message {
            Message::State(state) => {
                let stale = self.has(Sabotage::AcceptStaleStates);
                let Some(peer) = self.core.peers.get_mut(port) else { return };
                if peer.condemned && !stale {
                    return hit(Mark::MetaCondemnedSpoke);
                }
                if peer.state.is_some_and(|s| s.sequence >= state.sequence) && !stale {
                    return hit(Mark::MetaStateLate);
                }
                if let Some(pose) = self.core.dead.get(&state.id).filter(|_| !stale) {
                    // Its first words in this session came later than the news of its death. Whoever is
                    // started again is told of.
                    hit(Mark::MetaCondemnedSpoke);
                    *peer = Peer {
                        state: Some(State { pose: *pose, ..state }),
                        condemned: true,
                        ..Peer::new(peer.session)
                    };
                    return self.look_again(now);
                }
                let before = peer.state.replace(state);
                if stale {
                    self.core.dead.remove(&state.id);
                }
                self.take_task(now, state.task);
                let filled = match state.task == self.core.task {
                    true => self.core.filled.and(state.filled),
                    false => self.core.filled,
                };
                let still =
                    |b: &State| State { sequence: state.sequence, filled: state.filled, ..*b } == state;
                let news = !before.as_ref().is_some_and(still) || filled != self.core.filled;
                self.core.filled = filled;
                if before.is_none() {
                    // Contacts need not begin on both sides at once: what was told on ours may have come
                    // too early on the other.
                    let message = self.state();
                    self.out.push_back(Output::Send { port, class: Class::Liveness, message });
                }
                if news {
                    self.look_again(now);
                }
            }
            Message::Way(way) => self.hear_way(now, port, way),
            Message::Directive(call) => self.hear_call(now, port, call),
            Message::Probe(probe) => self.on_probe(now, port, probe),
            Message::Request { origin, token, rank, age, pose, sweep, ends } => {
                let known = match self.core.peers.get_mut(port) {
                    Some(peer) if token > peer.over => peer.grant.is_some_and(|g| g.token == token),
                    Some(_) => return hit(Mark::MetaRequestOver),
                    None => return,
                };
                let asked = Asked { rank, age, origin, pose, sweep };
                let denial = if known { None } else { self.judge(now, asked) };
                if known {
                    hit(Mark::MetaRequestRepeated);
                }
                denial.into_iter().for_each(|d| hit(d.mark()));
                let until = now + self.setup.params.lease;
                let forgets = self.has(Sabotage::ForgetLocks);
                if let Some(peer) = self.core.peers.get_mut(port)
                    && denial.is_none()
                    && !forgets
                    && !known
                {
                    peer.grant = Some(Grant { token, pose, sweep, ends, until });
                }
                let from = self.core.id;
                let message = Message::Response { from, token, denial };
                self.out.push_back(Output::Send { port, class: Class::Negotiation, message });
            }
            Message::Response { from, token, denial } if token == self.core.token => match denial {
                None => self.granted(now, port),
                Some(denial) if matches!(self.core.phase, Phase::Asking { .. }) => {
                    if denial.is_collision() {
                        self.core.prevented += 1;
                    }
                    self.core.waits_for = Some(from);
                    let rest = self.back_off();
                    self.stop(now, rest);
                }
                Some(_) => {}
            },
            Message::Response { .. } => {}
            Message::Release { token, pose, .. } => {
                if let Some(peer) = self.core.peers.get_mut(port) {
                    if let Some(state) = peer.state.as_mut().filter(|_| token > peer.over && !peer.condemned)
                    {
                        // Its state says so too, but may come later.
                        state.pose = pose;
                    }
                    peer.over = peer.over.max(token);
                    if peer.grant.is_some_and(|g| g.token <= token) {
                        peer.grant = None;
                        self.look_again(now);
                    }
                }
            }
        }
    }

    fn contact(&mut self, now: Time, port: Port, session: Option<crate::ids::Session>) {
        self.core.peers.set(port, session.map(Peer::new));
        if session.is_some() {
            let message = self.state();
            self.out.push_back(Output::Send { port, class: Class::Liveness, message });
            if let Some(way) = self.core.intent.way {
                let (class, message) = (Class::Liveness, Message::Way(way));
                self.out.push_back(Output::Send { port, class, message });
            }
            // Whoever has come must be asked too.
            if matches!(self.core.phase, Phase::Asking { .. }) {
                hit(Mark::MetaCameWhileAsking);
                self.stop(now, Span::ZERO);
            }
        } else if let Phase::Asking { pending, again, .. } = &mut self.core.phase {
            // Whoever has left hearing need not be asked. But whoever has been started again comes back at once,
            // and must be: not before the next moment is it known which.
            *pending &= !(1 << port.0);
            if *pending == 0 {
                *again = now + Span(1);
            }
        }
        self.look_again(now);
    }

    fn order(&mut self, now: Time, order: Order) {
        match order {
            Order::Seeds { task, open, filled } => {
                self.take_task(now, task);
                if task == self.core.task {
                    if filled.holds(self.core.filled) || self.setup.params.teller == Teller::Controller {
                        self.core.open = open;
                    }
                    self.core.filled = self.core.filled.and(filled);
                }
            }
            Order::Alive { id } => {
                self.core.dead.remove(&id);
                if let Some((_, peer)) = self.core.peers.named(id) {
                    peer.condemned = false;
                }
            }
            Order::Obstacle { cell, there: true } => {
                hit(Mark::MetaObstacle);
                self.core.obstacles.insert(cell);
            }
            Order::Obstacle { cell, there: false } => _ = self.core.obstacles.remove(&cell),
            Order::Dead { id, pose } => {
                hit(Mark::MetaDeathTold);
                self.core.dead.insert(id, pose);
                self.count_dead();
                if let Some((port, peer)) = self.core.peers.named(id) {
                    (peer.grant, peer.way, peer.condemned) = (None, None, true);
                    if let Some(state) = &mut peer.state {
                        state.pose = pose;
                    }
                    self.granted(now, port);
                }
            }
        }
        self.look_again(now);
    }

    fn report(&mut self) {
        let c = &mut self.core;
        let status = Status {
            pose: c.pose,
            settled: c.settled,
            prevented: c.prevented,
            waits_for: c.waits_for,
            barred: c.intent.barred,
            deadlocked: c.watch.deadlocked,
        };
        if c.reported != Some(status) {
            c.reported = Some(status);
            self.out.push_back(Output::Report(status));
        }
    }
}

impl Agent for Metamodule {
    type Setup = Setup;
    type Place = Pose;
    type Message = Message;
    type Action = Action;
    type Percept = Percept;
    type Order = Order;
    type Report = Status;

    const PORTS: usize = 24;

    fn new(setup: &Arc<Setup>, birth: Birth<Pose>, now: Time) -> Metamodule {
        let restarted = birth.incarnation.0 > 0;
        let quarantine = if restarted { now + setup.params.lease } else { now };
        let mut agent = Metamodule {
            setup: Arc::clone(setup),
            core: Core {
                id: birth.id,
                pose: birth.place,
                peers: Peers::new(Self::PORTS),
                dead: BTreeMap::new(),
                obstacles: BTreeSet::new(),
                task: Task::default(),
                open: SeedSet::default(),
                filled: SeedSet::default(),
                settled: None,
                course: Course::default(),
                intent: Intent::new(),
                lead: Lead::default(),
                stuck: None,
                phase: Phase::Idle { look_at: now.max(quarantine) },
                // Tokens of a later life are larger than any of an earlier one.
                token: Token(u32::from(birth.incarnation.0) << 20),
                waiting_since: now,
                rest_until: quarantine,
                quarantine,
                repeat_at: now + setup.params.repeat,
                sequence: 0,
                prevented: 0,
                waits_for: None,
                reported: None,
                watch: Watch::new(birth.incarnation),
                chance: Stream::named(birth.seed, "metamodule", u64::from(birth.id.0)),
            },
            out: VecDeque::new(),
        };
        agent.report();
        agent
    }

    fn handle(&mut self, now: Time, input: InputOf<Metamodule>) {
        match input {
            Input::Contact { port, session } => self.contact(now, port, session),
            Input::Message { port, message } => self.message(now, port, message),
            Input::Percept(percept) => self.percept(now, percept),
            Input::Order(order) => self.order(now, order),
            Input::Wake => {
                if now >= self.core.repeat_at {
                    self.tell(now, Class::Liveness);
                    if let Some(way) = self.core.intent.way {
                        self.broadcast(Class::Liveness, Message::Way(way));
                    }
                    self.repeat_call(now);
                }
                match &mut self.core.phase {
                    Phase::Idle { look_at } if now >= *look_at => self.look(now),
                    Phase::Asking { pending: 0, again, .. } if now >= *again => self.set_out(now),
                    Phase::Asking { again, .. } if now >= *again => {
                        hit(Mark::MetaResent);
                        *again = now + self.setup.params.resend;
                        self.send_requests(now);
                    }
                    _ => {}
                }
            }
        }
        self.tend_detector(now);
        self.report();
    }

    fn poll(&mut self) -> Option<OutputOf<Metamodule>> {
        self.out.pop_front()
    }

    fn wake_at(&self) -> Time {
        let next = match &self.core.phase {
            Phase::Idle { look_at } => *look_at,
            Phase::Asking { again, .. } => *again,
            Phase::Moving { .. } => Time::NEVER,
        };
        next.min(self.core.repeat_at).min(self.core.watch.wake_at())
    }

    fn digest(&self, hasher: &mut dyn Hasher) {
        self.core.digest_state(hasher);
    }

    fn summary(&self, _now: Time) -> Summary {
        let c = &self.core;
        let claim = c.intent.claim;
        let role = match (c.settled, claim) {
            (Some(_), _) => "settled",
            (None, Some(_)) => "claiming",
            (None, None) => "free",
        };
        let activity = match c.phase {
            Phase::Idle { .. } => "idle",
            Phase::Asking { .. } => "asking",
            Phase::Moving { .. } => "moving",
        };
        Summary {
            role: role.to_owned(),
            activity: activity.to_owned(),
            goal: u16::from(c.task.goal),
            level: c.settled.or(claim.map(|c| c.seed)).map(u16::from),
            gradient: claim.map(|c| u32::from(c.cost)),
            lock: c.peers.iter().find_map(|(_, p)| p.grant.and(p.state).map(|s| s.id)),
            waits_for: c.waits_for,
        }
    }
}
