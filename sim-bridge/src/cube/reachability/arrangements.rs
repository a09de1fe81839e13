//! The arrangements of movers that a search examines, on a dense grid.
//!
//! A cell is a number, and a state is the ascending numbers of the cells of the modules that can move. Numbers are in the order
//! of cells, so that two searches examine arrangements in the same order wherever the grid lies. The grid surrounds all modules
//! and goal cells with a margin; a search that comes near its edge is begun again with a wider one.

use super::{PlannedMove, StandstillSnapshot, motions};
use metamorph_kernel::director::proof::{Found, RuleSet};
use metamorph_protocol::lattice::{Cell, Face, Motion};
use rustc_hash::FxHashSet;
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::rc::Rc;

/// The largest number of cells of a grid. Above it, a search is undecided.
const CELLS_MAX: usize = 1 << 22;
/// The width of the margin at first, in cells.
const MARGIN: i32 = 6;
/// The width of the part of the margin that no module may enter, in cells: what is looked at around a module lies on the grid.
const EDGE: i32 = 3;

/// Constant properties of a cell.
#[derive(Clone, Copy, Default)]
struct Is(u16);

impl Is {
    /// It has a live module that does not move.
    const FIXED_LIVE: Is = Is(1);
    const DEAD: Is = Is(1 << 1);
    const GOAL: Is = Is(1 << 2);
    /// A walker was in it at first: it carries no module before it is finalized.
    const WALKER: Is = Is(1 << 3);
    /// The module in it is finalized, or was when it died.
    const FINALIZED: Is = Is(1 << 4);
    /// It is part of the finalized structure: a live module, or a dead one in a goal cell that starts others.
    const ROOT: Is = Is(1 << 5);
    /// The module in it leaves only from the end of a branch.
    const UNATTACHED: Is = Is(1 << 6);
    /// A module that can move was in it at first.
    const MOVER: Is = Is(1 << 7);
    /// No module may enter it: the search needs a wider grid.
    const EDGE: Is = Is(1 << 8);

    const fn or(self, other: Is) -> Is {
        Is(self.0 | other.0)
    }
    /// Returns true if it has one of these properties.
    const fn any(self, of: Is) -> bool {
        self.0 & of.0 != 0
    }
}

/// The number of a cell of a grid.
type At = u32;

/// A box of cells.
#[derive(Clone, Copy)]
struct Grid {
    min: [i32; 3],
    size: [i32; 3],
}

impl Grid {
    /// Returns the box around cells, with a margin; `None` if it is too large.
    fn around(cells: impl Iterator<Item = Cell> + Clone, margin: i32) -> Option<Grid> {
        let along = |pick: fn(&Cell) -> i16| {
            let coordinates = cells.clone().map(|c| i32::from(pick(&c)));
            let (low, high) = (coordinates.clone().min().unwrap_or(0), coordinates.max().unwrap_or(0));
            (low - margin, high - low + 1 + 2 * margin)
        };
        let all = [along(|c| c.x), along(|c| c.y), along(|c| c.z)];
        let cells = all.iter().try_fold(1usize, |product, (_, size)| product.checked_mul(*size as usize));
        cells.filter(|cells| *cells <= CELLS_MAX)?;
        Some(Grid { min: all.map(|(min, _)| min), size: all.map(|(_, size)| size) })
    }
    fn len(self) -> usize {
        self.size.iter().map(|size| *size as usize).product()
    }
    fn number(self, cell: Cell) -> At {
        let [x, y, z] = [
            i32::from(cell.x) - self.min[0],
            i32::from(cell.y) - self.min[1],
            i32::from(cell.z) - self.min[2],
        ];
        ((x * self.size[1] + y) * self.size[2] + z) as At
    }
    fn cell(self, at: At) -> Cell {
        let at = at as i32;
        let (x, y, z) =
            (at / self.size[2] / self.size[1], at / self.size[2] % self.size[1], at % self.size[2]);
        // Invariant: the grid lies around cells, with a margin that is small beside the range of coordinates.
        Cell::new((x + self.min[0]) as i16, (y + self.min[1]) as i16, (z + self.min[2]) as i16)
    }
    /// Returns the difference between the numbers of a cell and its neighbour.
    fn step(self, face: Face) -> i32 {
        let origin = Cell::new(0, 0, 0);
        self.number(origin.step(face)) as i32 - self.number(origin) as i32
    }
    fn is_edge(self, at: At) -> bool {
        let at = at as i32;
        let place = [at / self.size[2] / self.size[1], at / self.size[2] % self.size[1], at % self.size[2]];
        place.iter().zip(self.size).any(|(place, size)| *place < EDGE || *place >= size - EDGE)
    }
}

