//! A randomly generated structure of free modules and its goal.

use crate::generated::{Dice, Failing, GeneratedSwarm, Smaller};
use metamorph_protocol::lattice::Cell;
use metamorph_scenario::family::Swarm;
use std::fmt;

/// The goals that a line of so many modules becomes, the simplest first.
const GOALS: [(usize, &[&str]); 3] =
    [(2, &["line:2", "ell:2"]), (3, &["ell:3", "loop:2x3"]), (4, &["ell:4", "loop:3x3"])];

/// A line and its goal.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GeneratedFreeModules {
    /// The quarter turns of the connections of the line.
    types: Vec<u8>,
    /// The goal.
    goal: &'static str,
}

impl GeneratedFreeModules {
    /// Draws a line and a goal.
    pub fn draw(dice: &mut Dice) -> GeneratedFreeModules {
        let (modules, goals) = dice.pick(&GOALS);
        let types = (1..modules).map(|_| dice.0.below(4) as u8).collect();
        GeneratedFreeModules { types, goal: dice.pick(goals) }
    }
    /// Returns a line that stays as it is.
    pub fn smallest() -> GeneratedFreeModules {
        GeneratedFreeModules { types: vec![0], goal: GOALS[0].1[0] }
    }
}

impl GeneratedSwarm for GeneratedFreeModules {
    fn modules(&self) -> usize {
        self.types.len() + 1
    }
    fn goal_cells(&self) -> usize {
        self.types.len()
    }
    fn summary(&self) -> String {
        format!("{} free modules, {}", self.modules(), self.goal)
    }
    fn settle(&mut self, _: &Swarm) -> bool {
        false
    }
    fn obstacle(&self, _: &mut Dice) -> Option<Cell> {
        None
    }
    fn write(&self, f: &mut fmt::Formatter<'_>, failing: Failing) -> fmt::Result {
        let types: String = self.types.iter().map(u8::to_string).collect();
        writeln!(
            f,
            "family = \"{}\"\nstart = \"line:{}\"\ntypes = \"{types}\"",
            super::NAME,
            self.modules()
        )?;
        failing.write(f, false)?;
        writeln!(f, "\n[[goal]]\nshape = \"{}\"", self.goal)
    }
    fn smaller(&self) -> Vec<Smaller> {
        let mut found = Vec::new();
        let modules = self.modules();
        let mut add = |types: Vec<u8>, goal, gone| {
            let swarm = Box::new(GeneratedFreeModules { types, goal });
            found.push(Smaller { swarm, gone, replaced: false });
        };
        for (fewer, goals) in GOALS.into_iter().filter(|(fewer, _)| *fewer < modules) {
            add(self.types[..fewer - 1].to_vec(), goals[0], fewer..modules);
        }
        let simpler = GOALS.iter().find(|(n, _)| *n == modules).map(|(_, goals)| goals[0]);
        if let Some(goal) = simpler.filter(|goal| *goal != self.goal) {
            add(self.types.clone(), goal, 0..0);
        }
        if self.types.iter().any(|t| *t != 0) {
            add(vec![0; modules - 1], self.goal, 0..0);
        }
        found
    }
}
