//! Whether metamodules that stand still could have gone on: a search over everything that those who live
//! can do together among what stays, one after the other, up to a bound.
//!
//! It is asked whether one more open seed could have been filled, with what is built staying. The search
//! is exact on the motion database: a body that rests may rest in any posture that it can get to, not only
//! where it has landed. Postures that fill the same cells and lead to each other are one; and since all
//! bodies of a swarm are of one kind, only where bodies are counts and not whose they are. Motions at the
//! same time are no more than motions one after the other: what a motion sweeps is nobody else's until it
//! is over. So if the search ends without a way there is none, and if what moves would find none even alone
//! on the floor, that is seen without it.
//!
//! Absent: what is known to whom, and who would have to tell whom to make way.

use crate::feasible::Found;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::blueprint::{Seed, SeedSet, Task};
use metamorph_protocol::metamodule::distances::Distances;
use metamorph_protocol::metamodule::params::Setup;
use metamorph_protocol::metamodule::pose::{End, Pose, to_frame};
use metamorph_protocol::metamodule::search::Ground;
use metamorph_protocol::roombots::grid::GridState;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};
use std::sync::Arc;

/// A standstill of metamodules as a question: who stands where, and what is to be built.
#[derive(Clone, Debug)]
pub struct MetamodulePlight {
    /// What they are, and where.
    pub setup: Arc<Setup>,
    /// What is built.
    pub task: Task,
    /// What of it is.
    pub filled: SeedSet,
    /// Those who live, can move, and are no part of what is built.
    pub free: Vec<Pose>,
    /// The cells of everything that stays.
    pub fixed: Vec<Cell>,
}

/// What bodies that are looked at may rest in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Rests {
    /// Only in postures by which they have landed: enough to find most ways, and quick.
    Landings,
    /// In all of them: needed to prove that there is no way.
    Everything,
}

/// Searches what looks nearest to a seed first. Each of the two searches, the quick one and the one that
/// proves, looks at so many arrangements at most.
pub fn search(plight: &MetamodulePlight, bound: usize) -> Found {
    let mut board = Board::new(plight);
    if board.start.iter().all(|body| board.strides(*body).is_none()) {
        return Found::Impossible(1);
    }
    match board.search(Rests::Landings, bound) {
        Found::Way(strides) => Found::Way(strides),
        _ => board.search(Rests::Everything, bound),
    }
}

/// A body at rest: where it is attached, and the postures that it may be in. All fill the same cells.
type Body = (GridState, Vec<u16>);

/// What does not change while a search goes on, and bodies by their numbers.
struct Board<'a> {
    plight: &'a MetamodulePlight,
    /// The open seeds with the strides to them around what stays.
    seeds: Vec<(Seed, Arc<Distances>)>,
    start: Vec<u32>,
    bodies: Vec<(Body, [Cell; 4])>,
    numbers: BTreeMap<Body, u32>,
}

