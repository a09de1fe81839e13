//! The state space of the cooperative search: where several bodies can get to, one after the other.
//!
//! It is exact on the motion database: a body may rest in any posture that it can reach, not only where it
//! has landed. Connected postures that fill the same cells form one shape; and since all bodies of a swarm
//! are of one kind, a state holds the filled shapes without the identities of the bodies. Simultaneous
//! motions add no states, because the cells that a motion sweeps are locked until it ends. While one body
//! moves the others rest, so the places of the moving body between two rests need not be told apart.

use super::distances::Distances;
use super::graph::Bits;
use crate::metamodule::blueprint::Seed;
use crate::metamodule::planning::cooperative::{Move, SearchResult, Standstill};
use crate::metamodule::planning::paths::Ground;
use crate::metamodule::pose::{Pose, to_frame};
use metamorph_core::lattice::Cell;
use metamorph_roombots::grid::GridState;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};
use std::sync::Arc;

/// Work of computing the reachable postures around some taken cells, in units of [`StateSpace::work`].
const LOOK: usize = 50;

/// The postures in which bodies may rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StopAt {
    /// Only postures that land: fast, and enough to find most plans.
    Landings,
    /// All postures: needed to prove that there is no plan.
    Everything,
}

/// A body at rest.
struct Shape {
    state: GridState,
    /// Connected postures, one of which the body is in. All fill the same cells.
    postures: Vec<u16>,
    cells: [Cell; 4],
    steps: u16,
}

/// A moving body: attached in a grid state, in any of the postures connected to its own.
#[derive(Default)]
struct Place {
    /// The shapes in which it may rest there, by number.
    shapes: Vec<u32>,
    /// Those of them that land or fill a seed.
    landings: Vec<u32>,
    /// The postures that land, and the pose after each.
    lands: Vec<(u16, Pose)>,
    /// The posture that fills a seed.
    fills: Option<u16>,
    steps: u16,
}

/// The transition from one node to the next.
#[derive(Clone, Copy)]
enum By {
    /// This body is the first to move.
    Begins(usize),
    /// The moving body lands by this posture and then has this pose.
    Lands(u16, Pose),
    /// The moving body rests in shape `rests`; the one in shape `woken` moves next, from `posture`.
    Wakes { rests: u32, woken: u32, posture: u16 },
}

/// Poses that one body can reach while all others stay.
pub struct Reachable {
    body: usize,
    stays: Vec<Stay>,
    /// The poses in which it may rest: index of the stay, and posture.
    pub rests: Vec<(usize, u16)>,
    /// The pose that fills an open seed, in the same form.
    pub fills: Option<(usize, u16)>,
}

/// A grid state in which the body has landed.
struct Stay {
    /// Index of the stay before, and the posture that lands from there; `None` for the first.
    before: Option<(usize, u16)>,
    /// The pose after the landing.
    pose: Pose,
}

impl Reachable {
    /// Returns the pose of a rest.
    pub fn pose(&self, (stay, posture): (usize, u16)) -> Pose {
        Pose { posture, ..self.stays[stay].pose }
    }

    /// Returns the moves that lead to a rest.
    pub fn moves(&self, (mut stay, posture): (usize, u16)) -> Vec<Move> {
        let turn = |stay: usize, posture| {
            let from = self.stays[stay].pose;
            Move { body: self.body, from, posture, lands: false }
        };
        let mut moves = vec![turn(stay, posture)];
        while let Some((before, by)) = self.stays[stay].before {
            moves.push(Move { lands: true, ..turn(before, by) });
            stay = before;
        }
        moves.reverse();
        moves
    }
}

/// The place of the moving body, and the shapes of the others in ascending order.
type Node = (u32, Vec<u32>);

/// The search problem, and everything computed so far, by number.
pub struct StateSpace<'a> {
    standstill: &'a Standstill,
    /// The cells that are always taken.
    fixed: Vec<Cell>,
    /// The open seeds with the distances to them around the fixed cells.
    seeds: Vec<(Seed, Arc<Distances>)>,
    shapes: Vec<Shape>,
    shape_numbers: BTreeMap<(GridState, Vec<u16>), u32>,
    places: Vec<Place>,
    place_numbers: BTreeMap<(GridState, u32), u32>,
    /// Connected postures, grouped by shape.
    parts: Vec<Vec<Vec<u16>>>,
    /// By taken cells and posture: the index into `parts`.
    part_numbers: BTreeMap<Bits, BTreeMap<u16, u32>>,
    /// Work done by the last search, in units of less than a microsecond.
    pub work: usize,
}

