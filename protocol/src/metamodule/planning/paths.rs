//! Ways over the floor: courses of strides to a seed, or out of the way.
//!
//! The search is exact on the motion database: every landing of every posture with everything that it
//! sweeps, every class. What moves is not in it; whoever asks says which cells are taken.

use super::distances::{Distances, index, states};
use super::graph::{Bits, Reach};
use crate::lattice::Cell;
use crate::metamodule::blueprint::Seed;
use crate::metamodule::motions::Motions;
use crate::metamodule::params::Floor;
use crate::metamodule::pose::{Pose, to_frame};
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::sync::Arc;

/// A way: strides, and the posture to take at its end.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Default)]
pub struct Route {
    /// The postures that land, one after the other, each seen from the end that is attached then.
    pub steps: Vec<u16>,
    /// The posture to take after the last stride; none to stay as landed.
    pub last: Option<u16>,
}

impl Route {
    /// Whether nothing is left to do.
    pub fn is_over(&self) -> bool {
        self.steps.is_empty() && self.last.is_none()
    }
    /// The posture to turn to next, and whether it lands.
    pub fn next(&self) -> Option<(u16, bool)> {
        self.steps.first().map(|p| (*p, true)).or(self.last.map(|p| (p, false)))
    }
    /// What is next has been done.
    pub fn advance(&mut self) {
        if self.steps.is_empty() {
            self.last = None;
        } else {
            self.steps.remove(0);
        }
    }
}

/// A floor with some cells taken.
pub struct Ground<'a> {
    /// What bodies can do.
    pub motions: &'a Motions,
    /// The connectors.
    pub floor: Floor,
    /// Cells to keep out of.
    pub taken: &'a [Cell],
}

/// What a stride costs in units of a turn: a stride more is only worth it to save this many turns.
const STRIDE: u32 = 64;
/// About as many turns as a stride takes. A little too many, so that of equally long ways the one that
/// is nearly there is looked at first; it is too little to matter beside [`STRIDE`].
const TURNS: u32 = 6;
/// So many places are left in one search, at most. The floor of the published experiment has about a
/// thousand; a search that finds its goal leaves a few.
const MOST_LEFT: usize = 20_000;
/// So many strides to get out of the way, at most.
const MOST_ASIDE: u32 = 4;

struct Node {
    pose: Pose,
    cost: u32,
    /// The node before and the posture that landed here.
    by: Option<(u32, u16)>,
}

/// Places that a search has left.
pub(super) struct Left {
    /// For every grid state the postures that land there.
    postures: Vec<u128>,
    count: usize,
    floor: Floor,
}

impl Left {
    pub fn new(floor: Floor) -> Left {
        Left { postures: vec![0; states(floor)], count: 0, floor }
    }
    /// Whether one of these postures has been there.
    pub fn has(&self, pose: Pose, postures: u128) -> bool {
        self.postures[index(self.floor, pose.state)] & postures != 0
    }
    pub fn add(&mut self, pose: Pose, postures: u128) {
        self.postures[index(self.floor, pose.state)] |= postures;
        self.count += 1;
    }
    /// Whether another place may be left.
    pub fn is_bounded(&self) -> bool {
        self.count < MOST_LEFT
    }
}

