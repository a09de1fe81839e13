//! Centralised planning: the moves of all metamodules that build a goal, from a view of the whole.
//!
//! Seeds are filled in the order in which they open. Each fill takes the body for which the total number of moves is
//! smallest: its own moves around all other bodies, plus those of the rest by an optimal assignment (Kuhn and Munkres)
//! of the exact distances. If no body has a route, the cooperative search moves others out of the way. A fill after
//! which a later seed can no longer be reached is taken back, and cheaper choices are tried as long as [`BRANCHES`]
//! allows it (depth-first branch and bound). Seeds that no body can reach from the start are left out.
//!
//! The moves are found one after the other, and made in a partial order: a move comes after the earlier ones of
//! its own body and after those whose cells meet its own; a fill of a seed that is not open at the start after
//! all fills before it. All other moves may be made at once.
//!
//! Not here: who carries a plan out, and what happens when a move fails (`sim-bridge`, plan execution). Safety does
//! not rest on a plan: bodies ask for locks as always.

use metamorph_agents::metamodule::blueprint::{Seed, SeedSet};
use metamorph_agents::metamodule::motions::Sweep;
use metamorph_agents::metamodule::planning::cooperative::{Move, SearchResult, Standstill, search};
use metamorph_agents::metamodule::planning::distances::Distances;
use metamorph_agents::metamodule::planning::paths::{Ground, Route};
use metamorph_agents::metamodule::pose::Pose;
use metamorph_core::lattice::Cell;
use pathfinding::kuhn_munkres::kuhn_munkres_min;
use pathfinding::matrix::Matrix;
use std::cmp::Ordering;
use std::collections::BTreeSet;

/// Largest number of fills tried, including those taken back.
pub const BRANCHES: usize = 64;
/// Largest number of cooperative searches.
const SEARCHES: usize = 3;
/// Largest number of choices tried for one fill.
const CHOICES: usize = 3;
/// Work of one search for a route: a number of placements examined, as the cooperative search counts them.
const ROUTE_WORK: usize = 2_000;
/// Added cost, in moves, of assigning a body to a seed that is not open yet when there are no more bodies than seeds.
const LATER: i64 = 1 << 20;
/// Cost, in moves, where there is no route.
const FAR: i64 = 1 << 10;

/// One move of a plan.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlannedMove {
    /// The body, by its number among the free ones of the standstill.
    pub body: usize,
    /// The pose before the move.
    pub from: Pose,
    /// The posture after the turns.
    pub posture: u16,
    /// True if the free end then connects to the floor and the other end detaches.
    pub lands: bool,
    /// The seed that the body fills by this move.
    pub fills: Option<u8>,
    /// The moves that come before it, by number.
    pub after: Vec<usize>,
}

/// Why a plan leaves seeds unfilled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shortage {
    /// There are fewer bodies than seeds.
    Bodies,
    /// No body can ever fill an open seed; holds the number of reachable states, all of them examined.
    NoWay(usize),
    /// A bound on the work was reached first.
    Undecided,
}

/// A plan for all bodies.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CentralPlan {
    /// The moves, in an order in which they can be made one after the other.
    pub moves: Vec<PlannedMove>,
    /// Why seeds remain unfilled, if some do.
    pub shortage: Option<Shortage>,
    /// Work done, in units of the cooperative search.
    pub work: usize,
}

impl CentralPlan {
    /// Returns the number of landings.
    pub fn landings(&self) -> usize {
        self.moves.iter().filter(|m| m.lands).count()
    }
}

/// Finds moves that fill all seeds, or as many as it can. One cooperative search may take about `work`.
pub fn plan(start: &Standstill, work: usize) -> CentralPlan {
    let mut planner = Planner {
        search_work: work,
        branches: BRANCHES,
        searches: SEARCHES,
        unreachable: SeedSet::default(),
        best: Vec::new(),
        least: i64::MAX,
        first: None,
        work: 0,
    };
    let bodies: Vec<usize> = (0..start.free.len()).collect();
    let goal = start.setup.goal(start.task);
    let unfilled = goal.all().without(start.filled).len();
    planner.fill(start, &bodies, &mut Vec::new());
    let fills = planner.best.iter().filter(|m| m.fills.is_some()).count();
    let shortage = match planner.first {
        _ if fills == unfilled => None,
        _ if fills == bodies.len() => Some(Shortage::Bodies),
        Some(states) if fills == 0 => Some(Shortage::NoWay(states)),
        _ => Some(Shortage::Undecided),
    };
    let Planner { best, work, .. } = planner;
    CentralPlan { moves: ordered(start, &best), shortage, work }
}

