//! The world-controller's brain for metamodules: opens seeds level by level in the order of the
//! blueprint, injects faults, tells of deaths, watches progress and decides how the run ends.

use crate::direct::{Command, Direct};
use crate::director::{Progress, Stop};
use crate::faults::{Fault, Schedule, Struck};
use crate::metamodule_world::MetamoduleWorld;
use crate::outcome::{Outcome, Reason, Stall};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::blueprint::SeedSet;
use metamorph_protocol::metamodule::message::{Order, Status};
use metamorph_protocol::metamodule::params::{Setup, Teller};
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::time::Time;
use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;

/// What is known of a metamodule.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Known {
    alive: bool,
    status: Option<Status>,
}

/// The controller's brain for metamodules.
pub struct MetamoduleDirector {
    setup: Arc<Setup>,
    schedule: Schedule,
    next_fault: usize,
    stop: Stop,
    failure: Ratio,
    known: Vec<Known>,
    /// The dead whose death is still to be told.
    untold: BTreeSet<ModuleId>,
    dead: BTreeSet<ModuleId>,
    paused: BTreeSet<ModuleId>,
    commands: VecDeque<Command<Order>>,
    struck: Vec<Struck>,
    restarted: u64,
    crashed: u64,
    filled: SeedSet,
    told: Option<SeedSet>,
    done: u64,
    moves: u64,
    last_deed: Time,
    last_fill: Time,
    next_check: Time,
    outcome: Option<(Time, Outcome)>,
    stall: Option<Stall>,
}

impl MetamoduleDirector {
    /// A director for a swarm of this many metamodules. `stop.stall` counts from the last thing that a
    /// body completed, `stop.livelock` from the last seed filled.
    pub fn new(
        setup: Arc<Setup>,
        metamodules: usize,
        schedule: Schedule,
        stop: Stop,
        failure: Ratio,
    ) -> MetamoduleDirector {
        MetamoduleDirector {
            setup,
            schedule,
            next_fault: 0,
            stop,
            failure,
            known: vec![Known::default(); metamodules],
            untold: BTreeSet::new(),
            dead: BTreeSet::new(),
            paused: BTreeSet::new(),
            commands: VecDeque::new(),
            struck: Vec::new(),
            restarted: 0,
            crashed: 0,
            filled: SeedSet::default(),
            told: None,
            done: 0,
            moves: 0,
            last_deed: Time::ZERO,
            last_fill: Time::ZERO,
            next_check: Time::ZERO,
            outcome: None,
            stall: None,
        }
    }

    /// How the run ended, and when; none while it goes on.
    pub fn outcome(&self) -> Option<(Time, Outcome)> {
        self.outcome
    }
    /// The standstill that ended the run, if one did.
    pub fn stall(&self) -> Option<&Stall> {
        self.stall.as_ref()
    }
    /// Faults that have struck.
    pub fn struck(&self) -> &[Struck] {
        &self.struck
    }
    /// Processes that have died, and those that were started again.
    pub fn crashed_and_restarted(&self) -> (u64, u64) {
        (self.crashed, self.restarted)
    }
    /// When the last seed was filled.
    pub fn last_fill(&self) -> Time {
        self.last_fill
    }
    /// Locks refused because two would have met.
    pub fn prevented(&self) -> u64 {
        self.known.iter().filter_map(|k| k.status).map(|s| u64::from(s.prevented)).sum()
    }
    /// How far the run has come. Seeds stand for cells.
    pub fn progress(&self) -> Progress {
        Progress {
            stage: 0,
            stages: 1,
            goal: self.setup.blueprint.seeds().len(),
            filled: self.filled.len(),
            alive: self.known.iter().filter(|k| k.alive).count(),
            moves: self.moves,
        }
    }

    fn finish(&mut self, now: Time, outcome: Outcome) {
        if self.outcome.is_none() {
            self.outcome = Some((now, outcome));
            self.commands.push_back(Command::Finish);
        }
    }

