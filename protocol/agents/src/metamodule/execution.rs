//! Asking for the lock of a motion, and carrying the motion out.

use super::agent::{Metamodule, STUCK_FOR};
use super::locks::Requester;
use super::message::{Message, Percept};
use super::phase::{Attempt, Motion, Next, Phase, Progress, Setback};
use super::plan::Plan;
use super::pose::Pose;
use super::view::View;
use metamorph_core::counters::Class;
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::ids::Port;
use metamorph_core::lattice::Cell;
use metamorph_core::time::{Span, Time};

/// Asking for locks.
impl Metamodule {
    pub(super) fn ask(&mut self, now: Time, plan: Plan) {
        let pending = Requester::ports_to_ask(self.view(now));
        self.requester.token.0 += 1;
        if pending.is_empty() {
            return self.begin(now, now, plan);
        }
        let again = now + self.setup.params.resend;
        self.phase = Phase::Asking(Attempt { plan, pending, asked: now, again });
        self.send_requests(now);
    }

    /// Sends the request to all that have not answered.
    fn send_requests(&mut self, now: Time) {
        let Phase::Asking(attempt) = &self.phase else { return };
        let message = self.requester.request(self.view(now), self.policy.rank(), &attempt.plan);
        for port in attempt.pending.iter() {
            self.out.send(port, Class::Negotiation, message);
        }
    }

    /// Begins the motion if all have answered, and repeats the request otherwise.
    pub(super) fn ask_again(&mut self, now: Time) {
        let Phase::Asking(attempt) = &mut self.phase else { return };
        if attempt.pending.is_empty() {
            return self.set_out(now);
        }
        hit(CoveragePoint::MetaResent);
        attempt.again = now + self.setup.params.resend;
        self.send_requests(now);
    }

    /// Notes that the neighbour on a port has granted the lock, or that its grant is no longer needed.
    pub(super) fn granted(&mut self, now: Time, port: Port) {
        if let Phase::Asking(attempt) = &mut self.phase
            && attempt.granted_by(port)
        {
            self.set_out(now);
        }
    }

    /// Begins the motion that all have granted. Backs off instead if the strategy now objects to it, or if a dead body
    /// is in its way.
    fn set_out(&mut self, now: Time) {
        let Phase::Asking(attempt) = &self.phase else { return };
        let v = self.view(now);
        // Others have set out meanwhile, or have died in a place that is known only now.
        if self.policy.objects_to(v, &attempt.plan) || meets_the_dead(v, &attempt.plan) {
            return self.back_off(now);
        }
        let (asked, plan) = (attempt.asked, attempt.plan.clone());
        self.begin(now, asked, plan);
    }

    /// Begins a motion whose lock was asked for at `asked`.
    pub(super) fn begin(&mut self, now: Time, asked: Time, plan: Plan) {
        self.requester.waits_for = None;
        self.phase = Phase::Moving(Motion::new(plan, asked, self.setup.params.lease));
        self.go_on(now);
    }

    /// Gives an attempt up for now.
    pub(super) fn back_off(&mut self, now: Time) {
        let rest = self.requester.back_off(self.setup.params.back_off);
        self.stop(now, rest);
    }

    /// Ends a motion or an attempt, tells all, and looks for something else after `rest`.
    pub(super) fn stop(&mut self, now: Time, rest: Span) {
        let over = std::mem::replace(&mut self.phase, Phase::Idle { look_at: now + rest });
        self.requester.rest_until = now + rest;
        if matches!(over, Phase::Moving(_)) {
            self.tell(now, Class::Gradient);
        }
        if !matches!(over, Phase::Idle { .. }) {
            let (origin, token, pose) = (self.own.id, self.requester.token, self.own.pose);
            let message = Message::Release { origin, token, pose };
            self.say(now, |v, out| out.broadcast(v, Class::Negotiation, message));
        }
    }
}

/// Moving.
impl Metamodule {
    /// Asks the body for the next action of the motion, or ends the motion.
    fn go_on(&mut self, now: Time) {
        let Phase::Moving(motion) = &self.phase else { return };
        match motion.next(self.view(now)) {
            Next::Act(action) => self.out.act(action),
            Next::Settled => self.settle(now),
            Next::Shifted => {
                self.policy.on_motion(false);
                self.stop(now, Span::ZERO);
            }
            // Where the metamodule is now is a place like any other.
            Next::LockRunsOut => self.stop(now, Span::ZERO),
        }
    }

    fn settle(&mut self, now: Time) {
        // The task may have changed on the way.
        if let Some(seed) = self.view(now).settles_in(self.own.pose) {
            (self.own.settled, self.own.steered) = (Some(seed), None);
            self.own.filled = self.own.filled.with(seed);
        }
        self.retire(now);
        self.requester.waiting_since = now;
        self.stop(now, Span::ZERO);
    }

    pub(super) fn on_percept(&mut self, now: Time, percept: Percept) {
        // Drawn however the action went: what is drawn later does not depend on it.
        let rest = self.requester.back_off(self.setup.params.back_off);
        if let Percept::Done(pose) = percept {
            return self.on_done(now, pose);
        }
        let Phase::Moving(motion) = &mut self.phase else { return };
        match motion.on_failure(percept) {
            Setback::Retry => self.go_on(now),
            Setback::GiveUp => self.stop(now, rest),
            Setback::Stuck => {
                self.own.stuck = Some(now + self.setup.params.patience * STUCK_FOR);
                self.retire(now);
                self.stop(now, rest);
            }
        }
    }

    fn on_done(&mut self, now: Time, pose: Pose) {
        let before = std::mem::replace(&mut self.own.pose, pose);
        let Phase::Moving(motion) = &mut self.phase else {
            if before != pose {
                // An action of an earlier incarnation has ended.
                hit(CoveragePoint::MetaEarlierLifeActed);
                self.tell(now, Class::Gradient);
                self.look_again(now);
            }
            return;
        };
        match motion.on_done(pose) {
            Progress::Turned => {
                self.own.stuck = None;
                self.go_on(now);
            }
            Progress::Gripped => self.go_on(now),
            Progress::Moved => {
                self.policy.on_motion(true);
                self.requester.waiting_since = now;
                self.stop(now, Span::ZERO);
            }
        }
    }
}

/// Whether a dead body stands in the way of a motion.
fn meets_the_dead(v: View<'_>, plan: &Plan) -> bool {
    let dead: Vec<Cell> = v.neighbours.dead.values().flat_map(|pose| v.setup.occupied(*pose)).collect();
    plan.cells(v.setup).any(|cell| dead.contains(&cell))
}