/// A move before the partial order is known, with the cells that it needs.
#[derive(Clone)]
struct Found {
    body: usize,
    from: Pose,
    posture: u16,
    lands: bool,
    fills: Option<u8>,
    cells: Vec<Cell>,
}

fn landings(moves: &[Found]) -> i64 {
    moves.iter().filter(|m| m.lands).count() as i64
}

struct Planner {
    search_work: usize,
    branches: usize,
    searches: usize,
    /// The seeds that are left out.
    unreachable: SeedSet,
    best: Vec<Found>,
    /// Landings of the cheapest complete plan so far.
    least: i64,
    /// The number of states examined, if it is proved that no seed can be filled from the start.
    first: Option<usize>,
    work: usize,
}

/// One way to fill an open seed.
struct Choice {
    /// Moves of all bodies until the goal is built, estimated.
    cost: i64,
    seed: u8,
    body: usize,
    route: Route,
}

impl Planner {
    /// Fills all that is left and reachable, in the cheapest way found. Returns whether it could.
    fn fill(&mut self, at: &Standstill, bodies: &[usize], moves: &mut Vec<Found>) -> bool {
        let fills = |moves: &[Found]| moves.iter().filter(|m| m.fills.is_some()).count();
        let is_better = match fills(moves).cmp(&fills(&self.best)) {
            Ordering::Less => false,
            Ordering::Equal => landings(moves) < landings(&self.best),
            Ordering::Greater => true,
        };
        if is_better {
            self.best.clone_from(moves);
        }
        let open = at.setup.goal(at.task).open(at.filled).without(self.unreachable);
        if open.is_empty() || at.free.is_empty() {
            self.least = self.least.min(landings(moves));
            return true;
        }
        if self.branches == 0 {
            return false;
        }
        let mut estimate = Estimate::new(at, open, self.unreachable);
        self.work += ROUTE_WORK * estimate.seeds.len();
        if estimate.is_dead_end() {
            if !moves.is_empty() {
                return false;
            }
            self.unreachable = estimate.unreachable();
            estimate.leave_out(self.unreachable);
            if estimate.open.is_empty() {
                return false;
            }
        }
        let mut is_built = false;
        for choice in self.choices(at, &estimate) {
            let Some(path) = steps(at, &choice) else { continue };
            if landings(moves) + choice.cost < self.least {
                is_built |= self.go_on(at, bodies, moves, &path);
            }
        }
        if is_built || self.least < i64::MAX {
            return is_built;
        }
        if self.branches == 0 || self.searches == 0 {
            return false;
        }
        self.searches -= 1;
        self.work += self.search_work;
        match search(at, self.search_work) {
            SearchResult::Path(path) => self.go_on(at, bodies, moves, &path),
            SearchResult::NoWay(states) => {
                if moves.is_empty() {
                    self.first = Some(states);
                }
                false
            }
            SearchResult::Undecided => false,
        }
    }

    /// Makes the moves of a path, and fills what is left then.
    fn go_on(&mut self, at: &Standstill, bodies: &[usize], moves: &mut Vec<Found>, path: &[Move]) -> bool {
        let (before, Some(last)) = (moves.len(), path.last()) else { return false };
        if self.branches == 0 {
            return false;
        }
        self.branches -= 1;
        let Some(next) = at.after(path) else { return false };
        let seed = next.filled.without(at.filled).iter().next();
        let mut poses = at.free.clone();
        for (i, step) in path.iter().enumerate() {
            let fills = seed.filter(|_| i + 1 == path.len());
            let Some(found) = found(at, &mut poses, bodies, step, fills) else {
                moves.truncate(before);
                return false;
            };
            moves.push(found);
        }
        let mut left = bodies.to_vec();
        left.remove(last.body);
        let is_built = self.fill(&next, &left, moves);
        moves.truncate(before);
        is_built
    }

