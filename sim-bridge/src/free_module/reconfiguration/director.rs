//! The director of free modules: injects faults, has plans made and carried out, and decides how the run ends.

use super::plan_execution::{Known, PlanExecution, Shortage};
use super::reasons::{DEAD, NO_PLAN, NOT_CARRIED_OUT, SILENT, STUCK, UNDECIDED};
use super::world::FreeModuleWorld;
use crate::director::fault_injector::FaultInjector;
use crate::director::faults::{Fault, FaultRecord, Schedule};
use crate::director::outcome::{Objective, Outcome, Proof, Stall, Waiter};
use crate::director::port::DirectorPort;
use crate::director::progress::{Progress, Stage, Stop};
use crate::director::reason::{Reason, Why};
use crate::world::World;
use metamorph_protocol::free_module::reconfiguration::Setup;
use metamorph_protocol::free_module::reconfiguration::message::{Order, Status};
use metamorph_protocol::free_module::reconfiguration::place::configuration;
use metamorph_protocol::free_module::reconfiguration::planning::Planner;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::record::Outside;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::Time;
use std::collections::VecDeque;
use std::sync::Arc;

pub use super::plan_execution::{PLANNING_RATE, PlanCounts};

/// The course of a run.
#[derive(Clone, Debug)]
pub struct Course {
    /// How plans are made.
    pub planner: Planner,
    /// The faults and their times.
    pub schedule: Schedule,
    /// The conditions that end the run. `stall` counts from the last completed action of a body, `livelock` from the
    /// last joined face of the goal that was gained.
    pub stop: Stop,
    /// The probability that a connector does not close.
    pub failure: Ratio,
}

/// The director of free modules.
pub struct FreeModuleDirector {
    setup: Arc<Setup>,
    faults: FaultInjector,
    stop: Stop,
    failure: Ratio,
    known: Vec<Known>,
    execution: PlanExecution,
    commands: VecDeque<Command<Order>>,
    prevented_before: u64,
    /// Actions completed, at the last look.
    done: u64,
    /// Actions that have ended, at the last look.
    ended: u64,
    /// Joined faces of the goal, and how many of them there are.
    joined: (usize, usize),
    /// Whether the bodies form the goal.
    is_reached: bool,
    built: Option<Time>,
    last_action: Time,
    last_gain: Time,
    next_check: Time,
    outcome: Option<(Time, Outcome)>,
    stall: Option<Stall>,
}

