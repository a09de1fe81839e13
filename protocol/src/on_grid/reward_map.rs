//! Metamodules on a floor of connectors: the reward map of thesis 4.2.3, and exact moves with failing connections.
//!
//! The thesis leaves bonus, penalty, ties and classes open. Assumed here: the reward of a connector is minus the
//! number of its moves to the goal on a map without classes, in which two connectors are neighbours if some class
//! allows the move between them; ties are broken by the straight-line distance. A try fails if the current class
//! does not allow the move, or if it would reach the goal in another class; then the next best connector is tried.
//!
//! The exact planner works on connectors with classes. A failed connection leaves a metamodule where it was, so the
//! expected number of tries of a move is 1 / (1 − p), and the least expected number of tries to the goal is a
//! shortest path with these weights. No value iteration is needed.

use crate::ratio::Ratio;
use crate::rng::Rng;
use crate::roombots::Kind;
use crate::roombots::grid::{GridState, landings};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// Moves after which a walk by the reward map is given up.
const MOVE_LIMIT: u32 = 100;
/// One try in the unit of [`Floor::expected`]: expected tries are counted in millionths.
pub const MILLION: u64 = 1_000_000;

/// A square floor of connectors, and for each class the moves of one kind of metamodule.
#[derive(Clone, Debug)]
pub struct Floor {
    side: i16,
    moves: [Vec<GridState>; 4],
}

/// A walk by the reward map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapWalk {
    /// True if the goal was reached in its class.
    pub reached: bool,
    /// Tries that failed.
    pub failed: u32,
    /// Moves made.
    pub moves: u32,
    /// Moves to the goal by the map.
    pub minimal: u32,
}

impl Floor {
    /// Creates a floor of `side` by `side` connectors.
    pub fn new(kind: Kind, side: i16) -> Floor {
        let all: Vec<GridState> = landings(kind).into_keys().collect();
        let turned = |class| all.iter().map(move |l| GridState::new(0, 0, class).then(*l));
        Floor { side, moves: [0, 1, 2, 3].map(|class| turned(class).collect()) }
    }
    fn has(&self, x: i16, y: i16) -> bool {
        (0..self.side).contains(&x) && (0..self.side).contains(&y)
    }
    /// Returns the states that one move from `at` leads to.
    pub fn next(&self, at: GridState) -> Vec<GridState> {
        let to = self.moves[usize::from(at.class)].iter();
        let to = to.map(|s| GridState::new(at.x + s.x, at.y + s.y, s.class));
        to.filter(|s| self.has(s.x, s.y)).collect()
    }
    /// Draws a place and a class.
    pub fn draw(&self, rng: &mut Rng) -> GridState {
        let side = self.side as u64;
        GridState::new(rng.below(side) as i16, rng.below(side) as i16, rng.below(4) as u8)
    }

    /// Returns the differences between the connectors before and after a move, for all moves of all classes.
    fn offsets(&self) -> BTreeSet<(i16, i16)> {
        self.moves.iter().flatten().map(|s| (s.x, s.y)).collect()
    }

    /// Returns the map: for every connector from which the goal can be reached, the number of moves, whatever the
    /// classes.
    pub fn map(&self, goal: GridState) -> BTreeMap<(i16, i16), u32> {
        let offsets = self.offsets();
        let mut far = BTreeMap::from([((goal.x, goal.y), 0)]);
        let mut open = VecDeque::from([((goal.x, goal.y), 0)]);
        while let Some(((x, y), n)) = open.pop_front() {
            for (dx, dy) in &offsets {
                // The offsets of all four classes are symmetric.
                let to = (x - dx, y - dy);
                if self.has(to.0, to.1) && !far.contains_key(&to) {
                    far.insert(to, n + 1);
                    open.push_back((to, n + 1));
                }
            }
        }
        far
    }

    /// Walks by the reward map; `penalty` moves are added for each earlier visit of a connector.
    pub fn walk(&self, from: GridState, goal: GridState, penalty: u32) -> MapWalk {
        let (far, offsets) = (self.map(goal), self.offsets());
        let minimal = far.get(&(from.x, from.y)).copied().unwrap_or(0);
        let mut walk = MapWalk { reached: false, failed: 0, moves: 0, minimal };
        let mut visits = BTreeMap::from([((from.x, from.y), 1)]);
        let mut at = from;
        while walk.moves < MOVE_LIMIT {
            if at == goal {
                return MapWalk { reached: true, ..walk };
            }
            let mut candidates: Vec<_> = offsets
                .iter()
                .map(|(dx, dy)| (at.x + dx, at.y + dy))
                .filter_map(|c| {
                    let moves = far.get(&c)? + penalty * visits.get(&c).unwrap_or(&0);
                    let (x, y) = (i32::from(c.0 - goal.x), i32::from(c.1 - goal.y));
                    Some((moves, x * x + y * y, c))
                })
                .collect();
            candidates.sort_unstable();
            let next = self.next(at);
            let landed = candidates.iter().find_map(|(_, _, c)| {
                let there = |s: &&GridState| (s.x, s.y) == *c && (*c != (goal.x, goal.y) || **s == goal);
                let found = next.iter().find(there);
                walk.failed += u32::from(found.is_none());
                found
            });
            let Some(to) = landed else { break };
            at = *to;
            walk.moves += 1;
            *visits.entry((at.x, at.y)).or_default() += 1;
        }
        walk
    }

