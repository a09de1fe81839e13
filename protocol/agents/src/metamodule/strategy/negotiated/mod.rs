//! The `negotiated` strategy: which metamodule fills which seed, by which route, and which one makes way.
//!
//! Seeds are shared out so that all together make the fewest moves; a metamodule to which a seed falls claims it
//! and announces its path. Claims are ranked by the order of their seeds. A metamodule that stands in a more important
//! path leaves it, and until it has done so, its rank is the next one below the rank of that path: so ranks are passed
//! along chains of metamodules that make way for each other. What is promised, under which assumptions, and why, is in
//! `docs/negotiated.md`.
//!
//! * `scene` — what stands around, and where a metamodule blocks others;
//! * `corridor` — the cells of ways;
//! * `claims` — sharing out seeds, and what is claimed;
//! * `approach` — the way to the claimed seed;
//! * `yielding` — making way, and being blocked;
//! * `announcement` — telling others the way;
//! * `coordinator` — planning for the whole group when it makes no progress.
//!
//! In all parts but the last, a metamodule decides for itself, from what it knows. Locks, which keep it safe, are not
//! here: a wrong or late message about a path costs time, never safety.

mod announcement;
mod approach;
mod claims;
mod coordinator;
mod corridor;
mod safety;
mod scene;
mod yielding;

use super::context::{Context, Decision};
use crate::metamodule::message::{Claim, Directive, Instruction, Message, Path, Rank};
use crate::metamodule::plan::Plan;
use crate::metamodule::planning::paths::Route;
use crate::metamodule::pose::Pose;
use crate::metamodule::view::{Advertised, View};
use announcement::Announcement;
use claims::Claims;
use coordinator::Coordinator;
use metamorph_core::counters::Class;
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::digest::Portable;
use metamorph_core::ids::Port;
use metamorph_core::time::Time;
use scene::Scene;
use std::collections::BTreeMap;
use std::hash::Hash;
use yielding::{Need, Yielding};

/// The state of the strategy.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(in crate::metamodule) struct Negotiated {
    /// Where the metamodule intends to go next.
    route: Route,
    claims: Claims,
    yielding: Yielding,
    announcement: Announcement,
    /// The ways that neighbours have announced.
    paths: BTreeMap<Port, Path>,
    coordinator: Coordinator,
}

impl Negotiated {
    pub fn new() -> Negotiated {
        Negotiated {
            route: Route::default(),
            claims: Claims::default(),
            yielding: Yielding::default(),
            announcement: Announcement::new(),
            paths: BTreeMap::new(),
            coordinator: Coordinator::default(),
        }
    }

    /// Feeds the state into a hash, without the ways of neighbours; see `digest`.
    pub fn digest(&self, hasher: &mut Portable<'_>) {
        let Negotiated { route, claims, yielding, announcement, paths: _, coordinator } = self;
        route.hash(hasher);
        claims.digest(hasher);
        yielding.digest(hasher);
        announcement.digest(hasher);
        coordinator.digest(hasher);
    }
    /// The way that the neighbour on a port has announced.
    pub fn path_of(&self, port: Port) -> Option<&Path> {
        self.paths.get(&port)
    }
    pub fn advertised(&self) -> Advertised {
        let (claim, unreachable) = (self.claims.claim, self.claims.unreachable());
        Advertised { claim, unreachable, blocked: self.yielding.is_blocked() }
    }
    pub fn rank(&self) -> Rank {
        self.announcement.rank
    }
    pub fn announced(&self) -> Option<Path> {
        self.announcement.path()
    }
    /// Whether a metamodule that takes this posture where it stands blocks no other one.
    pub fn is_non_blocking(&self, v: View<'_>, posture: u16) -> bool {
        Scene::new(v, &self.paths).is_non_blocking(Pose { posture, ..v.own.pose })
    }

    /// Decides what to do next.
    pub fn look(&mut self, cx: &mut Context<'_>, next_expiry: Time) -> Decision {
        let scene = Scene::new(cx.v, &self.paths);
        self.review(cx, &scene);
        let filled_since = self.claims.filled_since();
        if let Some((instruction, until)) = self.coordinator.step(cx, &scene, filled_since, next_expiry) {
            return self.follow(cx, &scene, instruction, until);
        }
        if self.claims.claim.is_none() && !self.yielding.is_blocked() {
            self.claim(cx, &scene);
        }
        let claim = self.claims.claim;
        let rank = claim.map_or(Rank::NONE, |c| Rank::of_seed(c.seed));
        let corridor = scene.corridor(rank);
        if let Some(claim) = claim
            && let Some(plan) = self.go_to_seed(cx, &scene, &corridor, claim)
        {
            self.announce(cx, &scene, rank);
            return Decision::Ask(plan);
        }
        let need = Need::find(&scene, &corridor, claim);
        if let Some(need) = need {
            if let Some(plan) = self.step_aside(cx, &scene, need, claim.is_some()) {
                return Decision::Ask(plan);
            }
        } else {
            if claim.is_none() {
                self.route = Route::default();
            }
            self.announce(cx, &scene, rank);
        }
        let is_waiting = claim.is_some() || need.is_some_and(|n| n.in_way) || self.claims.is_unclaimed();
        Decision::Wait(self.next_look(&scene, is_waiting).min(next_expiry))
    }

