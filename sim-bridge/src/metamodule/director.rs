//! The director of metamodules: opens seeds level by level in the order of the blueprint, injects faults,
//! certifies deaths, watches progress and decides how the run ends.

mod diagnosis;
mod elements;
mod injection;
pub mod picture;
mod plan_execution;

use crate::director::fault_injector::FaultInjector;
use crate::director::faults::{Fault, FaultRecord, Schedule};
use crate::director::operator::{Habits, Level, Operator};
use crate::director::outcome::{Outcome, Stall};
use crate::director::port::DirectorPort;
use crate::director::progress::{Progress, Stage, Stop};
use crate::metamodule::faults::{COMMANDS, DROP, OBSTACLE, OBSTACLE_GONE};
use crate::metamodule::relocation::{Elsewhere, Shift, Trials, clear_places};
use crate::metamodule::world::MetamoduleWorld;
use injection::Commanded;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::blueprint::{Blueprint, SeedOrder, SeedSet, Task};
use metamorph_protocol::metamodule::message::{Order, Status};
use metamorph_protocol::metamodule::params::{SeedAuthority, Setup, Strategy};
use metamorph_protocol::metamodule::planning::cooperative::{SearchResult, Standstill, WORK, search};
use metamorph_protocol::metamodule::planning::transport::Scenes;
use metamorph_protocol::metamodule::tuning::Tuning;
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::record::Outside;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::{Span, Time};
use plan_execution::PlanExecution;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::sync::Arc;

pub use injection::refused_at;
pub use plan_execution::{PLANNING_RATE, PlanCounts};

/// What is known of a metamodule.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Known {
    alive: bool,
    status: Option<Status>,
    /// When it last moved, or came to its place.
    progress: Time,
}

/// The course of a run.
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

/// A change of the goal while it is built.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GoalChange {
    /// The director moved it, by this much along x and y, to a place where it could be built.
    Relocated(Shift),
    /// A command moved it.
    Moved(Shift),
    /// A command turned it by so many quarters.
    Turned(u8),
    /// A command gave its seeds another order.
    Ordered(SeedOrder),
    /// A command gave it up.
    Dropped,
    /// A command took it up again after it had been given up.
    Resumed,
}

/// The director of a swarm of metamodules.
pub struct MetamoduleDirector {
    setup: Arc<Setup>,
    faults: FaultInjector,
    changes: VecDeque<(Time, u8)>,
    relocate: bool,
    trials: Trials,
    /// True if the goal has been moved.
    moved: bool,
    /// What was done to the goal since it is built.
    goal_changes: Vec<GoalChange>,
    /// The result of the last search for another place, at the last standstill.
    elsewhere: Option<Elsewhere>,
    /// The task and the filled seeds at which all metamodules were last found to have no path.
    out_of_reach: Option<(Task, SeedSet)>,
    stop: Stop,
    failure: Ratio,
    task: Task,
    /// An entry for every goal so far, the current one last.
    stages: Vec<Stage>,
    known: Vec<Known>,
    /// Cells with a foreign object in them, as announced.
    obstacles: BTreeSet<Cell>,
    /// Dead metamodules whose death has not been announced yet.
    untold: BTreeSet<ModuleId>,
    dead: BTreeSet<ModuleId>,
    commands: VecDeque<Command<Order>>,
    filled: SeedSet,
    told: Option<(Task, SeedSet)>,
    /// Locks refused in incarnations that have ended.
    prevented_before: u64,
    done: u64,
    moves: u64,
    last_action: Time,
    last_fill: Time,
    next_check: Time,
    outcome: Option<(Time, Outcome)>,
    stall: Option<Stall>,
    follow: bool,
    detected: Option<(Time, ModuleId)>,
    alarms: u32,
    /// The execution of plans under the strategy `planned`; `None` under the others.
    execution: Option<PlanExecution>,
    operator: Option<Operator>,
    /// What metamodules were commanded last.
    leases: BTreeMap<ModuleId, Commanded>,
    /// How much metamodules decide for themselves. If they hold when they are commanded nothing: those that have been told to,
    /// and those that an operator has released from that.
    level: Level,
    scenes: Scenes,
    held: BTreeSet<ModuleId>,
    released: BTreeSet<ModuleId>,
    /// The parameters that a command has changed.
    tuned: Option<Tuning>,
}

