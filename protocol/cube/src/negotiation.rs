//! Local negotiation for a cell: requests along routes, consent, leases and deadlines.
//!
//! A module that wants to move asks every module along a route to stay where it is, and the last one also to keep
//! the destination cell free.
//! No module waits while it holds a lock: a request is granted or denied at once, so locks cannot deadlock.
//! Every grant ends by itself after the lease, and the mover's deadline is earlier than the end of every
//! grant, whatever the delay of the request was.

use super::Cube;
use super::lock_table::Lock;
use super::message::{Ask, Denial, Message, RequestId, Role};
use super::params::Connectivity;
use super::route::Route;
use alloc::vec::Vec;
use metamorph_core::agent::Output;
use metamorph_core::counters::Class;
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::defects::Defect;
use metamorph_core::ids::{ModuleId, Token};
use metamorph_core::lattice::{Cell, Face, Motion};
use metamorph_core::time::{Span, Time};

/// The largest number of requests of one attempt.
const MAX_REQUESTS: usize = 24;

/// One request of an attempt.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Request {
    pub route: Route,
    pub ask: Ask,
    pub granted: bool,
}

/// One intended move, and the requests that must all be granted before it starts.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Attempt {
    pub token: Token,
    pub motion: Motion,
    /// The latest start of the move.
    pub deadline: Time,
    /// When to give up waiting for answers.
    pub timeout: Time,
    pub requests: Vec<Request>,
    /// The search that has to end before locks are asked for (connecting cycles only).
    pub search: Option<super::cycles::SearchState>,
}

impl Cube {
    pub(super) fn begin_attempt(&mut self, now: Time, motion: Motion) {
        hit(CoveragePoint::CubeAsked);
        let token = self.tokens.next();
        let deadline = self.latest_start(now, motion).min(self.turn(now, motion).until);
        self.attempt = Some(Attempt {
            token,
            motion,
            deadline,
            timeout: Time::NEVER,
            requests: Vec::new(),
            search: None,
        });
        self.withdraw_gradient();
        self.planner.waiting_since.get_or_insert(now);
        if self.own.is_closed {
            return self.launch_if_granted(now);
        }
        if self.own.role == Role::Reserve
            && self.own.connectivity() == Connectivity::Cycles
            && !self.ask_for_cycles(now)
        {
            return;
        }
        self.ask_for_destination(now);
    }

    /// Asks for the destination of the attempt's motion.
    pub(super) fn ask_for_destination(&mut self, now: Time) {
        use metamorph_core::lattice::MotionKind::{Convex, Slide};
        let Some(Attempt { motion, .. }) = self.attempt else { return };
        if self.sides.is_certified_dead(motion.support) {
            // It grants nothing, and does not leave.
            return self.launch_if_granted(now);
        }
        let (hops, face): (&[Face], Face) = match motion.kind {
            Slide => (&[motion.support, motion.heading], motion.support.opposite()),
            Convex => (&[motion.support], motion.heading),
        };
        let route = Route::new(hops).expect("invariant: one or two hops are a route");
        self.ask(now, route, Ask::Reserve(face));
    }

    /// Sends one request of the current attempt.
    pub(super) fn ask(&mut self, now: Time, route: Route, ask: Ask) {
        let Some(attempt) = &mut self.attempt else { return };
        if attempt.requests.len() == MAX_REQUESTS {
            hit(CoveragePoint::CubeTooManyRequests);
            return self.abort_attempt(now, None);
        }
        let id =
            RequestId { origin: self.own.id, token: attempt.token, number: attempt.requests.len() as u8 };
        attempt.requests.push(Request { route, ask, granted: false });
        let first = attempt.requests.len() == 1;
        let answer = now + self.own.params().answer_over(route.hop_count());
        if let Some(attempt) = &mut self.attempt {
            attempt.timeout = if first { answer } else { attempt.timeout.max(answer) };
        }
        self.send_request(now, id, route, ask);
    }