fn plus(at: At, step: i32) -> At {
    at.wrapping_add_signed(step)
}

/// A motion as differences between numbers of cells.
#[derive(Clone, Copy)]
struct GridMotion {
    motion: Motion,
    support: i32,
    destination: i32,
    landing: i32,
    corner: Option<i32>,
}

/// A set of cells that is emptied at once.
struct Marks {
    of: Vec<u32>,
    present: u32,
}

impl Marks {
    fn new(cells: usize) -> Marks {
        Marks { of: vec![0; cells], present: 1 }
    }
    fn clear(&mut self) {
        self.present += 1;
        if self.present == u32::MAX {
            self.of.fill(0);
            self.present = 1;
        }
    }
    fn has(&self, at: At) -> bool {
        self.of[at as usize] == self.present
    }
    fn insert(&mut self, at: At) -> bool {
        let is_new = !self.has(at);
        self.of[at as usize] = self.present;
        is_new
    }
}

/// The part of a search that changes from one arrangement to the next.
struct Board {
    /// True where a module is that can move.
    taken: Vec<bool>,
    /// The finalized structure, grown over live modules in goal cells.
    grown: Marks,
    marks: Marks,
    front: Vec<At>,
}

/// The constant part of a search.
pub(super) struct StateSpace {
    /// True if goal cells are filled by growth, so that one counts only if it is connected with the finalized
    /// structure, and if modules move only over those that grant it, or stay permanently.
    by_growth: bool,
    /// True if modules without a place in the forest leave only from the end of a branch, and none leaves from under
    /// another.
    is_held: bool,
    spared_by_live: bool,
    /// The number of goal cells that must be filled.
    enough: usize,
    grid: Grid,
    of: Vec<Is>,
    steps: [i32; 6],
    motions: Vec<GridMotion>,
    /// The initial cells of the modules that can move, ascending.
    movers: Rc<[At]>,
    goal: Vec<At>,
    goal_cells: Vec<Cell>,
    roots: Vec<At>,
}

/// A module came too near to the edge of the grid.
struct AtTheEdge;

/// The moves of a plan, as the cells of a module before and after.
type Steps = Vec<(At, At)>;

/// Searches within the rules, arrangements nearest to the goal first. Returns the plan if it finds one.
pub(super) fn search(
    snapshot: &StandstillSnapshot,
    within: RuleSet,
    bound: usize,
) -> (Found, Vec<PlannedMove>) {
    let mut margin = MARGIN;
    while let Some(mut space) = StateSpace::new(snapshot, within, margin) {
        if let Ok((found, steps)) = space.0.search(&mut space.1, bound) {
            let planned = space.0.planned(&mut space.1, &steps);
            return (found, planned);
        }
        margin *= 4;
    }
    (Found::Undecided, Vec::new())
}

