//! The `negotiated` strategy: who goes to which seed, by which way, and who makes way.
//!
//! Seeds are shared out so that all together make as few strides as possible; whoever has got one
//! claims it and announces its way. Claims are ranked by the order of their seeds. Whoever stands in a
//! more important way leaves it, and is as important as that way, one place below it, until it has:
//! ranks travel along chains of those who have to make way for each other. What is promised, under
//! which assumptions, and why, is in `docs/negotiated.md`.
//!
//! Everything here is decided from what a metamodule knows by itself; nobody is in charge. Locks, which
//! keep it safe, are not here: a wrong or late word about a way costs time, never safety.

use super::blueprint::SeedSet;
use super::message::{Claim, LEGS, Leg, Message, Rank, Way};
use super::motions::Sweep;
use super::pose::Pose;
use super::{Metamodule, Phase};
use crate::counters::Class;
use crate::coverage::{Mark, hit};
use crate::defects::Sabotage;
use crate::digest::Portable;
use crate::ids::ModuleId;
use crate::lattice::Cell;
use crate::metamodule::planning::enclosure::is_away;
use crate::metamodule::planning::paths::{Course, Ground};
use crate::metamodule::strategy::greedy_policy::{Aim, Plan};
use crate::time::Time;
use pathfinding::kuhn_munkres::kuhn_munkres_min;
use pathfinding::matrix::Matrix;
use std::hash::Hash;

/// What a metamodule is about, under `negotiated`.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Intent {
    /// The seed it is on its way to.
    pub claim: Option<Claim>,
    /// When everybody has heard of the claim, and would have objected.
    agreed_at: Time,
    /// Seeds that it has no way to, until what stands around changes, or this time.
    pub barred: SeedSet,
    barred_until: Time,
    /// What stood around when the first of them was barred.
    barred_in: u64,
    /// Since when an open seed has been nobody's.
    unclaimed_since: Option<Time>,
    /// What is filled, and since when nothing has been filled besides.
    filled: (SeedSet, Option<Time>),
    /// What stood around when it looked for its course.
    looked_in: (u64, bool),
    /// And what was to stand there by the time it comes.
    planned_in: u64,
    /// Until when it counts as cornered: it had no way out of a more important way.
    cornered_until: Option<Time>,
    /// From when on it does not, where nobody means to go anywhere.
    cornered_at_least: Time,
    /// How often it has been since it last got anywhere.
    pub cornered: u8,
    /// What it has announced.
    pub way: Option<Way>,
    /// What that was made from.
    told: Option<(Course, Pose, Rank)>,
    /// How important what it does is.
    pub rank: Rank,
}

impl Intent {
    pub fn new() -> Intent {
        Intent {
            claim: None,
            agreed_at: Time::ZERO,
            barred: SeedSet::default(),
            barred_until: Time::NEVER,
            barred_in: 0,
            unclaimed_since: None,
            filled: (SeedSet::default(), None),
            looked_in: (0, false),
            planned_in: 0,
            cornered_until: None,
            cornered_at_least: Time::ZERO,
            cornered: 0,
            way: None,
            told: None,
            rank: Rank::NONE,
        }
    }
    /// Hashes what it is about, without what it knows already to be of no use.
    pub fn digest_state(&self, hasher: &mut Portable<'_>) {
        let Intent {
            claim,
            agreed_at,
            barred,
            barred_until,
            unclaimed_since,
            filled,
            cornered_until,
            cornered_at_least,
            cornered,
            way,
            told,
            rank,
            barred_in: _,
            looked_in: _,
            planned_in: _,
        } = self;
        (claim, agreed_at, barred, barred_until, unclaimed_since, filled).hash(hasher);
        (cornered_until, cornered_at_least, cornered, way, told, rank).hash(hasher);
    }
    /// Since when nothing has been filled.
    pub fn filled_since(&self) -> Option<Time> {
        self.filled.1
    }
    /// Whether it is in somebody's way and cannot leave it.
    pub fn is_cornered(&self) -> bool {
        self.cornered_until.is_some()
    }
}

/// Another metamodule that can move.
struct Other {
    id: ModuleId,
    pose: Pose,
    cells: [Cell; 4],
    /// Where it will be when the motion that it is granted is over.
    soon: Pose,
    claim: Option<Claim>,
    barred: SeedSet,
    way: Option<Way>,
}

