//! Ways over the floor: courses of strides to a seed, or out of the way.
//!
//! The search is exact on the motion database: every landing of every posture with everything that it
//! sweeps, every class. What moves is not in it; whoever asks says which cells are taken.

use super::blueprint::Seed;
use super::graph::{Bits, Reach};
use super::motions::Motions;
use super::params::Floor;
use super::pose::{Pose, to_frame};
use crate::lattice::Cell;
use crate::roombots::grid::GridState;
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::sync::Arc;

/// A way: strides, and the posture to take at its end.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Default)]
pub struct Course {
    /// The postures that land, one after the other, each seen from the end that is attached then.
    pub strides: Vec<u16>,
    /// The posture to take after the last stride; none to stay as landed.
    pub last: Option<u16>,
}

impl Course {
    /// Whether nothing is left to do.
    pub fn is_over(&self) -> bool {
        self.strides.is_empty() && self.last.is_none()
    }
    /// The posture to turn to next, and whether it lands.
    pub fn next(&self) -> Option<(u16, bool)> {
        self.strides.first().map(|p| (*p, true)).or(self.last.map(|p| (p, false)))
    }
    /// What is next has been done.
    pub fn advance(&mut self) {
        if self.strides.is_empty() {
            self.last = None;
        } else {
            self.strides.remove(0);
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
/// No stride needs fewer turns.
const TURNS: u32 = 3;
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

/// Places that have been left. All postures at one connector that can be got to from each other are
/// one place: whoever has come to one of them has come to all.
struct Left {
    /// The first entry of every grid state, plus one.
    first: Vec<u32>,
    /// The postures of a place that land, and the next entry of the same state, plus one.
    entries: Vec<(u128, u32)>,
    floor: Floor,
}

impl Left {
    fn new(floor: Floor) -> Left {
        let side = |a: i16, b: i16| usize::from(b.abs_diff(a)) + 1;
        let states = side(floor.min.0, floor.max.0) * side(floor.min.1, floor.max.1) * 4;
        Left { first: vec![0; states], entries: Vec::new(), floor }
    }
    /// Invariant: poses on their way through a search stand on the floor.
    fn index(&self, pose: Pose) -> usize {
        let (x, y) = (pose.state.x.abs_diff(self.floor.min.0), pose.state.y.abs_diff(self.floor.min.1));
        let wide = usize::from(self.floor.max.0.abs_diff(self.floor.min.0)) + 1;
        (usize::from(y) * wide + usize::from(x)) * 4 + usize::from(pose.state.class)
    }
    fn has(&self, motions: &Motions, pose: Pose) -> bool {
        let Some(bit) = motions.rest(pose.posture) else { return false };
        let mut at = self.first[self.index(pose)];
        while let Some((postures, next)) = at.checked_sub(1).map(|i| self.entries[i as usize]) {
            if postures >> bit & 1 == 1 {
                return true;
            }
            at = next;
        }
        false
    }
    fn leave(&mut self, pose: Pose, reach: &Reach) {
        let index = self.index(pose);
        self.entries.push((reach.lands, self.first[index]));
        self.first[index] = self.entries.len() as u32;
    }
}

impl Ground<'_> {
    /// The taken cells as a body in this place sees them.
    pub fn taken_at(&self, pose: Pose) -> Bits {
        taken_at(self.motions, pose, self.taken)
    }
    /// What can be got to without leaving the place.
    pub fn reach(&self, pose: Pose) -> Arc<Reach> {
        self.motions.graph().reach(pose.posture, self.taken_at(pose))
    }
    /// Where a body is after it has landed by this posture; none if there is no connector.
    pub fn landed(&self, pose: Pose, posture: u16) -> Option<Pose> {
        let to = self.motions.turned_around(Pose { posture, ..pose })?;
        self.floor.has(to.state.x, to.state.y).then_some(Pose { both: false, ..to })
    }
    /// Whether a body in this place can take this posture now.
    pub fn can_take(&self, pose: Pose, posture: u16) -> bool {
        let reach = self.reach(pose);
        match self.motions.graph().landing(posture) {
            Some(_) => reach.landings.iter().any(|l| l.posture == posture),
            None => self.motions.graph().way(pose.posture, posture, self.taken_at(pose)).is_some(),
        }
    }
    /// The posture that fills a seed from its connector with the steps to it, if there is a way to it.
    pub fn filling(&self, pose: Pose, seed: Seed) -> Option<(u16, u8)> {
        let chain = self.motions.chain_of(seed.cells().map(|c| to_frame(pose.state, c)))?;
        self.reach(pose).chains.get(usize::from(chain)).copied().flatten()
    }

    /// A course to a seed with the fewest strides, and with few turns.
    ///
    /// Every motion can be made backwards, so the search begins in the seed and looks for the body:
    /// around the seed, where ways are narrow, it is soon exhausted, and in the open, where bodies
    /// wait, the number of strides that are left is known. Courses of more than `most` strides are not
    /// looked for.
    pub fn to_seed(&self, from: Pose, seed: Seed, most: usize) -> Option<Course> {
        if seed.cells().iter().any(|c| self.taken.contains(c)) || !self.floor.has(seed.foot.0, seed.foot.1) {
            return None;
        }
        let guess = |pose: Pose| {
            let moves = self.motions.moves_between(from.state, pose.state);
            u32::from(moves) * (STRIDE + TURNS)
        };
        let bound = u32::try_from(most).map_or(u32::MAX, |m| m.saturating_add(1).saturating_mul(STRIDE));
        let (mut nodes, mut queue) = (Vec::new(), BinaryHeap::new());
        for class in 0..4 {
            let state = GridState::new(seed.foot.0, seed.foot.1, class);
            let chain = self.motions.chain_of(seed.cells().map(|c| to_frame(state, c)));
            for posture in chain.map_or(&[][..], |c| self.motions.filling(c)) {
                let pose = Pose { state, posture: *posture, ..from };
                queue.push((Reverse(guess(pose)), Reverse(nodes.len() as u32), false));
                nodes.push(Node { pose, cost: 0, by: None });
            }
        }
        let mut left = Left::new(self.floor);
        while let Some((_, Reverse(at), met)) = queue.pop() {
            if met {
                return Some(backwards(&nodes, at));
            }
            let Node { pose, cost, .. } = nodes[at as usize];
            if left.has(self.motions, pose) {
                continue;
            }
            let reach = self.reach(pose);
            if pose.state == from.state
                && let Some((steps, _)) =
                    self.motions.graph().way(pose.posture, from.posture, self.taken_at(pose))
            {
                queue.push((Reverse(cost + steps.len() as u32), Reverse(at), true));
            }
            if left.entries.len() == MOST_LEFT {
                return None;
            }
            left.leave(pose, &reach);
            for landed in &reach.landings {
                let Some(to) = self.landed(pose, landed.posture) else { continue };
                let cost = cost + STRIDE + u32::from(landed.turns);
                let likely = cost + guess(to);
                if likely < bound && !left.has(self.motions, to) {
                    queue.push((Reverse(likely), Reverse(nodes.len() as u32), false));
                    nodes.push(Node { pose: to, cost, by: Some((at, landed.posture)) });
                }
            }
        }
        None
    }

    /// The cheapest course to a place where the body fills only cells that `fits` accepts; changing
    /// its shape on the spot is the cheapest of all.
    pub fn aside(&self, from: Pose, fits: impl Fn(&[Cell; 4]) -> bool) -> Option<Course> {
        let mut nodes = vec![Node { pose: from, cost: 0, by: None }];
        let mut queue = BinaryHeap::from([(Reverse(0), Reverse(0u32), None)]);
        let mut left = Left::new(self.floor);
        while let Some((_, Reverse(at), last)) = queue.pop() {
            let Node { pose, cost, .. } = nodes[at as usize];
            if let Some(last) = last {
                return Some(forwards(&nodes, at, (pose.posture != last).then_some(last)));
            }
            if left.has(self.motions, pose) {
                continue;
            }
            let reach = self.reach(pose);
            let rests = reach.chains.iter().flatten();
            let fitting = rests.filter(|(p, _)| fits(&self.motions.cells(Pose { posture: *p, ..pose })));
            if let Some((last, turns)) = fitting.min_by_key(|(_, turns)| *turns) {
                queue.push((Reverse(cost + u32::from(*turns)), Reverse(at), Some(*last)));
            }
            if left.entries.len() == MOST_LEFT {
                return None;
            }
            left.leave(pose, &reach);
            if cost / STRIDE >= MOST_ASIDE {
                continue;
            }
            for landed in &reach.landings {
                let Some(to) = self.landed(pose, landed.posture) else { continue };
                if !left.has(self.motions, to) {
                    let cost = cost + STRIDE + u32::from(landed.turns);
                    queue.push((Reverse(cost), Reverse(nodes.len() as u32), None));
                    nodes.push(Node { pose: to, cost, by: Some((at, landed.posture)) });
                }
            }
        }
        None
    }
}

/// The taken cells as a body in this place sees them.
pub fn taken_at(motions: &Motions, pose: Pose, taken: &[Cell]) -> Bits {
    taken.iter().fold(0, |bits, cell| bits | motions.graph().bit(to_frame(pose.state, *cell)))
}

/// The course from a node that was come to from the end: whoever stands there lands by its posture
/// where the node before it is, and so on.
fn backwards(nodes: &[Node], mut at: u32) -> Course {
    let mut strides = Vec::new();
    while let Some((before, _)) = nodes[at as usize].by {
        strides.push(nodes[at as usize].pose.posture);
        at = before;
    }
    Course { strides, last: Some(nodes[at as usize].pose.posture) }
}

/// The course to a node that was come to from the beginning.
fn forwards(nodes: &[Node], mut at: u32, last: Option<u16>) -> Course {
    let mut strides = Vec::new();
    while let Some((before, posture)) = nodes[at as usize].by {
        strides.push(posture);
        at = before;
    }
    strides.reverse();
    Course { strides, last }
}
