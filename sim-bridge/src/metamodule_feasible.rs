//! Whether metamodules that stand still could have gone on: a search over everything that those who live
//! can do together among what stays, one after the other, up to a bound.
//!
//! It is asked whether one more open seed could have been filled, with what is built staying. The search
//! is exact on the motion database: a body that rests may rest in any posture that it can get to, not only
//! where it has landed. Postures that fill the same cells and lead to each other are one; and since all
//! bodies of a swarm are of one kind, only where bodies are counts and not whose they are. Motions at the
//! same time are no more than motions one after the other: what a motion sweeps is nobody else's until it
//! is over. While one moves the others do not, so where it is until it rests need not be told apart.
//!
//! All bodies together have too many arrangements to look at them all, so what is simple is asked first.
//! Most standstills have somebody in them who is *held*: it could not get away even if all others were
//! gone, or all but one or two who could not either. The cells that it never leaves are taken for everybody
//! else, always; and whoever fills a seed could do it also if all others who are not held were gone. If
//! nobody can do that, there is no way. On the other hand, most ways take one or two who move while all
//! others stay where they are.
//!
//! Absent: what is known to whom, and who would have to tell whom to make way.

use crate::feasible::Found;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::blueprint::{Seed, SeedSet, Task};
use metamorph_protocol::metamodule::distances::Distances;
use metamorph_protocol::metamodule::graph::Bits;
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
    /// Only in postures that land: enough to find most ways, and quick.
    Landings,
    /// In all of them: needed to prove that there is no way.
    Everything,
}

/// Whoever has so many arrangements before it, alone or with one or two others, is not taken to be held.
const HELD: usize = 300;
/// So many together are looked at whether they hold each other.
const GROUP: usize = 3;
/// Each two who could move while all others stay are looked at with so much less work than everybody.
const PAIRS: usize = 20;
/// Finding out what can be got to around some taken cells is so much work.
const LOOK: usize = 50;

/// Looks for a proof that there is no way, and for a way. Each of the searches that this takes, from the
/// simplest to that over everything, does so much work at most; a unit is one that moves looked at in one
/// place, less than a microsecond.
pub fn search(plight: &MetamodulePlight, work: usize) -> Found {
    let held = Held::find(plight, work);
    let everybody = 0..plight.free.len();
    let outside: Vec<usize> = everybody.clone().filter(|i| !held.bodies.contains(i)).collect();
    if !held.fills {
        let starts: Vec<Vec<usize>> = outside.iter().map(|i| vec![*i]).collect();
        if let Found::Impossible(seen) = held.board(plight).search(&starts, Rests::Everything, work) {
            return Found::Impossible(seen);
        }
    }
    let movers: Vec<usize> = everybody.filter(|i| !held.still.contains(i)).collect();
    let pairs = movers.iter().flat_map(|i| movers.iter().filter(move |j| *j > i).map(move |j| vec![*i, *j]));
    for pair in movers.iter().map(|i| vec![*i]).chain(pairs) {
        let mut board = Board::around_all_but(plight, &pair);
        if let Found::Way(moves) = board.search(&[pair], Rests::Everything, work / PAIRS) {
            return Found::Way(moves);
        }
    }
    let inside = || movers.iter().copied().filter(|i| held.bodies.contains(i));
    let mut starts: Vec<Vec<usize>> = outside.iter().map(|i| inside().chain([*i]).collect()).collect();
    starts.push(inside().collect());
    let mut board = Board::around_all_but(plight, &movers);
    match board.search(&starts, Rests::Everything, work) {
        Found::Impossible(seen) => return Found::Impossible(seen),
        Found::Way(moves) if outside.len() <= 1 => return Found::Way(moves),
        _ => {}
    }
    match board.search(std::slice::from_ref(&movers), Rests::Landings, work) {
        Found::Way(moves) => Found::Way(moves),
        _ => board.search(&[movers], Rests::Everything, work),
    }
}