/// What is around.
pub(super) struct Scene {
    /// Cells of what does not move: the built, the dead, the stuck, obstacles.
    pub stays: Vec<Cell>,
    /// The same, and the cornered.
    fixed: Vec<Cell>,
    /// Who can move, cornered or not, and where it is.
    pub movable: Vec<(ModuleId, Pose)>,
    free: Vec<Other>,
    /// Where everybody stands who has no seed yet and may still get to one.
    hopeful: Vec<Pose>,
    /// All cells to keep out of now: fixed ones, bodies, grants.
    pub taken: Vec<Cell>,
    /// All cells of what will not move when the goal is built.
    built: Vec<Cell>,
    /// The corners of the rectangle around the feet of all seeds.
    zone: ((i16, i16), (i16, i16)),
}

impl Scene {
    /// All cells with something in them.
    fn bodies(&self) -> Vec<Cell> {
        self.fixed.iter().copied().chain(self.free.iter().flat_map(|o| o.cells)).collect()
    }
    /// Whether a connector is more than so many cells away from those of the seeds.
    fn is_beyond(&self, x: i16, y: i16, by: i16) -> bool {
        let (min, max) = self.zone;
        // Without a seed everything is beyond.
        let beyond = |v: i16, min: i16, max: i16| v < min.saturating_sub(by) || v > max.saturating_add(by);
        beyond(x, min.0, max.0) || beyond(y, min.1, max.1)
    }
}

/// What a claimant may do on its way now.
#[derive(Clone, Copy)]
struct May {
    /// End a stride in the zone around the goal, where it may be in the way of what is built.
    enter: bool,
    /// Fill its seed.
    fill: bool,
    /// End a stride where that shuts somebody in.
    hurry: bool,
    /// Fill its seed even if that closes the ways to others.
    anyhow: bool,
}

impl May {
    const ANYTHING: May = May { enter: true, fill: true, hurry: true, anyhow: true };
}

/// After so many times its patience a metamodule leaves its seed to others.
const GIVE_UP: u64 = 3;
/// When nothing has been filled for so many times its patience, what can still be built is built, even if
/// that is at the cost of what cannot be built with it.
const STANDS_STILL: u64 = 8;
/// A cornered metamodule counts as such for twice as long each time, up to so many times.
const MOST_CORNERED: u8 = 3;
/// Leaving a seed that is not open yet to somebody is as bad as so many strides.
const LATER: i64 = 1 << 20;
/// And one that it has barred, as so many.
const BARRED: i64 = 1 << 30;
/// A way that is not there counts as so many strides: it may be there when its time comes.
const FAR: i64 = 1 << 10;
/// In so many places is looked whether somebody else gets past, at most.
const MOST_LET_BY: u32 = 64;
/// So many strides more are worth it to whoever has waited in vain.
const DETOUR: usize = 3;

impl Metamodule {
    fn scene(&self) -> Scene {
        let (core, motions) = (&self.core, &self.setup.motions);
        let (mut stays, mut cornered) = (self.fixed(), Vec::new());
        let (mut free, mut hopeful, mut movable) = (Vec::new(), Vec::new(), Vec::new());
        for (_, peer) in core.peers.iter() {
            let Some(state) = peer.state.filter(|s| !core.dead.contains_key(&s.id)) else { continue };
            let cells = motions.cells(state.pose);
            let soon = peer.grant.map_or(state.pose, |g| Pose { posture: g.ends, ..g.pose });
            if self.stays(&state) || state.stuck {
                stays.extend(cells);
                continue;
            }
            hopeful.push(soon);
            movable.push((state.id, state.pose));
            if state.blocked {
                cornered.extend(cells);
                continue;
            }
            let fits = |c: &Claim| state.task == core.task && !core.filled.has(c.seed);
            free.push(Other {
                id: state.id,
                pose: state.pose,
                cells,
                soon,
                claim: state.claim.filter(fits),
                barred: state.unreachable,
                way: peer.way.filter(|w| w.count > 0),
            });
        }
        free.sort_by_key(|o| o.id);
        movable.sort_by_key(|(id, _)| *id);
        let fixed = [&stays[..], &cornered].concat();
        let mut taken = fixed.clone();
        taken.extend(free.iter().flat_map(|o| o.cells));
        taken.extend(core.peers.granted(motions));
        let seeds = || self.setup.seeds(core.task).map(|(_, s)| s);
        let mut built = self.fixed();
        built.extend(seeds().flat_map(|s| s.cells()));
        let (far, none) = ((i16::MIN, i16::MIN), (i16::MAX, i16::MAX));
        let zone = seeds().fold((none, far), |(min, max), s| {
            let (x, y) = s.foot;
            ((min.0.min(x), min.1.min(y)), (max.0.max(x), max.1.max(y)))
        });
        Scene { stays, fixed, movable, free, hopeful, taken, built, zone }
    }

