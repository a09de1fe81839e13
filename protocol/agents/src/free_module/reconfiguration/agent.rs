//! The agent of a free module: carries out the steps that the controller orders, one at a time.
//!
//! An order is taken once: by its name a repeated one is answered with what became of it. Orders of earlier epochs are
//! ignored. A connector closes or opens at once; a turn asks for the branch lock first. A module that has restarted
//! keeps still for one lease, since it may have granted a lock before.

use super::LatticeSetup;
use super::branch_lock::{BranchLock, Ports, ports};
use super::message::{
    Failure, LatticeAction, LatticeBodyAction, LatticeDenial, LatticeMessage, LatticeOrder, LatticePercept,
    LatticeRefusal, LatticeStatus, LockMessage, StepName, StepResult,
};
use super::place::{CONNECTORS, LatticePlace};
use metamorph_core::agent::{Agent, Birth, Input, InputOf, Output, OutputOf, Summary};
use metamorph_core::counters::Class;
use metamorph_core::defects::Defect;
use metamorph_core::digest::Portable;
use metamorph_core::ids::{Incarnation, ModuleId, Port};
use metamorph_core::rng::Rng;
use metamorph_core::time::{Span, Time};
use metamorph_planning::assembly::tables::hemisphere;
use std::collections::VecDeque;
use std::hash::{Hash, Hasher};
use std::sync::Arc;

/// How far a step is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Stage {
    /// It is tried at this time, or when something around changes.
    Waiting(Time),
    /// It asks for the branch lock.
    Asking,
    /// The body acts.
    Acting,
}

/// A step that was ordered.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Job {
    step: StepName,
    body_action: LatticeBodyAction,
    not_after: Time,
    stage: Stage,
}

/// The agent of a module of a free assembly.
#[derive(Clone, Debug)]
pub struct LatticeModule {
    setup: Arc<LatticeSetup>,
    id: ModuleId,
    rng: Rng,
    place: LatticePlace,
    /// The connectors that are connected, as bits.
    docked: Ports,
    epoch: u32,
    job: Option<Job>,
    last: Option<(StepName, StepResult)>,
    lock: Option<BranchLock>,
    is_carried: bool,
    /// Until then it grants nothing and does nothing.
    still_until: Time,
    /// The last attempt of its own.
    token: u32,
    prevented: u32,
    waits_for: Option<ModuleId>,
    told: Option<LatticeStatus>,
    outputs: VecDeque<OutputOf<LatticeModule>>,
}

impl LatticeModule {
    /// Returns the module for whose turn this one keeps still, other than itself.
    pub fn granted_to(&self, now: Time) -> Option<ModuleId> {
        self.lock.filter(|lock| lock.parent.is_some() && now < lock.until).map(|lock| lock.origin)
    }
    /// Returns true if it does nothing while another module turns.
    pub fn keeps_still_for(&self, now: Time, other: ModuleId) -> bool {
        self.granted_to(now) == Some(other) || now < self.still_until
    }
    /// Returns the end of its own branch lock.
    pub fn locked_until(&self) -> Option<Time> {
        self.lock.filter(|lock| lock.parent.is_none()).map(|lock| lock.until)
    }

    fn has(&self, defect: Defect) -> bool {
        self.setup.defect == Some(defect)
    }
    fn status(&self) -> LatticeStatus {
        LatticeStatus {
            epoch: self.epoch,
            place: self.place,
            busy: self.job.is_some() || self.is_carried,
            last: self.last,
            prevented: self.prevented,
            waits_for: self.waits_for,
        }
    }
    fn tell(&mut self) {
        let status = self.status();
        self.told = Some(status);
        self.outputs.push_back(Output::Report(status));
    }
    fn send(&mut self, to: Ports, message: LatticeMessage) {
        for port in ports(to & self.docked) {
            self.outputs.push_back(Output::Send { port, class: Class::Negotiation, message });
        }
    }
    fn respond(&mut self, port: Port, message: &LatticeMessage, denial: Option<LatticeDenial>) {
        let what = LockMessage::Response(denial.map(|why| (why, self.id)));
        self.send(1 << port.0, LatticeMessage { what, ..*message });
    }

