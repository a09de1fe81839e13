//! Making way for more important metamodules, and being blocked where that is not possible.

use super::Negotiated;
use super::corridor::Corridor;
use super::scene::{Other, Scene};
use crate::metamodule::message::{Claim, Rank};
use crate::metamodule::plan::{Aim, Plan};
use crate::metamodule::planning::nearby::Nearby;
use crate::metamodule::planning::paths::Route;
use crate::metamodule::pose::Pose;
use crate::metamodule::strategy::context::Context;
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::digest::Portable;
use metamorph_core::lattice::Cell;
use metamorph_core::time::Time;
use std::collections::BTreeMap;
use std::hash::Hash;

/// Largest number of doublings of the time for which a metamodule counts as blocked.
const MOST_DOUBLED: u8 = 3;
/// Largest number of poses examined for whether another metamodule can get past.
const MOST_LET_BY: u32 = 64;

/// Whether a metamodule is blocked: it could not leave a more important path.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Yielding {
    /// Until when it counts as blocked.
    blocked_until: Option<Time>,
    /// Until when it counts as blocked in any case; after that, only while another metamodule announces a path.
    blocked_at_least: Time,
    /// How often it has been blocked since it last moved to another connector.
    times_blocked: u8,
}

impl Default for Yielding {
    fn default() -> Yielding {
        Yielding { blocked_until: None, blocked_at_least: Time::ZERO, times_blocked: 0 }
    }
}

impl Yielding {
    /// Feeds the state into a hash; see `digest`.
    pub fn digest(&self, hasher: &mut Portable<'_>) {
        let Yielding { blocked_until, blocked_at_least, times_blocked } = self;
        (blocked_until, blocked_at_least, times_blocked).hash(hasher);
    }
    pub fn is_blocked(&self) -> bool {
        self.blocked_until.is_some()
    }
    /// Returns when to check again whether the metamodule still counts as blocked.
    pub fn ends(&self, now: Time) -> Time {
        let until = self.blocked_until.unwrap_or(Time::NEVER);
        if now < self.blocked_at_least { self.blocked_at_least } else { until }
    }
    /// The metamodule stands on another connector.
    pub fn on_moved(&mut self) {
        self.times_blocked = 0;
    }
    /// Ends the blocked state when its time is over, or when no free neighbour announces a path any more. Returns true
    /// if the state has ended.
    pub fn review(&mut self, scene: &Scene<'_>) -> bool {
        let (now, at_least) = (scene.v.now, self.blocked_at_least);
        let is_over = |until: &mut Time| {
            now >= *until || (now >= at_least && scene.free.iter().all(|o| o.path.is_none()))
        };
        self.blocked_until.take_if(is_over).is_some()
    }
    fn block(&mut self, scene: &Scene<'_>) {
        hit(CoveragePoint::MetaCornered);
        // Longer every time: one that goes around must get past before this one counts as free again.
        let (now, times, retry) = (scene.v.now, self.times_blocked, scene.v.params().patience);
        self.times_blocked = (times + 1).min(MOST_DOUBLED);
        self.blocked_until = Some(now + retry * (1 << times));
        // The one that meant to come this way may have given it up for that very reason, and would mean to
        // again: the two must not continue like that without time passing.
        self.blocked_at_least = if times == MOST_DOUBLED { now + retry } else { now };
    }
}

/// Why a metamodule has to go elsewhere.
#[derive(Clone, Copy)]
pub(super) struct Need {
    /// The rank of the metamodule while it makes way.
    rank: Rank,
    /// True if it stands in a more important path. Otherwise it is at risk of being shut in, and the next seed waits
    /// until it is in a safe place.
    pub in_way: bool,
}

impl Need {
    /// Finds out whether a metamodule with this claim has to go elsewhere.
    pub fn find(scene: &Scene<'_>, corridor: &Corridor, claim: Option<Claim>) -> Option<Need> {
        let v = scene.v;
        let in_way_of = corridor.most_important(&v.motions().cells(v.own.pose));
        let next = v.open().iter().next().map(Rank::of_seed);
        // The next seed may matter more than the way that this metamodule stands in: two that each made way
        // for the other, and thereby gave up their own, would continue like that forever.
        let matters = in_way_of.is_none_or(|rank| next.is_some_and(|next| next < rank));
        let is_first = claim.is_some_and(|c| scene.is_first(c));
        let is_done = v.own.filled.holds(v.goal().all());
        let is_at_risk = matters && !(is_first || is_done || scene.is_safe(v.own.pose));
        if is_at_risk {
            return Some(Need { rank: next.map_or(Rank::NONE, Rank::below), in_way: false });
        }
        in_way_of.map(|rank| Need { rank: rank.below(), in_way: true })
    }
}

