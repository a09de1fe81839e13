//! The approach to the claimed seed: the route, and which of its motions may be made now.

use super::Negotiated;
use super::corridor::Corridor;
use super::scene::{Scene, fingerprint};
use crate::metamodule::blueprint::SeedSet;
use crate::metamodule::message::Claim;
use crate::metamodule::plan::{Aim, Plan};
use crate::metamodule::planning::cooperative::can_be_shared_out;
use crate::metamodule::planning::paths::Route;
use crate::metamodule::pose::Pose;
use crate::metamodule::strategy::context::Context;
use metamorph_core::lattice::Cell;

/// The time without progress after which a metamodule leaves its seed to others, in multiples of `patience`.
const GIVE_UP: u64 = 3;
/// The time without a newly filled seed after which any reachable seed is filled, even if that blocks others, in
/// multiples of `patience`.
const STANDS_STILL: u64 = 8;
/// The number of extra moves of detour that a metamodule accepts once it has waited for longer than `patience`.
const DETOUR: usize = 3;

/// Permissions of a claimant for its next segment.
#[derive(Clone, Copy)]
struct Permission {
    /// End a move in the zone around the goal, where it may be in the way of what is built.
    enter: bool,
    /// Fill its seed.
    fill: bool,
    /// End a move where that shuts another metamodule in.
    block: bool,
    /// Fill its seed even if that closes the ways to others.
    close: bool,
}

impl Permission {
    const ALL: Permission = Permission { enter: true, fill: true, block: true, close: true };
}

impl Scene<'_> {
    /// Returns the best route to a seed. It leads around the bodies in the way if that takes at most one extra move for
    /// each of them (and [`DETOUR`] more unless `patient`), and otherwise through the cells in which they stand.
    pub fn route_to(&self, number: u8, patient: bool) -> Option<Route> {
        let seed = self.seed(number)?;
        let find = |fixed: &[Cell]| {
            let pose = self.v.own.pose;
            let through = self.v.ground(fixed).to_seed(pose, seed, fixed, usize::MAX)?;
            let swept = self.cells_of(pose, &self.segments(&through));
            let in_way = self.free.iter().filter(|o| o.cells.iter().any(|c| swept.contains(c))).count();
            if in_way == 0 {
                return Some(through);
            }
            let worth = through.steps.len() + in_way + if patient { 0 } else { DETOUR };
            let bodies = fixed.iter().copied().chain(self.free.iter().flat_map(|o| o.cells.iter().copied()));
            let bodies: Vec<Cell> = bodies.collect();
            Some(self.v.ground(&bodies).to_seed(pose, seed, fixed, worth).unwrap_or(through))
        };
        find(&self.planned(number)).or_else(|| find(&self.fixed))
    }

    /// Returns true if the built goal would shut in a metamodule that is needed for another seed than the claimed one,
    /// and that the fixed cells do not shut in already.
    fn loses_candidates(&self, claim: Claim) -> bool {
        let own = self.v.own;
        let left = self.v.goal().all().without(own.filled).without(SeedSet::default().with(claim.seed));
        let most = self.candidates.len().min(left.len());
        let count = |taken: &[Cell]| {
            let ground = self.v.ground(taken);
            self.candidates.iter().filter(|p| !ground.is_shut_in(**p)).count().min(left.len())
        };
        let movable = count(&self.built);
        movable < most && movable < count(&self.fixed)
    }

    /// Returns true if too few metamodules would come to the other seeds once this one has filled the claimed one, and enough do
    /// now.
    fn leaves_too_few(&self, claim: Claim) -> bool {
        let (own, setup) = (self.v.own, self.v.setup);
        let left = self.v.goal().all().without(own.filled);
        let others = left.without(SeedSet::default().with(claim.seed));
        let seed = self.seed(claim.seed).map(|seed| seed.cells());
        let filled: Vec<Cell> = self.stays.iter().copied().chain(seed.into_iter().flatten()).collect();
        let all: Vec<Pose> = self.candidates.iter().copied().chain([own.pose]).collect();
        !can_be_shared_out(setup, (own.task, others), &self.candidates, &filled)
            && can_be_shared_out(setup, (own.task, left), &all, &self.stays)
    }
}