    /// Takes an order. One that was taken before is answered.
    fn order(&mut self, now: Time, order: LatticeOrder) {
        let epoch = match order {
            LatticeOrder::Hold { epoch } => epoch,
            LatticeOrder::Step { step, .. } => step.epoch,
        };
        if epoch < self.epoch && !self.has(Defect::FollowOldPlans) {
            return;
        }
        if epoch != self.epoch {
            self.epoch = epoch;
            self.drop_job();
        }
        if let LatticeOrder::Step { step, body_action, expect, not_after } = order {
            let known = self.last.is_some_and(|(last, _)| last == step) && !self.has(Defect::FollowOldPlans);
            if !known && self.job.is_none() {
                self.job = Some(Job { step, body_action, not_after, stage: Stage::Waiting(now) });
                if expect != (self.place.posture, self.place.closed) {
                    return self.finish(Err(Failure::Stale));
                }
                self.go_on(now);
            }
        }
        self.tell();
    }

    /// Gives up a step that has not begun.
    fn drop_job(&mut self) {
        if self.job.is_some_and(|job| job.stage != Stage::Acting) {
            self.job = None;
            self.waits_for = None;
            self.release();
        }
    }

    /// Ends the step.
    fn finish(&mut self, result: StepResult) {
        let Some(job) = self.job.take() else { return };
        self.last = Some((job.step, result));
        self.waits_for = None;
        self.release();
        self.tell();
    }

    /// Ends its own branch lock.
    fn release(&mut self) {
        if let Some(lock) = self.lock.take_if(|lock| lock.parent.is_none()) {
            self.send(lock.asked, lock.message(LockMessage::Release));
        }
    }

    /// Tries the step later.
    fn wait(&mut self, until: Time) {
        if let Some(job) = &mut self.job {
            job.stage = Stage::Waiting(until);
        }
    }

    fn back_off(&mut self, now: Time) {
        let wait = self.setup.back_off;
        let more = wait * self.rng.below(1_000) / 1_000;
        self.wait(now + wait + more);
    }

    /// Begins the step if nothing is in its way here.
    fn go_on(&mut self, now: Time) {
        let Some(job) = self.job.filter(|job| matches!(job.stage, Stage::Waiting(_))) else { return };
        if now > job.not_after {
            return self.finish(Err(Failure::Late));
        }
        if now < self.still_until {
            return self.wait(self.still_until);
        }
        if self.is_carried || self.lock.is_some() {
            return self.back_off(now);
        }
        match job.body_action {
            LatticeBodyAction::Attach(_) | LatticeBodyAction::Detach(_) => self.act(job.not_after),
            LatticeBodyAction::Turn { joint, .. } => self.ask(now, joint),
        }
    }

    fn act(&mut self, not_after: Time) {
        let Some(job) = &mut self.job else { return };
        job.stage = Stage::Acting;
        self.waits_for = None;
        let Job { step, body_action, .. } = *job;
        self.outputs.push_back(Output::Act(LatticeAction { step, body_action, not_after }));
    }

    /// Asks all modules that the turn moves to keep still.
    fn ask(&mut self, now: Time, joint: u8) {
        let behind = |port: &Port| hemisphere(port.0) > usize::from(joint);
        let mut asked = 0;
        if !self.has(Defect::AskNone) {
            asked = ports(self.docked).filter(behind).fold(0, |all, port| all | 1 << port.0);
        }
        self.token += 1;
        let lock = BranchLock {
            origin: self.id,
            token: self.token,
            parent: None,
            asked,
            awaiting: asked,
            denial: None,
            until: now + self.setup.lease,
            resend_at: now + self.setup.resend,
        };
        self.lock = Some(lock);
        if let Some(job) = &mut self.job {
            job.stage = Stage::Asking;
        }
        self.send(asked, lock.message(LockMessage::Request));
        self.answered(now);
    }

    /// Goes on when all that were asked have answered: turns, or tells its own parent.
    fn answered(&mut self, now: Time) {
        let Some(lock) = self.lock.filter(BranchLock::is_answered) else { return };
        match (lock.parent, lock.denial) {
            (None, None) => {
                if let Some(Job { not_after, .. }) = self.job {
                    let latest = (lock.until - self.setup.turn_time).min(not_after);
                    let margin = if self.has(Defect::IgnoreSkew) { Span::ZERO } else { self.setup.skew };
                    self.act(latest - margin);
                }
            }
            (None, Some((why, by))) => {
                self.prevented += 1;
                self.waits_for = Some(by);
                if why == LatticeDenial::Loop {
                    return self.finish(Err(Failure::Impossible));
                }
                self.release();
                self.back_off(now);
                self.tell();
            }
            (Some(parent), denial) => {
                self.send(1 << parent.0, lock.message(LockMessage::Response(denial)));
                if denial.is_some() {
                    self.send(lock.asked, lock.message(LockMessage::Release));
                    self.lock = None;
                }
            }
        }
    }

