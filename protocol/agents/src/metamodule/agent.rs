//! The agent of a metamodule: what an input means for which part, and in which order the parts work.

use super::blueprint::{SeedSet, Task};
use super::detector::DeadlockDetector;
use super::locks::{LockTable, Requester};
use super::message::{Action, Message, Order, Percept, Status};
use super::neighbour_table::NeighbourTable;
use super::outbox::Outbox;
use super::params::Strategy;
use super::phase::Phase;
use super::plan::{JointTrial, Plan};
use super::pose::Pose;
use super::setup::Setup;
use super::steering::Steering;
use super::strategy::Policy;
use super::strategy::context::{Context, Decision};
use super::tuning::Tuning;
use super::view::{Own, View};
use metamorph_core::agent::{Agent, Birth, Input, InputOf, OutputOf, Summary};
use metamorph_core::counters::Class;
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::ids::{Port, PortSet, Token};
use metamorph_core::rng::Rng;
use metamorph_core::time::Time;
use std::hash::{Hash, Hasher};
use std::sync::Arc;

/// The time for which stuck joints rest before they are tried again, in multiples of `patience`.
pub(super) const STUCK_FOR: u64 = 3;

/// A metamodule's agent.
#[derive(Clone, Debug)]
pub struct Metamodule {
    pub(super) setup: Arc<Setup>,
    pub(super) own: Own,
    pub(super) neighbours: NeighbourTable,
    /// The locks granted to neighbours.
    pub(super) locks: LockTable,
    /// The locks requested from neighbours.
    pub(super) requester: Requester,
    pub(super) phase: Phase,
    pub(super) policy: Policy,
    pub(super) detector: DeadlockDetector,
    pub(super) out: Outbox,
    /// The parameters that a command has changed.
    pub(super) tuned: Option<Tuning>,
}

/// All of its state, unlike [`Agent::digest`]: two that hash alike do the same from now on.
impl Hash for Metamodule {
    fn hash<H: Hasher>(&self, hasher: &mut H) {
        let Metamodule { setup: _, own, neighbours, locks, requester, phase, policy, detector, out, tuned } =
            self;
        (own, neighbours, locks, requester).hash(hasher);
        (phase, policy, detector, out, tuned).hash(hasher);
    }
}

/// Timers of an agent, by their purpose.
#[derive(Clone, Copy, Debug)]
enum Timer {
    /// The next repetition of the state.
    Repeat,
    /// The next look for something to do.
    Look,
    /// Answers to a request.
    Answers,
    /// The next wave of the deadlock detector, or the next repetition of a question.
    Detector,
}

impl Timer {
    /// In the order in which they fire.
    const ALL: [Timer; 4] = [Timer::Repeat, Timer::Look, Timer::Answers, Timer::Detector];
}

impl Agent for Metamodule {
    type Setup = Setup;
    type Place = Pose;
    type Message = Message;
    type Action = Action;
    type Percept = Percept;
    type Order = Order;
    type Report = Status;

    /// The number of ports: as many as a set of ports can hold.
    const PORTS: usize = PortSet::CAPACITY;

    fn new(setup: &Arc<Setup>, birth: Birth<Pose>, now: Time) -> Metamodule {
        let restarted = birth.incarnation.0 > 0;
        let quarantine_until = if restarted { now + setup.params.lease } else { now };
        let mut agent = Metamodule {
            setup: Arc::clone(setup),
            own: Own {
                id: birth.id,
                pose: birth.place,
                task: Task::default(),
                open: SeedSet::default(),
                filled: SeedSet::default(),
                settled: None,
                stuck: None,
                steered: None,
                quarantine_until,
            },
            neighbours: NeighbourTable::default(),
            locks: LockTable::default(),
            requester: Requester {
                // Tokens of a later incarnation are larger than any of an earlier one.
                token: Token(u32::from(birth.incarnation.0) << 20),
                waiting_since: now,
                rest_until: quarantine_until,
                waits_for: None,
                prevented: 0,
                rng: Rng::named(birth.seed, "metamodule", u64::from(birth.id.0)),
            },
            phase: Phase::Idle { look_at: now.max(quarantine_until) },
            policy: Policy::new(setup.params.strategy),
            detector: DeadlockDetector::new(birth.incarnation),
            out: Outbox::new(now + setup.params.repeat),
            tuned: None,
        };
        agent.report();
        agent
    }

