//! The director of a walking structure: injects faults, hands out gaits, has others tried when modules die or the
//! structure becomes slow, and decides how the run ends.

use super::goal::Goal;
use super::measure::{Measure, Movement, WINDOW};
use super::reasons::{DEAD, NO_JOINT, SLOW, STILL};
use super::tuner::{Gait, Tuner};
use crate::director::fault_injector::FaultInjector;
use crate::director::faults::{Fault, FaultRecord, Schedule};
use crate::director::outcome::{Objective, Outcome, Stall, Waiter};
use crate::director::port::DirectorPort;
use crate::director::progress::{Progress, Stage, Stop};
use crate::free_module::members::Members;
use crate::free_module::physics::Physics;
use crate::free_module::physics_world::PhysicsWorld;
use crate::free_module::trial::REST;
use metamorph_protocol::free_module::gait::body::Status;
use metamorph_protocol::free_module::gait::message::{Gait as GaitOrder, Order};
use metamorph_protocol::free_module::oscillator::STEP;
use metamorph_protocol::free_module::structure::Joint;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::record::Outside;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::{Span, Time};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// The time between two looks at the structure.
const LOOK: Span = Span::millis(100);
/// The longest time that agents may take to agree on their structure.
const AGREE: Span = Span::secs(10);
/// The time from an order of a gait to its begin: orders have arrived by then.
const LEAD: Span = Span::millis(500);
/// The share of the former speed that is enough after a failure; of a gait learnt for this failure, of its speed.
pub const ENOUGH: f64 = 0.8;
/// The share of its speed below which a gait is given up.
pub const TOO_SLOW: f64 = 0.5;
/// The factor of the speed after a self-collision (thesis 7.6).
const COLLIDED: f64 = 0.001;
/// The speed in mm/s below which a structure stays where it is.
const STANDING: f64 = 1.0;

/// The course of a run.
pub struct Course {
    /// The goal.
    pub goal: Goal,
    /// Chooses gaits.
    pub tuner: Box<dyn Tuner>,
    /// How long a gait is tried. The last two thirds count.
    pub trial: Span,
    /// The faults and their times.
    pub schedule: Schedule,
    /// The conditions that end the run. `stall` counts from the last time that the structure moved, `livelock` from the last
    /// time that it was fast enough.
    pub stop: Stop,
}

/// What was done between two changes of the structure.
#[derive(Clone, Debug, PartialEq)]
pub struct Situation {
    /// Its beginning.
    pub since: Time,
    /// Modules that are dead.
    pub dead: Vec<ModuleId>,
    /// Gaits tried.
    pub tried: u32,
    /// The speed of the first one, in mm/s.
    pub first_mm_s: Option<f64>,
    /// The speed of the best one.
    pub best_mm_s: Option<f64>,
    /// When a gait was kept.
    pub kept: Option<Time>,
}

/// What the structure does.
#[derive(Clone, Copy, Debug, PartialEq)]
enum State {
    /// Agents find out the structure; not before the first and at the second time at the latest the next gait begins.
    Settling(Time, Time),
    /// A gait is tried that begins at this time.
    Trying(Time),
    /// A gait of this speed is kept since a time.
    Walking(Time, f64),
    /// No joint can move.
    Helpless,
}

/// The director of a walking structure.
pub struct WalkDirector {
    modules: usize,
    course: Course,
    faults: FaultInjector,
    members: Members,
    /// What agents have reported since the structure changed last.
    agreed: BTreeMap<ModuleId, u64>,
    state: State,
    epoch: u16,
    /// When the gait in use begins, and its parameters.
    gait: (Time, Gait),
    /// The best gait of the situation and its speed.
    best: Option<(f64, Gait)>,
    /// The speed of the first gait of the run.
    reference: Option<f64>,
    situations: Vec<Situation>,
    measure: Measure,
    next_look: Time,
    last_moved: Time,
    last_fast: Time,
    fast_since: Option<Time>,
    walked: Option<Time>,
    commands: VecDeque<Command<Order>>,
    outcome: Option<(Time, Outcome)>,
    stall: Option<Stall>,
}