    fn send_request(&mut self, now: Time, id: RequestId, route: Route, ask: Ask) {
        let age = now.since(self.planner.waiting_since.unwrap_or(now));
        let class = if ask == Ask::Lock { Class::Connectivity } else { Class::Negotiation };
        if let Some(first) = route.hop(0) {
            self.out.send(&self.sides, first, class, Message::Request { id, age, hop: 1, ask, route });
        }
    }

    /// Repeats the requests that have not been answered. Returns false if no answer could arrive before the deadline.
    /// A module that has already granted such a request confirms the grant without extending its lease, or repeats it to the
    /// next one. Without repetition, the loss of a single message would fail the whole attempt.
    fn ask_again(&mut self, now: Time) -> bool {
        let Some(attempt) = &self.attempt else { return false };
        let open: Vec<(RequestId, Route, Ask)> = (0u8..)
            .zip(&attempt.requests)
            .filter(|(_, r)| !r.granted)
            .map(|(number, r)| {
                (RequestId { origin: self.own.id, token: attempt.token, number }, r.route, r.ask)
            })
            .collect();
        let Some(longest) = open.iter().map(|(_, route, _)| route.hop_count()).max() else { return false };
        let p = self.own.params();
        let (answer, earliest) = (now + p.answer_over(longest), now + p.answer_over(1));
        let hopeless = open.iter().any(|(_, r, _)| r.hop(0).is_none_or(|f| self.sides.live(f).is_none()));
        if earliest > attempt.deadline || hopeless {
            return false;
        }
        hit(CoveragePoint::CubeAskedAgain);
        if let Some(attempt) = &mut self.attempt {
            attempt.timeout = answer;
        }
        for (id, route, ask) in open {
            self.send_request(now, id, route, ask);
        }
        true
    }

    #[allow(clippy::too_many_arguments, reason = "the fields of the message")]
    pub(super) fn on_request(
        &mut self,
        now: Time,
        from: Face,
        id: RequestId,
        age: Span,
        hop: u8,
        ask: Ask,
        route: Route,
    ) {
        let depth = usize::from(hop);
        if route.hop(depth - 1).map(Face::opposite) != Some(from) {
            return;
        }
        let next = route.hop(depth);
        // A repeated request: an answer was lost on the way back from here.
        if let Some(co_owners) = self.locks.find(id).and_then(|l| l.beyond) {
            hit(CoveragePoint::CubeRequestRepeated);
            return self.answer(from, id, hop - 1, None, None, co_owners, route);
        }
        let is_last = route.hop(depth + 1).is_none();
        let verdict = self.consider(now, id, age, (next, is_last), ask);
        match (verdict, next) {
            (Err((denial, blocker)), _) => {
                hit(denial.coverage_point());
                self.answer(from, id, hop - 1, Some(denial), blocker, 0, route);
            }
            (Ok(()), Some(next)) if self.sides.is_certified_dead(next) => {
                // The last module of a route needs no lock if it is dead, and keeps no cell free. Another one has died since
                // this module gave its lock: those behind it are not asked, or cannot answer.
                let stays = if is_last { self.locks.granted_beyond(id, 0) } else { !self.locks.withdraw(id) };
                if stays {
                    hit(CoveragePoint::CubeLandsOnDead);
                }
                let denial = (!stays).then_some(Denial::NoSupport);
                self.answer(from, id, hop - 1, denial, None, 0, route);
            }
            // It is repeated from here, when that is due.
            (Ok(()), Some(_)) if self.relays.is_open(id) => {}
            (Ok(()), Some(next)) => {
                let class = if ask == Ask::Lock { Class::Connectivity } else { Class::Negotiation };
                let message = Message::Request { id, age, hop: hop + 1, ask, route };
                self.out.send(&self.sides, next, class, message);
                let again = now + self.own.params().answer_over(route.hop_count() - depth);
                self.relays.add(id, next, message, again);
            }
            (Ok(()), None) => {
                let co_owners = match ask {
                    Ask::Reserve(face) => self.co_owners(face),
                    Ask::Lock => 0,
                };
                self.answer(from, id, hop - 1, None, None, co_owners, route);
            }
        }
    }

