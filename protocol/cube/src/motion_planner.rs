//! Where to go: the motion that leads towards a target, and when a module leaves for it.

use super::Cube;
use super::attraction::Attraction;
use super::beacon::Beacons;
use super::body::{Percept, Refusal};
use super::message::{Beacon, Role};
use super::negotiation::Attempt;
use super::params::{BACK_OFF, BACK_OFF_SPREAD, Connectivity, MOST_DOUBLED, Params};
use super::sides::Sides;
use super::steering::{Steered, Steering};
use super::turns::Window;
use super::view::View;
use alloc::vec::Vec;
use core::hash::Hash;
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::digest::Portable;
use metamorph_core::ids::ModuleId;
use metamorph_core::lattice::{Cell, Face, Motion, MotionKind};
use metamorph_core::ratio::Ratio;
use metamorph_core::rng::Rng;
use metamorph_core::time::Time;

/// Number of decisions for which a module waits for its outer neighbours to leave first.
const OUTERMOST_FIRST: u16 = 6;
/// The same number with connecting cycles.
const OUTERMOST_FIRST_IN_CYCLES: u16 = 200;
/// Number of deferrals up to which a module in reserve accepts no detour; after that, it accepts a detour of one move.
const DETOUR: u16 = 12;
/// The same number of a walker, which stands in the way of others while it waits.
const WALKER_DETOUR: u16 = 3;
/// Number of deferrals after which a module sometimes accepts a detour of two moves.
const WIDE_DETOUR: u16 = 40;

/// The largest number of targets that a module in reserve remembers.
const MAX_TARGETS: usize = 24;

/// A target known to a module in reserve. A module leaves for a target only after it has known it for
/// [`Params::recruit_per_move`] per move of its distance. So each target recruits from a growing circle, and few more
/// modules walk than are needed.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Target {
    source: u32,
    first: Time,
    last: Time,
}

/// A motion that leads towards a target.
struct Candidate {
    moves: u16,
    source: u32,
    /// True if the support is not finalized; a finalized one is steadier.
    over_loose: bool,
    motion: Motion,
    /// True if another module must move on before this motion is possible.
    is_taken: bool,
    /// That module, if this one touches it.
    behind: Option<ModuleId>,
}

/// The parts of a planner's state, in the order in which they are hashed.
#[derive(Clone, Copy, Debug)]
pub(super) enum DigestPart {
    Waiting,
    Failures,
    Targets,
}

/// The motions over the supports of a module, by what the module knows of them.
#[derive(Default)]
pub(super) struct Candidates {
    /// Motions towards a target, over every live support.
    known: Vec<Candidate>,
    /// Motions to free cells from which no distance to a target is known.
    blind: Vec<Motion>,
    /// For each support, headings whose corner is blocked.
    corners: [u8; 6],
}

/// Which motions a module looks at.
#[derive(Clone, Copy, Debug)]
struct Outlook {
    /// Those that lead to no known target as well.
    all: bool,
    /// Not those whose cell is said to be taken ([`Beacon::taken`]).
    trusts: bool,
}

/// When and where a module wants to move.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct MotionPlanner {
    /// When to decide next.
    pub decide_at: Time,
    pub back_off_until: Time,
    /// Since when this module has been wanting to move.
    pub waiting_since: Option<Time>,
    /// The module in the way, if it is known.
    pub waits_for: Option<ModuleId>,
    /// The number of decisions put off and of attempts failed since the last move.
    deferrals: u16,
    /// The number of attempts that failed in a row.
    denied: u8,
    /// The number of actions of the body that failed in a row.
    failed: u8,
    pub corners_seen: [u8; 6],
    /// Targets heard of while in reserve.
    targets: Vec<Target>,
}

impl MotionPlanner {
    pub fn new(now: Time) -> MotionPlanner {
        MotionPlanner {
            decide_at: now,
            back_off_until: now,
            waiting_since: None,
            waits_for: None,
            deferrals: 0,
            denied: 0,
            failed: 0,
            corners_seen: [0; 6],
            targets: Vec::new(),
        }
    }

