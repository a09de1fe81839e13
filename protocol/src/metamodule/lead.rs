//! Leading: where nobody gets on, one metamodule looks for a way of all that it hears together, and says who
//! moves next.
//!
//! Under `negotiated` everybody decides for itself, and makes way for one way at a time. Some standstills take
//! more: two who must change their shapes in turn, or one who must step aside for somebody who has no way to
//! announce yet. Then the metamodule with the smallest number among those in hearing asks all to stay, searches
//! (`joint`), and calls one move after the other; whoever is called makes it, with locks as always. When the seed
//! is filled, or a move has not been made in time, or it is not heard any more, everybody goes on as before.
//!
//! What is called late or to somebody else than was meant costs time, never safety. Absent: a choice among ways;
//! the first that is found is gone, also if it closes the way to another seed.

use super::blueprint::SeedSet;
use super::message::{Directive, Instruction, Message};
use super::negotiation::{Scene, fingerprint};
use super::params::Setup;
use super::pose::Pose;
use super::{Metamodule, Phase};
use crate::counters::Class;
use crate::coverage::{Mark, hit};
use crate::defects::Sabotage;
use crate::digest::Portable;
use crate::ids::{ModuleId, Port};
use crate::metamodule::planning::cooperative::{Move, Sought, Standstill, WORK, search};
use crate::metamodule::planning::lru_cache::mix;
use crate::metamodule::strategy::greedy_policy::{Aim, Plan};
use crate::time::Time;
use std::collections::VecDeque;
use std::hash::Hash;
use std::sync::Arc;

/// A metamodule leads after nothing has moved for so many times its patience,
const QUIET: u64 = 5;
/// or after nothing has been filled for so many, whatever moves.
const LONG: u64 = 20;
/// Whoever leads is heeded for so many times the patience after it was last heard.
const HEEDED: u64 = 3;
/// The time until it leads again doubles each time that it has led in vain, up to so many times.
const MOST_IN_VAIN: u8 = 4;

/// What a metamodule leads, and who leads it.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Default)]
pub(super) struct Lead {
    /// Who stands where, and since when.
    quiet: Option<(u64, Time)>,
    /// When it last began to lead, or had to give it up.
    began: Option<Time>,
    /// Who stood where when it found no way.
    in_vain: Option<u64>,
    /// How often it has led in vain since these were filled, and nothing else.
    times_in_vain: u8,
    filled: SeedSet,
    stage: Stage,
    /// What it has called, to be repeated.
    said: Option<Directive>,
    /// What it has been called, and until when it heeds that.
    heard: Option<(Directive, Time)>,
}

impl Lead {
    /// Hashes what it leads, without what it has already found to be in vain.
    pub fn digest_state(&self, hasher: &mut Portable<'_>) {
        let Lead { began, times_in_vain, filled, stage, said, heard, quiet: _, in_vain: _ } = self;
        (began, times_in_vain, filled, stage, said, heard).hash(hasher);
    }
}

#[derive(Clone, Debug, PartialEq, Eq, Hash, Default)]
enum Stage {
    /// It does not lead.
    #[default]
    Not,
    /// All have been asked to stay, and will have heard it by `at`. Locks are waited for until `until`.
    Gathers { at: Time, until: Time },
    /// These moves are left of a way, and the first of them is waited for until `until`.
    Goes { moves: VecDeque<(ModuleId, Move)>, until: Time },
}

impl Metamodule {
    /// Does what it is called to do, or leads. Says whether that is all there is to do.
    pub(super) fn lead(&mut self, now: Time, scene: &Scene, next_expiry: Time) -> bool {
        if let Some((call, until)) =
            self.core.lead.heard.filter(|(call, _)| call.instruction != Instruction::Over)
        {
            if now < until {
                self.stop_leading();
                return self.heed(now, call.instruction, scene, next_expiry.min(until));
            }
            self.core.lead.heard = None;
        }
        match self.core.lead.stage {
            Stage::Not => {
                if now < self.leads_at(now, scene) {
                    return false;
                }
                hit(Mark::MetaLed);
                let params = &self.setup.params;
                let (at, until) = (now + params.resend, now + params.lease);
                self.core.lead.stage = Stage::Gathers { at, until };
                self.core.lead.began = Some(now);
                self.call(Instruction::Stay);
                self.heed(now, Instruction::Stay, scene, at)
            }
            Stage::Gathers { at, .. } if now < at => self.heed(now, Instruction::Stay, scene, at),
            Stage::Gathers { until, .. } if now < until && self.has_granted() => {
                self.heed(now, Instruction::Stay, scene, next_expiry.min(until))
            }
            Stage::Gathers { .. } => match self.find_together(scene) {
                Some(moves) => {
                    // The search may have taken its time; the first call is made when it is known how much.
                    self.core.lead.stage = Stage::Goes { moves: moves.into(), until: Time::NEVER };
                    self.heed(now, Instruction::Stay, scene, now)
                }
                None => {
                    hit(Mark::MetaLedInVain);
                    self.core.lead.in_vain = Some(self.arrangement(scene));
                    self.lead_in_vain(now);
                    false
                }
            },
            Stage::Goes { .. } => self.call_next(now, scene, next_expiry),
        }
    }