    /// Grants a request, which may be a repeated one, or returns the reason for the denial and the module in the way.
    /// `next` is the face over which it is passed on, and whether the neighbour there is the last of the route.
    pub(super) fn consider(
        &mut self,
        now: Time,
        id: RequestId,
        age: Span,
        (next, is_last): (Option<Face>, bool),
        ask: Ask,
    ) -> Result<(), (Denial, Option<ModuleId>)> {
        if self.locks.find(id).is_some() {
            hit(CoveragePoint::CubeRequestRepeated);
            return Ok(());
        }
        if self.own.role == Role::Walker || id.origin == self.own.id {
            return Err((Denial::NoSupport, None));
        }
        if self.locks.is_full() {
            hit(CoveragePoint::CubeDeniedFull);
        }
        if self.moving.is_some() || self.locks.is_full() {
            return Err((Denial::Busy, Some(self.own.id)));
        }
        if self.own.is_quarantined(now) {
            return Err((Denial::Quarantined, Some(self.own.id)));
        }
        if let Some(attempt) = &self.attempt {
            let mine = now.since(self.planner.waiting_since.unwrap_or(now));
            // A search may take long and fail; a module that knows its route goes first.
            let theirs_first =
                attempt.search.is_some() || age > mine || (age == mine && id.origin < self.own.id);
            if !theirs_first {
                return Err((Denial::Younger, Some(self.own.id)));
            }
        }
        let mut reserved = None;
        match (next, ask) {
            // A module that is called over the dead lands on one.
            (Some(next), Ask::Reserve(_)) if is_last && self.sides.is_certified_dead(next) => {}
            (Some(next), _) => {
                if self.sides.support(next).is_none() {
                    return Err((Denial::NoSupport, self.sides.peer(next).map(|b| b.id)));
                }
            }
            (None, Ask::Reserve(face)) => {
                if self.sides.is_touching(face) {
                    return Err((Denial::Occupied, self.sides.peer(face).map(|b| b.id)));
                }
                let other = self.locks.reserved_for_other(face, id.origin);
                if other.is_some() && !self.own.has(Defect::ReserveTwice) {
                    return Err((Denial::Reserved, other));
                }
                reserved = Some(face);
            }
            (None, Ask::Lock) => {}
        }
        // A module that stays for another does not leave itself.
        if self.attempt.is_some() {
            hit(CoveragePoint::CubeYielded);
        }
        self.abort_attempt(now, Some(id.origin));
        let expires = match self.own.params().defect {
            Some(Defect::ShortLease) => now + self.own.params().move_time,
            Some(Defect::KeepLocks) => Time::NEVER,
            _ => now + self.own.params().keep_for(),
        };
        self.locks.grant(Lock { id, expires, next, reserved, beyond: None });
        if reserved.is_some() {
            // Walkers are told that the cell is taken.
            self.beacons.invalidate();
        }
        Ok(())
    }

    /// Returns the directions of the neighbours that have a module on their own `face`. Such a module touches the
    /// cell outside `face` of this one.
    fn co_owners(&self, face: Face) -> u8 {
        let touches = |u: &Face| self.sides.support(*u).is_some_and(|b| b.supports & face.bit() != 0);
        Face::mask(face.perpendicular().into_iter().filter(touches))
    }

    #[allow(clippy::too_many_arguments, reason = "the fields of the message")]
    fn answer(
        &mut self,
        to: Face,
        id: RequestId,
        hop: u8,
        denial: Option<Denial>,
        blocker: Option<ModuleId>,
        co_owners: u8,
        route: Route,
    ) {
        let message = Message::Response { id, hop, denial, blocker, co_owners, route };
        self.out.send(&self.sides, to, Class::Negotiation, message);
    }