    /// Feeds the state into a hash; see `digest`.
    pub fn digest(&self, hasher: &mut Portable<'_>, part: DigestPart) {
        let MotionPlanner {
            decide_at: _,
            back_off_until,
            waiting_since,
            waits_for,
            deferrals,
            denied,
            failed,
            corners_seen,
            targets,
        } = self;
        match part {
            DigestPart::Waiting => (back_off_until, waiting_since, waits_for).hash(hasher),
            DigestPart::Failures => (deferrals, denied, failed).hash(hasher),
            DigestPart::Targets => (corners_seen, targets).hash(hasher),
        }
    }
    /// Returns the directions in which the corner over a support was found blocked.
    pub fn corners_seen(&self, support: Face) -> u8 {
        self.corners_seen[support.index()]
    }
    /// Resets the state of a module that is finalized.
    pub fn on_finalized(&mut self) {
        self.stop_waiting();
    }
    /// Starts over with another goal.
    pub fn on_goal(&mut self) {
        (self.deferrals, self.waiting_since) = (0, None);
    }
    /// Notes that the module stands at a new cell, by a move of its own or of an earlier incarnation.
    pub fn on_arrival(&mut self) {
        self.corners_seen = [0; 6];
    }
    /// Notes that a move of this incarnation has succeeded.
    pub fn on_moved(&mut self, decide_at: Time) {
        self.stop_waiting();
        (self.deferrals, self.denied, self.failed) = (0, 0, 0);
        self.decide_at = decide_at;
    }
    /// Notes that the body has failed to move. Returns true if the module counts as immobile now.
    pub fn on_failed(&mut self, now: Time, p: &Params, rng: &mut Rng) -> bool {
        self.failed = self.failed.saturating_add(1);
        let immobile = self.failed >= p.immobile_after;
        self.denied = self.denied.saturating_add(1);
        self.back_off(now, p, rng);
        if immobile {
            hit(CoveragePoint::CubeImmobile);
            self.back_off_until = now + p.out_of_turn_after;
            self.decide_at = self.back_off_until;
        }
        immobile
    }
    /// Notes that an attempt has failed.
    pub fn count_denial(&mut self) {
        self.denied = self.denied.saturating_add(1);
        self.deferrals = self.deferrals.saturating_add(1);
    }
    fn stop_waiting(&mut self) {
        (self.waiting_since, self.waits_for) = (None, None);
    }

    /// Waits before the next attempt, the longer the more attempts have failed in a row.
    pub fn back_off(&mut self, now: Time, p: &Params, rng: &mut Rng) {
        let spread = BACK_OFF_SPREAD << self.denied.min(MOST_DOUBLED);
        let ticks = BACK_OFF + rng.below(spread);
        self.back_off_until = now + p.tick() * ticks;
        self.decide_at = self.back_off_until;
    }
    /// Schedules a decision at once or, during a back-off, at its end, because something has changed.
    pub fn decide_soon(&mut self, now: Time) {
        self.decide_at = self.decide_at.min(self.back_off_until.max(now));
    }
    /// Ends a back-off, because the reason for the attempts before is gone.
    pub fn end_back_off(&mut self, now: Time) {
        (self.back_off_until, self.denied) = (now, 0);
    }
    fn decide_later(&mut self, now: Time, p: &Params) {
        self.deferrals = self.deferrals.saturating_add(1);
        self.decide_at = now + p.advertise;
    }

    /// Returns true if a module waits for a cell that it is told is taken. One that has waited for long asks: the denial names the
    /// module in the way, and what it was told may be out of date.
    fn trusts_hints(&self) -> bool {
        self.deferrals <= WIDE_DETOUR
    }
    /// Returns true if a module in reserve waits for an outer neighbour to leave first.
    fn waits_for_outer(&self, v: View<'_>, label: u16) -> bool {
        let outer = |b: &Beacon| b.role == Role::Reserve && b.rank.label > label;
        let has_outer = Face::in_mask(v.sides.support_mask()).any(|f| v.support(f).is_some_and(outer));
        let deferrals = match v.own.connectivity() {
            // A module that leaves from the middle leaves a mesh of loops too long for any search.
            Connectivity::Cycles => OUTERMOST_FIRST_IN_CYCLES,
            Connectivity::Forest | Connectivity::Gradient => OUTERMOST_FIRST,
        };
        has_outer && self.deferrals < deferrals
    }