impl Negotiated {
    /// Looks for a route elsewhere and announces it. Returns its first motion, if that is free. As long as there is no
    /// such motion, the route to a claimed seed is kept; after one, it is searched again.
    pub(super) fn step_aside(
        &mut self,
        cx: &mut Context<'_>,
        scene: &Scene<'_>,
        need: Need,
        has_claim: bool,
    ) -> Option<Plan> {
        let kept = std::mem::take(&mut self.route);
        let plan = self.set_route_aside(scene, need.rank);
        if plan.is_none() && need.in_way && self.route.is_over() {
            self.yielding.block(scene);
            self.tell(cx);
        }
        self.announce(cx, scene, need.rank);
        if has_claim {
            self.route = kept;
        }
        if plan.is_some() {
            hit(CoveragePoint::MetaMadeWay);
            self.route = Route::default();
        }
        plan
    }

    /// Sets the route to the one found by `route_aside`, if there is one. Returns its first motion, if that is free.
    fn set_route_aside(&mut self, scene: &Scene<'_>, rank: Rank) -> Option<Plan> {
        let (v, pose) = (scene.v, scene.v.own.pose);
        let route = route_aside(scene, rank)?;
        let plan = route.next().and_then(|(posture, lands)| {
            let non_blocking = scene.is_non_blocking(Pose { posture, ..pose });
            let aim = if lands { Aim::Land } else { Aim::Shift };
            Some(Plan { non_blocking, ..Plan::to(&v.ground(&scene.taken), pose, posture, aim)? })
        });
        self.route = route;
        plan
    }
}

/// Returns the route to the best place out of the way of metamodules more important than `rank`: preferably clear of
/// all their paths, otherwise of the ends of the segments, otherwise where `let_by` allows this one to stay.
fn route_aside(scene: &Scene<'_>, rank: Rank) -> Option<Route> {
    let (v, corridor) = (scene.v, scene.corridor(rank));
    let (motions, pose) = (v.motions(), v.own.pose);
    let is_clear = |pose: Pose| corridor.is_clear_of(&motions.cells(pose));
    // Asked on both grounds.
    let mut known: BTreeMap<Pose, bool> = BTreeMap::new();
    let mut is_non_blocking =
        |pose: Pose| is_clear(pose) && *known.entry(pose).or_insert_with(|| scene.is_non_blocking(pose));
    let free = v.ground(&scene.taken);
    let mut free = Nearby::new(&free, pose);
    let route = free.find(&mut is_non_blocking);
    if route.is_some() {
        return route;
    }
    // A segment sweeps the cells of one route of many to its end. A body that is clear of all ends may be avoided.
    let ends = scene.ends_of_ways(rank);
    let is_past = |pose: Pose| !motions.cells(pose).iter().any(|cell| ends.contains(cell));
    let past = |nearby: &mut Nearby<'_>| nearby.find(is_past).filter(|route| !route.is_over());
    // More important metamodules do not make way.
    let is_firm = |o: &&Other| o.path.is_some_and(|w| (w.rank, o.id) < (rank, v.own.id));
    let firm = scene.free.iter().filter(is_firm).flat_map(|o| o.cells.iter().copied());
    let firm: Vec<Cell> = scene.fixed.iter().copied().chain(firm).collect();
    let firm = v.ground(&firm);
    let mut firm = Nearby::new(&firm, pose);
    firm.find(&mut is_non_blocking)
        .or_else(|| free.find(is_clear))
        .or_else(|| firm.find(is_clear))
        .or_else(|| past(&mut free).or_else(|| past(&mut firm)))
        .or_else(|| let_by(scene, rank, &mut free))
}

/// Returns the route to the nearest place where this metamodule can stay because the most important claimant, of a rank
/// above `rank`, then has some other route to its seed.
fn let_by(scene: &Scene<'_>, rank: Rank, nearby: &mut Nearby<'_>) -> Option<Route> {
    let v = scene.v;
    let claims = |o: &Other| o.claim.filter(|c| o.path.is_some_and(|w| w.rank == Rank::of_seed(c.seed)));
    let claims = scene.free.iter().filter_map(|o| Some((claims(o)?.seed, o.pose)));
    let (number, from) = claims.min_by_key(|(seed, _)| *seed).filter(|(s, _)| Rank::of_seed(*s) < rank)?;
    let (seed, planned) = (scene.seed(number)?, scene.planned(number));
    let mut left = MOST_LET_BY;
    let route = nearby.find(|pose| {
        let may_look = left > 0;
        left = left.saturating_sub(1);
        let fixed = [&planned[..], &v.motions().cells(pose)].concat();
        may_look && v.ground(&fixed).to_seed(from, seed, &fixed, usize::MAX).is_some()
    })?;
    if !route.is_over() {
        hit(CoveragePoint::MetaLetBy);
    }
    Some(route)
}