    /// The ways to fill an open seed around all other bodies, the best first.
    fn choices(&mut self, at: &Standstill, estimate: &Estimate) -> Vec<Choice> {
        let open = estimate.open;
        let mut found = Vec::new();
        let mut seen = BTreeSet::new();
        // Most often the body of the best assignment has a free way, which is as short as can be.
        let assigned: Vec<(u8, usize)> =
            estimate.assigned.iter().copied().filter(|(seed, _)| open.has(*seed)).collect();
        for (seed, body) in &assigned {
            seen.insert((*seed, *body));
            found.extend(self.choice(at, estimate, *seed, *body));
        }
        if !found.iter().any(|c: &Choice| c.cost == estimate.cost) {
            for (seed, body) in open.iter().flat_map(|s| (0..at.free.len()).map(move |b| (s, b))) {
                if seen.insert((seed, body)) {
                    found.extend(self.choice(at, estimate, seed, body));
                }
            }
        }
        found.sort_by_key(|c| (c.cost, c.seed, c.body));
        found.truncate(CHOICES);
        found
    }

    fn choice(&mut self, at: &Standstill, estimate: &Estimate, seed: u8, body: usize) -> Option<Choice> {
        estimate.steps(seed, body)?;
        self.work += ROUTE_WORK;
        let taken = at.taken_around(&[body]);
        let ground = Ground { motions: &at.setup.motions, floor: at.setup.floor, taken: &taken };
        let place = at.setup.seed(at.task, seed)?;
        let route = ground.to_seed(at.free[body], place, &at.fixed, usize::MAX)?;
        let cost = route.steps.len() as i64 + estimate.rest(seed, body);
        Some(Choice { cost, seed, body, route })
    }
}

/// The distances from all bodies to all seeds that are left, and the best assignment.
struct Estimate {
    seeds: Vec<u8>,
    open: SeedSet,
    bodies: usize,
    /// By seed and body: moves around what stays and what is built before; `None` if there is no way.
    steps: Vec<Vec<Option<i64>>>,
    /// Moves of all bodies by the best assignment.
    cost: i64,
    /// Seeds with their bodies.
    assigned: Vec<(u8, usize)>,
}

impl Estimate {
    /// Measures all seeds that are unfilled and not `unreachable`.
    fn new(at: &Standstill, open: SeedSet, unreachable: SeedSet) -> Estimate {
        let goal = at.setup.goal(at.task);
        let seeds: Vec<u8> = goal.all().without(at.filled).without(unreachable).iter().collect();
        let distances = |seed: &u8| {
            let before = goal.before(*seed).without(at.filled).iter();
            let built = before.filter_map(|s| at.setup.seed(at.task, s)).flat_map(|s| s.cells());
            let fixed: Vec<Cell> = at.fixed.iter().copied().chain(built).collect();
            at.setup.seed(at.task, *seed).map_or_else(Vec::new, |place| distances(at, place, &fixed))
        };
        let steps = seeds.iter().map(distances).collect();
        let mut estimate =
            Estimate { seeds, open, bodies: at.free.len(), steps, cost: 0, assigned: Vec::new() };
        (estimate.cost, estimate.assigned) = estimate.assign(None);
        estimate
    }

    fn steps(&self, seed: u8, body: usize) -> Option<i64> {
        let place = self.seeds.iter().position(|s| *s == seed)?;
        self.steps.get(place)?.get(body).copied().flatten()
    }
    /// Returns true if no body has a route to some seed that must be filled, whatever the others do.
    fn is_dead_end(&self) -> bool {
        self.seeds.len() <= self.bodies && !self.unreachable().is_empty()
    }
    /// Returns the seeds to which no body has a route, whatever the others do.
    fn unreachable(&self) -> SeedSet {
        let has_none = |(_, steps): &(&u8, &Vec<Option<i64>>)| steps.iter().all(Option::is_none);
        let seeds = self.seeds.iter().zip(&self.steps).filter(has_none);
        seeds.fold(SeedSet::default(), |set, (seed, _)| set.with(*seed))
    }
    /// Leaves seeds out, and assigns bodies to the others.
    fn leave_out(&mut self, seeds: SeedSet) {
        let kept = self.seeds.drain(..).zip(self.steps.drain(..)).filter(|(seed, _)| !seeds.has(*seed));
        (self.seeds, self.steps) = kept.unzip();
        self.open = self.open.without(seeds);
        (self.cost, self.assigned) = self.assign(None);
    }
    /// Moves of the others if this body fills this seed.
    fn rest(&self, seed: u8, body: usize) -> i64 {
        self.assign(Some((seed, body))).0
    }

