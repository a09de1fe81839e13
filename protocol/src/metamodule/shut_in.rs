//! Whether somebody is shut in: cannot get away from where it stands while nothing else moves.
//!
//! The answer is exact, and takes a search over the floor. The same is asked again and again with a
//! little changed around, so what was learnt from a search is kept: a way out is one wherever none of its
//! cells is taken, and the cells that ended a search without one are a wall wherever all of them are
//! taken. What is kept changes how long an answer takes and nothing else.

use super::field::Middle;
use super::graph::Bits;
use super::params::Floor;
use super::pose::{Pose, to_frame, to_world};
use super::search::{Ground, Left};
use crate::lattice::Cell;
use crate::roombots::grid::GridState;
use std::sync::{Mutex, PoisonError};

/// Whoever can get this far away, in connectors from its middle, is not shut in.
const AWAY: i64 = 5;

/// Whether whoever has come from around this middle to a connector is not shut in any more. Nothing
/// changes for a body that changes from one end to the other.
pub fn is_away(from: Middle, to: (i16, i16)) -> bool {
    let (x, y) = (i64::from(to.0) * 4 - from.0, i64::from(to.1) * 4 - from.1);
    x.abs().max(y.abs()) >= AWAY * 4
}

/// What is kept lies within this distance of the connector that holds the body, along x and y.
const NEAR: i16 = 10;
const SIDE: usize = 2 * NEAR as usize + 1;
/// And below this height.
const HEIGHT: usize = 9;

/// A set of cells around a body, seen from the connector that holds it.
struct Near([u64; (SIDE * SIDE * HEIGHT).div_ceil(64)]);

impl Near {
    /// The number of a cell; none if it is too far away.
    fn number(cell: Cell) -> Option<u16> {
        let along = |c: i16| usize::try_from(c + NEAR).ok().filter(|i| *i < SIDE);
        let up = usize::try_from(cell.z).ok().filter(|i| *i < HEIGHT)?;
        Some(((along(cell.x)? * SIDE + along(cell.y)?) * HEIGHT + up) as u16)
    }
    fn new(state: GridState, cells: &[Cell]) -> Near {
        let mut near = Near([0; _]);
        for i in cells.iter().filter_map(|c| Near::number(to_frame(state, *c))) {
            near.0[usize::from(i) / 64] |= 1 << (i % 64);
        }
        near
    }
    fn has(&self, number: u16) -> bool {
        self.0[usize::from(number) / 64] >> (number % 64) & 1 == 1
    }
}

/// A way out from a posture.
struct WayOut {
    /// The corners of the rectangle around the connectors that it uses.
    feet: ((i16, i16), (i16, i16)),
    cells: Box<[u16]>,
}

/// What ended a search.
struct Wall {
    floor: Floor,
    state: GridState,
    posture: u16,
    cells: Box<[u16]>,
}

/// What was learnt from earlier searches.
pub struct Learnt {
    /// By the posture in which they begin.
    ways: Box<[Mutex<Vec<WayOut>>]>,
    /// By place and posture.
    walls: Box<[Mutex<Vec<Wall>>]>,
}

/// So many ways are kept for each posture.
const WAYS: usize = 64;
/// Walls are kept in so many heaps of so many each.
const WALLS: (usize, usize) = (1 << 12, 8);

impl Learnt {
    /// Nothing yet, about so many postures.
    pub fn new(postures: usize) -> Learnt {
        let none = |count| std::iter::repeat_with(|| Mutex::new(Vec::new())).take(count).collect();
        Learnt { ways: (0..postures).map(|_| Mutex::default()).collect(), walls: none(WALLS.0) }
    }
    fn walls(&self, pose: Pose) -> &Mutex<Vec<Wall>> {
        let numbers = [pose.state.x as u16, pose.state.y as u16, u16::from(pose.state.class), pose.posture];
        let hash = numbers.into_iter().fold(0, |h, n| super::memo::mix(h, u64::from(n)));
        &self.walls[hash as usize % WALLS.0]
    }
}

/// Whether one of these answers the question. It comes first from then on, and what has not been of use
/// for longest comes last.
fn finds<T>(kept: &Mutex<Vec<T>>, answers: impl Fn(&T) -> bool) -> bool {
    let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
    let at = kept.iter().position(answers);
    at.inspect(|at| kept[..=*at].rotate_right(1)).is_some()
}

fn keep<T>(kept: &Mutex<Vec<T>>, new: T, most: usize) {
    let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
    kept.truncate(most - 1);
    kept.insert(0, new);
}