    pub(super) fn ground<'a>(&'a self, taken: &'a [Cell]) -> Ground<'a> {
        Ground { motions: &self.setup.motions, floor: self.setup.floor, taken }
    }

    /// Looks for something to do.
    pub(super) fn negotiate(&mut self, now: Time, next_expiry: Time) {
        let scene = self.scene();
        self.review(now, &scene);
        if self.lead(now, &scene, next_expiry) {
            return;
        }
        if self.core.intent.claim.is_none() && !self.core.intent.is_cornered() {
            self.claim(now, &scene);
        }
        let claim = self.core.intent.claim;
        let rank = claim.map_or(Rank::NONE, |c| Rank::of_seed(c.seed));
        let corridor = self.corridor(&scene, rank);
        let here = self.setup.motions.cells(self.core.pose);
        if let Some(claim) = claim
            && let Some(plan) = self.go_to_seed(now, &scene, &corridor, claim)
        {
            self.announce(rank, &scene);
            return self.ask(now, plan);
        }
        let in_way_of = corridor.iter().filter(|(cells, _)| here.iter().any(|c| cells.contains(c)));
        let in_way_of = in_way_of.map(|(_, rank)| *rank).min();
        let is_first = claim.is_some_and(|c| self.is_first(&scene, c));
        let is_done = self.core.filled.holds(self.goal().all());
        // The next seed waits until this metamodule is in a safe place, and that may matter more than the way
        // that it stands in: two who each made way for the other, and thereby gave up their own, would go on
        // like that for ever.
        let next = self.open().iter().next().map(Rank::of_seed);
        let matters = in_way_of.is_none_or(|rank| next.is_some_and(|next| next < rank));
        let exposed = matters && !(is_first || is_done || self.is_safe(&scene, self.core.pose));
        let in_way_of = in_way_of.filter(|_| !exposed);
        if exposed || in_way_of.is_some() {
            let rank = in_way_of.or(next).map_or(Rank::NONE, Rank::below);
            let kept = std::mem::take(&mut self.core.course);
            let plan = self.make_way(&scene, rank);
            if plan.is_none() && in_way_of.is_some() && self.core.course.is_over() {
                hit(Mark::MetaCornered);
                // Longer every time: whoever goes around it must get past it before it counts as free again.
                let (times, patience) = (self.core.intent.cornered, self.setup.params.patience);
                let intent = &mut self.core.intent;
                intent.cornered = (times + 1).min(MOST_CORNERED);
                intent.cornered_until = Some(now + patience * (1 << times));
                // Whoever meant to come this way may have given it up for that very reason, and would mean to
                // again: they must not go on like that without time passing.
                let again = times == MOST_CORNERED;
                intent.cornered_at_least = if again { now + patience } else { now };
                self.tell(now, Class::Gradient);
            }
            self.announce(rank, &scene);
            if claim.is_some() {
                // Where it was going is found again from where it ends up.
                self.core.course = kept;
            }
            if let Some(plan) = plan {
                hit(Mark::MetaMadeWay);
                self.core.course = Course::default();
                return self.ask(now, plan);
            }
        } else {
            if claim.is_none() {
                self.core.course = Course::default();
            }
            self.announce(rank, &scene);
        }
        let waits = claim.is_some() || in_way_of.is_some() || self.core.intent.unclaimed_since.is_some();
        let intent = &self.core.intent;
        let params = &self.setup.params;
        let patience = if waits { now + params.patience } else { Time::NEVER };
        let shared = intent.unclaimed_since.map(|since| since + params.resend);
        let agreed = claim.map(|_| intent.agreed_at);
        let patience = shared.or(agreed).filter(|at| *at > now).unwrap_or(patience);
        let barred = if intent.barred.is_empty() { Time::NEVER } else { intent.barred_until };
        let cornered = intent.cornered_until.unwrap_or(Time::NEVER);
        let cornered = if now < intent.cornered_at_least { intent.cornered_at_least } else { cornered };
        let leads = self.leads_at(now, &scene);
        let look_at =
            [next_expiry, patience, barred, cornered, leads].into_iter().fold(Time::NEVER, Time::min);
        self.core.phase = Phase::Idle { look_at };
    }