impl WalkDirector {
    /// Creates the director of this many modules.
    pub fn new(modules: usize, course: Course) -> WalkDirector {
        WalkDirector {
            modules,
            faults: FaultInjector::new(course.schedule.clone()),
            course,
            members: Members::default(),
            agreed: BTreeMap::new(),
            state: State::Settling(Time::ZERO + REST, Time::ZERO + AGREE),
            epoch: 0,
            gait: (Time::ZERO, Gait::new()),
            best: None,
            reference: None,
            situations: Vec::new(),
            measure: Measure::default(),
            next_look: Time::ZERO,
            last_moved: Time::ZERO,
            last_fast: Time::ZERO,
            fast_since: None,
            walked: None,
            commands: VecDeque::new(),
            outcome: None,
            stall: None,
        }
    }

    /// Returns how the run ended, and when; `None` while it goes on.
    pub fn outcome(&self) -> Option<(Time, Outcome)> {
        self.outcome
    }
    /// Returns the standstill that ended the run, if one did.
    pub fn stall(&self) -> Option<&Stall> {
        self.stall.as_ref()
    }
    /// Returns how many processes died, and how many were restarted.
    pub fn crashed_and_restarted(&self) -> (u64, u64) {
        self.faults.crashed_and_restarted()
    }
    /// Returns what was done, in order.
    pub fn situations(&self) -> &[Situation] {
        &self.situations
    }
    /// Returns the time walked, the distance from the start and the length of the path in mm.
    pub fn way(&self) -> (Span, f64, f64) {
        let (distance, path) = self.measure.way_mm();
        (self.measure.time(), distance, path)
    }
    /// Returns how far the structure has turned in degrees, counter-clockwise seen from above.
    pub fn turned_deg(&self) -> f64 {
        self.measure.turned_deg()
    }
    /// Returns the number of gaits ordered.
    pub fn gaits(&self) -> u64 {
        self.epoch.into()
    }

    /// Returns the seconds asked for, and those for which the structure has been fast enough without a break.
    fn seconds(&self) -> (usize, usize) {
        let asked = self.course.goal.time;
        let held = match (self.walked, self.fast_since) {
            (Some(_), _) => asked,
            (None, Some(since)) => self.last_fast.since(since).min(asked),
            (None, None) => Span::ZERO,
        };
        let whole = |span: Span| span.as_secs_f64() as usize;
        (whole(asked).max(1), if self.walked.is_some() { whole(asked).max(1) } else { whole(held) })
    }
    /// Returns the progress of the run: seconds of walking stand for cells.
    pub fn progress(&self) -> Progress {
        let (goal, filled) = self.seconds();
        let alive = self.members.alive().count();
        Progress { stage: 0, stages: 1, goal, filled, alive, moves: self.gaits(), messages: None }
    }
    /// Returns the only stage.
    pub fn stage(&self) -> Stage {
        let (cells, filled) = self.seconds();
        Stage { cells, filled, opened: Time::ZERO, built: self.walked, known: self.walked }
    }

    fn finish(&mut self, now: Time, outcome: Outcome) {
        if self.outcome.is_none() {
            self.outcome = Some((now, outcome));
            self.commands.push_back(Command::Finish);
        }
    }

    /// Returns what a fault found.
    fn found(&self, id: ModuleId) -> String {
        let doing = match self.state {
            _ if !self.members.is_alive(id) => "dead",
            State::Settling(..) | State::Helpless => "resting",
            State::Trying(_) => "trying a gait",
            State::Walking(..) => "walking",
        };
        format!("it was {doing}")
    }

    fn inject<P: Physics>(&mut self, now: Time, fault: Fault, world: &mut PhysicsWorld<P>) {
        // A fault or its end may resolve a standstill.
        (self.last_moved, self.last_fast) = (now, now);
        let Some(id) = fault.module() else {
            let effect = "free modules have no such fault".to_owned();
            return self.faults.inject(now, fault, false, effect, &mut self.commands);
        };
        let (alive, effect) = (self.members.is_alive(id), self.found(id));
        self.faults.inject(now, fault, alive, effect, &mut self.commands);
        match fault {
            Fault::Stick(_) => world.set_stuck(id, true),
            Fault::Unstick(_) => world.set_stuck(id, false),
            _ => {}
        }
    }

    /// Waits until agents agree on the structure, and then begins with gaits anew.
    fn settle(&mut self, now: Time) {
        self.agreed.clear();
        self.state = State::Settling(now, now + AGREE);
        self.next_look = Time::ZERO;
    }

