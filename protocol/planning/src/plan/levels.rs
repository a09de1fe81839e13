//! Breadth-first search over a whole space: the number of states at every distance from a start.

use super::table::{Id, NO_PARENT, Table};
use super::{Limits, Space};

/// A count under way.
pub struct Levels<S: Space> {
    space: S,
    limits: Limits,
    table: Table,
    next: Id,
    /// The first state of every level; the last one is being made.
    starts: Vec<Id>,
}

/// Result of a slice of work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Counted {
    /// There is more to do.
    Running,
    /// All states have been counted.
    All,
    /// A limit was reached; the complete levels are valid.
    OutOfRoom,
}

impl<S: Space> Levels<S> {
    /// Begins a count.
    pub fn new(space: S, start: &S::State, limits: Limits) -> Levels<S> {
        let mut table = Table::new(space.key_width());
        let mut key = vec![0; space.key_width()];
        space.key(start, &mut key);
        table.insert(&key, limits.memory, || (0, 0, NO_PARENT));
        Levels { space, limits, table, next: 0, starts: vec![0, 1] }
    }

    /// Returns the number of states at every distance; the level that is being made is left out.
    pub fn counts(&self) -> Vec<u64> {
        self.starts.windows(2).map(|w| u64::from(w[1] - w[0])).collect()
    }
    /// Returns the states, in the order in which they were found.
    pub fn table(&self) -> &Table {
        &self.table
    }
    /// Returns the space.
    pub fn space(&self) -> &S {
        &self.space
    }
    /// Takes the states.
    pub fn into_table(self) -> Table {
        self.table
    }
    /// Returns the number of complete levels.
    pub fn complete(&self) -> usize {
        self.starts.len() - 1
    }

    /// Works for at most `work` expansions.
    pub fn advance(&mut self, work: u64) -> Counted {
        let mut key = vec![0; self.space.key_width()];
        for _ in 0..work {
            let len = self.table.len() as Id;
            let level_end = self.starts[self.starts.len() - 1];
            if self.next == level_end {
                if len == level_end {
                    return Counted::All;
                }
                self.starts.push(len);
            }
            let room = self.table.bytes() + self.table.chunk_bytes();
            if room > self.limits.memory || u64::from(self.next) >= self.limits.work {
                return Counted::OutOfRoom;
            }
            let Levels { space, table, next, limits, .. } = self;
            let state = space.state(table.key(*next));
            let cost = table.cost(*next) + 1;
            space.expand(&state, &mut |_, _, to| {
                space.key(to, &mut key);
                table.insert(&key, limits.memory, || (cost, 0, *next));
            });
            *next += 1;
        }
        Counted::Running
    }
}