    fn strike(&mut self, now: Time, fault: Fault, world: &mut MetamoduleWorld) {
        let id = fault.module();
        let known = self.known[id.index()];
        let doing = match known.status {
            _ if !known.alive => "dead",
            Some(s) if s.settled.is_some() => "settled",
            _ => "free",
        };
        let acting = if world.is_acting(id) { ", acting" } else { "" };
        let effect = format!("it was {doing} at {}{acting}", world.pose(id).state);
        self.struck.push(Struck { at: now, fault, effect });
        match fault {
            Fault::Kill(_) => self.commands.push_back(Command::Kill(id)),
            Fault::Pause(_) => {
                self.paused.insert(id);
                self.commands.push_back(Command::Pause(id));
            }
            Fault::Resume(_) => {
                self.paused.remove(&id);
                self.commands.push_back(Command::Resume(id));
            }
            Fault::Restart(_) => {
                if known.alive {
                    self.commands.push_back(Command::Kill(id));
                }
                self.restarted += 1;
                self.commands.push_back(Command::Restart(id));
            }
            Fault::Stick(_) => world.set_stuck(id, true),
            Fault::Unstick(_) => world.set_stuck(id, false),
        }
    }

    /// Tells everybody where the dead stay, once their bodies have come to rest.
    fn tell_deaths(&mut self, world: &MetamoduleWorld) {
        let still: Vec<ModuleId> = self.untold.iter().copied().filter(|id| !world.is_acting(*id)).collect();
        for dead in still {
            self.untold.remove(&dead);
            let order = Order::Dead { id: dead, pose: world.pose(dead) };
            for id in (0..self.known.len() as u32).map(ModuleId) {
                self.commands.push_back(Command::Order(id, order));
            }
        }
    }

    fn count_filled(&mut self, now: Time, world: &MetamoduleWorld) {
        let mut filled = SeedSet::default();
        for (i, seed) in self.setup.blueprint.seeds().iter().enumerate() {
            let cells = seed.cells();
            let fills = |(id, known): (usize, &Known)| {
                let stays = !known.alive || known.status.is_some_and(|s| s.settled == Some(i as u8));
                stays && world.cells(ModuleId(id as u32)) == cells
            };
            if self.known.iter().enumerate().any(fills) {
                filled = filled.with(i as u8);
            }
        }
        if filled != self.filled {
            self.filled = filled;
            self.last_fill = now;
        }
    }

    fn seeds(&self) -> Order {
        Order::Seeds { open: self.setup.blueprint.open(self.filled), filled: self.filled }
    }

    fn watch(&mut self, now: Time, world: &MetamoduleWorld) {
        let deeds = world.deeds();
        self.moves = deeds.moves;
        let done = deeds.turns + deeds.moves + deeds.released;
        if done != self.done {
            self.done = done;
            self.last_deed = now;
        }
        self.next_check = now + self.setup.params.turn_time;
        self.count_filled(now, world);
        let told_by_us = self.setup.params.teller == Teller::Controller;
        if self.told != Some(self.filled) && (told_by_us || self.told.is_none()) {
            self.told = Some(self.filled);
            if told_by_us {
                let order = self.seeds();
                for id in (0..self.known.len() as u32).map(ModuleId) {
                    self.commands.push_back(Command::Order(id, order));
                }
            }
        }
        if self.filled.holds(self.setup.blueprint.all()) {
            return self.finish(now, Outcome::Built);
        }
        let planned = self.next_fault < self.schedule.len() || !self.paused.is_empty();
        let idle_since = self.last_deed.max(self.last_fill);
        if now >= self.stop.timeout {
            self.stall = Some(self.explain(idle_since));
            self.finish(now, Outcome::Timeout);
        } else if planned {
            // Something will still happen.
        } else if now.since(idle_since) > self.stop.stall {
            self.stall = Some(self.explain(idle_since));
            self.finish(now, Outcome::Deadlock);
        } else if now.since(self.last_fill) > self.stop.livelock {
            self.stall = Some(self.explain(self.last_fill));
            self.finish(now, Outcome::Livelock);
        }
    }

