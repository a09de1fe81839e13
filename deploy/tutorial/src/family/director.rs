//! The director of an election whose processes may die: it ends the run when all modules that live name
//! the same leader, or when nothing has changed for too long.

use crate::leader::{Leader, Lowest};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::record::Outside;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::Never;
use metamorph_sim_bridge::director::fault_injector::FaultInjector;
use metamorph_sim_bridge::director::faults::{Fault, FaultRecord, Schedule};
use metamorph_sim_bridge::director::outcome::{Outcome, Stall};
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::director::progress::{Progress, Stage, Stop};
use metamorph_sim_bridge::director::reason::{Excuse, Reason};
use metamorph_sim_bridge::kernel::still_world::StillWorld;
use metamorph_sim_bridge::world::World;
use std::collections::VecDeque;

/// Modules that cannot hear each other name different leaders.
pub const DIVIDED: Reason = Reason::new(
    "divided",
    Excuse::IfDead,
    "divided: modules that cannot hear each other name different leaders",
);

/// The director.
pub struct ElectionDirector {
    faults: FaultInjector,
    stop: Stop,
    /// The leader that each module has named last.
    named: Vec<Option<ModuleId>>,
    alive: Vec<bool>,
    /// Processes that are to be killed and are not dead yet.
    dying: usize,
    last_change: Time,
    commands: VecDeque<Command<Never>>,
    ended: Option<(Time, Outcome)>,
    stall: Option<Stall>,
}

impl ElectionDirector {
    /// A director of this many modules.
    pub fn new(modules: usize, schedule: Schedule, stop: Stop) -> ElectionDirector {
        ElectionDirector {
            faults: FaultInjector::new(schedule),
            stop,
            named: vec![None; modules],
            alive: vec![false; modules],
            dying: 0,
            last_change: Time::ZERO,
            commands: VecDeque::new(),
            ended: None,
            stall: None,
        }
    }
    /// The time and the way that the run ended; `None` before it has.
    pub fn ended(&self) -> Option<(Time, Outcome)> {
        self.ended
    }
    /// Why the modules did not agree.
    pub fn stall(&self) -> Option<&Stall> {
        self.stall.as_ref()
    }
    /// How many processes died, and how many were started again.
    pub fn crashed_and_restarted(&self) -> (u64, u64) {
        self.faults.crashed_and_restarted()
    }
    /// How far the run has come: a module counts as a filled cell once it names the lowest leader.
    pub fn progress(&self) -> Progress {
        Progress {
            stage: 0,
            stages: 1,
            goal: self.named.len(),
            filled: self.named.len() - self.dissenters().len(),
            alive: self.alive.iter().filter(|alive| **alive).count(),
            moves: 0,
            messages: None,
        }
    }
    /// The only stage.
    pub fn stage(&self) -> Stage {
        let built = self.ended.filter(|(_, outcome)| *outcome == Outcome::Built).map(|(at, _)| at);
        let Progress { goal, filled, .. } = self.progress();
        Stage { cells: goal, filled, opened: Time::ZERO, built, known: built }
    }

    /// Living modules that do not name the lowest leader that any living module names.
    fn dissenters(&self) -> Vec<ModuleId> {
        let living = (0..self.named.len()).filter(|i| self.alive[*i]);
        let lowest = living.clone().filter_map(|i| self.named[i]).min();
        living.filter(|i| self.named[*i] != lowest).map(|i| ModuleId(i as u32)).collect()
    }

    fn end(&mut self, now: Time, outcome: Outcome, world: &StillWorld<Leader>) {
        if self.ended.is_some() {
            return;
        }
        self.ended = Some((now, outcome));
        self.commands.push_back(Command::Finish);
        let open = self.dissenters().into_iter().map(|id| world.place(id).into()).collect();
        self.stall = (outcome != Outcome::Built).then(|| Stall {
            since: self.last_change,
            reason: DIVIDED,
            text: DIVIDED.text,
            open,
            wait_cycle: Vec::new(),
            waiting: Vec::new(),
            detected: None,
            proof: None,
        });
    }
}

impl DirectorPort<StillWorld<Leader>> for ElectionDirector {
    fn report(&mut self, now: Time, id: ModuleId, Lowest(lowest): Lowest) {
        self.named[id.index()] = Some(lowest);
        self.last_change = now;
    }
    fn died(&mut self, now: Time, id: ModuleId) {
        self.faults.died(id);
        self.alive[id.index()] = false;
        self.dying = self.dying.saturating_sub(1);
        self.last_change = now;
    }
    fn external(&mut self, now: Time, id: ModuleId, what: &Outside, _: &StillWorld<Leader>) {
        self.faults.external(now, id, what, "it was voting");
    }
    fn started(&mut self, now: Time, id: ModuleId) {
        self.alive[id.index()] = true;
        self.last_change = now;
    }
    fn wake(&mut self, now: Time, world: &mut StillWorld<Leader>) {
        while let Some(fault) = self.faults.due(now) {
            let alive = fault.module().is_some_and(|id| self.alive[id.index()]);
            self.dying += usize::from(alive && matches!(fault, Fault::Kill(_)));
            let effect = if alive { "it was voting" } else { "it was dead" };
            self.faults.inject(now, fault, alive, effect.to_owned(), &mut self.commands);
            self.last_change = now;
        }
        let waits = self.faults.is_pending() || self.dying > 0 || now < self.stop.planned_until;
        if self.dissenters().is_empty() && !waits {
            self.end(now, Outcome::Built, world);
        } else if now >= self.stop.timeout {
            self.end(now, Outcome::Timeout, world);
        } else if now >= self.last_change + self.stop.stall && !waits {
            self.end(now, Outcome::Deadlock, world);
        }
    }
    fn wake_at(&self) -> Time {
        if self.ended.is_some() {
            return Time::NEVER;
        }
        // A schedule that is not over has its end among the faults to come.
        let next = match (self.faults.is_pending(), self.dissenters().is_empty()) {
            (true, _) => self.faults.next_at(),
            _ if self.dying > 0 => Time::NEVER,
            (false, true) => self.last_change.max(self.stop.planned_until),
            (false, false) => (self.last_change + self.stop.stall).max(self.stop.planned_until),
        };
        next.min(self.stop.timeout)
    }
    fn poll(&mut self) -> Option<Command<Never>> {
        self.commands.pop_front()
    }
    fn struck(&self) -> &[FaultRecord] {
        self.faults.struck()
    }
}
