//! Which seed a metamodule goes to: seeds are shared out so that all together make the fewest moves.

use super::scene::{Other, Scene, fingerprint};
use crate::coverage::{CoveragePoint, hit};
use crate::digest::Portable;
use crate::metamodule::blueprint::SeedSet;
use crate::metamodule::message::Claim;
use crate::metamodule::planning::paths::Route;
use crate::metamodule::pose::Pose;
use crate::metamodule::view::View;
use crate::time::{Span, Time};
use pathfinding::kuhn_munkres::kuhn_munkres_min;
use pathfinding::matrix::Matrix;
use std::hash::Hash;

/// What it costs, in moves, to leave a seed that is not open yet to a metamodule.
const LATER: i64 = 1 << 20;
/// What it costs, in moves, to leave a seed to a metamodule that has no way to it.
const UNREACHABLE: i64 = 1 << 30;
/// The moves that a way counts that is not there: it may be there when its time comes.
const FAR: i64 = 1 << 10;
/// How long a seed counts as unreachable if nothing around changes, in retry delays.
const UNREACHABLE_FOR: u64 = 4;

/// What a metamodule has claimed, and what it knows of seeds.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Claims {
    /// The seed it is on its way to.
    pub claim: Option<Claim>,
    /// When all have heard of the claim, and would have objected.
    agreed_at: Time,
    /// Seeds that it has no way to, until what stands around changes, or this time.
    unreachable: SeedSet,
    reachable_at: Time,
    /// What stood around when the first of them was found to be unreachable.
    unreachable_in: u64,
    /// Since when an open seed has been unclaimed.
    unclaimed_since: Option<Time>,
    /// What is filled, and since when.
    filled: (SeedSet, Option<Time>),
    /// What stood around when it looked for its course, and whether it had waited for less than a retry
    /// delay.
    pub searched_in: (u64, bool),
    /// What is to stand there by the time it arrives.
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
    /// Since when nothing has been filled.
    pub fn filled_since(&self) -> Option<Time> {
        self.filled.1
    }
    /// For how long nothing has been filled.
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
    /// When all know of an unclaimed seed, or of the claim.
    pub fn known_at(&self, v: View<'_>) -> Option<Time> {
        let shared = self.unclaimed_since.map(|since| since + v.params().resend);
        shared.or(self.claim.map(|_| self.agreed_at))
    }

    /// Notes what has changed around. Returns whether the claim is lost: its seed is not open any more, or a
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
    pub fn mark_unreachable(&mut self, scene: &Scene<'_>, seed: u8) {
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

    /// The seed that falls to this metamodule if all unclaimed ones are shared out among those without one,
    /// with the fewest moves; open seeds before later ones.
    fn share(&self, scene: &Scene<'_>, open: SeedSet, claimed: SeedSet) -> Option<u8> {
        let own = scene.v.own;
        let others = scene.free.iter().filter(|o| o.claim.is_none());
        let others = others.map(|o| (o.id, o.pose, o.unreachable));
        let mut walkers: Vec<_> = others.chain([(own.id, own.pose, self.unreachable)]).collect();
        walkers.sort_by_key(|w| w.0);
        let poses: Vec<Pose> = walkers.iter().map(|w| w.1).collect();
        let left = scene.v.goal().all().without(own.filled).without(claimed);
        let seeds: Vec<u8> = left.iter().collect();
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