impl<'a> StateSpace<'a> {
    /// Returns the state space around cells that stay taken.
    pub fn new(standstill: &'a Standstill, fixed: Vec<Cell>) -> StateSpace<'a> {
        let setup = &standstill.setup;
        let open = setup.goal(standstill.task).open(standstill.filled);
        let seeds = open.iter().filter_map(|s| setup.seed(standstill.task, s));
        let seeds = seeds.map(|s| (s, setup.motions.distances(setup.floor, s, &fixed))).collect();
        StateSpace { seeds, ..StateSpace::without_seeds(standstill, fixed) }
    }

    /// Like [`StateSpace::new`], for reachability alone: distances to seeds are most of the work.
    pub fn without_seeds(standstill: &'a Standstill, fixed: Vec<Cell>) -> StateSpace<'a> {
        StateSpace {
            standstill,
            fixed,
            seeds: Vec::new(),
            shapes: Vec::new(),
            shape_numbers: BTreeMap::new(),
            places: Vec::new(),
            place_numbers: BTreeMap::new(),
            parts: Vec::new(),
            part_numbers: BTreeMap::new(),
            work: 0,
        }
    }

    /// Returns the state space in which all bodies but `movers` are fixed.
    pub fn around_all_but(standstill: &'a Standstill, movers: &[usize]) -> StateSpace<'a> {
        StateSpace::new(standstill, standstill.taken_around(movers))
    }

    /// Returns the number of a shape.
    fn shape(&mut self, state: GridState, postures: Vec<u16>) -> u32 {
        let key = (state, postures);
        if let Some(number) = self.shape_numbers.get(&key) {
            return *number;
        }
        let number = self.shapes.len() as u32;
        let cells = self.standstill.setup.motions.cells(attached(state, first(&key.1)));
        let steps = self.steps(state, &key.1);
        self.shapes.push(Shape { state, postures: key.1.clone(), cells, steps });
        self.shape_numbers.insert(key, number);
        number
    }

    /// Returns the steps to the nearest open seed around fixed cells; `u16::MAX` if there is no route.
    fn steps(&self, state: GridState, postures: &[u16]) -> u16 {
        let setup = &self.standstill.setup;
        let ground = Ground { motions: &setup.motions, floor: setup.floor, taken: &self.fixed };
        let from = |posture: u16| {
            let pose = attached(state, posture);
            let lands = ground.lands(pose);
            let to = |(seed, distances): &(Seed, Arc<Distances>)| {
                let fills = pose.foot() == seed.foot && ground.filling(pose, *seed).is_some();
                fills.then_some(0).or_else(|| distances.steps(pose, lands))
            };
            self.seeds.iter().filter_map(to).min()
        };
        postures.iter().filter_map(|posture| from(*posture)).min().unwrap_or(u16::MAX)
    }

    /// True if a body in this pose fills an open seed.
    fn fills(&self, state: GridState, posture: u16) -> bool {
        let motions = &self.standstill.setup.motions;
        let chain = |seed: &Seed| motions.chain_of(seed.cells().map(|c| to_frame(state, c)));
        self.seeds.iter().any(|(seed, _)| {
            (state.x, state.y) == seed.foot
                && chain(seed).is_some_and(|c| motions.graph().chain(posture) == Some(c))
        })
    }

    /// Returns the place of a body that moves from this posture while the others rest.
    fn place(&mut self, state: GridState, posture: u16, others: &[u32]) -> u32 {
        self.work += 1;
        let setup = Arc::clone(&self.standstill.setup);
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
            let on_floor = |(_, to): &(u16, Pose)| setup.floor.has(to.state.x, to.state.y);
            let landed = |p: &u16| Some((*p, motions.turned_around(attached(state, *p))?));
            let lands: Vec<(u16, Pose)> = postures.iter().filter_map(landed).filter(on_floor).collect();
            let fills = Some(first(&postures)).filter(|p| self.fills(state, *p));
            let shape = self.shape(state, postures);
            if fills.is_some() || !lands.is_empty() {
                place.landings.push(shape);
            }
            nearest = nearest.min(self.shapes[shape as usize].steps);
            place.shapes.push(shape);
            place.lands.extend(lands);
            place.fills = place.fills.or(fills);
        }
        place.steps = nearest;
        let number = self.places.len() as u32;
        self.places.push(place);
        self.place_numbers.insert((state, part), number);
        number
    }

    /// Returns the nodes in which one of these bodies moves and the others rest.
    fn begin(&mut self, bodies: &[usize]) -> Vec<(Node, By)> {
        let poses = bodies.iter().map(|i| self.standstill.free[*i]);
        let resting: Vec<u32> = poses.map(|pose| self.shape(pose.state, vec![pose.posture])).collect();
        let mut nodes = Vec::new();
        for (i, body) in bodies.iter().enumerate() {
            let mut others = resting.clone();
            let shape = others.remove(i);
            let woken = self.wake(shape, others).into_iter();
            nodes.extend(woken.map(|(node, _)| (node, By::Begins(*body))));
        }
        nodes
    }

    /// Returns the nodes in which a body that was at rest moves, from each posture of its shape.
    fn wake(&mut self, shape: u32, mut others: Vec<u32>) -> Vec<(Node, u16)> {
        others.sort_unstable();
        let Shape { state, postures, .. } = &self.shapes[shape as usize];
        let (state, postures) = (*state, postures.clone());
        let mut nodes: Vec<(Node, u16)> = Vec::new();
        for posture in postures {
            let place = self.place(state, posture, &others);
            if nodes.last().is_none_or(|((last, _), _)| *last != place) {
                nodes.push(((place, others.clone()), posture));
            }
        }
        nodes
    }

    /// Returns the nodes that follow a node.
    fn next(&mut self, (place, others): &Node, rests: StopAt) -> Vec<(Node, By)> {
        let mut next = Vec::new();
        for (posture, to) in self.places[*place as usize].lands.clone() {
            let node = (self.place(to.state, to.posture, others), others.clone());
            next.push((node, By::Lands(posture, to)));
        }
        let place = &self.places[*place as usize];
        let shapes = if rests == StopAt::Landings { &place.landings } else { &place.shapes };
        for rests in if others.is_empty() { Vec::new() } else { shapes.clone() } {
            for i in 0..others.len() {
                let mut resting = others.clone();
                let woken = std::mem::replace(&mut resting[i], rests);
                let nodes = self.wake(woken, resting).into_iter();
                // A node without any move adds no states.
                let free = nodes.filter(|((place, _), _)| self.places[*place as usize].is_free());
                next.extend(free.map(|(node, posture)| (node, By::Wakes { rests, woken, posture })));
            }
        }
        next
    }

    /// Returns everything that one body reaches while all others stay where they are.
    pub fn reachable(&mut self, poses: &[Pose], body: usize) -> Reachable {
        let from = poses[body];
        let others = poses.iter().enumerate().filter(|(i, _)| *i != body);
        let others: Vec<u32> = others.map(|(_, p)| self.shape(p.state, vec![p.posture])).collect();
        let mut reachable = Reachable { body, stays: Vec::new(), rests: Vec::new(), fills: None };
        let (mut seen, mut found) = (BTreeSet::new(), vec![Stay { before: None, pose: from }]);
        let mut places = Vec::new();
        for at in 0.. {
            for stay in found {
                let place = self.place(stay.pose.state, stay.pose.posture, &others);
                if seen.insert(place) {
                    reachable.stays.push(stay);
                    places.push(place);
                }
            }
            let Some(place) = places.get(at).map(|number| &self.places[*number as usize]) else { break };
            reachable
                .rests
                .extend(place.shapes.iter().map(|s| (at, first(&self.shapes[*s as usize].postures))));
            reachable.fills = reachable.fills.or(place.fills.map(|posture| (at, posture)));
            found = place.lands.iter().map(|(by, to)| Stay { before: Some((at, *by)), pose: *to }).collect();
        }
        reachable
    }

    /// Explores the states of a group with no other body present. Returns the cells that it never leaves, and
    /// whether one of it fills a seed; `None` if it has more than `most` states.
    pub fn explore(&mut self, group: &[usize], most: usize) -> Option<(BTreeSet<Cell>, bool)> {
        let cells = |state_space: &StateSpace<'_>, shape: u32| state_space.shapes[shape as usize].cells;
        let mut front: Vec<Node> = self.begin(group).into_iter().map(|(node, _)| node).collect();
        let mut seen: BTreeSet<Node> = front.iter().cloned().collect();
        let stays = group.iter().flat_map(|i| self.standstill.setup.motions.cells(self.standstill.free[*i]));
        let (mut stays, mut fills): (BTreeSet<Cell>, _) = (stays.collect(), false);
        while let Some(node) = front.pop() {
            let place = &self.places[node.0 as usize];
            fills |= place.fills.is_some();
            let others: Vec<Cell> = node.1.iter().flat_map(|s| cells(self, *s)).collect();
            for shape in &place.shapes {
                let mine = cells(self, *shape);
                stays.retain(|c| others.contains(c) || mine.contains(c));
            }
            let next = self.next(&node, StopAt::Everything).into_iter().map(|(node, _)| node);
            front.extend(next.filter(|node| seen.insert(node.clone())));
            if seen.len() > most {
                return None;
            }
        }
        Some((stays, fills))
    }

    /// Runs a best-first search from all these starts, by distance to the nearest seed. A plan that `accepts` refuses is passed over;
    /// if there are only such, the result is undecided.
    pub fn search(
        &mut self,
        starts: &[Vec<usize>],
        rests: StopAt,
        work: usize,
        accepts: &mut dyn FnMut(&[Move]) -> bool,
    ) -> SearchResult {
        self.work = 0;
        let mut is_refused = false;
        let (mut seen, mut front) = (BTreeSet::new(), BinaryHeap::new());
        let mut trail: Vec<(Option<usize>, By, Node)> = Vec::new();
        let mut found: Vec<(Node, By)> = starts.iter().flat_map(|start| self.begin(start)).collect();
        let (mut before, mut moves) = (None, 0);
        loop {
            for (node, by) in found {
                if !seen.insert(node.clone()) {
                    continue;
                }
                let place = &self.places[node.0 as usize];
                let (fills, steps) = (place.fills, place.steps);
                let resting = node.1.iter().map(|s| self.shapes[*s as usize].steps);
                let nearest = resting.chain([steps]).min();
                let moves = moves + usize::from(matches!(by, By::Lands(..)));
                front.push(Reverse((nearest, moves, trail.len())));
                trail.push((before, by, node));
                if let Some(posture) = fills {
                    let path = self.path(&trail, posture);
                    if accepts(&path) {
                        return SearchResult::Path(path);
                    }
                    is_refused = true;
                }
            }
            if self.work > work {
                return SearchResult::Undecided;
            }
            let Some(Reverse((_, made, at))) = front.pop() else { break };
            (before, moves) = (Some(at), made);
            let node = trail[at].2.clone();
            found = self.next(&node, rests);
        }
        match rests {
            StopAt::Everything if !is_refused => SearchResult::NoWay(seen.len()),
            StopAt::Everything | StopAt::Landings => SearchResult::Undecided,
        }
    }

    /// Returns the moves that lead to the last node, followed by the turn to the posture that fills a seed.
    fn path(&self, trail: &[(Option<usize>, By, Node)], fills: u16) -> Vec<Move> {
        let mut steps = Vec::new();
        let mut at = trail.len().checked_sub(1);
        while let Some((before, by, _)) = at.map(|at| &trail[at]) {
            steps.push(*by);
            at = *before;
        }
        steps.reverse();
        let mut poses = self.standstill.free.clone();
        // By shape: the body at rest in it, and the index of the move that brought it there. The posture of
        // that move is corrected once the body moves on.
        let mut rests: BTreeMap<u32, (usize, usize)> = BTreeMap::new();
        let (mut moves, mut mover) = (Vec::<Move>::new(), 0);
        let turn = |body: usize, from: Pose, posture: u16| Move { body, from, posture, lands: false };
        for by in steps {
            match by {
                By::Begins(body) => mover = body,
                By::Lands(posture, to) => {
                    moves.push(Move { lands: true, ..turn(mover, poses[mover], posture) });
                    poses[mover] = to;
                }
                By::Wakes { rests: shape, woken, posture } => {
                    let Shape { state, postures, .. } = &self.shapes[shape as usize];
                    rests.insert(shape, (mover, moves.len()));
                    moves.push(turn(mover, poses[mover], first(postures)));
                    poses[mover] = attached(*state, first(postures));
                    let moved = rests.remove(&woken);
                    if let Some((body, at)) = moved {
                        (moves[at].posture, mover) = (posture, body);
                    } else {
                        // No move led to this shape, so the body in it has not moved since the start.
                        let Shape { state, postures, .. } = &self.shapes[woken as usize];
                        let stands = |p: &Pose| p.state == *state && Some(&p.posture) == postures.first();
                        mover = poses.iter().position(stands).unwrap_or(mover);
                    }
                    poses[mover].posture = posture;
                }
            }
        }
        moves.retain(|m| m.lands || m.posture != m.from.posture);
        moves.push(turn(mover, poses[mover], fills));
        moves
    }
}

impl Place {
    /// True if the body can land or change its shape here.
    fn is_free(&self) -> bool {
        self.shapes.len() > 1 || !self.lands.is_empty()
    }
}

/// Returns the pose of a body attached by its foot.
fn attached(state: GridState, posture: u16) -> Pose {
    Pose::standing(state, posture)
}

/// Returns the first posture of a shape, which has at least one.
fn first(postures: &[u16]) -> u16 {
    postures.first().copied().unwrap_or_default()
}
