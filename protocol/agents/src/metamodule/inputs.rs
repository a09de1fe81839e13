//! How a metamodule handles messages, contacts and orders.

use super::agent::Metamodule;
use super::locks::{Grant, Request, Verdict, judge};
use super::message::{Denial, Message, Order, State};
use super::params::SeedAuthority;
use super::phase::Phase;
use super::pose::Pose;
use super::view::View;
use metamorph_core::counters::Class;
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::defects::Defect;
use metamorph_core::ids::{ModuleId, Port, Session, Token};
use metamorph_core::time::{Span, Time};

/// Messages.
impl Metamodule {
    pub(super) fn on_message(&mut self, now: Time, port: Port, message: Message) {
        match message {
            Message::State(state) => self.on_state(now, port, state),
            Message::Path(path) => {
                if self.with_policy(now, |policy, cx| policy.hear_path(cx.v, port, path)) {
                    self.look_again(now);
                }
            }
            Message::Directive(directive) => {
                if self.with_policy(now, |policy, cx| policy.hear_directive(cx.v, port, directive)) {
                    self.look_again(now);
                }
            }
            Message::Probe(probe) => {
                let Metamodule { setup, own, neighbours, locks, phase, detector, out, .. } = self;
                detector.on_probe(View { now, setup, own, neighbours, locks }, phase, out, port, probe);
            }
            Message::Request { origin, token, rank, age, pose, sweep, ends } => {
                self.on_request(now, port, Request { origin, token, rank, age, pose, sweep, ends });
            }
            Message::Response { from, token, denial } if token == self.requester.token => {
                self.on_response(now, port, from, denial);
            }
            Message::Response { .. } => {}
            Message::Release { token, pose, .. } => self.on_release(now, port, token, pose),
        }
    }

    fn on_state(&mut self, now: Time, port: Port, state: State) {
        let accepts_stale = self.view(now).has(Defect::AcceptStaleStates);
        let Some(neighbour) = self.neighbours.get(port) else { return };
        let before = neighbour.state;
        if neighbour.certified_dead && !accepts_stale {
            return hit(CoveragePoint::MetaCondemnedSpoke);
        }
        if before.is_some_and(|s| s.sequence >= state.sequence) && !accepts_stale {
            return hit(CoveragePoint::MetaStateLate);
        }
        if let Some(pose) = self.neighbours.dead.get(&state.id).copied().filter(|_| !accepts_stale) {
            // Its first state in this session came later than the news of its death; of a restart there would
            // be news, too.
            hit(CoveragePoint::MetaCondemnedSpoke);
            let session = neighbour.session;
            self.begin_session(port, Some(session));
            if let Some(neighbour) = self.neighbours.get_mut(port) {
                (neighbour.state, neighbour.certified_dead) = (Some(State { pose, ..state }), true);
            }
            return self.look_again(now);
        }
        if let Some(neighbour) = self.neighbours.get_mut(port) {
            neighbour.state = Some(state);
        }
        if accepts_stale {
            self.neighbours.dead.remove(&state.id);
        }
        self.take_task(now, state.task);
        let known = self.own.filled;
        if state.task == self.own.task {
            self.own.filled = known.and(state.filled);
        }
        let is_same = |b: State| State { sequence: state.sequence, filled: state.filled, ..b } == state;
        let is_news = !before.is_some_and(is_same) || self.own.filled != known;
        if before.is_none() {
            // Contacts need not begin on both sides at once: what was told on this side may have come too
            // early on the other.
            self.greet(now, port);
        }
        if is_news {
            self.look_again(now);
        }
    }

    fn on_request(&mut self, now: Time, port: Port, request: Request) {
        let Request { origin, token, pose, sweep, ends, .. } = request;
        if self.neighbours.get(port).is_none() {
            return;
        }
        if token <= self.locks.over(port) {
            return hit(CoveragePoint::MetaRequestOver);
        }
        let denial = if self.locks.grant_of(port).is_some_and(|g| g.token == token) {
            hit(CoveragePoint::MetaRequestRepeated);
            None
        } else {
            let v = self.view(now);
            let own = self.requester.precedence(v, self.policy.rank());
            let (forgets, verdict) = (v.has(Defect::ForgetLocks), judge(v, &self.phase, own, &request));
            if matches!(verdict, Verdict::GrantedBefore) {
                hit(CoveragePoint::MetaYielded);
                self.requester.prevented += 1;
                self.requester.waits_for = Some(origin);
                self.back_off(now);
            }
            match verdict {
                Verdict::Denied(denial) => {
                    hit(denial.coverage_point());
                    Some(denial)
                }
                Verdict::Granted | Verdict::GrantedBefore => {
                    if !forgets {
                        let until = now + self.setup.params.lease;
                        self.locks.grant(port, Grant { token, pose, sweep, ends, until });
                    }
                    None
                }
            }
        };
        let message = Message::Response { from: self.own.id, token, denial };
        self.out.send(port, Class::Negotiation, message);
    }