impl StateSpace {
    fn new(snapshot: &StandstillSnapshot, within: RuleSet, margin: i32) -> Option<(StateSpace, Board)> {
        let by_growth = matches!(within, RuleSet::Held | RuleSet::Carried);
        let cells = snapshot.modules.iter().map(|m| m.cell).chain(snapshot.goal.iter().copied());
        let grid = Grid::around(cells, margin)?;
        let mut of = vec![Is::default(); grid.len()];
        for cell in &snapshot.goal {
            let goal = &mut of[grid.number(*cell) as usize];
            *goal = goal.or(Is::GOAL);
        }
        let (mut movers, mut roots) = (Vec::new(), Vec::new());
        for m in &snapshot.modules {
            let (at, moves) = (grid.number(m.cell), snapshot.moves(m, within));
            let starts = m.finalized || m.held_for_good;
            let is_root = if m.alive { m.finalized } else { starts && of[at as usize].any(Is::GOAL) };
            let bits = [
                (Is::MOVER, moves),
                (Is::FIXED_LIVE, m.alive && !moves),
                (Is::DEAD, !m.alive),
                (Is::WALKER, m.walker),
                (Is::FINALIZED, m.finalized),
                (Is::ROOT, is_root),
                (Is::UNATTACHED, m.alive && m.unattached),
            ];
            let holding = bits.iter().filter(|(_, holds)| *holds);
            of[at as usize] = holding.fold(of[at as usize], |all, (bit, _)| all.or(*bit));
            movers.extend(moves.then_some(at));
            roots.extend(is_root.then_some(at));
        }
        for at in (0..grid.len() as At).filter(|at| grid.is_edge(*at)) {
            of[at as usize] = of[at as usize].or(Is::EDGE);
        }
        movers.sort_unstable();
        let mut goal: Vec<At> = snapshot.goal.iter().map(|cell| grid.number(*cell)).collect();
        goal.sort_unstable();
        goal.dedup();
        let motions = motions().map(|motion| {
            let (support, heading) = (grid.step(motion.support), grid.step(motion.heading));
            let is_convex = motion.corner(Cell::new(0, 0, 0)).is_some();
            let destination = if is_convex { heading + support } else { heading };
            let landing = destination + grid.step(motion.landing_support());
            GridMotion { motion, support, destination, landing, corner: is_convex.then_some(heading) }
        });
        let mut taken = vec![false; grid.len()];
        movers.iter().for_each(|at| taken[*at as usize] = true);
        let board =
            Board { taken, grown: Marks::new(grid.len()), marks: Marks::new(grid.len()), front: Vec::new() };
        let space = StateSpace {
            by_growth,
            is_held: within == RuleSet::Held,
            spared_by_live: snapshot.spared_by_live && within == RuleSet::Held,
            enough: if by_growth { snapshot.filled + 1 } else { snapshot.goal.len() },
            motions: motions.collect(),
            steps: Face::ALL.map(|face| grid.step(face)),
            movers: movers.into(),
            goal_cells: goal.iter().map(|at| grid.cell(*at)).collect(),
            goal,
            roots,
            of,
            grid,
        };
        Some((space, board))
    }

    /// Searches for an arrangement with enough goal cells filled. Returns the moves to it.
    fn search(&self, board: &mut Board, bound: usize) -> Result<(Found, Steps), AtTheEdge> {
        let start = Rc::clone(&self.movers);
        self.grow(board);
        if self.by_growth && !self.is_enough(board) && self.is_out_of_reach(board, &start) {
            return Ok((Found::Impossible(1), Vec::new()));
        }
        // For each arrangement the one before it, and the move between them.
        let mut origins: Vec<(usize, (At, At))> = vec![(0, (0, 0))];
        let mut seen = FxHashSet::from_iter([Rc::clone(&start)]);
        let mut front = BinaryHeap::from([Reverse((self.distance(board, &start), 0, start, 0))]);
        let mut shown = Rc::clone(&self.movers);
        let (mut next, mut found) = (Vec::new(), Vec::new());
        while let Some(Reverse((_, moves, at, index))) = front.pop() {
            self.show(board, &shown, &at);
            self.grow(board);
            shown = Rc::clone(&at);
            if self.is_enough(board) {
                let mut steps = Vec::with_capacity(moves);
                let mut last = index;
                while last != 0 {
                    let (before, step) = origins[last];
                    steps.push(step);
                    last = before;
                }
                steps.reverse();
                return Ok((Found::Way(moves), steps));
            }
            self.moves(board, &at, &mut found)?;
            for (from, to) in found.iter().copied() {
                if seen.len() >= bound {
                    return Ok((Found::Undecided, Vec::new()));
                }
                moved(&at, from, to, &mut next);
                if !seen.contains(next.as_slice()) {
                    let next: Rc<[At]> = next.as_slice().into();
                    self.set(board, from, to);
                    let distance = self.distance(board, &next);
                    self.set(board, to, from);
                    seen.insert(Rc::clone(&next));
                    front.push(Reverse((distance, moves + 1, next, origins.len())));
                    origins.push((index, (from, to)));
                }
            }
        }
        Ok((Found::Impossible(seen.len()), Vec::new()))
    }

