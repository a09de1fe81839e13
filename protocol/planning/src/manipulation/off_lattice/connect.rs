//! Motions between joint angles: two trees that grow towards each other (RRT-Connect; J. Kuffner and S. LaValle, 2000).

use super::arm::Arm;
use metamorph_core::rng::Rng;
use metamorph_roombots::chain::{joint_distance, random_angles, wrapped};

/// Largest number of nodes of both trees together.
const MAX_NODES: usize = 4_000;
/// The longest edge, in radians of the joint that turns most: 20°.
const REACH: f64 = 0.35;
/// Distance between samples of an edge, in radians: 2.5°.
const SAMPLE: f64 = 0.0436;
/// Number of attempts to shorten a path.
const SHORTCUTS: usize = 40;

/// A path of joint angles, from one to the next along straight lines, each joint the short way round.
pub type Path = Vec<Vec<f64>>;

struct Tree {
    nodes: Vec<(Vec<f64>, usize)>,
}

impl Tree {
    fn new(roots: &[Vec<f64>]) -> Tree {
        Tree { nodes: roots.iter().enumerate().map(|(i, q)| (q.clone(), i)).collect() }
    }
    fn nearest(&self, q: &[f64]) -> usize {
        let distance = |i: usize| joint_distance(&self.nodes[i].0, q);
        (0..self.nodes.len()).min_by(|a, b| distance(*a).total_cmp(&distance(*b))).unwrap_or(0)
    }
    /// Returns the path from a root to a node.
    fn path(&self, mut node: usize) -> Path {
        let mut path = vec![self.nodes[node].0.clone()];
        while self.nodes[node].1 != node {
            node = self.nodes[node].1;
            path.push(self.nodes[node].0.clone());
        }
        path.reverse();
        path
    }
    /// Grows from the node nearest to `q` towards it, by one edge, or until it is there or something is in the way. Returns
    /// the last node, and whether it is there.
    fn grow(&mut self, arm: &Arm, q: &[f64], all_the_way: bool) -> (usize, bool) {
        let mut at = self.nearest(q);
        loop {
            let from = &self.nodes[at].0;
            let distance = joint_distance(from, q);
            let is_there = distance <= REACH;
            let to = if is_there { q.to_vec() } else { between(from, q, REACH / distance) };
            if distance < 1e-9 || !is_free_between(arm, from, &to) {
                return (at, distance < 1e-9);
            }
            self.nodes.push((to, at));
            at = self.nodes.len() - 1;
            if is_there || !all_the_way {
                return (at, is_there);
            }
        }
    }
}

/// Returns the angles at a fraction of the way.
pub fn between(from: &[f64], to: &[f64], fraction: f64) -> Vec<f64> {
    from.iter().zip(to).map(|(a, b)| wrapped(a + fraction * wrapped(b - a))).collect()
}

/// Returns true if nothing is touched on the straight line between two postures.
pub fn is_free_between(arm: &Arm, from: &[f64], to: &[f64]) -> bool {
    let samples = (joint_distance(from, to) / SAMPLE).ceil().max(1.0) as usize;
    (0..=samples).all(|i| arm.is_free(&between(from, to, i as f64 / samples as f64)))
}

/// Finds a path from one of the angles `from` to `to`; `None` if none was found.
pub fn connect(arm: &Arm, from: &[Vec<f64>], to: &[f64], seed: u64) -> Option<Path> {
    if from.is_empty() || !arm.is_free(to) {
        return None;
    }
    let mut rng = Rng::named(seed, "off-lattice", 0);
    let (mut start, mut end) = (Tree::new(from), Tree::new(&[to.to_vec()]));
    let mut goal = to.to_vec();
    while end.nodes.len() + start.nodes.len() - from.len() < MAX_NODES {
        let (at, is_there) = start.grow(arm, &goal, true);
        if is_there {
            let there = end.nearest(&start.nodes[at].0);
            let mut path = start.path(at);
            path.extend(end.path(there).into_iter().rev().skip(1));
            return Some(shortened(arm, path, &mut rng));
        }
        let (grown, _) = end.grow(arm, &random_angles(arm.kind(), &mut rng), false);
        goal.clone_from(&end.nodes[grown].0);
    }
    None
}

/// Leaves nodes out where there is a straight way.
fn shortened(arm: &Arm, mut path: Path, rng: &mut Rng) -> Path {
    for _ in 0..SHORTCUTS {
        if path.len() < 3 {
            break;
        }
        let first = rng.below(path.len() as u64 - 2) as usize;
        let second = first + 2 + rng.below((path.len() - first - 2) as u64) as usize;
        if is_free_between(arm, &path[first], &path[second]) {
            path.drain(first + 1..second);
        }
    }
    path
}