impl<'a> Board<'a> {
    fn new(plight: &'a MetamodulePlight) -> Board<'a> {
        let setup = &plight.setup;
        let open = setup.goal(plight.task).open(plight.filled);
        let seeds = open.iter().filter_map(|s| setup.seed(plight.task, s));
        let seeds = seeds.map(|s| (s, setup.motions.distances(setup.floor, s, &plight.fixed))).collect();
        let mut board =
            Board { plight, seeds, start: Vec::new(), bodies: Vec::new(), numbers: BTreeMap::new() };
        let cells = |pose: &Pose| setup.motions.cells(*pose);
        for (i, pose) in plight.free.iter().enumerate() {
            let others = plight.free.iter().enumerate().filter(|(j, _)| *j != i).flat_map(|(_, p)| cells(p));
            let taken: Vec<Cell> = plight.fixed.iter().copied().chain(others).collect();
            let body = board.gathered(pose.state, pose.posture, &taken);
            board.start.push(body);
        }
        board.start.sort_unstable();
        board
    }

    fn pose(&self, body: u32) -> Pose {
        let ((state, postures), _) = &self.bodies[body as usize];
        let posture = postures.first().copied().unwrap_or_default();
        Pose { state: *state, end: End::Foot, both: false, posture }
    }

    fn number(&mut self, body: Body) -> u32 {
        if let Some(number) = self.numbers.get(&body) {
            return *number;
        }
        let number = self.bodies.len() as u32;
        let posture = body.1.first().copied().unwrap_or_default();
        let pose = Pose { state: body.0, end: End::Foot, both: false, posture };
        self.bodies.push((body.clone(), self.plight.setup.motions.cells(pose)));
        self.numbers.insert(body, number);
        number
    }

    /// A body in a posture, with the others that it can get to and that fill the same cells.
    fn gathered(&mut self, state: GridState, posture: u16, taken: &[Cell]) -> u32 {
        let graph = self.plight.setup.motions.graph();
        let shapes = graph.shapes(&[posture], graph.seen_from(state, taken));
        let same = shapes.into_iter().find(|s| s.contains(&posture));
        self.number((state, same.unwrap_or_else(|| vec![posture])))
    }

    /// Strides to the nearest open seed around what stays; none if there is no way to any.
    fn strides(&self, body: u32) -> Option<u16> {
        let setup = &self.plight.setup;
        let ground = Ground { motions: &setup.motions, floor: setup.floor, taken: &self.plight.fixed };
        let (state, postures) = &self.bodies[body as usize].0;
        let to = |(seed, distances): &(Seed, Arc<Distances>)| {
            postures
                .iter()
                .filter_map(|posture| {
                    let pose = Pose { state: *state, end: End::Foot, both: false, posture: *posture };
                    let stays =
                        (pose.foot() == seed.foot && ground.filling(pose, *seed).is_some()).then_some(0);
                    stays.or_else(|| distances.strides(pose, ground.lands(pose)))
                })
                .min()
        };
        self.seeds.iter().filter_map(to).min()
    }

    /// Whether a body fills an open seed.
    fn fills(&self, body: u32) -> bool {
        let pose = self.pose(body);
        self.seeds.iter().any(|(seed, _)| {
            let chain = || self.plight.setup.motions.chain_of(seed.cells().map(|c| to_frame(pose.state, c)));
            pose.foot() == seed.foot
                && chain().is_some_and(|c| self.plight.setup.motions.graph().chain(pose.posture) == Some(c))
        })
    }

    fn search(&mut self, rests: Rests, bound: usize) -> Found {
        let start = self.start.clone();
        let mut seen = BTreeSet::from([start.clone()]);
        let mut away: BTreeMap<u32, u16> = BTreeMap::new();
        let mut front = BinaryHeap::from([Reverse((0, 0, 0u32, start))]);
        let mut order = 0;
        while let Some(Reverse((_, moves, _, at))) = front.pop() {
            for i in 0..at.len() {
                for (to, is_move) in self.moves(&at, i, rests) {
                    let moves = moves + usize::from(is_move);
                    if self.fills(to) {
                        return Found::Way(moves);
                    }
                    let mut next = at.clone();
                    next[i] = to;
                    next.sort_unstable();
                    if seen.contains(&next) {
                        continue;
                    }
                    if seen.len() >= bound {
                        return Found::Undecided;
                    }
                    seen.insert(next.clone());
                    let mut far = |body: u32| {
                        *away.entry(body).or_insert_with(|| self.strides(body).unwrap_or(u16::MAX))
                    };
                    let nearest = next.iter().map(|b| far(*b)).min().unwrap_or(u16::MAX);
                    order += 1;
                    front.push(Reverse((nearest, moves, order, next)));
                }
            }
        }
        match rests {
            Rests::Everything => Found::Impossible(seen.len()),
            Rests::Landings => Found::Undecided,
        }
    }

    /// Everything that one body can do while the others stand still, and whether that is a stride.
    fn moves(&mut self, at: &[u32], i: usize, rests: Rests) -> Vec<(u32, bool)> {
        let (setup, mut found) = (Arc::clone(&self.plight.setup), Vec::new());
        let (motions, graph) = (&setup.motions, setup.motions.graph());
        let others = at.iter().enumerate().filter(|(j, _)| *j != i);
        let others = others.flat_map(|(_, b)| self.bodies[*b as usize].1);
        let taken: Vec<Cell> = self.plight.fixed.iter().copied().chain(others).collect();
        let (state, postures) = self.bodies[at[i] as usize].0.clone();
        for shape in graph.shapes(&postures, graph.seen_from(state, &taken)) {
            for posture in &shape {
                let pose = Pose { state, end: End::Foot, both: false, posture: *posture };
                let Some(to) = motions.turned_around(pose) else { continue };
                if setup.floor.has(to.state.x, to.state.y) {
                    found.push((self.gathered(to.state, to.posture, &taken), true));
                }
            }
            let stays = (state, shape);
            let number = self.number(stays);
            if rests == Rests::Everything || self.fills(number) {
                found.push((number, false));
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::lattice::Face;
    use metamorph_protocol::metamodule::blueprint::{Blueprint, SeedOrder};
    use metamorph_protocol::metamodule::motions::Motions;
    use metamorph_protocol::metamodule::params::{Floor, Params, Strategy};
    use metamorph_protocol::roombots::Kind;
    use metamorph_protocol::roombots::database::Database;
    use metamorph_protocol::roombots::posture::Posture;
    use metamorph_protocol::stream::Stream;
    use metamorph_protocol::time::Span;

    fn setup(database: &Arc<Database>, side: i16, feet: &[(i16, i16)]) -> Arc<Setup> {
        let seed = |foot: &(i16, i16)| Seed { foot: *foot, directions: [Face::Up; 3] };
        let levels = [feet.iter().map(seed).collect()];
        Arc::new(Setup {
            params: Params::scaled(Strategy::Negotiated, Span::secs(1), Span::millis(10)),
            floor: Floor { min: (0, 0), max: (side - 1, side - 1) },
            goals: vec![Blueprint::new(&levels, SeedOrder::AtOnce).unwrap()],
            motions: Motions::new(Arc::clone(database), Kind::Srs).unwrap(),
        })
    }

    fn upright(setup: &Setup, x: i16, y: i16) -> Pose {
        let posture = setup.motions.table().find(Posture::zero(Kind::Srs)).unwrap();
        Pose { state: GridState::new(x, y, 0), end: End::Foot, both: false, posture }
    }

    fn plight(setup: &Arc<Setup>, free: &[(i16, i16)], fixed: &[Cell]) -> MetamodulePlight {
        let free = free.iter().map(|(x, y)| upright(setup, *x, *y)).collect();
        let (task, filled) = (Task::default(), SeedSet::default());
        MetamodulePlight { setup: Arc::clone(setup), task, filled, free, fixed: fixed.to_vec() }
    }

    #[test]
    fn finds_a_way_where_there_is_one() {
        let setup = setup(&Arc::new(Database::build()), 9, &[(4, 4)]);
        assert_eq!(search(&plight(&setup, &[(4, 4)], &[]), 100), Found::Way(0), "it stands there");
        assert!(matches!(search(&plight(&setup, &[(0, 0), (1, 1)], &[]), 1_000), Found::Way(2..)));
        assert_eq!(search(&plight(&setup, &[(0, 0), (1, 1)], &[]), 1), Found::Undecided);
        assert_eq!(search(&plight(&setup, &[], &[]), 100), Found::Impossible(1), "nobody is free");
        let foreign = [Cell::new(4, 4, 2)];
        assert_eq!(search(&plight(&setup, &[(0, 0)], &foreign), 100), Found::Impossible(1));
    }

    /// Two on a floor where each alone would get to the seed, and everything around a place to hold them.
    #[test]
    fn says_only_what_is_so() {
        let (database, mut stream) = (Arc::new(Database::build()), Stream::named(1, "feasible", 0));
        let mut counts = [0; 3];
        for _ in 0..60 {
            let side = 2 + stream.below(2) as i16;
            let mut place = || (stream.below(side as u64) as i16, stream.below(side as u64) as i16);
            let setup = setup(&database, side, &[place()]);
            let (a, b) = (place(), place());
            if a == b {
                continue;
            }
            let fixed: Vec<Cell> = (0..4)
                .map(|_| place())
                .filter(|p| *p != a && *p != b)
                .map(|(x, y)| Cell::new(x, y, (x + 2 * y) % 4))
                .collect();
            let plight = plight(&setup, &[a, b], &fixed);
            let (mut quick, mut all) = (Board::new(&plight), Board::new(&plight));
            let quick = quick.search(Rests::Landings, 3_000);
            let all = all.search(Rests::Everything, 3_000);
            // What is proved to be impossible is not found by the quick search either.
            assert!(!matches!((quick, all), (Found::Way(_), Found::Impossible(_))), "{plight:?}");
            counts[match all {
                Found::Way(_) => 0,
                Found::Impossible(_) => 1,
                Found::Undecided => 2,
            }] += 1;
        }
        assert!(counts[0] > 5 && counts[1] > 5, "{counts:?}");
    }
}
