//! Iterative deepening from the frontier of a search that has run out of memory.
//!
//! Every state that is kept and not expanded is a root of a depth-first search up to a threshold, which
//! rises to the least cost that exceeded it. A branch ends at a kept state that is at least as near to the start:
//! such a state is a root or has been expanded. A transposition table of fixed size ends most other branches that
//! come to a known state.

use super::search::{DEAD, chain};
use super::table::{Id, Table, hash};
use super::{Cost, MAX_COST, Path, Space};

/// Largest number of slots of the transposition table.
const SLOTS_MAX: usize = 1 << 22;

struct Successor<S: Space> {
    state: S::State,
    key: Box<[u8]>,
    cost: Cost,
    lower: Cost,
}

struct Frame<S: Space> {
    key: Box<[u8]>,
    /// Still to be visited, the most promising last.
    rest: Vec<Successor<S>>,
}

pub(super) struct Deepening<S: Space> {
    threshold: Cost,
    /// The least cost above the threshold.
    next: Option<Cost>,
    cut: bool,
    root: Id,
    from: Id,
    stack: Vec<Frame<S>>,
    seen: Transpositions,
    visited: u64,
}

/// Result of a step of the search.
pub(super) enum Found {
    /// A state was expanded.
    Expanded { generated: u64 },
    /// All paths up to a cost have been tried; the next threshold.
    Threshold(Cost),
    /// A path that costs less than every path found before.
    Path(Path),
    /// Nothing is left to try.
    Exhausted { states: u64, cut: bool },
}

impl<S: Space> Deepening<S> {
    pub(super) fn new(space: &S, threshold: Cost, room: usize) -> Deepening<S> {
        let seen = Transpositions::new(space.key_width(), room);
        Deepening { threshold, next: None, cut: false, root: 0, from: 0, stack: Vec::new(), seen, visited: 0 }
    }

    pub(super) fn step(&mut self, space: &S, table: &Table, upper: Option<Cost>) -> Found {
        loop {
            if upper.is_some_and(|upper| upper <= self.threshold) {
                return Found::Exhausted { states: self.states(table), cut: false };
            }
            let (state, key, cost) = match self.stack.last_mut() {
                None => match self.next_root(space, table) {
                    Some(root) => root,
                    None => return self.raise(table),
                },
                Some(frame) => match frame.rest.pop() {
                    None => {
                        self.stack.pop();
                        continue;
                    }
                    Some(next) if self.seen.reached(&next.key, next.cost, self.threshold) => continue,
                    Some(next) => (next.state, next.key, next.cost),
                },
            };
            return self.expand(space, table, &state, key, cost);
        }
    }

    fn states(&self, table: &Table) -> u64 {
        table.len() as u64 + self.visited
    }

    fn raise(&mut self, table: &Table) -> Found {
        match self.next.take() {
            Some(next) => {
                self.threshold = next;
                self.root = 0;
                self.visited = 0;
                Found::Threshold(next)
            }
            None => Found::Exhausted { states: self.states(table), cut: self.cut },
        }
    }

    /// Finds the next state that is kept and not expanded, and within the threshold.
    fn next_root(&mut self, space: &S, table: &Table) -> Option<(S::State, Box<[u8]>, Cost)> {
        while (self.root as usize) < table.len() {
            let id = self.root;
            self.root += 1;
            let (cost, lower) = (table.cost(id), table.lower(id));
            if table.is_expanded(id) || lower == DEAD {
                continue;
            }
            if cost + lower > self.threshold {
                self.put_off(cost + lower);
                continue;
            }
            self.from = id;
            return Some((space.state(table.key(id)), table.key(id).into(), cost));
        }
        None
    }

    fn put_off(&mut self, cost: Cost) {
        self.next = Some(self.next.unwrap_or(Cost::MAX).min(cost));
    }

    fn expand(&mut self, space: &S, table: &Table, state: &S::State, key: Box<[u8]>, cost: Cost) -> Found {
        self.visited += 1;
        let mut rest: Vec<Successor<S>> = Vec::new();
        let mut to_key = vec![0; space.key_width()];
        let mut generated = 0;
        let mut goal = None;
        let (mut cut, mut beyond) = (false, None);
        space.expand(state, &mut |_, step, to| {
            generated += 1;
            let total = cost + step;
            if total > MAX_COST {
                cut = true;
                return;
            }
            space.key(to, &mut to_key);
            let known = table.find(&to_key).is_some_and(|id| table.cost(id) <= total);
            let on_path = || key[..] == to_key[..] || self.stack.iter().any(|f| f.key[..] == to_key[..]);
            if known || on_path() {
                return;
            }
            match space.lower(to).filter(|l| *l <= MAX_COST) {
                None => {}
                Some(lower) if total + lower > self.threshold => {
                    beyond = Some(beyond.unwrap_or(Cost::MAX).min(total + lower));
                }
                Some(lower) => {
                    if lower == 0 && space.is_goal(to) {
                        goal = Some((total, to_key.clone()));
                    }
                    rest.push(Successor {
                        state: to.clone(),
                        key: to_key.clone().into(),
                        cost: total,
                        lower,
                    });
                }
            }
        });
        self.cut |= cut;
        if let Some(beyond) = beyond {
            self.put_off(beyond);
        }
        // Stable, so that the order of equal ones is that of the space.
        rest.sort_by_key(|next| std::cmp::Reverse(next.cost + next.lower));
        self.stack.push(Frame { key, rest });
        if let Some((cost, key)) = goal {
            let mut keys = chain(table, self.from);
            keys.extend(self.stack[1..].iter().map(|frame| frame.key.to_vec()));
            keys.push(key);
            return Found::Path(Path { keys, cost });
        }
        Found::Expanded { generated }
    }
}

/// States that were searched with their cost and threshold; a new one overwrites the one in its slot.
struct Transpositions {
    width: usize,
    keys: Vec<u8>,
    marks: Vec<(u16, u16)>,
}

impl Transpositions {
    fn new(width: usize, room: usize) -> Transpositions {
        let slots = (room / (width + 4)).clamp(1, SLOTS_MAX);
        Transpositions { width, keys: vec![0; slots * width], marks: vec![(u16::MAX, 0); slots] }
    }

    /// Returns true if the state was searched at this threshold with at most this cost; otherwise notes that it is.
    fn reached(&mut self, key: &[u8], cost: Cost, threshold: Cost) -> bool {
        let slot = ((u128::from(hash(key)) * self.marks.len() as u128) >> 64) as usize;
        let kept = &mut self.keys[slot * self.width..(slot + 1) * self.width];
        let mark = &mut self.marks[slot];
        let now = (cost as u16, threshold as u16);
        if kept == key && mark.1 == now.1 && mark.0 <= now.0 {
            return true;
        }
        kept.copy_from_slice(key);
        *mark = now;
        false
    }
}
