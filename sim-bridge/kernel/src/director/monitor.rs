//! The part that the directors of all families share: faults and commands, the time of the last progress, and the end of a run.

use crate::director::fault_injector::FaultInjector;
use crate::director::faults::{Fault, FaultRecord, Schedule};
use crate::director::outcome::{Outcome, Stall};
use crate::director::progress::Stop;
use crate::director::rescue::Help;
use crate::director::standstills::{Look, Standstills};
use metamorph_core::ids::ModuleId;
use metamorph_core::runtime::Command;
use metamorph_core::time::Time;
use std::collections::VecDeque;

/// The faults, the commands and the end of a run. `O` is the type of orders to agents.
#[derive(Clone)]
pub struct RunMonitor<O> {
    /// Injects the faults of the schedule and those that operators command.
    pub faults: FaultInjector,
    /// Commands that the driver has not polled yet, in order.
    pub commands: VecDeque<Command<O>>,
    /// The bounds after which a run without progress is ended.
    pub stop: Stop,
    /// The end of the last action of a body. Most directors also count events that may let bodies act again.
    pub last_action: Time,
    /// The last time that a part of the goal was reached.
    pub last_gain: Time,
    /// The next time that the director examines the world.
    pub next_check: Time,
    /// Conflicts prevented in incarnations that have ended.
    pub prevented_before: u64,
    standstills: Standstills,
    done: u64,
    outcome: Option<(Time, Outcome)>,
    stall: Option<Stall>,
}

/// The state of a run that decides whether it ends at a standstill.
#[derive(Clone, Copy, Debug)]
pub struct Standing {
    /// True if a planned event may still let modules continue.
    pub is_planned: bool,
    /// True if nothing can continue, however short the standstill is.
    pub is_stranded: bool,
    /// The start of the time without actions.
    pub idle_since: Time,
    /// The start of the time without a gain.
    pub no_gain_since: Time,
}

impl<O> RunMonitor<O> {
    /// Creates the monitor of a run that has not begun.
    pub fn new(schedule: Schedule, stop: Stop) -> RunMonitor<O> {
        RunMonitor {
            faults: FaultInjector::new(schedule),
            commands: VecDeque::new(),
            stop,
            last_action: Time::ZERO,
            last_gain: Time::ZERO,
            next_check: Time::ZERO,
            prevented_before: 0,
            standstills: Standstills::default(),
            done: 0,
            outcome: None,
            stall: None,
        }
    }

    /// Returns the outcome of the run and its time; `None` until it has ended.
    pub fn outcome(&self) -> Option<(Time, Outcome)> {
        self.outcome
    }
    /// Returns the standstill that ended the run, if one did.
    pub fn stall(&self) -> Option<&Stall> {
        self.stall.as_ref()
    }
    /// Returns the standstills so far, including those that did not end the run.
    pub fn standstills(&self) -> &Standstills {
        &self.standstills
    }
    /// Returns the number of standstills so far, with one that lasts.
    pub fn standstill_count(&self) -> u64 {
        self.standstills.counts().iter().sum()
    }
    /// Returns the effects of the faults so far.
    pub fn struck(&self) -> &[FaultRecord] {
        self.faults.struck()
    }
    /// Returns how many processes died, and how many were restarted.
    pub fn crashed_and_restarted(&self) -> (u64, u64) {
        self.faults.crashed_and_restarted()
    }
    /// Returns the time of the last gain.
    pub fn last_gain(&self) -> Time {
        self.last_gain
    }
    /// Returns the number of completed actions, at the last look.
    pub fn done(&self) -> u64 {
        self.done
    }
    /// Returns the conflicts prevented in the run. `reported` are those that each living incarnation has reported.
    pub fn prevented(&self, reported: impl Iterator<Item = u32>) -> u64 {
        self.prevented_before + reported.map(u64::from).sum::<u64>()
    }

