//! Beam search: it keeps only the most promising states of every layer, in passes that each keep twice as many. It
//! finds a plan where an exact search would take too much work, but proves nothing about the least cost.
//!
//! States are ordered by their bound, then by the space's guide. Only few states of each class are kept, and more of
//! those whose bound is smaller: otherwise one plateau of similar states would fill every layer.

use super::search::{chain, cost_along};
use super::table::{Id, NO_PARENT, Table, hash};
use super::{Cost, Limits, MAX_COST, Outcome, Path, Progress, Resource, Space, Step};
use std::collections::{BTreeMap, HashSet};

/// The largest number of states kept of a layer in the first pass.
const LEAST_WIDTH: usize = 2000;
/// The largest number of layers of a pass without a plan: the lower bound of the start times the first number,
/// plus the second.
const DEPTH: (Cost, Cost) = (3, 24);

/// Candidates are thinned out when there are this many times the width.
const FULL: usize = 32;

/// The number of states kept of a class doubles with each unit by which their bound is below that of the start, at
/// most this many times.
const MOST_DOUBLED: u32 = 16;

/// A successor that may be kept.
#[derive(Clone, Copy)]
struct Candidate {
    /// The bound of a plan through it, the guide, then by chance, so that a plateau is sampled evenly.
    score: (Cost, u32, u32),
    /// Its place among the keys of the candidates.
    at: u32,
    parent: Id,
    cost: Cost,
}

/// A search under way.
pub struct Beam<S: Space> {
    space: S,
    limits: Limits,
    width: usize,
    table: Table,
    /// States to be expanded, the next one last.
    layer: Vec<Id>,
    depth: Cost,
    candidates: Vec<Candidate>,
    /// Their keys.
    keys: Vec<u8>,
    /// Hashes of the keys of all successors of the layer, so that each is judged once. Of two with the same hash one
    /// is lost, which a beam can afford.
    seen: HashSet<u64>,
    /// States of each class kept in this pass.
    classes: BTreeMap<u64, u32>,
    best: Option<Path>,
    lower: Cost,
    expanded: u64,
    generated: u64,
    done: bool,
}

impl<S: Space> Beam<S> {
    /// Begins a search.
    pub fn new(space: S, start: &S::State, limits: Limits) -> Beam<S> {
        let mut beam = Beam {
            table: Table::new(space.key_width()),
            limits,
            width: LEAST_WIDTH,
            layer: Vec::new(),
            depth: 0,
            candidates: Vec::new(),
            keys: Vec::new(),
            seen: HashSet::new(),
            classes: BTreeMap::new(),
            best: None,
            lower: 0,
            expanded: 0,
            generated: 0,
            done: false,
            space,
        };
        let mut key = vec![0; beam.space.key_width()];
        beam.space.key(start, &mut key);
        match beam.space.lower(start).filter(|l| *l <= MAX_COST) {
            Some(lower) => beam.lower = lower,
            None => beam.done = true,
        }
        if beam.space.is_goal(start) {
            (beam.best, beam.done) = (Some(Path { keys: vec![key.clone()], cost: 0 }), true);
        }
        beam.begin(&key);
        beam
    }
    /// Returns how far the search is.
    pub fn progress(&self) -> Progress {
        Progress {
            lower: self.lower,
            upper: self.best.as_ref().map(|p| p.cost),
            expanded: self.expanded,
            generated: self.generated,
            kept: self.table.len() as u64,
            bytes: self.bytes() as u64,
        }
    }
    /// Returns the best path so far.
    pub fn path(&self) -> Option<&Path> {
        self.best.as_ref()
    }
    /// Works for at most `work` expansions. It ends when its memory does, or with a path that costs no more than
    /// the lower bound of the start.
    pub fn advance(&mut self, work: u64) -> Step {
        for _ in 0..work {
            if self.done {
                break;
            }
            self.step();
        }
        match (self.done, &self.best) {
            (false, _) => Step::Running,
            (true, Some(path)) if path.cost == self.lower => {
                Step::Done(Outcome::Solved { path: path.clone(), lower: self.lower })
            }
            (true, best) => {
                let resource =
                    if self.expanded >= self.limits.work { Resource::Work } else { Resource::Memory };
                Step::Done(Outcome::OutOf { resource, best: best.clone(), lower: self.lower })
            }
        }
    }

