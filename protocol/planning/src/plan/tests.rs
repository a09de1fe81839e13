//! The engines against an independent search on random graphs.

use super::beam::Beam;
use super::bidirectional::Bidirectional;
use super::levels::{Counted, Levels};
use super::portfolio::Portfolio;
use super::search::{Method, OPTIMAL, Search};
use super::{Cost, Limits, Outcome, Resource, Space, Step, actions};
use metamorph_core::rng::Rng;
use pathfinding::prelude::dijkstra;
use std::collections::BTreeMap;

/// A random undirected graph with a bound that is a half of the distance, or 0.
#[derive(Clone)]
struct Graph {
    edges: Vec<Vec<(u32, Cost)>>,
    goal: u32,
    lower: Vec<Option<Cost>>,
}

impl Graph {
    fn draw(seed: u64, unit: bool) -> Graph {
        let mut rng = Rng::named(seed, "graph", 0);
        let n = 2 + rng.below(60) as u32;
        let mut edges = vec![Vec::new(); n as usize];
        for _ in 0..rng.below(u64::from(3 * n)) {
            let (a, b) = (rng.below(u64::from(n)) as u32, rng.below(u64::from(n)) as u32);
            let cost = if unit { 1 } else { rng.below(8) as Cost };
            edges[a as usize].push((b, cost));
            edges[b as usize].push((a, cost));
        }
        let goal = rng.below(u64::from(n)) as u32;
        let informed = rng.below(2) == 1;
        let mut graph = Graph { edges, goal, lower: vec![Some(0); n as usize] };
        let distances: Vec<_> = (0..n).map(|v| graph.distance(v)).collect();
        if informed {
            graph.lower = distances.iter().map(|d| d.map(|d| d / 2)).collect();
        }
        graph
    }
    fn distance(&self, from: u32) -> Option<Cost> {
        dijkstra(&from, |v| self.edges[*v as usize].clone(), |v| *v == self.goal).map(|(_, c)| c)
    }
}

impl Space for Graph {
    type State = u32;
    type Action = u32;
    fn key_width(&self) -> usize {
        4
    }
    fn key(&self, state: &u32, key: &mut [u8]) {
        key.copy_from_slice(&state.to_le_bytes());
    }
    fn state(&self, key: &[u8]) -> u32 {
        u32::from_le_bytes(key.try_into().unwrap())
    }
    fn expand(&self, state: &u32, visit: &mut impl FnMut(u32, Cost, &u32)) {
        for (to, cost) in &self.edges[*state as usize] {
            visit(*to, *cost, to);
        }
    }
    fn lower(&self, state: &u32) -> Option<Cost> {
        self.lower[*state as usize]
    }
    fn is_goal(&self, state: &u32) -> bool {
        *state == self.goal
    }
}

const LIMITS: Limits = Limits { memory: 2 << 20, work: 1_000_000 };

fn run(graph: &Graph, limits: Limits, method: Method) -> (Outcome, u64) {
    let mut search = Search::new(graph.clone(), &0, limits, method);
    loop {
        if let Step::Done(outcome) = search.advance(7) {
            return (outcome, search.progress().expanded);
        }
    }
}

fn check_path(graph: &Graph, keys: &[Vec<u8>], cost: Cost) {
    let way = actions(graph, &0, keys).expect("the keys are a path");
    let mut at = 0;
    let mut sum = 0;
    for to in way {
        let edges: BTreeMap<u32, Cost> =
            graph.edges[at as usize].iter().rev().fold(BTreeMap::new(), |mut all, (v, c)| {
                let known = all.entry(*v).or_insert(*c);
                *known = (*known).min(*c);
                all
            });
        sum += edges[&to];
        at = to;
    }
    assert_eq!((at, sum), (graph.goal, cost));
}