    /// Not before this time it leads, if nothing else happens.
    pub(super) fn leads_at(&mut self, now: Time, scene: &Scene) -> Time {
        let around = self.arrangement(scene);
        let patience = self.setup.params.patience;
        let quiet = self.core.lead.quiet.filter(|(before, _)| *before == around);
        let (_, since) = *self.core.lead.quiet.insert(quiet.unwrap_or((around, now)));
        let filled = self.core.intent.filled_since().unwrap_or(now);
        let is_first = scene.movable.iter().all(|(id, _)| *id > self.core.id);
        if !is_first || self.open().is_empty() || self.core.lead.in_vain == Some(around) {
            return Time::NEVER;
        }
        let at = (since + patience * QUIET).min(filled + patience * LONG);
        let lead = &mut self.core.lead;
        if lead.filled != self.core.filled {
            (lead.filled, lead.times_in_vain) = (self.core.filled, 0);
        }
        // Where everybody moves and there is no way, looking for one every time would be most of the work.
        let again = QUIET << lead.times_in_vain.min(MOST_IN_VAIN);
        lead.began.map_or(at, |began| at.max(began + patience * again))
    }

    fn has_granted(&self) -> bool {
        self.core.peers.iter().any(|(_, p)| p.grant.is_some())
    }

    /// Tells who stands where from any other.
    fn arrangement(&self, scene: &Scene) -> u64 {
        let poses = scene.movable.iter().map(|(_, pose)| *pose).chain([self.core.pose]);
        let tells = |p: Pose| [p.state.x as u64, p.state.y as u64, p.state.class.into(), p.posture.into()];
        let poses = poses.map(|p| tells(p).into_iter().fold(0, mix)).fold(0, u64::wrapping_add);
        let core = &self.core;
        let task = [core.task.epoch.into(), core.filled.0.into()];
        task.into_iter().chain([fingerprint(&scene.stays)]).fold(poses, mix)
    }

    /// A way of all who can move together.
    fn find_together(&self, scene: &Scene) -> Option<Vec<(ModuleId, Move)>> {
        let mut movers = scene.movable.clone();
        movers.push((self.core.id, self.core.pose));
        movers.sort_by_key(|(id, _)| *id);
        let standstill = Standstill {
            setup: Arc::clone(&self.setup),
            task: self.core.task,
            filled: self.core.filled,
            free: movers.iter().map(|(_, pose)| *pose).collect(),
            fixed: scene.stays.clone(),
        };
        let Sought::Way(way) = search(&standstill, WORK) else { return None };
        Some(way.into_iter().map(|m| (movers[m.body].0, m)).collect())
    }

    /// Calls the next move, unless it is waited for.
    fn call_next(&mut self, now: Time, scene: &Scene, next_expiry: Time) -> bool {
        let me = (self.core.id, self.core.pose);
        let pose_of =
            |id: ModuleId| scene.movable.iter().chain([&me]).find(|(i, _)| *i == id).map(|(_, p)| *p);
        // Whoever repeats its state on the way tells a posture of the way.
        let is_moving = |id: ModuleId, from: Pose| {
            let mut granted = self.core.peers.iter().filter(|(_, p)| p.state.is_some_and(|s| s.id == id));
            granted.any(|(_, p)| p.grant.is_some_and(|g| stands(g.pose, from)))
        };
        let Stage::Goes { moves, until } = &self.core.lead.stage else { return false };
        let (mut moves, mut until) = (moves.clone(), *until);
        if let [(who, made), _, ..] = moves.make_contiguous()
            && pose_of(*who).is_some_and(|pose| is_made(&self.setup, made, pose))
        {
            moves.pop_front();
        }
        let Some((who, next)) = moves.front().copied() else { return false };
        // The last move is over when whoever makes it stays where it is for good.
        let Some(pose) = pose_of(who) else {
            match moves.len() {
                1 => self.stop_leading(),
                _ => self.lead_in_vain(now),
            }
            return false;
        };
        if now >= until || !(stands(pose, next.from) || is_moving(who, next.from)) {
            self.lead_in_vain(now);
            return false;
        }
        let bid = Instruction::Move { mover: who, from: next.from, posture: next.posture, lands: next.lands };
        let is_called = self.core.lead.said.is_some_and(|said| said.instruction == bid);
        if !is_called {
            self.call(bid);
            until = now + self.setup.params.lease;
        }
        self.core.lead.stage = Stage::Goes { moves, until };
        self.heed(now, bid, scene, next_expiry.min(until))
    }

