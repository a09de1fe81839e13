//! The planner of transports: metamodules bring one element from one place to another.
//!
//! The nodes of the manipulation graph are the holds: foothold, grip, and set of postures of the holder. Its edges are
//! hand-overs. A state of the search is a hold with the stands of the other metamodules; its cost counts connections,
//! the landings of walks and the grips. The search ignores the bodies of metamodules that stand still. A plan that it
//! finds is carried out with all bodies; an edge that cannot be is taken out, and the search begins again. If the
//! search ends without a plan before any edge was taken out, there is none.
//!
//! If the task allows it, the element is put down on the floor on the way and picked up again: then the places where it
//! rests are nodes, too.

use super::colour::colours_differ;
use super::resting::{Place, Resting};
use super::scene::{Hold, NO_SET, Transfer};
pub use super::task::{Refutations, Task};
use super::verification::{BodyAction, MoverAction, Situation};
use super::walking::{Body, Motion, Stand, WalkingGround};
use crate::plan::search::{Method, Search};
use crate::plan::{Cost, Limits, Outcome, Space, Step, actions};
use metamorph_core::lattice::Cell;
use metamorph_core::names;
use std::collections::{BTreeMap, BTreeSet, HashMap, VecDeque};
use std::ops::Range;

/// Largest number of expansions of one search.
const MAX_EXPANSIONS: u64 = 1_000_000;
/// Memory of one search in bytes: 256 MiB.
const MEMORY: usize = 256 << 20;

/// Why there is no plan with lattice angles: none in which the element is always held, or, if it may be put down, none at all.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum TransportReason {
    /// The goal has cells of the other colour.
    Colour,
    /// No metamodule can hold the element where it is.
    NoGrip,
    /// No metamodule can hold the element at its goal.
    NoPlace,
    /// No sequence of hand-overs leads to the goal.
    NoTransfer,
    /// The metamodules cannot walk to where they are needed.
    NoWalk,
}

names!(TransportReason {
    Colour => "colour",
    NoGrip => "no-grip",
    NoPlace => "no-place",
    NoTransfer => "no-transfer",
    NoWalk => "no-walk",
});

/// A plan that was carried out with all bodies.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ManipulationPlan {
    /// The actions in order.
    pub actions: Vec<MoverAction>,
    /// The number of hand-overs.
    pub hand_overs: u32,
    /// The connections that the search counted, without the bodies of metamodules that stand still.
    pub relaxed: Cost,
    /// The proven least number of connections, if no edge was taken out; with weight 1 it is [`Plan::relaxed`].
    pub lower: Cost,
    /// The number of edges that were taken out before.
    pub refutations: usize,
}

impl ManipulationPlan {
    /// Returns the number of connections of all metamodules: landings and grips.
    pub fn connections(&self) -> u32 {
        let connects = |action: &&MoverAction| {
            matches!(action.body_action, BodyAction::Move(Motion::Land(_)) | BodyAction::Grip { .. })
        };
        self.actions.iter().filter(connects).count() as u32
    }
    /// Returns the sum of all joint motions, in degrees.
    pub fn degrees(&self) -> u32 {
        let angle = |action: &MoverAction| match action.body_action {
            BodyAction::Move(Motion::Turn { degrees, .. }) => u32::from(degrees),
            _ => 0,
        };
        self.actions.iter().map(angle).sum()
    }
}

/// The answer to a task.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// A plan.
    Plan(ManipulationPlan),
    /// There is no plan with lattice angles.
    Infeasible(TransportReason),
    /// Neither a plan nor a proof was found.
    Undecided {
        /// The number of edges that were taken out.
        refutations: usize,
    },
}

/// Plans a transport.
pub fn plan(ground: &WalkingGround<'_>, task: &Task) -> Answer {
    match colours_differ(&task.start, &task.goal) {
        true => Answer::Infeasible(TransportReason::Colour),
        false => plan_any_colour(ground, task),
    }
}