    /// Returns true if all living agents use the same structure.
    fn is_agreed(&self) -> bool {
        let mut known = self.members.alive().map(|id| self.agreed.get(&id));
        let first = known.next().flatten();
        let others = self.members.dead().count();
        first.is_some() && known.all(|k| k == first) && self.agreed.len() + others == self.modules
    }

    fn begin(&mut self, now: Time) {
        let dead: BTreeSet<ModuleId> = self.members.dead().collect();
        self.best = None;
        self.situations.push(Situation {
            since: now,
            dead: dead.iter().copied().collect(),
            tried: 0,
            first_mm_s: None,
            best_mm_s: None,
            kept: None,
        });
        match self.course.tuner.begin(&dead, &self.gait.1) {
            Some(gait) => self.try_gait(now, gait),
            None => self.state = State::Helpless,
        }
    }

    fn try_gait(&mut self, now: Time, gait: Gait) {
        if let Some(situation) = self.situations.last_mut() {
            situation.tried += 1;
        }
        self.order(now, gait);
        self.state = State::Trying(self.gait.0);
    }

    /// Orders a gait. It begins at a step of the oscillators.
    fn order(&mut self, now: Time, gait: Gait) {
        let start = Time((now + LEAD).0.next_multiple_of(STEP.0));
        self.gait = (start, gait);
        // A run ends long before the numbers do.
        self.epoch = self.epoch.saturating_add(1);
        let orders: Vec<_> = self.members.alive().map(|id| self.order_of(id)).collect();
        self.commands.extend(orders);
    }
    fn order_of(&self, id: ModuleId) -> Command<Order> {
        let (start, gait) = &self.gait;
        let joints = [0, 1, 2].map(|j| gait.get(&Joint::new(id, j)).copied());
        Command::Order(id, Order::Gait(GaitOrder { epoch: self.epoch, start: *start, joints }))
    }

    /// Takes the speed of the gait that was tried, and decides how to go on.
    fn tried(&mut self, now: Time, speed: f64) {
        if self.best.as_ref().is_none_or(|(best, _)| speed > *best) {
            self.best = Some((speed, self.gait.1.clone()));
        }
        let best = self.best.as_ref().map(|(speed, _)| *speed);
        if let Some(situation) = self.situations.last_mut() {
            situation.first_mm_s.get_or_insert(speed);
            situation.best_mm_s = best;
        }
        let reference = *self.reference.get_or_insert(speed);
        let expected = self.course.tuner.expected().map_or(reference, |expected| expected.min(reference));
        let enough = self.course.goal.least().unwrap_or(ENOUGH * expected);
        if speed < enough
            && let Some(next) = self.course.tuner.tell(speed)
        {
            return self.try_gait(now, next);
        }
        if let Some((speed, gait)) = self.best.clone() {
            if gait != self.gait.1 {
                self.order(now, gait);
            }
            self.state = State::Walking(now, speed);
        }
        if let Some(situation) = self.situations.last_mut() {
            situation.kept = Some(now);
        }
    }

    /// Returns the speed over the last [`WINDOW`] that counts for the goal.
    fn speed(&self) -> Option<f64> {
        self.measure.recent().map(|movement: Movement| self.course.goal.speed(&movement))
    }

    /// Looks how the structure walks.
    fn look<P: Physics>(&mut self, now: Time, world: &PhysicsWorld<P>) {
        self.next_look = now + LOOK;
        if self.epoch > 1 || (self.epoch == 1 && now >= self.gait.0) {
            let physics = world.physics();
            let [x, y, _] = physics.centre_of_mass();
            let modules = (0..self.modules as u32).map(|m| physics.pose(ModuleId(m), 1).position);
            let modules = modules.map(|[x, y, _]| [x, y]).collect();
            self.measure.add(now, [x, y], modules, WINDOW.max(self.course.trial));
        }
        match self.state {
            State::Settling(earliest, latest) => {
                if now >= earliest && (self.is_agreed() || now >= latest) {
                    self.begin(now);
                }
            }
            State::Trying(start) => {
                if now >= start + self.course.trial {
                    let from = start + Span(self.course.trial.0 / 3);
                    let speed =
                        self.measure.since(from).map_or(0.0, |movement| self.course.goal.speed(&movement));
                    let collided = world.collided().is_some_and(|at| at >= from);
                    self.tried(now, if collided { speed * COLLIDED } else { speed });
                }
            }
            State::Walking(since, kept) => {
                let slow = self.speed().is_some_and(|speed| speed < TOO_SLOW * kept);
                if slow && now.since(since) >= WINDOW {
                    self.begin(now);
                }
            }
            State::Helpless => {}
        }
    }

