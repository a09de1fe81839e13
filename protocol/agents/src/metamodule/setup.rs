//! The setup that all metamodules of a swarm share: parameters, floor, goals, motions, elements.

use super::blueprint::{Blueprint, Floor, Seed, Task};
use super::elements::Elements;
use super::motions::Motions;
use super::params::Params;
use metamorph_roombots::Kind;
use serde::{Deserialize, Serialize};

/// Parameters, goals and tables that all agents of a swarm share.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Setup {
    /// The parameters.
    pub params: Params,
    /// The floor.
    pub floor: Floor,
    /// The goals, of which one at a time is built. The first one is the task at the beginning.
    pub goals: Vec<Blueprint>,
    /// The motion database of the metamodules' kind.
    pub motions: Motions,
    /// The passive elements.
    pub elements: Elements,
}

impl Setup {
    /// The goal of a swarm that has none: it has no seeds. Every setup from a scenario has a goal.
    pub const NO_GOAL: &'static Blueprint = &Blueprint::NOTHING;

    /// Returns the goal of a task in its order, neither turned nor moved.
    pub fn goal(&self, task: Task) -> &Blueprint {
        let goal = self.goals.get(usize::from(task.goal)).filter(|_| !task.is_dropped);
        let goal = goal.unwrap_or(Setup::NO_GOAL);
        task.order.map_or(goal, |order| goal.in_order(order))
    }
    /// Returns a seed of a task, where the task has it.
    pub fn seed(&self, task: Task, seed: u8) -> Option<Seed> {
        self.goal(task).seeds().get(usize::from(seed)).map(|s| task.moved(*s))
    }
    /// Iterates over all seeds of a task with their numbers, where the task has them.
    pub fn seeds(&self, task: Task) -> impl Iterator<Item = (u8, Seed)> + '_ {
        (0u8..).zip(self.goal(task).seeds()).map(move |(i, s)| (i, task.moved(*s)))
    }
    /// The kind of the metamodules.
    pub fn kind(&self) -> Kind {
        self.motions.kind()
    }
}