    /// Assigns bodies to seeds, without the pair that is given.
    fn assign(&self, without: Option<(u8, usize)>) -> (i64, Vec<(u8, usize)>) {
        let seeds: Vec<usize> = (0..self.seeds.len())
            .filter(|s| without.is_none_or(|(seed, _)| self.seeds[*s] != seed))
            .collect();
        let bodies: Vec<usize> =
            (0..self.bodies).filter(|b| without.is_none_or(|(_, body)| body != *b)).collect();
        if seeds.is_empty() || bodies.is_empty() {
            return (0, Vec::new());
        }
        let steps = |seed: usize, body: usize| self.steps[seed].get(body).copied().flatten().unwrap_or(FAR);
        let later = |seed: usize| if self.open.has(self.seeds[seed]) { 0 } else { LATER };
        // The method wants as many columns as rows, or more.
        let pairs: Vec<(usize, usize)> = if bodies.len() <= seeds.len() {
            let costs = Matrix::from_fn(bodies.len(), seeds.len(), |(b, s)| {
                steps(seeds[s], bodies[b]) + later(seeds[s])
            });
            let (_, seed_of) = kuhn_munkres_min(&costs);
            seed_of.iter().enumerate().map(|(b, s)| (seeds[*s], bodies[b])).collect()
        } else {
            let costs = Matrix::from_fn(seeds.len(), bodies.len(), |(s, b)| steps(seeds[s], bodies[b]));
            let (_, body_of) = kuhn_munkres_min(&costs);
            body_of.iter().enumerate().map(|(s, b)| (seeds[s], bodies[*b])).collect()
        };
        let cost = pairs.iter().map(|(s, b)| steps(*s, *b)).sum();
        (cost, pairs.into_iter().map(|(s, b)| (self.seeds[s], b)).collect())
    }
}

/// The moves from each body to a seed around fixed cells.
fn distances(at: &Standstill, seed: Seed, fixed: &[Cell]) -> Vec<Option<i64>> {
    let distances = at.setup.motions.distances(at.setup.floor, seed, fixed);
    let ground = Ground { motions: &at.setup.motions, floor: at.setup.floor, taken: fixed };
    at.free.iter().map(|pose| distances.steps(*pose, ground.lands(*pose)).map(i64::from)).collect()
}