/// Those who can never get away, alone or together, whatever all others do.
struct Held {
    bodies: BTreeSet<usize>,
    /// Those of them who never leave any of their cells.
    still: BTreeSet<usize>,
    /// The cells of what stays, and those that are never left.
    stays: Vec<Cell>,
    /// One of them might fill a seed.
    fills: bool,
}

impl Held {
    fn find(plight: &MetamodulePlight, work: usize) -> Held {
        let (bodies, still) = (BTreeSet::new(), BTreeSet::new());
        let mut held = Held { bodies, still, stays: plight.fixed.clone(), fills: false };
        // Only who cannot get away while all others stand still is held.
        let is_shut_in = |i: &usize| Board::around_all_but(plight, &[*i]).explore(&[*i]).is_some();
        let shut_in: Vec<usize> = (0..plight.free.len()).filter(is_shut_in).collect();
        let mut left = work;
        let mut groups: Vec<Vec<usize>> = shut_in.iter().map(|i| vec![*i]).collect();
        let mut at = 0;
        // Once somebody new is held, it may be that others are too.
        while let Some(group) = groups.get(at).cloned() {
            at += 1;
            if group.iter().any(|i| held.bodies.contains(i)) {
                continue;
            }
            let mut board = held.board(plight);
            let found = board.explore(&group);
            left = left.saturating_sub(board.work);
            if left == 0 {
                break;
            }
            if let Some((stays, fills)) = found {
                held.add(plight, &group, &stays, fills);
                at = 0;
            } else if group.len() < GROUP {
                let more = shut_in.iter().filter(|i| group.iter().all(|j| j < *i));
                let larger = more.map(|i| group.iter().copied().chain([*i]).collect::<Vec<usize>>());
                let larger: Vec<Vec<usize>> = larger.filter(|group| !groups.contains(group)).collect();
                groups.extend(larger);
            }
        }
        held
    }

    fn add(&mut self, plight: &MetamodulePlight, group: &[usize], stays: &BTreeSet<Cell>, fills: bool) {
        let mut cells = group.iter().flat_map(|i| plight.setup.motions.cells(plight.free[*i]));
        if !fills && cells.all(|c| stays.contains(&c)) {
            self.still.extend(group);
        }
        self.bodies.extend(group);
        self.stays.extend(stays);
        self.fills |= fills;
    }

    fn board<'a>(&self, plight: &'a MetamodulePlight) -> Board<'a> {
        Board::new(plight, self.stays.clone())
    }
}

/// A body at rest.
struct Shape {
    state: GridState,
    /// The postures that it may be in. All fill the same cells.
    postures: Vec<u16>,
    cells: [Cell; 4],
    strides: u16,
}

/// Where a body is that moves: attached here, in any posture that it can get to.
#[derive(Default)]
struct Place {
    /// What it may rest in there, by the numbers of the shapes.
    shapes: Vec<u32>,
    /// Those of them that land, or fill a seed.
    landings: Vec<u32>,
    /// Where it is after it has landed.
    lands: Vec<Pose>,
    fills: bool,
    strides: u16,
}

/// The place of the one who moves, and the shapes of the others, in order.
type Node = (u32, Vec<u32>);

/// What does not change while a search goes on, and what has been looked at, by numbers.
struct Board<'a> {
    plight: &'a MetamodulePlight,
    /// The cells that are always taken.
    fixed: Vec<Cell>,
    /// The open seeds with the strides to them around what is fixed.
    seeds: Vec<(Seed, Arc<Distances>)>,
    shapes: Vec<Shape>,
    shape_numbers: BTreeMap<(GridState, Vec<u16>), u32>,
    places: Vec<Place>,
    place_numbers: BTreeMap<(GridState, u32), u32>,
    /// Shapes that lead to each other.
    parts: Vec<Vec<Vec<u16>>>,
    /// The part of a posture around what is taken.
    part_numbers: BTreeMap<Bits, BTreeMap<u16, u32>>,
    work: usize,
}

