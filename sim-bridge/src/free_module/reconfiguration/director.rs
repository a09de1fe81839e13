//! The director of free modules: injects faults, has plans made and carried out, and decides how the run ends.

use super::plan_execution::{Known, PlanExecution, Shortage};
use super::reasons::{DEAD, NO_PLAN, NOT_CARRIED_OUT, SILENT, STUCK, UNDECIDED};
use super::world::FreeModuleWorld;
use metamorph_kernel::director::faults::{Fault, FaultRecord, Schedule};
use metamorph_kernel::director::monitor::{RunMonitor, Standing};
use metamorph_kernel::director::outcome::{Objective, Outcome, Proof, Stall, Waiter};
use metamorph_kernel::director::port::DirectorPort;
use metamorph_kernel::director::progress::{Progress, Stage, Stop};
use metamorph_kernel::director::reason::{Reason, Why};
use metamorph_kernel::director::rescue::Help;
use metamorph_kernel::world::World;
use metamorph_protocol::free_module::reconfiguration::LatticeSetup;
use metamorph_protocol::free_module::reconfiguration::message::{LatticeOrder, LatticeStatus};
use metamorph_protocol::free_module::reconfiguration::place::configuration;
use metamorph_protocol::free_module::reconfiguration::planning::Planner;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::record::Outside;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::Time;
use std::sync::Arc;

pub use super::plan_execution::{PLANNING_RATE, ReconfigurationCounts};

/// Parameters of a run.
#[derive(Clone, Debug)]
pub struct ReconfigurationRun {
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
#[derive(Clone)]
pub struct FreeModuleDirector {
    setup: Arc<LatticeSetup>,
    monitor: RunMonitor<LatticeOrder>,
    failure: Ratio,
    known: Vec<Known>,
    execution: PlanExecution,
    /// Actions that have ended, at the last look.
    ended: u64,
    /// Joined faces of the goal, and how many of them there are.
    joined: (usize, usize),
    /// Whether the bodies form the goal.
    is_reached: bool,
    built: Option<Time>,
}

impl FreeModuleDirector {
    /// Creates a director for this many modules.
    pub fn new(setup: Arc<LatticeSetup>, modules: usize, course: ReconfigurationRun) -> FreeModuleDirector {
        let ReconfigurationRun { planner, schedule, stop, failure } = course;
        FreeModuleDirector {
            execution: PlanExecution::new(Arc::clone(&setup), planner),
            setup,
            monitor: RunMonitor::new(schedule, stop),
            failure,
            known: vec![Known::default(); modules],
            ended: 0,
            joined: (0, 0),
            is_reached: false,
            built: None,
        }
    }

    /// Returns the faults, the commands and the end of the run.
    pub fn monitor(&self) -> &RunMonitor<LatticeOrder> {
        &self.monitor
    }
    /// Returns what has been planned and ordered.
    pub fn plan_counts(&self) -> ReconfigurationCounts {
        self.execution.counts
    }
    /// Returns the number of branch locks that were refused.
    pub fn prevented(&self) -> u64 {
        self.monitor.prevented(self.known.iter().filter_map(|k| k.status).map(|s| s.prevented))
    }
    /// Returns the progress of the run: joined faces of the goal stand for cells.
    pub fn progress(&self) -> Progress {
        Progress {
            stage: 0,
            stages: 1,
            goal: self.joined.0,
            filled: self.joined.1,
            alive: self.known.iter().filter(|k| k.alive).count(),
            moves: self.monitor.done(),
            standstills: self.monitor.standstill_count(),
            restarts: self.monitor.crashed_and_restarted().1,
            messages: None,
        }
    }
    /// Returns the only stage.
    pub fn stage(&self) -> Stage {
        let (cells, filled) = self.joined;
        Stage { cells, filled, opened: Time::ZERO, built: self.built, known: self.built }
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
        self.monitor.last_action = now;
        let Some(id) = fault.module() else {
            return self.monitor.inject(now, fault, false, "free modules have no such fault");
        };
        let (alive, effect) = (self.known[id.index()].alive, self.found(id, world));
        self.monitor.inject(now, fault, alive, effect);
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
        self.monitor.count_actions(now, done);
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
            self.monitor.last_gain = now;
        }
        self.joined = (goal, joined);
    }

