//! Telling neighbours where this metamodule means to go.

use super::Negotiated;
use super::scene::Scene;
use crate::counters::Class;
use crate::digest::Portable;
use crate::metamodule::message::{LEGS, Leg, Message, Rank, Way};
use crate::metamodule::planning::paths::Course;
use crate::metamodule::pose::Pose;
use crate::metamodule::strategy::Context;
use std::hash::Hash;

/// What a metamodule has announced.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Announcement {
    way: Option<Way>,
    /// What the way was made from.
    made_from: Option<(Course, Pose, Rank)>,
    /// The rank of what the metamodule does.
    pub rank: Rank,
}

impl Announcement {
    pub fn new() -> Announcement {
        Announcement { way: None, made_from: None, rank: Rank::NONE }
    }
    /// Feeds the state into a hash; see `digest`.
    pub fn digest(&self, hasher: &mut Portable<'_>) {
        let Announcement { way, made_from, rank } = self;
        (way, made_from, rank).hash(hasher);
    }
    pub fn way(&self) -> Option<Way> {
        self.way
    }
    /// Withdraws the way, if one has been announced.
    pub fn withdraw(&mut self, cx: &mut Context<'_>) {
        if let Some(way) = std::mem::replace(self, Announcement::new()).way {
            // No legs, not even those that are not told: all that hear it keep the same.
            let (sequence, legs) = (cx.out.next_sequence(), [Leg::default(); LEGS]);
            let way = Way { sequence, rank: Rank::NONE, legs, count: 0, ..way };
            cx.out.broadcast(cx.v, Class::Negotiation, Message::Way(way));
        }
    }
}

impl Negotiated {
    /// Tells where this metamodule means to go, if that has changed.
    pub(super) fn announce(&mut self, cx: &mut Context<'_>, scene: &Scene<'_>, rank: Rank) {
        self.announcement.rank = rank;
        let claim = self.claims.claim;
        // A claimant whose turn has not come does not ask others to make way.
        let is_silent = claim.is_some_and(|c| !scene.is_first(c) && Rank::of_seed(c.seed) == rank);
        let subject =
            (!self.course.is_over() && !is_silent).then(|| (self.course.clone(), cx.v.own.pose, rank));
        if self.announcement.made_from == subject {
            return;
        }
        let told = if subject.is_some() { scene.legs(&self.course) } else { Vec::new() };
        let mut legs = [Leg::default(); LEGS];
        legs.iter_mut().zip(&told).for_each(|(leg, told)| *leg = *told);
        self.announcement.made_from = subject;
        let (sequence, count) = (cx.out.next_sequence(), told.len() as u8);
        let way = Way { id: cx.v.own.id, sequence, rank, from: cx.v.own.pose, legs, count };
        let before = std::mem::replace(&mut self.announcement.way, (count > 0).then_some(way));
        if before.is_some() || count > 0 {
            cx.out.broadcast(cx.v, Class::Negotiation, Message::Way(way));
        }
    }
}