    fn watch<P: Physics>(&mut self, now: Time, world: &PhysicsWorld<P>) {
        let moves = self.measure.recent().is_none_or(|movement| movement.speed() >= STANDING);
        if moves {
            self.last_moved = now;
        }
        if self.speed().is_some_and(|speed| speed >= self.course.goal.speed_mm_s) {
            self.fast_since.get_or_insert(now);
            self.last_fast = now;
        } else {
            self.fast_since = None;
        }
        let planned = self.faults.is_pending() || now < self.course.stop.planned_until;
        let held = self.fast_since.is_some_and(|since| now.since(since) >= self.course.goal.time);
        if world.is_broken() {
            return self.finish(now, Outcome::Unsafe);
        }
        if held && !planned {
            self.walked = Some(now);
            return self.finish(now, Outcome::Built);
        }
        let quiet = self.course.stop.planned_until;
        let (reason, since, outcome) = if now >= self.course.stop.timeout {
            (SLOW, self.last_fast, Outcome::Timeout)
        } else if planned {
            return;
        } else if self.state == State::Helpless {
            (NO_JOINT, self.last_moved, Outcome::Deadlock)
        } else if now.since(self.last_moved.max(quiet)) > self.course.stop.stall {
            (STILL, self.last_moved, Outcome::Deadlock)
        } else if now.since(self.last_fast.max(quiet)) > self.course.stop.livelock {
            (SLOW, self.last_fast, Outcome::Livelock)
        } else {
            return;
        };
        let waiting = self.members.dead().map(|module| Waiter { module, on: None, why: DEAD });
        self.stall = Some(Stall {
            since,
            reason,
            text: reason.text,
            open: vec![Objective { text: self.course.goal.to_string(), cell: None }],
            wait_cycle: Vec::new(),
            waiting: waiting.collect(),
            detected: None,
            proof: None,
        });
        self.finish(now, outcome);
    }
}

impl<P: Physics> DirectorPort<PhysicsWorld<P>> for WalkDirector {
    fn report(&mut self, _: Time, id: ModuleId, report: Status) {
        if self.members.is_alive(id) {
            self.agreed.insert(id, report.known);
        }
    }

    fn died(&mut self, now: Time, id: ModuleId) {
        self.faults.died(id);
        self.members.died(id, &mut self.commands);
        self.settle(now);
    }

    fn external(&mut self, now: Time, id: ModuleId, what: &Outside, _: &PhysicsWorld<P>) {
        (self.last_moved, self.last_fast) = (now, now);
        let found = self.found(id);
        self.faults.external(now, id, what, &found);
    }

    fn started(&mut self, now: Time, id: ModuleId) {
        self.members.started(id, &mut self.commands);
        if self.epoch > 0 {
            self.commands.push_back(self.order_of(id));
            self.settle(now);
        }
    }

    fn wake(&mut self, now: Time, world: &mut PhysicsWorld<P>) {
        if self.outcome.is_some() {
            return;
        }
        while let Some(fault) = self.faults.due(now) {
            self.inject(now, fault, world);
        }
        if now >= self.next_look {
            self.look(now, world);
            self.watch(now, world);
        }
    }

    fn input(&mut self, now: Time, kind: &str, bytes: &[u8]) -> Result<(), String> {
        if self.outcome.is_some() {
            return Err("the run is over".to_owned());
        }
        self.faults.input(now, kind, bytes, self.modules, &[])
    }

    fn wake_at(&self) -> Time {
        if self.outcome.is_some() {
            return Time::NEVER;
        }
        self.faults.next_at().min(self.next_look).min(self.course.stop.timeout)
    }

    fn poll(&mut self) -> Option<Command<Order>> {
        self.commands.pop_front()
    }

    fn struck(&self) -> &[FaultRecord] {
        self.faults.struck()
    }
}
