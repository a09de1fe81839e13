//! A* with bounded memory, as an anytime search if weights are given, and with iterative deepening at the memory limit.

use super::deepening::{Deepening, Found};
use super::queue::Queue;
use super::table::{Id, NO_PARENT, Table};
use super::{Cost, Limits, MAX_COST, Outcome, Path, Progress, Resource, Space, Step};

/// The lower bound of a state from which the goal cannot be reached.
pub(super) const DEAD: Cost = 0xffff;

/// The weight of an optimal search.
pub const OPTIMAL: u32 = 100;

/// How a search goes about it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Method {
    /// Weights of the lower bound in hundredths, one pass each, falling; [`OPTIMAL`] last unless a plan within a
    /// factor is enough.
    pub weights: Vec<u32>,
    /// True to keep states. If false, the search is iterative deepening from the start.
    pub keep: bool,
    /// True to continue with iterative deepening when memory ends.
    pub deepen: bool,
}

impl Method {
    /// A*.
    pub fn astar() -> Method {
        Method { weights: vec![OPTIMAL], keep: true, deepen: true }
    }
    /// ARA* with weights 3, 2, 1.5 and 1.
    pub fn anytime() -> Method {
        Method { weights: vec![300, 200, 150, OPTIMAL], keep: true, deepen: true }
    }
    /// Iterative deepening.
    pub fn deepening() -> Method {
        Method { weights: vec![OPTIMAL], keep: false, deepen: true }
    }
}

enum Phase<S: Space> {
    Best,
    Deepening(Box<Deepening<S>>),
    Done(Outcome),
}

/// A search under way.
pub struct Search<S: Space> {
    space: S,
    limits: Limits,
    method: Method,
    pass: usize,
    table: Table,
    /// By weighted cost in hundredths, then the largest cost from the start.
    queue: Queue<(u32, u32)>,
    best: Option<Path>,
    /// The goal among the kept states, for [`Search::path`].
    goal: Option<Id>,
    lower: Cost,
    expanded: u64,
    generated: u64,
    /// True if states were left out because of [`MAX_COST`].
    cut: bool,
    phase: Phase<S>,
}

impl<S: Space> Search<S> {
    /// Begins a search.
    pub fn new(space: S, start: &S::State, limits: Limits, method: Method) -> Search<S> {
        let mut table = Table::new(space.key_width());
        let mut key = vec![0; space.key_width()];
        space.key(start, &mut key);
        let lower = space.lower(start).filter(|l| *l <= MAX_COST);
        table.insert(&key, limits.memory, || (0, lower.unwrap_or(DEAD), NO_PARENT));
        let keep = method.keep;
        let mut search = Search {
            lower: lower.unwrap_or(0),
            space,
            limits,
            method,
            pass: 0,
            table,
            queue: Queue::new(),
            best: None,
            goal: None,
            expanded: 0,
            generated: 0,
            cut: false,
            phase: Phase::Best,
        };
        if lower == Some(0) && search.space.is_goal(start) {
            search.goal = Some(0);
        }
        search.refill();
        if !keep && search.goal.is_none() {
            search.deepen();
        }
        search
    }

    /// Returns the space.
    pub fn space(&self) -> &S {
        &self.space
    }

    /// Returns how far the search is.
    pub fn progress(&self) -> Progress {
        Progress {
            lower: self.lower,
            upper: self.upper(),
            expanded: self.expanded,
            generated: self.generated,
            kept: self.table.len() as u64,
            bytes: self.bytes() as u64,
        }
    }
    fn bytes(&self) -> usize {
        self.table.bytes() + self.queue.bytes() + self.space.bytes()
    }
    fn upper(&self) -> Option<Cost> {
        self.goal.map(|id| self.table.cost(id)).or(self.best.as_ref().map(|p| p.cost))
    }

    /// Returns the best path so far.
    pub fn path(&self) -> Option<Path> {
        match self.goal {
            Some(id) => {
                // States on the way may have become cheaper since the goal was reached through them.
                let keys = chain(&self.table, id);
                let cost = cost_along(&self.space, &keys);
                Some(Path { keys, cost })
            }
            None => self.best.clone(),
        }
    }

