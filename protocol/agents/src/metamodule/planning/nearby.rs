//! The places around a body, to which it may step aside.

use super::paths::{Ground, Left, Node, Route, STEP, route};
use crate::metamodule::pose::Pose;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Largest number of steps aside.
const MOST_ASIDE: u32 = 4;

/// A place that a body can get to.
struct Place {
    /// The number of its node.
    at: u32,
    /// A posture for each chain of cells that it can fill there, with the number of turns to it, nearest first.
    rests: Vec<(u16, u8)>,
}

/// The places around a body by the cost of the way, which are searched as far as questions need them. Several questions about
/// one body on one ground therefore cost one search.
pub struct Nearby<'g> {
    ground: &'g Ground<'g>,
    nodes: Vec<Node>,
    /// Nodes by cost, then by number.
    queue: BinaryHeap<(Reverse<u32>, Reverse<u32>)>,
    left: Left,
    places: Vec<Place>,
}

impl<'g> Nearby<'g> {
    /// Begins a search around a pose.
    pub fn new(ground: &'g Ground<'g>, from: Pose) -> Nearby<'g> {
        let nodes = vec![Node { pose: from, cost: 0, by: None }];
        let queue = BinaryHeap::from([(Reverse(0), Reverse(0))]);
        Nearby { ground, nodes, queue, left: Left::new(ground.floor), places: Vec::new() }
    }

    /// Returns the cheapest route to a pose that `fits`; a change of posture without a step is cheapest.
    pub fn find(&mut self, mut fits: impl FnMut(Pose) -> bool) -> Option<Route> {
        // Cost, node and posture of the best route.
        let mut best: Option<(u32, u32, u16)> = None;
        let mut number = 0;
        while self.has(number) {
            let Place { at, rests } = &self.places[number];
            let (at, Node { pose, cost, .. }) = (*at, self.nodes[*at as usize]);
            if best.is_some_and(|best| (best.0, best.1) < (cost, at)) {
                break;
            }
            if let Some((last, turns)) =
                rests.iter().find(|(posture, _)| fits(Pose { posture: *posture, ..pose }))
            {
                let new = (cost + u32::from(*turns), at, *last);
                best = Some(best.map_or(new, |best| best.min(new)));
            }
            number += 1;
        }
        let (_, at, last) = best?;
        Some(route(&self.nodes, at, (self.nodes[at as usize].pose.posture != last).then_some(last)))
    }

    /// Searches until the place with this number, in the order of costs, is known. Returns false if there is none.
    fn has(&mut self, number: usize) -> bool {
        while self.places.len() <= number {
            let Some((_, Reverse(at))) = self.queue.pop() else { return false };
            self.expand(at);
        }
        true
    }

    fn expand(&mut self, at: u32) {
        let (ground, Node { pose, cost, .. }) = (self.ground, self.nodes[at as usize]);
        let rest_bit = |pose: Pose| ground.motions.rest_bit(pose.posture);
        if self.left.has(pose, rest_bit(pose)) || !self.left.is_bounded() {
            return;
        }
        let reach = ground.reach(pose);
        let mut rests: Vec<(u16, u8)> = reach.chains.iter().flatten().copied().collect();
        rests.sort_by_key(|(_, turns)| *turns);
        self.places.push(Place { at, rests });
        self.left.add(pose, reach.lands);
        if cost / STEP >= MOST_ASIDE {
            return;
        }
        for landed in &reach.landings {
            let Some(to) = ground.landed(pose, landed.posture) else { continue };
            if !self.left.has(to, rest_bit(to)) {
                let cost = cost + STEP + u32::from(landed.turns);
                self.queue.push((Reverse(cost), Reverse(self.nodes.len() as u32)));
                self.nodes.push(Node { pose: to, cost, by: Some((at, landed.posture)) });
            }
        }
    }
}