    /// Returns the motions of a plan that was found.
    fn planned(&self, board: &mut Board, steps: &[(At, At)]) -> Vec<PlannedMove> {
        board.taken.fill(false);
        self.movers.iter().for_each(|at| board.taken[*at as usize] = true);
        let mut planned = Vec::with_capacity(steps.len());
        for (from, to) in steps.iter().copied() {
            self.grow(board);
            board.taken[from as usize] = false;
            let possible =
                |m: &&GridMotion| plus(from, m.destination) == to && self.is_possible(board, from, m);
            // A live support keeps the destination free for the mover.
            let is_live = |m: &&GridMotion| self.carries(board, plus(from, m.support));
            let live = self.motions.iter().filter(|m| possible(m) && is_live(m));
            let live = live.min_by_key(|m| m.motion.kind as u8);
            if let Some(m) = live.or_else(|| self.motions.iter().find(possible)) {
                let (support, landing) = (plus(from, m.support), plus(from, m.landing));
                planned.push(PlannedMove {
                    from: self.grid.cell(from),
                    motion: m.motion,
                    lands_on_fixed: self.is(landing, Is::FINALIZED),
                    is_unasked: self.is(support, Is::DEAD) && support != landing,
                });
            }
            board.taken[to as usize] = true;
        }
        planned
    }

    /// Puts the modules that are shown in one arrangement to those of another.
    fn show(&self, board: &mut Board, before: &[At], after: &[At]) {
        before.iter().for_each(|at| board.taken[*at as usize] = false);
        after.iter().for_each(|at| board.taken[*at as usize] = true);
    }
    fn set(&self, board: &mut Board, from: At, to: At) {
        board.taken[from as usize] = false;
        board.taken[to as usize] = true;
    }

    fn is(&self, at: At, any: Is) -> bool {
        self.of[at as usize].any(any)
    }
    fn neighbours(&self, at: At) -> impl Iterator<Item = At> {
        self.steps.map(|step| plus(at, step)).into_iter()
    }
    fn is_live(&self, board: &Board, at: At) -> bool {
        board.taken[at as usize] || self.is(at, Is::FIXED_LIVE)
    }
    fn is_taken(&self, board: &Board, at: At) -> bool {
        board.taken[at as usize] || self.is(at, Is::FIXED_LIVE.or(Is::DEAD))
    }
    /// Returns true if the live module in a cell grants that others move over it: it has not left its initial cell, or is
    /// part of the finalized structure.
    fn carries(&self, board: &Board, at: At) -> bool {
        let stays = self.is(at, Is::FIXED_LIVE) || (board.taken[at as usize] && self.is(at, Is::MOVER));
        (stays && !self.is(at, Is::WALKER)) || (board.grown.has(at) && !self.is(at, Is::DEAD))
    }

    /// Grows the finalized structure over live modules in goal cells.
    fn grow(&self, board: &mut Board) {
        board.grown.clear();
        board.front.clear();
        for root in self.roots.iter().filter(|root| board.grown.insert(**root)) {
            board.front.push(*root);
        }
        while let Some(at) = board.front.pop() {
            for next in self.neighbours(at) {
                if self.is(next, Is::GOAL) && self.is_live(board, next) && board.grown.insert(next) {
                    board.front.push(next);
                }
            }
        }
    }

    /// Returns true if enough goal cells are filled. Where goal cells are filled by growth, a cell counts only if it is
    /// part of the structure grown from the finalized one, or has a dead module in it.
    fn is_enough(&self, board: &Board) -> bool {
        let is_filled = |at: &&At| match self.by_growth {
            true => self.is(**at, Is::DEAD) || board.grown.has(**at),
            false => self.is_taken(board, **at),
        };
        self.goal.iter().filter(is_filled).count() >= self.enough
    }

