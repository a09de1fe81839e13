//! The director of metamodules: opens seeds level by level in the order of the blueprint, injects faults,
//! certifies deaths, watches progress and decides how the run ends.
//!
//! It consists of parts, each in a file of its own. A part changes only itself; what else it needs it is lent, as a
//! [`View`](view::View) or by name. This file and `injection` are where one part's result changes another.

mod diagnosis;
mod elements;
mod goal;
mod injection;
mod leases;
mod members;
pub mod picture;
mod plan_execution;
mod relocation;
mod rules;
mod view;

use crate::metamodule::faults::{COMMANDS, DROP, OBSTACLE, OBSTACLE_GONE};
use crate::metamodule::relocation::Shift;
use crate::metamodule::world::MetamoduleWorld;
use diagnosis::Diagnosis;
use elements::Elements;
use goal::Goal;
use leases::Leases;
use members::Members;
use metamorph_kernel::director::faults::{Fault, FaultRecord, Schedule};
use metamorph_kernel::director::monitor::{RunMonitor, Standing};
use metamorph_kernel::director::operator::{Habits, Level, Operator};
use metamorph_kernel::director::outcome::{Outcome, Stall};
use metamorph_kernel::director::port::DirectorPort;
use metamorph_kernel::director::progress::{Progress, Stage, Stop};
use metamorph_kernel::director::rescue::Help;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::metamodule::blueprint::{SeedSet, Task};
use metamorph_protocol::metamodule::message::{Order, Status};
use metamorph_protocol::metamodule::params::{Setup, Strategy};
use metamorph_protocol::metamodule::planning::cooperative::Standstill;
use metamorph_protocol::metamodule::planning::transport::Scenes;
use metamorph_protocol::metamodule::tuning::Tuning;
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::record::Outside;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::{Span, Time};
use picture::Picture;
use plan_execution::PlanExecution;
use relocation::Relocation;
use rules::Rules;
use std::sync::Arc;
use view::View;

pub use goal::GoalChange;
pub use plan_execution::{PLANNING_RATE, PlanCounts};
pub use rules::refused_at;

/// The number of the scripted operator of a run, which is that of the first person at a page.
const SCRIPTED: u16 = 1;

/// Parameters of a run.
#[derive(Clone, Debug)]
pub struct MetamodulePlan {
    /// The faults and their times.
    pub schedule: Schedule,
    /// The conditions that end the run. `stall` counts from the last completed action of a body, `livelock`
    /// from the last seed filled.
    pub stop: Stop,
    /// The probability that a connection fails.
    pub failure: Ratio,
    /// Changes of the goal: the time and the number of the new goal, in the order of time.
    pub changes: Vec<(Time, u8)>,
    /// True if the director moves a goal that a dead body or an obstacle in a seed keeps from being built.
    pub relocate: bool,
    /// True if the run ends when the swarm itself has detected a standstill, and no event is planned that may
    /// change that. The swarm detects only if its parameters say so.
    pub follow: bool,
    /// True if metamodules may decide for themselves where a plan leaves seeds unfilled (`planned` only).
    pub hands_over: bool,
    /// How long an order and the report of its result are under way at most.
    pub round_trip: Span,
    /// The scripted operator, with the seed of what it draws.
    pub operator: Option<(Habits, u64)>,
    /// How much metamodules decide for themselves.
    pub level: Level,
    /// The graphs that transports of elements are planned on; all runs that share them save the time to make them.
    pub scenes: Scenes,
}

/// The director of a swarm of metamodules.
#[derive(Clone)]
pub struct MetamoduleDirector {
    setup: Arc<Setup>,
    /// The parameters that a command has changed.
    tuned: Option<Tuning>,
    failure: Ratio,
    monitor: RunMonitor<Order>,
    members: Members,
    goal: Goal,
    relocation: Relocation,
    elements: Elements,
    leases: Leases,
    operator: Option<Operator>,
    /// The execution of plans under the strategy `planned`; `None` under the others.
    execution: Option<PlanExecution>,
    /// Moves of bodies, at the last look.
    moves: u64,
}

