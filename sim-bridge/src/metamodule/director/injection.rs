//! How the director of metamodules carries out faults and commands, and the rules that refuse commands.

use super::{GoalChange, MetamoduleDirector};
use crate::director::faults::{Fault, Target};
use crate::director::operator::Level;
use crate::director::steering::Steering as Wish;
use crate::metamodule::faults::{
    COMMANDS, DROP, GOAL_DROPPED, GOAL_MOVED, GOAL_ORDERED, GOAL_SET, GOAL_TURNED, OBSTACLE, OBSTACLE_GONE,
    TUNED,
};
use crate::metamodule::world::MetamoduleWorld;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::blueprint::{SeedOrder, Task};
use metamorph_protocol::metamodule::message::Order;
use metamorph_protocol::metamodule::params::{Precedence, PrecedenceBy, Repulsion, Strategy};
use metamorph_protocol::metamodule::steering::Steering;
use metamorph_protocol::metamodule::tuning::Tuning;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::{Span, Time};
use std::sync::Arc;

/// Why a goal that is given up has neither seeds nor a place, and what to do instead.
const GIVEN_UP: &str = "the goal is given up; `goal.set` begins one";

/// What a metamodule is commanded, and until when.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Commanded {
    pub steering: Steering,
    pub until: Time,
}

impl MetamoduleDirector {
    /// Describes the state of a metamodule at the moment of a fault.
    pub(super) fn found(&self, id: ModuleId, world: &MetamoduleWorld) -> String {
        let known = self.known[id.index()];
        let doing = match known.status {
            _ if !known.alive => "dead",
            Some(s) if s.settled.is_some() => "settled",
            _ => "free",
        };
        let acting = if world.is_acting(id) { ", acting" } else { "" };
        format!("it was {doing} at {}{acting}", world.pose(id).state)
    }

    pub(super) fn inject(&mut self, now: Time, fault: Fault, world: &mut MetamoduleWorld) {
        // A fault or its end may resolve a standstill.
        self.last_action = now;
        let Some(id) = fault.module() else { return self.strike_cell(now, fault, world) };
        let (alive, mut effect, rule) =
            (self.known[id.index()].alive, self.found(id, world), self.rule(now, &fault));
        if let Err(rule) = &rule {
            effect = format!("{effect}; refused: {rule}");
        }
        self.faults.inject(now, fault, alive, effect, &mut self.commands);
        match fault {
            Fault::Stick(_) => world.set_stuck(id, true),
            Fault::Unstick(_) => world.set_stuck(id, false),
            Fault::Steer(_, steering) if rule.is_ok() => self.steer(now, id, steering),
            _ => {}
        }
    }

    fn strike_cell(&mut self, now: Time, fault: Fault, world: &mut MetamoduleWorld) {
        if let Some(task) = self.commanded_task(&fault) {
            return self.change_task(now, fault, task);
        }
        if let Fault::World(&TUNED, Target::Word(word)) = fault {
            return self.tune(now, fault, word);
        }
        let (cell, there, done) = match fault {
            Fault::World(&DROP, Target::Element(element)) => {
                let effect = self.drop_element(usize::from(element), world);
                return self.faults.inject(now, fault, false, effect, &mut self.commands);
            }
            Fault::World(&OBSTACLE, Target::Cell(cell)) => (cell, true, world.block(cell)),
            Fault::World(&OBSTACLE_GONE, Target::Cell(cell)) => (cell, false, world.unblock(cell)),
            _ => {
                let effect = "metamodules have no such fault".to_owned();
                return self.faults.inject(now, fault, false, effect, &mut self.commands);
            }
        };
        let effect = match (there, done) {
            (true, true) => "the cell was free",
            (true, false) => "a metamodule is in the cell, so nothing came into it",
            (false, true) => "the obstacle is gone",
            (false, false) => "there was no obstacle",
        };
        self.faults.inject(now, fault, false, format!("{cell}: {effect}"), &mut self.commands);
        if done {
            self.obstacles = world.obstacles().iter().copied().chain(world.resting()).collect();
            self.order_all(Order::Obstacle { cell, there });
            self.disturb();
            self.relocate(now, world);
        }
    }

