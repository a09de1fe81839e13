//! The least number of moves that takes a body of cubes from one set of cells to another, as far as geometry
//! alone says: a minimum-cost assignment of start cells to goal cells.
//!
//! A slide changes one coordinate by one, a convex move two; so a cube displaced by `(x, y, z)` cells needs
//! at least `max(x, y, z, ⌈(x + y + z) / 2⌉)` moves, which is its distance in the lattice with 18 neighbours.
//! Each goal cell is filled by a different cube, so the sum over the best assignment is a lower bound for
//! every protocol. Supports, collisions and connectivity are ignored, so it need not be reachable.
//!
//! The assignment is exact. The distance is a shortest path in a lattice, so the assignment is a minimum-cost
//! flow from start cells to goal cells along lattice steps: successive shortest paths with potentials, all
//! paths of one length at a time. The Hungarian algorithm gives the same (see the test) in cubic time: 7 s
//! instead of 0.3 s for 2,500 cubes.

use metamorph_protocol::lattice::Cell;
use std::collections::BTreeSet;

/// Returns the least number of moves of a cube from one cell to another.
pub fn distance(a: Cell, b: Cell) -> u64 {
    let away = [a.x.abs_diff(b.x), a.y.abs_diff(b.y), a.z.abs_diff(b.z)].map(u64::from);
    away.into_iter().fold(0, u64::max).max(away.iter().sum::<u64>().div_ceil(2))
}

/// Returns the steps of a lattice with 18 neighbours; a step and its opposite are at `i` and `17 - i`.
fn steps() -> Vec<[i32; 3]> {
    let all = (-1..=1).flat_map(|x| (-1..=1).flat_map(move |y| (-1..=1).map(move |z| [x, y, z])));
    all.filter(|s: &[i32; 3]| matches!(s.iter().map(|c| c.abs()).sum::<i32>(), 1 | 2)).collect()
}

/// Returns the least number of moves from `start` to `goal`, or `None` if there are fewer cells in `start`.
pub fn least_moves(start: &[Cell], goal: &[Cell]) -> Option<u64> {
    let start: BTreeSet<Cell> = start.iter().copied().collect();
    let goal: BTreeSet<Cell> = goal.iter().copied().collect();
    // A cube on a goal cell stays there in some best assignment, because distances are a metric.
    let from: Vec<Cell> = start.difference(&goal).copied().collect();
    let to: Vec<Cell> = goal.difference(&start).copied().collect();
    if from.len() < to.len() {
        return None;
    }
    let mut flow = Flow::new(&from, &to);
    let mut moves = 0;
    for _ in 0..to.len() {
        // Invariant: the lattice is connected and there are enough cubes, so every goal cell has a path.
        let length = flow.shorten()?;
        let paths = flow.augment();
        moves += paths * length;
        flow.left -= paths;
        if flow.left == 0 {
            break;
        }
    }
    Some(moves)
}

/// A flow from cubes to goal cells over the box around both, with a margin of one cell.
struct Flow {
    /// The index offset of each step.
    steps: Vec<isize>,
    /// For each cell and step, the cubes that take it.
    along: Vec<u16>,
    /// Cells whose cube has not been assigned.
    free: Vec<bool>,
    /// Goal cells without an assigned cube, and their number.
    wanted: Vec<bool>,
    left: u64,
    /// All start cells.
    sources: Vec<usize>,
    /// Distances from the cubes, as of the latest search. With them, no residual arc has a negative cost.
    potential: Vec<i32>,
    /// Scratch memory of a search.
    distance: Vec<i32>,
    /// Cells around the box, where no path leads.
    is_margin: Vec<bool>,
}

impl Flow {
    fn new(from: &[Cell], to: &[Cell]) -> Flow {
        let all = || from.iter().chain(to).map(|c| [c.x, c.y, c.z].map(i32::from));
        let fold = |f: fn(i32, i32) -> i32| {
            all().reduce(|a, b| [0, 1, 2].map(|i| f(a[i], b[i]))).unwrap_or_default()
        };
        let (low, high) = (fold(i32::min), fold(i32::max));
        let sides = [0, 1, 2].map(|i| high[i] - low[i] + 3);
        let index = |at: [i32; 3]| ((at[2] * sides[1] + at[1]) * sides[0] + at[0]) as usize;
        let place = |c: &Cell| index([0, 1, 2].map(|i| i32::from([c.x, c.y, c.z][i]) - low[i] + 1));
        let cells = sides.iter().product::<i32>() as usize;
        let mut flow = Flow {
            steps: steps()
                .into_iter()
                .map(|[x, y, z]| ((z * sides[1] + y) * sides[0] + x) as isize)
                .collect(),
            along: vec![0; cells * 18],
            free: vec![false; cells],
            wanted: vec![false; cells],
            left: to.len() as u64,
            sources: from.iter().map(place).collect(),
            potential: vec![0; cells],
            distance: vec![0; cells],
            is_margin: vec![true; cells],
        };
        for (z, y) in (1..sides[2] - 1).flat_map(|z| (1..sides[1] - 1).map(move |y| (z, y))) {
            let row = index([1, y, z]);
            flow.is_margin[row..row + sides[0] as usize - 2].fill(false);
        }
        from.iter().for_each(|c| flow.free[place(c)] = true);
        to.iter().for_each(|c| flow.wanted[place(c)] = true);
        flow
    }

