//! Decides whether a body is enclosed: it cannot get away from where it stands while nothing else moves.
//!
//! The answer is exact and takes a search over the floor. Questions recur with few cells changed, so results
//! of earlier searches are cached: a route out stays valid where none of its cells is taken, and the cells
//! that stopped a search form a wall where all of them are taken. The cache affects the time an answer takes,
//! never the answer.

use super::graph::{RADIUS, ones};
use crate::metamodule::blueprint::Floor;
use crate::metamodule::motions::Middle;
use crate::metamodule::planning::paths::{Ground, Left};
use crate::metamodule::pose::{Pose, to_frame, to_world};
use metamorph_core::lattice::Cell;
use metamorph_roombots::grid::GridState;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The distance, in connectors from its middle, from which on a body counts as not enclosed.
const AWAY: i64 = 5;

/// True if a connector is far enough from a middle for a body that started there to count as not enclosed.
/// The answer is the same for both ends of the body.
pub fn is_away(from: Middle, to: (i16, i16)) -> bool {
    let (x, y) = (i64::from(to.0) * 4 - from.0, i64::from(to.1) * 4 - from.1);
    x.abs().max(y.abs()) >= AWAY * 4
}

/// Returns true if a taken cell may decide whether a body with this middle is enclosed: a motion from a connector that is not
/// far enough away may sweep it.
pub fn bears_on(middle: Middle, cell: Cell) -> bool {
    let (x, y) = (i64::from(cell.x) * 4 - middle.0, i64::from(cell.y) * 4 - middle.1);
    x.abs().max(y.abs()) < (AWAY + i64::from(RADIUS)) * 4
}

/// Range of cached cells along x and y, in connectors from the one that holds the body.
const NEAR: i16 = 10;
/// Width of the cached range along x and y, in cells.
const SIDE_CELLS: usize = 2 * NEAR as usize + 1;
/// Range of cached cells along z.
const HEIGHT: usize = 9;

/// A set of cells in the frame of the connector that holds the body.
struct Near([u64; (SIDE_CELLS * SIDE_CELLS * HEIGHT).div_ceil(64)]);