    /// Chooses a motion, or when to decide again.
    fn choose(&mut self, v: View<'_>, candidates: &Candidates, rng: &mut Rng) -> Option<Motion> {
        let Some(nearest) = candidates.known.iter().map(|o| o.moves).min() else {
            self.stop_waiting();
            return None;
        };
        if v.own.role == Role::Reserve
            && let Some(source) = candidates.known.iter().find(|o| o.moves == nearest).map(|o| o.source)
        {
            let go = self.heard_since(v.now, source) + v.params().recruit_per_move * u64::from(nearest);
            if v.now < go {
                self.decide_at = go;
                return None;
            }
        }
        let patience = if v.own.role == Role::Walker { WALKER_DETOUR } else { DETOUR };
        let slack = match self.deferrals {
            p if p <= patience => 0,
            p if p > WIDE_DETOUR && rng.chance(QUARTER) => 2,
            _ => 1,
        };
        let Some(best) = best_of(&candidates.known, nearest + slack, rng) else {
            hit(CoveragePoint::CubeBehindWalker);
            self.waits_for = candidates.known.iter().find_map(|o| o.behind).or(self.waits_for);
            self.waiting_since.get_or_insert(v.now);
            self.decide_later(v.now, v.params());
            return None;
        };
        if best.moves > nearest {
            hit(CoveragePoint::CubeDetour);
        }
        Some(best.motion)
    }

    /// Notes that a target has been heard of.
    pub fn hear_of(&mut self, now: Time, source: u32) {
        if let Some(target) = self.targets.iter_mut().find(|t| t.source == source) {
            target.last = now;
            return;
        }
        if self.targets.len() == MAX_TARGETS {
            let oldest = (0..MAX_TARGETS).min_by_key(|i| self.targets[*i].last);
            oldest.map(|i| self.targets.swap_remove(i));
        }
        self.targets.push(Target { source, first: now, last: now });
    }

    fn heard_since(&mut self, now: Time, source: u32) -> Time {
        self.hear_of(now, source);
        self.targets.iter().find(|t| t.source == source).map_or(now, |t| t.first)
    }
}

/// Returns the best candidate that is free and no longer than `longest`; of equally good ones, a random one.
fn best_of<'a>(candidates: &'a [Candidate], longest: u16, rng: &mut Rng) -> Option<&'a Candidate> {
    let key = |o: &Candidate| (o.moves, o.over_loose);
    let mut best: Option<&Candidate> = None;
    let mut ties = 0;
    for candidate in candidates.iter().filter(|o| !o.is_taken && o.moves <= longest) {
        match best.map(|b| key(candidate).cmp(&key(b))) {
            None | Some(core::cmp::Ordering::Less) => (best, ties) = (Some(candidate), 1),
            Some(core::cmp::Ordering::Equal) => {
                ties += 1;
                if rng.below(ties) == 0 {
                    best = Some(candidate);
                }
            }
            Some(core::cmp::Ordering::Greater) => {}
        }
    }
    best
}

impl Candidates {
    /// Iterates over the motions that no walker is in the way of.
    pub fn free(&self) -> impl Iterator<Item = Motion> {
        let known =
            self.known.iter().filter(|candidate| !candidate.is_taken).map(|candidate| candidate.motion);
        known.chain(self.blind.iter().copied())
    }

    /// Evaluates the motions over every live support.
    fn around(v: View<'_>, outlook: Outlook) -> Candidates {
        let mut candidates = Candidates::default();
        for support in Face::in_mask(v.sides.support_mask()) {
            let Some(b) = v.support(support) else { continue };
            for (slot, heading) in support.perpendicular().into_iter().enumerate() {
                candidates.add(v, outlook, (b, slot), support, heading);
            }
        }
        candidates
    }