    /// Drops what no longer holds: a claim that somebody nearer has made too, or on what is filled; bars
    /// from when something else stood around.
    fn review(&mut self, now: Time, scene: &Scene) {
        // Where nobody means to go anywhere, nobody is in the way.
        let at_least = self.core.intent.cornered_at_least;
        let is_over =
            |until: Time| now >= until || (now >= at_least && scene.free.iter().all(|o| o.way.is_none()));
        if self.core.intent.cornered_until.is_some_and(is_over) {
            self.core.intent.cornered_until = None;
            self.tell(now, Class::Gradient);
        }
        let open = self.open();
        let around = fingerprint(&scene.fixed);
        if self.core.intent.filled.1.is_none() || self.core.intent.filled.0 != self.core.filled {
            self.core.intent.filled = (self.core.filled, Some(now));
        }
        let me = self.core.id;
        let intent = &mut self.core.intent;
        if now >= intent.barred_until || (intent.barred_in != around && !intent.barred.is_empty()) {
            intent.barred = SeedSet::default();
            intent.barred_until = Time::NEVER;
        }
        if let Some(claim) = intent.claim {
            let better = |o: &Other| {
                o.claim.is_some_and(|c| c.seed == claim.seed && (c.cost, o.id) < (claim.cost, me))
            };
            let outranked = scene.free.iter().any(better);
            if outranked {
                hit(Mark::MetaOutranked);
            }
            if !open.has(claim.seed) || outranked {
                self.drop_claim();
            }
        }
    }

    fn drop_claim(&mut self) {
        self.core.intent.claim = None;
        self.core.course = Course::default();
    }

    fn bar(&mut self, now: Time, seed: u8, scene: &Scene) {
        hit(Mark::MetaBarred);
        let params = &self.setup.params;
        let intent = &mut self.core.intent;
        intent.barred = intent.barred.with(seed);
        intent.barred_in = fingerprint(&scene.fixed);
        intent.barred_until = now + params.patience * 4;
    }

    /// Claims an open seed, if the best way of sharing them out gives it one, or if nobody takes one
    /// for long.
    fn claim(&mut self, now: Time, scene: &Scene) {
        loop {
            let claimed = scene.free.iter().filter_map(|o| o.claim);
            let claimed = claimed.fold(SeedSet::default(), |set, c| set.with(c.seed));
            let open = self.open().without(claimed).without(self.core.intent.barred);
            if open.is_empty() {
                self.core.intent.unclaimed_since = None;
                return;
            }
            let since = *self.core.intent.unclaimed_since.get_or_insert(now);
            if now < since + self.setup.params.resend {
                // Until everybody has heard what this one has, they would share out differently.
                return;
            }
            let patient = now < since + self.setup.params.patience;
            let shared = self.share(scene, open, claimed).filter(|s| open.has(*s));
            let me = [(self.core.id, self.core.pose, SeedSet::default())];
            let nearest = || open.iter().min_by_key(|s| self.strides(scene, &me, *s));
            let Some(number) = shared.or_else(|| nearest().filter(|_| !patient)) else { return };
            if shared.is_none() {
                hit(Mark::MetaNearest);
            }
            match self.course_to(scene, number, true) {
                Some(course) => {
                    let cost = u8::try_from(course.strides.len()).unwrap_or(u8::MAX);
                    self.core.intent.claim = Some(Claim { seed: number, cost });
                    self.core.intent.agreed_at = now + self.setup.params.resend;
                    self.core.intent.unclaimed_since = None;
                    self.core.course = course;
                    self.core.intent.planned_in = fingerprint(&self.planned(scene, number));
                    self.core.waiting_since = now;
                }
                None => self.bar(now, number, scene),
            }
            self.tell(now, Class::Gradient);
            if self.core.intent.claim.is_some() {
                return;
            }
        }
    }

    /// Strides to a seed from everybody, around what will be built before it.
    fn strides(&self, scene: &Scene, from: &[(ModuleId, Pose, SeedSet)], number: u8) -> Vec<i64> {
        let Some(seed) = self.setup.seed(self.core.task, number) else { return vec![BARRED; from.len()] };
        let planned = self.planned(scene, number);
        let ground = self.ground(&planned);
        let distances = self.setup.motions.distances(self.setup.floor, seed, &planned);
        let strides = |pose: Pose| distances.strides(pose, ground.lands(pose)).map_or(FAR, i64::from);
        from.iter().map(|(_, pose, _)| strides(*pose)).collect()
    }