    /// Takes a path found elsewhere, so that states that cannot lead to a better one are not searched.
    pub fn know(&mut self, path: Path) {
        if self.upper().is_none_or(|upper| path.cost < upper) {
            (self.best, self.goal) = (Some(path), None);
        }
    }

    /// Works for at most `work` expansions.
    pub fn advance(&mut self, work: u64) -> Step {
        for _ in 0..work {
            match &self.phase {
                Phase::Done(_) => break,
                Phase::Best => self.step(),
                Phase::Deepening(_) => self.deepening_step(),
            }
        }
        match &self.phase {
            Phase::Done(outcome) => Step::Done(outcome.clone()),
            _ => Step::Running,
        }
    }

    fn weight(&self) -> u32 {
        self.method.weights[self.pass]
    }

    /// Expands the most promising state.
    fn step(&mut self) {
        let id = loop {
            let Some((f, _)) = self.queue.first() else { return self.pass_ended() };
            if self.upper().is_some_and(|upper| upper * 100 <= f) {
                return self.pass_ended();
            }
            let Some((f, id)) = self.queue.pop() else { return };
            let cost = self.table.cost(id);
            let current = f.0 == priority(cost, self.table.lower(id), self.weight()).0;
            let useful = self.upper().is_none_or(|upper| cost + self.table.lower(id) < upper);
            if current && useful && !self.table.is_expanded(id) {
                break id;
            }
        };
        if self.weight() == OPTIMAL {
            self.lower = self.lower.max(self.table.cost(id) + self.table.lower(id));
        }
        let room = self.table.chunk_bytes() + 4096;
        let out_of_memory = self.bytes() + room > self.limits.memory;
        if out_of_memory || self.expanded >= self.limits.work {
            // Not expanded, so it is still open.
            let f = priority(self.table.cost(id), self.table.lower(id), self.weight());
            self.queue.push(f, id);
            return match (out_of_memory, self.method.deepen && self.weight() == OPTIMAL) {
                (true, true) => self.deepen(),
                (true, false) => self.ended_by(Resource::Memory),
                (false, _) => self.ended_by(Resource::Work),
            };
        }
        self.expand(id);
    }

    fn expand(&mut self, id: Id) {
        self.expanded += 1;
        self.table.set_expanded(id);
        let weight = self.weight();
        let mut upper = self.upper();
        let Search { space, table, queue, limits, goal, generated, cut, .. } = self;
        let state = space.state(table.key(id));
        let cost = table.cost(id);
        let mut key = vec![0; space.key_width()];
        let limit = limits.memory.saturating_sub(queue.bytes() + space.bytes());
        space.expand(&state, &mut |_, step, to| {
            *generated += 1;
            let total = cost + step;
            if total > MAX_COST {
                *cut = true;
                return;
            }
            space.key(to, &mut key);
            let bound = || space.lower(to).filter(|l| *l <= MAX_COST).unwrap_or(DEAD);
            let (next, new) = table.insert(&key, limit, || (total, bound(), id));
            let lower = table.lower(next);
            if !new {
                if total >= table.cost(next) {
                    return;
                }
                table.improve(next, total, id);
            }
            if lower == 0 && upper.is_none_or(|u| total < u) && space.is_goal(to) {
                upper = Some(total);
                *goal = Some(next);
            } else if lower != DEAD && upper.is_none_or(|u| total + lower < u) {
                queue.push(priority(total, lower, weight), next);
            }
        });
    }

    /// Fills the queue with all states that are not expanded, and returns the least cost through one of them.
    fn refill(&mut self) -> Option<Cost> {
        self.queue.clear();
        let weight = self.weight();
        let upper = self.upper().unwrap_or(DEAD);
        let mut least = None;
        for id in 0..self.table.len() as Id {
            let (cost, lower) = (self.table.cost(id), self.table.lower(id));
            if !self.table.is_expanded(id) && lower != DEAD && cost + lower < upper {
                self.queue.push(priority(cost, lower, weight), id);
                least = Some(least.unwrap_or(Cost::MAX).min(cost + lower));
            }
        }
        least
    }

