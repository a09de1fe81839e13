//! The least time in which a body of cubes gets from one set of cells to another, as far as geometry alone says:
//! the bottleneck of the best assignment of start cells to goal cells, which is the smallest number of moves with which
//! every goal cell is reached by a cube of its own. A cube moves once in a move time, so no protocol is faster.
//!
//! Distances are those of `matching`, and as there supports, collisions and connectivity are ignored. The number of moves
//! is raised until augmenting paths (Kuhn) assign all goal cells; assignments with fewer moves are kept.

use super::matching::distance;
use metamorph_protocol::lattice::Cell;
use std::collections::VecDeque;

/// Returns the least number of move times from `start` to `goal`, or `None` if there are fewer cells in `start`.
pub fn least_move_times(start: &[Cell], goal: &[Cell]) -> Option<u64> {
    if start.len() < goal.len() {
        return None;
    }
    let nearest = |to: &Cell| start.iter().map(|from| distance(*from, *to)).min();
    let mut moves = goal.iter().filter_map(nearest).max()?;
    let mut assignment =
        Assignment { start, goal, cube_of: vec![None; goal.len()], goal_of: vec![None; start.len()] };
    while !assignment.complete(moves) {
        moves += 1;
    }
    Some(moves)
}

struct Assignment<'a> {
    start: &'a [Cell],
    goal: &'a [Cell],
    cube_of: Vec<Option<usize>>,
    goal_of: Vec<Option<usize>>,
}

impl Assignment<'_> {
    /// Assigns cubes of at most so many moves to goal cells while it can. Returns true if no goal cell is left.
    fn complete(&mut self, moves: u64) -> bool {
        loop {
            let open: Vec<usize> = (0..self.goal.len()).filter(|g| self.cube_of[*g].is_none()).collect();
            if open.is_empty() {
                return true;
            }
            // A cube from which a search has gone on leads later searches of the same round nowhere new.
            let mut unseen: Vec<usize> = (0..self.start.len()).collect();
            let assigned = open.into_iter().filter(|goal| self.augment(*goal, moves, &mut unseen)).count();
            if assigned == 0 {
                return false;
            }
        }
    }

    /// Searches breadth first for a path from a goal cell to a cube without one, and assigns along it.
    fn augment(&mut self, root: usize, moves: u64, unseen: &mut Vec<usize>) -> bool {
        let mut queue = VecDeque::from([root]);
        let mut seen_from = vec![usize::MAX; self.start.len()];
        while let Some(goal) = queue.pop_front() {
            let mut i = 0;
            while let Some(&cube) = unseen.get(i) {
                if distance(self.start[cube], self.goal[goal]) > moves {
                    i += 1;
                    continue;
                }
                unseen.swap_remove(i);
                seen_from[cube] = goal;
                let Some(other) = self.goal_of[cube] else {
                    self.assign(cube, &seen_from);
                    return true;
                };
                queue.push_back(other);
            }
        }
        false
    }

    /// Gives a cube to the goal cell that found it, the cube of that one to the goal cell before, and so on.
    fn assign(&mut self, cube: usize, seen_from: &[usize]) {
        let mut next = Some(cube);
        while let Some(cube) = next {
            let goal = seen_from[cube];
            self.goal_of[cube] = Some(goal);
            next = self.cube_of[goal].replace(cube);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::rng::Rng;
    use std::collections::BTreeSet;

    /// Tries every assignment.
    fn tried(start: &[Cell], goal: &[Cell]) -> u64 {
        let Some((first, others)) = goal.split_first() else { return 0 };
        (0..start.len())
            .map(|i| {
                let mut rest = start.to_vec();
                distance(rest.remove(i), *first).max(tried(&rest, others))
            })
            .min()
            .unwrap()
    }

    #[test]
    fn it_is_the_bottleneck_of_the_best_assignment() {
        for seed in 0..200 {
            let mut stream = Rng::named(seed, "bottleneck", 0);
            let mut some = |n: u64| -> Vec<Cell> {
                let mut cells = BTreeSet::new();
                while (cells.len() as u64) < n {
                    let [x, y, z] = [6, 4, 3].map(|s| stream.below(s) as i16);
                    cells.insert(Cell::new(x, y, z));
                }
                cells.into_iter().collect()
            };
            let (start, goal) = (some(1 + seed % 6), some(1 + seed % 5));
            let expected = (goal.len() <= start.len()).then(|| tried(&start, &goal));
            assert_eq!(least_move_times(&start, &goal), expected, "seed {seed}");
        }
    }

    #[test]
    fn a_row_that_moves_on_by_one_takes_one_move_time() {
        let row: Vec<Cell> = (0..5).map(|x| Cell::new(x, 0, 0)).collect();
        assert_eq!(least_move_times(&row[..4], &row[1..]), Some(1));
        assert_eq!(least_move_times(&row, &row), Some(0));
    }
}