#[test]
fn every_engine_agrees_with_dijkstra() {
    for seed in 0..300 {
        let graph = Graph::draw(seed, false);
        let truth = graph.distance(0);
        let methods = [
            Method::astar(),
            Method::anytime(),
            Method::deepening(),
            Method { weights: vec![OPTIMAL], keep: true, deepen: false },
        ];
        for method in methods {
            let (outcome, expanded) = run(&graph, LIMITS, method.clone());
            match (&outcome, truth) {
                (Outcome::Solved { path, lower }, Some(cost)) => {
                    assert_eq!((path.cost, *lower), (cost, cost), "seed {seed}, {method:?}");
                    check_path(&graph, &path.keys, cost);
                }
                (Outcome::Impossible { .. }, None) => {}
                other => panic!("seed {seed}, {method:?}: {other:?}"),
            }
            assert_eq!(run(&graph, LIMITS, method), (outcome, expanded), "seed {seed}: not repeatable");
        }
    }
}

/// A* and beam search together give what A* gives, and a plan within a factor if asked.
#[test]
fn a_portfolio_is_exact_and_accepts_a_factor() {
    let limits = Limits { memory: 64 << 20, work: 1_000_000 };
    let (mut found_first, mut within) = (0, 0);
    for seed in 0..200 {
        let graph = Graph::draw(seed, seed % 2 == 0);
        let truth = graph.distance(0);
        for weight in [OPTIMAL, 200] {
            let mut search = Portfolio::new(graph.clone(), &0, limits, weight);
            let outcome = loop {
                found_first += u32::from(search.progress().upper.is_some());
                if let Step::Done(outcome) = search.advance(3) {
                    break outcome;
                }
            };
            match (&outcome, truth) {
                (Outcome::Solved { path, lower }, Some(cost)) => {
                    assert!(
                        *lower <= cost && path.cost * OPTIMAL <= lower * weight,
                        "seed {seed}: {outcome:?}"
                    );
                    check_path(&graph, &path.keys, path.cost);
                    within += u32::from(path.cost > cost);
                }
                (Outcome::Impossible { .. }, None) => {}
                other => panic!("seed {seed}: {other:?}"),
            }
        }
    }
    println!("{found_first} turns with a plan before the proof, {within} plans that are not optimal");
    assert!(found_first > 0);
}

/// A beam finds a plan in every connected graph that it can keep, and never claims more than its bound proves.
#[test]
fn a_beam_finds_plans_and_proves_none() {
    let limits = Limits { memory: 16 << 20, work: 20_000 };
    for seed in 0..200 {
        let graph = Graph::draw(seed, true);
        let mut beam = Beam::new(graph.clone(), &0, limits);
        let Step::Done(outcome) = beam.advance(u64::MAX) else { panic!("seed {seed}: it did not end") };
        let truth = graph.distance(0);
        match outcome {
            Outcome::Solved { path, lower } => assert_eq!((Some(path.cost), lower), (truth, path.cost)),
            Outcome::OutOf { best: Some(path), .. } => {
                assert!(truth.is_some_and(|cost| cost <= path.cost), "seed {seed}");
                check_path(&graph, &path.keys, path.cost);
            }
            Outcome::OutOf { best: None, .. } => assert_eq!(truth, None, "seed {seed}"),
            other => panic!("seed {seed}: {other:?}"),
        }
    }
}

/// A plan within a factor carries a bound that is right.
#[test]
fn weighted_plans_are_within_their_weight() {
    for seed in 0..300 {
        let graph = Graph::draw(seed, false);
        let method = Method { weights: vec![200], keep: true, deepen: false };
        let (Outcome::Solved { path, lower }, Some(truth)) =
            (run(&graph, LIMITS, method).0, graph.distance(0))
        else {
            continue;
        };
        assert!(lower <= truth && truth <= path.cost && path.cost <= 2 * lower, "seed {seed}");
        check_path(&graph, &path.keys, path.cost);
    }
}

/// Stopped at any amount of work, the bound holds and the best plan so far is a plan.
#[test]
fn a_limit_leaves_a_valid_bound_and_plan() {
    for seed in 0..100 {
        let graph = Graph::draw(seed, false);
        let truth = graph.distance(0);
        for work in 0..40 {
            for method in [Method::astar(), Method::anytime(), Method::deepening()] {
                let (outcome, expanded) = run(&graph, Limits { work, ..LIMITS }, method);
                assert!(expanded <= work);
                let Outcome::OutOf { resource, best, lower } = outcome else { continue };
                assert_eq!(resource, Resource::Work);
                assert!(truth.is_none_or(|t| lower <= t), "seed {seed}, work {work}: {lower} > {truth:?}");
                if let Some(path) = best {
                    assert!(path.cost >= lower);
                    check_path(&graph, &path.keys, path.cost);
                }
            }
        }
    }
}

