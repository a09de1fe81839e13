//! The central plan of a reconfiguration: a search from the sensed configuration, with what cannot act left out.

use crate::assembly::action::{Action, Connectors, Rules};
use crate::assembly::canonical::Detail;
use crate::assembly::collision::Model;
use crate::assembly::configuration::{Configuration, Module};
use crate::assembly::order;
use crate::assembly::shape::Shape;
use crate::assembly::similarity::{labels, shared};
use crate::assembly::space::{Assembly, Goal, Objective, usual_shapes};
use crate::assembly::tables::{TABLES, sub};
use crate::plan::portfolio::Portfolio;
use crate::plan::{Cost, Limits, Outcome, Path, Space, Step, actions};
use siphasher::sip::SipHasher13;
use std::hash::{Hash, Hasher};

/// Number of expansions between two checks of the limits.
const SLICE_EXPANSIONS: u64 = 256;
/// Bytes of a module in a key that tells modules apart: cell, rotation, posture, connectors.
const KEY: usize = 7;

/// How plans are made.
#[derive(Clone, Debug)]
pub struct Planner {
    /// Where plans end.
    pub goal: Goal,
    /// The collision model of turns.
    pub collision: Model,
    /// Which connectors can make a connection.
    pub connectors: Connectors,
    /// The quantity that a plan minimizes.
    pub objective: Objective,
    /// A plan costs at most this many hundredths of the least.
    pub weight: u32,
    /// Memory and work of one plan.
    pub limits: Limits,
}

/// The modules that cannot act, as bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Frozen {
    /// Those whose joints do not turn.
    pub joints: u16,
    /// Those that do nothing and cannot agree to be moved.
    pub dead: u16,
}

impl Frozen {
    fn is_none(self) -> bool {
        self == Frozen::default()
    }
    fn allows(self, action: Action, before: &Configuration, after: &Configuration) -> bool {
        let is_in = |set: u16, module: u8| set >> module & 1 != 0;
        match action {
            Action::Attach(pair) | Action::Detach(pair) => {
                !is_in(self.dead, pair.a.0) && !is_in(self.dead, pair.b.0)
            }
            Action::Turn { module, .. } => {
                let moved = |i: usize| {
                    let place = |m: &Module| (m.cell, m.rotation);
                    place(&before.modules()[i]) != place(&after.modules()[i])
                };
                let carried = (0..before.len()).any(|i| is_in(self.dead, i as u8) && moved(i));
                !is_in(self.joints | self.dead, module) && !carried
            }
        }
    }
}

/// A plan.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plan {
    /// The actions, in an order in which they can be carried out.
    pub actions: Vec<Action>,
    /// For each action those that must be done before it.
    pub after: Vec<Vec<usize>>,
    /// The cost.
    pub cost: Cost,
    /// The proven lower bound of the cost of every plan.
    pub lower: Cost,
}

impl Plan {
    /// Returns a number by which plans are told apart.
    pub fn hash(&self) -> u64 {
        let mut hasher = SipHasher13::new_with_keys(0, 0);
        let mut portable = metamorph_core::digest::Portable::new(&mut hasher);
        (&self.actions, &self.after).hash(&mut portable);
        drop(portable);
        hasher.finish()
    }
}

/// The end of planning.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Planned {
    /// There is a plan.
    Plan(Plan),
    /// There is none: this many configurations, all that can be reached, were examined.
    Impossible(u64),
    /// Memory or work ended before a plan was found.
    Undecided,
}

impl Planner {
    /// Returns the rules of actions.
    pub fn rules(&self) -> Rules {
        Rules::new(self.connectors, self.collision)
    }
    /// Returns true if a configuration is the goal.
    pub fn is_reached(&self, configuration: &Configuration) -> bool {
        match &self.goal {
            Goal::Shape(goal) => {
                let shape = Shape::of(configuration);
                shape.len() == goal.len() && shape.canonical() == goal.canonical()
            }
            Goal::Configuration(goal) => {
                let key = |configuration: &Configuration| {
                    let mut key = vec![0; Detail::Joints.key_width(configuration.len())];
                    Detail::Joints.key(configuration, &mut key);
                    key
                };
                configuration.len() == goal.len() && key(configuration) == key(goal)
            }
            Goal::None => true,
        }
    }
    /// Returns the number of joined faces of the goal, and how many of them a configuration has, by their labels
    /// (report 2.3). All of them may be there although the goal is not reached.
    pub fn joined(&self, configuration: &Configuration) -> (usize, usize) {
        let goal = match &self.goal {
            Goal::Shape(goal) => *goal,
            Goal::Configuration(goal) => Shape::of(goal),
            Goal::None => return (0, 0),
        };
        (goal.joins().len(), shared(&labels(&Shape::of(configuration)), &labels(&goal)))
    }
    /// Returns the space of plans of this many modules. Its bounds take a while to compute and serve for all plans.
    pub fn space(&self, modules: usize) -> Assembly {
        Assembly::new(modules, self.rules(), self.objective, &self.goal, usual_shapes(modules))
    }
    /// Plans from a configuration, in the space of its number of modules. Also returns the work: the expansions of the
    /// search.
    pub fn plan(&self, space: &Assembly, start: &Configuration, frozen: Frozen) -> (Planned, u64) {
        let space = space.clone();
        if frozen.is_none() {
            self.search(space, start)
        } else {
            self.search(Restricted { space, frozen }, start)
        }
    }

