//! Coordinator. When the group makes no progress, one metamodule plans for all in range and schedules one
//! move at a time.
//!
//! Under `negotiated` each metamodule decides for itself, and makes way for one way at a time. Some
//! standstills take more: two that must change their shapes in turn, or one that must step aside for another
//! that has no way to announce yet. Then the metamodule with the smallest number among those in range asks
//! all to stay, searches for a plan of all together (`planning::cooperative`), and orders one move after the
//! other; the mover makes it, with locks as always. When the seed is filled, or a move has not been made in
//! time, or the coordinator is not heard any more, all continue as before.
//!
//! If the scenario says so, it asks the operator first, and continues by itself when it is told to, or after a time.
//!
//! A directive that comes late or to another metamodule costs time, never safety. A plan that closes the way to another seed
//! is carried out only if no other is found.

use super::scene::{Scene, fingerprint};
use crate::metamodule::blueprint::SeedSet;
use crate::metamodule::message::{Directive, Instruction, Message, MoveEnd};
use crate::metamodule::params::Ask;
use crate::metamodule::plan::{Aim, Plan};
use crate::metamodule::planning::cooperative::{Move, SearchResult, Standstill, WORK, search_ahead};
use crate::metamodule::planning::lru_cache::mix;
use crate::metamodule::pose::{Load, Pose};
use crate::metamodule::setup::Setup;
use crate::metamodule::strategy::context::Context;
use crate::metamodule::view::View;
use metamorph_core::counters::Class;
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::defects::Defect;
use metamorph_core::digest::Portable;
use metamorph_core::ids::ModuleId;
use metamorph_core::time::Time;
use std::collections::VecDeque;
use std::hash::Hash;
use std::sync::Arc;

/// The time without a move after which a metamodule coordinates, in multiples of `patience`.
const QUIET: u64 = 5;
/// The time without a newly filled seed after which it coordinates even if others move, in multiples of `patience`.
const LONG: u64 = 20;
/// The time for which a coordinator is followed after it was last heard, in multiples of `patience`.
const FOLLOWED: u64 = 3;
/// The largest number of doublings of the time until it coordinates again, after it has done so without success.
const MOST_DOUBLED: u8 = 4;

/// State of coordination: the plan that a metamodule coordinates, and the coordinator that it follows.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Default)]
pub(super) struct Coordinator {
    /// The arrangement of all in range, and since when it has been the same.
    quiet: Option<(u64, Time)>,
    /// When this metamodule last began to coordinate, or had to give it up.
    began: Option<Time>,
    /// The arrangement for which it found no plan.
    in_vain: Option<u64>,
    /// How often it has coordinated without success since the seeds in `filled`, and no others, were filled.
    times_in_vain: u8,
    filled: SeedSet,
    stage: Stage,
    /// Its current directive, which it repeats.
    said: Option<Directive>,
    /// The directive that it follows, and until when.
    heard: Option<(Directive, Time)>,
    /// The operator has answered that it is to continue.
    is_answered: bool,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash, Default)]
enum Stage {
    /// It does not coordinate.
    #[default]
    Off,
    /// All have been asked to stay, and will have heard it by `at`. Locks are waited for until `until`.
    Gathering { at: Time, until: Time },
    /// These moves are left of a plan, and the first of them is waited for until `until`.
    Executing { moves: VecDeque<(ModuleId, Move)>, until: Time },
    /// The operator is asked about this arrangement until `until`. Meanwhile each metamodule decides for itself.
    Asking { about: u64, until: Time },
}

impl Coordinator {
    /// Feeds the state into a hash, without what it says of the surroundings; see `digest`.
    pub fn digest(&self, hasher: &mut Portable<'_>) {
        let Coordinator {
            began,
            times_in_vain,
            filled,
            stage,
            said,
            heard,
            quiet: _,
            in_vain: _,
            is_answered,
        } = self;
        (began, times_in_vain, filled, stage, said, heard).hash(hasher);
        // Hashes of swarms that ask nothing do not depend on whether they could.
        if *is_answered {
            is_answered.hash(hasher);
        }
    }

