//! The director of a walking structure: injects faults, hands out gaits, has others tried when modules die or the
//! structure becomes slow, and decides how the run ends.

use super::goal::Goal;
use super::measure::{Measure, Movement, WINDOW};
use super::reasons::{DEAD, NO_JOINT, SLOW, STILL};
use super::tuner::{Gait, Tuner};
use crate::free_module::members::Members;
use crate::free_module::physics::Physics;
use crate::free_module::physics_world::PhysicsWorld;
use crate::free_module::trial::REST;
use metamorph_kernel::director::faults::{Fault, FaultRecord, Schedule};
use metamorph_kernel::director::monitor::{RunMonitor, Standing};
use metamorph_kernel::director::outcome::{Objective, Outcome, Stall, Waiter};
use metamorph_kernel::director::port::DirectorPort;
use metamorph_kernel::director::progress::{Progress, Stage, Stop};
use metamorph_kernel::director::reason::Reason;
use metamorph_kernel::director::rescue::Help;
use metamorph_protocol::free_module::gait::body::WalkStatus;
use metamorph_protocol::free_module::gait::message::{Gait as GaitOrder, WalkOrder};
use metamorph_protocol::free_module::oscillator::STEP;
use metamorph_protocol::free_module::structure::Joint;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::record::Outside;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::{Span, Time};
use std::collections::{BTreeMap, BTreeSet};

/// The time between two checks of the structure.
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

/// Parameters of a run.
pub struct WalkingRun {
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

/// Record of the gaits between two changes of the structure.
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

/// State of the search for a gait.
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

/// The director of a walking structure. Its actions are movements of the structure, its gain is the speed of the goal.
pub struct WalkDirector {
    monitor: RunMonitor<WalkOrder>,
    modules: usize,
    goal: Goal,
    tuner: Box<dyn Tuner>,
    trial: Span,
    members: Members,
    /// The reports of agents since the last change of the structure.
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
    fast_since: Option<Time>,
    walked: Option<Time>,
}

impl WalkDirector {
    /// Creates the director of this many modules.
    pub fn new(modules: usize, course: WalkingRun) -> WalkDirector {
        let WalkingRun { goal, tuner, trial, schedule, stop } = course;
        WalkDirector {
            monitor: RunMonitor::new(schedule, stop),
            modules,
            goal,
            tuner,
            trial,
            members: Members::default(),
            agreed: BTreeMap::new(),
            state: State::Settling(Time::ZERO + REST, Time::ZERO + AGREE),
            epoch: 0,
            gait: (Time::ZERO, Gait::new()),
            best: None,
            reference: None,
            situations: Vec::new(),
            measure: Measure::default(),
            fast_since: None,
            walked: None,
        }
    }

    /// Returns the faults, the commands and the end of the run.
    pub fn monitor(&self) -> &RunMonitor<WalkOrder> {
        &self.monitor
    }
    /// Returns what was done, in order.
    pub fn situations(&self) -> &[Situation] {
        &self.situations
    }
    /// Returns the time walked, the distance from the start and the length of the path in mm.
    pub fn walked(&self) -> (Span, f64, f64) {
        let (distance, path) = self.measure.distance_and_path_mm();
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
        let asked = self.goal.time;
        let held = match (self.walked, self.fast_since) {
            (Some(_), _) => asked,
            (None, Some(since)) => self.monitor.last_gain.since(since).min(asked),
            (None, None) => Span::ZERO,
        };
        let whole = |span: Span| span.as_secs_f64() as usize;
        (whole(asked).max(1), if self.walked.is_some() { whole(asked).max(1) } else { whole(held) })
    }
    /// Returns the progress of the run: seconds of walking stand for cells.
    pub fn progress(&self) -> Progress {
        let (goal, filled) = self.seconds();
        let alive = self.members.alive().count();
        Progress {
            stage: 0,
            stages: 1,
            goal,
            filled,
            alive,
            moves: self.gaits(),
            standstills: self.monitor.standstill_count(),
            restarts: self.monitor.crashed_and_restarted().1,
            messages: None,
        }
    }
    /// Returns the only stage.
    pub fn stage(&self) -> Stage {
        let (cells, filled) = self.seconds();
        Stage { cells, filled, opened: Time::ZERO, built: self.walked, known: self.walked }
    }

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
        (self.monitor.last_action, self.monitor.last_gain) = (now, now);
        let Some(id) = fault.module() else {
            return self.monitor.inject(now, fault, false, "free modules have no such fault");
        };
        let (alive, effect) = (self.members.is_alive(id), self.found(id));
        self.monitor.inject(now, fault, alive, effect);
        match fault {
            Fault::Stick(_) => world.set_stuck(id, true),
            Fault::Unstick(_) => world.set_stuck(id, false),
            _ => {}
        }
    }

    /// Waits until agents agree on the structure, and then begins with gaits again.
    fn settle(&mut self, now: Time) {
        self.agreed.clear();
        self.state = State::Settling(now, now + AGREE);
        self.monitor.next_check = Time::ZERO;
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
        match self.tuner.begin(&dead, &self.gait.1) {
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
        self.monitor.commands.extend(orders);
    }
    fn order_of(&self, id: ModuleId) -> Command<WalkOrder> {
        let (start, gait) = &self.gait;
        let joints = [0, 1, 2].map(|j| gait.get(&Joint::new(id, j)).copied());
        Command::Order(id, WalkOrder::Gait(GaitOrder { epoch: self.epoch, start: *start, joints }))
    }

    /// Takes the speed of the gait that was tried, and decides how to continue.
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
        let expected = self.tuner.expected().map_or(reference, |expected| expected.min(reference));
        let enough = self.goal.least().unwrap_or(ENOUGH * expected);
        if speed < enough
            && let Some(next) = self.tuner.tell(speed)
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
        self.measure.recent().map(|movement: Movement| self.goal.speed(&movement))
    }

