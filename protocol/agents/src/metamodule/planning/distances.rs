//! The number of steps to a seed from every place on the floor, around cells that stay taken.
//!
//! Every motion is reversible, so the count spreads from the seed. All postures at one connector that turn
//! into each other count as one place.

use crate::metamodule::blueprint::{Floor, Seed};
use crate::metamodule::motions::Motions;
use crate::metamodule::planning::paths::Ground;
use crate::metamodule::pose::{Pose, to_frame};
use metamorph_core::lattice::Cell;
use metamorph_roombots::grid::GridState;
use std::collections::VecDeque;

/// Returns the number of a grid state of a floor, from 0 on.
pub fn index(floor: Floor, state: GridState) -> usize {
    let (x, y) = (state.x.abs_diff(floor.min.0), state.y.abs_diff(floor.min.1));
    let wide = usize::from(floor.max.0.abs_diff(floor.min.0)) + 1;
    (usize::from(y) * wide + usize::from(x)) * 4 + usize::from(state.class)
}

/// Returns the number of grid states of a floor.
pub fn states(floor: Floor) -> usize {
    let side = |a: i16, b: i16| usize::from(b.abs_diff(a)) + 1;
    side(floor.min.0, floor.max.0) * side(floor.min.1, floor.max.1) * 4
}

/// The distances to one seed.
pub struct Distances {
    floor: Floor,
    /// By [`index`]: for each set of connected postures from which the seed can be reached, those that land,
    /// as bits, and the number of steps.
    places: Vec<Vec<(u128, u16)>>,
}

impl Distances {
    /// Counts the steps to a seed around fixed cells.
    pub fn new(motions: &Motions, floor: Floor, seed: Seed, fixed: &[Cell]) -> Distances {
        Distances::with_end(motions, floor, seed, fixed, fixed)
    }

    /// Counts the steps to a seed around fixed cells, if those of `last` are taken as well when the body, standing on the
    /// seed's connector, turns to fill it.
    pub fn with_end(motions: &Motions, floor: Floor, seed: Seed, fixed: &[Cell], last: &[Cell]) -> Distances {
        let mut distances = Distances { floor, places: Vec::new() };
        distances.places.resize_with(states(floor), Vec::new);
        if !floor.has(seed.foot.0, seed.foot.1) || seed.cells().iter().any(|c| fixed.contains(c)) {
            return distances;
        }
        let ground = Ground { motions, floor, taken: fixed };
        let end = Ground { taken: last, ..ground };
        let mut front = VecDeque::new();
        for class in 0..4 {
            let state = GridState::new(seed.foot.0, seed.foot.1, class);
            let chain = motions.chain_of(seed.cells().map(|c| to_frame(state, c)));
            for posture in chain.map_or(&[][..], |c| motions.filling(c)) {
                let pose = Pose::standing(state, *posture);
                let lands = distances.come(&end, pose, end.lands(pose), 0);
                front.extend(before(&ground, pose, lands, 1));
            }
        }
        while let Some((pose, postures, steps)) = front.pop_front() {
            let lands = distances.come(&ground, pose, postures, steps);
            front.extend(before(&ground, pose, lands, steps.saturating_add(1)));
        }
        distances
    }

    /// Enters a place `steps` away. Returns the landings from there as bits; zero if it is known already.
    fn come(&mut self, ground: &Ground<'_>, pose: Pose, postures: u128, steps: u16) -> u128 {
        if postures == 0 {
            return 0;
        }
        let places = &mut self.places[index(self.floor, pose.state)];
        if places.iter().any(|(lands, _)| lands & postures != 0) {
            return 0;
        }
        let graph = ground.motions.graph();
        let one = graph.landings(postures).next();
        let lands = one.map_or(0, |posture| ground.lands(Pose { posture, ..pose }));
        places.push((lands, steps));
        lands
    }

    /// True if there is a route from some connector that `is_it` accepts.
    pub fn reach(&self, is_it: impl Fn((i16, i16)) -> bool) -> bool {
        let (xs, ys) = (self.floor.min.0..=self.floor.max.0, self.floor.min.1..=self.floor.max.1);
        let mut states = ys.flat_map(|y| xs.clone().flat_map(move |x| [(x, y); 4])).zip(&self.places);
        states.any(|(at, places)| !places.is_empty() && is_it(at))
    }

    /// Returns the number of steps from a place, given by its connector, its class and some of its postures
    /// that land; `None` if there is no route.
    pub fn steps(&self, pose: Pose, postures: u128) -> Option<u16> {
        let places = self.places.get(index(self.floor, pose.state))?;
        places.iter().find(|(lands, _)| lands & postures != 0).map(|(_, steps)| *steps)
    }
}

/// Returns the places from which a landing leads to a place: each as a pose with one of its postures.
fn before<'a>(
    ground: &'a Ground<'a>,
    pose: Pose,
    lands: u128,
    steps: u16,
) -> impl Iterator<Item = (Pose, u128, u16)> + 'a {
    let landed = ground.motions.graph().landings(lands).filter_map(move |p| ground.landed(pose, p));
    landed.map(move |to| (to, ground.motions.rest_bit(to.posture), steps))
}
