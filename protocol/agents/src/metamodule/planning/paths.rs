//! Routes over the floor: sequences of steps to a seed, or aside.
//!
//! The search is exact on the motion database: it considers every landing of every posture in every class,
//! with all cells swept. Moving bodies are unknown to it; the caller says which cells are taken.

use super::distances::{Distances, index, states};
use super::graph::{Bits, Reach};
use crate::metamodule::blueprint::{Floor, Seed};
use crate::metamodule::motions::Motions;
use crate::metamodule::pose::{Pose, to_frame};
use metamorph_core::lattice::Cell;
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::sync::Arc;

/// A route: steps, and the posture to take at its end.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Default)]
pub struct Route {
    /// The landing posture of each step, seen from the end that is attached at that time.
    pub steps: Vec<u16>,
    /// The posture to take after the last step; `None` to stay as landed.
    pub last: Option<u16>,
}

impl Route {
    /// True if nothing is left to do.
    pub fn is_over(&self) -> bool {
        self.steps.is_empty() && self.last.is_none()
    }
    /// Returns the posture to turn to next, and whether it lands.
    pub fn next(&self) -> Option<(u16, bool)> {
        self.steps.first().map(|p| (*p, true)).or(self.last.map(|p| (p, false)))
    }
    /// Removes the part that is done.
    pub fn advance(&mut self) {
        if self.steps.is_empty() {
            self.last = None;
        } else {
            self.steps.remove(0);
        }
    }
}

/// A floor with taken cells.
pub struct Ground<'a> {
    /// The motion database.
    pub motions: &'a Motions,
    /// The connectors.
    pub floor: Floor,
    /// The cells that motions must not sweep, in world coordinates.
    pub taken: &'a [Cell],
}

/// Cost of a step in turns: one more step pays off only if it saves more turns than this.
pub(super) const STEP: u32 = 64;
/// Estimated number of turns of a step. Slightly high, so that of equally long routes the one closest to its
/// end is expanded first, and too small to outweigh [`STEP`].
const TURNS: u32 = 6;
/// Number of places that one search may expand. The floor of the published experiment has about 1000; a
/// successful search expands a few.
const MOST_LEFT: usize = 20_000;
/// A pose that a search has found a way to.
#[derive(Clone, Copy)]
pub(super) struct Node {
    pub pose: Pose,
    /// The cost of the way.
    pub cost: u32,
    /// The node before, and the posture that landed here.
    pub by: Option<(u32, u16)>,
}

/// The places that a search has expanded.
pub(super) struct Left {
    /// By grid state: the postures that land there, as bits.
    postures: Vec<u128>,
    count: usize,
    floor: Floor,
}

impl Left {
    pub fn new(floor: Floor) -> Left {
        Left { postures: vec![0; states(floor)], count: 0, floor }
    }
    /// True if a place with one of these postures has been expanded.
    pub fn has(&self, pose: Pose, postures: u128) -> bool {
        self.postures[index(self.floor, pose.state)] & postures != 0
    }
    pub fn add(&mut self, pose: Pose, postures: u128) {
        self.postures[index(self.floor, pose.state)] |= postures;
        self.count += 1;
    }
    /// True if another place may be expanded.
    pub fn is_bounded(&self) -> bool {
        self.count < MOST_LEFT
    }
}

impl Ground<'_> {
    /// Returns the taken cells as bits in the frame of a body's foot.
    pub fn taken_at(&self, pose: Pose) -> Bits {
        self.motions.graph().seen_from(pose.state, self.taken)
    }
    /// Returns what the body can reach without a landing.
    pub fn reach(&self, pose: Pose) -> Arc<Reach> {
        self.motions.graph().reach(pose.posture, self.taken_at(pose))
    }
    /// Returns the landings of [`Ground::reach`] as bits, computed much faster.
    pub fn lands(&self, pose: Pose) -> u128 {
        self.motions.graph().lands(pose.posture, self.taken_at(pose))
    }
    /// Returns the pose after landing by `posture`; `None` if no connector is there.
    pub fn landed(&self, pose: Pose, posture: u16) -> Option<Pose> {
        let to = self.motions.turned_around(Pose { posture, ..pose })?;
        self.floor.has(to.state.x, to.state.y).then_some(Pose { both: false, ..to })
    }
    /// Returns the posture that fills a seed from its connector, and the turns to it; `None` if unreachable.
    pub fn filling(&self, pose: Pose, seed: Seed) -> Option<(u16, u8)> {
        let chain = self.motions.chain_of(seed.cells().map(|c| to_frame(pose.state, c)))?;
        self.reach(pose).chains.get(usize::from(chain)).copied().flatten()
    }

    /// Returns a route to a seed with the fewest steps, at most `most`, and few turns. `fixed` are those
    /// taken cells that stay taken.
    pub fn to_seed(&self, from: Pose, seed: Seed, fixed: &[Cell], most: usize) -> Option<Route> {
        if seed.cells().iter().any(|c| self.taken.contains(c)) {
            return None;
        }
        let distances = self.motions.distances(self.floor, seed, fixed);
        self.find_seed(from, seed, &distances, u32::try_from(most).unwrap_or(u32::MAX))
    }

    fn find_seed(&self, from: Pose, seed: Seed, distances: &Distances, most: u32) -> Option<Route> {
        // Movable obstacles only lengthen a route, so the distance around fixed ones is a lower bound.
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
                let cost = cost + STEP + u32::from(landed.turns);
                let Some(to_go) = left_to_go(to, bit).filter(|g| cost / STEP + g <= most) else { continue };
                queue.push((Reverse(cost + to_go * (STEP + TURNS)), Reverse(nodes.len() as u32), None));
                nodes.push(Node { pose: to, cost, by: Some((at, landed.posture)) });
            }
        }
        None
    }
}

/// Returns the route to a node.
pub(super) fn route(nodes: &[Node], mut at: u32, last: Option<u16>) -> Route {
    let mut steps = Vec::new();
    while let Some((before, posture)) = nodes[at as usize].by {
        steps.push(posture);
        at = before;
    }
    steps.reverse();
    Route { steps, last }
}
