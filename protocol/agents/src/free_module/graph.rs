//! Undirected graphs on small numbers: components, biconnected components and shortest paths.
//!
//! Neighbours are visited in increasing order, so every answer is the same on every machine.

use std::collections::{BTreeSet, VecDeque};

/// A simple undirected graph. Its nodes are numbers below a bound.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Graph {
    present: Vec<bool>,
    neighbours: Vec<Vec<usize>>,
}

impl Graph {
    /// Creates a graph without nodes.
    pub fn new(bound: usize) -> Graph {
        Graph { present: vec![false; bound], neighbours: vec![Vec::new(); bound] }
    }
    /// Adds a node.
    pub fn insert(&mut self, node: usize) {
        self.present[node] = true;
    }
    /// Adds an edge between two nodes; a second one between the same nodes, or a loop, changes nothing.
    pub fn join(&mut self, a: usize, b: usize) {
        for (from, to) in [(a, b), (b, a)] {
            if let Err(place) = self.neighbours[from].binary_search(&to)
                && a != b
            {
                self.neighbours[from].insert(place, to);
            }
        }
    }
    /// Returns the neighbours of a node in increasing order.
    pub fn neighbours(&self, node: usize) -> &[usize] {
        &self.neighbours[node]
    }
    /// Iterates over the nodes in increasing order.
    pub fn nodes(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.present.len()).filter(|n| self.present[*n])
    }
    /// Iterates over the edges in increasing order, the smaller end first.
    pub fn edges(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        self.nodes().flat_map(|a| self.neighbours[a].iter().filter(move |b| a < **b).map(move |b| (a, *b)))
    }

    /// Returns the part of the graph on these nodes.
    pub fn induced(&self, nodes: &BTreeSet<usize>) -> Graph {
        let mut part = Graph::new(self.present.len());
        for node in nodes.iter().filter(|n| self.present[**n]) {
            part.present[*node] = true;
            part.neighbours[*node] =
                self.neighbours[*node].iter().filter(|n| nodes.contains(n)).copied().collect();
        }
        part
    }
    /// Returns the graph without these nodes.
    pub fn without(&self, nodes: &BTreeSet<usize>) -> Graph {
        self.induced(&self.nodes().filter(|n| !nodes.contains(n)).collect())
    }

    /// Returns the connected components, each in increasing order, in the order of their least nodes.
    pub fn parts(&self) -> Vec<Vec<usize>> {
        let mut seen = vec![false; self.present.len()];
        let mut parts = Vec::new();
        for start in self.nodes() {
            if std::mem::replace(&mut seen[start], true) {
                continue;
            }
            let mut part = vec![start];
            let mut next = 0;
            while let Some(node) = part.get(next).copied() {
                next += 1;
                for neighbour in &self.neighbours[node] {
                    if !std::mem::replace(&mut seen[*neighbour], true) {
                        part.push(*neighbour);
                    }
                }
            }
            part.sort_unstable();
            parts.push(part);
        }
        parts
    }

    /// Searches breadth-first from a node.
    pub fn search(&self, from: usize) -> Search {
        let mut found =
            Search { distance: vec![None; self.present.len()], parent: vec![None; self.present.len()] };
        found.distance[from] = Some(0);
        let mut queue = VecDeque::from([(from, 0)]);
        while let Some((node, distance)) = queue.pop_front() {
            for next in &self.neighbours[node] {
                if found.distance[*next].is_none() {
                    found.distance[*next] = Some(distance + 1);
                    found.parent[*next] = Some(node);
                    queue.push_back((*next, distance + 1));
                }
            }
        }
        found
    }

    /// Returns the biconnected components (Tarjan), each in increasing order, and sorted. A bridge is one of two nodes;
    /// a node without neighbours is in none.
    pub fn biconnected(&self) -> Vec<Vec<usize>> {
        let n = self.present.len();
        let mut tarjan =
            Tarjan { number: vec![0; n], low: vec![0; n], counter: 0, edges: Vec::new(), found: Vec::new() };
        for node in self.nodes() {
            if tarjan.number[node] == 0 {
                tarjan.visit(self, node);
            }
        }
        tarjan.found.sort_unstable();
        tarjan.found
    }
}