    pub(super) fn on_response(&mut self, now: Time, from: Face, message: Message) {
        let Message::Response { id, hop, denial, blocker, co_owners, route } = message else { return };
        let depth = usize::from(hop);
        if route.hop(depth) != Some(from) {
            return;
        }
        if depth > 0 {
            // A grant says that all modules from here on stay, so it is passed back only with a lock, and from then on no
            // denial ends that lock: a request is repeated, so a grant may follow a denial or be overtaken by one.
            let is_passed_back = match denial {
                Some(_) => self.locks.withdraw(id),
                None => self.locks.granted_beyond(id, co_owners),
            };
            if !is_passed_back {
                hit(CoveragePoint::CubeAnswerOvertaken);
                return;
            }
            if let Some(back) = route.hop(depth - 1).map(Face::opposite) {
                self.answer(back, id, hop - 1, denial, blocker, co_owners, route);
            }
            return;
        }
        let Some(attempt) = self.attempt.as_mut().filter(|a| a.token == id.token && id.origin == self.own.id)
        else {
            return;
        };
        let Some(request) = attempt.requests.get_mut(usize::from(id.number)) else { return };
        if let Some(denial) = denial {
            self.prevented += u32::from(denial.is_collision());
            return self.abort_attempt(now, blocker);
        }
        if core::mem::replace(&mut request.granted, true) {
            return;
        }
        let (ask, route) = (request.ask, request.route);
        // Only the module first asked for the cell names the others that touch it.
        let first_of_its_kind = attempt.requests.iter().filter(|r| r.ask != Ask::Lock).count() == 1;
        if let Ask::Reserve(face) = ask
            && first_of_its_kind
            && self.own.params().co_owners
        {
            self.ask_co_owners(now, route, face, co_owners);
        }
        self.launch_if_granted(now);
    }

    fn ask_co_owners(&mut self, now: Time, route: Route, face: Face, mask: u8) {
        let grantor = route.faces().fold(Cell::default(), |at, f| at + f.offset());
        for u in face.perpendicular().into_iter().filter(|u| mask & u.bit() != 0) {
            let at = grantor + u.offset() + face.offset();
            // A route that closes on itself would ask the mover for its own consent.
            if at == Cell::default() {
                continue;
            }
            if let Some(route) = route.then(u).and_then(|r| r.then(face)) {
                self.ask(now, route, Ask::Reserve(u.opposite()));
            }
        }
    }

    pub(super) fn launch_if_granted(&mut self, now: Time) {
        let ready = self.attempt.as_ref().is_some_and(|a| {
            let needs_none = self.own.is_closed || self.sides.is_certified_dead(a.motion.support);
            let is_asked = needs_none || !a.requests.is_empty();
            a.search.is_none() && is_asked && a.requests.iter().all(|r| r.granted)
        });
        if !ready {
            return;
        }
        let is_checked = self.own.role == Role::Reserve && !self.own.is_closed;
        let held = if is_checked { self.may_leave(now).err() } else { None };
        let fenced = !self.own.has(Defect::NoDeadline);
        let late = fenced && self.attempt.as_ref().is_some_and(|a| now > a.deadline);
        // A neighbour may have fallen silent meanwhile.
        let turn = self.attempt.as_ref().map(|a| self.turn(now, a.motion));
        let is_its_turn = turn.is_some_and(|turn| turn.from <= now && now <= turn.until);
        // Or another module have come to rest on this one.
        if !is_its_turn || (!self.own.is_closed && self.may_carry(now)) {
            hit(CoveragePoint::CubeOutOfTurn);
            return self.abort_attempt(now, None);
        }
        if held.is_some() || late {
            hit(if late { CoveragePoint::CubeTooLate } else { CoveragePoint::CubeHeldAtLaunch });
            return self.abort_attempt(now, held.and_then(|h| h.0));
        }
        if let Some(attempt) = self.attempt.take() {
            let motion = attempt.motion;
            let until = turn.map_or(Time::NEVER, |turn| turn.until);
            let not_after = if fenced { attempt.deadline.min(until) } else { Time::NEVER };
            self.out.push(Output::Act(super::Move { motion, not_after }));
            self.moving = Some(attempt);
            self.invalidate();
        }
    }