    /// The blocked seeds, and who waits for whom by the last refusal.
    fn explain(&self, since: Time) -> Stall {
        let seeds = self.setup.blueprint.seeds();
        let unfilled = self.setup.blueprint.all().without(self.filled);
        let free: Vec<(ModuleId, Option<ModuleId>)> = (0..)
            .map(ModuleId)
            .zip(&self.known)
            .filter(|(_, k)| k.alive)
            .filter_map(|(id, k)| Some((id, k.status.filter(|s| s.settled.is_none())?.waits_for)))
            .collect();
        let reason = if free.len() < unfilled.len() {
            Reason::MaterialExhausted
        } else if free.iter().any(|(_, on)| on.is_some()) {
            Reason::NoLock
        } else {
            Reason::NoBetterPlace
        };
        Stall {
            since,
            reason,
            text: reason.text(),
            unfilled: unfilled
                .iter()
                .map(|s| seeds[usize::from(s)].foot)
                .map(|(x, y)| Cell::new(x, y, 0))
                .collect(),
            wait_cycle: cycle(&free),
            waiting: free,
        }
    }
}

/// Whoever waits for each other in a circle; each waits for one at most.
fn cycle(waiting: &[(ModuleId, Option<ModuleId>)]) -> Vec<ModuleId> {
    let on = |id: ModuleId| waiting.iter().find(|(w, _)| *w == id).and_then(|(_, on)| *on);
    for (start, _) in waiting {
        let mut path = vec![*start];
        while let Some(next) = path.last().and_then(|id| on(*id)) {
            if next == *start {
                path.sort_unstable();
                return path;
            }
            if path.contains(&next) {
                break;
            }
            path.push(next);
        }
    }
    Vec::new()
}

impl Direct<MetamoduleWorld> for MetamoduleDirector {
    fn report(&mut self, _now: Time, id: ModuleId, report: Status) {
        let before = self.known[id.index()].status.replace(report);
        if before.and_then(|s| s.settled) != report.settled {
            self.next_check = Time::ZERO;
        }
    }

    fn died(&mut self, _now: Time, id: ModuleId) {
        self.crashed += 1;
        self.known[id.index()].alive = false;
        self.paused.remove(&id);
        self.dead.insert(id);
        self.untold.insert(id);
        self.next_check = Time::ZERO;
    }

    fn started(&mut self, _now: Time, id: ModuleId) {
        self.known[id.index()] = Known { alive: true, status: None };
        self.dead.remove(&id);
        self.untold.remove(&id);
        if self.told.is_some() {
            let order = self.seeds();
            self.commands.push_back(Command::Order(id, order));
            // Who has lost its memory has to be told again who is dead; the others do not mind.
            self.untold.extend(self.dead.iter().copied());
        }
    }

    fn wake(&mut self, now: Time, world: &mut MetamoduleWorld) {
        if self.outcome.is_some() {
            return;
        }
        if now == Time::ZERO {
            world.set_failure(self.failure);
        }
        while let Some((_, fault)) = self.schedule.get(self.next_fault).filter(|(at, _)| *at <= now) {
            self.next_fault += 1;
            self.strike(now, fault, world);
        }
        self.tell_deaths(world);
        self.watch(now, world);
    }

    fn wake_at(&self) -> Time {
        if self.outcome.is_some() {
            return Time::NEVER;
        }
        let fault = self.schedule.get(self.next_fault).map_or(Time::NEVER, |(at, _)| at);
        fault.min(self.next_check).min(self.stop.timeout)
    }

    fn poll(&mut self) -> Option<Command<Order>> {
        self.commands.pop_front()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_who_waits_in_a_circle() {
        let wait = |pairs: &[(u32, Option<u32>)]| {
            let pairs: Vec<_> = pairs.iter().map(|(a, b)| (ModuleId(*a), b.map(ModuleId))).collect();
            cycle(&pairs)
        };
        assert_eq!(wait(&[(0, Some(1)), (1, Some(2)), (2, Some(1))]), [ModuleId(1), ModuleId(2)]);
        assert_eq!(wait(&[(0, Some(1)), (1, None)]), []);
        assert_eq!(wait(&[(0, Some(7))]), []);
    }
}
