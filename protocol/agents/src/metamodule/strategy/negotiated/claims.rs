//! Which seed a metamodule goes to: seeds are shared out so that all together make the fewest moves.

use super::scene::{Other, Scene, fingerprint};
use crate::metamodule::blueprint::SeedSet;
use crate::metamodule::message::Claim;
use crate::metamodule::planning::cooperative::SHARED_SEEDS_MAX;
use crate::metamodule::planning::paths::Route;
use crate::metamodule::pose::Pose;
use crate::metamodule::view::View;
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::digest::Portable;
use metamorph_core::time::{Span, Time};
use pathfinding::kuhn_munkres::kuhn_munkres_min;
use pathfinding::matrix::Matrix;
use std::hash::Hash;

/// The added cost, in moves, of assigning a metamodule a seed that is not open yet.
const LATER: i64 = 1 << 20;
/// The added cost, in moves, of assigning a metamodule a seed that it has marked unreachable.
const UNREACHABLE: i64 = 1 << 30;
/// The number of moves assumed where there is no route; there may be one by the time the seed opens.
const FAR: i64 = 1 << 10;
/// How long a seed counts as unreachable if the fixed cells do not change, in multiples of `patience`.
const UNREACHABLE_FOR: u64 = 4;

/// The claim of a metamodule, and its knowledge about seeds.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Claims {
    /// The seed it is on its way to.
    pub claim: Option<Claim>,
    /// When all neighbours have had time to hear of the claim and to object.
    agreed_at: Time,
    /// Seeds to which it has found no route.
    unreachable: SeedSet,
    /// When these are tried again, unless the fixed cells change before.
    reachable_at: Time,
    /// The [`fingerprint`] of the fixed cells when a seed was last found to be unreachable.
    unreachable_in: u64,
    /// Since when an open seed has been unclaimed.
    unclaimed_since: Option<Time>,
    /// The filled seeds, and since when the set has been the same.
    filled: (SeedSet, Option<Time>),
    /// The [`fingerprint`] of the bodies around when it last searched for a route, and whether it had waited for no
    /// longer than `patience` then.
    pub searched_in: (u64, bool),
    /// The [`fingerprint`] of [`Scene::planned`], for the claimed seed, that the route was made for.
    pub planned_in: u64,
}

impl Default for Claims {
    fn default() -> Claims {
        Claims {
            claim: None,
            agreed_at: Time::ZERO,
            unreachable: SeedSet::default(),
            reachable_at: Time::NEVER,
            unreachable_in: 0,
            unclaimed_since: None,
            filled: (SeedSet::default(), None),
            searched_in: (0, false),
            planned_in: 0,
        }
    }
}

impl Claims {
    /// Feeds the state into a hash, without what it says of the surroundings; see `digest`.
    pub fn digest(&self, hasher: &mut Portable<'_>) {
        let Claims {
            claim,
            agreed_at,
            unreachable,
            reachable_at,
            unclaimed_since,
            filled,
            unreachable_in: _,
            searched_in: _,
            planned_in: _,
        } = self;
        (claim, agreed_at, unreachable, reachable_at, unclaimed_since, filled).hash(hasher);
    }
    /// Claims without anything but what is filled.
    pub fn only_filled(&self) -> Claims {
        Claims { filled: self.filled, ..Claims::default() }
    }
    pub fn unreachable(&self) -> SeedSet {
        self.unreachable
    }
    /// When seeds that it has no way to are tried again.
    pub fn reachable_at(&self) -> Time {
        if self.unreachable.is_empty() { Time::NEVER } else { self.reachable_at }
    }
    /// Returns when the set of filled seeds last changed.
    pub fn filled_since(&self) -> Option<Time> {
        self.filled.1
    }
    /// Returns for how long the set of filled seeds has been the same.
    pub fn unfilled_for(&self, now: Time) -> Span {
        self.filled.1.map_or(Span::ZERO, |at| now.since(at))
    }
    /// Whether an open seed is unclaimed.
    pub fn is_unclaimed(&self) -> bool {
        self.unclaimed_since.is_some()
    }
    /// Whether all have heard of the claim, and have not objected.
    pub fn is_agreed(&self, now: Time) -> bool {
        now >= self.agreed_at
    }
    /// Returns when all neighbours have had time to learn of an unclaimed seed or, failing that, of the claim.
    pub fn known_at(&self, v: View<'_>) -> Option<Time> {
        let shared = self.unclaimed_since.map(|since| since + v.params().resend);
        shared.or(self.claim.map(|_| self.agreed_at))
    }