impl<'a> Board<'a> {
    fn new(plight: &'a MetamodulePlight, fixed: Vec<Cell>) -> Board<'a> {
        let setup = &plight.setup;
        let open = setup.goal(plight.task).open(plight.filled);
        let seeds = open.iter().filter_map(|s| setup.seed(plight.task, s));
        let seeds = seeds.map(|s| (s, setup.motions.distances(setup.floor, s, &fixed))).collect();
        Board {
            plight,
            fixed,
            seeds,
            shapes: Vec::new(),
            shape_numbers: BTreeMap::new(),
            places: Vec::new(),
            place_numbers: BTreeMap::new(),
            parts: Vec::new(),
            part_numbers: BTreeMap::new(),
            work: 0,
        }
    }

    /// With everybody fixed but these.
    fn around_all_but(plight: &'a MetamodulePlight, movers: &[usize]) -> Board<'a> {
        let others = (0..).zip(&plight.free).filter(|(i, _)| !movers.contains(i));
        let others = others.flat_map(|(_, pose)| plight.setup.motions.cells(*pose));
        Board::new(plight, plight.fixed.iter().copied().chain(others).collect())
    }

    /// A body at rest, by its number.
    fn shape(&mut self, state: GridState, postures: Vec<u16>) -> u32 {
        let key = (state, postures);
        if let Some(number) = self.shape_numbers.get(&key) {
            return *number;
        }
        let number = self.shapes.len() as u32;
        let cells = self.plight.setup.motions.cells(attached(state, first(&key.1)));
        let strides = self.strides(state, &key.1);
        self.shapes.push(Shape { state, postures: key.1.clone(), cells, strides });
        self.shape_numbers.insert(key, number);
        number
    }

    /// Strides to the nearest open seed around what is fixed.
    fn strides(&self, state: GridState, postures: &[u16]) -> u16 {
        let setup = &self.plight.setup;
        let ground = Ground { motions: &setup.motions, floor: setup.floor, taken: &self.fixed };
        let from = |posture: u16| {
            let pose = attached(state, posture);
            let lands = ground.lands(pose);
            let to = |(seed, distances): &(Seed, Arc<Distances>)| {
                let fills = pose.foot() == seed.foot && ground.filling(pose, *seed).is_some();
                fills.then_some(0).or_else(|| distances.strides(pose, lands))
            };
            self.seeds.iter().filter_map(to).min()
        };
        postures.iter().filter_map(|posture| from(*posture)).min().unwrap_or(u16::MAX)
    }

    /// Whether a body fills an open seed.
    fn fills(&self, state: GridState, posture: u16) -> bool {
        let motions = &self.plight.setup.motions;
        let chain = |seed: &Seed| motions.chain_of(seed.cells().map(|c| to_frame(state, c)));
        self.seeds.iter().any(|(seed, _)| {
            (state.x, state.y) == seed.foot
                && chain(seed).is_some_and(|c| motions.graph().chain(posture) == Some(c))
        })
    }

    /// Where a body in a posture is when it moves while these others rest.
    fn place(&mut self, state: GridState, posture: u16, others: &[u32]) -> u32 {
        self.work += 1;
        let setup = Arc::clone(&self.plight.setup);
        let (motions, graph) = (&setup.motions, setup.motions.graph());
        let mut taken = graph.seen_from(state, &self.fixed);
        for other in others {
            taken |= graph.seen_from(state, &self.shapes[*other as usize].cells);
        }
        let parts = self.part_numbers.entry(taken).or_default();
        let part = if let Some(part) = parts.get(&posture) {
            *part
        } else {
            self.work += LOOK;
            let part = self.parts.len() as u32;
            let shapes = graph.shapes(&[posture], taken);
            parts.extend(shapes.iter().flatten().map(|p| (*p, part)));
            self.parts.push(shapes);
            part
        };
        if let Some(number) = self.place_numbers.get(&(state, part)) {
            return *number;
        }
        let (mut place, mut nearest) = (Place::default(), u16::MAX);
        for postures in self.parts[part as usize].clone() {
            let on_floor = |to: &Pose| setup.floor.has(to.state.x, to.state.y);
            let lands = postures.iter().filter_map(|p| motions.turned_around(attached(state, *p)));
            let lands: Vec<Pose> = lands.filter(on_floor).collect();
            let fills = self.fills(state, first(&postures));
            let shape = self.shape(state, postures);
            if fills || !lands.is_empty() {
                place.landings.push(shape);
            }
            nearest = nearest.min(self.shapes[shape as usize].strides);
            place.shapes.push(shape);
            place.lands.extend(lands);
            place.fills |= fills;
        }
        place.strides = nearest;
        let number = self.places.len() as u32;
        self.places.push(place);
        self.place_numbers.insert((state, part), number);
        number
    }

    /// One of these moves.
    fn begin(&mut self, bodies: &[usize]) -> Vec<Node> {
        let poses = bodies.iter().map(|i| self.plight.free[*i]);
        let resting: Vec<u32> = poses.map(|pose| self.shape(pose.state, vec![pose.posture])).collect();
        let mut nodes = Vec::new();
        for i in 0..resting.len() {
            let mut others = resting.clone();
            let shape = others.remove(i);
            self.wake(shape, others, &mut nodes);
        }
        nodes
    }

    /// One that has been at rest moves.
    fn wake(&mut self, shape: u32, mut others: Vec<u32>, nodes: &mut Vec<Node>) {
        others.sort_unstable();
        let Shape { state, postures, .. } = &self.shapes[shape as usize];
        let (state, postures) = (*state, postures.clone());
        let mut before = None;
        for posture in postures {
            let place = self.place(state, posture, &others);
            if before.replace(place) != Some(place) {
                nodes.push((place, others.clone()));
            }
        }
    }

    /// What can be next, and whether it takes a stride.
    fn next(&mut self, (place, others): &Node, rests: Rests) -> Vec<(Node, bool)> {
        let mut next = Vec::new();
        for to in self.places[*place as usize].lands.clone() {
            next.push(((self.place(to.state, to.posture, others), others.clone()), true));
        }
        let place = &self.places[*place as usize];
        let shapes = if rests == Rests::Landings { &place.landings } else { &place.shapes };
        let mut woken = Vec::new();
        for shape in if others.is_empty() { Vec::new() } else { shapes.clone() } {
            for i in 0..others.len() {
                let mut resting = others.clone();
                let other = std::mem::replace(&mut resting[i], shape);
                self.wake(other, resting, &mut woken);
            }
        }
        // Who can do nothing has been looked at already.
        woken.retain(|(place, _)| self.places[*place as usize].is_free());
        next.extend(woken.into_iter().map(|node| (node, false)));
        next
    }

    /// If these together have few arrangements with nobody else there: the cells that they never leave, and
    /// whether one of them fills a seed.
    fn explore(&mut self, group: &[usize]) -> Option<(BTreeSet<Cell>, bool)> {
        let cells = |board: &Board<'_>, shape: u32| board.shapes[shape as usize].cells;
        let mut front = self.begin(group);
        let mut seen: BTreeSet<Node> = front.iter().cloned().collect();
        let stays = group.iter().flat_map(|i| self.plight.setup.motions.cells(self.plight.free[*i]));
        let (mut stays, mut fills): (BTreeSet<Cell>, _) = (stays.collect(), false);
        while let Some(node) = front.pop() {
            let place = &self.places[node.0 as usize];
            fills |= place.fills;
            let others: Vec<Cell> = node.1.iter().flat_map(|s| cells(self, *s)).collect();
            for shape in &place.shapes {
                let mine = cells(self, *shape);
                stays.retain(|c| others.contains(c) || mine.contains(c));
            }
            let next = self.next(&node, Rests::Everything).into_iter().map(|(node, _)| node);
            front.extend(next.filter(|node| seen.insert(node.clone())));
            if seen.len() > HELD {
                return None;
            }
        }
        Some((stays, fills))
    }

    /// Searches from all these starts, what looks nearest to a seed first.
    fn search(&mut self, starts: &[Vec<usize>], rests: Rests, work: usize) -> Found {
        self.work = 0;
        let (mut seen, mut front, mut order) = (BTreeSet::new(), BinaryHeap::new(), 0u32);
        let mut found: Vec<(Node, bool)> = Vec::new();
        for start in starts {
            found.extend(self.begin(start).into_iter().map(|node| (node, false)));
        }
        let mut before = 0;
        loop {
            for (node, is_move) in found {
                if !seen.insert(node.clone()) {
                    continue;
                }
                let (moves, place) = (before + usize::from(is_move), &self.places[node.0 as usize]);
                if place.fills {
                    return Found::Way(moves);
                }
                let resting = node.1.iter().map(|s| self.shapes[*s as usize].strides);
                let nearest = resting.chain([place.strides]).min();
                order += 1;
                front.push(Reverse((nearest, moves, order, node)));
            }
            if self.work > work {
                return Found::Undecided;
            }
            let Some(Reverse((_, moves, _, node))) = front.pop() else { break };
            before = moves;
            found = self.next(&node, rests);
        }
        match rests {
            Rests::Everything => Found::Impossible(seen.len()),
            Rests::Landings => Found::Undecided,
        }
    }
}

impl Place {
    /// Whether whoever is here can do anything.
    fn is_free(&self) -> bool {
        self.shapes.len() > 1 || !self.lands.is_empty()
    }
}

/// A body attached here by its foot, in a posture.
fn attached(state: GridState, posture: u16) -> Pose {
    Pose { state, end: End::Foot, both: false, posture }
}

/// One of the postures of a shape, which has one at least.
fn first(postures: &[u16]) -> u16 {
    postures.first().copied().unwrap_or_default()
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
        assert_eq!(search(&plight(&setup, &[(4, 4)], &[]), 100_000), Found::Way(0), "it stands there");
        assert!(matches!(search(&plight(&setup, &[(0, 0), (1, 1)], &[]), 100_000), Found::Way(2..)));
        assert_eq!(search(&plight(&setup, &[(0, 0), (1, 1)], &[]), 1), Found::Undecided);
        let is_impossible = |plight| matches!(search(&plight, 100_000), Found::Impossible(_));
        assert!(is_impossible(plight(&setup, &[], &[])), "nobody is free");
        assert!(is_impossible(plight(&setup, &[(0, 0)], &[Cell::new(4, 4, 2)])), "the seed is taken");
    }

    /// What is seen without a search over everything is what such a search says.
    #[test]
    fn says_only_what_is_so() {
        let (database, mut stream) = (Arc::new(Database::build()), Stream::named(1, "feasible", 0));
        let mut counts = [0; 4];
        for _ in 0..60 {
            let side = 2 + stream.below(3) as i16;
            let mut place = || (stream.below(side as u64) as i16, stream.below(side as u64) as i16);
            let (setup, mut free) = (setup(&database, side, &[place()]), Vec::<(i16, i16)>::new());
            for at in [place(), place(), place()] {
                if !free.contains(&at) {
                    free.push(at);
                }
            }
            let fixed = (0..5).map(|_| place()).filter(|p| !free.contains(p));
            let fixed: Vec<Cell> = fixed.map(|(x, y)| Cell::new(x, y, (x + 2 * y) % 4)).collect();
            let plight = plight(&setup, &free, &fixed);
            let everybody: Vec<usize> = (0..free.len()).collect();
            let mut board = Board::around_all_but(&plight, &everybody);
            let all = board.search(&[everybody], Rests::Everything, 200_000);
            let found = search(&plight, 200_000);
            let is_so = match all {
                Found::Way(_) => matches!(found, Found::Way(_)),
                Found::Impossible(_) => matches!(found, Found::Impossible(_)),
                Found::Undecided => true,
            };
            assert!(is_so, "{all:?}, {found:?}: {plight:?}");
            counts[match (all, found) {
                (Found::Way(_), _) => 0,
                (Found::Impossible(_), _) => 1,
                (Found::Undecided, Found::Impossible(_)) => 2,
                _ => 3,
            }] += 1;
        }
        assert!(counts[..3].iter().all(|n| *n > 1), "{counts:?}");
    }
}