/// Plans a transport without a look at colours first. If they differ, the search finds that there is no plan.
pub fn plan_any_colour(ground: &WalkingGround<'_>, task: &Task) -> Answer {
    let mut graph = match Relaxed::new(ground, task) {
        Ok(graph) => graph,
        Err(reason) => return Answer::Infeasible(reason),
    };
    let mut refutations = 0;
    loop {
        if refutations > task.refutations.most {
            return Answer::Undecided { refutations };
        }
        let limits = Limits { memory: MEMORY, work: MAX_EXPANSIONS };
        let method = Method { weights: vec![task.weight], keep: true, deepen: false };
        let start = graph.start();
        let mut search = Search::new(&graph, &start, limits, method);
        let (path, lower) = match search.advance(u64::MAX) {
            Step::Done(Outcome::Solved { path, lower }) => (path, lower),
            Step::Done(Outcome::Impossible { .. }) if refutations == 0 => {
                return Answer::Infeasible(TransportReason::NoWalk);
            }
            _ => return Answer::Undecided { refutations },
        };
        let edges = actions(&&graph, &start, &path.keys).unwrap_or_default();
        match graph.carried_out(&path.keys, &edges) {
            Ok(situation) => {
                let is_hand_over = |edge: &&Edge| matches!(edge, Edge::HandOver { .. });
                let hand_overs = edges.iter().filter(is_hand_over).count() as u32;
                let (actions, relaxed) = (situation.actions, path.cost);
                return Answer::Plan(ManipulationPlan { actions, hand_overs, relaxed, lower, refutations });
            }
            Err(failed) => {
                if edges.is_empty() {
                    return Answer::Undecided { refutations };
                }
                // The last edge leads to a goal that cannot be taken from there.
                let edge = failed.min(path.keys.len() - 2);
                graph.ban(&path.keys[edge], &path.keys[edge + 1], refutations < task.refutations.exact);
                refutations += 1;
            }
        }
    }
}

/// The manipulation graph of a task, without the bodies of metamodules that stand still.
struct Relaxed<'a> {
    ground: &'a WalkingGround<'a>,
    task: &'a Task,
    /// The places where the element can rest; the first is that of the start, if it rests there.
    resting: Resting,
    /// The ways to hold the element at the goal.
    goals: Vec<(Hold, u16)>,
    /// The place where the element shall rest.
    goal: Option<Place>,
    /// How the element is held at the start.
    held: Option<(u8, Hold)>,
    left: Left,
    /// Edges that cannot be carried out, by the keys of their states, whole or of the element only.
    banned: BTreeSet<(Vec<u8>, Vec<u8>)>,
    /// The situation at the start.
    begun: Situation<'a>,
    /// By the keys of a path, the situation at its end and how the element is held or was held last: paths of later searches
    /// begin alike.
    carried: BTreeMap<Vec<Vec<u8>>, (Situation<'a>, Hold)>,
}

/// Approximate number of situations that are kept.
const MAX_KEPT: usize = 32;

/// The part of a key that says where the element is and how it is held, but not by which metamodule.
const OF_ELEMENT: Range<usize> = 1..6;

/// A state: who holds the element and how, or where it rests, and the stands of all. That of the holder is where it stands,
/// without a set.
#[derive(Clone, Debug, PartialEq, Eq)]
struct State {
    holder: Option<(u8, Hold)>,
    place: Place,
    stands: Vec<Stand>,
}

/// An edge: who takes the element and how, or where it is put down.
#[derive(Clone, Copy, Debug)]
enum Edge {
    PickUp { receiver: u8, from: Place, hold: Hold, came: u16 },
    HandOver { receiver: u8, to: u16, way: Transfer },
    PutDown { hold: Hold, to: Place, left: u16 },
}

/// The fewest grips that are left to the goal, from holds and from places.
#[derive(Default)]
struct Left {
    holds: HashMap<Hold, u16>,
    places: HashMap<Place, u16>,
}