impl Near {
    /// Returns the number of a cell; `None` if it is out of range.
    fn number(cell: Cell) -> Option<u16> {
        let along = |c: i16| usize::try_from(c + NEAR).ok().filter(|i| *i < SIDE_CELLS);
        let up = usize::try_from(cell.z).ok().filter(|i| *i < HEIGHT)?;
        Some(((along(cell.x)? * SIDE_CELLS + along(cell.y)?) * HEIGHT + up) as u16)
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

/// A rectangle of connectors, by two opposite corners.
type Rectangle = ((i16, i16), (i16, i16));

fn with((min, max): Rectangle, (x, y): (i16, i16)) -> Rectangle {
    ((min.0.min(x), min.1.min(y)), (max.0.max(x), max.1.max(y)))
}

/// A route out, from its first landing on, in the frame of the connector that held the body before.
struct EscapePath {
    /// The connector at its end.
    to: (i16, i16),
    /// The bounding rectangle of all connectors that it uses.
    feet: Rectangle,
    cells: Box<[u16]>,
}

/// The cells that stopped a search.
struct Obstruction {
    floor: Floor,
    /// The grid state in which the search began.
    state: GridState,
    /// The landings there on the same side of the wall, as bits.
    lands: u128,
    /// The bounding rectangle of all connectors that the search visited.
    feet: Rectangle,
    cells: Box<[u16]>,
}

/// Results of earlier searches.
pub struct EnclosureCache(Mutex<CachedEnclosure>);

struct CachedEnclosure {
    /// By first landing.
    paths: Vec<Vec<EscapePath>>,
    /// By hash of the grid state.
    walls: Vec<Vec<Obstruction>>,
}

/// Number of routes kept for each landing.
const WAYS: usize = 32;
/// Number of buckets for walls, and of walls kept in each.
const WALLS: (usize, usize) = (1 << 10, 32);

impl EnclosureCache {
    /// Returns an empty cache.
    pub fn new() -> EnclosureCache {
        let (mut paths, mut walls) = (Vec::new(), Vec::new());
        paths.resize_with(u128::BITS as usize, Vec::new);
        walls.resize_with(WALLS.0, Vec::new);
        EnclosureCache(Mutex::new(CachedEnclosure { paths, walls }))
    }
    fn kept(&self) -> MutexGuard<'_, CachedEnclosure> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl CachedEnclosure {
    fn walls(&mut self, state: GridState) -> &mut Vec<Obstruction> {
        let numbers = [state.x as u16, state.y as u16, u16::from(state.class)];
        let hash =
            numbers.into_iter().fold(0, |h, n| crate::metamodule::planning::lru_cache::mix(h, u64::from(n)));
        &mut self.walls[hash as usize % WALLS.0]
    }
}

/// Returns true if an entry answers the question. That entry moves to the front, so the one unused for
/// longest is last.
fn finds<T>(kept: &mut [T], answers: impl Fn(&T) -> bool) -> bool {
    let at = kept.iter().position(answers);
    at.inspect(|at| kept[..=*at].rotate_right(1)).is_some()
}

fn keep<T>(kept: &mut Vec<T>, new: T, most: usize) {
    kept.truncate(most - 1);
    kept.insert(0, new);
}

/// A place visited by the search, with the index of the one before and the posture that landed here.
struct Step {
    pose: Pose,
    by: Option<(u32, u16)>,
}

impl Ground<'_> {
    /// True if a body in `pose` cannot get away from there.
    pub fn is_shut_in(&self, pose: Pose) -> bool {
        let (graph, state) = (self.motions.graph(), pose.state);
        let lands = self.lands(pose);
        if lands == 0 {
            return true;
        }
        let near = Near::new(state, self.taken);
        let mut kept = self.motions.learnt().kept();
        let from = self.motions.middle(Pose { state: GridState::new(0, 0, 0), ..pose });
        let is_way = |path: &EscapePath| is_away(from, path.to) && self.is_free(path, state, &near);
        if ones(lands).any(|rest| finds(&mut kept.paths[rest], is_way)) {
            return false;
        }
        let from = self.motions.middle(pose);
        let holds = |wall: &Obstruction| {
            let (min, max) = wall.feet;
            let ends = [min, max, (min.0, max.1), (max.0, min.1)];
            (wall.state, wall.floor) == (state, self.floor)
                && wall.lands & lands != 0
                && !ends.into_iter().any(|to| is_away(from, to))
                && wall.cells.iter().all(|c| near.has(*c))
        };
        if finds(kept.walls(state), holds) {
            return true;
        }
        match self.find_route_out(pose) {
            Ok(steps) => {
                let first = steps.first().and_then(|posture| graph.rest(*posture));
                if let Some((rest, path)) = first.zip(self.escape_path(pose, &steps)) {
                    keep(&mut kept.paths[usize::from(rest)], path, WAYS);
                }
                false
            }
            Err((cells, feet)) => {
                let number = |c: &Cell| Near::number(to_frame(state, *c));
                if let Some(cells) = cells.iter().map(number).collect() {
                    keep(
                        kept.walls(state),
                        Obstruction { floor: self.floor, state, lands, feet, cells },
                        WALLS.1,
                    );
                }
                true
            }
        }
    }

    fn is_free(&self, path: &EscapePath, state: GridState, near: &Near) -> bool {
        let corner = |(x, y)| to_world(state, Cell::new(x, y, 0));
        let (a, b) = (corner(path.feet.0), corner(path.feet.1));
        self.floor.has(a.x, a.y) && self.floor.has(b.x, b.y) && !path.cells.iter().any(|c| near.has(*c))
    }

    /// Returns the landings of a route out with the fewest steps; or else taken cells that block all routes,
    /// and the bounding rectangle of all connectors visited.
    fn find_route_out(&self, from: Pose) -> Result<Vec<u16>, (Vec<Cell>, Rectangle)> {
        let graph = self.motions.graph();
        let middle = self.motions.middle(from);
        let (mut left, mut steps) = (Left::new(self.floor), vec![Step { pose: from, by: None }]);
        let (mut at, mut places) = (0, Vec::new());
        while let Some(Step { pose, .. }) = steps.get(at) {
            let pose = *pose;
            if !left.has(pose, self.motions.rest_bit(pose.posture)) && left.is_bounded() {
                let lands = self.lands(pose);
                left.add(pose, lands);
                places.push(pose);
                for posture in graph.landings(lands) {
                    let Some(to) = self.landed(pose, posture) else { continue };
                    let by = Some((at as u32, posture));
                    if is_away(middle, to.foot()) {
                        return Ok(path_to(&steps, by));
                    }
                    if !left.has(to, self.motions.rest_bit(to.posture)) {
                        steps.push(Step { pose: to, by });
                    }
                }
            }
            at += 1;
        }
        let mut wall = Vec::new();
        for pose in &places {
            let cells = graph.wall(pose.posture, self.taken_at(*pose));
            wall.extend(graph.cells(cells).map(|c| to_world(pose.state, c)));
        }
        wall.sort_unstable();
        wall.dedup();
        Err((wall, places.iter().fold((from.foot(), from.foot()), |feet, p| with(feet, p.foot()))))
    }

    /// Returns the cached form of a route; `None` if it leaves the range of the cache.
    fn escape_path(&self, from: Pose, steps: &[u16]) -> Option<EscapePath> {
        let graph = self.motions.graph();
        let (first, steps) = steps.split_first()?;
        let foot = |pose: Pose| {
            let cell = to_frame(from.state, Cell::new(pose.state.x, pose.state.y, 0));
            (cell.x, cell.y)
        };
        let mut at = self.landed(from, *first)?;
        let (mut cells, mut feet) = (Vec::new(), (foot(at), foot(at)));
        for posture in steps {
            let path = graph.path(at.posture, *posture, self.taken_at(at))?;
            for cell in graph.cells(path.swept) {
                cells.push(Near::number(to_frame(from.state, to_world(at.state, cell)))?);
            }
            at = self.landed(at, *posture)?;
            feet = with(feet, foot(at));
        }
        cells.sort_unstable();
        cells.dedup();
        Some(EscapePath { to: foot(at), feet, cells: cells.into() })
    }
}

fn path_to(steps: &[Step], last: Option<(u32, u16)>) -> Vec<u16> {
    let before = |by: &(u32, u16)| steps[by.0 as usize].by;
    let mut steps: Vec<u16> = std::iter::successors(last, before).map(|(_, posture)| posture).collect();
    steps.reverse();
    steps
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metamodule::motions::Motions;
    use metamorph_core::rng::Rng;
    use metamorph_roombots::Kind;
    use metamorph_roombots::database::Database;
    use std::sync::Arc;

    /// Cached results do not change the answers, nor do cells that are too far away.
    #[test]
    fn what_was_learnt_changes_no_answer() {
        let database = Arc::new(Database::build());
        let floor = Floor { min: (0, 0), max: (8, 8) };
        for kind in Kind::METAMODULES {
            let motions = Motions::new(Arc::clone(&database), kind).unwrap();
            let mut rng = Rng::named(1, "shut in", 0);
            let mut below = |n: usize| rng.below(n as u64) as usize;
            let postures = motions.table().postures().len();
            let mut counts = [0; 2];
            for round in 0..1_500 {
                let mut body = || {
                    let state = GridState::new(below(9) as i16, below(9) as i16, below(4) as u8);
                    Pose::standing(state, below(postures) as u16)
                };
                let pose = body();
                let taken: Vec<Cell> = (0..round % 9).flat_map(|_| motions.cells(body())).collect();
                let ground = Ground { motions: &motions, floor, taken: &taken };
                let expected = ground.find_route_out(pose).is_err();
                for _ in 0..2 {
                    assert_eq!(ground.is_shut_in(pose), expected, "{kind} {pose:?} {taken:?}");
                }
                let mut around = || Pose {
                    state: GridState::new(below(40) as i16 - 16, below(40) as i16 - 16, below(4) as u8),
                    ..pose
                };
                let far: Vec<Cell> = (0..8).flat_map(|_| motions.cells(around())).chain(taken).collect();
                let middle = motions.middle(pose);
                let near: Vec<Cell> = far.iter().copied().filter(|c| bears_on(middle, *c)).collect();
                let [far, near] = [&far, &near].map(|taken| Ground { motions: &motions, floor, taken });
                assert_eq!(far.is_shut_in(pose), near.is_shut_in(pose), "{kind} {pose:?} {:?}", far.taken);
                counts[usize::from(expected)] += 1;
            }
            assert!(counts.iter().all(|n| *n > 100), "{kind}: {counts:?}");
            let kept = motions.learnt().kept();
            assert!(kept.paths.iter().any(|w| !w.is_empty()) && kept.walls.iter().any(|w| !w.is_empty()));
        }
    }
}