    /// Returns the least expected tries from every state to the goal, in millionths, if connecting at a connector fails
    /// with the probability of `failure`.
    pub fn expected(
        &self,
        goal: GridState,
        failure: impl Fn(GridState) -> Ratio,
    ) -> BTreeMap<GridState, u64> {
        let mut known = BTreeMap::new();
        let mut open = BTreeSet::from([(0, goal)]);
        while let Some((cost, at)) = open.pop_first() {
            if known.contains_key(&at) {
                continue;
            }
            known.insert(at, cost);
            // Tries of connecting here, from wherever a move leads here: moves can be undone.
            let p = failure(at);
            let (num, den) = (u64::from(p.num()), u64::from(p.den()));
            if num == den {
                continue;
            }
            let tries = MILLION * den / (den - num);
            for from in self.next(at).into_iter().filter(|s| self.next(*s).contains(&at)) {
                open.insert((cost + tries, from));
            }
        }
        known
    }

    /// Walks by the least expected number of tries, with connection failures drawn from `rng`. Returns the numbers of
    /// tries and of moves.
    pub fn attempt(
        &self,
        from: GridState,
        expected: &BTreeMap<GridState, u64>,
        failure: impl Fn(GridState) -> Ratio,
        rng: &mut Rng,
    ) -> (u64, u64) {
        let (mut tries, mut moves) = (0, 0);
        let mut at = from;
        let value = |s: &GridState| {
            let p = failure(*s);
            let (num, den) = (u64::from(p.num()), u64::from(p.den()));
            let own = expected.get(s).copied().filter(|_| num < den)?;
            Some(own + MILLION * den / (den - num))
        };
        while expected.get(&at).is_some_and(|e| *e > 0) {
            let next = self.next(at).into_iter().filter_map(|s| value(&s).map(|v| (v, s))).min();
            let Some((_, to)) = next else { break };
            tries += 1;
            if !rng.chance(failure(to)) {
                moves += 1;
                at = to;
            }
        }
        (tries, moves)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const P: (u32, u32) = (1, 20);

    /// With equal probabilities the expectation is moves / (1 − p), and a bad connector is walked around.
    #[test]
    fn expectations_are_those_of_shortest_paths_and_avoid_bad_connectors() {
        let always = |_| Ratio::ZERO;
        let equal = |_| Ratio::new(P.0, P.1).unwrap();
        for kind in Kind::METAMODULES {
            let floor = Floor::new(kind, 13);
            let goal = GridState::new(6, 6, 1);
            let (sure, tries) = (floor.expected(goal, always), floor.expected(goal, equal));
            // PAR cannot turn in the corners of a floor.
            let least = if kind == Kind::Par { 13 * 13 * 4 - 16 } else { 13 * 13 * 4 };
            assert!((least..=13 * 13 * 4).contains(&sure.len()), "{kind}: {}", sure.len());
            for (state, moves) in &sure {
                let moves = moves / MILLION;
                assert_eq!(tries[state], moves * (MILLION * 20 / 19), "{kind}, {state}");
                let map = floor.map(goal)[&(state.x, state.y)];
                assert!(u64::from(map) <= moves, "{kind}, {state}");
            }
            let from = GridState::new(0, 6, 0);
            let on_path = floor.next(from).into_iter().min_by_key(|s| sure[s]).unwrap();
            let bad = |s: GridState| {
                let here = (s.x, s.y) == (on_path.x, on_path.y);
                if here { Ratio::new(3, 5).unwrap() } else { Ratio::new(P.0, P.1).unwrap() }
            };
            let around = floor.expected(goal, bad)[&from];
            let through = tries[&from] + (MILLION * 5 / 2 - MILLION * 20 / 19);
            assert!(around < through, "{kind}: {around} against {through}");
            let mut rng = Rng::named(1, "tries", 0);
            let (mut tried, mut made) = (0, 0);
            for _ in 0..2_000 {
                let (t, s) = floor.attempt(floor.draw(&mut rng), &tries, equal, &mut rng);
                (tried, made) = (tried + t, made + s);
            }
            let ratio = tried as f64 / made as f64;
            assert!((ratio - 20.0 / 19.0).abs() < 0.02, "{kind}: {ratio}");
        }
    }
}