impl<'a> Relaxed<'a> {
    fn new(ground: &'a WalkingGround<'a>, task: &'a Task) -> Result<Relaxed<'a>, TransportReason> {
        let holds = |cells: &[Cell]| {
            let mut holds = ground.scene().holds_at(cells);
            holds.retain(|(hold, _)| ground.exists(hold.foothold));
            holds
        };
        let scene = ground.scene();
        let held = task.held_by.map(|(holder, grip)| {
            let Body { foothold, posture } = task.bodies[usize::from(holder)];
            let set = scene.holding(foothold, grip)[usize::from(posture)];
            (holder, Hold { foothold, grip, set })
        });
        let picks = if held.is_some() { Vec::new() } else { holds(&task.start) };
        let mut goals = if task.rests { Vec::new() } else { holds(&task.goal) };
        if let Some(ends) = &task.ends {
            goals.retain(|(hold, posture)| ends.contains(&scene.body(hold.foothold, *posture)));
        }
        if picks.is_empty() && held.is_none_or(|(_, hold)| hold.set == NO_SET) {
            return Err(TransportReason::NoGrip);
        }
        let at_rest = held.is_none().then(|| (task.start.clone(), picks.clone()));
        let mut resting = Resting::of_places(at_rest);
        if task.puts_down || task.rests {
            resting.add_floor(ground, &task.fixed);
        }
        let goal = resting.find(&task.goal).filter(|_| task.rests);
        if goals.is_empty() && goal.is_none_or(|goal| resting.holds(goal).is_empty()) {
            return Err(TransportReason::NoPlace);
        }
        let left = Left::new(ground, &resting, &goals, goal);
        let mut holds = picks.iter().map(|(hold, _)| hold).chain(held.iter().map(|(_, hold)| hold));
        if !holds.any(|hold| left.holds.contains_key(hold)) {
            return Err(TransportReason::NoTransfer);
        }
        let (begun, carried) = (Situation::new(ground, task), BTreeMap::new());
        Ok(Relaxed {
            ground,
            task,
            resting,
            goals,
            goal,
            held,
            left,
            banned: BTreeSet::new(),
            begun,
            carried,
        })
    }

    /// Takes an edge out, where all metamodules stand as in these states, or wherever they stand.
    fn ban(&mut self, from: &[u8], to: &[u8], is_exact: bool) {
        let part = if is_exact { 0..from.len() } else { OF_ELEMENT };
        self.banned.insert((from[part.clone()].to_vec(), to[part].to_vec()));
    }

    fn is_banned(&self, from: &[u8], to: &[u8]) -> bool {
        let has =
            |part: Range<usize>| self.banned.contains(&(from[part.clone()].to_vec(), to[part].to_vec()));
        !self.banned.is_empty() && (has(0..from.len()) || has(OF_ELEMENT))
    }

    fn start(&self) -> State {
        let stand = |body: &Body| {
            (body.foothold, self.ground.scene().empty(body.foothold)[usize::from(body.posture)])
        };
        let mut stands: Vec<Stand> = self.task.bodies.iter().map(stand).collect();
        if let Some((holder, hold)) = self.held {
            stands[usize::from(holder)] = (hold.foothold, NO_SET);
        }
        State { holder: self.held, place: 0, stands }
    }

    fn empty(&self, hold: &Hold, posture: u16) -> u16 {
        self.ground.scene().empty(hold.foothold)[usize::from(posture)]
    }

    /// Carries out the edges of a path, and then places the element. On failure returns the number of the edge that cannot be
    /// carried out; the number of all edges if it is the placing.
    fn carried_out(&mut self, keys: &[Vec<u8>], edges: &[Edge]) -> Result<Situation<'a>, usize> {
        if self.carried.len() > MAX_KEPT {
            self.carried.clear();
        }
        let mut at = self.begun.clone();
        let mut last = self.held.map(|(_, hold)| hold);
        for (i, edge) in edges.iter().enumerate() {
            let path = &keys[..i + 2];
            if let Some((known, hold)) = self.carried.get(path) {
                (at, last) = (known.clone(), Some(*hold));
                continue;
            }
            let (next, hold) = match edge {
                Edge::PickUp { receiver, from, hold, came } => {
                    let same = |(h, p): &&(Hold, u16)| h == hold && self.empty(h, *p) == *came;
                    let holds: Vec<_> = self.resting.holds(*from).iter().filter(same).copied().collect();
                    (at.picked_up(usize::from(*receiver), &holds), *hold)
                }
                Edge::HandOver { receiver, to, way } => {
                    let hold = Hold { foothold: *to, grip: way.receiver.0, set: way.receiver.1 };
                    (at.handed_over(usize::from(*receiver), *to, way), hold)
                }
                Edge::PutDown { hold, to, left } => {
                    let lies = |(p, posture): &&(Place, u16)| p == to && self.empty(hold, *posture) == *left;
                    let postures = self.resting.places_of(hold).iter().filter(lies).map(|(_, p)| *p);
                    (at.put_down(&postures.collect::<Vec<u16>>()), *hold)
                }
            };
            (at, last) = (next.ok_or(i)?, Some(hold));
            self.carried.insert(path.to_vec(), (at.clone(), hold));
        }
        if self.goal.is_some() {
            return Ok(at);
        }
        let goals: Vec<_> = self.goals.iter().filter(|(h, _)| Some(*h) == last).copied().collect();
        at.placed(&goals).ok_or(edges.len())
    }