    /// Coordinates, or looks for a coordinator to follow. Returns what is to be done by all, and until when,
    /// or `None` if each metamodule decides for itself.
    pub fn step(
        &mut self,
        cx: &mut Context<'_>,
        scene: &Scene<'_>,
        filled_since: Option<Time>,
        next_expiry: Time,
    ) -> Option<(Instruction, Time)> {
        let now = cx.v.now;
        if let Some((directive, until)) = self.heard.filter(|(d, _)| d.instruction != Instruction::Over) {
            if now < until {
                self.stop(cx);
                return Some((directive.instruction, next_expiry.min(until)));
            }
            self.heard = None;
        }
        match self.stage {
            Stage::Off => {
                if now < self.due(scene, filled_since) {
                    return None;
                }
                if self.is_to_ask(cx.v) {
                    let (about, until) = (arrangement(scene), now + cx.v.params().answer_within);
                    self.stage = Stage::Asking { about, until };
                    cx.out.asks = true;
                    return None;
                }
                Some(self.begin(cx))
            }
            Stage::Asking { about, until } => {
                // A change in the meantime may have resolved the standstill.
                if arrangement(scene) != about || self.due(scene, filled_since) == Time::NEVER {
                    self.stop(cx);
                    return None;
                }
                (now >= until).then(|| self.begin(cx))
            }
            Stage::Gathering { at, .. } if now < at => Some((Instruction::Stay, at)),
            Stage::Gathering { until, .. } if now < until && cx.v.locks.iter().next().is_some() => {
                Some((Instruction::Stay, next_expiry.min(until)))
            }
            Stage::Gathering { .. } => match plan_together(scene) {
                Some(moves) => {
                    // The search may have taken its time; the first move is ordered when it is known how
                    // much.
                    self.stage = Stage::Executing { moves: moves.into(), until: Time::NEVER };
                    Some((Instruction::Stay, now))
                }
                None => {
                    hit(CoveragePoint::MetaLedInVain);
                    self.in_vain = Some(arrangement(scene));
                    self.give_up(cx);
                    None
                }
            },
            Stage::Executing { .. } => self.order_next(cx, scene, next_expiry),
        }
    }

    /// Begins to coordinate: asks all in range to stay.
    fn begin(&mut self, cx: &mut Context<'_>) -> (Instruction, Time) {
        hit(CoveragePoint::MetaLed);
        let (now, params) = (cx.v.now, cx.v.params());
        let (at, until) = (now + params.resend, now + params.lease);
        self.stage = Stage::Gathering { at, until };
        (self.began, self.is_answered, cx.out.asks) = (Some(now), false, false);
        self.say(cx, Instruction::Stay);
        (Instruction::Stay, at)
    }

    /// Returns true if the operator is to be asked before it coordinates.
    fn is_to_ask(&self, v: View<'_>) -> bool {
        let is_quiet = |(_, since): (u64, Time)| v.now >= since + v.params().patience * QUIET;
        !self.is_answered
            && match v.params().ask {
                Ask::Never => false,
                Ask::Stuck => self.quiet.is_some_and(is_quiet),
                Ask::Always => true,
            }
    }

    /// Takes the answer of the operator that it is to continue.
    pub fn on_answer(&mut self) {
        self.is_answered |= matches!(self.stage, Stage::Asking { .. });
    }

    /// Returns the time at which this metamodule begins to coordinate if nothing changes; `Time::NEVER` if it would not
    /// do so.
    pub fn due(&mut self, scene: &Scene<'_>, filled_since: Option<Time>) -> Time {
        let (v, around) = (scene.v, arrangement(scene));
        let retry = v.params().patience;
        let quiet = self.quiet.filter(|(before, _)| *before == around);
        let (_, since) = *self.quiet.insert(quiet.unwrap_or((around, v.now)));
        let is_first = scene.movable.iter().all(|(id, _)| *id > v.own.id);
        if !is_first || v.open().is_empty() || self.in_vain == Some(around) {
            return Time::NEVER;
        }
        if let Stage::Asking { until, .. } = self.stage {
            return until;
        }
        let at = (since + retry * QUIET).min(filled_since.unwrap_or(v.now) + retry * LONG);
        if self.filled != v.own.filled {
            (self.filled, self.times_in_vain) = (v.own.filled, 0);
        }
        // Where all move and there is no plan, looking for one every time would be most of the work.
        let again = QUIET << self.times_in_vain.min(MOST_DOUBLED);
        self.began.map_or(at, |began| at.max(began + retry * again))
    }