    /// Updates what depends on the surroundings. Returns true if the claim is lost: its seed is no longer open, or a
    /// nearer metamodule has claimed it too.
    pub fn review(&mut self, scene: &Scene<'_>) -> bool {
        let (now, own) = (scene.v.now, scene.v.own);
        if self.filled.1.is_none() || self.filled.0 != own.filled {
            self.filled = (own.filled, Some(now));
        }
        let has_changed = || self.unreachable_in != fingerprint(&scene.fixed);
        if now >= self.reachable_at || (!self.unreachable.is_empty() && has_changed()) {
            (self.unreachable, self.reachable_at) = (SeedSet::default(), Time::NEVER);
        }
        let Some(claim) = self.claim else { return false };
        let is_better = |o: &Other| {
            o.claim.is_some_and(|c| c.seed == claim.seed && (c.cost, o.id) < (claim.cost, own.id))
        };
        let outranked = scene.free.iter().any(is_better);
        if outranked {
            hit(CoveragePoint::MetaOutranked);
        }
        !scene.v.open().has(claim.seed) || outranked
    }

    /// Notes that there is no way to a seed.
    pub fn set_unreachable(&mut self, scene: &Scene<'_>, seed: u8) {
        hit(CoveragePoint::MetaUnreachable);
        self.unreachable = self.unreachable.with(seed);
        self.unreachable_in = fingerprint(&scene.fixed);
        self.reachable_at = scene.v.now + scene.v.params().patience * UNREACHABLE_FOR;
    }

    /// Claims a seed.
    pub fn take(&mut self, scene: &Scene<'_>, seed: u8, route: &Route) {
        let cost = u8::try_from(route.steps.len()).unwrap_or(u8::MAX);
        self.claim = Some(Claim { seed, cost });
        self.agreed_at = scene.v.now + scene.v.params().resend;
        self.unclaimed_since = None;
        self.planned_in = fingerprint(&scene.planned(seed));
    }

    /// The seed to claim: the one that falls to this metamodule, or the nearest that remains unclaimed for
    /// long.
    pub fn choose(&mut self, scene: &Scene<'_>) -> Option<u8> {
        let (now, params) = (scene.v.now, scene.v.params());
        let claimed = scene.claimed();
        let open = scene.v.open().without(claimed).without(self.unreachable);
        if open.is_empty() {
            self.unclaimed_since = None;
            return None;
        }
        let since = *self.unclaimed_since.get_or_insert(now);
        if now < since + params.resend {
            // Until all have heard what this one has, they would share out differently.
            return None;
        }
        if let Some(seed) = self.share(scene, open, claimed).filter(|s| open.has(*s)) {
            return Some(seed);
        }
        if now < since + params.patience {
            return None;
        }
        hit(CoveragePoint::MetaNearest);
        open.iter().min_by_key(|s| steps(scene, &[scene.v.own.pose], *s))
    }

    /// The seed that falls to this metamodule if all unclaimed ones (of large goals the open ones) are shared out among
    /// those without one,
    /// with the fewest moves; open seeds before later ones.
    fn share(&self, scene: &Scene<'_>, open: SeedSet, claimed: SeedSet) -> Option<u8> {
        let own = scene.v.own;
        let others = scene.free.iter().filter(|o| o.claim.is_none());
        let others = others.map(|o| (o.id, o.pose, o.unreachable));
        let mut walkers: Vec<_> = others.chain([(own.id, own.pose, self.unreachable)]).collect();
        walkers.sort_by_key(|w| w.0);
        let poses: Vec<Pose> = walkers.iter().map(|w| w.1).collect();
        let left = scene.v.goal().all().without(own.filled).without(claimed);
        let shared = if scene.v.goal().seeds().len() > SHARED_SEEDS_MAX { open } else { left };
        let seeds: Vec<u8> = shared.iter().collect();
        let steps: Vec<Vec<i64>> = seeds.iter().map(|s| steps(scene, &poses, *s)).collect();
        let cost = |walker: usize, place: usize| {
            let ((_, _, unreachable), seed) = (walkers[walker], seeds[place]);
            let later = if open.has(seed) { 0 } else { LATER };
            let unreachable = if unreachable.has(seed) { UNREACHABLE } else { 0 };
            steps[place][walker] + later + unreachable
        };
        let mine = walkers.iter().position(|w| w.0 == own.id)?;
        // The method wants as many columns as rows, or more.
        if walkers.len() <= seeds.len() {
            let costs = Matrix::from_fn(walkers.len(), seeds.len(), |(w, s)| cost(w, s));
            let (_, seed_of) = kuhn_munkres_min(&costs);
            Some(seeds[seed_of[mine]])
        } else {
            let costs = Matrix::from_fn(seeds.len(), walkers.len(), |(s, w)| cost(w, s));
            let (_, walker_of) = kuhn_munkres_min(&costs);
            walker_of.iter().position(|w| *w == mine).map(|s| seeds[s])
        }
    }
}

/// Moves to a seed from each pose, around what will be built before it.
fn steps(scene: &Scene<'_>, from: &[Pose], number: u8) -> Vec<i64> {
    let Some(seed) = scene.seed(number) else { return vec![UNREACHABLE; from.len()] };
    let planned = scene.planned(number);
    let ground = scene.v.ground(&planned);
    let distances = scene.v.motions().distances(scene.v.setup.floor, seed, &planned);
    let steps = |pose: &Pose| distances.steps(*pose, ground.lands(*pose)).map_or(FAR, i64::from);
    from.iter().map(steps).collect()
}