    /// Returns true if no module comes to a goal cell that could be filled next, even if all others made way
    /// and carried at the same time. This detects most walled-in cells at once.
    fn is_out_of_reach(&self, board: &mut Board, start: &[At]) -> bool {
        let is_wall = |at: At| self.is(at, Is::FIXED_LIVE.or(Is::DEAD));
        let mut reached = std::mem::replace(&mut board.marks, Marks::new(0));
        let mut front = std::mem::take(&mut board.front);
        reached.clear();
        front.clear();
        front.extend(start.iter().copied().filter(|at| reached.insert(*at)));
        let carries = |at: At| self.carries(board, at) || self.is(at, Is::DEAD.or(Is::GOAL));
        while let Some(from) = front.pop() {
            for m in self.motions.iter().filter(|m| carries(plus(from, m.support))) {
                let to = plus(from, m.destination);
                let is_free = !is_wall(to) && m.corner.is_none_or(|corner| !is_wall(plus(from, corner)));
                if is_free && carries(plus(from, m.landing)) && reached.insert(to) {
                    front.push(to);
                }
            }
        }
        let is_next = |at: &&At| {
            !self.is_taken(board, **at)
                && reached.has(**at)
                && self.neighbours(**at).any(|n| board.grown.has(n))
        };
        let is_reached = self.goal.iter().any(|at| is_next(&at));
        (board.marks, board.front) = (reached, front);
        !is_reached
    }

    /// Returns a heuristic: for each unfilled goal cell 4 plus the distance of the nearest module outside of the goal,
    /// or plus 100 if there is none.
    fn distance(&self, board: &Board, at: &[At]) -> u32 {
        let mut free =
            self.goal.iter().zip(&self.goal_cells).filter(|(g, _)| !self.is_taken(board, **g)).peekable();
        if free.peek().is_none() {
            return 0;
        }
        let spare: Vec<Cell> =
            at.iter().filter(|at| !self.is(**at, Is::GOAL)).map(|at| self.grid.cell(*at)).collect();
        free.map(|(_, goal)| 4 + spare.iter().map(|c| c.manhattan(*goal)).min().unwrap_or(100)).sum()
    }

    /// Finds every move that is possible in the arrangement that the board shows: by the mover, then by its destination.
    fn moves(&self, board: &mut Board, at: &[At], found: &mut Vec<(At, At)>) -> Result<(), AtTheEdge> {
        found.clear();
        for from in at.iter().copied() {
            board.taken[from as usize] = false;
            let first = found.len();
            for m in &self.motions {
                if self.is_possible(board, from, m) {
                    found.push((from, plus(from, m.destination)));
                }
            }
            if found.len() > first {
                let is_edge = found[first..].iter().any(|(_, to)| self.is(*to, Is::EDGE));
                if !self.holds_without(board, from) {
                    found.truncate(first);
                } else if is_edge {
                    board.taken[from as usize] = true;
                    return Err(AtTheEdge);
                } else {
                    found[first..].sort_unstable();
                    found.dedup();
                }
            }
            board.taken[from as usize] = true;
        }
        Ok(())
    }

    fn is_possible(&self, board: &Board, from: At, m: &GridMotion) -> bool {
        let (support, landing, to) =
            (plus(from, m.support), plus(from, m.landing), plus(from, m.destination));
        let carries = if self.by_growth {
            let carries = |at| self.is(at, Is::DEAD) || self.carries(board, at);
            carries(support) && carries(landing)
        } else {
            self.is_taken(board, support) && self.is_taken(board, landing)
        };
        carries
            && !self.is_taken(board, to)
            && m.corner.is_none_or(|corner| !self.is_taken(board, plus(from, corner)))
    }

    /// Returns true if the neighbours of a cell are connected without the module that leaves it, which the board does not show.
    fn holds_without(&self, board: &mut Board, from: At) -> bool {
        let mut beside = [0; 6];
        let mut touched = 0;
        for at in self.neighbours(from) {
            if self.is_taken(board, at) {
                beside[touched] = at;
                touched += 1;
            }
        }
        if self.is_held && self.is(from, Is::UNATTACHED) && touched > 1 {
            return false;
        }
        // A module that has set out may rest on this one.
        let rests_here = |at: At| board.taken[at as usize] && !self.is(at, Is::MOVER) && !board.grown.has(at);
        let is_first_move = self.is(from, Is::MOVER) && !self.is(from, Is::WALKER);
        if self.is_held && is_first_move && self.neighbours(from).any(rests_here) {
            return false;
        }
        self.are_together(board, &beside[..touched]) && (!self.spared_by_live || self.is_cycled(board, from))
    }