    /// Stays, or makes the move that it is called to make.
    fn heed(&mut self, now: Time, bid: Instruction, scene: &Scene, until: Time) -> bool {
        self.fall_silent(now);
        self.core.phase = Phase::Idle { look_at: until };
        if let Instruction::Move { mover: who, from, posture, lands } = bid
            && who == self.core.id
            && stands(self.core.pose, from)
            && !self.has(Sabotage::StandInTheWay)
        {
            let pose = self.core.pose;
            let fills = self.fits(Pose { posture, ..pose }).filter(|s| self.open().has(*s));
            let aim = match fills {
                _ if lands => Aim::Land,
                Some(seed) => Aim::Settle(seed),
                None => Aim::Shift,
            };
            if let Some(plan) = Plan::to(&self.ground(&scene.taken), pose, posture, aim) {
                hit(Mark::MetaCalled);
                self.ask(now, plan);
            }
        }
        true
    }

    fn call(&mut self, bid: Instruction) {
        self.core.sequence += 1;
        let call = Directive { coordinator: self.core.id, sequence: self.core.sequence, instruction: bid };
        self.core.lead.said = Some(call);
        self.broadcast(Class::Negotiation, Message::Directive(call));
    }

    /// Leads no more, as it was for nothing.
    fn lead_in_vain(&mut self, now: Time) {
        let lead = &mut self.core.lead;
        (lead.began, lead.times_in_vain) = (Some(now), lead.times_in_vain.saturating_add(1));
        self.stop_leading();
    }

    /// What has been tried for another task says nothing of this one.
    pub(super) fn lead_afresh(&mut self) {
        self.stop_leading();
        let lead = &mut self.core.lead;
        *lead = Lead { said: lead.said, heard: lead.heard, ..Lead::default() };
    }

    /// Leads no more, and says so.
    pub(super) fn stop_leading(&mut self) {
        if std::mem::take(&mut self.core.lead.stage) != Stage::Not {
            self.call(Instruction::Over);
        }
    }

    /// Somebody leads.
    pub(super) fn hear_call(&mut self, now: Time, port: Port, call: Directive) {
        let is_heard = self.core.peers.iter().any(|(p, peer)| p == port && !peer.condemned);
        let is_later = |(before, until): (Directive, Time)| match call.coordinator == before.coordinator {
            // Whoever has been started again begins to count anew.
            true => call.sequence >= before.sequence || now >= until,
            false => {
                call.coordinator < before.coordinator
                    || now >= until
                    || before.instruction == Instruction::Over
            }
        };
        let leads = self.core.lead.stage != Stage::Not && self.core.id < call.coordinator;
        if !is_heard || leads || !self.core.lead.heard.is_none_or(is_later) {
            return;
        }
        let before = self.core.lead.heard.replace((call, now + self.setup.params.patience * HEEDED));
        if before.is_none_or(|(before, _)| before.instruction != call.instruction) {
            self.look_again(now);
        }
    }

    /// Says again what it has called.
    pub(super) fn repeat_call(&mut self, now: Time) {
        if let Stage::Gathers { until, .. } | Stage::Goes { until, .. } = self.core.lead.stage
            && now >= until
        {
            // Whoever waits for somebody else meanwhile keeps nobody longer than that.
            return self.lead_in_vain(now);
        }
        if let Some(call) = self.core.lead.said {
            self.broadcast(Class::Liveness, Message::Directive(call));
            if call.instruction == Instruction::Over {
                self.core.lead.said = None;
            }
        }
    }
}

/// Whether a body stands as a move wants it to.
fn stands(pose: Pose, as_in: Pose) -> bool {
    (pose.state, pose.posture, pose.both) == (as_in.state, as_in.posture, false)
}

/// Whether whoever stands like this has made a move.
fn is_made(setup: &Setup, made: &Move, pose: Pose) -> bool {
    let ends = Pose { posture: made.posture, ..made.from };
    let ends = if made.lands { setup.motions.turned_around(ends) } else { Some(ends) };
    ends.is_some_and(|ends| stands(pose, ends))
}
