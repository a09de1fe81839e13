//! Sequential plans: one spare module after the other goes to an unfilled goal cell while all others stay, the cell nearest to
//! the seed first. If none comes to such a cell because others enclose it, a neighbour makes a step into it, so that the empty
//! cell moves outwards.
//!
//! The time for a plan grows with the surface of the swarm and not with the number of arrangements, so plans are found for large
//! swarms too. But a plan may leave cells unfilled although they could be filled in another order.

use crate::cube::reachability::{PlannedMove, StandstillSnapshot, are_together, motions};
use metamorph_kernel::world::grid::{Grid, Occupant};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::{Cell, Face, Motion, MotionKind};
use std::collections::{BTreeMap, BTreeSet, VecDeque};

/// The largest number of spare modules whose ways are looked for before an enclosed cell is moved.
const CANDIDATES: usize = 16;

/// Returns a plan that fills goal cells, and true if it fills them all.
pub(super) fn plan_one_by_one(snapshot: &StandstillSnapshot) -> (Vec<PlannedMove>, bool) {
    let mut plan = SequentialPlan::new(snapshot);
    let mut is_over = plan.holes().is_empty();
    while !is_over && plan.goes_on() {
        is_over = plan.holes().is_empty();
    }
    (plan.moves, is_over)
}

/// The cells that a module comes to, each with the cell before and the motion from there.
type Ways = BTreeMap<Cell, (Cell, Motion)>;

/// A plan that is being made, and where the modules are after it.
struct SequentialPlan<'a> {
    snapshot: &'a StandstillSnapshot,
    cells: Vec<Cell>,
    grid: Grid,
    /// The goal cells, each with its distance from the seed within the goal.
    goal: BTreeMap<Cell, usize>,
    moves: Vec<PlannedMove>,
}

impl SequentialPlan<'_> {
    fn new(snapshot: &StandstillSnapshot) -> SequentialPlan<'_> {
        let mut grid = Grid::default();
        for (id, module) in (0u32..).zip(&snapshot.modules) {
            grid.set(module.cell, Some(Occupant::Body(ModuleId(id))));
        }
        let in_goal: BTreeSet<Cell> = snapshot.goal.iter().copied().collect();
        let goal = distances([snapshot.seed], |cell| in_goal.contains(&cell));
        let cells = snapshot.modules.iter().map(|m| m.cell).collect();
        SequentialPlan { snapshot, cells, grid, goal, moves: Vec::new() }
    }

    fn is_taken(&self, cell: Cell) -> bool {
        self.grid.body(cell).is_some()
    }
    /// Returns the goal cells without a module.
    fn holes(&self) -> Vec<Cell> {
        self.goal.keys().copied().filter(|cell| !self.is_taken(*cell)).collect()
    }
    fn may_move(&self, module: usize) -> bool {
        self.snapshot.modules[module].alive && !self.snapshot.modules[module].stuck
    }
    /// Returns true if the body stays connected without the module in a cell.
    fn is_removable(&self, cell: Cell) -> bool {
        let stays = |c: &Cell| *c != cell && self.is_taken(*c);
        let beside: Vec<Cell> = cell.neighbours().into_iter().filter(stays).collect();
        are_together(&beside, &stays)
    }
    fn is_possible(&self, from: Cell, at: Cell, motion: Motion) -> bool {
        let is_free = |cell: Cell| cell == from || !self.is_taken(cell);
        let (support, to) = (at.step(motion.support), motion.destination(at));
        let landing = to.step(motion.landing_support());
        !is_free(support) && !is_free(landing) && is_free(to) && motion.corner(at).is_none_or(is_free)
    }

    /// Makes one more goal cell filled, or moves an enclosed one outwards. Returns false if neither can be done.
    fn goes_on(&mut self) -> bool {
        let holes = self.holes();
        let distance = |cell: Cell| holes.iter().map(|hole| hole.manhattan(cell)).min();
        let is_spare = |i: &usize| self.may_move(*i) && !self.goal.contains_key(&self.cells[*i]);
        let mut spare: Vec<usize> = (0..self.cells.len()).filter(is_spare).collect();
        spare.sort_by_key(|i| (distance(self.cells[*i]), *i));
        let mut outside: BTreeSet<Cell> = BTreeSet::new();
        let candidates = spare.into_iter().filter(|i| self.is_removable(self.cells[*i]));
        for i in candidates.take(CANDIDATES).collect::<Vec<usize>>() {
            let ways = self.ways(self.cells[i]);
            let reached = holes.iter().copied().filter(|hole| ways.contains_key(hole));
            if let Some(hole) = reached.min_by_key(|hole| (self.goal[hole], *hole)) {
                self.go(i, hole, &ways);
                return true;
            }
            outside.extend(ways.into_keys());
        }
        self.move_outwards(&holes, outside)
    }

    /// Returns all cells that the module in a cell comes to while all others stay.
    fn ways(&self, from: Cell) -> Ways {
        let mut ways = Ways::new();
        let mut front = VecDeque::from([from]);
        while let Some(at) = front.pop_front() {
            for motion in motions().filter(|m| self.is_possible(from, at, *m)) {
                let to = motion.destination(at);
                if to != from && !ways.contains_key(&to) {
                    ways.insert(to, (at, motion));
                    front.push_back(to);
                }
            }
        }
        ways
    }

    /// Moves a module along its way to a cell.
    fn go(&mut self, module: usize, to: Cell, ways: &Ways) {
        let (from, first) = (self.cells[module], self.moves.len());
        let mut at = to;
        while at != from
            && let Some((before, motion)) = ways.get(&at).copied()
        {
            self.moves.push(PlannedMove { from: before, motion, lands_on_fixed: false, is_unasked: false });
            at = before;
        }
        self.moves[first..].reverse();
        self.grid.set(from, None);
        self.grid.set(to, Some(Occupant::Body(ModuleId(module as u32))));
        self.cells[module] = to;
    }

    /// Slides a module of the goal into an enclosed cell beside it that is farther from the outside.
    fn move_outwards(&mut self, holes: &[Cell], outside: BTreeSet<Cell>) -> bool {
        let depths = distances(outside, |cell| self.goal.contains_key(&cell));
        let depth = |cell: &Cell| depths.get(cell).copied();
        for hole in holes {
            let Some(deep) = depth(hole) else { continue };
            for face in Face::ALL {
                let from = hole.step(face);
                let Some(module) = self.grid.body(from).map(|id| id.index()) else { continue };
                let slides = |m: &Motion| m.kind == MotionKind::Slide && m.destination(from) == *hole;
                let possible = |m: &Motion| slides(m) && self.is_possible(from, from, *m);
                if self.may_move(module)
                    && depth(&from).is_some_and(|d| d < deep)
                    && self.is_removable(from)
                    && let Some(motion) = motions().find(possible)
                {
                    self.go(module, *hole, &Ways::from([(*hole, (from, motion))]));
                    return true;
                }
            }
        }
        false
    }
}