impl MetamoduleDirector {
    /// Creates a director for a swarm of this many metamodules.
    pub fn new(setup: Arc<Setup>, metamodules: usize, plan: MetamodulePlan) -> MetamoduleDirector {
        let is_planned = setup.params.strategy == Strategy::Planned;
        // An operator may help a swarm that has found out that it cannot continue.
        let ends_when_detected = plan.follow && plan.operator.is_none();
        MetamoduleDirector {
            goal: Goal::new(&setup, plan.changes),
            setup,
            tuned: None,
            failure: plan.failure,
            monitor: RunMonitor::new(plan.schedule, plan.stop),
            members: Members::new(metamodules, ends_when_detected),
            relocation: Relocation::new(plan.relocate),
            elements: Elements::new(plan.scenes),
            leases: Leases::new(plan.level, is_planned),
            operator: plan.operator.map(|(habits, seed)| Operator::new(habits, 1, seed)),
            execution: is_planned.then(|| PlanExecution::new(plan.hands_over, plan.round_trip)),
            moves: 0,
        }
    }

    /// Returns the faults, the commands and the end of the run.
    pub fn monitor(&self) -> &RunMonitor<Order> {
        &self.monitor
    }
    /// Returns when the swarm itself detected a standstill, and which metamodule did; `None` if it has not, or if that one
    /// has continued after all.
    pub fn detected(&self) -> Option<(Time, ModuleId)> {
        self.members.detected()
    }
    /// Returns how often a metamodule has reported a standstill.
    pub fn alarms(&self) -> u32 {
        self.members.alarms()
    }
    /// Returns what has been planned and ordered; `None` for strategies that do not plan centrally.
    pub fn plan_counts(&self) -> Option<PlanCounts> {
        self.execution.as_ref().map(|execution| execution.counts)
    }
    /// Returns the number of locks refused because two metamodules would have met.
    pub fn prevented(&self) -> u64 {
        self.monitor.prevented(self.members.statuses().map(|s| s.prevented))
    }
    /// Returns the goal that is being built, and its place.
    pub fn task(&self) -> Task {
        self.goal.task()
    }
    /// Returns what was done to the goal since it is built, in order.
    pub fn goal_changes(&self) -> &[GoalChange] {
        self.goal.changes()
    }
    /// Returns all goals so far. A goal that has been moved is the same one.
    pub fn stages(&self) -> &[Stage] {
        self.goal.stages()
    }
    /// Returns the seeds that are filled.
    pub fn filled(&self) -> SeedSet {
        self.goal.filled()
    }
    /// Returns the scripted operator, if the run has one.
    pub fn operator(&self) -> Option<&Operator> {
        self.operator.as_ref()
    }
    /// Returns the progress of the run. Seeds stand for cells.
    pub fn progress(&self) -> Progress {
        Progress {
            stage: u16::from(self.task().goal),
            stages: self.setup.goals.len() as u16,
            goal: self.stages().last().map_or(0, |stage| stage.cells),
            filled: self.filled().len(),
            alive: self.members.known().iter().filter(|k| k.alive).count(),
            moves: self.moves,
            standstills: self.monitor.standstill_count(),
            restarts: self.monitor.crashed_and_restarted().1,
            messages: None,
        }
    }

    /// Returns what an operator sees.
    pub fn picture<'a>(&'a self, world: &'a MetamoduleWorld) -> Picture<'a> {
        Picture::new(self.view(world), &self.monitor)
    }
    /// Returns the state in which the last fault left the metamodules, or the beginning of this task if that was later.
    pub fn before(&self) -> Option<&Standstill> {
        self.goal.before()
    }
    /// Returns the current state of the swarm as the input of a search.
    pub fn snapshot(&self, world: &MetamoduleWorld) -> Standstill {
        self.view(world).snapshot()
    }
    /// Returns the elements that are not at their goals, each with a dead metamodule whose latch on it stays closed.
    pub fn pinned(&self, world: &MetamoduleWorld) -> Vec<(usize, ModuleId)> {
        elements::pinned(self.view(world))
    }
    /// Returns the next element if there is no transport to its goal, with the dead metamodules in the way. See
    /// [`Elements::blocked`].
    pub fn blocked(&self, world: &MetamoduleWorld) -> Option<(usize, Vec<ModuleId>)> {
        self.elements.blocked(self.view(world))
    }
    /// Returns true if an element is not at its goal, or is still held where it is to lie.
    pub fn has_elements_left(&self, world: &MetamoduleWorld) -> bool {
        self.elements.are_left(self.view(world))
    }