    fn watch(&mut self, now: Time, world: &FreeModuleWorld) {
        self.monitor.next_check = now + self.setup.turn_time;
        self.measure(now, world);
        // The steps that have led there are confirmed first.
        if self.is_reached && !self.execution.is_moving() {
            self.built = Some(now);
            return self.monitor.finish(now, Outcome::Built);
        }
        let planned_until = self.monitor.stop.planned_until;
        let idle_since = self.monitor.last_action.max(planned_until);
        let standing = Standing {
            is_planned: self.monitor.is_event_planned(now),
            is_stranded: self.is_stranded(now, idle_since),
            idle_since,
            no_gain_since: self.monitor.last_gain.max(planned_until),
        };
        if let Some(since) = self.monitor.look(now, standing, self.joined.1, Help::default(), false) {
            let stall = self.explain(since);
            self.monitor.begin_standstill(stall);
        }
        if let Some(outcome) = self.monitor.verdict(now, standing) {
            let stall = self.explain(idle_since);
            self.monitor.give_up(now, outcome, stall);
        }
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
    fn report(&mut self, _now: Time, id: ModuleId, report: LatticeStatus) {
        let before = self.known[id.index()].status.replace(report);
        let has_moved = before.is_some_and(|before| before.place != report.place);
        if self.execution.is_resting() && (has_moved || self.execution.is_silent(id)) {
            self.execution.disturb();
        }
        self.monitor.next_check = Time::ZERO;
    }

    fn died(&mut self, _now: Time, id: ModuleId) {
        self.monitor.faults.died(id);
        self.known[id.index()].alive = false;
        self.execution.disturb();
        self.monitor.next_check = Time::ZERO;
    }

    fn external(&mut self, now: Time, id: ModuleId, what: &Outside, world: &FreeModuleWorld) {
        self.monitor.last_action = now;
        let found = self.found(id, world);
        self.monitor.faults.external(now, id, what, &found);
    }

    fn started(&mut self, _now: Time, id: ModuleId) {
        let known = &mut self.known[id.index()];
        // A restart commanded before the first start is reported is not over with that start.
        let restarting = known.restarting && !known.launched;
        let begun = Known { alive: true, launched: true, restarting, status: None, ..*known };
        let before = std::mem::replace(known, begun);
        // A plan that waits for a first incarnation continues waiting.
        if before.status.is_some() || self.execution.has_given_up(id) {
            self.execution.disturb();
        }
        self.monitor.prevented_before += before.status.map_or(0, |s| u64::from(s.prevented));
        self.monitor.next_check = Time::ZERO;
    }

    fn wake(&mut self, now: Time, world: &mut FreeModuleWorld) {
        if self.monitor.outcome().is_some() {
            return;
        }
        // Processes on the process link are not up at time zero.
        world.set_failure(self.failure);
        while let Some(fault) = self.monitor.faults.due(now) {
            self.inject(now, fault, world);
        }
        let unheard = |k: &Known| !k.alive || k.status.is_none();
        for (id, known) in (0..).map(ModuleId).zip(&mut self.known).filter(|(_, k)| unheard(k)) {
            known.body = world.place(id);
        }
        for done in self.execution.step(now, &self.known, &mut self.monitor.commands) {
            world.confirm(now, done.epoch, done.index, &done.sides, &done.after);
        }
        self.watch(now, world);
    }

    fn input(&mut self, now: Time, kind: &str, bytes: &[u8]) -> Result<(), String> {
        self.monitor.injector()?.input(now, kind, bytes, self.known.len(), &[])
    }
    fn wake_at(&self) -> Time {
        self.monitor.wake_at(self.execution.wake_at())
    }
    fn poll(&mut self) -> Option<Command<LatticeOrder>> {
        self.monitor.commands.pop_front()
    }
    fn struck(&self) -> &[FaultRecord] {
        self.monitor.struck()
    }
}