    fn handle(&mut self, now: Time, input: InputOf<Metamodule>) {
        match input {
            Input::Contact { port, session } => self.on_contact(now, port, session),
            Input::Message { port, message } => self.on_message(now, port, message),
            Input::Percept(percept) => self.on_percept(now, percept),
            Input::Order(order) => self.on_order(now, order),
            Input::Wake => {
                let fired = Timer::ALL.map(|timer| (timer, now >= self.due(timer)));
                fired.into_iter().filter(|(_, is_due)| *is_due).for_each(|(t, _)| self.fire(now, t));
            }
        }
        let v = View {
            now,
            setup: &self.setup,
            own: &self.own,
            neighbours: &self.neighbours,
            locks: &self.locks,
        };
        self.detector.tend(v, &self.phase, &mut self.out);
        self.report();
    }

    fn poll(&mut self) -> Option<OutputOf<Metamodule>> {
        self.out.poll()
    }

    fn wake_at(&self) -> Time {
        Timer::ALL.into_iter().map(|timer| self.due(timer)).min().unwrap_or(Time::NEVER)
    }

    fn reseed(&mut self, seed: u64) {
        self.requester.rng = Rng::named(seed, "metamodule", self.own.id.0.into());
    }

    fn digest(&self, hasher: &mut dyn Hasher) {
        self.digest_state(hasher);
    }

    fn summary(&self, _now: Time) -> Summary {
        self.summarize()
    }
}