    /// Returns true if these cells are connected with each other through bodies. It stops when they have met.
    fn are_together(&self, board: &mut Board, cells: &[At]) -> bool {
        let mut missing = cells.len().saturating_sub(1);
        if missing == 0 {
            return true;
        }
        board.marks.clear();
        board.front.clear();
        board.marks.insert(cells[0]);
        board.front.push(cells[0]);
        // In the order in which they are found: cells that are near each other meet soon.
        let mut first = 0;
        while let Some(at) = board.front.get(first).copied() {
            first += 1;
            for next in self.neighbours(at) {
                if self.is_taken(board, next) && board.marks.insert(next) {
                    missing -= usize::from(cells.contains(&next));
                    if missing == 0 {
                        return true;
                    }
                    board.front.push(next);
                }
            }
        }
        false
    }

    /// Returns true if cycles of live modules around a cell connect its neighbours, without the module in it. The finalized
    /// structure counts as one module, with the dead that belong to it or touch it. Any other dead one counts as connected
    /// with a live module that touches it.
    fn is_cycled(&self, board: &mut Board, from: At) -> bool {
        let mut reached = std::mem::replace(&mut board.marks, Marks::new(0));
        let is_cycled = self.is_cycled_with(board, &mut reached, from);
        board.marks = reached;
        is_cycled
    }

    fn is_cycled_with(&self, board: &Board, reached: &mut Marks, from: At) -> bool {
        let is_live = |at: At| at != from && self.carries(board, at);
        let is_grown = |at: At| is_live(at) && board.grown.has(at);
        let is_root = |at: At| self.is(at, Is::FINALIZED) || self.neighbours(at).any(is_grown);
        let live: Vec<At> = self.neighbours(from).filter(|at| is_live(*at)).collect();
        let (rooted, dead): (Vec<At>, Vec<At>) =
            self.neighbours(from).filter(|at| self.is(*at, Is::DEAD)).partition(|at| is_root(*at));
        let is_rooted = !rooted.is_empty() || live.iter().any(|at| self.is(*at, Is::FINALIZED));
        let mut all = Vec::new();
        reached.clear();
        self.spread(live.first().copied(), reached, &mut all, &is_live);
        let is_dead_root = |at: At| self.is(at, Is::DEAD) && is_root(at);
        let touches_root = |at: &At| board.grown.has(*at) || self.neighbours(*at).any(is_dead_root);
        if is_rooted && all.iter().any(touches_root) {
            let grown = self.grown_cells(board);
            self.spread(grown.into_iter().filter(|at| is_live(*at)), reached, &mut all, &is_live);
        } else if is_rooted && !live.is_empty() {
            return false;
        }
        if live.is_empty() {
            return dead.len() + usize::from(is_rooted) < 2;
        }
        let is_held = |at: &At| self.neighbours(*at).any(|n| reached.has(n));
        live.iter().all(|at| reached.has(*at)) && dead.iter().all(is_held)
    }

    /// Returns the cells of the finalized structure.
    fn grown_cells(&self, board: &Board) -> Vec<At> {
        let of_goal = self.goal.iter().copied().filter(|at| board.grown.has(*at));
        self.roots.iter().copied().chain(of_goal).collect()
    }

    /// Adds cells to a set, and all that are connected with them through cells that `counts` accepts.
    fn spread(
        &self,
        from: impl IntoIterator<Item = At>,
        reached: &mut Marks,
        all: &mut Vec<At>,
        counts: &dyn Fn(At) -> bool,
    ) {
        let mut next = all.len();
        all.extend(from.into_iter().filter(|at| reached.insert(*at)));
        while let Some(at) = all.get(next).copied() {
            next += 1;
            for neighbour in self.neighbours(at) {
                if counts(neighbour) && reached.insert(neighbour) {
                    all.push(neighbour);
                }
            }
        }
    }
}

/// Writes the arrangement after a move.
fn moved(at: &[At], from: At, to: At, next: &mut Vec<At>) {
    next.clear();
    next.extend(at.iter().copied().filter(|cell| *cell != from));
    let place = next.partition_point(|cell| *cell < to);
    next.insert(place, to);
}