    /// When to look again if nothing is heard until then.
    fn next_look(&mut self, scene: &Scene<'_>, is_waiting: bool) -> Time {
        let v = scene.v;
        let retry = if is_waiting { v.now + v.params().patience } else { Time::NEVER };
        let retry = self.claims.known_at(v).filter(|at| *at > v.now).unwrap_or(retry);
        let coordinates = self.coordinator.due(scene, self.claims.filled_since());
        retry.min(self.claims.reachable_at()).min(self.yielding.ends(v.now)).min(coordinates)
    }

    /// Drops what no longer holds.
    fn review(&mut self, cx: &mut Context<'_>, scene: &Scene<'_>) {
        if self.yielding.review(scene) {
            self.tell(cx);
        }
        if self.claims.review(scene) {
            self.drop_claim();
        }
    }

    fn drop_claim(&mut self) {
        self.claims.claim = None;
        self.route = Route::default();
    }

    /// Claims an open seed: the one that the optimal assignment gives to this metamodule, or else the nearest one, once
    /// open seeds have been unclaimed for long.
    fn claim(&mut self, cx: &mut Context<'_>, scene: &Scene<'_>) {
        while self.claims.claim.is_none() {
            let Some(seed) = self.claims.choose(scene) else { return };
            match scene.route_to(seed, true) {
                Some(route) => {
                    self.claims.take(scene, seed, &route);
                    self.route = route;
                    *cx.waiting_since = cx.v.now;
                }
                None => self.claims.set_unreachable(scene, seed),
            }
            self.tell(cx);
        }
    }

    /// Drops the claim to a seed that this metamodule cannot get to, and marks the seed unreachable.
    fn give_up(&mut self, cx: &mut Context<'_>, scene: &Scene<'_>, claim: Claim) {
        hit(CoveragePoint::MetaGaveUpSeed);
        self.drop_claim();
        self.claims.set_unreachable(scene, claim.seed);
        self.tell(cx);
    }

    fn tell(&self, cx: &mut Context<'_>) {
        cx.out.tell(cx.v, self.advertised(), Class::Gradient);
    }

    /// Follows the instruction of a coordinator: stays, or makes the move that it has been ordered to make.
    fn follow(
        &mut self,
        cx: &mut Context<'_>,
        scene: &Scene<'_>,
        instruction: Instruction,
        until: Time,
    ) -> Decision {
        self.fall_silent(cx);
        let plan = coordinator::own_move(scene, instruction);
        plan.map_or(Decision::Wait(until), Decision::Ask)
    }

    /// Drops its own intentions as long as a coordinator plans.
    fn fall_silent(&mut self, cx: &mut Context<'_>) {
        let claims = self.claims.only_filled();
        let is_silent = self.claims == claims
            && self.yielding == Yielding::default()
            && self.announcement == Announcement::new();
        if !is_silent {
            self.withdraw(cx);
            self.claims = claims;
            *cx.waiting_since = cx.v.now;
            self.tell(cx);
        }
    }

    /// Drops its own intentions, and says so.
    fn withdraw(&mut self, cx: &mut Context<'_>) {
        (self.route, self.claims, self.yielding) = (Route::default(), Claims::default(), Yielding::default());
        self.announcement.withdraw(cx);
    }

    pub fn retire(&mut self, cx: &mut Context<'_>) {
        self.withdraw(cx);
        self.coordinator.stop(cx);
    }
    pub fn on_answer(&mut self) {
        self.coordinator.on_answer();
    }
    pub fn on_task(&mut self, cx: &mut Context<'_>) {
        self.withdraw(cx);
        self.coordinator.start_over(cx);
    }
    pub fn on_motion(&mut self, moved: bool) {
        self.route.advance();
        if moved {
            self.yielding.on_moved();
        }
    }
    pub fn forget(&mut self, port: Port) {
        self.paths.remove(&port);
    }
    pub fn repeat(&mut self, cx: &mut Context<'_>) {
        if let Some(path) = self.announced() {
            cx.out.broadcast(cx.v, Class::Liveness, Message::Path(path));
        }
        self.coordinator.repeat(cx);
    }
    pub fn hear_path(&mut self, v: View<'_>, port: Port, path: Path) -> bool {
        let is_later = self.paths.get(&port).is_none_or(|w| w.sequence < path.sequence);
        let is_news = v.neighbours.get(port).is_some() && is_later;
        if is_news {
            self.paths.insert(port, path);
        }
        is_news
    }
    pub fn hear_directive(&mut self, v: View<'_>, port: Port, directive: Directive) -> bool {
        let heard = v.neighbours.get(port).is_some_and(|n| !n.certified_dead);
        heard && self.coordinator.hear(v, directive)
    }
}

/// The motion that an instruction asks of this metamodule, if it is the mover and the way is free.
pub(super) fn ordered_move(v: View<'_>, negotiated: &Negotiated, instruction: Instruction) -> Option<Plan> {
    coordinator::own_move(&Scene::new(v, &negotiated.paths), instruction)
}
