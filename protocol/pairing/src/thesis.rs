//! The published pairing by biconnected components (thesis C.6.2), on any graph, for comparison with a matching.
//!
//! The text leaves open what follows when no component of two nodes is left. Here the body is the 2-core, and a drawn
//! edge is paired then.

use super::Pairing;
use metamorph_core::rng::Rng;
use petgraph::algo::{bridges, connected_components, maximum_matching};
use petgraph::graph::UnGraph;
use petgraph::visit::EdgeRef;
use std::collections::{BTreeSet, VecDeque};

/// A graph of nodes to be paired with neighbours.
#[derive(Clone, Debug)]
pub struct Nodes {
    neighbours: Vec<BTreeSet<usize>>,
}

impl Nodes {
    /// Draws a graph of Erdős and Rényi.
    pub fn random(nodes: usize, mean_degree: u64, rng: &mut Rng) -> Nodes {
        let mut neighbours = vec![BTreeSet::new(); nodes];
        for a in 0..nodes {
            for b in a + 1..nodes {
                if rng.below(nodes as u64 - 1) < mean_degree {
                    neighbours[a].insert(b);
                    neighbours[b].insert(a);
                }
            }
        }
        Nodes { neighbours }
    }
    /// The cells of a structure.
    pub fn of(pairing: &Pairing) -> Nodes {
        let cells: Vec<_> = pairing.cells().collect();
        let near = |c: &metamorph_core::lattice::Cell| {
            let at = |n: metamorph_core::lattice::Cell| {
                cells.binary_search_by_key(&super::key(n), |c| super::key(*c))
            };
            c.neighbours().into_iter().filter_map(|n| at(n).ok()).collect()
        };
        Nodes { neighbours: cells.iter().map(near).collect() }
    }

    fn graph(&self) -> UnGraph<(), (), usize> {
        let mut graph = UnGraph::with_capacity(self.neighbours.len(), 0);
        for _ in &self.neighbours {
            graph.add_node(());
        }
        for (a, neighbours) in self.neighbours.iter().enumerate() {
            for b in neighbours.range(a + 1..) {
                graph.add_edge(a.into(), (*b).into(), ());
            }
        }
        graph
    }
    /// Returns true for a structure that the published rule calls valid: an even number of connected nodes, none with
    /// more than two neighbours that have no other neighbour.
    pub fn is_valid(&self) -> bool {
        let leaf = |n: &&usize| self.neighbours[**n].len() <= 1;
        self.neighbours.len().is_multiple_of(2)
            && self.neighbours.iter().all(|near| near.iter().filter(leaf).count() <= 2)
            && connected_components(&self.graph()) == 1
    }

    /// Returns the number of pairs of a maximum matching.
    pub fn most_pairs(&self) -> usize {
        maximum_matching(&self.graph()).len()
    }
    /// Returns the number of pairs that the published algorithm makes.
    pub fn published_pairs(&self, rng: &mut Rng) -> usize {
        let mut left = self.clone();
        let mut pairs = 0;
        while left.neighbours.iter().any(|n| !n.is_empty()) {
            let graph = left.graph();
            let distance = left.distances_to_body();
            let ends = |e: petgraph::graph::EdgeReference<'_, (), usize>| {
                (e.source().index().min(e.target().index()), e.source().index().max(e.target().index()))
            };
            let mut components: Vec<(usize, usize)> = bridges(&graph).map(ends).collect();
            if components.is_empty() {
                let all: Vec<_> = graph.edge_references().map(ends).collect();
                components.push(all[rng.below(all.len() as u64) as usize]);
            }
            // The mean distance of two nodes orders as their sum.
            let far = |(a, b): &(usize, usize)| distance[*a] + distance[*b];
            let most = components.iter().map(far).max().unwrap_or(0);
            components.retain(|c| far(c) == most);
            components.sort_unstable();
            while !components.is_empty() {
                let (a, b) = components.swap_remove(rng.below(components.len() as u64) as usize);
                if left.neighbours[a].contains(&b) {
                    left.take(a, b);
                    pairs += 1;
                }
            }
        }
        pairs
    }
    /// Returns the number of pairs made by pairing a node of lowest degree with its neighbour of lowest degree, again
    /// and again. Ties are drawn.
    pub fn lowest_degree_pairs(&self, rng: &mut Rng) -> usize {
        let mut left = self.clone();
        let mut pairs = 0;
        loop {
            let degree = |n: usize| left.neighbours[n].len();
            let nodes: Vec<usize> = (0..left.neighbours.len()).filter(|n| degree(*n) > 0).collect();
            let Some(a) = lowest(&nodes, degree, rng) else { return pairs };
            let near: Vec<usize> = left.neighbours[a].iter().copied().collect();
            let b = lowest(&near, degree, rng).expect("invariant: the degree of a is not 0");
            left.take(a, b);
            pairs += 1;
        }
    }

    /// Removes two nodes.
    fn take(&mut self, a: usize, b: usize) {
        for node in [a, b] {
            for near in std::mem::take(&mut self.neighbours[node]) {
                self.neighbours[near].remove(&node);
            }
        }
    }
    /// Returns each node's distance to the 2-core; 0 for all if there is none.
    fn distances_to_body(&self) -> Vec<usize> {
        let mut core = self.clone();
        while let Some(leaf) = core.neighbours.iter().position(|n| n.len() == 1) {
            let near = core.neighbours[leaf].pop_first().expect("invariant: it has one neighbour");
            core.neighbours[near].remove(&leaf);
        }
        let body: VecDeque<usize> =
            (0..self.neighbours.len()).filter(|n| !core.neighbours[*n].is_empty()).collect();
        let mut distance = vec![if body.is_empty() { 0 } else { usize::MAX }; self.neighbours.len()];
        for node in &body {
            distance[*node] = 0;
        }
        let mut queue = body;
        while let Some(node) = queue.pop_front() {
            for near in &self.neighbours[node] {
                if distance[*near] == usize::MAX {
                    distance[*near] = distance[node] + 1;
                    queue.push_back(*near);
                }
            }
        }
        // A part without a body of its own counts as body.
        distance.into_iter().map(|d| if d == usize::MAX { 0 } else { d }).collect()
    }
}

fn lowest(nodes: &[usize], degree: impl Fn(usize) -> usize, rng: &mut Rng) -> Option<usize> {
    let least = nodes.iter().map(|n| degree(*n)).min()?;
    let ties: Vec<usize> = nodes.iter().copied().filter(|n| degree(*n) == least).collect();
    Some(ties[rng.below(ties.len() as u64) as usize])
}
