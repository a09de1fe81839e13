//! The goal that is built: its place, the seeds that are filled, and what was done to it.

use crate::metamodule::faults::{GOAL_DROPPED, GOAL_MOVED, GOAL_ORDERED, GOAL_SET, GOAL_TURNED};
use crate::metamodule::relocation::Shift;
use metamorph_kernel::director::faults::{Fault, Target};
use metamorph_kernel::director::progress::Stage;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::blueprint::{Seed, SeedOrder, SeedSet, Task};
use metamorph_protocol::metamodule::message::Order;
use metamorph_protocol::metamodule::params::{SeedAuthority, Setup};
use metamorph_protocol::metamodule::planning::cooperative::Standstill;
use metamorph_protocol::time::Time;
use std::collections::VecDeque;

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

/// The present goal and those before it.
#[derive(Clone)]
pub(super) struct Goal {
    task: Task,
    filled: SeedSet,
    /// The task and the filled seeds announced to agents last.
    announced: Option<(Task, SeedSet)>,
    /// Goals to come: the time and the number, in the order of time.
    scheduled: VecDeque<(Time, u8)>,
    /// An entry for every goal so far, the current one last.
    stages: Vec<Stage>,
    /// The changes of the goal since its construction began.
    changes: Vec<GoalChange>,
    /// The state in which the last fault left the metamodules, or the beginning of this task if that was later.
    before: Option<Standstill>,
}

/// Creates the entry of a new goal. Its `known` stays `None`, since no agent counts the filled seeds.
fn opened(setup: &Setup, task: Task, now: Time) -> Stage {
    Stage::opened(setup.goal(task).seeds().len(), now)
}

impl Goal {
    pub fn new(setup: &Setup, scheduled: Vec<(Time, u8)>) -> Goal {
        Goal {
            task: Task::default(),
            filled: SeedSet::default(),
            announced: None,
            scheduled: scheduled.into(),
            stages: vec![opened(setup, Task::default(), Time::ZERO)],
            changes: Vec::new(),
            before: None,
        }
    }
    /// Returns the state in which the last fault left the metamodules, or the beginning of this task if that was later.
    pub fn before(&self) -> Option<&Standstill> {
        self.before.as_ref()
    }
    /// Takes note that a fault has changed the state of the metamodules.
    pub fn disturb(&mut self) {
        self.before = None;
    }
    /// Takes note of the state of the metamodules, unless nothing has struck since the last time.
    pub fn note_state(&mut self, state: impl FnOnce(&Goal) -> Standstill) {
        if self.before.is_none() {
            self.before = Some(state(self));
        }
    }

    pub fn task(&self) -> Task {
        self.task
    }
    pub fn filled(&self) -> SeedSet {
        self.filled
    }
    pub fn stages(&self) -> &[Stage] {
        &self.stages
    }
    pub fn changes(&self) -> &[GoalChange] {
        &self.changes
    }
    /// Returns the seeds that may be filled now.
    pub fn open(&self, setup: &Setup) -> SeedSet {
        setup.goal(self.task).open(self.filled)
    }
    /// Iterates over the seeds that are not filled.
    pub fn unfilled<'a>(&'a self, setup: &'a Setup) -> impl Iterator<Item = (u8, Seed)> + 'a {
        setup.seeds(self.task).filter(|(seed, _)| !self.filled.has(*seed))
    }
    /// Returns true if all seeds of the present goal are filled.
    pub fn is_filled(&self, setup: &Setup) -> bool {
        self.filled.holds(setup.goal(self.task).all())
    }
    /// Returns true if no other goal is scheduled.
    pub fn is_last(&self) -> bool {
        self.scheduled.is_empty()
    }
    /// Returns when the next goal is scheduled.
    pub fn next_at(&self) -> Time {
        self.scheduled.front().map_or(Time::NEVER, |(at, _)| *at)
    }
    /// Takes the next goal if its time has come.
    pub fn due(&mut self, now: Time) -> Option<Task> {
        let (_, goal) = self.scheduled.front().copied().filter(|(at, _)| *at <= now)?;
        self.scheduled.pop_front();
        Some(Task { goal, ..Task::default() })
    }

    /// Starts another task; its epoch does not matter. Returns true if it is about another goal.
    pub fn begin(&mut self, now: Time, task: Task, setup: &Setup) -> bool {
        let is_new = task.goal != self.task.goal;
        if is_new {
            self.stages.push(opened(setup, task, now));
            self.changes.clear();
        }
        self.task = Task { epoch: self.task.epoch.saturating_add(1), ..task };
        self.filled = SeedSet::default();
        self.announced = None;
        is_new
    }
    pub fn note_change(&mut self, change: GoalChange) {
        self.changes.push(change);
    }