    /// Hands a command that no rule refuses to the metamodule.
    fn steer(&mut self, now: Time, id: ModuleId, wish: Wish) {
        let (steering, lease) = match wish {
            Wish::GoTo(to, lease) => (Steering::GoTo((to.x, to.y)), lease),
            Wish::Take(seed, lease) => (Steering::Take(seed), lease),
            Wish::Hold(lease) => (Steering::Hold, lease),
            Wish::Release => (Steering::Release, Span::ZERO),
            Wish::Swap(other) => {
                // Invariant: no rule refuses it, so both have been commanded something.
                if let (Some(own), Some(others)) = (self.holding(now, id), self.holding(now, other)) {
                    self.command(id, others);
                    self.command(other, own);
                }
                return;
            }
        };
        self.command(id, Commanded { steering, until: now + lease });
    }

    fn command(&mut self, id: ModuleId, commanded: Commanded) {
        self.leases.insert(id, commanded);
        self.held.remove(&id);
        if commanded.steering == Steering::Release {
            self.released.insert(id);
        } else {
            self.released.remove(&id);
        }
        let Commanded { steering, until } = commanded;
        self.commands.push_back(Command::Order(id, Order::Steer { steering, until }));
    }

    /// Returns true if metamodules stay where they are unless they are commanded to move. Under `planned` the controller
    /// moves them.
    fn holds_idle(&self) -> bool {
        self.level.holds_idle() && self.setup.params.strategy != Strategy::Planned
    }
    /// Tells those that are commanded nothing any more to stay, if that is their level.
    pub(super) fn hold_idle(&mut self, now: Time) {
        if !self.holds_idle() {
            return;
        }
        for id in (0..self.known.len() as u32).map(ModuleId) {
            let is_idle = self.holding(now, id).is_none_or(|commanded| self.is_in_vain(commanded));
            let is_there = self.known[id.index()].alive && !self.released.contains(&id);
            if is_there && is_idle && self.held.insert(id) {
                let (steering, until) = (Steering::Hold, Time::NEVER);
                self.commands.push_back(Command::Order(id, Order::Steer { steering, until }));
            }
        }
    }
    /// Returns true if the seed that is to be filled is filled: the metamodule then decides for itself.
    fn is_in_vain(&self, commanded: Commanded) -> bool {
        matches!(commanded.steering, Steering::Take(seed) if self.filled.has(seed))
    }
    /// Returns when the next metamodule is to be told to stay.
    pub(super) fn next_idle(&self) -> Time {
        let are_to_stay = self.holds_idle();
        let own = |id: &ModuleId| are_to_stay && !self.held.contains(id) && !self.released.contains(id);
        let ends = self.leases.iter().filter(|(id, _)| own(id)).map(|(_, commanded)| commanded.until);
        ends.min().unwrap_or(Time::NEVER)
    }
    /// A process that has ended has forgotten what it was commanded.
    pub(super) fn forget_commands(&mut self, id: ModuleId) {
        self.held.remove(&id);
        self.released.remove(&id);
        if self.holds_idle() {
            self.leases.remove(&id);
        }
    }

    /// Returns what a metamodule is commanded at this time.
    fn holding(&self, now: Time, id: ModuleId) -> Option<Commanded> {
        self.leases.get(&id).copied().filter(|c| c.steering != Steering::Release && now < c.until)
    }