    fn view<'a>(&'a self, world: &'a MetamoduleWorld) -> View<'a> {
        View { setup: &self.setup, world, members: &self.members, goal: &self.goal }
    }
    fn rules(&self) -> Rules<'_> {
        Rules { setup: &self.setup, members: &self.members, goal: &self.goal, leases: &self.leases }
    }

    /// Requests a new plan, since the state that the last one was made for has changed.
    fn disturb(&mut self) {
        self.goal.disturb();
        if let Some(execution) = &mut self.execution {
            execution.disturb();
            self.monitor.next_check = Time::ZERO;
        }
    }

    /// Lets the scripted operator look and command.
    fn operate(&mut self, now: Time, world: &MetamoduleWorld) {
        let Some(mut operator) = self.operator.take() else { return };
        let acts = operator.step(now, &[&self.picture(world)]);
        for act in acts {
            match self.rules().check(now, &act.command) {
                Ok(()) => self.monitor.faults.command(now, act.command, SCRIPTED),
                Err(_) => operator.refused(),
            }
        }
        self.operator = Some(operator);
    }

    /// Moves the goal if an immovable body or obstacle is in a seed.
    fn evade(&mut self, now: Time, world: &MetamoduleWorld) {
        self.relocation.forget_trials();
        self.count_filled(now, world);
        if let Some(shift) = self.relocation.evade(self.view(world)) {
            self.move_to(now, shift);
        }
    }
    /// Moves the goal after a standstill. Returns false if there is no place to move it to.
    fn retreat(&mut self, now: Time, world: &MetamoduleWorld) -> bool {
        let view = View { setup: &self.setup, world, members: &self.members, goal: &self.goal };
        self.relocation.retreat(view).map(|shift| self.move_to(now, shift)).is_some()
    }
    fn move_to(&mut self, now: Time, shift: Shift) {
        self.relocation.has_moved = true;
        let before = self.task().shift;
        let by = (shift.0.saturating_sub(before.0), shift.1.saturating_sub(before.1));
        self.goal.note_change(GoalChange::Relocated(by));
        self.monitor.relocate_standstill(now);
        self.begin(now, Task { shift, ..self.task() });
    }

    /// Starts another task; its epoch does not matter.
    fn begin(&mut self, now: Time, task: Task) {
        self.monitor.resolve_standstill(now);
        let is_other_goal = self.goal.begin(now, task, &self.setup);
        self.relocation.begun(is_other_goal);
        self.leases.forget_held();
        (self.monitor.last_gain, self.monitor.last_action) = (now, now);
        self.disturb();
        self.members.order_all(self.goal.seeds(&self.setup), &mut self.monitor.commands);
        self.monitor.next_check = now;
    }

    fn count_filled(&mut self, now: Time, world: &MetamoduleWorld) {
        let filled = self.view(world).filled();
        if self.goal.count(now, filled) {
            self.monitor.last_gain = now;
        }
    }

    fn watch(&mut self, now: Time, world: &MetamoduleWorld) {
        let counts = world.action_counts();
        self.moves = counts.moves;
        let done = counts.turns + counts.moves + counts.released + counts.grips + counts.let_go;
        self.monitor.count_actions(now, done);
        self.monitor.next_check = now + self.setup.params.turn_time;
        self.count_filled(now, world);
        let (setup, members) = (&self.setup, &self.members);
        self.goal.note_state(|goal| View { setup, world, members, goal }.snapshot());
        if let Some(order) = self.goal.announce(&self.setup) {
            self.members.order_all(order, &mut self.monitor.commands);
        }
        if world.elements() > 0 {
            self.elements.announce(world, &self.members, &mut self.monitor.commands);
        }
        let is_filled = !self.task().is_dropped && self.goal.is_filled(&self.setup);
        if self.goal.is_last() && is_filled && self.elements.are_placed(self.view(world)) {
            return self.monitor.finish(now, Outcome::Built);
        }
        let attended = self.operator.as_ref().is_some_and(|operator| operator.attends(0));
        // The end of a lease may resolve a standstill.
        let leased = self.leases.end();
        let is_planned =
            self.monitor.is_event_planned(now) || !self.goal.is_last() || attended || now < leased;
        let view = View { setup: &self.setup, world, members: &self.members, goal: &self.goal };
        if !is_planned && self.relocation.is_stranded(view) && self.retreat(now, world) {
            return;
        }
        let RunMonitor { last_action, last_gain, stop, .. } = self.monitor;
        let no_gain_since = last_gain.max(stop.planned_until).max(leased);
        let idle_since = last_action.max(no_gain_since);
        let is_stranded = self.members.is_end_detected();
        let standing = Standing { is_planned, is_stranded, idle_since, no_gain_since };
        let filled = self.filled().len();
        // The moves of a central plan are no help: without them there is none.
        if let Some(since) = self.monitor.look(now, standing, filled, Help::default(), false) {
            let stall = self.explain(world, since, false);
            self.monitor.begin_standstill(stall);
        }
        let Some(outcome) = self.monitor.verdict(now, standing) else { return };
        if outcome != Outcome::Timeout && self.retreat(now, world) {
            return;
        }
        let since = if outcome == Outcome::Livelock { last_gain } else { idle_since };
        let stall = self.explain(world, since, true);
        self.monitor.give_up(now, outcome, stall);
    }

    fn explain(&self, world: &MetamoduleWorld, since: Time, searches: bool) -> Stall {
        let (view, elements, relocation) = (self.view(world), &self.elements, &self.relocation);
        Diagnosis { view, elements, relocation }.explain(since, searches)
    }
}