/// Returns the cells that are connected with `from` through cells that `counts` accepts, with their distances from there.
fn distances(from: impl IntoIterator<Item = Cell>, counts: impl Fn(Cell) -> bool) -> BTreeMap<Cell, usize> {
    let mut found: BTreeMap<Cell, usize> = from.into_iter().map(|cell| (cell, 0)).collect();
    let mut front: VecDeque<(Cell, usize)> = found.iter().map(|(cell, d)| (*cell, *d)).collect();
    while let Some((at, d)) = front.pop_front() {
        for next in at.neighbours() {
            if counts(next) && !found.contains_key(&next) {
                found.insert(next, d + 1);
                front.push_back((next, d + 1));
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cube::reachability::ModuleSnapshot;

    fn module(cell: Cell, alive: bool) -> ModuleSnapshot {
        ModuleSnapshot { cell, alive, ..ModuleSnapshot::LIVE }
    }
    fn snapshot(modules: Vec<ModuleSnapshot>, goal: Vec<Cell>, seed: Cell) -> StandstillSnapshot {
        StandstillSnapshot { modules, goal, seed, filled: 0, spared_by_live: false }
    }

    /// Carries out a plan: each move is possible, and leaves a connected body. Returns the cells afterwards.
    fn carry_out(snapshot: &StandstillSnapshot, moves: &[PlannedMove]) -> BTreeSet<Cell> {
        let mut plan = SequentialPlan::new(snapshot);
        for PlannedMove { from, motion, .. } in moves {
            let id = plan.grid.body(*from).unwrap();
            assert!(plan.is_possible(*from, *from, *motion) && plan.is_removable(*from), "{from} {motion:?}");
            plan.go(
                id.index(),
                motion.destination(*from),
                &Ways::from([(motion.destination(*from), (*from, *motion))]),
            );
        }
        plan.cells.into_iter().collect()
    }

    /// A row becomes a tower, over a dead module too.
    #[test]
    fn a_row_becomes_a_tower() {
        let row = (0..6).map(|x| module(Cell::new(x, 0, 0), x != 2)).collect();
        let tower: Vec<Cell> = (0..4).map(|z| Cell::new(0, 0, z)).collect();
        let snapshot = snapshot(row, tower.clone(), tower[0]);
        let (moves, is_whole) = plan_one_by_one(&snapshot);
        let cells = carry_out(&snapshot, &moves);
        assert!(is_whole && tower.iter().all(|c| cells.contains(c)), "{cells:?}");
        assert!(cells.contains(&Cell::new(2, 0, 0)), "the dead module stays");
    }

    /// An enclosed empty cell moves outwards, until a spare module fills it.
    #[test]
    fn an_enclosed_cell_is_filled() {
        let along = || -2..=2;
        let goal: Vec<Cell> = along()
            .flat_map(|x| along().flat_map(move |y| along().map(move |z| Cell::new(x, y, z))))
            .collect();
        let walls = goal.iter().filter(|cell| **cell != Cell::default());
        let modules = walls.copied().chain([Cell::new(3, 0, 0)]).map(|cell| module(cell, true)).collect();
        let snapshot = snapshot(modules, goal.clone(), goal[0]);
        let (moves, is_whole) = plan_one_by_one(&snapshot);
        assert!(is_whole && moves.len() >= 3, "{moves:?}");
        let cells = carry_out(&snapshot, &moves);
        assert!(goal.iter().all(|c| cells.contains(c)));
    }

    /// Cells that cannot be filled are left, and modules that hold the body together stay.
    #[test]
    fn a_plan_fills_what_it_can() {
        let row: Vec<ModuleSnapshot> =
            [(0, true), (1, true), (2, false)].map(|(x, a)| module(Cell::new(x, 0, 0), a)).into();
        let snapshot = snapshot(row, vec![Cell::new(0, 0, 0), Cell::new(0, 0, 1)], Cell::new(0, 0, 0));
        assert_eq!(plan_one_by_one(&snapshot), (Vec::new(), false));
    }
}