    /// Takes the seeds that are filled now. Returns true if they have changed.
    pub fn count(&mut self, now: Time, filled: SeedSet) -> bool {
        let has_changed = filled != self.filled;
        self.filled = filled;
        if let Some(stage) = self.stages.last_mut() {
            stage.filled = filled.len();
            if filled.len() < stage.cells || self.task.is_dropped {
                stage.built = None;
            } else {
                stage.built.get_or_insert(now);
            }
        }
        has_changed
    }
    /// Returns the order that tells metamodules the goal; `None` until the first time that it was to be told.
    pub fn announced(&self, setup: &Setup) -> Option<Order> {
        self.announced.map(|_| self.seeds(setup))
    }
    /// Returns the order that tells metamodules the goal, if it is due: it has changed, and it is told by the controller.
    pub fn announce(&mut self, setup: &Setup) -> Option<Order> {
        let is_controller = setup.params.seed_authority == SeedAuthority::Controller;
        let now = Some((self.task, self.filled));
        if self.announced == now || !(is_controller || self.announced.is_none()) {
            return None;
        }
        self.announced = now;
        is_controller.then(|| self.seeds(setup))
    }
    /// Returns the order that tells metamodules the goal as it stands.
    pub fn seeds(&self, setup: &Setup) -> Order {
        Order::Seeds { task: self.task, open: self.open(setup), filled: self.filled }
    }

    /// Returns the task after a command about the goal; `None` for anything else.
    pub fn commanded(&self, fault: &Fault, setup: &Setup) -> Option<Task> {
        let task = self.task;
        Some(match *fault {
            Fault::World(&GOAL_MOVED, Target::Shift(x, y)) => task.shifted((x, y)),
            Fault::World(&GOAL_TURNED, Target::Number(quarters)) => self.turned((quarters % 4) as u8, setup),
            Fault::World(&GOAL_ORDERED, Target::Word(word)) => {
                Task { order: SeedOrder::ALL.into_iter().find(|order| order.name() == word), ..task }
            }
            Fault::World(&GOAL_DROPPED, _) => Task { is_dropped: true, ..task },
            // A number that no goal has is refused.
            Fault::World(&GOAL_SET, Target::Number(goal)) => {
                Task { goal: u8::try_from(goal).unwrap_or(u8::MAX), ..Task::default() }
            }
            _ => return None,
        })
    }
    /// Returns the task with the goal turned where it stands: the corner of its cells with the least coordinates stays.
    fn turned(&self, quarters: u8, setup: &Setup) -> Task {
        let corner = |task: Task| {
            let cells = || setup.seeds(task).flat_map(|(_, seed)| seed.cells());
            let least = |along: fn(Cell) -> i16| cells().map(along).min().unwrap_or(0);
            (least(|cell| cell.x), least(|cell| cell.y))
        };
        let turned = Task { quarters: (self.task.quarters + quarters) % 4, ..self.task };
        let (before, after) = (corner(self.task), corner(turned));
        turned.shifted((before.0.saturating_sub(after.0), before.1.saturating_sub(after.1)))
    }
    /// Returns the change that a command makes; `None` if another goal is built from then on.
    pub fn change_by(&self, fault: &Fault, task: Task) -> Option<GoalChange> {
        Some(match *fault {
            Fault::World(&GOAL_MOVED, Target::Shift(x, y)) => GoalChange::Moved((x, y)),
            Fault::World(&GOAL_TURNED, Target::Number(quarters)) => GoalChange::Turned((quarters % 4) as u8),
            Fault::World(&GOAL_ORDERED, _) => GoalChange::Ordered(task.order?),
            Fault::World(&GOAL_DROPPED, _) => GoalChange::Dropped,
            Fault::World(&GOAL_SET, _) if task.goal == self.task.goal => GoalChange::Resumed,
            _ => return None,
        })
    }
    /// Describes what a command about the goal changes, as it was before.
    pub fn describe(&self, fault: &Fault, setup: &Setup) -> String {
        let task = self.task;
        match *fault {
            Fault::World(&GOAL_SET, _) => format!("goal {} was built before", task.goal),
            Fault::World(&GOAL_ORDERED, _) => match task.order {
                Some(order) => format!("the order was {} before", order.name()),
                None => "the order was the scenario's before".to_owned(),
            },
            Fault::World(&GOAL_TURNED, _) => {
                format!("the goal was turned by {}° before", u16::from(task.quarters) * 90)
            }
            Fault::World(&GOAL_DROPPED, _) => {
                let seeds = setup.goal(task).seeds().len();
                format!("{} of {seeds} seeds of the goal were filled", self.filled.len())
            }
            _ => format!("the goal was shifted by {:?} before", task.shift),
        }
    }
}