    fn bytes(&self) -> usize {
        self.table.bytes()
            + self.keys.capacity()
            + self.seen.capacity() * 9
            + self.candidates.capacity() * size_of::<Candidate>()
            + self.classes.len() * 2 * size_of::<(u64, u32)>()
    }
    fn begin(&mut self, start: &[u8]) {
        self.table = Table::new(self.space.key_width());
        self.table.insert(start, usize::MAX, || (0, self.lower, NO_PARENT));
        (self.layer, self.depth) = (vec![0], 0);
        self.classes.clear();
    }

    /// Expands one state.
    fn step(&mut self) {
        let Some(id) = self.layer.pop() else { return self.next_layer() };
        let room = self.table.chunk_bytes()
            + 4096
            + FULL * self.width * (self.space.key_width() + size_of::<Candidate>());
        if self.bytes() + room > self.limits.memory || self.expanded >= self.limits.work {
            self.done = true;
            return;
        }
        self.expanded += 1;
        let state = self.space.state(self.table.key(id));
        let cost = self.table.cost(id);
        let mut key = vec![0; self.space.key_width()];
        let mut reached = None;
        let Beam { space, table, candidates, keys, seen, best, generated, .. } = self;
        let mut upper = best.as_ref().map_or(MAX_COST + 1, |b| b.cost);
        space.expand(&state, &mut |_, step, to| {
            *generated += 1;
            let total = cost + step;
            space.key(to, &mut key);
            if total >= upper || table.find(&key).is_some_and(|known| table.cost(known) <= total) {
                return;
            }
            let hash = hash(&key);
            if !seen.insert(hash) {
                return;
            }
            let Some(lower) = space.lower(to) else { return };
            if total + lower >= upper {
                return;
            }
            if lower == 0 && space.is_goal(to) {
                (upper, reached) = (total, Some(key.clone()));
                return;
            }
            let at = (keys.len() / key.len()) as u32;
            keys.extend(&key);
            let score = (total + lower, space.guide(to), hash as u32);
            candidates.push(Candidate { score, at, parent: id, cost: total });
        });
        if let Some(goal) = reached {
            let mut keys = chain(&self.table, id);
            keys.push(goal);
            // States on the way may have become cheaper since the next one was generated from them.
            let cost = cost_along(&self.space, &keys);
            self.best = Some(Path { keys, cost });
        }
        if self.candidates.len() >= FULL * self.width {
            self.select(FULL * self.width / 2);
        }
    }

    /// Keeps the best `most` candidates only.
    fn select(&mut self, most: usize) {
        let width = self.space.key_width();
        let Beam { candidates, keys, best, .. } = self;
        let key = |c: &Candidate| &keys[c.at as usize * width..][..width];
        candidates.sort_unstable_by(|a, b| {
            a.score.cmp(&b.score).then_with(|| key(a).cmp(key(b))).then(a.at.cmp(&b.at))
        });
        if let Some(best) = best {
            candidates.retain(|c| c.score.0 < best.cost);
        }
        candidates.truncate(most);
        let mut kept = Vec::with_capacity(candidates.len() * width);
        for (at, candidate) in candidates.iter_mut().enumerate() {
            kept.extend_from_slice(key(candidate));
            candidate.at = at as u32;
        }
        self.keys = kept;
    }

    fn next_layer(&mut self) {
        self.select(usize::MAX);
        self.depth += 1;
        let too_deep = self.best.is_none() && self.depth > self.lower * DEPTH.0 + DEPTH.1;
        if self.candidates.is_empty() || too_deep {
            return self.next_pass();
        }
        let width = self.space.key_width();
        for c in self.candidates.drain(..) {
            if self.layer.len() == self.width {
                break;
            }
            let key = &self.keys[c.at as usize * width..][..width];
            let lower = c.score.0 - c.cost;
            let kept = self.classes.entry(self.space.class(&self.space.state(key))).or_insert(0);
            let doubled = self.lower.saturating_sub(lower).min(MOST_DOUBLED);
            if *kept >= 1 << doubled {
                continue;
            }
            *kept += 1;
            let (id, new) = self.table.insert(key, usize::MAX, || (c.cost, lower, c.parent));
            if !new {
                self.table.improve(id, c.cost, c.parent);
            }
            self.layer.push(id);
        }
        self.layer.reverse();
        self.keys.clear();
        self.seen.clear();
    }

    /// Begins again with twice the width.
    fn next_pass(&mut self) {
        if self.best.as_ref().is_some_and(|b| b.cost == self.lower) {
            self.done = true;
            return;
        }
        self.candidates.clear();
        self.keys.clear();
        self.seen.clear();
        self.width *= 2;
        let start = self.table.key(0).to_vec();
        self.begin(&start);
    }
}