impl DirectorPort<MetamoduleWorld> for MetamoduleDirector {
    fn report(&mut self, now: Time, id: ModuleId, report: Status) {
        if self.members.report(now, id, report) || self.execution.is_some() {
            self.monitor.next_check = Time::ZERO;
        }
    }

    fn died(&mut self, _now: Time, id: ModuleId) {
        self.monitor.faults.died(id);
        self.members.died(id);
        self.leases.forget(id);
        self.disturb();
        self.monitor.next_check = Time::ZERO;
    }

    fn external(&mut self, now: Time, id: ModuleId, what: &Outside, world: &MetamoduleWorld) {
        self.monitor.last_action = now;
        self.goal.disturb();
        self.monitor.faults.external(now, id, what, &self.members.describe(id, world));
    }

    fn started(&mut self, now: Time, id: ModuleId) {
        let (before, was_dead) = self.members.started(now, id);
        self.monitor.prevented_before += before.map_or(0, |s| u64::from(s.prevented));
        self.leases.forget(id);
        self.relocation.forget_trials();
        self.disturb();
        if was_dead {
            self.members.order_all(Order::Alive { id }, &mut self.monitor.commands);
        }
        let told = self.goal.announced(&self.setup).into_iter().chain(self.tuned.map(Order::Tune));
        let there = |cell: &_| Order::Obstacle { cell: *cell, there: true };
        for order in told.chain(self.elements.obstacles().iter().map(there)) {
            self.monitor.order(id, order);
        }
    }

    fn wake(&mut self, now: Time, world: &mut MetamoduleWorld) {
        if self.monitor.outcome().is_some() {
            return;
        }
        // Processes on the process link are not up at time zero.
        world.set_failure(self.failure);
        self.operate(now, world);
        while let Some(fault) = self.monitor.faults.due(now) {
            self.inject(now, fault, world);
        }
        while let Some(task) = self.goal.due(now) {
            self.begin(now, task);
        }
        self.leases.hold_idle(now, &self.members, self.goal.filled(), &mut self.monitor.commands);
        if self.members.announce_deaths(world, &mut self.monitor.commands) {
            self.evade(now, world);
        }
        self.watch(now, world);
        if self.monitor.outcome().is_none() && self.members.are_deaths_announced() {
            let view = View { setup: &self.setup, world, members: &self.members, goal: &self.goal };
            if let Some(execution) = &mut self.execution {
                execution.step(now, &self.elements.swarm(view), &mut self.monitor.commands);
            }
        }
    }

    fn input(&mut self, now: Time, kind: &str, bytes: &[u8]) -> Result<(), String> {
        let world = [[&OBSTACLE, &OBSTACLE_GONE, &DROP].as_slice(), &COMMANDS].concat();
        let MetamoduleDirector { setup, members, goal, leases, monitor, .. } = self;
        let rules = Rules { setup, members, goal, leases };
        let modules = members.known().len();
        let rule = |fault: &Fault| rules.check(now, fault);
        monitor.injector()?.input_if(now, kind, bytes, modules, &world, rule)
    }
    fn reseed(&mut self, seed: u64) {
        if let Some(operator) = &mut self.operator {
            operator.reseed(seed);
        }
    }
    fn wake_at(&self) -> Time {
        let operator = self.operator.as_ref().map_or(Time::NEVER, Operator::wake_at);
        let plan = self.execution.as_ref().map_or(Time::NEVER, PlanExecution::ready_at);
        self.monitor.wake_at(operator.min(plan).min(self.goal.next_at()).min(self.leases.next_idle()))
    }
    fn poll(&mut self) -> Option<Command<Order>> {
        self.monitor.commands.pop_front()
    }
    fn struck(&self) -> &[FaultRecord] {
        self.monitor.struck()
    }
}