    /// Repeats what has been passed on for others and not been answered.
    pub(super) fn repeat_for_others(&mut self, now: Time) {
        self.relays.drop_settled(|id| self.locks.find(id).is_some_and(|lock| lock.beyond.is_none()));
        self.deny_cut_off();
        let interval = self.own.params().answer_over(1);
        let (out, sides) = (&mut self.out, &self.sides);
        self.retransmission.tend(now, interval, |face, message| {
            hit(CoveragePoint::CubeSearchRepeated);
            out.send(sides, face, Class::Connectivity, message);
        });
        self.relays.tend(now, interval, |face, message| {
            hit(CoveragePoint::CubeRelayRepeated);
            let is_lock = matches!(message, Message::Request { ask: Ask::Lock, .. });
            let class = if is_lock { Class::Connectivity } else { Class::Negotiation };
            out.send(sides, face, class, message);
        });
    }

    /// Denies the requests that were passed on to a module which has left before it has answered.
    fn deny_cut_off(&mut self) {
        for message in self.relays.take_cut_off(|face| self.sides.is_touching(face)) {
            let Message::Request { id, hop, route, .. } = message else { continue };
            hit(CoveragePoint::CubeRelayCutOff);
            // Those that all others have granted are not open any more.
            if !self.locks.withdraw(id) {
                continue;
            }
            let before = usize::from(hop) - 2;
            if let Some(back) = route.hop(before).map(Face::opposite) {
                self.answer(back, id, before as u8, Some(Denial::NoSupport), None, 0, route);
            }
        }
    }

    /// Handles the time-out of the current attempt: widens its search or repeats its requests, and aborts it if
    /// neither is possible.
    pub(super) fn tend_attempt(&mut self, now: Time) {
        let waited = self.attempt.as_ref().filter(|a| now >= a.timeout).map(|a| a.search.is_some());
        let Some(searches) = waited else { return };
        let goes_on = if searches { self.widen_search(now) } else { self.ask_again(now) };
        if !goes_on {
            hit(CoveragePoint::CubeTimedOut);
            self.abort_attempt(now, None);
        }
    }

    /// Aborts the current attempt: releases its grants and backs off. `blocker` is the module in the way, if known.
    pub(super) fn abort_attempt(&mut self, now: Time, blocker: Option<ModuleId>) {
        if let Some(attempt) = self.attempt.take() {
            self.surveyor.on_failed(self.own.cell, attempt.motion, false);
            self.give_back(&attempt);
            self.planner.waits_for = blocker;
            self.planner.count_denial();
            self.planner.back_off(now, self.own.params(), &mut self.rng);
            self.withdraw_gradient();
        }
    }

    /// Makes the next beacons say that this module withdraws from the connection gradient or is part of it again, by the
    /// published rule ([`ParentForest::told_rank`](super::parent_forest::ParentForest::told_rank)).
    fn withdraw_gradient(&mut self) {
        if self.own.connectivity() == Connectivity::Gradient {
            self.beacons.invalidate();
        }
    }

    /// Releases the grants of an attempt: sends one release over each face that its requests left by.
    pub(super) fn give_back(&mut self, attempt: &Attempt) {
        let mut told = 0u8;
        for first in attempt.requests.iter().filter_map(|r| r.route.hop(0)) {
            if told & first.bit() == 0 {
                told |= first.bit();
                let message = Message::Release { origin: self.own.id, token: attempt.token };
                self.out.send(&self.sides, first, Class::Negotiation, message);
            }
        }
    }

    /// Drops the locks that `which` selects and all others of the same attempts, and passes the releases on.
    pub(super) fn release_locks(&mut self, which: impl Fn(&Lock) -> bool) {
        if self.own.has(Defect::KeepLocks) {
            return;
        }
        let reservations = self.locks.reservation_count();
        for (next, origin, token) in self.locks.release(which) {
            hit(CoveragePoint::CubeReleaseForwarded);
            self.out.send(&self.sides, next, Class::Negotiation, Message::Release { origin, token });
        }
        if self.locks.reservation_count() != reservations {
            self.beacons.invalidate();
        }
    }
}