    fn add(
        &mut self,
        v: View<'_>,
        outlook: Outlook,
        (b, slot): (&Beacon, usize),
        support: Face,
        heading: Face,
    ) {
        // The support cannot see what stands over its edge.
        let is_edge = (b.supports | b.dead) & heading.bit() == 0;
        let behind = match (v.sides.is_touching(heading), v.peer(heading)) {
            (false, _) => None,
            (true, Some(peer)) if v.sides.is_open(heading) => Some(peer.id),
            // A module that has just come there will send its state.
            (true, None) if !v.sides.is_certified_dead(heading) => return,
            (true, _) => {
                self.corners[support.index()] |= if is_edge { heading.bit() } else { 0 };
                return;
            }
        };
        let is_said_to_be_taken = outlook.trusts && is_edge && b.taken & heading.bit() != 0;
        let is_taken = behind.is_some() || is_said_to_be_taken;
        let kind = if is_edge { MotionKind::Convex } else { MotionKind::Slide };
        let (entry, motion) = (b.field[slot], Motion { kind, support, heading });
        if entry.is_known() {
            let (moves, source, over_loose) = (entry.moves(), entry.source, b.role != Role::Final);
            self.known.push(Candidate { moves, source, over_loose, motion, is_taken, behind });
        } else if !is_taken && outlook.all {
            self.blind.push(motion);
        }
    }
}

impl Cube {
    /// Schedules a decision since something has changed.
    pub(super) fn decide_soon(&mut self, now: Time) {
        if self.own.role != Role::Final {
            self.planner.decide_soon(now);
        }
    }

    /// Decides whether to move, and begins to ask for what a move needs.
    pub(super) fn decide(&mut self, now: Time) {
        self.planner.decide_at = Time::NEVER;
        if self.own.role == Role::Final || !self.is_idle() {
            return;
        }
        if self.own.is_quarantined(now) {
            self.planner.decide_at = self.own.quarantine_until;
            return;
        }
        if now < self.planner.back_off_until {
            self.planner.decide_at = self.planner.back_off_until;
            return;
        }
        if self.own.immobile {
            // Joints can come free again. After a pause, half as many failures suffice to give up again, but
            // one does not: it may be a coincidence.
            self.own.immobile = false;
            self.planner.failed = self.own.params().immobile_after / 2;
            self.invalidate();
        }
        let steered = self.steered_at(now).filter(|_| !self.own.is_closed);
        let is_called = steered.is_none() && self.call_ends().is_some();
        if is_called && self.is_called_here() {
            return;
        }
        if let Some(Steered { steering: Steering::Hold, until }) = steered {
            self.planner.decide_at = until;
            return;
        }
        if self.own.is_closed {
            // Only the called module moves, and it asks none.
            if let Some(motion) = self.called_motion() {
                self.begin_attempt(now, motion);
            }
            return;
        }
        let may_be_wanted = self.own.role == Role::Walker || self.own.masks.own;
        if may_be_wanted && self.view(now).may_hear_more() {
            // Each neighbour message decides again; this is not counted as a deferral.
            self.planner.decide_at = now + self.own.params().advertise;
            return;
        }
        if self.may_carry(now) {
            self.planner.decide_at = now + self.own.params().advertise;
            return;
        }
        if self.own.role == Role::Reserve {
            if let Err(held) = self.may_leave(now) {
                self.planner.waits_for = held.0;
                return;
            }
            if steered.is_none()
                && !is_called
                && self.planner.waits_for_outer(self.view(now), self.forest.rank().label)
            {
                return self.planner.decide_later(now, self.own.params());
            }
        }
        if is_called {
            // Until the next motion is possible, each neighbour message decides again.
            if let Some(motion) = self.called_motion() {
                self.begin_in_turn(now, motion);
            }
            return;
        }
        let v = View { now, own: &self.own, sides: &self.sides };
        let surveys = self.may_survey();
        let outlook = Outlook { all: steered.is_some() || surveys, trusts: self.planner.trusts_hints() };
        let candidates = Candidates::around(v, outlook);
        if candidates.corners != self.planner.corners_seen && self.own.role == Role::Walker {
            hit(CoveragePoint::CubeCornerSeen);
            self.planner.corners_seen = candidates.corners;
            self.beacons.invalidate();
        }
        let motion = match steered {
            Some(Steered { steering: Steering::GoTo(to), until }) => {
                // It looks again when a neighbour tells something new.
                self.planner.decide_at = until;
                towards(self.own.cell, to, &candidates, &mut self.rng)
            }
            _ => self.planner.choose(v, &candidates, &mut self.rng),
        };
        if !candidates.known.is_empty() {
            self.surveyor.reset(now);
        }
        let is_lost = surveys && candidates.known.is_empty();
        if let Some(motion) = if is_lost { self.survey(now, &candidates) } else { motion } {
            self.begin_in_turn(now, motion);
        }
    }