    /// Takes the number of actions completed so far. A higher one than before is progress.
    pub fn count_actions(&mut self, now: Time, done: u64) {
        if done != self.done {
            (self.done, self.last_action) = (done, now);
        }
    }
    /// Injects the fault that is due. See [`FaultInjector::inject`].
    pub fn inject(&mut self, now: Time, fault: Fault, alive: bool, effect: impl Into<String>) {
        self.faults.inject(now, fault, alive, effect.into(), &mut self.commands);
    }
    /// Sends an order to an agent.
    pub fn order(&mut self, id: ModuleId, order: O) {
        self.commands.push_back(Command::Order(id, order));
    }

    /// Returns true if faults of the schedule, or other events of the scenario, are still to come.
    pub fn is_event_planned(&self, now: Time) -> bool {
        self.faults.is_pending() || now < self.stop.planned_until
    }
    /// Returns the outcome with which a run ends now that stands like this; `None` if it continues.
    pub fn verdict(&self, now: Time, standing: Standing) -> Option<Outcome> {
        let Standing { is_planned, is_stranded, idle_since, no_gain_since } = standing;
        if now >= self.stop.timeout {
            Some(Outcome::Timeout)
        } else if is_planned {
            None
        } else if is_stranded || now.since(idle_since) > self.stop.stall {
            Some(Outcome::Deadlock)
        } else if now.since(no_gain_since) > self.stop.livelock {
            Some(Outcome::Livelock)
        } else {
            None
        }
    }
    /// Looks if the swarm stands still: with `filled` parts of the goal reached, and this help of the controller so far. Returns
    /// the time since which it does if that is noticed now; the caller then calls [`RunMonitor::begin_standstill`].
    pub fn look(
        &mut self,
        now: Time,
        standing: Standing,
        filled: usize,
        help: Help,
        is_led: bool,
    ) -> Option<Time> {
        let Standing { is_planned, idle_since, no_gain_since, .. } = standing;
        let (moves, commands) = (self.done, self.faults.commanded());
        let look = Look { now, is_planned, idle_since, no_gain_since, moves, filled, help, is_led, commands };
        self.standstills.look(look, self.stop.stall, self.stop.livelock)
    }
    /// Records a standstill that was noticed at the last look.
    pub fn begin_standstill(&mut self, stall: Stall) {
        self.standstills.begin(stall);
    }
    /// Takes note that a standstill, if there is one, is over because the controller moved the goal.
    pub fn relocate_standstill(&mut self, now: Time) {
        self.standstills.relocate(now);
    }
    /// Takes note that a standstill, if there is one, is over because another goal begins.
    pub fn resolve_standstill(&mut self, now: Time) {
        self.standstills.resolve(now);
    }

    /// Ends the run, unless it has ended.
    pub fn finish(&mut self, now: Time, outcome: Outcome) {
        if self.outcome.is_none() {
            match outcome {
                Outcome::Built => self.standstills.resolve(now),
                _ => self.standstills.close(),
            }
            self.outcome = Some((now, outcome));
            self.commands.push_back(Command::Finish);
        }
    }
    /// Ends the run at a standstill.
    pub fn give_up(&mut self, now: Time, outcome: Outcome, stall: Stall) {
        self.stall = Some(stall);
        self.finish(now, outcome);
    }

    /// Returns the injector, for commands of an operator.
    ///
    /// # Errors
    /// If the run has ended.
    pub fn injector(&mut self) -> Result<&mut FaultInjector, String> {
        if self.outcome.is_some() { Err("the run is over".to_owned()) } else { Ok(&mut self.faults) }
    }

    /// Returns when to wake the director: at `own` at the latest, for the next fault, check or the timeout; never after the end.
    pub fn wake_at(&self, own: Time) -> Time {
        if self.outcome.is_some() {
            return Time::NEVER;
        }
        self.faults.next_at().min(self.next_check).min(self.stop.timeout).min(own)
    }
}
