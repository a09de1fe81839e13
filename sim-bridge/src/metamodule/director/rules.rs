//! The rules that refuse commands of operators to metamodules.

use super::goal::Goal;
use super::leases::Leases;
use super::members::Members;
use crate::metamodule::faults::{COMMANDS, GOAL_DROPPED, GOAL_SET, GOAL_TURNED, TUNED};
use metamorph_kernel::director::faults::{Fault, Target};
use metamorph_kernel::director::operator::Level;
use metamorph_kernel::director::steering::Steering as Wish;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::blueprint::Task;
use metamorph_protocol::metamodule::params::{Setup, Strategy};
use metamorph_protocol::metamodule::tuning::Tuning;
use metamorph_protocol::time::Time;

/// Why a goal that is given up has neither seeds nor a place, and what to do instead.
const GIVEN_UP: &str = "the goal is given up; `goal.set` begins one";

/// The state that decides which commands are refused.
pub(super) struct Rules<'a> {
    pub setup: &'a Setup,
    pub members: &'a Members,
    pub goal: &'a Goal,
    pub leases: &'a Leases,
}

impl Rules<'_> {
    /// Returns the rule that refuses a command, and what to do instead.
    ///
    /// # Errors
    /// If there is one.
    pub fn check(&self, now: Time, fault: &Fault) -> Result<(), String> {
        if let Some(refusal) = refusal(self.leases.level, levels_of(fault)) {
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
            _ => self.goal.commanded(fault, self.setup).map_or(Ok(()), |task| self.rule_of_goal(fault, task)),
        }
    }

    fn rule_of_swap(&self, now: Time, id: ModuleId, other: ModuleId) -> Result<(), String> {
        self.rule_of_steering(id, Wish::Release)?;
        self.rule_of_steering(other, Wish::Release)?;
        for id in [id, other] {
            if self.leases.holding(now, id).is_none() {
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
        if goal == u16::from(self.goal.task().goal) && !self.goal.task().is_dropped {
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
        let Some(known) = self.members.get(id) else { return Ok(()) };
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
            Wish::Take(..) if self.goal.task().is_dropped => refused("goal", GIVEN_UP.to_owned()),
            Wish::Take(seed, _) if !self.setup.goal(self.goal.task()).all().has(seed) => {
                let seeds = self.setup.goal(self.goal.task()).seeds().len();
                refused(
                    "goal",
                    format!("the goal has no seed {seed}; they are numbered from 0 to {}", seeds - 1),
                )
            }
            Wish::Take(seed, _) if self.goal.filled().has(seed) => {
                refused("filled", format!("seed {seed} is filled; take another one"))
            }
            _ => Ok(()),
        }
    }

    /// Returns the rule that refuses to turn, move, reorder or give up the present goal.
    fn rule_of_goal(&self, fault: &Fault, task: Task) -> Result<(), String> {
        if self.goal.task().is_dropped {
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