    fn visit(
        &self,
        from: &State,
        (receiver, before, came): (usize, Stand, u16),
        (hold, left): (Hold, Option<u16>),
    ) -> Option<(Cost, State)> {
        let to = (hold.foothold, came);
        let walk = *self.ground.distances(before).get(&to)?;
        let mut stands = from.stands.clone();
        if let (Some((holder, _)), Some(left)) = (from.holder, left) {
            stands[usize::from(holder)].1 = left;
        }
        stands[receiver] = (hold.foothold, NO_SET);
        Some((Cost::from(walk) + 1, State { holder: Some((receiver as u8, hold)), place: 0, stands }))
    }
}

impl Left {
    /// Counts from every hold and place to the nearest goal: the holds, or the place. Hand-overs can be taken
    /// backwards, and an element can be picked up where it can be put down.
    fn new(
        ground: &WalkingGround<'_>,
        resting: &Resting,
        goals: &[(Hold, u16)],
        goal: Option<Place>,
    ) -> Left {
        let (mut left, mut open) = (Left::default(), VecDeque::new());
        let reach = |left: &mut Left, open: &mut VecDeque<Hold>, hold: Hold, n: u16| {
            left.holds.entry(hold).or_insert_with(|| {
                open.push_back(hold);
                n
            });
        };
        goals.iter().for_each(|(hold, _)| reach(&mut left, &mut open, *hold, 0));
        if let Some(goal) = goal {
            left.places.insert(goal, 0);
            resting.holds(goal).iter().for_each(|(hold, _)| reach(&mut left, &mut open, *hold, 0));
        }
        while let Some(at) = open.pop_front() {
            let next = left.holds[&at] + 1;
            ground.ways_from(&at).for_each(|(to, _)| reach(&mut left, &mut open, to, next));
            for (place, _) in resting.places_of(&at) {
                if left.places.contains_key(place) {
                    continue;
                }
                left.places.insert(*place, next);
                resting.holds(*place).iter().for_each(|(hold, _)| reach(&mut left, &mut open, *hold, next));
            }
        }
        left
    }
}

