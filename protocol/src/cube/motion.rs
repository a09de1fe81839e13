//! Where to go, and going there.

use super::body::{Percept, Refusal};
use super::message::Role;
use super::negotiation::Attempt;
use super::params::Connectivity;
use super::{Cube, Side, UNRANKED};
use crate::ids::ModuleId;
use crate::lattice::{Cell, Face, Motion, MotionKind};
use crate::marks::{Mark, hit};
use crate::ratio::Ratio;
use crate::time::{Span, Time};

/// Decisions for which a module waits for its outer neighbours to leave first.
const OUTERMOST_FIRST: u16 = 6;
/// The same with connecting cycles.
const OUTERMOST_FIRST_IN_CYCLES: u16 = 200;
/// Decisions after which a walker accepts one move of detour.
const DETOUR: u16 = 12;
/// Decisions after which a walker sometimes accepts two moves of detour.
const WIDE_DETOUR: u16 = 40;

/// So often a walker that hears of no target tries to move at once. After that it waits twice as long every
/// time, or a swarm with nothing left to do would not come to rest; where it has stopped it may be in the way.
const ROAMING: u8 = 100;
/// It waits no longer than so many times twice as long.
const LONGEST_ROAMING: u8 = 30;

/// What a walker that hears of no target has done about it. Distances go from module to module along the
/// surface, and where a dead one stands in the corner between two they end, though a walker gets past.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Roaming {
    since: Time,
    tries: u8,
    /// Where it was when it last tried.
    from: Cell,
}

/// A move that the body has been asked for.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Moving {
    pub attempt: Attempt,
}

/// Targets remembered by a module in reserve.
const MAX_TARGETS: usize = 24;

/// A target that a module in reserve has heard of. A module leaves for a target only when it has been
/// there for half as long as a nearer module would have needed to fill it; so each target recruits an ever
/// wider circle, and few more modules wander than there is work for.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Target {
    source: u32,
    first: Time,
    last: Time,
}

/// A motion that leads towards a target.
struct Course {
    moves: u16,
    source: u32,
    /// Not over a finalized module, which would be the steadier support.
    over_loose: bool,
    motion: Motion,
    /// The walker that stands in the way.
    behind: Option<ModuleId>,
}

impl Cube {
    /// Something changed that may change a decision; but a back-off is waited out.
    pub(super) fn decide_soon(&mut self, now: Time) {
        if self.role != Role::Final {
            self.decide_at = self.decide_at.min(self.back_off_until.max(now));
        }
    }

    fn decide_later(&mut self, now: Time) {
        self.patience = self.patience.saturating_add(1);
        self.decide_at = now + self.setup.params.advertise;
    }