    /// Begins to ask for a motion, or waits for its turn.
    fn begin_in_turn(&mut self, now: Time, motion: Motion) {
        let Window { from, until } = self.turn(now, motion);
        if now < from {
            // It decides again, since the next beacon may tell something new.
            self.planner.decide_at = self.planner.decide_at.min(from);
        } else if now <= until {
            self.begin_attempt(now, motion);
        }
    }

    pub(super) fn on_percept(&mut self, now: Time, percept: Percept) {
        let attempt = self.moving.take();
        if let Percept::Arrived(cell) = percept {
            self.arrive(now, cell);
        }
        // A restarted module hears of a move that its earlier incarnation began: it has been carried
        // elsewhere, and continues listening there.
        let Some(attempt) = attempt else { return hit(CoveragePoint::CubeCarriedOn) };
        match percept {
            Percept::Arrived(_) => {
                self.own.role = Role::Walker;
                self.own.support = Some(attempt.motion.landing_support());
                // Allows some time for the first beacons at a new place.
                self.planner.on_moved(now + self.own.params().usual_delay);
            }
            Percept::Failed => {
                hit(CoveragePoint::CubeMoveFailed);
                self.give_back(&attempt);
                self.own.immobile = self.planner.on_failed(now, self.own.params(), &mut self.rng);
            }
            Percept::Refused(why) => self.on_refused(now, &attempt, why),
        }
        self.invalidate();
    }

    fn on_refused(&mut self, now: Time, attempt: &Attempt, why: Refusal) {
        match why {
            Refusal::Blocked => hit(CoveragePoint::CubeRefusedBlocked),
            Refusal::Late => hit(CoveragePoint::CubeRefusedLate),
            Refusal::Stale => hit(CoveragePoint::CubeRefusedStale),
            Refusal::Moving => {}
        }
        let is_certain = why == Refusal::Blocked && self.sides.is_certified_dead(attempt.motion.support);
        self.surveyor.on_failed(self.own.cell, attempt.motion, is_certain);
        self.give_back(attempt);
        self.planner.count_denial();
        self.planner.back_off(now, self.own.params(), &mut self.rng);
    }

    /// Forgets the old neighbourhood at a new cell.
    fn arrive(&mut self, now: Time, cell: Cell) {
        self.surveyor.on_arrival(now, self.own.cell, cell);
        let own = &mut self.own;
        (own.cell, own.settled, own.restarted, own.role) = (cell, now, false, Role::Reserve);
        (own.activator, own.support) = (None, None);
        own.look_up();
        self.sides = Sides::new();
        self.attraction = Attraction::new();
        self.beacons = Beacons::new();
        self.forest.on_arrival();
        self.planner.on_arrival();
        self.locks.clear();
        self.on_step(cell);
        self.invalidate();
    }
}

/// Returns a motion that is free and brings a module nearest to a cell; of equally good ones, a random one. `None` if
/// no motion brings it nearer than it is.
fn towards(cell: Cell, to: Cell, candidates: &Candidates, rng: &mut Rng) -> Option<Motion> {
    let nearer = |motion: &Motion| motion.destination(cell).manhattan(to) < cell.manhattan(to);
    let mut motions: Vec<Motion> = candidates.free().filter(nearer).collect();
    let nearest = motions.iter().map(|motion| motion.destination(cell).manhattan(to)).min()?;
    motions.retain(|motion| motion.destination(cell).manhattan(to) == nearest);
    motions.get(rng.below(motions.len() as u64) as usize).copied()
}

const QUARTER: Ratio = match Ratio::new(1, 4) {
    Some(quarter) => quarter,
    None => Ratio::ZERO,
};
