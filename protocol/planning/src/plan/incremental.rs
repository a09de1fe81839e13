//! Replanning where edges change: D* Lite (Koenig and Likhachev, AAAI 2002), which keeps the distances to the goal
//! and repairs those that an edit or a move of the start has changed.

use std::collections::BTreeSet;

/// The length of a path, in the unit of the graph's edges.
pub type Length = u64;

/// No path.
const INFINITE: Length = Length::MAX;

/// A graph whose edges may appear and vanish. An edge leads both ways and has a length above 0: around a cycle of
/// length 0, distances would support each other after the path to the goal is gone.
pub trait Graph {
    /// Returns the number of nodes; nodes are numbered from 0.
    fn size(&self) -> usize;
    /// Visits the neighbours of a node with the lengths of the edges to them.
    fn neighbours(&self, node: u32, visit: &mut impl FnMut(u32, Length));
    /// Returns a lower bound of the distance between two nodes, which obeys the triangle inequality whatever edges
    /// there are.
    fn lower(&self, from: u32, to: u32) -> Length;
}

/// The priority of a node: the bound of a path through it, then its distance to the goal.
type Priority = (Length, Length);

/// A shortest path to the nearest of some goals, kept up to date.
#[derive(Clone, Debug)]
pub struct DStarLite<G> {
    graph: G,
    start: u32,
    is_goal: Vec<bool>,
    /// The distance of each node to the nearest goal, as of its last expansion (g of D* Lite).
    known: Vec<Length>,
    /// The distance of each node computed from the distances of its neighbours (rhs of D* Lite).
    ahead: Vec<Length>,
    /// Nodes whose two distances differ.
    open: BTreeSet<(Priority, u32)>,
    priorities: Vec<Option<Priority>>,
    /// The amount added to new priorities, instead of lowering the old ones when the start moves (k_m of D* Lite).
    raised: Length,
    expanded: u64,
}

impl<G: Graph> DStarLite<G> {
    /// Creates a search without distances. [`DStarLite::distance`] computes them.
    pub fn new(graph: G, start: u32, goals: impl IntoIterator<Item = u32>) -> DStarLite<G> {
        let n = graph.size();
        let mut search = DStarLite {
            graph,
            start,
            is_goal: vec![false; n],
            known: vec![INFINITE; n],
            ahead: vec![INFINITE; n],
            open: BTreeSet::new(),
            priorities: vec![None; n],
            raised: 0,
            expanded: 0,
        };
        for goal in goals {
            search.is_goal[goal as usize] = true;
            search.ahead[goal as usize] = 0;
            search.schedule(goal);
        }
        search
    }
    /// Returns the graph.
    pub fn graph(&self) -> &G {
        &self.graph
    }
    /// Returns the number of expansions; a node that is expanded again counts again.
    pub fn expanded(&self) -> u64 {
        self.expanded
    }
    /// Changes edges. `touched` are the nodes at which an edge appears, vanishes or changes its length, both ends of
    /// each.
    pub fn edit(&mut self, change: impl FnOnce(&mut G), touched: impl IntoIterator<Item = u32>) {
        change(&mut self.graph);
        for node in touched {
            self.look_ahead(node);
        }
    }
    /// Moves the start to another node.
    pub fn move_to(&mut self, start: u32) {
        self.raised += self.graph.lower(self.start, start);
        self.start = start;
    }
    /// Returns the distance from the start to the nearest goal, `None` if there is no path.
    pub fn distance(&mut self) -> Option<Length> {
        while let Some(&(priority, node)) = self.open.first() {
            let i = node as usize;
            let start = self.start as usize;
            if priority >= self.priority(self.start) && self.ahead[start] == self.known[start] {
                break;
            }
            let current = self.priority(node);
            if priority < current {
                self.schedule(node);
                continue;
            }
            self.expanded += 1;
            if self.known[i] > self.ahead[i] {
                self.known[i] = self.ahead[i];
                self.schedule(node);
            } else {
                self.known[i] = INFINITE;
                self.look_ahead(node);
            }
            let mut around = Vec::new();
            self.graph.neighbours(node, &mut |to, _| around.push(to));
            for to in around {
                self.look_ahead(to);
            }
        }
        Some(self.ahead[self.start as usize]).filter(|d| *d < INFINITE)
    }
    /// Returns the nodes of a shortest path from the start on, `None` if there is none.
    pub fn path(&mut self) -> Option<Vec<u32>> {
        self.distance()?;
        let (mut path, mut at) = (vec![self.start], self.start);
        while !self.is_goal[at as usize] {
            let mut best = (INFINITE, at);
            let known = &self.known;
            self.graph.neighbours(at, &mut |to, length| {
                best = best.min((known[to as usize].saturating_add(length), to));
            });
            at = best.1;
            path.push(at);
        }
        Some(path)
    }

    fn priority(&self, node: u32) -> Priority {
        let least = self.known[node as usize].min(self.ahead[node as usize]);
        let through = least.saturating_add(self.graph.lower(self.start, node)).saturating_add(self.raised);
        (through, least)
    }
    /// Computes a node's distance from the distances of its neighbours.
    fn look_ahead(&mut self, node: u32) {
        let i = node as usize;
        if !self.is_goal[i] {
            let (mut least, known) = (INFINITE, &self.known);
            self.graph.neighbours(node, &mut |to, length| {
                least = least.min(known[to as usize].saturating_add(length));
            });
            self.ahead[i] = least;
        }
        self.schedule(node);
    }
    /// Puts a node into the queue if its distances differ, with its current priority, and takes it out otherwise.
    fn schedule(&mut self, node: u32) {
        let i = node as usize;
        let wanted = (self.known[i] != self.ahead[i]).then(|| self.priority(node));
        if let Some(before) = std::mem::replace(&mut self.priorities[i], wanted) {
            self.open.remove(&(before, node));
        }
        if let Some(priority) = wanted {
            self.open.insert((priority, node));
        }
    }
}