#[test]
fn both_ends_meet_on_a_shortest_path() {
    for seed in 0..300 {
        let graph = Graph::draw(seed, true);
        let mut search = Bidirectional::new(graph.clone(), &0, &graph.goal, LIMITS);
        let outcome = loop {
            if let Step::Done(outcome) = search.advance(3) {
                break outcome;
            }
        };
        match (outcome, graph.distance(0)) {
            (Outcome::Solved { path, .. }, Some(cost)) => {
                assert_eq!(path.cost, cost, "seed {seed}");
                check_path(&graph, &path.keys, cost);
            }
            (Outcome::Impossible { .. }, None) => {}
            other => panic!("seed {seed}: {other:?}"),
        }
    }
}

/// A line of numbers, long enough to fill the least memory.
#[derive(Clone)]
struct Plane(i32);

impl Space for Plane {
    type State = (i32, i32);
    type Action = ();
    fn key_width(&self) -> usize {
        8
    }
    fn key(&self, (x, y): &(i32, i32), key: &mut [u8]) {
        key[..4].copy_from_slice(&x.to_le_bytes());
        key[4..].copy_from_slice(&y.to_le_bytes());
    }
    fn state(&self, key: &[u8]) -> (i32, i32) {
        let number = |b: &[u8]| i32::from_le_bytes(b.try_into().unwrap());
        (number(&key[..4]), number(&key[4..]))
    }
    fn expand(&self, (x, y): &(i32, i32), visit: &mut impl FnMut((), Cost, &(i32, i32))) {
        for (dx, dy) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
            visit((), 1, &(x + dx, y + dy));
        }
    }
    fn lower(&self, (x, y): &(i32, i32)) -> Option<Cost> {
        Some(((x - self.0).abs().max((y - self.0).abs())) as Cost)
    }
    fn is_goal(&self, at: &(i32, i32)) -> bool {
        *at == (self.0, self.0)
    }
}

#[test]
fn a_search_stops_within_a_hundredth_of_its_memory() {
    let memory = Limits::LEAST_MEMORY;
    let method = Method { deepen: false, ..Method::astar() };
    let mut search = Search::new(Plane(2_000), &(0, 0), Limits { memory, work: u64::MAX }, method);
    let outcome = loop {
        if let Step::Done(outcome) = search.advance(1_000) {
            break outcome;
        }
    };
    assert!(matches!(outcome, Outcome::OutOf { resource: Resource::Memory, best: None, lower: 2_000.. }));
    let used = search.progress().bytes as f64 / memory as f64;
    assert!((0.99..=1.0).contains(&used), "{used}");
}

/// With the states that fit kept, iterative deepening finds the path that A* with enough memory finds.
#[test]
fn iterative_deepening_goes_on_where_memory_ends() {
    let space = Plane(6);
    let limits = Limits { memory: 430_000, work: 200_000_000 };
    let mut search = Search::new(space, &(-30, 30), limits, Method::astar());
    let outcome = loop {
        if let Step::Done(outcome) = search.advance(1_000) {
            break outcome;
        }
    };
    assert!(matches!(&outcome, Outcome::Solved { path, lower: 60 } if path.cost == 60), "{outcome:?}");
}

#[test]
fn levels_count_every_state_once() {
    let mut levels = Levels::new(Plane(0), &(0, 0), Limits { memory: 64 << 20, work: 200 });
    assert_eq!(levels.advance(u64::MAX), Counted::OutOfRoom);
    assert_eq!(levels.counts(), [1, 4, 8, 12, 16, 20, 24, 28, 32, 36, 40]);
    let graph = Graph::draw(4, true);
    let mut levels = Levels::new(graph, &0, LIMITS);
    assert_eq!(levels.advance(u64::MAX), Counted::All);
    assert_eq!(levels.counts().iter().sum::<u64>(), levels.table().len() as u64);
}