/// Where a search has come to, from which place and by which posture.
struct Step {
    pose: Pose,
    by: Option<(u32, u16)>,
}

impl Ground<'_> {
    /// Whether whoever stands like this cannot get away from there.
    pub fn is_shut_in(&self, pose: Pose) -> bool {
        let near = Near::new(pose.state, self.taken);
        let learnt = self.motions.learnt();
        let Some(ways) = learnt.ways.get(usize::from(pose.posture)) else { return true };
        if finds(ways, |way| self.is_free(way, pose.state, &near)) {
            return false;
        }
        let walls = learnt.walls(pose);
        let is_at = |w: &Wall| (w.posture, w.state, w.floor) == (pose.posture, pose.state, self.floor);
        if finds(walls, |wall| is_at(wall) && wall.cells.iter().all(|c| near.has(*c))) {
            return true;
        }
        match self.look_for_way_out(pose) {
            Ok(strides) => {
                if let Some(way) = self.way_out(pose, &strides) {
                    keep(ways, way, WAYS);
                }
                false
            }
            Err(cells) => {
                let number = |c: &Cell| Near::number(to_frame(pose.state, *c));
                if let Some(cells) = cells.iter().map(number).collect() {
                    let wall = Wall { floor: self.floor, state: pose.state, posture: pose.posture, cells };
                    keep(walls, wall, WALLS.1);
                }
                true
            }
        }
    }

    fn is_free(&self, way: &WayOut, state: GridState, near: &Near) -> bool {
        let corner = |(x, y)| to_world(state, Cell::new(x, y, 0));
        let (a, b) = (corner(way.feet.0), corner(way.feet.1));
        self.floor.has(a.x, a.y) && self.floor.has(b.x, b.y) && !way.cells.iter().any(|c| near.has(*c))
    }

    /// The strides of a way out, as few as possible; or taken cells that leave none.
    fn look_for_way_out(&self, from: Pose) -> Result<Vec<u16>, Vec<Cell>> {
        let graph = self.motions.graph();
        let middle = super::choice::middle(self.motions, from);
        let (mut left, mut steps) = (Left::new(self.floor), vec![Step { pose: from, by: None }]);
        let mut at = 0;
        while let Some(Step { pose, .. }) = steps.get(at) {
            let pose = *pose;
            if !left.has(pose, self.motions.rest_bit(pose.posture)) && left.is_bounded() {
                let lands = self.lands(pose);
                left.add(pose, lands);
                for posture in graph.landings(lands) {
                    let Some(to) = self.landed(pose, posture) else { continue };
                    let by = Some((at as u32, posture));
                    if is_away(middle, to.foot()) {
                        return Ok(strides(&steps, by));
                    }
                    if !left.has(to, self.motions.rest_bit(to.posture)) {
                        steps.push(Step { pose: to, by });
                    }
                }
            }
            at += 1;
        }
        let walls =
            steps.iter().map(|Step { pose, .. }| (*pose, graph.wall(pose.posture, self.taken_at(*pose))));
        let cells = |(pose, wall): (Pose, Bits)| graph.cells(wall).map(move |c| to_world(pose.state, c));
        let mut wall: Vec<Cell> = walls.flat_map(cells).collect();
        wall.sort_unstable();
        wall.dedup();
        Err(wall)
    }

    /// A way of these strides as it is kept; none if it leads too far.
    fn way_out(&self, from: Pose, strides: &[u16]) -> Option<WayOut> {
        let graph = self.motions.graph();
        let (mut at, mut cells) = (from, Vec::new());
        let (mut min, mut max) = ((0, 0), (0, 0));
        for posture in strides {
            let way = graph.way(at.posture, *posture, self.taken_at(at))?;
            for cell in graph.cells(way.swept) {
                cells.push(Near::number(to_frame(from.state, to_world(at.state, cell)))?);
            }
            at = self.landed(at, *posture)?;
            let foot = to_frame(from.state, Cell::new(at.state.x, at.state.y, 0));
            min = (foot.x.min(min.0), foot.y.min(min.1));
            max = (foot.x.max(max.0), foot.y.max(max.1));
        }
        cells.sort_unstable();
        cells.dedup();
        Some(WayOut { feet: (min, max), cells: cells.into() })
    }
}

fn strides(steps: &[Step], last: Option<(u32, u16)>) -> Vec<u16> {
    let before = |by: &(u32, u16)| steps[by.0 as usize].by;
    let mut strides: Vec<u16> = std::iter::successors(last, before).map(|(_, posture)| posture).collect();
    strides.reverse();
    strides
}