    /// The seed that falls to this metamodule if all that are nobody's yet are shared out among those
    /// without one, with the fewest strides; open seeds before later ones.
    fn share(&self, scene: &Scene, open: SeedSet, claimed: SeedSet) -> Option<u8> {
        let me = (self.core.id, self.core.pose, self.core.intent.barred);
        let others = scene.free.iter().filter(|o| o.claim.is_none()).map(|o| (o.id, o.pose, o.barred));
        let mut walkers: Vec<_> = others.chain([me]).collect();
        walkers.sort_by_key(|w| w.0);
        let seeds: Vec<u8> = self.goal().all().without(self.core.filled).without(claimed).iter().collect();
        let strides: Vec<Vec<i64>> = seeds.iter().map(|s| self.strides(scene, &walkers, *s)).collect();
        let cost = |walker: usize, place: usize| {
            let ((_, _, barred), seed) = (walkers[walker], seeds[place]);
            let later = if open.has(seed) { 0 } else { LATER };
            let barred = if barred.has(seed) { BARRED } else { 0 };
            strides[place][walker] + later + barred
        };
        let mine = walkers.iter().position(|w| w.0 == self.core.id)?;
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

    /// What will not move, with all that is to be built before this seed.
    fn planned(&self, scene: &Scene, number: u8) -> Vec<Cell> {
        let before = self.goal().before(number).without(self.core.filled);
        let seeds = before.iter().filter_map(|s| self.setup.seed(self.core.task, s));
        scene.fixed.iter().copied().chain(seeds.flat_map(|s| s.cells())).collect()
    }

    /// The best course to a seed: around those who stand about if that is not longer than what they
    /// would need to make way, through where they stand otherwise.
    fn course_to(&self, scene: &Scene, number: u8, patient: bool) -> Option<Course> {
        let seed = self.setup.seed(self.core.task, number)?;
        let find = |fixed: &[Cell]| {
            let pose = self.core.pose;
            let through = self.ground(fixed).to_seed(pose, seed, fixed, usize::MAX)?;
            let swept = self.cells_of(pose, &self.legs(scene, &through));
            let in_way = scene.free.iter().filter(|o| o.cells.iter().any(|c| swept.contains(c))).count();
            if in_way == 0 {
                return Some(through);
            }
            let worth = through.strides.len() + in_way + if patient { 0 } else { DETOUR };
            let bodies: Vec<Cell> =
                fixed.iter().copied().chain(scene.free.iter().flat_map(|o| o.cells)).collect();
            Some(self.ground(&bodies).to_seed(pose, seed, fixed, worth).unwrap_or(through))
        };
        find(&self.planned(scene, number)).or_else(|| find(&scene.fixed))
    }

    /// The next motion to the claimed seed, if it can be made now.
    fn go_to_seed(
        &mut self,
        now: Time,
        scene: &Scene,
        corridor: &[(Vec<Cell>, Rank)],
        claim: Claim,
    ) -> Option<Plan> {
        if now < self.core.intent.agreed_at {
            // A stride towards a seed that is lost to somebody nearer would be one in vain.
            return None;
        }
        let enter = self.is_first(scene, claim);
        let waited = now.since(self.core.waiting_since);
        let patience = self.setup.params.patience;
        let left = self.goal().all().without(self.core.filled).without(SeedSet::default().with(claim.seed));
        let count = |taken: &[Cell]| {
            let ground = self.ground(taken);
            scene.hopeful.iter().filter(|p| !ground.is_shut_in(**p)).count().min(left.len())
        };
        let movable = count(&scene.built);
        // Whoever is shut in by what stays anyway is lost whatever is built.
        let loses = movable < scene.hopeful.len().min(left.len()) && movable < count(&scene.fixed);
        let walls_in = loses
            || (waited <= patience * (GIVE_UP - 1)
                && scene.free.iter().any(|o| !self.is_safe_beside(scene, o, self.core.pose)));
        let stands_still = self.core.intent.filled.1.is_some_and(|t| now.since(t) > patience * STANDS_STILL);
        let may = May {
            enter,
            fill: enter && (stands_still || !walls_in),
            hurry: enter && waited > patience,
            anyhow: stands_still,
        };
        let planned = fingerprint(&self.planned(scene, claim.seed));
        if self.core.intent.planned_in == planned
            && let Some(plan) = self.next_leg(scene, &scene.taken, corridor, claim, may)
        {
            return Some(plan);
        }
        if !enter {
            // Its turn will come; that is no reason to lose patience.
            self.core.waiting_since = now;
            return None;
        }
        let bodies = scene.bodies();
        if waited > patience * GIVE_UP {
            self.give_up(now, scene, claim);
            return None;
        }
        let looked_in = (fingerprint(&bodies), waited <= patience);
        let fits = self.core.intent.planned_in == planned;
        // Whoever has been granted a way will be through it soon.
        let is_open = || self.next_leg(scene, &bodies, &[], claim, May::ANYTHING).is_some();
        if fits && (self.core.intent.looked_in == looked_in || (is_open() && waited <= patience)) {
            return None;
        }
        let Some(course) = self.course_to(scene, claim.seed, waited <= patience) else {
            self.give_up(now, scene, claim);
            return None;
        };
        self.core.course = course;
        (self.core.intent.looked_in, self.core.intent.planned_in) = (looked_in, planned);
        self.next_leg(scene, &scene.taken, corridor, claim, may)
    }

    /// Leaves a seed to somebody else.
    fn give_up(&mut self, now: Time, scene: &Scene, claim: Claim) {
        hit(Mark::MetaGaveUpSeed);
        self.drop_claim();
        self.bar(now, claim.seed, scene);
        self.tell(now, Class::Gradient);
    }

    /// Whether nobody has claimed a seed before this one. Only the first may be in the zone: whoever else
    /// were there could be walled in.
    fn is_first(&self, scene: &Scene, claim: Claim) -> bool {
        scene.free.iter().filter_map(|o| o.claim).all(|c| claim.seed <= c.seed)
    }

    /// The next leg of the course over free ground, if this metamodule may make it. It does not end in a
    /// more important way.
    fn next_leg(
        &self,
        scene: &Scene,
        taken: &[Cell],
        corridor: &[(Vec<Cell>, Rank)],
        claim: Claim,
        may: May,
    ) -> Option<Plan> {
        let (posture, lands) = self.core.course.next()?;
        let ground = self.ground(taken);
        let pose = self.core.pose;
        let aim = if lands { Aim::Land } else { Aim::Settle(claim.seed) };
        if lands {
            ground.landed(pose, posture)?;
            let ends = self.setup.motions.cells(Pose { posture, ..pose });
            if corridor.iter().any(|(cells, _)| ends.iter().any(|c| cells.contains(c))) {
                return None;
            }
            let end = Pose { posture, ..pose };
            let harmless = !may.hurry && (!may.enter || self.is_off(scene, end));
            if harmless && !self.is_apart(scene, end) {
                return None;
            }
            Some(Plan { harmless, ..Plan::to(&ground, pose, posture, aim)? })
        } else if may.fill && (may.anyhow || self.keeps_open(scene, claim.seed)) {
            Plan::to(&ground, pose, posture, aim)
        } else {
            None
        }
    }

    /// The way out of everything at least as important as what this metamodule makes way for. Its
    /// first leg, if it is free.
    fn make_way(&mut self, scene: &Scene, rank: Rank) -> Option<Plan> {
        let (corridor, me, pose) = (self.corridor(scene, rank), self.core.id, self.core.pose);
        let motions = &self.setup.motions;
        let is_clear = |pose: Pose| {
            let cells = motions.cells(pose);
            !cells.iter().any(|cell| corridor.iter().any(|(cells, _)| cells.contains(cell)))
        };
        let is_apart = |pose: Pose| is_clear(pose) && self.is_apart(scene, pose);
        // What a leg sweeps is one way of many to its end: whoever is out of all ends may be got past.
        let ends = self.ends(scene, rank);
        let is_past = |pose: Pose| !motions.cells(pose).iter().any(|cell| ends.contains(cell));
        let past = |ground: &Ground<'_>| ground.aside(pose, is_past).filter(|course| !course.is_over());
        // Whoever is more important does not make way.
        let is_firm = |o: &&Other| o.way.is_some_and(|w| (w.rank, o.id) < (rank, me));
        let firm = scene.free.iter().filter(is_firm).flat_map(|o| o.cells);
        let firm: Vec<Cell> = scene.fixed.iter().copied().chain(firm).collect();
        let (free, firm) = (self.ground(&scene.taken), self.ground(&firm));
        let course = free
            .aside(pose, is_apart)
            .or_else(|| firm.aside(pose, is_apart))
            .or_else(|| free.aside(pose, is_clear))
            .or_else(|| firm.aside(pose, is_clear))
            .or_else(|| past(&free).or_else(|| past(&firm)))
            .or_else(|| self.let_by(scene, rank, &free))?;
        let next = course.next();
        let plan = next.and_then(|(posture, lands)| {
            let harmless = self.is_apart(scene, Pose { posture, ..pose });
            let aim = if lands { Aim::Land } else { Aim::Shift };
            Some(Plan { harmless, ..Plan::to(&free, pose, posture, aim)? })
        });
        self.core.course = course;
        plan
    }

    /// A course to the nearest place in which this metamodule may stay: the most important of those in whose
    /// way it is gets to its seed by some other way then.
    fn let_by(&self, scene: &Scene, rank: Rank, ground: &Ground<'_>) -> Option<Course> {
        let claims = |o: &Other| o.claim.filter(|c| o.way.is_some_and(|w| w.rank == Rank::of_seed(c.seed)));
        let claims = scene.free.iter().filter_map(|o| Some((claims(o)?.seed, o.pose)));
        let (number, from) =
            claims.min_by_key(|(seed, _)| *seed).filter(|(s, _)| Rank::of_seed(*s) < rank)?;
        let (seed, planned) = (self.setup.seed(self.core.task, number)?, self.planned(scene, number));
        let mut left = MOST_LET_BY;
        let course = ground.aside(self.core.pose, |pose| {
            let may_look = left > 0;
            left = left.saturating_sub(1);
            let fixed = [&planned[..], &self.setup.motions.cells(pose)].concat();
            may_look && self.ground(&fixed).to_seed(from, seed, &fixed, usize::MAX).is_some()
        })?;
        if !course.is_over() {
            hit(Mark::MetaLetBy);
        }
        Some(course)
    }

    /// Whether whoever stands like this is out of the way of what is built, and can get away when all of
    /// it is, even if nobody else moves: the goal and one cell around it are kept free, and whoever lies
    /// beside it may need room that the goal will take.
    fn is_safe(&self, scene: &Scene, pose: Pose) -> bool {
        let mut taken = scene.built.clone();
        taken.extend(scene.free.iter().flat_map(|o| self.setup.motions.cells(o.soon)));
        self.is_off(scene, pose) && !self.ground(&taken).is_shut_in(pose)
    }

    /// The same for somebody else if this metamodule stood like this.
    fn is_safe_beside(&self, scene: &Scene, other: &Other, me: Pose) -> bool {
        let motions = &self.setup.motions;
        let others = scene.free.iter().filter(|o| o.id != other.id);
        let others = others.map(|o| o.soon).chain([me]).flat_map(|pose| motions.cells(pose));
        let taken: Vec<Cell> = scene.built.iter().copied().chain(others).collect();
        self.is_off(scene, other.soon) && !self.ground(&taken).is_shut_in(other.soon)
    }

    /// Whether whoever stands like this is out of the zone.
    fn is_off(&self, scene: &Scene, pose: Pose) -> bool {
        self.setup.motions.cells(pose).iter().all(|c| scene.is_beyond(c.x, c.y, 1))
    }

    /// Whether it is no harm to anybody if this metamodule stands like this.
    fn is_apart(&self, scene: &Scene, me: Pose) -> bool {
        self.is_safe(scene, me) && !self.shuts_in(scene, me)
    }

    /// The same, from what is known by now.
    pub(super) fn is_harmless(&self, posture: u16) -> bool {
        self.is_apart(&self.scene(), Pose { posture, ..self.core.pose })
    }

    /// Whether somebody who is safe now would not be any more if this metamodule stood somewhere else.
    fn shuts_in(&self, scene: &Scene, me: Pose) -> bool {
        let is_safe = |o: &Other, me: Pose| self.is_safe_beside(scene, o, me);
        scene.free.iter().any(|o| !is_safe(o, me) && is_safe(o, self.core.pose))
    }

    /// Whether all seeds that should have been filled before this one can still be got to when it has been.
    fn keeps_open(&self, scene: &Scene, number: u8) -> bool {
        let Some(seed) = self.setup.seed(self.core.task, number) else { return true };
        let before = self.goal().before(number).without(self.core.filled);
        before.iter().filter_map(|s| Some((s, self.setup.seed(self.core.task, s)?))).all(|(number, other)| {
            let mut around = self.planned(scene, number);
            around.extend(seed.cells());
            let distances = self.setup.motions.distances(self.setup.floor, other, &around);
            let (x, y) = other.foot;
            distances.reach(|from| is_away((i64::from(x) * 4, i64::from(y) * 4), from))
        })
    }

    /// The ways that are more important than a rank.
    fn ways_above(&self, scene: &Scene, rank: Rank) -> impl Iterator<Item = Way> {
        let me = self.core.id;
        let heeds = !self.has(Sabotage::StandInTheWay);
        let ways = scene.free.iter().filter_map(|o| Some((o.id, o.way?)));
        ways.filter(move |(id, w)| heeds && (w.rank, *id) < (rank, me)).map(|(_, way)| way)
    }

    /// The same with the cells of each.
    fn corridor(&self, scene: &Scene, rank: Rank) -> Vec<(Vec<Cell>, Rank)> {
        self.ways_above(scene, rank).map(|w| (self.cells_of(w.from, w.legs()), w.rank)).collect()
    }

    /// Only the cells in which their legs end.
    fn ends(&self, scene: &Scene, rank: Rank) -> Vec<Cell> {
        let unswept = |leg: &Leg| Leg { sweep: Sweep::default(), ..*leg };
        let ends = |w: Way| self.cells_of(w.from, &w.legs().iter().map(unswept).collect::<Vec<Leg>>());
        self.ways_above(scene, rank).flat_map(ends).collect()
    }

    /// All cells of a way.
    fn cells_of(&self, from: Pose, legs: &[Leg]) -> Vec<Cell> {
        let motions = &self.setup.motions;
        let (mut at, mut cells) = (from, Vec::new());
        for leg in legs {
            cells.extend(motions.swept(at.state, leg.sweep));
            let ends = Pose { posture: leg.posture, ..at };
            cells.extend(motions.cells(ends));
            match motions.turned_around(ends) {
                Some(to) => at = to,
                None => break,
            }
        }
        cells
    }

    /// The first legs of a course, around others where that is possible without another course.
    fn legs(&self, scene: &Scene, course: &Course) -> Vec<Leg> {
        let (fixed, taken) = (self.ground(&scene.fixed), self.ground(&scene.taken));
        let (mut at, mut legs) = (self.core.pose, Vec::new());
        for posture in course.strides.iter().copied().chain(course.last).take(LEGS) {
            let Some(straight) = Plan::to(&fixed, at, posture, Aim::Land) else { break };
            let is_free = straight.sweep.0 & taken.taken_at(at) == 0;
            let around = || Plan::to(&taken, at, posture, Aim::Land);
            let plan = if is_free { straight } else { around().unwrap_or(straight) };
            legs.push(Leg { posture, sweep: plan.sweep });
            match fixed.landed(at, posture) {
                Some(to) => at = to,
                None => break,
            }
        }
        legs
    }

    /// Tells where it means to go, if that has changed.
    fn announce(&mut self, rank: Rank, scene: &Scene) {
        self.core.intent.rank = rank;
        let course = &self.core.course;
        let silent =
            self.core.intent.claim.is_some_and(|c| !self.is_first(scene, c) && Rank::of_seed(c.seed) == rank);
        let subject = (!course.is_over() && !silent).then(|| (course.clone(), self.core.pose, rank));
        if self.core.intent.told == subject {
            return;
        }
        let told = if subject.is_some() { self.legs(scene, course) } else { Vec::new() };
        let mut legs = [Leg::default(); LEGS];
        legs.iter_mut().zip(&told).for_each(|(leg, told)| *leg = *told);
        let core = &mut self.core;
        core.intent.told = subject;
        core.sequence += 1;
        let (id, sequence, from, count) = (core.id, core.sequence, core.pose, told.len() as u8);
        let way = Way { id, sequence, rank, from, legs, count };
        let before = std::mem::replace(&mut core.intent.way, (count > 0).then_some(way));
        if before.is_some() || count > 0 {
            self.broadcast(Class::Negotiation, Message::Way(way));
        }
    }

    /// Is about nothing any more, and says so.
    pub(super) fn withdraw(&mut self) {
        self.core.course = Course::default();
        let before = std::mem::replace(&mut self.core.intent, Intent::new());
        if let Some(way) = before.way {
            self.core.sequence += 1;
            // No legs, not even those that are not told: all who hear it keep the same.
            let legs = [Leg::default(); LEGS];
            let way = Way { sequence: self.core.sequence, rank: Rank::NONE, legs, count: 0, ..way };
            self.broadcast(Class::Negotiation, Message::Way(way));
        }
    }

    /// Is about nothing of its own as long as somebody leads.
    pub(super) fn fall_silent(&mut self, now: Time) {
        let filled = self.core.intent.filled;
        let silent = Intent { filled, ..Intent::new() };
        if self.core.intent != silent {
            self.withdraw();
            self.core.intent.filled = filled;
            self.core.waiting_since = now;
            self.tell(now, Class::Gradient);
        }
    }

    /// Somebody tells where it means to go.
    pub(super) fn hear_way(&mut self, now: Time, port: crate::ids::Port, way: Way) {
        let Some(peer) = self.core.peers.get_mut(port) else { return };
        if peer.way.is_none_or(|w| w.sequence < way.sequence) {
            peer.way = Some(way);
            self.look_again(now);
        }
    }
}

/// Tells one set of cells from another.
pub(super) fn fingerprint(cells: &[Cell]) -> u64 {
    let mix = |c: &Cell| {
        let v = (c.x as u16 as u64) << 32 | (c.y as u16 as u64) << 16 | c.z as u16 as u64;
        (v + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29).wrapping_mul(0xBF58_476D_1CE4_E5B9)
    };
    // The order of the cells does not matter.
    cells.iter().map(mix).fold(0, u64::wrapping_add)
}