    /// Answers a request for a branch lock, or passes it on.
    fn request(&mut self, now: Time, port: Port, message: &LatticeMessage) {
        let own = self.lock.filter(|lock| lock.is_of(message));
        if message.origin == self.id {
            // The wave has come back: harmless from within the moving side, a loop from the other one.
            let inside = own.is_some_and(|lock| lock.asked >> port.0 & 1 != 0);
            let denial = match own {
                None => Some(LatticeDenial::Changed),
                Some(_) if inside => None,
                Some(_) => Some(LatticeDenial::Loop),
            };
            return self.respond(port, message, denial);
        }
        if let Some(lock) = own {
            return match (lock.parent == Some(port), lock.is_answered()) {
                (false, _) => self.respond(port, message, None),
                (true, true) => self.answered(now),
                (true, false) => self.send(lock.awaiting, lock.message(LockMessage::Request)),
            };
        }
        // A later attempt of the same module replaces an earlier one.
        let stale = |lock: &BranchLock| lock.origin == message.origin && lock.token < message.token;
        let denial = match &self.lock {
            _ if now < self.still_until => Some(LatticeDenial::Quarantined),
            _ if self.job.is_some() || self.is_half_open() => Some(LatticeDenial::Busy),
            _ if self.is_carried => Some(LatticeDenial::Held),
            Some(lock) if !stale(lock) => Some(LatticeDenial::Held),
            _ => None,
        };
        if denial.is_some() {
            return self.respond(port, message, denial);
        }
        let asked = self.docked & !(1 << port.0);
        let lock = BranchLock {
            origin: message.origin,
            token: message.token,
            parent: Some(port),
            asked,
            awaiting: asked,
            denial: None,
            until: now + self.setup.lease,
            resend_at: now + self.setup.resend,
        };
        self.lock = Some(lock);
        self.send(asked, lock.message(LockMessage::Request));
        self.answered(now);
    }

    /// Returns true if a connector is closed on this side only.
    fn is_half_open(&self) -> bool {
        self.place.closed & !self.docked != 0
    }

    fn hear(&mut self, now: Time, port: Port, message: LatticeMessage) {
        match message.what {
            LockMessage::Request => self.request(now, port, &message),
            LockMessage::Response(denial) => {
                let lock = self.lock.as_mut().filter(|lock| lock.is_of(&message));
                if lock.is_some_and(|lock| lock.answer(port, denial)) {
                    self.answered(now);
                }
            }
            LockMessage::Release => {
                let is_it = |lock: &mut BranchLock| lock.is_of(&message) && lock.parent == Some(port);
                if let Some(lock) = self.lock.take_if(is_it) {
                    self.send(lock.asked, message);
                    self.go_on(now);
                }
            }
        }
    }

    fn contact(&mut self, now: Time, port: Port, is_there: bool) {
        let bit = 1 << port.0;
        self.docked = if is_there { self.docked | bit } else { self.docked & !bit };
        let by = self.id;
        // The answer to a request that was sent in the former contact does not come any more.
        if self.lock.as_mut().is_some_and(|lock| lock.answer(port, Some((LatticeDenial::Changed, by)))) {
            self.answered(now);
        }
    }

    fn sense(&mut self, now: Time, percept: LatticePercept) {
        let is_acting = self.job.is_some_and(|job| job.stage == Stage::Acting);
        match percept {
            LatticePercept::Done(place) => {
                self.place = place;
                // Otherwise an earlier incarnation has begun it, and a step ordered meanwhile is for the place before.
                self.finish(if is_acting { Ok(()) } else { Err(Failure::Stale) });
            }
            LatticePercept::Failed | LatticePercept::Misaligned if !is_acting => {}
            LatticePercept::Failed | LatticePercept::Misaligned => {
                let is_turn =
                    self.job.is_some_and(|job| matches!(job.body_action, LatticeBodyAction::Turn { .. }));
                self.finish(Err(if is_turn { Failure::Joint } else { Failure::Connection }));
            }
            LatticePercept::Refused(LatticeRefusal::Blocked) => self.finish(Err(Failure::Blocked)),
            LatticePercept::Refused(LatticeRefusal::Impossible) => self.finish(Err(Failure::Impossible)),
            LatticePercept::Refused(LatticeRefusal::Late | LatticeRefusal::Stale | LatticeRefusal::Busy) => {
                self.release();
                self.back_off(now);
            }
            LatticePercept::Carried(_) => {
                self.is_carried = true;
                self.tell();
            }
            LatticePercept::Settled { place, .. } => {
                self.place = place;
                self.is_carried = false;
                self.tell();
            }
        }
    }