    /// Looks how the structure walks.
    fn look<P: Physics>(&mut self, now: Time, world: &PhysicsWorld<P>) {
        self.monitor.next_check = now + LOOK;
        if self.epoch > 1 || (self.epoch == 1 && now >= self.gait.0) {
            let physics = world.physics();
            let [x, y, _] = physics.centre_of_mass();
            let modules = (0..self.modules as u32).map(|m| physics.pose(ModuleId(m), 1).position);
            let modules = modules.map(|[x, y, _]| [x, y]).collect();
            self.measure.add(now, [x, y], modules, WINDOW.max(self.trial));
        }
        match self.state {
            State::Settling(earliest, latest) => {
                if now >= earliest && (self.is_agreed() || now >= latest) {
                    self.begin(now);
                }
            }
            State::Trying(start) => {
                if now >= start + self.trial {
                    let from = start + Span(self.trial.0 / 3);
                    let speed = self.measure.since(from).map_or(0.0, |movement| self.goal.speed(&movement));
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
            self.monitor.last_action = now;
        }
        if self.speed().is_some_and(|speed| speed >= self.goal.speed_mm_s) {
            self.fast_since.get_or_insert(now);
            self.monitor.last_gain = now;
        } else {
            self.fast_since = None;
        }
        let is_planned = self.monitor.is_event_planned(now);
        let held = self.fast_since.is_some_and(|since| now.since(since) >= self.goal.time);
        if world.is_broken() {
            return self.monitor.finish(now, Outcome::Unsafe);
        }
        if held && !is_planned {
            self.walked = Some(now);
            return self.monitor.finish(now, Outcome::Built);
        }
        let (last_moved, last_fast) = (self.monitor.last_action, self.monitor.last_gain);
        let standing = Standing {
            is_planned,
            is_stranded: self.state == State::Helpless,
            idle_since: last_moved.max(self.monitor.stop.planned_until),
            no_gain_since: last_fast.max(self.monitor.stop.planned_until),
        };
        let is_fast = usize::from(self.fast_since.is_some());
        if let Some(since) = self.monitor.look(now, standing, is_fast, Help::default(), false) {
            let stall = self.explain(since, if since == standing.idle_since { STILL } else { SLOW });
            self.monitor.begin_standstill(stall);
        }
        let Some(outcome) = self.monitor.verdict(now, standing) else { return };
        let (reason, since) = match outcome {
            Outcome::Deadlock if standing.is_stranded => (NO_JOINT, last_moved),
            Outcome::Deadlock => (STILL, last_moved),
            _ => (SLOW, last_fast),
        };
        let stall = self.explain(since, reason);
        self.monitor.give_up(now, outcome, stall);
    }

    fn explain(&self, since: Time, reason: Reason) -> Stall {
        let waiting = self.members.dead().map(|module| Waiter { module, on: None, why: DEAD });
        Stall {
            since,
            reason,
            text: reason.text,
            open: vec![Objective { text: self.goal.to_string(), cell: None }],
            wait_cycle: Vec::new(),
            waiting: waiting.collect(),
            detected: None,
            proof: None,
        }
    }
}

impl<P: Physics> DirectorPort<PhysicsWorld<P>> for WalkDirector {
    fn report(&mut self, _: Time, id: ModuleId, report: WalkStatus) {
        if self.members.is_alive(id) {
            self.agreed.insert(id, report.known);
        }
    }

    fn died(&mut self, now: Time, id: ModuleId) {
        self.monitor.faults.died(id);
        self.members.died(id, &mut self.monitor.commands);
        self.settle(now);
    }

    fn external(&mut self, now: Time, id: ModuleId, what: &Outside, _: &PhysicsWorld<P>) {
        (self.monitor.last_action, self.monitor.last_gain) = (now, now);
        let found = self.found(id);
        self.monitor.faults.external(now, id, what, &found);
    }

    fn started(&mut self, now: Time, id: ModuleId) {
        self.members.started(id, &mut self.monitor.commands);
        if self.epoch > 0 {
            self.monitor.commands.push_back(self.order_of(id));
            self.settle(now);
        }
    }

    fn wake(&mut self, now: Time, world: &mut PhysicsWorld<P>) {
        if self.monitor.outcome().is_some() {
            return;
        }
        while let Some(fault) = self.monitor.faults.due(now) {
            self.inject(now, fault, world);
        }
        if now >= self.monitor.next_check {
            self.look(now, world);
            self.watch(now, world);
        }
    }

    fn input(&mut self, now: Time, kind: &str, bytes: &[u8]) -> Result<(), String> {
        self.monitor.injector()?.input(now, kind, bytes, self.modules, &[])
    }
    fn wake_at(&self) -> Time {
        self.monitor.wake_at(Time::NEVER)
    }
    fn poll(&mut self) -> Option<Command<WalkOrder>> {
        self.monitor.commands.pop_front()
    }
    fn struck(&self) -> &[FaultRecord] {
        self.monitor.struck()
    }
}
