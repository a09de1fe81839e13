//! Telling neighbours where this metamodule means to go.

use super::Negotiated;
use super::scene::Scene;
use crate::metamodule::message::{LEGS, Message, Path, Rank, Segment};
use crate::metamodule::planning::paths::Route;
use crate::metamodule::pose::Pose;
use crate::metamodule::strategy::context::Context;
use metamorph_core::counters::Class;
use metamorph_core::digest::Portable;
use std::hash::Hash;

/// The path that a metamodule has announced.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Announcement {
    path: Option<Path>,
    /// The route, the pose and the rank that `path` was computed from.
    made_from: Option<(Route, Pose, Rank)>,
    /// The rank of what the metamodule does.
    pub rank: Rank,
}

impl Announcement {
    pub fn new() -> Announcement {
        Announcement { path: None, made_from: None, rank: Rank::NONE }
    }
    /// Feeds the state into a hash; see `digest`.
    pub fn digest(&self, hasher: &mut Portable<'_>) {
        let Announcement { path, made_from, rank } = self;
        (path, made_from, rank).hash(hasher);
    }
    pub fn path(&self) -> Option<Path> {
        self.path
    }
    /// Withdraws the announced path, if there is one, by announcing an empty one.
    pub fn withdraw(&mut self, cx: &mut Context<'_>) {
        if let Some(path) = std::mem::replace(self, Announcement::new()).path {
            // No segments, not even those that are not announced: all receivers keep the same path.
            let (sequence, segments) = (cx.out.next_sequence(), [Segment::default(); LEGS]);
            let path = Path { sequence, rank: Rank::NONE, segments, count: 0, ..path };
            cx.out.broadcast(cx.v, Class::Negotiation, Message::Path(path));
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
            (!self.route.is_over() && !is_silent).then(|| (self.route.clone(), cx.v.own.pose, rank));
        if self.announcement.made_from == subject {
            return;
        }
        let told = if subject.is_some() { scene.segments(&self.route) } else { Vec::new() };
        let mut segments = [Segment::default(); LEGS];
        segments.iter_mut().zip(&told).for_each(|(segment, told)| *segment = *told);
        self.announcement.made_from = subject;
        let (sequence, count) = (cx.out.next_sequence(), told.len() as u8);
        let path = Path { id: cx.v.own.id, sequence, rank, from: cx.v.own.pose, segments, count };
        let before = std::mem::replace(&mut self.announcement.path, (count > 0).then_some(path));
        if before.is_some() || count > 0 {
            cx.out.broadcast(cx.v, Class::Negotiation, Message::Path(path));
        }
    }
}