impl FreeModuleDirector {
    /// Creates a director for this many modules.
    pub fn new(setup: Arc<Setup>, modules: usize, course: Course) -> FreeModuleDirector {
        let Course { planner, schedule, stop, failure } = course;
        FreeModuleDirector {
            execution: PlanExecution::new(Arc::clone(&setup), planner),
            setup,
            faults: FaultInjector::new(schedule),
            stop,
            failure,
            known: vec![Known::default(); modules],
            commands: VecDeque::new(),
            prevented_before: 0,
            done: 0,
            ended: 0,
            is_reached: false,
            joined: (0, 0),
            built: None,
            last_action: Time::ZERO,
            last_gain: Time::ZERO,
            next_check: Time::ZERO,
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
    /// Returns what has been planned and ordered.
    pub fn plan_counts(&self) -> PlanCounts {
        self.execution.counts
    }
    /// Returns how many processes died, and how many were restarted.
    pub fn crashed_and_restarted(&self) -> (u64, u64) {
        self.faults.crashed_and_restarted()
    }
    /// Returns the number of branch locks that were refused.
    pub fn prevented(&self) -> u64 {
        let now = self.known.iter().filter_map(|k| k.status).map(|s| u64::from(s.prevented)).sum::<u64>();
        self.prevented_before + now
    }
    /// Returns the progress of the run: joined faces of the goal stand for cells.
    pub fn progress(&self) -> Progress {
        Progress {
            stage: 0,
            stages: 1,
            goal: self.joined.0,
            filled: self.joined.1,
            alive: self.known.iter().filter(|k| k.alive).count(),
            moves: self.done,
            messages: None,
        }
    }
    /// Returns the only stage.
    pub fn stage(&self) -> Stage {
        let (cells, filled) = self.joined;
        Stage { cells, filled, opened: Time::ZERO, built: self.built, known: self.built }
    }

    fn finish(&mut self, now: Time, outcome: Outcome) {
        if self.outcome.is_none() {
            self.outcome = Some((now, outcome));
            self.commands.push_back(Command::Finish);
        }
    }

    fn found(&self, id: ModuleId, world: &FreeModuleWorld) -> String {
        let doing = match (self.known[id.index()].alive, world.is_acting(id)) {
            (false, _) => "dead",
            (true, true) => "acting",
            (true, false) => "resting",
        };
        format!("it was {doing} at {}", world.place(id).cell)
    }

    fn inject(&mut self, now: Time, fault: Fault, world: &mut FreeModuleWorld) {
        // A fault or its end may resolve a standstill.
        self.last_action = now;
        let Some(id) = fault.module() else {
            let effect = "free modules have no such fault".to_owned();
            return self.faults.inject(now, fault, false, effect, &mut self.commands);
        };
        let (alive, effect) = (self.known[id.index()].alive, self.found(id, world));
        self.faults.inject(now, fault, alive, effect, &mut self.commands);
        match fault {
            Fault::Restart(_) => self.known[id.index()].restarting = true,
            Fault::Kill(_) => self.known[id.index()].restarting = false,
            Fault::Stick(_) => world.set_stuck(id, true),
            Fault::Unstick(_) => {
                world.set_stuck(id, false);
                if self.execution.is_resting() {
                    self.execution.disturb();
                }
            }
            _ => {}
        }
    }

    /// Counts what is done, and looks whether the goal is there.
    fn measure(&mut self, now: Time, world: &FreeModuleWorld) {
        let counts = world.counts();
        let done = counts.turns + counts.sides;
        if done != self.done {
            (self.done, self.last_action) = (done, now);
        }
        let ended = done + counts.failed;
        if ended == self.ended && self.joined != (0, 0) {
            return;
        }
        let Some(state) = world.at_rest().and_then(|places| configuration(&places)) else { return };
        self.ended = ended;
        let planner = self.execution.planner();
        let (goal, joined) = planner.joined(&state);
        self.is_reached = planner.is_reached(&state);
        // All labels may be there in another shape.
        let joined = if self.is_reached { goal } else { joined.min(goal.saturating_sub(1)) };
        if joined > self.joined.1 {
            self.last_gain = now;
        }
        self.joined = (goal, joined);
    }

    fn watch(&mut self, now: Time, world: &FreeModuleWorld) {
        self.next_check = now + self.setup.turn_time;
        self.measure(now, world);
        // The steps that have led there are confirmed first.
        if self.is_reached && !self.execution.is_moving() {
            self.built = Some(now);
            return self.finish(now, Outcome::Built);
        }
        let planned = self.faults.is_pending() || now < self.stop.planned_until;
        let idle_since = self.last_action.max(self.stop.planned_until);
        let outcome = if now >= self.stop.timeout {
            Outcome::Timeout
        } else if planned {
            return;
        } else if self.is_stranded(now, idle_since) || now.since(idle_since) > self.stop.stall {
            Outcome::Deadlock
        } else if now.since(self.last_gain.max(self.stop.planned_until)) > self.stop.livelock {
            Outcome::Livelock
        } else {
            return;
        };
        self.stall = Some(self.explain(idle_since));
        self.finish(now, outcome);
    }

    /// Returns true if there is no plan, and no module that was silent has answered for a while.
    fn is_stranded(&self, now: Time, idle_since: Time) -> bool {
        self.execution.is_resting() && now.since(idle_since) > self.setup.patience
    }

    fn explain(&self, since: Time) -> Stall {
        let (reason, proof): (Reason, _) = match self.execution.shortage {
            Some(Shortage::NoPlan(states)) => {
                (NO_PLAN, Some(Proof { arrangements: states as usize, places: None }))
            }
            Some(Shortage::Undecided) => (UNDECIDED, None),
            Some(Shortage::NotCarriedOut) | None => (NOT_CARRIED_OUT, None),
        };
        let waiting = (0..).map(ModuleId).zip(&self.known).map(|(module, known)| {
            let on = known.status.and_then(|s| s.waits_for);
            let why = match on {
                _ if !known.alive => DEAD,
                _ if self.execution.stuck().contains(&module) => STUCK,
                Some(_) => Why::WAITS,
                None if known.status.is_none() => SILENT,
                None => Why::UNKNOWN,
            };
            Waiter { module, on, why }
        });
        let (goal, joined) = self.joined;
        let open = (joined..goal).map(|i| Objective { text: format!("joined face {}", i + 1), cell: None });
        Stall {
            since,
            reason,
            text: reason.text,
            open: open.collect(),
            wait_cycle: Vec::new(),
            waiting: waiting.filter(|w| w.why != Why::UNKNOWN).collect(),
            detected: None,
            proof,
        }
    }
}

impl DirectorPort<FreeModuleWorld> for FreeModuleDirector {
    fn report(&mut self, _now: Time, id: ModuleId, report: Status) {
        let before = self.known[id.index()].status.replace(report);
        let has_moved = before.is_some_and(|before| before.place != report.place);
        if self.execution.is_resting() && (has_moved || self.execution.is_silent(id)) {
            self.execution.disturb();
        }
        self.next_check = Time::ZERO;
    }

    fn died(&mut self, _now: Time, id: ModuleId) {
        self.faults.died(id);
        self.known[id.index()].alive = false;
        self.execution.disturb();
        self.next_check = Time::ZERO;
    }

    fn external(&mut self, now: Time, id: ModuleId, what: &Outside, world: &FreeModuleWorld) {
        self.last_action = now;
        let found = self.found(id, world);
        self.faults.external(now, id, what, &found);
    }

    fn started(&mut self, _now: Time, id: ModuleId) {
        let known = &mut self.known[id.index()];
        // A restart commanded before the first start is reported is not over with that start.
        let restarting = known.restarting && !known.launched;
        let begun = Known { alive: true, launched: true, restarting, status: None, ..*known };
        let before = std::mem::replace(known, begun);
        // A plan that waits for a first incarnation goes on waiting.
        if before.status.is_some() || self.execution.has_given_up(id) {
            self.execution.disturb();
        }
        self.prevented_before += before.status.map_or(0, |s| u64::from(s.prevented));
        self.next_check = Time::ZERO;
    }

    fn wake(&mut self, now: Time, world: &mut FreeModuleWorld) {
        if self.outcome.is_some() {
            return;
        }
        // Processes on the process link are not up at time zero.
        world.set_failure(self.failure);
        while let Some(fault) = self.faults.due(now) {
            self.inject(now, fault, world);
        }
        let unheard = |k: &Known| !k.alive || k.status.is_none();
        for (id, known) in (0..).map(ModuleId).zip(&mut self.known).filter(|(_, k)| unheard(k)) {
            known.body = world.place(id);
        }
        for done in self.execution.step(now, &self.known, &mut self.commands) {
            world.confirm(now, done.epoch, done.index, &done.sides, &done.after);
        }
        self.watch(now, world);
    }

    fn input(&mut self, now: Time, kind: &str, bytes: &[u8]) -> Result<(), String> {
        if self.outcome.is_some() {
            return Err("the run is over".to_owned());
        }
        self.faults.input(now, kind, bytes, self.known.len(), &[])
    }

    fn wake_at(&self) -> Time {
        if self.outcome.is_some() {
            return Time::NEVER;
        }
        let execution = self.execution.wake_at();
        self.faults.next_at().min(self.next_check).min(self.stop.timeout).min(execution)
    }

    fn poll(&mut self) -> Option<Command<Order>> {
        self.commands.pop_front()
    }

    fn struck(&self) -> &[FaultRecord] {
        self.faults.struck()
    }
}