impl Negotiated {
    /// Returns the next motion to the claimed seed, if it can be made now. Gives the seed up if there is no
    /// way to it.
    pub(super) fn go_to_seed(
        &mut self,
        cx: &mut Context<'_>,
        scene: &Scene<'_>,
        corridor: &Corridor,
        claim: Claim,
    ) -> Option<Plan> {
        let now = cx.v.now;
        if !self.claims.is_agreed(now) {
            // A move towards a seed that is lost to a nearer metamodule would have no purpose.
            return None;
        }
        let (waited, retry) = (now.since(*cx.waiting_since), cx.v.params().patience);
        let enter = scene.is_first(claim);
        let stands_still = self.claims.unfilled_for(now) > retry * STANDS_STILL;
        let walls_in = !stands_still
            && (scene.loses_candidates(claim)
                || (waited <= retry * (GIVE_UP - 1) && !scene.leaves_others_safe()));
        let fills = enter && !walls_in && matches!(self.route.next(), Some((_, false)));
        let may = Permission {
            enter,
            fill: fills && !scene.leaves_too_few(claim),
            block: enter && waited > retry,
            close: stands_still,
        };
        let planned = fingerprint(&scene.planned(claim.seed));
        let fits = self.claims.planned_in == planned;
        if fits && let Some(plan) = self.next_segment(scene, &scene.taken, Some(corridor), claim, may) {
            return Some(plan);
        }
        if !enter {
            // Its turn will come; this is no reason to give up.
            *cx.waiting_since = now;
            return None;
        }
        if waited > retry * GIVE_UP {
            self.give_up(cx, scene, claim);
            return None;
        }
        let bodies = scene.bodies();
        let (patient, around) = (waited <= retry, fingerprint(&bodies));
        // A metamodule that has been granted a way will be through it soon.
        let is_open = || self.next_segment(scene, &bodies, None, claim, Permission::ALL).is_some();
        if fits && (self.claims.searched_in == (around, patient) || (patient && is_open())) {
            return None;
        }
        let Some(route) = scene.route_to(claim.seed, patient) else {
            self.give_up(cx, scene, claim);
            return None;
        };
        self.route = route;
        (self.claims.searched_in, self.claims.planned_in) = ((around, patient), planned);
        self.next_segment(scene, &scene.taken, Some(corridor), claim, may)
    }

    /// Returns the next motion of the route over free ground, if this metamodule may make it. A landing in `corridor`,
    /// the paths of more important metamodules, is not allowed.
    fn next_segment(
        &self,
        scene: &Scene<'_>,
        taken: &[Cell],
        corridor: Option<&Corridor>,
        claim: Claim,
        may: Permission,
    ) -> Option<Plan> {
        let (posture, lands) = self.route.next()?;
        let (ground, pose) = (scene.v.ground(taken), scene.v.own.pose);
        if !lands {
            let may_fill = may.fill && (may.close || scene.keeps_open(claim.seed));
            return if may_fill { Plan::to(&ground, pose, posture, Aim::Settle(claim.seed)) } else { None };
        }
        ground.landed(pose, posture)?;
        let end = Pose { posture, ..pose };
        if corridor.is_some_and(|c| !c.is_clear_of(&scene.v.motions().cells(end))) {
            return None;
        }
        let non_blocking = !may.block && (!may.enter || scene.is_outside_zone(end));
        if non_blocking && !scene.is_non_blocking(end) {
            return None;
        }
        Some(Plan { non_blocking, ..Plan::to(&ground, pose, posture, Aim::Land)? })
    }
}