    /// Does what is due: ends locks, asks again, tries again.
    fn tick(&mut self, now: Time) {
        if let Some(lock) = self.lock {
            let is_acting = self.job.is_some_and(|job| job.stage == Stage::Acting);
            let own = lock.parent.is_none();
            // There must be time for the turn itself before the lease ends.
            let end = if own { lock.until - self.setup.turn_time } else { lock.until };
            if now >= end && own && !is_acting {
                self.release();
                self.back_off(now);
            } else if now >= end && !own && !self.is_carried {
                self.lock = None;
            } else if now >= lock.resend_at && !lock.is_answered() {
                self.send(lock.awaiting, lock.message(LockMessage::Request));
                if let Some(lock) = &mut self.lock {
                    lock.resend_at = now + self.setup.resend;
                }
            }
        }
        if self.job.is_some_and(|job| matches!(job.stage, Stage::Waiting(at) if now >= at)) {
            self.go_on(now);
        }
    }
}

impl Agent for LatticeModule {
    type Setup = LatticeSetup;
    type Place = LatticePlace;
    type Message = LatticeMessage;
    type Action = LatticeAction;
    type Percept = LatticePercept;
    type Order = LatticeOrder;
    type Report = LatticeStatus;

    /// The number of ports: one for each connector.
    const PORTS: usize = CONNECTORS;

    fn new(setup: &Arc<LatticeSetup>, birth: Birth<LatticePlace>, now: Time) -> LatticeModule {
        let Birth { id, incarnation, place, seed, .. } = birth;
        let restarted = incarnation > Incarnation(0);
        let mut agent = LatticeModule {
            setup: Arc::clone(setup),
            id,
            rng: Rng::named(seed, "lattice module", (u64::from(id.0) << 16) | u64::from(incarnation.0)),
            place,
            docked: 0,
            epoch: 0,
            job: None,
            last: None,
            lock: None,
            is_carried: false,
            still_until: if restarted { now + setup.lease } else { now },
            token: u32::from(incarnation.0) << 16,
            prevented: 0,
            waits_for: None,
            told: None,
            outputs: VecDeque::new(),
        };
        agent.tell();
        agent
    }

    fn handle(&mut self, now: Time, input: InputOf<LatticeModule>) {
        match input {
            Input::Contact { port, session } => self.contact(now, port, session.is_some()),
            Input::Message { port, message } => self.hear(now, port, message),
            Input::Percept(percept) => self.sense(now, percept),
            Input::Order(order) => self.order(now, order),
            Input::Wake => {}
        }
        self.tick(now);
        if self.told != Some(self.status()) {
            self.tell();
        }
    }

    fn poll(&mut self) -> Option<OutputOf<LatticeModule>> {
        self.outputs.pop_front()
    }

    fn wake_at(&self) -> Time {
        let job = match self.job.map(|job| job.stage) {
            Some(Stage::Waiting(at)) => at,
            _ => Time::NEVER,
        };
        let is_acting = self.job.is_some_and(|job| job.stage == Stage::Acting);
        let lock = match &self.lock {
            None => Time::NEVER,
            Some(lock) if lock.parent.is_none() && is_acting => Time::NEVER,
            Some(_) if self.is_carried => Time::NEVER,
            Some(lock) => {
                let margin = if lock.parent.is_none() { self.setup.turn_time } else { Span::ZERO };
                let resend = if lock.is_answered() { Time::NEVER } else { lock.resend_at };
                resend.min(lock.until - margin)
            }
        };
        job.min(lock)
    }

    fn reseed(&mut self, seed: u64) {
        self.rng = Rng::named(seed, "lattice module, reseeded", self.id.0.into());
    }

    fn digest(&self, hasher: &mut dyn Hasher) {
        let mut hasher = Portable::new(hasher);
        (&self.rng, self.place, self.docked, self.epoch).hash(&mut hasher);
        (self.job, self.last, self.lock, self.is_carried).hash(&mut hasher);
        (self.still_until, self.token, self.prevented, self.waits_for).hash(&mut hasher);
    }

    fn summary(&self, now: Time) -> Summary {
        let activity = match self.job.map(|job| job.stage) {
            None if self.is_carried => "carried",
            None => "resting",
            Some(Stage::Waiting(_)) => "waiting",
            Some(Stage::Asking) => "asking",
            Some(Stage::Acting) => "acting",
        };
        let role = if self.job.is_some() { "acting" } else { "resting" };
        Summary {
            role: role.to_owned(),
            activity: activity.to_owned(),
            lock: self.granted_to(now),
            waits_for: self.waits_for,
            ..Summary::default()
        }
    }
}