/// Creates the entry of a new goal. Its `known` stays `None`, since no agent counts the filled seeds.
fn opened(goal: &Blueprint, now: Time) -> Stage {
    Stage { cells: goal.seeds().len(), filled: 0, opened: now, built: None, known: None }
}

impl MetamoduleDirector {
    /// Creates a director for a swarm of this many metamodules.
    pub fn new(setup: Arc<Setup>, metamodules: usize, plan: MetamodulePlan) -> MetamoduleDirector {
        let is_planned = setup.params.strategy == Strategy::Planned;
        let stages = vec![opened(setup.goal(Task::default()), Time::ZERO)];
        MetamoduleDirector {
            setup,
            faults: FaultInjector::new(plan.schedule),
            changes: plan.changes.into(),
            relocate: plan.relocate,
            trials: Trials::default(),
            moved: false,
            goal_changes: Vec::new(),
            elsewhere: None,
            out_of_reach: None,
            stop: plan.stop,
            failure: plan.failure,
            task: Task::default(),
            stages,
            known: vec![Known::default(); metamodules],
            obstacles: BTreeSet::new(),
            untold: BTreeSet::new(),
            dead: BTreeSet::new(),
            commands: VecDeque::new(),
            filled: SeedSet::default(),
            told: None,
            prevented_before: 0,
            done: 0,
            moves: 0,
            last_action: Time::ZERO,
            last_fill: Time::ZERO,
            next_check: Time::ZERO,
            outcome: None,
            stall: None,
            follow: plan.follow,
            detected: None,
            alarms: 0,
            leases: BTreeMap::new(),
            level: plan.level,
            scenes: plan.scenes,
            held: BTreeSet::new(),
            released: BTreeSet::new(),
            tuned: None,
            operator: plan.operator.map(|(habits, seed)| Operator::new(habits, 1, seed)),
            execution: is_planned.then(|| PlanExecution::new(plan.hands_over, plan.round_trip)),
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
    /// Returns when the swarm itself detected a standstill, and which metamodule did; `None` if it has not,
    /// or if one went on after all.
    pub fn detected(&self) -> Option<(Time, ModuleId)> {
        self.detected
    }
    /// Returns the current state of the swarm as the input of a search.
    pub fn snapshot(&self, world: &MetamoduleWorld) -> Standstill {
        self.standstill(world, |known| known.status.is_none_or(|s| s.settled.is_none()))
    }
    /// Returns how often a metamodule has reported a standstill.
    pub fn alarms(&self) -> u32 {
        self.alarms
    }
    /// Returns what has been planned and ordered; `None` for strategies that do not plan centrally.
    pub fn plan_counts(&self) -> Option<PlanCounts> {
        self.execution.as_ref().map(|execution| execution.counts)
    }
    /// Returns the faults injected so far.
    pub fn struck(&self) -> &[FaultRecord] {
        self.faults.struck()
    }
    /// Returns how many processes died, and how many were restarted.
    pub fn crashed_and_restarted(&self) -> (u64, u64) {
        self.faults.crashed_and_restarted()
    }
    /// Returns when the last seed was filled.
    pub fn last_fill(&self) -> Time {
        self.last_fill
    }
    /// Returns the number of locks refused because two metamodules would have met.
    pub fn prevented(&self) -> u64 {
        let now: u64 = self.known.iter().filter_map(|k| k.status).map(|s| u64::from(s.prevented)).sum();
        self.prevented_before + now
    }
    /// Returns the goal that is being built, and its place.
    pub fn task(&self) -> Task {
        self.task
    }
    /// Returns what was done to the goal since it is built, in order.
    pub fn goal_changes(&self) -> &[GoalChange] {
        &self.goal_changes
    }
    /// Returns all goals so far. A goal that has been moved is the same one.
    pub fn stages(&self) -> &[Stage] {
        &self.stages
    }
    /// Returns the seeds that are filled.
    pub fn filled(&self) -> SeedSet {
        self.filled
    }
    /// Returns the progress of the run. Seeds stand for cells.
    pub fn progress(&self) -> Progress {
        Progress {
            stage: u16::from(self.task.goal),
            stages: self.setup.goals.len() as u16,
            goal: self.stages.last().map_or(0, |stage| stage.cells),
            filled: self.filled.len(),
            alive: self.known.iter().filter(|k| k.alive).count(),
            moves: self.moves,
            messages: None,
        }
    }

    fn finish(&mut self, now: Time, outcome: Outcome) {
        if self.outcome.is_none() {
            self.outcome = Some((now, outcome));
            self.commands.push_back(Command::Finish);
        }
    }

    /// Requests a new plan, since the state that the last one was made for has changed.
    fn disturb(&mut self) {
        if let Some(execution) = &mut self.execution {
            execution.disturb();
            self.next_check = Time::ZERO;
        }
    }

    /// Plans and orders what is due.
    fn carry_out(&mut self, now: Time, world: &MetamoduleWorld) {
        let Some(mut execution) = self.execution.take() else { return };
        let mut commands = std::mem::take(&mut self.commands);
        execution.step(now, &self.swarm(world), &mut commands);
        (self.execution, self.commands) = (Some(execution), commands);
    }

    fn order_all(&mut self, order: Order) {
        for id in (0..self.known.len() as u32).map(ModuleId) {
            self.commands.push_back(Command::Order(id, order));
        }
    }

    /// Returns the cells that no living metamodule can clear: those of dead bodies and of obstacles.
    fn foreign(&self, world: &MetamoduleWorld) -> BTreeSet<Cell> {
        let dead = self.dead.iter().flat_map(|id| world.cells(*id));
        dead.chain(world.obstacles()).copied().collect()
    }

    /// Returns true if an immovable body or obstacle is in a cell of a seed that is not filled.
    fn is_seed_blocked(&self, foreign: &BTreeSet<Cell>) -> bool {
        let mut unfilled = self.setup.seeds(self.task).filter(|(s, _)| !self.filled.has(*s));
        unfilled.any(|(_, seed)| seed.cells().iter().any(|c| foreign.contains(c)))
    }

    /// Moves the goal if an immovable body or obstacle is in a seed: to the clear place with the most room around it,
    /// of several to the nearest (see [`clear_places`]).
    fn relocate(&mut self, now: Time, world: &MetamoduleWorld) {
        self.trials.forget();
        self.count_filled(now, world);
        let foreign = self.foreign(world);
        if self.relocate
            && self.is_seed_blocked(&foreign)
            && let Some(shift) = self.clear_place(&foreign)
        {
            self.move_to(now, shift);
        }
    }

    /// Returns true if an open seed is unreachable for every metamodule that could fill it.
    fn is_out_of_reach(&self, world: &MetamoduleWorld) -> bool {
        let free = || {
            let all = (0..).map(ModuleId).zip(&self.known).filter(|(id, k)| k.alive && !world.is_stuck(*id));
            all.filter_map(|(_, k)| k.status).filter(|s| s.settled.is_none())
        };
        let open = self.setup.goal(self.task).open(self.filled);
        free().next().is_some() && open.iter().any(|seed| free().all(|s| s.unreachable.has(seed)))
    }

    /// Returns the input of a search for another place of the goal: no seed is filled, and all metamodules that can
    /// move are free.
    fn all_free(&self, world: &MetamoduleWorld) -> Standstill {
        Standstill { filled: SeedSet::default(), ..self.standstill(world, |_| true) }
    }

    fn standstill(&self, world: &MetamoduleWorld, is_free: impl Fn(&Known) -> bool) -> Standstill {
        let (mut free, mut fixed) = (Vec::new(), Vec::from_iter(world.obstacles().iter().copied()));
        for (id, known) in (0..).map(ModuleId).zip(&self.known) {
            let pose = world.pose(id);
            if known.alive && !world.is_stuck(id) && is_free(known) {
                // A metamodule held at both ends lets go of the older one first.
                let around = self.setup.motions.turned_around(pose).filter(|_| pose.both);
                free.push(around.unwrap_or(pose));
            } else {
                fixed.extend(world.cells(id));
            }
        }
        fixed.extend((0..world.elements()).flat_map(|e| world.element(e)));
        let setup = Arc::clone(&self.setup);
        Standstill { setup, task: self.task, filled: self.filled, free, fixed }
    }

    /// Moves the goal after a standstill: for `negotiated` to a place where a search builds it or may; for the
    /// others, whose local minima no search predicts, once to a clear place. Returns true if it has been moved.
    fn move_away(&mut self, now: Time, world: &MetamoduleWorld) -> bool {
        if !self.relocate || self.task.is_dropped {
            return false;
        }
        let to = if !self.setup.params.strategy.is_published() {
            let next = self.trials.next(&self.all_free(world));
            self.elsewhere = Some(next);
            match next {
                Elsewhere::Place(shift) => Some(shift),
                Elsewhere::Barred(_) | Elsewhere::Unproved => None,
            }
        } else {
            let foreign = self.foreign(world);
            let may_move = !self.moved && !foreign.is_empty();
            may_move.then(|| self.clear_place(&foreign)).flatten()
        };
        to.map(|shift| self.move_to(now, shift)).is_some()
    }

    fn clear_place(&self, foreign: &BTreeSet<Cell>) -> Option<Shift> {
        clear_places(&self.setup, self.task, foreign).into_iter().find(|shift| *shift != self.task.shift)
    }

    fn move_to(&mut self, now: Time, shift: Shift) {
        self.moved = true;
        let before = self.task.shift;
        let by = (shift.0.saturating_sub(before.0), shift.1.saturating_sub(before.1));
        self.goal_changes.push(GoalChange::Relocated(by));
        self.begin(now, Task { shift, ..self.task });
    }

    /// Starts another task; its epoch does not matter.
    fn begin(&mut self, now: Time, task: Task) {
        if task.goal != self.task.goal {
            self.stages.push(opened(self.setup.goal(task), now));
            self.goal_changes.clear();
            self.trials.forget();
        }
        self.task = Task { epoch: self.task.epoch.saturating_add(1), ..task };
        self.filled = SeedSet::default();
        self.elsewhere = None;
        // Those that filled a seed took no command.
        self.held.clear();
        (self.last_fill, self.last_action) = (now, now);
        self.disturb();
        let order = self.seeds();
        self.order_all(order);
        self.told = None;
        self.next_check = now;
    }

    /// Tells all metamodules the cells of the dead, once their bodies have come to rest.
    fn tell_deaths(&mut self, now: Time, world: &MetamoduleWorld) {
        let still: Vec<ModuleId> = self.untold.iter().copied().filter(|id| !world.is_acting(*id)).collect();
        for dead in &still {
            self.untold.remove(dead);
            self.order_all(Order::Dead { id: *dead, pose: world.pose(*dead) });
        }
        if !still.is_empty() {
            self.relocate(now, world);
        }
    }

    fn count_filled(&mut self, now: Time, world: &MetamoduleWorld) {
        let mut filled = SeedSet::default();
        for (i, seed) in self.setup.seeds(self.task) {
            let cells = seed.cells();
            let fills = |(id, known): (usize, &Known)| {
                let stays = !known.alive || known.status.is_some_and(|s| s.settled == Some(i));
                stays && *world.cells(ModuleId(id as u32)) == cells
            };
            if self.known.iter().enumerate().any(fills) {
                filled = filled.with(i);
            }
        }
        if filled != self.filled {
            self.filled = filled;
            self.last_fill = now;
        }
        let all = self.setup.goal(self.task).seeds().len();
        if let Some(stage) = self.stages.last_mut() {
            stage.filled = filled.len();
            if filled.len() < all || self.task.is_dropped {
                stage.built = None;
            } else {
                stage.built.get_or_insert(now);
            }
        }
    }

    fn seeds(&self) -> Order {
        let open = self.setup.goal(self.task).open(self.filled);
        Order::Seeds { task: self.task, open, filled: self.filled }
    }

    fn watch(&mut self, now: Time, world: &MetamoduleWorld) {
        let action_counts = world.action_counts();
        self.moves = action_counts.moves;
        let done = action_counts.turns
            + action_counts.moves
            + action_counts.released
            + action_counts.grips
            + action_counts.let_go;
        if done != self.done {
            self.done = done;
            self.last_action = now;
        }
        self.next_check = now + self.setup.params.turn_time;
        self.count_filled(now, world);
        let told_by_us = self.setup.params.seed_authority == SeedAuthority::Controller;
        if self.told != Some((self.task, self.filled)) && (told_by_us || self.told.is_none()) {
            self.told = Some((self.task, self.filled));
            if told_by_us {
                let order = self.seeds();
                self.order_all(order);
            }
        }
        if world.elements() > 0 {
            self.tell_obstacles(world);
        }
        let is_filled = !self.task.is_dropped && self.filled.holds(self.setup.goal(self.task).all());
        if self.changes.is_empty() && is_filled && self.are_elements_placed(world) {
            return self.finish(now, Outcome::Built);
        }
        let cut = now < self.stop.planned_until;
        let attended = self.operator.as_ref().is_some_and(|operator| operator.attends(0));
        // The end of a lease may resolve a standstill.
        let leased = self.leases.values().map(|commanded| commanded.until).max().unwrap_or(Time::ZERO);
        let planned = self.faults.is_pending() || !self.changes.is_empty() || cut || attended || now < leased;
        if !planned && self.is_stranded(world) && self.move_away(now, world) {
            return;
        }
        // An operator may help a swarm that has found out that it cannot go on.
        let follows = self.follow && self.operator.is_none();
        let idle_since = self.last_action.max(self.last_fill).max(self.stop.planned_until).max(leased);
        if now >= self.stop.timeout {
            self.stall = Some(self.explain(idle_since, world));
            self.finish(now, Outcome::Timeout);
        } else if planned {
            // Further events are planned.
        } else if now.since(idle_since) > self.stop.stall || (follows && self.detected.is_some()) {
            self.stand_still(now, idle_since, Outcome::Deadlock, world);
        } else if now.since(self.last_fill.max(self.stop.planned_until).max(leased)) > self.stop.livelock {
            self.stand_still(now, self.last_fill, Outcome::Livelock, world);
        }
    }

    /// Moves the goal after a standstill, or ends the run.
    fn stand_still(&mut self, now: Time, since: Time, outcome: Outcome, world: &MetamoduleWorld) {
        if !self.move_away(now, world) {
            self.stall = Some(self.explain(since, world));
            self.finish(now, outcome);
        }
    }

    /// Returns true if an open seed is unreachable for all metamodules, and no cooperative plan exists either. As that
    /// takes a search, it is asked once per state of the structure; after that the answer is false.
    fn is_stranded(&mut self, world: &MetamoduleWorld) -> bool {
        let built = (self.task, self.filled);
        if !self.relocate || self.out_of_reach == Some(built) || !self.is_out_of_reach(world) {
            return false;
        }
        self.out_of_reach = Some(built);
        matches!(search(&self.snapshot(world), WORK), SearchResult::NoWay(_))
    }
}

impl DirectorPort<MetamoduleWorld> for MetamoduleDirector {
    fn report(&mut self, now: Time, id: ModuleId, report: Status) {
        let place = |status: Status| (status.pose, status.settled);
        if self.known[id.index()].status.is_none_or(|before| place(before) != place(report)) {
            self.known[id.index()].progress = now;
        }
        let before = self.known[id.index()].status.replace(report);
        self.alarms += u32::from(report.deadlocked && !before.is_some_and(|s| s.deadlocked));
        match (report.deadlocked, self.detected) {
            (true, None) => self.detected = Some((now, id)),
            (false, Some((_, by))) if by == id => self.detected = None,
            _ => {}
        }
        if before.and_then(|s| s.settled) != report.settled || self.execution.is_some() {
            self.next_check = Time::ZERO;
        }
    }

    fn died(&mut self, _now: Time, id: ModuleId) {
        self.faults.died(id);
        self.known[id.index()].alive = false;
        self.forget_commands(id);
        self.detected = self.detected.filter(|(_, by)| *by != id);
        self.dead.insert(id);
        self.untold.insert(id);
        self.disturb();
        self.next_check = Time::ZERO;
    }

    fn external(&mut self, now: Time, id: ModuleId, what: &Outside, world: &MetamoduleWorld) {
        self.last_action = now;
        let found = self.found(id, world);
        self.faults.external(now, id, what, &found);
    }
    fn started(&mut self, now: Time, id: ModuleId) {
        let before = std::mem::replace(
            &mut self.known[id.index()],
            Known { alive: true, status: None, progress: now },
        );
        self.prevented_before += before.status.map_or(0, |s| u64::from(s.prevented));
        self.untold.remove(&id);
        self.forget_commands(id);
        self.trials.forget();
        self.disturb();
        if self.dead.remove(&id) {
            self.order_all(Order::Alive { id });
        }
        if self.told.is_some() {
            let order = self.seeds();
            self.commands.push_back(Command::Order(id, order));
        }
        self.commands.extend(self.tuned.map(|tuning| Command::Order(id, Order::Tune(tuning))));
        let there = |cell: &Cell| Command::Order(id, Order::Obstacle { cell: *cell, there: true });
        self.commands.extend(self.obstacles.iter().map(there));
        // A metamodule that has lost its memory has to be told the deaths again; repeating them to the others
        // is harmless.
        self.untold.extend(self.dead.iter().copied());
    }

    fn wake(&mut self, now: Time, world: &mut MetamoduleWorld) {
        if self.outcome.is_some() {
            return;
        }
        // Processes on the process link are not up at time zero.
        world.set_failure(self.failure);
        self.operate(now, world);
        while let Some(fault) = self.faults.due(now) {
            self.inject(now, fault, world);
        }
        while let Some((_, goal)) = self.changes.front().copied().filter(|(at, _)| *at <= now) {
            self.changes.pop_front();
            self.begin(now, Task { goal, ..Task::default() });
        }
        self.hold_idle(now);
        self.tell_deaths(now, world);
        self.watch(now, world);
        if self.outcome.is_none() && self.untold.is_empty() {
            self.carry_out(now, world);
        }
    }

    fn input(&mut self, now: Time, kind: &str, bytes: &[u8]) -> Result<(), String> {
        if self.outcome.is_some() {
            return Err("the run is over".to_owned());
        }
        let world = [[&OBSTACLE, &OBSTACLE_GONE, &DROP].as_slice(), &COMMANDS].concat();
        // The rules read all but the injector.
        let mut faults = std::mem::take(&mut self.faults);
        let taken = faults
            .input_if(now, kind, bytes, self.known.len(), &world, |fault: &Fault| self.rule(now, fault));
        self.faults = faults;
        taken
    }

    fn wake_at(&self) -> Time {
        if self.outcome.is_some() {
            return Time::NEVER;
        }
        let change = self.changes.front().map_or(Time::NEVER, |(at, _)| *at);
        let operator = self.operator.as_ref().map_or(Time::NEVER, Operator::wake_at);
        let plan = self.execution.as_ref().map_or(Time::NEVER, PlanExecution::ready_at);
        let due = self.faults.next_at().min(change).min(self.next_check).min(self.stop.timeout);
        due.min(plan).min(operator).min(self.next_idle())
    }

    fn poll(&mut self) -> Option<Command<Order>> {
        self.commands.pop_front()
    }

    fn struck(&self) -> &[FaultRecord] {
        self.faults.struck()
    }
}