    pub(super) fn decide(&mut self, now: Time) {
        self.decide_at = Time::NEVER;
        if self.role == Role::Final || !self.is_idle() {
            return;
        }
        if self.is_quarantined(now) {
            self.decide_at = self.quarantine_until;
            return;
        }
        if now < self.back_off_until {
            self.decide_at = self.back_off_until;
            return;
        }
        if self.immobile {
            // Joints come free again; half as many failures are enough to give up for another while, but not
            // one, which may be bad luck.
            self.immobile = false;
            self.failed = self.setup.params.immobile_after / 2;
            self.touch();
        }
        if (self.role == Role::Walker || self.goal().contains(self.cell)) && self.may_hear_more(now) {
            // Every word of a neighbour asks again; waiting for them is no reason to lose patience.
            self.decide_at = now + self.setup.params.advertise;
            return;
        }
        if self.role == Role::Reserve {
            if let Err(held) = self.may_leave(now) {
                self.waits_for = held.0;
                return;
            }
            let outer = |b: &super::Beacon| b.role == Role::Reserve && b.rank.label > self.rank.label;
            let has_outer = Face::ALL.into_iter().any(|f| self.terrain(now, f).is_some_and(outer));
            let patience = match self.setup.params.connectivity {
                // What leaves from the middle leaves a mesh of loops too long for any search.
                Connectivity::Cycles => OUTERMOST_FIRST_IN_CYCLES,
                Connectivity::Forest | Connectivity::Gradient => OUTERMOST_FIRST,
            };
            if has_outer && self.patience < patience {
                return self.decide_later(now);
            }
        }
        let (options, blind) = self.options(now);
        let Some(nearest) = options.iter().map(|o| o.moves).min() else {
            self.waiting_since = None;
            self.waits_for = None;
            return self.roam(now, &blind);
        };
        self.roaming = None;
        if self.role == Role::Reserve
            && let Some(source) = options.iter().find(|o| o.moves == nearest).map(|o| o.source)
        {
            let go = self.heard_since(now, source) + self.setup.params.recruit_per_move * u64::from(nearest);
            if now < go {
                self.decide_at = go;
                return;
            }
        }
        let slack = match self.patience {
            0..=DETOUR => 0,
            p if p > WIDE_DETOUR && self.stream.chance(QUARTER) => 2,
            _ => 1,
        };
        let mut best: Option<&Course> = None;
        let mut ties = 0;
        for option in options.iter().filter(|o| o.behind.is_none() && o.moves <= nearest + slack) {
            let key = |o: &Course| (o.moves, o.over_loose);
            match best.map(|b| key(option).cmp(&key(b))) {
                None | Some(std::cmp::Ordering::Less) => (best, ties) = (Some(option), 1),
                Some(std::cmp::Ordering::Equal) => {
                    ties += 1;
                    if self.stream.below(ties) == 0 {
                        best = Some(option);
                    }
                }
                Some(std::cmp::Ordering::Greater) => {}
            }
        }
        match best.map(|o| o.motion) {
            Some(motion) => {
                if best.is_some_and(|o| o.moves > nearest) {
                    hit(Mark::CubeDetour);
                }
                self.begin_attempt(now, motion);
            }
            None => {
                hit(Mark::CubeBehindWalker);
                self.waits_for = options.iter().find_map(|o| o.behind);
                self.waiting_since.get_or_insert(now);
                self.decide_later(now);
            }
        }
    }

    /// Goes anywhere but back, after having heard of no target for long.
    fn roam(&mut self, now: Time, ways: &[Motion]) {
        if self.role != Role::Walker {
            return;
        }
        let p = &self.setup.params;
        let cell = self.cell;
        let roaming = self.roaming.get_or_insert(Roaming { since: now, tries: 0, from: cell });
        let go = match roaming.tries {
            0 => roaming.since + p.relax,
            1..ROAMING => self.settled + p.first_words(),
            tries => roaming.since + p.relax * (2 << (tries - ROAMING).min(LONGEST_ROAMING)),
        };
        if now < go {
            self.decide_at = go;
            return;
        }
        let onward: Vec<Motion> =
            ways.iter().copied().filter(|m| m.destination(cell) != roaming.from).collect();
        let ways = if onward.is_empty() { ways } else { &onward };
        let Some(motion) = ways.get(self.stream.below(ways.len().max(1) as u64) as usize) else { return };
        (roaming.tries, roaming.from) = (roaming.tries.saturating_add(1), cell);
        hit(Mark::CubeRoamed);
        self.begin_attempt(now, *motion);
    }

