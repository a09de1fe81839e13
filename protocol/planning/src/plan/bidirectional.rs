//! Breadth-first search from both ends, for one goal state and actions of cost 1 that can be undone.

use super::search::chain;
use super::table::{Id, NO_PARENT, Table};
use super::{Cost, Limits, Outcome, Path, Progress, Resource, Space, Step};

struct Side {
    table: Table,
    /// The first state of the last complete level.
    level: Id,
    /// The next state of that level to be expanded.
    next: Id,
    /// The first state of the level that is being made.
    end: Id,
    depth: Cost,
}

/// A search under way.
pub struct Bidirectional<S: Space> {
    space: S,
    limits: Limits,
    sides: [Side; 2],
    side: usize,
    expanded: u64,
    generated: u64,
    done: Option<Outcome>,
}

impl<S: Space> Bidirectional<S> {
    /// Begins a search.
    pub fn new(space: S, start: &S::State, goal: &S::State, limits: Limits) -> Bidirectional<S> {
        let mut key = vec![0; space.key_width()];
        let sides = [start, goal].map(|state| {
            let mut table = Table::new(space.key_width());
            space.key(state, &mut key);
            table.insert(&key, limits.memory / 2, || (0, 0, NO_PARENT));
            Side { table, level: 0, next: 0, end: 1, depth: 0 }
        });
        let same = sides[0].table.key(0) == sides[1].table.key(0);
        let path = Path { keys: vec![key], cost: 0 };
        let done = same.then_some(Outcome::Solved { path, lower: 0 });
        Bidirectional { space, limits, sides, side: 0, expanded: 0, generated: 0, done }
    }

    /// Returns how far the search is.
    pub fn progress(&self) -> Progress {
        let [a, b] = &self.sides;
        let path = match &self.done {
            Some(Outcome::Solved { path, .. }) => Some(path.cost),
            _ => None,
        };
        Progress {
            lower: path.unwrap_or(a.depth + b.depth + 1),
            upper: path,
            expanded: self.expanded,
            generated: self.generated,
            kept: (a.table.len() + b.table.len()) as u64,
            bytes: self.bytes() as u64,
        }
    }
    fn bytes(&self) -> usize {
        self.sides.iter().map(|s| s.table.bytes()).sum()
    }

    /// Works for at most `work` expansions.
    pub fn advance(&mut self, work: u64) -> Step {
        for _ in 0..work {
            if self.done.is_some() {
                break;
            }
            self.step();
        }
        self.done.clone().map_or(Step::Running, Step::Done)
    }

    fn step(&mut self) {
        let chunk = self.sides[self.side].table.chunk_bytes();
        let lower = self.progress().lower;
        if self.bytes() + chunk > self.limits.memory || self.expanded >= self.limits.work {
            let memory = self.expanded < self.limits.work;
            let resource = if memory { Resource::Memory } else { Resource::Work };
            self.done = Some(Outcome::OutOf { resource, best: None, lower });
            return;
        }
        if self.sides[self.side].next == self.sides[self.side].end && !self.next_level() {
            return;
        }
        self.expanded += 1;
        let side = self.side;
        let [a, b] = &mut self.sides;
        let (here, there) = if side == 0 { (a, &b.table) } else { (b, &a.table) };
        let id = here.next;
        here.next += 1;
        let state = self.space.state(here.table.key(id));
        let cost = here.table.cost(id) + 1;
        let mut key = vec![0; self.space.key_width()];
        let mut met = None;
        let generated = &mut self.generated;
        let (limit, space) = (self.limits.memory / 2, &self.space);
        space.expand(&state, &mut |_, step, to| {
            debug_assert_eq!(step, 1, "the search counts actions");
            *generated += 1;
            space.key(to, &mut key);
            let (next, new) = here.table.insert(&key, limit, || (cost, 0, id));
            if new && met.is_none() {
                met = there.find(&key).map(|other| (next, other));
            }
        });
        // No path is as short as the sum of the complete levels, so the first that is found is a shortest one.
        if let Some((here_id, there_id)) = met {
            let (from, to) = if side == 0 { (here_id, there_id) } else { (there_id, here_id) };
            let mut keys = chain(&self.sides[0].table, from);
            keys.extend(chain(&self.sides[1].table, to).into_iter().rev().skip(1));
            let cost = keys.len() as Cost - 1;
            self.done = Some(Outcome::Solved { path: Path { keys, cost }, lower: cost });
        }
    }

    /// Ends a level and takes the side with the smaller one; false if a side has no further states.
    fn next_level(&mut self) -> bool {
        let side = &mut self.sides[self.side];
        side.depth += 1;
        (side.level, side.end) = (side.end, side.table.len() as Id);
        debug_assert_eq!(side.next, side.level);
        if side.level == side.end {
            let states = side.table.len() as u64;
            self.done = Some(Outcome::Impossible { states });
            return false;
        }
        let [a, b] = [0, 1].map(|i| self.sides[i].end - self.sides[i].level);
        self.side = usize::from(b < a);
        true
    }
}