/// Returns a lower bound on the number of landings of any plan. A body needs at least as many landings to a seed as it
/// would with no other body around. When it turns to fill the seed, all seeds that must be filled earlier are filled;
/// for one seed, the last one, all others are.
pub fn bound(start: &Standstill) -> u32 {
    let goal = start.setup.goal(start.task);
    let all = goal.all().without(start.filled);
    let seeds: Vec<u8> = all.iter().collect();
    // With fewer bodies than seeds, which seeds are filled is not known.
    if seeds.len() > start.free.len() || seeds.is_empty() {
        return 0;
    }
    let alone = Ground { motions: &start.setup.motions, floor: start.setup.floor, taken: &start.fixed };
    // The landings of all bodies if these seeds are filled before.
    let steps = |seed: u8, filled: SeedSet| -> Vec<i64> {
        let Some(place) = start.setup.seed(start.task, seed) else { return vec![FAR; start.free.len()] };
        let built = filled.iter().filter_map(|s| start.setup.seed(start.task, s)).flat_map(|s| s.cells());
        let last: Vec<Cell> = start.fixed.iter().copied().chain(built).collect();
        let distances = Distances::with_end(alone.motions, alone.floor, place, &start.fixed, &last);
        let steps = |pose: &Pose| distances.steps(*pose, alone.lands(*pose)).map_or(FAR, i64::from);
        start.free.iter().map(steps).collect()
    };
    // A seed must be filled before another one that does not open without it.
    let one = |seed: u8| SeedSet::default().with(seed);
    let before = |seed: u8| {
        let is_needed = |other: &u8| !goal.open(goal.all().without(one(seed)).without(one(*other))).has(seed);
        let needed = seeds.iter().copied().filter(|other| *other != seed).filter(is_needed);
        needed.fold(SeedSet::default(), SeedSet::with)
    };
    let rows: Vec<Vec<i64>> = seeds.iter().map(|seed| steps(*seed, before(*seed))).collect();
    let can_be_last = |seed: &u8| !seeds.iter().any(|other| before(*other).has(*seed));
    let sums = seeds.iter().copied().filter(can_be_last).map(|last| {
        let row = steps(last, all.without(one(last)));
        let costs = Matrix::from_fn(seeds.len(), start.free.len(), |(s, b)| {
            if seeds[s] == last { row[b] } else { rows[s][b] }
        });
        kuhn_munkres_min(&costs).0
    });
    let sum = sums.min().unwrap_or(FAR);
    if sum >= FAR { 0 } else { u32::try_from(sum).unwrap_or(0) }
}

/// The moves of a route.
fn steps(at: &Standstill, choice: &Choice) -> Option<Vec<Move>> {
    let ground = Ground { motions: &at.setup.motions, floor: at.setup.floor, taken: &[] };
    let (body, mut from) = (choice.body, at.free[choice.body]);
    let mut moves = Vec::new();
    for posture in &choice.route.steps {
        moves.push(Move { body, from, posture: *posture, lands: true });
        from = ground.landed(from, *posture)?;
    }
    moves.extend(choice.route.last.map(|posture| Move { body, from, posture, lands: false }));
    Some(moves)
}

/// Returns a move with the cells that it needs while all other bodies stay in their `poses`, and applies it to `poses`.
fn found(
    at: &Standstill,
    poses: &mut [Pose],
    bodies: &[usize],
    step: &Move,
    fills: Option<u8>,
) -> Option<Found> {
    let motions = &at.setup.motions;
    let others = poses.iter().enumerate().filter(|(i, _)| *i != step.body);
    let taken: Vec<Cell> =
        at.fixed.iter().copied().chain(others.flat_map(|(_, p)| motions.cells(*p))).collect();
    let ground = Ground { motions, floor: at.setup.floor, taken: &taken };
    let path = motions.graph().path(step.from.posture, step.posture, ground.taken_at(step.from))?;
    let swept = Sweep(path.swept | motions.graph().filled_bits(step.from.posture));
    let end = Pose { posture: step.posture, ..step.from };
    let mut cells: Vec<Cell> = motions.swept(step.from.state, swept).chain(motions.cells(end)).collect();
    cells.sort_unstable();
    cells.dedup();
    *poses.get_mut(step.body)? = if step.lands { ground.landed(step.from, step.posture)? } else { end };
    let Move { body, from, posture, lands } = *step;
    Some(Found { body: bodies[body], from, posture, lands, fills, cells })
}

/// Returns the moves, each with the earlier moves that it must come after.
fn ordered(start: &Standstill, found: &[Found]) -> Vec<PlannedMove> {
    let open = start.setup.goal(start.task).open(start.filled);
    let comes_after = |i: usize, j: usize| {
        let (late, early) = (&found[i], &found[j]);
        let opens = early.fills.is_some() && late.fills.is_some_and(|seed| !open.has(seed));
        late.body == early.body || opens || late.cells.iter().any(|c| early.cells.binary_search(c).is_ok())
    };
    let planned = |(i, m): (usize, &Found)| PlannedMove {
        body: m.body,
        from: m.from,
        posture: m.posture,
        lands: m.lands,
        fills: m.fills,
        after: (0..i).filter(|j| comes_after(i, *j)).collect(),
    };
    found.iter().enumerate().map(planned).collect()
}