/// The result of a breadth-first search.
#[derive(Clone, Debug)]
pub struct Search {
    distance: Vec<Option<usize>>,
    parent: Vec<Option<usize>>,
}

impl Search {
    /// Returns the number of edges to a node; `None` if it cannot be reached.
    pub fn distance(&self, node: usize) -> Option<usize> {
        self.distance[node]
    }
    /// Returns the node before this one on the path from the start.
    pub fn parent(&self, node: usize) -> Option<usize> {
        self.parent[node]
    }
    /// Returns the path from the start to a node that can be reached, with both ends.
    pub fn path(&self, to: usize) -> Vec<usize> {
        let mut path = vec![to];
        let mut node = to;
        while let Some(parent) = self.parent[node] {
            path.push(parent);
            node = parent;
        }
        path.reverse();
        path
    }
    /// Returns the farthest node that can be reached, of several the smallest, and its distance.
    pub fn farthest(&self) -> (usize, usize) {
        let reached = self.distance.iter().enumerate().filter_map(|(node, d)| d.map(|d| (node, d)));
        reached.fold((0, 0), |best, (node, d)| if d > best.1 { (node, d) } else { best })
    }
}

struct Tarjan {
    /// The order of visits from 1; 0 for nodes not visited.
    number: Vec<usize>,
    low: Vec<usize>,
    counter: usize,
    edges: Vec<(usize, usize)>,
    found: Vec<Vec<usize>>,
}

/// A node under visit.
struct Visit {
    node: usize,
    parent: Option<usize>,
    /// The index of the neighbour to examine next.
    next: usize,
}

impl Tarjan {
    fn visit(&mut self, graph: &Graph, root: usize) {
        let mut stack = vec![self.enter(root, None)];
        while let Some(top) = stack.last_mut() {
            let (node, parent) = (top.node, top.parent);
            if let Some(next) = graph.neighbours[node].get(top.next).copied() {
                top.next += 1;
                if self.number[next] == 0 {
                    self.edges.push((node, next));
                    let visit = self.enter(next, Some(node));
                    stack.push(visit);
                } else if Some(next) != parent && self.number[next] < self.number[node] {
                    self.edges.push((node, next));
                    self.low[node] = self.low[node].min(self.number[next]);
                }
                continue;
            }
            stack.pop();
            if let Some(parent) = parent {
                self.low[parent] = self.low[parent].min(self.low[node]);
                if self.low[node] >= self.number[parent] {
                    self.close((parent, node));
                }
            }
        }
    }
    fn enter(&mut self, node: usize, parent: Option<usize>) -> Visit {
        self.counter += 1;
        self.number[node] = self.counter;
        self.low[node] = self.counter;
        Visit { node, parent, next: 0 }
    }
    /// Takes the edges since this one, which are a component.
    fn close(&mut self, edge: (usize, usize)) {
        let mut nodes = BTreeSet::new();
        while let Some(last) = self.edges.pop() {
            nodes.extend([last.0, last.1]);
            if last == edge {
                break;
            }
        }
        self.found.push(nodes.into_iter().collect());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn graph(bound: usize, edges: &[(usize, usize)]) -> Graph {
        let mut graph = Graph::new(bound);
        (0..bound).for_each(|n| graph.insert(n));
        edges.iter().for_each(|(a, b)| graph.join(*a, *b));
        graph
    }

    #[test]
    fn two_triangles_with_a_bridge() {
        let g = graph(7, &[(0, 1), (1, 2), (2, 0), (2, 3), (3, 4), (4, 5), (5, 3), (3, 2)]);
        assert_eq!(g.biconnected(), [vec![0, 1, 2], vec![2, 3], vec![3, 4, 5]]);
        assert_eq!(g.parts(), [vec![0, 1, 2, 3, 4, 5], vec![6]]);
        assert_eq!(g.without(&BTreeSet::from([2])).parts().len(), 3);
        assert_eq!(g.edges().count(), 7);
        let from = g.search(0);
        assert_eq!(from.path(5), [0, 2, 3, 5]);
        assert_eq!((from.farthest(), from.distance(6)), ((4, 3), None));
    }
}