    fn on_response(&mut self, now: Time, port: Port, from: ModuleId, denial: Option<Denial>) {
        let Some(denial) = denial else { return self.granted(now, port) };
        if matches!(self.phase, Phase::Asking(_)) {
            self.requester.prevented += u32::from(denial.is_collision());
            self.requester.waits_for = Some(from);
            self.back_off(now);
        }
    }

    fn on_release(&mut self, now: Time, port: Port, token: Token, pose: Pose) {
        let Some(neighbour) = self.neighbours.get_mut(port) else { return };
        if token > self.locks.over(port)
            && !neighbour.certified_dead
            && let Some(state) = &mut neighbour.state
        {
            // Its state says so too, but may come later.
            state.pose = pose;
        }
        if self.locks.release(port, token) {
            self.look_again(now);
        }
    }
}

/// Contacts and orders.
impl Metamodule {
    /// Begins a session on a port, or ends it, and forgets everything about the previous neighbour.
    fn begin_session(&mut self, port: Port, session: Option<Session>) {
        self.neighbours.begin(port, session);
        self.locks.begin(port);
        self.policy.forget(port);
    }

    pub(super) fn on_contact(&mut self, now: Time, port: Port, session: Option<Session>) {
        self.begin_session(port, session);
        if session.is_some() {
            self.greet(now, port);
            if let Some(path) = self.policy.announced() {
                self.out.send(port, Class::Liveness, Message::Path(path));
            }
            // The one that has come into range must be asked too.
            if matches!(self.phase, Phase::Asking(_)) {
                hit(CoveragePoint::MetaCameWhileAsking);
                self.stop(now, Span::ZERO);
            }
        } else if let Phase::Asking(attempt) = &mut self.phase
            && attempt.granted_by(port)
        {
            // One that has left the range need not be asked. But one that has restarted comes back at once,
            // and must be: it is known only in the next moment which of the two it is.
            attempt.again = now + Span(1);
        }
        self.look_again(now);
    }

    pub(super) fn on_order(&mut self, now: Time, order: Order) {
        match order {
            Order::Seeds { task, open, filled } => {
                self.take_task(now, task);
                let own = &mut self.own;
                if task == own.task {
                    if filled.holds(own.filled)
                        || self.setup.params.seed_authority == SeedAuthority::Controller
                    {
                        own.open = open;
                    }
                    own.filled = own.filled.and(filled);
                }
            }
            Order::Alive { id } => {
                self.neighbours.dead.remove(&id);
                if let Some((_, neighbour)) = self.neighbours.named(id) {
                    neighbour.certified_dead = false;
                }
            }
            Order::Obstacle { cell, there: true } => {
                hit(CoveragePoint::MetaObstacle);
                self.neighbours.obstacles.insert(cell);
            }
            Order::Obstacle { cell, there: false } => {
                self.neighbours.obstacles.remove(&cell);
            }
            Order::Steer { steering, until } => self.on_steering(now, steering, until),
            Order::Tune(tuning) => self.on_tuning(now, tuning),
            Order::Dead { id, pose } => self.on_death(now, id, pose),
            Order::Instruct { number, instruction } => {
                let is_news = self.with_policy(now, |policy, cx| policy.hear_order(cx, number, instruction));
                if is_news && matches!(self.phase, Phase::Asking(_)) {
                    self.stop(now, Span::ZERO);
                }
            }
        }
        self.look_again(now);
    }

    fn on_death(&mut self, now: Time, id: ModuleId, pose: Pose) {
        hit(CoveragePoint::MetaDeathTold);
        self.neighbours.dead.insert(id, pose);
        self.count_dead(now);
        let Some((port, neighbour)) = self.neighbours.named(id) else { return };
        neighbour.certified_dead = true;
        if let Some(state) = &mut neighbour.state {
            state.pose = pose;
        }
        self.locks.revoke(port);
        self.policy.forget(port);
        self.granted(now, port);
    }
}
