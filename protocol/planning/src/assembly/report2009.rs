//! The planner of the 2009 report, re-implemented: best-first by label distance, visited by shape.
//!
//! The search is greedy: it ignores the cost so far, and draws ties at random. A configuration whose shape was seen
//! before is dropped whatever its joint values (report 3.2). So the joint values of the first visit decide what can be
//! reached from a shape: the search is incomplete, and a better path to a known shape is never taken.

use super::action::{Action, Rules};
use super::canonical::Detail;
use super::configuration::Configuration;
use super::shape::Shape;
use super::similarity::{labels, shared};
use crate::plan::table::{Id, NO_PARENT, Table};
use metamorph_core::rng::Rng;
use std::collections::BTreeMap;

/// The least common multiple of 1 to 16, so that ratios of up to 16 joins are integers.
const SCALE: u64 = 720_720;

/// Result of the search.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Found {
    /// The number of actions of the first plan, and of configurations generated until it was found.
    pub first: Option<(u32, u64)>,
    /// Actions of the best plan.
    pub best: Option<u32>,
    /// Configurations generated.
    pub generated: u64,
    /// Shapes expanded.
    pub expanded: u64,
}

/// A search under way.
pub struct Report2009 {
    rules: Rules,
    goal: Vec<u8>,
    goal_labels: BTreeMap<Vec<u8>, usize>,
    goal_joins: usize,
    rng: Rng,
    /// The shapes seen, with their depth and parent; `configurations` has the configuration of each, by its number.
    seen: Table,
    configurations: Vec<Box<[u8]>>,
    open: BTreeMap<u64, Vec<Id>>,
    found: Found,
    first: Option<Vec<Id>>,
}

impl Report2009 {
    /// Begins a search.
    pub fn new(rules: Rules, start: &Configuration, goal: &Shape, rng: Rng) -> Report2009 {
        let mut search = Report2009 {
            rules,
            goal: goal.canonical(),
            goal_labels: labels(goal),
            goal_joins: goal.joins().len(),
            rng,
            seen: Table::new(Shape::key_width(start.len())),
            configurations: Vec::new(),
            open: BTreeMap::new(),
            found: Found::default(),
            first: None,
        };
        search.add(start, 0, NO_PARENT);
        search
    }

    /// Returns what has been found.
    pub fn found(&self) -> Found {
        self.found
    }

    /// Returns the label distance, 1 − shared / larger, as a share of [`SCALE`] (report 2.3).
    fn distance(&self, shape: &Shape) -> u64 {
        let own = labels(shape);
        let joins: usize = own.values().sum::<usize>().max(self.goal_joins).max(1);
        let apart = joins - shared(&own, &self.goal_labels);
        apart as u64 * SCALE / joins as u64
    }

    fn add(&mut self, configuration: &Configuration, depth: u32, parent: Id) {
        let shape = Shape::of(configuration);
        let key = shape.canonical();
        let is_goal = key == self.goal;
        if is_goal {
            self.found.first.get_or_insert((depth, self.found.generated));
            self.found.best = Some(self.found.best.map_or(depth, |b| b.min(depth)));
        }
        let (id, new) = self.seen.insert(&key, usize::MAX, || (depth.min(crate::plan::MAX_COST), 0, parent));
        if !new {
            return;
        }
        let mut form = vec![0; Detail::Joints.key_width(configuration.len())];
        Detail::Joints.key(configuration, &mut form);
        self.configurations.push(form.into());
        if is_goal && self.first.is_none() {
            let chain = std::iter::successors(Some(id), |i| {
                let parent = self.seen.parent(*i);
                (parent != NO_PARENT).then_some(parent)
            });
            self.first = Some(chain.collect());
        }
        let distance = self.distance(&shape);
        self.open.entry(distance).or_default().push(id);
    }

    /// Expands at most `work` shapes. Returns false if none is left, or if `until_first` is true and a plan is known.
    pub fn advance(&mut self, work: u64, until_first: bool) -> bool {
        for _ in 0..work {
            if until_first && self.found.first.is_some() {
                return false;
            }
            let Some(mut level) = self.open.first_entry() else { return false };
            let ids = level.get_mut();
            let id = ids.swap_remove(self.rng.below(ids.len() as u64) as usize);
            if ids.is_empty() {
                level.remove();
            }
            self.found.expanded += 1;
            let depth = self.seen.cost(id);
            let configuration = Detail::Joints.configuration(&self.configurations[id as usize]);
            let mut next = Vec::new();
            self.rules.expand(&configuration, |_, to| next.push(*to));
            for to in next {
                self.found.generated += 1;
                self.add(&to, depth + 1, id);
            }
        }
        true
    }

    /// Returns the configurations of the first plan, the start first.
    pub fn first_plan(&self) -> Option<Vec<Configuration>> {
        let form = |id: &Id| Detail::Joints.configuration(&self.configurations[*id as usize]);
        self.first.as_ref().map(|ids| ids.iter().rev().map(form).collect())
    }
}

/// Returns the actions that lead through a list of configurations, with modules numbered as in `start`.
pub fn actions_along(rules: &Rules, start: &Configuration, plan: &[Configuration]) -> Option<Vec<Action>> {
    let form = |c: &Configuration| {
        let mut key = vec![0; Detail::Joints.key_width(c.len())];
        Detail::Joints.key(c, &mut key);
        key
    };
    let mut at = *start;
    let mut actions = Vec::new();
    for wanted in &plan[1..] {
        let wanted = form(wanted);
        let mut found = None;
        rules.expand(&at, |action, to| {
            if found.is_none() && form(to) == wanted {
                found = Some((action, *to));
            }
        });
        let (action, to) = found?;
        actions.push(action);
        at = to;
    }
    Some(actions)
}