    /// Orders the next move of the plan, unless it has been ordered already and is awaited.
    fn order_next(
        &mut self,
        cx: &mut Context<'_>,
        scene: &Scene<'_>,
        next_expiry: Time,
    ) -> Option<(Instruction, Time)> {
        let v = cx.v;
        let me = (v.own.id, v.own.pose);
        let pose_of =
            |id: ModuleId| scene.movable.iter().chain([&me]).find(|(i, _)| *i == id).map(|(_, p)| *p);
        // A metamodule that repeats its state on the way tells a posture of the way.
        let is_moving = |id: ModuleId, from: Pose| {
            let mut ports = v.neighbours.states().filter(|(_, s)| s.id == id).map(|(port, _)| port);
            ports.any(|port| v.locks.grant_of(port).is_some_and(|g| stands(g.pose, from)))
        };
        let Stage::Executing { moves, until } = &mut self.stage else { return None };
        if let [(mover, made), _, ..] = moves.make_contiguous()
            && pose_of(*mover).is_some_and(|pose| is_made(v.setup, made, pose))
        {
            moves.pop_front();
        }
        let (mover, next) = *moves.front()?;
        // The last move is over when its mover stays where it is permanently.
        let Some(pose) = pose_of(mover) else {
            match moves.len() {
                1 => self.stop(cx),
                _ => self.give_up(cx),
            }
            return None;
        };
        if v.now >= *until || !(stands(pose, next.from) || is_moving(mover, next.from)) {
            self.give_up(cx);
            return None;
        }
        let Move { from, posture, lands, .. } = next;
        let end = MoveEnd::of(lands, moves.len() == 1);
        let instruction = Instruction::Move { mover, from, posture, end };
        let is_ordered = self.said.is_some_and(|said| said.instruction == instruction);
        if !is_ordered {
            *until = v.now + v.params().lease;
        }
        let until = *until;
        if !is_ordered {
            self.say(cx, instruction);
        }
        Some((instruction, next_expiry.min(until)))
    }

    fn say(&mut self, cx: &mut Context<'_>, instruction: Instruction) {
        let sequence = cx.out.next_sequence();
        let directive = Directive { coordinator: cx.v.own.id, sequence, instruction };
        self.said = Some(directive);
        cx.out.broadcast(cx.v, Class::Negotiation, Message::Directive(directive));
    }

    /// Stops coordinating because it had no success.
    fn give_up(&mut self, cx: &mut Context<'_>) {
        (self.began, self.times_in_vain) = (Some(cx.v.now), self.times_in_vain.saturating_add(1));
        self.stop(cx);
    }

    /// Forgets what has been tried: it says nothing of another task.
    pub fn start_over(&mut self, cx: &mut Context<'_>) {
        self.stop(cx);
        *self = Coordinator { said: self.said, heard: self.heard, ..Coordinator::default() };
    }

    /// Stops coordinating, and tells all in range.
    pub fn stop(&mut self, cx: &mut Context<'_>) {
        cx.out.asks = false;
        match std::mem::take(&mut self.stage) {
            Stage::Off | Stage::Asking { .. } => {}
            Stage::Gathering { .. } | Stage::Executing { .. } => self.say(cx, Instruction::Over),
        }
    }

    /// Notes a directive. Returns whether it is news.
    pub fn hear(&mut self, v: View<'_>, directive: Directive) -> bool {
        let is_later = |(before, until): (Directive, Time)| match directive.coordinator == before.coordinator
        {
            // A coordinator that has restarted counts from zero again.
            true => directive.sequence >= before.sequence || v.now >= until,
            false => {
                let is_over = before.instruction == Instruction::Over;
                directive.coordinator < before.coordinator || v.now >= until || is_over
            }
        };
        let is_at_work = matches!(self.stage, Stage::Gathering { .. } | Stage::Executing { .. });
        let coordinates = is_at_work && v.own.id < directive.coordinator;
        if coordinates || !self.heard.is_none_or(is_later) {
            return false;
        }
        let before = self.heard.replace((directive, v.now + v.params().patience * FOLLOWED));
        before.is_none_or(|(before, _)| before.instruction != directive.instruction)
    }