impl Space for &Relaxed<'_> {
    type State = State;
    type Action = Edge;

    fn key_width(&self) -> usize {
        6 + 4 * self.task.bodies.len()
    }
    fn key(&self, state: &State, key: &mut [u8]) {
        key.fill(u8::MAX);
        key[4..6].copy_from_slice(&state.place.to_be_bytes());
        if let Some((holder, hold)) = &state.holder {
            key[0] = *holder;
            key[1] = hold.grip;
            key[2..4].copy_from_slice(&hold.foothold.to_be_bytes());
            key[4..6].copy_from_slice(&hold.set.to_be_bytes());
        }
        for (bytes, (foothold, set)) in key[6..].chunks_exact_mut(4).zip(&state.stands) {
            bytes[..2].copy_from_slice(&foothold.to_be_bytes());
            bytes[2..].copy_from_slice(&set.to_be_bytes());
        }
    }
    fn state(&self, key: &[u8]) -> State {
        let number = |i: usize| u16::from_be_bytes([key[i], key[i + 1]]);
        let hold = Hold { grip: key[1], foothold: number(2), set: number(4) };
        let holder = (key[0] != u8::MAX).then_some((key[0], hold));
        let stands = (6..key.len()).step_by(4).map(|i| (number(i), number(i + 2))).collect();
        let place = if holder.is_none() { number(4) } else { 0 };
        State { holder, place, stands }
    }
    fn expand(&self, state: &State, visit: &mut impl FnMut(Edge, Cost, &State)) {
        let mut from = vec![0; self.key_width()];
        self.key(state, &mut from);
        let mut key = from.clone();
        let mut unless_banned = |edge: Edge, found: Option<(Cost, State)>| {
            let Some((cost, to)) = found else { return };
            self.key(&to, &mut key);
            if !self.is_banned(&from, &key) {
                visit(edge, cost, &to);
            }
        };
        if let Some((holder, hold)) = &state.holder {
            let places = self.resting.places_of(hold).iter();
            let places: BTreeSet<(Place, u16)> = places.map(|(to, p)| (*to, self.empty(hold, *p))).collect();
            for (to, left) in places {
                let mut stands = state.stands.clone();
                stands[usize::from(*holder)].1 = left;
                let after = State { holder: None, place: to, stands };
                unless_banned(Edge::PutDown { hold: *hold, to, left }, Some((0, after)));
            }
        }
        let movers =
            (0..state.stands.len()).filter(|i| state.holder.is_none_or(|(h, _)| usize::from(h) != *i));
        for receiver in movers {
            let before = state.stands[receiver];
            let Some((_, held)) = &state.holder else {
                let from = state.place;
                let picks = self.resting.holds(from).iter();
                let picks: BTreeSet<(Hold, u16)> =
                    picks.map(|(hold, p)| (*hold, self.empty(hold, *p))).collect();
                for (hold, came) in picks {
                    let edge = Edge::PickUp { receiver: receiver as u8, from, hold, came };
                    unless_banned(edge, self.visit(state, (receiver, before, came), (hold, None)));
                }
                continue;
            };
            for (hold, way) in self.ground.ways_from(held) {
                let edge = Edge::HandOver { receiver: receiver as u8, to: hold.foothold, way: *way };
                let found = self.visit(state, (receiver, before, way.came), (hold, Some(way.left)));
                unless_banned(edge, found);
            }
        }
    }
    fn lower(&self, state: &State) -> Option<Cost> {
        match &state.holder {
            Some((_, hold)) => self.left.holds.get(hold).map(|n| Cost::from(*n)),
            None if self.goal == Some(state.place) => Some(0),
            None => {
                let holds = self.resting.holds(state.place).iter();
                let least = holds.filter_map(|(hold, _)| self.left.holds.get(hold)).min();
                least.map(|n| Cost::from(*n) + 1)
            }
        }
    }
    fn is_goal(&self, state: &State) -> bool {
        match (&state.holder, self.goal) {
            (None, Some(goal)) => state.place == goal,
            (Some((_, hold)), None) => self.left.holds.get(hold) == Some(&0),
            _ => false,
        }
    }
}