    fn pass_ended(&mut self) {
        let open = if self.weight() == OPTIMAL { None } else { self.refill() };
        if let Some(least) = open {
            self.lower = self.lower.max(least);
            if self.pass + 1 < self.method.weights.len() {
                self.pass += 1;
                self.refill();
                return;
            }
        }
        let states = self.table.len() as u64;
        self.phase = Phase::Done(match self.path() {
            Some(path) => {
                self.lower = if open.is_some() { self.lower.min(path.cost) } else { path.cost };
                Outcome::Solved { path, lower: self.lower }
            }
            None if self.cut => Outcome::OutOf { resource: Resource::Cost, best: None, lower: MAX_COST },
            None => Outcome::Impossible { states },
        });
    }

    fn ended_by(&mut self, resource: Resource) {
        if self.weight() != OPTIMAL
            && let Some(least) = self.refill()
        {
            self.lower = self.lower.max(least);
        }
        let best = self.path();
        self.lower = best.as_ref().map_or(self.lower, |b| self.lower.min(b.cost));
        self.phase = Phase::Done(Outcome::OutOf { resource, best, lower: self.lower });
    }

    /// Goes on from the frontier by iterative deepening. The queue's memory becomes its table of transpositions.
    fn deepen(&mut self) {
        self.queue.clear();
        let room = self.limits.memory.saturating_sub(self.bytes());
        let deepening = Deepening::new(&self.space, self.lower, room);
        self.best = self.path();
        self.goal = None;
        self.phase = Phase::Deepening(Box::new(deepening));
    }

    fn deepening_step(&mut self) {
        let Phase::Deepening(deepening) = &mut self.phase else { return };
        if self.expanded >= self.limits.work {
            let (best, lower) = (self.best.clone(), self.lower);
            self.phase = Phase::Done(Outcome::OutOf { resource: Resource::Work, best, lower });
            return;
        }
        let upper = self.best.as_ref().map(|p| p.cost);
        match deepening.step(&self.space, &self.table, upper) {
            Found::Expanded { generated } => {
                self.expanded += 1;
                self.generated += generated;
            }
            Found::Threshold(threshold) => self.lower = self.lower.max(threshold),
            Found::Path(path) => {
                self.lower = self.lower.max(path.cost);
                self.best = Some(path);
            }
            Found::Exhausted { states, cut } => {
                self.phase = Phase::Done(match self.best.take() {
                    Some(path) => {
                        self.lower = path.cost;
                        Outcome::Solved { lower: path.cost, path }
                    }
                    None if cut => Outcome::OutOf { resource: Resource::Cost, best: None, lower: MAX_COST },
                    None => Outcome::Impossible { states },
                });
            }
        }
    }
}

/// Returns the priority of a state: smaller weighted sums come first, among equal sums larger costs from the start.
fn priority(cost: Cost, lower: Cost, weight: u32) -> (u32, u32) {
    (cost * OPTIMAL + lower * weight, u32::MAX - cost)
}

/// Returns the cost of a path.
pub(super) fn cost_along<S: Space>(space: &S, keys: &[Vec<u8>]) -> Cost {
    let mut key = vec![0; space.key_width()];
    let step = |pair: &[Vec<u8>]| {
        let mut least = None;
        space.expand(&space.state(&pair[0]), &mut |_, cost, to| {
            if least.is_none_or(|l| cost < l) {
                space.key(to, &mut key);
                if key == pair[1] {
                    least = Some(cost);
                }
            }
        });
        least.expect("invariant: each state was generated from the one before")
    };
    keys.windows(2).map(step).sum()
}

/// Returns the keys from the start to a state.
pub(super) fn chain(table: &Table, id: Id) -> Vec<Vec<u8>> {
    let mut keys = Vec::new();
    let mut at = id;
    while at != NO_PARENT {
        keys.push(table.key(at).to_vec());
        at = table.parent(at);
    }
    keys.reverse();
    keys
}
