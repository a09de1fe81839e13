//! Shortest paths through the database.

use super::{CellSet, Table};
use crate::shape::Shape;
use crate::sweep::FloorContact;
use std::collections::VecDeque;

/// The direction in which a step of the database is taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// As stored: the joint turns by +120° or +90°.
    Forward,
    /// Reversed.
    Backward,
}

/// A path through the database and all cells that it sweeps.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Transition {
    /// The postures of the path, including the first and the last.
    pub postures: Vec<u16>,
    /// The steps: indices into [`Table::steps`], and their directions.
    pub steps: Vec<(u16, Direction)>,
    /// All cells that must be free.
    pub core: CellSet,
    /// The further cells that must be free in the strict model.
    pub graze: CellSet,
}

/// The postures that are reachable from one posture, and the steps to them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reach {
    /// The step by which each posture was first reached: the posture before and the step.
    came_by: Vec<Option<(u16, u16)>>,
    /// All reachable postures, including the first, nearest first.
    order: Vec<(u16, u8)>,
}

impl Reach {
    /// Iterates over the reachable postures with the number of steps, nearest first; equally near ones in the
    /// order of the steps.
    pub fn postures(&self) -> impl Iterator<Item = (u16, u8)> + '_ {
        self.order.iter().copied()
    }
}

impl Table {
    /// Finds all postures that strict steps lead to without sweeping a cell of `blocked`.
    pub fn reach(&self, from: u16, blocked: &CellSet) -> Reach {
        let mut reach = Reach { came_by: vec![None; self.postures.len()], order: Vec::new() };
        if usize::from(from) >= self.postures.len() {
            return reach;
        }
        reach.order.push((from, 0));
        let mut next = 0;
        while let Some((at, count)) = reach.order.get(next).copied() {
            next += 1;
            for i in &self.steps_at[usize::from(at)] {
                let step = &self.steps[usize::from(*i)];
                let to = if step.from == at { step.to } else { step.from };
                let free = step.floor == FloorContact::Free
                    && !step.core.meets(blocked)
                    && !step.graze.meets(blocked);
                if free && to != from && reach.came_by[usize::from(to)].is_none() {
                    reach.came_by[usize::from(to)] = Some((at, *i));
                    reach.order.push((to, count.saturating_add(1)));
                }
            }
        }
        reach
    }

    /// Returns the path to posture `to` of a [`Reach`] that began at `from`; `None` if `to` is not in it.
    pub fn path_within(&self, reach: &Reach, from: u16, to: u16) -> Option<Transition> {
        let known = from == to || reach.came_by.get(usize::from(to)).copied().flatten().is_some();
        known.then(|| self.trace(from, to, &reach.came_by))
    }

    /// Finds the shortest path by strict steps from a posture to the nearest one that `goal` accepts, through
    /// steps that sweep no cell of `blocked`, core or graze. `None` if there is no path.
    ///
    /// Among paths of the same length the first in the order of the steps is taken.
    pub fn shortest_path(
        &self,
        from: u16,
        blocked: &CellSet,
        mut goal: impl FnMut(u16) -> bool,
    ) -> Option<Transition> {
        if usize::from(from) >= self.postures.len() {
            return None;
        }
        let mut came_by: Vec<Option<(u16, u16)>> = vec![None; self.postures.len()];
        let mut queue = VecDeque::from([from]);
        while let Some(at) = queue.pop_front() {
            if goal(at) {
                return Some(self.trace(from, at, &came_by));
            }
            for i in &self.steps_at[usize::from(at)] {
                let step = &self.steps[usize::from(*i)];
                let next = if step.from == at { step.to } else { step.from };
                let free = step.floor == FloorContact::Free
                    && !step.core.meets(blocked)
                    && !step.graze.meets(blocked);
                if free && next != from && came_by[usize::from(next)].is_none() {
                    came_by[usize::from(next)] = Some((at, *i));
                    queue.push_back(next);
                }
            }
        }
        None
    }

    /// Finds the shortest path to a posture of a shape.
    pub fn path_to_shape(&self, from: u16, shape: Shape) -> Option<Transition> {
        let is = |p: u16| self.chains[usize::from(self.postures[usize::from(p)].chain)].shape == shape;
        self.shortest_path(from, &CellSet::default(), is)
    }

    fn trace(&self, from: u16, to: u16, came_by: &[Option<(u16, u16)>]) -> Transition {
        let mut way = Transition {
            postures: vec![to],
            steps: Vec::new(),
            core: CellSet::default(),
            graze: CellSet::default(),
        };
        let mut at = to;
        while let Some((before, i)) = came_by[usize::from(at)] {
            let step = &self.steps[usize::from(i)];
            let direction = if step.to == at { Direction::Forward } else { Direction::Backward };
            way.steps.push((i, direction));
            way.core = way.core.union(&step.core);
            way.graze = way.graze.union(&step.graze);
            at = before;
            way.postures.push(at);
        }
        debug_assert_eq!(at, from);
        way.graze = way.graze.without(&way.core);
        way.postures.reverse();
        way.steps.reverse();
        way
    }
}
