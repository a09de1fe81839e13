//! How many strides it takes to a seed from every place on the floor, around what does not move.
//!
//! Every motion can be made backwards, so the count begins in the seed and spreads, as far as it is
//! asked for. What has been built stands where it stands for long, in one run and in the next, so the
//! latest counts are kept; that changes how long an answer takes and nothing else.

use super::blueprint::Seed;
use super::motions::Motions;
use super::params::Floor;
use super::pose::{Pose, to_frame};
use super::search::Ground;
use crate::lattice::Cell;
use crate::roombots::grid::GridState;
use std::collections::VecDeque;

/// Places of one search, with a number for each. All postures at one connector that can be got to from
/// each other are one place: whoever has come to one of them has come to all.
pub struct Places {
    /// The first entry of every grid state, plus one.
    first: Vec<u32>,
    /// The postures of a place that land, its number, and the next entry of the same state, plus one.
    entries: Vec<(u128, u16, u32)>,
    floor: Floor,
}

impl Places {
    /// None yet.
    pub fn new(floor: Floor) -> Places {
        let side = |a: i16, b: i16| usize::from(b.abs_diff(a)) + 1;
        let states = side(floor.min.0, floor.max.0) * side(floor.min.1, floor.max.1) * 4;
        Places { first: vec![0; states], entries: Vec::new(), floor }
    }
    /// How many there are.
    pub fn count(&self) -> usize {
        self.entries.len()
    }
    /// Invariant: poses on their way through a search stand on the floor.
    fn index(&self, pose: Pose) -> usize {
        let (x, y) = (pose.state.x.abs_diff(self.floor.min.0), pose.state.y.abs_diff(self.floor.min.1));
        let wide = usize::from(self.floor.max.0.abs_diff(self.floor.min.0)) + 1;
        (usize::from(y) * wide + usize::from(x)) * 4 + usize::from(pose.state.class)
    }
    /// The number of the place at this connector and class that has one of these postures.
    pub fn get(&self, pose: Pose, postures: u128) -> Option<u16> {
        let mut at = self.first[self.index(pose)];
        while let Some((place, number, next)) = at.checked_sub(1).map(|i| self.entries[i as usize]) {
            if place & postures != 0 {
                return Some(number);
            }
            at = next;
        }
        None
    }
    /// Adds the place of this pose, with the postures there that land.
    pub fn add(&mut self, pose: Pose, lands: u128, number: u16) {
        let index = self.index(pose);
        self.entries.push((lands, number, self.first[index]));
        self.first[index] = self.entries.len() as u32;
    }
}

/// The count for one seed.
pub struct Distances {
    seed: Seed,
    fixed: Vec<Cell>,
    places: Places,
    /// Places that have been come to and not left yet, nearest first, with their strides.
    front: VecDeque<(Pose, u16)>,
}

impl Distances {
    /// Nothing counted yet. `fixed` is sorted.
    pub fn new(motions: &Motions, floor: Floor, seed: Seed, fixed: Vec<Cell>, like: Pose) -> Distances {
        let mut front = VecDeque::new();
        let blocked = seed.cells().iter().any(|c| fixed.binary_search(c).is_ok());
        if !blocked && floor.has(seed.foot.0, seed.foot.1) {
            for class in 0..4 {
                let state = GridState::new(seed.foot.0, seed.foot.1, class);
                let chain = motions.chain_of(seed.cells().map(|c| to_frame(state, c)));
                let filling = chain.map_or(&[][..], |c| motions.filling(c));
                front.extend(filling.iter().map(|p| (Pose { state, posture: *p, both: false, ..like }, 0)));
            }
        }
        Distances { seed, fixed, places: Places::new(floor), front }
    }
    /// Whether this is the count for this seed on this floor around these cells.
    pub fn is_for(&self, floor: Floor, seed: Seed, fixed: &[Cell]) -> bool {
        (self.places.floor, self.seed) == (floor, seed) && self.fixed == fixed
    }

    /// Strides from a place, given by its connector, class and some of its postures that land; none if
    /// there is no way.
    pub fn strides(&mut self, motions: &Motions, pose: Pose, postures: u128) -> Option<u16> {
        loop {
            if let Some(strides) = self.places.get(pose, postures) {
                return Some(strides);
            }
            self.leave_next(motions)?;
        }
    }

    /// Leaves the nearest place that has not been left; none if there is none.
    fn leave_next(&mut self, motions: &Motions) -> Option<()> {
        let (pose, strides) = self.front.pop_front()?;
        let ground = Ground { motions, floor: self.places.floor, taken: &self.fixed };
        if self.places.get(pose, motions.rest_bit(pose.posture)).is_some() {
            return Some(());
        }
        let lands = ground.lands(pose);
        if lands == 0 || self.places.get(pose, lands).is_some() {
            return Some(());
        }
        self.places.add(pose, lands, strides);
        for posture in motions.graph().landings(lands) {
            if let Some(to) = ground.landed(pose, posture)
                && self.places.get(to, motions.rest_bit(to.posture)).is_none()
            {
                self.front.push_back((to, strides.saturating_add(1)));
            }
        }
        Some(())
    }
}