    /// Returns the task after a command about the goal; `None` for anything else.
    fn commanded_task(&self, fault: &Fault) -> Option<Task> {
        let task = self.task;
        Some(match *fault {
            Fault::World(&GOAL_MOVED, Target::Shift(x, y)) => task.shifted((x, y)),
            Fault::World(&GOAL_TURNED, Target::Number(quarters)) => self.turned((quarters % 4) as u8),
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
    fn turned(&self, quarters: u8) -> Task {
        let corner = |task: Task| {
            let cells = || self.setup.seeds(task).flat_map(|(_, seed)| seed.cells());
            let least = |along: fn(Cell) -> i16| cells().map(along).min().unwrap_or(0);
            (least(|cell| cell.x), least(|cell| cell.y))
        };
        let turned = Task { quarters: (self.task.quarters + quarters) % 4, ..self.task };
        let (before, after) = (corner(self.task), corner(turned));
        turned.shifted((before.0.saturating_sub(after.0), before.1.saturating_sub(after.1)))
    }

    fn change_task(&mut self, now: Time, fault: Fault, task: Task) {
        let rule = self.rule(now, &fault);
        let is_taken = rule.is_ok();
        let effect = rule.map_or_else(
            |rule| format!("refused: {rule}"),
            |()| match fault {
                Fault::World(&GOAL_SET, _) => format!("goal {} was built before", self.task.goal),
                Fault::World(&GOAL_ORDERED, _) => match self.task.order {
                    Some(order) => format!("the order was {} before", order.name()),
                    None => "the order was the scenario's before".to_owned(),
                },
                Fault::World(&GOAL_TURNED, _) => {
                    format!("the goal was turned by {}° before", u16::from(self.task.quarters) * 90)
                }
                Fault::World(&GOAL_DROPPED, _) => {
                    let seeds = self.setup.goal(self.task).seeds().len();
                    format!("{} of {seeds} seeds of the goal were filled", self.filled.len())
                }
                _ => format!("the goal was shifted by {:?} before", self.task.shift),
            },
        );
        self.faults.inject(now, fault, false, effect, &mut self.commands);
        if is_taken {
            self.moved |= matches!(fault, Fault::World(&GOAL_MOVED | &GOAL_TURNED, _));
            let change = self.change_of(&fault, task);
            self.begin(now, task);
            self.goal_changes.extend(change);
        }
    }

    /// Returns what a command does to the goal; `None` if another goal is built from then on.
    fn change_of(&self, fault: &Fault, task: Task) -> Option<GoalChange> {
        Some(match *fault {
            Fault::World(&GOAL_MOVED, Target::Shift(x, y)) => GoalChange::Moved((x, y)),
            Fault::World(&GOAL_TURNED, Target::Number(quarters)) => GoalChange::Turned((quarters % 4) as u8),
            Fault::World(&GOAL_ORDERED, _) => GoalChange::Ordered(task.order?),
            Fault::World(&GOAL_DROPPED, _) => GoalChange::Dropped,
            Fault::World(&GOAL_SET, _) if task.goal == self.task.goal => GoalChange::Resumed,
            _ => return None,
        })
    }

    fn tune(&mut self, now: Time, fault: Fault, word: &str) {
        let tuned = Tuning::of(&self.setup.params).and_then(|before| tuned(before, word));
        let effect = match (self.rule(now, &fault), tuned) {
            (Ok(()), Some(tuning)) => {
                self.setup = Arc::new(tuning.apply(&self.setup));
                self.tuned = Some(tuning);
                self.order_all(Order::Tune(tuning));
                format!("{word} from now on")
            }
            (Err(rule), _) => format!("refused: {rule}"),
            (Ok(()), None) => format!("refused: there is no `{word}`"),
        };
        self.faults.inject(now, fault, false, effect, &mut self.commands);
    }

    /// Returns the rule that refuses a command, and what to do instead.
    ///
    /// # Errors
    /// If there is one.
    pub(super) fn rule(&self, now: Time, fault: &Fault) -> Result<(), String> {
        if let Some(refusal) = refusal(self.level, levels_of(fault)) {
            return Err(refusal);
        }
        match *fault {
            Fault::Steer(id, Wish::Swap(other)) => self.rule_of_swap(now, id, other),
            Fault::Steer(id, steering) => self.rule_of_steering(id, steering),
            Fault::World(&GOAL_SET, Target::Number(goal)) => self.rule_of_another_goal(goal),
            Fault::World(&TUNED, _) if Tuning::of(&self.setup.params).is_none() => Err(format!(
                "strategy: `{}` has no such parameters; only greedy, slope and step have",
                self.setup.params.strategy.name()
            )),
            _ => self.commanded_task(fault).map_or(Ok(()), |task| self.rule_of_goal(fault, task)),
        }
    }

    fn rule_of_swap(&self, now: Time, id: ModuleId, other: ModuleId) -> Result<(), String> {
        self.rule_of_steering(id, Wish::Release)?;
        self.rule_of_steering(other, Wish::Release)?;
        for id in [id, other] {
            if self.holding(now, id).is_none() {
                let why = "which can be swapped; command `take`, `goto` or `hold` first";
                return Err(format!("no-command: metamodule {id} has been commanded nothing {why}"));
            }
        }
        Ok(())
    }

    fn rule_of_another_goal(&self, goal: u16) -> Result<(), String> {
        if self.setup.params.strategy == Strategy::Planned {
            let why = "under `planned` goals change only at their times; use another strategy";
            return Err(format!("central-plan: {why}"));
        }
        let goals = self.setup.goals.len();
        if usize::from(goal) >= goals {
            let why = format!("the scenario has no goal {goal}; they are numbered from 0 to {}", goals - 1);
            return Err(format!("goal: {why}"));
        }
        if goal == u16::from(self.task.goal) && !self.task.is_dropped {
            return Err(format!("goal: goal {goal} is the one that is built; `goal.move` moves it"));
        }
        Ok(())
    }

    fn rule_of_steering(&self, id: ModuleId, steering: Wish) -> Result<(), String> {
        let refused = |rule: &str, why: String| Err(format!("{rule}: {why}"));
        if self.setup.params.strategy == Strategy::Planned {
            let why = "under `planned` the controller moves all metamodules; use another strategy".to_owned();
            return refused("central-plan", why);
        }
        // An unknown module is refused by its number.
        let Some(known) = self.known.get(id.index()) else { return Ok(()) };
        if !known.alive {
            return refused("dead", format!("the process of metamodule {id} is dead; restart it first"));
        }
        if let Some(seed) = known.status.and_then(|status| status.settled) {
            let why = format!("metamodule {id} fills seed {seed} and stays there until the goal changes");
            return refused("settled", why);
        }
        match steering {
            Wish::GoTo(Cell { x, y, z }, _) if z != 0 || !self.setup.floor.has(x, y) => {
                refused("floor", format!("there is no connector at [{x}, {y}, {z}]; choose one of the floor"))
            }
            Wish::Take(..) if self.task.is_dropped => refused("goal", GIVEN_UP.to_owned()),
            Wish::Take(seed, _) if !self.setup.goal(self.task).all().has(seed) => {
                let seeds = self.setup.goal(self.task).seeds().len();
                refused(
                    "goal",
                    format!("the goal has no seed {seed}; they are numbered from 0 to {}", seeds - 1),
                )
            }
            Wish::Take(seed, _) if self.filled.has(seed) => {
                refused("filled", format!("seed {seed} is filled; take another one"))
            }
            _ => Ok(()),
        }
    }

    /// Returns the rule that refuses to turn, move, reorder or give up the present goal.
    fn rule_of_goal(&self, fault: &Fault, task: Task) -> Result<(), String> {
        if self.task.is_dropped {
            return Err(format!("goal: {GIVEN_UP}"));
        }
        let has_elements = !self.setup.elements.all().is_empty();
        match *fault {
            Fault::World(&GOAL_TURNED, Target::Number(quarters)) if !(1..4).contains(&quarters) => {
                return Err("turn: a goal turns by 1, 2 or 3 quarters".to_owned());
            }
            Fault::World(&GOAL_TURNED | &GOAL_DROPPED, _) if has_elements => {
                let why = "the goal has passive elements, whose places stay; use `goal.set`";
                return Err(format!("elements: {why}"));
            }
            Fault::World(&GOAL_DROPPED, _) if self.setup.params.strategy == Strategy::Planned => {
                let why = "under `planned` goals change only at their times; use another strategy";
                return Err(format!("central-plan: {why}"));
            }
            _ => {}
        }
        let floor = self.setup.floor;
        let is_on = |cell: Cell| floor.has(cell.x, cell.y);
        if self.setup.seeds(task).any(|(_, seed)| !seed.cells().into_iter().all(is_on)) {
            return Err(format!("floor: the goal would leave the floor at {:?}; move it less", task.shift));
        }
        Ok(())
    }
}

/// The levels at which commands are taken: `release`, others to one metamodule, those about what is built, since that is
/// their own affair only if they move by themselves, and what is of the experiment and no matter of levels.
const OF_RELEASE: &[Level] = &[Level::Safe, Level::Shared];
const OF_STEERING: &[Level] = &[Level::Teleoperation, Level::Safe, Level::Shared];
const OF_GOALS: &[Level] = &[Level::Shared, Level::Full];
const OF_FAULTS: &[Level] = &[Level::Teleoperation, Level::Safe, Level::Shared, Level::Full];

/// Returns the levels of autonomy at which a command is taken.
fn levels_of(fault: &Fault) -> &'static [Level] {
    match fault {
        Fault::Steer(_, Wish::Release) => OF_RELEASE,
        Fault::Steer(..) => OF_STEERING,
        Fault::World(kind, _) if COMMANDS.contains(kind) => OF_GOALS,
        _ => OF_FAULTS,
    }
}

/// Returns why a level refuses commands that these levels allow.
fn refusal(own: Level, allowing: &[Level]) -> Option<String> {
    if allowing.contains(&own) {
        return None;
    }
    let names: Vec<String> = allowing.iter().map(|level| format!("`{}`", level.name())).collect();
    let (own, names) = (own.name(), names.join(" or "));
    Some(format!("level: [operator] has `level = \"{own}\"`; this command needs {names}"))
}

/// Returns why a level refuses all commands with this verb, for those who offer commands; `None` if it does not.
pub fn refused_at(level: Level, verb: &str) -> Option<String> {
    let allowing = match verb {
        "release" => OF_RELEASE,
        _ if Wish::VERBS.contains(&verb) => OF_STEERING,
        _ if COMMANDS.iter().any(|kind| kind.name == verb) => OF_GOALS,
        _ => OF_FAULTS,
    };
    refusal(level, allowing)
}

/// Returns parameters of which one has the value that a word such as `strategy=slope` says. `None` if it says none.
fn tuned(before: Tuning, word: &str) -> Option<Tuning> {
    let (key, value) = word.split_once('=')?;
    let strategy = Strategy::PUBLISHED.into_iter().find(|strategy| strategy.name() == value);
    let within = before.precedence.or(Strategy::Greedy.precedence())?.within;
    let by = PrecedenceBy::ALL.into_iter().find(|by| by.name() == value);
    Some(match (key, value) {
        ("strategy", _) => {
            let strategy = strategy?;
            let (repulsion, precedence) = (strategy.repulsion(), strategy.precedence());
            Tuning { strategy, repulsion, precedence, ..before }
        }
        ("repulsion", "off") => Tuning { repulsion: Repulsion { strength: 0, ..before.repulsion }, ..before },
        ("repulsion", _) => Tuning { repulsion: strategy?.repulsion(), ..before },
        ("precedence", "off") => Tuning { precedence: None, ..before },
        ("precedence", _) => Tuning { precedence: Some(Precedence { within, by: by? }), ..before },
        ("settled_repel", _) => Tuning { settled_repel: value.parse().ok()?, ..before },
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metamodule::faults::TUNABLE;

    #[test]
    fn every_word_changes_a_parameter_of_some_strategy() {
        for word in TUNABLE {
            let changes = Strategy::PUBLISHED.into_iter().any(|strategy| {
                let (repulsion, precedence) = (strategy.repulsion(), strategy.precedence());
                [true, false].into_iter().any(|settled_repel| {
                    let before = Tuning { strategy, repulsion, precedence, settled_repel };
                    tuned(before, word).unwrap() != before
                })
            });
            assert!(changes, "{word}");
        }
        let before = Tuning {
            strategy: Strategy::Slope,
            repulsion: Strategy::Slope.repulsion(),
            precedence: None,
            settled_repel: true,
        };
        for word in ["strategy=negotiated", "precedence=3", "settled_repel=off", "patience=3s", "strategy"] {
            assert_eq!(tuned(before, word), None, "{word}");
        }
    }
}