/// Between the parts.
impl Metamodule {
    pub(super) fn view(&self, now: Time) -> View<'_> {
        let Metamodule { setup, own, neighbours, locks, .. } = self;
        View { now, setup, own, neighbours, locks }
    }
    /// Runs `work` on the strategy, with the context of this step.
    pub(super) fn with_policy<T>(
        &mut self,
        now: Time,
        work: impl FnOnce(&mut Policy, &mut Context<'_>) -> T,
    ) -> T {
        let Metamodule { setup, own, neighbours, locks, requester, policy, out, .. } = self;
        let v = View { now, setup, own, neighbours, locks };
        work(policy, &mut Context { v, out, waiting_since: &mut requester.waiting_since })
    }
    /// Runs `say` on the outbox, with a view of the other parts.
    pub(super) fn say(&mut self, now: Time, say: impl FnOnce(View<'_>, &mut Outbox)) {
        let Metamodule { setup, own, neighbours, locks, out, .. } = self;
        say(View { now, setup, own, neighbours, locks }, out);
    }
    pub(super) fn tell(&mut self, now: Time, class: Class) {
        let advertised = self.policy.advertised();
        self.say(now, |v, out| out.tell(v, advertised, class));
    }
    pub(super) fn greet(&mut self, now: Time, port: Port) {
        let advertised = self.policy.advertised();
        self.say(now, |v, out| out.greet(v, advertised, port));
    }
    pub(super) fn retire(&mut self, now: Time) {
        self.with_policy(now, |policy, cx| policy.retire(cx));
    }
    fn report(&mut self) {
        let is_planned = self.setup.params.strategy == Strategy::Planned;
        self.out.report(Status {
            pose: self.own.pose,
            settled: self.own.settled,
            prevented: self.requester.prevented,
            waits_for: self.requester.waits_for,
            unreachable: self.policy.advertised().unreachable,
            deadlocked: self.detector.deadlocked,
            busy: is_planned && self.is_busy(),
            stuck: is_planned && self.own.stuck.is_some(),
        });
    }

    /// Whether it moves or is about to.
    fn is_busy(&self) -> bool {
        self.own.pose.both || !matches!(self.phase, Phase::Idle { .. })
    }

    /// Returns when the event of a timer is due.
    fn due(&self, timer: Timer) -> Time {
        match (timer, &self.phase) {
            (Timer::Repeat, _) => self.out.repeat_at,
            (Timer::Look, Phase::Idle { look_at }) => *look_at,
            (Timer::Answers, Phase::Asking(attempt)) => attempt.again,
            (Timer::Look | Timer::Answers, _) => Time::NEVER,
            (Timer::Detector, _) => self.detector.due(),
        }
    }
    fn fire(&mut self, now: Time, timer: Timer) {
        match timer {
            Timer::Repeat => {
                self.tell(now, Class::Liveness);
                self.with_policy(now, |policy, cx| policy.repeat(cx));
            }
            Timer::Look => self.look(now),
            Timer::Answers => self.ask_again(now),
            // It is tended to after every input.
            Timer::Detector => {}
        }
    }
}

/// The decision about the next action.
impl Metamodule {
    /// Makes an idle metamodule look for something to do, because something new is known: at once or, during a
    /// back-off, at its end.
    pub(super) fn look_again(&mut self, now: Time) {
        let rest = self.requester.rest_until;
        if let Phase::Idle { look_at } = &mut self.phase {
            *look_at = (*look_at).min(now.max(rest));
        }
    }

    /// Looks for something to do.
    fn look(&mut self, now: Time) {
        let next_expiry = self.locks.expire(now);
        let (v, idle) = (self.view(now), |look_at| Phase::Idle { look_at });
        if let Some(plan) = self.policy.handling(v) {
            // It sweeps no cell, so there is nothing to be granted.
            self.begin(now, now, plan);
        } else if self.own.settled.is_some() {
            self.phase = idle(Time::NEVER);
        } else if now < self.own.quarantine_until {
            self.phase = idle(self.own.quarantine_until);
        } else if let Some(seed) = v.settles_in(self.own.pose).filter(|s| self.own.filled.has(*s)) {
            // It is known to be filled, and no other one can be in its cells: an earlier incarnation did it.
            hit(CoveragePoint::MetaEarlierLifeSettled);
            self.own.settled = Some(seed);
            self.retire(now);
            self.phase = idle(Time::NEVER);
            self.tell(now, Class::Gradient);
        } else if self.own.pose.both {
            // An earlier incarnation has gripped and not released.
            hit(CoveragePoint::MetaEarlierLifeGripped);
            self.begin(now, now, Plan::let_go(self.own.pose));
        } else if v.any_unheard() {
            self.phase = idle(Time::NEVER);
        } else if let Some(again) = self.own.stuck {
            self.phase = idle(again);
            if now >= again {
                self.try_joints(now);
            }
        } else {
            let steered = self.steer(now, next_expiry);
            let look = |policy: &mut Policy, cx: &mut Context<'_>| policy.look(cx, next_expiry);
            match steered.unwrap_or_else(|| self.with_policy(now, look)) {
                Decision::Ask(plan) => self.ask(now, plan),
                Decision::Wait(until) => self.phase = idle(until),
                Decision::WaitFor(first, until) => {
                    self.requester.waits_for = first;
                    self.phase = idle(until);
                }
            }
        }
    }

    /// Tries whether stuck joints turn again.
    fn try_joints(&mut self, now: Time) {
        hit(CoveragePoint::MetaJointsTried);
        let v = self.view(now);
        let mut taken = v.fixed();
        taken.extend(v.neighbours.states().flat_map(|(_, s)| v.setup.occupied(s.pose)));
        taken.extend(v.locks.cells(v.setup));
        let trial = JointTrial::find(&v.ground(&taken), v.own.pose);
        let later = now + v.params().patience * STUCK_FOR;
        let (again, plan) = match trial {
            Some(JointTrial::Turn(plan)) => (later, Some(plan)),
            Some(JointTrial::OtherEnd(plan)) => (now, Some(plan)),
            None => (later, None),
        };
        self.own.stuck = Some(again);
        if let Some(plan) = plan {
            self.ask(now, plan);
        }
    }

    /// Takes up another task.
    pub(super) fn take_task(&mut self, now: Time, task: Task) {
        if task.epoch <= self.own.task.epoch {
            return;
        }
        let own = &mut self.own;
        (own.task, own.open, own.filled) = (task, SeedSet::default(), SeedSet::default());
        // The seed that it was to take belongs to the task before.
        own.steered.take_if(|s| matches!(s.steering, Steering::Take(_)));
        self.with_policy(now, |policy, cx| policy.on_task(cx));
        let was_settled = self.own.settled.take().is_some();
        let settled = self.view(now).settles_in(self.own.pose).filter(|_| was_settled);
        if let Some(seed) = settled {
            self.own.settled = settled;
            hit(CoveragePoint::MetaStaysForNewTask);
            self.own.filled = self.own.filled.with(seed);
        }
        self.count_dead(now);
        self.requester.waiting_since = now;
        self.tell(now, Class::Gradient);
        self.look_again(now);
    }

    /// Notes the seeds that dead bodies fill: these stay filled, but no process is left to tell so.
    pub(super) fn count_dead(&mut self, now: Time) {
        let v = self.view(now);
        let filled = v.neighbours.dead.values().filter_map(|pose| v.seed_filled_in(*pose));
        self.own.filled = filled.fold(v.own.filled, SeedSet::with);
    }
}