    /// Notes that a target has been heard of.
    pub(super) fn hear_of(&mut self, now: Time, source: u32) {
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

    /// Whether a neighbour that has not spoken yet may want this very cell filled, or know a shorter way.
    /// Whoever has been silent for longer than first words take has nothing to say, or cannot.
    pub(super) fn may_hear_more(&self, now: Time) -> bool {
        now.since(self.settled) < self.setup.params.first_words()
            && self.sides.iter().any(|s| s.session.is_some() && s.peer.is_none() && !s.condemned)
    }

    /// All motions towards a target, over every live support; and those of which that is not known.
    fn options(&mut self, now: Time) -> (Vec<Course>, Vec<Motion>) {
        let (mut options, mut blind) = (Vec::new(), Vec::new());
        let mut corners = [0u8; 6];
        for support in Face::ALL {
            let Some(b) = self.terrain(now, support) else { continue };
            for (slot, heading) in support.perpendicular().into_iter().enumerate() {
                let entry = b.field[slot];
                let ahead = self.side(heading);
                let behind = match (ahead.session, &ahead.peer) {
                    (None, _) => None,
                    (Some(_), Some(peer)) if self.is_open(now, heading) => Some(peer.beacon.id),
                    // Whoever has just come there will say what it is.
                    (Some(_), None) if !ahead.condemned => continue,
                    (Some(_), _) => {
                        // The support cannot see what stands over its edge.
                        if b.terrain & heading.bit() == 0 {
                            corners[support.index()] |= heading.bit();
                        }
                        continue;
                    }
                };
                let kind =
                    if b.terrain & heading.bit() == 0 { MotionKind::Convex } else { MotionKind::Slide };
                let motion = Motion { kind, support, heading };
                if entry.is_known() {
                    let over_loose = b.role != Role::Final;
                    let (moves, source) = (entry.moves(), entry.source);
                    options.push(Course { moves, source, over_loose, motion, behind });
                } else if behind.is_none() && self.role == Role::Walker {
                    blind.push(motion);
                }
            }
        }
        if corners != self.corners_seen && self.role == Role::Walker {
            hit(Mark::CubeCornerSeen);
            self.corners_seen = corners;
            for side in &mut self.sides {
                side.stale = true;
            }
        }
        (options, blind)
    }

    pub(super) fn on_percept(&mut self, now: Time, percept: Percept) {
        let moving = self.moving.take();
        if let Percept::Arrived(cell) = percept {
            self.arrive(now, cell);
        }
        // A restarted module hears of a move that its earlier life began: it has been carried
        // elsewhere, and goes on listening there.
        let Some(Moving { attempt }) = moving else { return hit(Mark::CubeCarriedOn) };
        match percept {
            Percept::Arrived(_) => {
                self.role = Role::Walker;
                self.anchor = Some(attempt.motion.landing_support());
                self.waiting_since = None;
                self.waits_for = None;
                (self.patience, self.denied, self.failed) = (0, 0, 0);
                self.decide_at = now + self.settle_time();
            }
            Percept::Failed => {
                hit(Mark::CubeMoveFailed);
                self.give_back(&attempt);
                self.failed = self.failed.saturating_add(1);
                self.immobile = self.failed >= self.setup.params.immobile_after;
                self.denied = self.denied.saturating_add(1);
                self.back_off(now);
                if self.immobile {
                    hit(Mark::CubeImmobile);
                    self.back_off_until = now + self.setup.params.relax;
                    self.decide_at = self.back_off_until;
                }
            }
            Percept::Refused(why) => {
                match why {
                    Refusal::Blocked => hit(Mark::CubeRefusedBlocked),
                    Refusal::Late => hit(Mark::CubeRefusedLate),
                    Refusal::Stale => hit(Mark::CubeRefusedStale),
                    Refusal::Moving => {}
                }
                self.give_back(&attempt);
                self.denied = self.denied.saturating_add(1);
                self.patience = self.patience.saturating_add(1);
                self.back_off(now);
            }
        }
        self.touch();
    }

    /// At a new cell nothing of the old neighbourhood counts.
    fn arrive(&mut self, now: Time, cell: Cell) {
        self.cell = cell;
        self.settled = now;
        self.reborn = false;
        self.role = Role::Reserve;
        self.activator = None;
        self.sides = std::array::from_fn(|_| Side::new());
        self.corners_seen = [0; 6];
        self.parent = None;
        self.rank = UNRANKED;
        self.want = None;
        self.anchor = None;
        self.locks.clear();
        self.touch();
    }

    /// A little time for the first beacons at a new place.
    fn settle_time(&self) -> Span {
        self.setup.params.usual_delay
    }
}

const QUARTER: Ratio = match Ratio::new(1, 4) {
    Some(quarter) => quarter,
    None => Ratio::ZERO,
};