    fn search<S: Space<State = Configuration, Action = Action> + Clone>(
        &self,
        space: S,
        start: &Configuration,
    ) -> (Planned, u64) {
        let mut search = Portfolio::new(space.clone(), start, self.limits, self.weight);
        let outcome = loop {
            if let Step::Done(outcome) = search.advance(SLICE_EXPANSIONS) {
                break outcome;
            }
        };
        let found = match outcome {
            Outcome::Solved { path, lower } => self.followed(&space, start, &path, lower),
            Outcome::Impossible { states } => Some(Planned::Impossible(states)),
            Outcome::OutOf { best, lower, .. } => {
                best.and_then(|path| self.followed(&space, start, &path, lower))
            }
        };
        (found.unwrap_or(Planned::Undecided), search.progress().expanded)
    }

    fn followed<S: Space<State = Configuration, Action = Action>>(
        &self,
        space: &S,
        start: &Configuration,
        path: &Path,
        lower: Cost,
    ) -> Option<Planned> {
        let actions = actions(space, start, &path.keys)?;
        let after = order::of(&self.rules(), start, &actions).after;
        Some(Planned::Plan(Plan { actions, after, cost: path.cost, lower: lower.min(path.cost) }))
    }
}

/// A space in which some modules cannot act. Modules are told apart, as some can do what others cannot; the bounds of
/// the space without restrictions hold.
#[derive(Clone)]
struct Restricted {
    space: Assembly,
    frozen: Frozen,
}

impl Space for Restricted {
    type State = Configuration;
    type Action = Action;

    fn key_width(&self) -> usize {
        self.space.modules() * KEY
    }
    fn key(&self, configuration: &Configuration, key: &mut [u8]) {
        let t = &**TABLES;
        let root = configuration.modules()[0];
        let back = t.inverse[usize::from(root.rotation)];
        for (m, key) in configuration.modules().iter().zip(key.chunks_exact_mut(KEY)) {
            let [x, y, z] = t.rotate(back, sub(m.cell, root.cell)).map(|c| c as u8);
            let [low, high] = m.held.to_le_bytes();
            key.copy_from_slice(&[x, y, z, t.times(back, m.rotation), m.posture, low, high]);
        }
    }
    fn state(&self, key: &[u8]) -> Configuration {
        let module = |key: &[u8]| Module {
            cell: [key[0] as i8, key[1] as i8, key[2] as i8],
            rotation: key[3],
            posture: key[4],
            held: u16::from_le_bytes([key[5], key[6]]),
        };
        let modules: Vec<Module> = key.chunks_exact(KEY).map(module).collect();
        Configuration::new(&modules).expect("invariant: keys are of configurations")
    }
    fn expand(&self, configuration: &Configuration, visit: &mut impl FnMut(Action, Cost, &Configuration)) {
        self.space.expand(configuration, &mut |action, cost, next| {
            if self.frozen.allows(action, configuration, next) {
                visit(action, cost, next);
            }
        });
    }
    fn lower(&self, configuration: &Configuration) -> Option<Cost> {
        self.space.lower(configuration)
    }
    fn is_goal(&self, configuration: &Configuration) -> bool {
        self.space.is_goal(configuration)
    }
    fn guide(&self, configuration: &Configuration) -> u32 {
        self.space.guide(configuration)
    }
    fn class(&self, configuration: &Configuration) -> u64 {
        self.space.class(configuration)
    }
    fn bytes(&self) -> usize {
        self.space.bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::assembly::named;

    fn planner(goal: &str) -> Planner {
        Planner {
            goal: Goal::Shape(named::shape(goal).unwrap()),
            collision: Model::Strict,
            connectors: Connectors::All,
            objective: Objective::Actions,
            weight: 100,
            limits: Limits { memory: 64 << 20, work: 100_000 },
        }
    }

    #[test]
    fn plans_leave_out_what_cannot_act() {
        let start = named::line(&[0, 0]).unwrap();
        let planner = planner("loop:2x3");
        let space = planner.space(3);
        let (Planned::Plan(all), _) = planner.plan(&space, &start, Frozen::default()) else {
            panic!("there is a plan")
        };
        assert_eq!(all.cost, all.lower);
        let turns = |plan: &Plan, of: u8| {
            plan.actions.iter().any(|a| matches!(a, Action::Turn { module, .. } if *module == of))
        };
        assert!(turns(&all, 1));
        let frozen = Frozen { joints: 1 << 1, dead: 0 };
        match planner.plan(&space, &start, frozen).0 {
            Planned::Plan(plan) => assert!(!turns(&plan, 1) && plan.cost >= all.cost),
            found => assert!(matches!(found, Planned::Impossible(_)), "{found:?}"),
        }
        // Where nothing can act, what can be reached is the start.
        let dead = Frozen { joints: 0, dead: 0b111 };
        assert_eq!(planner.plan(&space, &start, dead).0, Planned::Impossible(1));
        // And a goal that is there already takes nothing.
        let planner = super::tests::planner("line:3");
        let (Planned::Plan(none), _) = planner.plan(&planner.space(3), &start, dead) else {
            panic!("it is there")
        };
        assert_eq!(none.actions, []);
    }
}