    /// Returns the cell that a step leads to and the reduced cost of the step, or `None` if that cell is in
    /// the margin. A step that cancels the opposite one of a cube costs -1 instead of 1.
    fn arc(&self, at: usize, step: usize) -> Option<(usize, i32)> {
        let to = at.wrapping_add_signed(self.steps[step]);
        if self.is_margin[to] {
            return None;
        }
        let cost = if self.along[to * 18 + 17 - step] > 0 { -1 } else { 1 };
        Some((to, cost + self.potential[at] - self.potential[to]))
    }

    /// Finds the shortest path to a goal cell, updates the potentials so that its steps have no cost, and
    /// returns its length.
    fn shorten(&mut self) -> Option<u64> {
        self.distance.fill(i32::MAX);
        let mut buckets: Vec<Vec<usize>> = vec![Vec::new()];
        // The common root of all unassigned cubes has potential 0 and arcs of cost 0 to them.
        for &source in &self.sources {
            let d = -self.potential[source];
            if self.free[source] && d < self.distance[source] {
                self.distance[source] = d;
                push(&mut buckets, d, source);
            }
        }
        let (mut at, mut found) = (0, None);
        while at < buckets.len() && found.is_none_or(|(d, _)| at as i32 <= d) {
            while let Some(cell) = buckets[at].pop() {
                if self.distance[cell] != at as i32 {
                    continue;
                }
                if self.wanted[cell] && found.is_none() {
                    found = Some((at as i32, cell));
                }
                for step in 0..18 {
                    let Some((to, cost)) = self.arc(cell, step) else { continue };
                    let d = at as i32 + cost;
                    if d < self.distance[to] {
                        self.distance[to] = d;
                        push(&mut buckets, d, to);
                    }
                }
            }
            at += 1;
        }
        let (most, goal) = found?;
        for (potential, distance) in self.potential.iter_mut().zip(&self.distance) {
            *potential += (*distance).min(most);
        }
        u64::try_from(self.potential[goal]).ok()
    }

    /// Augments along paths without cost while there are any, and returns their number.
    fn augment(&mut self) -> u64 {
        let mut next = vec![0u8; self.free.len()];
        let mut paths = 0;
        for i in 0..self.sources.len() {
            let source = self.sources[i];
            if self.free[source] && self.potential[source] == 0 && self.set_out(source, &mut next) {
                paths += 1;
            }
        }
        paths
    }

    /// Searches depth first, along steps without reduced cost, for a path from a cube to a goal cell, and
    /// augments the flow along it. `next` is the first untried step of each cell.
    fn set_out(&mut self, source: usize, next: &mut [u8]) -> bool {
        let mut path: Vec<(usize, usize)> = Vec::new();
        let mut at = source;
        loop {
            if self.wanted[at] {
                break;
            }
            let step = usize::from(next[at]);
            if step == 18 {
                let Some((before, _)) = path.pop() else { return false };
                at = before;
                continue;
            }
            next[at] += 1;
            if let Some((to, 0)) = self.arc(at, step)
                && next[to] == 0
            {
                path.push((at, step));
                at = to;
            }
        }
        (self.free[source], self.wanted[at]) = (false, false);
        for (cell, step) in path {
            let to = cell.wrapping_add_signed(self.steps[step]);
            let back = &mut self.along[to * 18 + 17 - step];
            if *back > 0 {
                *back -= 1;
            } else {
                self.along[cell * 18 + step] += 1;
            }
            // The remaining steps may serve another path.
            next[cell] = 0;
        }
        true
    }
}

fn push(buckets: &mut Vec<Vec<usize>>, distance: i32, cell: usize) {
    let at = usize::try_from(distance).unwrap_or(0);
    if buckets.len() <= at {
        buckets.resize_with(at + 1, Vec::new);
    }
    buckets[at].push(cell);
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::rng::Rng;
    use pathfinding::kuhn_munkres::kuhn_munkres_min;
    use pathfinding::matrix::Matrix;

    /// The result equals that of the Hungarian algorithm, which is exact and knows nothing of lattices.
    #[test]
    fn it_is_the_cost_of_the_best_assignment() {
        for seed in 0..300 {
            let mut stream = Rng::named(seed, "matching", 0);
            let mut some = |n: u64, side: u64| -> Vec<Cell> {
                let mut cells = BTreeSet::new();
                while (cells.len() as u64) < n {
                    let [x, y, z] = [side, side, 4].map(|s| stream.below(s) as i16);
                    cells.insert(Cell::new(x, y, z));
                }
                cells.into_iter().collect()
            };
            let cubes = 1 + seed % 30;
            let (start, goal) = (some(cubes, 9), some(1 + seed % 7 * cubes / 8, 6));
            let costs = Matrix::from_fn(goal.len(), start.len(), |(g, s)| distance(goal[g], start[s]) as i64);
            assert_eq!(least_moves(&start, &goal), Some(kuhn_munkres_min(&costs).0 as u64), "seed {seed}");
            if goal.len() > 1 {
                assert_eq!(least_moves(&goal[1..], &goal), None);
            }
        }
    }

    #[test]
    fn a_convex_move_counts_once_and_what_is_there_stays() {
        let cell = |x, y, z| Cell::new(x, y, z);
        assert_eq!(least_moves(&[cell(0, 0, 0)], &[cell(1, 0, 1)]), Some(1));
        assert_eq!(least_moves(&[cell(0, 0, 0)], &[cell(1, 1, 1)]), Some(2));
        let row: Vec<Cell> = (0..5).map(|x| cell(x, 0, 0)).collect();
        assert_eq!(least_moves(&row, &row), Some(0));
        assert_eq!(least_moves(&row[..4], &row[1..]), Some(4));
    }
}