impl Ground<'_> {
    /// The taken cells as a body in this place sees them.
    pub fn taken_at(&self, pose: Pose) -> Bits {
        self.motions.graph().seen_from(pose.state, self.taken)
    }
    /// What can be got to without leaving the place.
    pub fn reach(&self, pose: Pose) -> Arc<Reach> {
        self.motions.graph().reach(pose.posture, self.taken_at(pose))
    }
    /// Where that lands, as bits; much less work.
    pub fn lands(&self, pose: Pose) -> u128 {
        self.motions.graph().lands(pose.posture, self.taken_at(pose))
    }
    /// Where a body is after it has landed by this posture; none if there is no connector.
    pub fn landed(&self, pose: Pose, posture: u16) -> Option<Pose> {
        let to = self.motions.turned_around(Pose { posture, ..pose })?;
        self.floor.has(to.state.x, to.state.y).then_some(Pose { both: false, ..to })
    }
    /// The posture that fills a seed from its connector with the steps to it, if there is a way to it.
    pub fn filling(&self, pose: Pose, seed: Seed) -> Option<(u16, u8)> {
        let chain = self.motions.chain_of(seed.cells().map(|c| to_frame(pose.state, c)))?;
        self.reach(pose).chains.get(usize::from(chain)).copied().flatten()
    }

    /// A course to a seed with the fewest strides, and with few turns, of at most `most` strides.
    /// `fixed` are those of the taken cells that stay taken.
    pub fn to_seed(&self, from: Pose, seed: Seed, fixed: &[Cell], most: usize) -> Option<Route> {
        if seed.cells().iter().any(|c| self.taken.contains(c)) {
            return None;
        }
        let distances = self.motions.distances(self.floor, seed, fixed);
        self.find_seed(from, seed, &distances, u32::try_from(most).unwrap_or(u32::MAX))
    }

    fn find_seed(&self, from: Pose, seed: Seed, distances: &Distances, most: u32) -> Option<Route> {
        // What moves can only make a way longer, so the strides around what does not move are a bound.
        let left_to_go = |pose: Pose, postures: u128| {
            let steps = u32::from(distances.steps(pose, postures)?);
            (steps <= most).then_some(steps)
        };
        let mut nodes = vec![Node { pose: from, cost: 0, by: None }];
        let mut queue = BinaryHeap::from([(Reverse(0), Reverse(0u32), None)]);
        let mut left = Left::new(self.floor);
        while let Some((_, Reverse(at), last)) = queue.pop() {
            if let Some(last) = last {
                return Some(route(&nodes, at, Some(last)));
            }
            let Node { pose, cost, .. } = nodes[at as usize];
            if left.has(pose, self.motions.rest_bit(pose.posture)) {
                continue;
            }
            let reach = self.reach(pose);
            if pose.foot() == seed.foot
                && let Some((last, turns)) = self.filling(pose, seed)
            {
                queue.push((Reverse(cost + u32::from(turns)), Reverse(at), Some(last)));
            }
            if !left.is_bounded() {
                return None;
            }
            left.add(pose, reach.lands);
            for landed in &reach.landings {
                let Some(to) = self.landed(pose, landed.posture) else { continue };
                let bit = self.motions.rest_bit(to.posture);
                if left.has(to, bit) {
                    continue;
                }
                let cost = cost + STRIDE + u32::from(landed.turns);
                let Some(to_go) = left_to_go(to, bit).filter(|g| cost / STRIDE + g <= most) else { continue };
                queue.push((Reverse(cost + to_go * (STRIDE + TURNS)), Reverse(nodes.len() as u32), None));
                nodes.push(Node { pose: to, cost, by: Some((at, landed.posture)) });
            }
        }
        None
    }

    /// The cheapest course to a pose that `fits`; changing its shape on the spot is the cheapest of all.
    pub fn aside(&self, from: Pose, mut fits: impl FnMut(Pose) -> bool) -> Option<Route> {
        let mut nodes = vec![Node { pose: from, cost: 0, by: None }];
        let mut queue = BinaryHeap::from([(Reverse(0), Reverse(0u32), None)]);
        let mut left = Left::new(self.floor);
        while let Some((_, Reverse(at), last)) = queue.pop() {
            let Node { pose, cost, .. } = nodes[at as usize];
            if let Some(last) = last {
                return Some(route(&nodes, at, (pose.posture != last).then_some(last)));
            }
            if left.has(pose, self.motions.rest_bit(pose.posture)) {
                continue;
            }
            let reach = self.reach(pose);
            let mut rests: Vec<(u16, u8)> = reach.chains.iter().flatten().copied().collect();
            rests.sort_by_key(|(_, turns)| *turns);
            if let Some((last, turns)) = rests.into_iter().find(|(p, _)| fits(Pose { posture: *p, ..pose })) {
                queue.push((Reverse(cost + u32::from(turns)), Reverse(at), Some(last)));
            }
            if !left.is_bounded() {
                return None;
            }
            left.add(pose, reach.lands);
            if cost / STRIDE >= MOST_ASIDE {
                continue;
            }
            for landed in &reach.landings {
                let Some(to) = self.landed(pose, landed.posture) else { continue };
                if !left.has(to, self.motions.rest_bit(to.posture)) {
                    let cost = cost + STRIDE + u32::from(landed.turns);
                    queue.push((Reverse(cost), Reverse(nodes.len() as u32), None));
                    nodes.push(Node { pose: to, cost, by: Some((at, landed.posture)) });
                }
            }
        }
        None
    }
}

fn route(nodes: &[Node], mut at: u32, last: Option<u16>) -> Route {
    let mut steps = Vec::new();
    while let Some((before, posture)) = nodes[at as usize].by {
        steps.push(posture);
        at = before;
    }
    steps.reverse();
    Route { steps, last }
}