    /// Repeats what has been ordered.
    pub fn repeat(&mut self, cx: &mut Context<'_>) {
        if let Stage::Gathering { until, .. } | Stage::Executing { until, .. } = self.stage
            && cx.v.now >= until
        {
            // A coordinator that waits for a lock meanwhile keeps the others no longer than that.
            return self.give_up(cx);
        }
        if let Some(directive) = self.said {
            cx.out.broadcast(cx.v, Class::Liveness, Message::Directive(directive));
            if directive.instruction == Instruction::Over {
                self.said = None;
            }
        }
    }
}

/// Returns a hash of the task, of what is filled and fixed, and of the poses of all that can move.
fn arrangement(scene: &Scene<'_>) -> u64 {
    let own = scene.v.own;
    let poses = scene.movable.iter().map(|(_, pose)| *pose).chain([own.pose]);
    let tells = |p: Pose| [p.state.x as u64, p.state.y as u64, p.state.class.into(), p.posture.into()];
    let poses = poses.map(|p| tells(p).into_iter().fold(0, mix)).fold(0, u64::wrapping_add);
    let (low, high) = (own.filled.0 as u64, (own.filled.0 >> 64) as u64);
    let task = [own.task.epoch.into(), if high == 0 { low } else { mix(low, high) }];
    task.into_iter().chain([fingerprint(&scene.stays)]).fold(poses, mix)
}

/// Searches for a plan of all that can move.
fn plan_together(scene: &Scene<'_>) -> Option<Vec<(ModuleId, Move)>> {
    let own = scene.v.own;
    let mut movers = scene.movable.clone();
    movers.push((own.id, own.pose));
    movers.sort_by_key(|(id, _)| *id);
    let standstill = Standstill {
        setup: Arc::clone(scene.v.setup),
        task: own.task,
        filled: own.filled,
        free: movers.iter().map(|(_, pose)| *pose).collect(),
        fixed: scene.stays.clone(),
    };
    let SearchResult::Path(path) = search_ahead(&standstill, WORK) else { return None };
    Some(path.into_iter().map(|m| (movers[m.body].0, m)).collect())
}

/// The motion that an instruction asks of this metamodule, if it is the mover and the way is free.
pub(super) fn own_move(scene: &Scene<'_>, instruction: Instruction) -> Option<Plan> {
    let (v, pose) = (scene.v, scene.v.own.pose);
    let Instruction::Move { mover, from, posture, end } = instruction else { return None };
    if mover != v.own.id || !stands(pose, from) || v.has(Defect::StandInTheWay) {
        return None;
    }
    let aim = match end {
        MoveEnd::Lands => Aim::Land,
        MoveEnd::Rests => Aim::Shift,
        MoveEnd::Settles => {
            let seed = v.settles_in(Pose { posture, ..pose }).filter(|s| v.open().has(*s));
            seed.map_or(Aim::Shift, Aim::Settle)
        }
    };
    if aim == Aim::Shift && posture == pose.posture {
        // It stands so already, and may not fill the seed yet. A motion of no steps would begin again at once.
        return None;
    }
    let plan = match pose.load {
        Load::NONE => Plan::to(&v.ground(&scene.taken), pose, posture, aim)?,
        // While two hold an element their chain is closed, so neither turns.
        _ if v.shares_element() => return None,
        _ => Plan::carry(v.setup, pose, posture, &scene.taken, aim)?,
    };
    hit(CoveragePoint::MetaCalled);
    Some(plan)
}

/// Whether a body stands as a move wants it to.
fn stands(pose: Pose, as_in: Pose) -> bool {
    (pose.state, pose.posture, pose.both, pose.load) == (as_in.state, as_in.posture, false, as_in.load)
}

/// Whether a body in `pose` has made a move.
fn is_made(setup: &Setup, made: &Move, pose: Pose) -> bool {
    let ends = Pose { posture: made.posture, ..made.from };
    let ends = if made.lands { setup.motions.turned_around(ends) } else { Some(ends) };
    ends.is_some_and(|ends| stands(pose, ends))
}
