//! The director of a protocol in Python: injects the faults, and ends the run when `until` says so, when no module has
//! reported anything for the bound of a standstill, or when the time is up.

use super::bodies::PyBodies;
use super::message::Payload;
use super::setup::Setup;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::Never;
use metamorph_sim_bridge::director::fault_injector::FaultInjector;
use metamorph_sim_bridge::director::faults::{Fault, FaultRecord, Schedule};
use metamorph_sim_bridge::director::outcome::{Objective, Outcome, Stall};
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::director::progress::{Progress, Stage, Stop};
use metamorph_sim_bridge::director::reason::{Excuse, Reason};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::collections::VecDeque;
use std::sync::Arc;

/// No module has reported anything for too long.
pub const SILENCE: Reason =
    Reason::new("silence", Excuse::IfDead, "silence: no module has reported anything for too long");

/// The director.
pub struct PyDirector {
    setup: Arc<Setup>,
    faults: FaultInjector,
    stop: Stop,
    alive: Vec<bool>,
    /// Processes that are to be killed and are not dead yet.
    dying: usize,
    last_change: Time,
    /// When `until` is asked next although nothing has happened.
    ask_at: Time,
    commands: VecDeque<Command<Never>>,
    ended: Option<(Time, Outcome)>,
    stall: Option<Stall>,
    is_over: bool,
}

impl PyDirector {
    /// Creates the director of a run of `modules`.
    pub fn new(setup: &Arc<Setup>, modules: usize, schedule: Schedule, stop: Stop) -> PyDirector {
        PyDirector {
            setup: Arc::clone(setup),
            faults: FaultInjector::new(schedule),
            stop,
            alive: vec![false; modules],
            dying: 0,
            last_change: Time::ZERO,
            ask_at: Time::ZERO + setup.move_time,
            commands: VecDeque::new(),
            ended: None,
            stall: None,
            is_over: false,
        }
    }
    /// Returns the time and the outcome; `None` if the run was interrupted.
    pub fn ended(&self) -> Option<(Time, Outcome)> {
        self.ended
    }
    /// Returns the standstill that ended the run.
    pub fn stall(&self) -> Option<&Stall> {
        self.stall.as_ref()
    }
    /// Returns how many processes died, and how many were restarted.
    pub fn crashed_and_restarted(&self) -> (u64, u64) {
        self.faults.crashed_and_restarted()
    }
    /// Returns the progress, with `until` as the one goal.
    pub fn progress(&self) -> Progress {
        let filled = self.stage().filled;
        let alive = self.alive.iter().filter(|alive| **alive).count();
        let (standstills, restarts) = (self.stall.is_some().into(), self.crashed_and_restarted().1);
        Progress { goal: 1, stages: 1, filled, alive, standstills, restarts, ..Progress::default() }
    }
    /// Returns `until` as a goal of one cell.
    pub fn stage(&self) -> Stage {
        let built = self.ended.filter(|(_, outcome)| *outcome == Outcome::Built).map(|(at, _)| at);
        Stage { cells: 1, filled: built.is_some().into(), opened: Time::ZERO, built, known: built }
    }

    /// Asks `until` whether the run is over.
    fn ask(&mut self, now: Time) {
        let spec = &self.setup.spec;
        let Some(until) = spec.until.as_ref().filter(|_| !self.is_over && !spec.has_failed()) else { return };
        let answer = Python::attach(|py| {
            let answer = until.bind(py).call1((&self.setup.reports, now.as_secs_f64()))?;
            if answer.is_none() || answer.extract::<bool>().is_ok_and(|over| !over) {
                return Ok(None);
            }
            if answer.extract::<bool>().is_ok() {
                return Ok(Some(Outcome::Built));
            }
            let name = answer.extract::<String>().unwrap_or_default();
            Outcome::ALL.into_iter().find(|o| o.name() == name).map(Some).ok_or_else(|| {
                let known: Vec<_> = Outcome::ALL.iter().map(|outcome| outcome.name()).collect();
                let known = known.join(", ");
                PyValueError::new_err(format!(
                    "`until` returned {answer}; write None, True, or one of {known}"
                ))
            })
        });
        match answer {
            Ok(None) => {}
            Ok(Some(outcome)) => self.end(now, outcome),
            Err(error) => spec.fail(error, None, now, "until"),
        }
    }

    fn end(&mut self, now: Time, outcome: Outcome) {
        if self.is_over {
            return;
        }
        self.close();
        self.ended = Some((now, outcome));
        self.stall = (outcome != Outcome::Built).then(|| Stall {
            since: self.last_change,
            reason: SILENCE,
            text: SILENCE.text,
            open: vec![Objective { text: "until".to_owned(), cell: None }],
            wait_cycle: Vec::new(),
            waiting: Vec::new(),
            detected: None,
            proof: None,
        });
    }

    fn close(&mut self) {
        self.is_over = true;
        self.commands.push_back(Command::Finish);
    }

    /// Changes a dictionary of the protocol; a failure ends the run.
    fn note(&self, now: Time, change: impl FnOnce(Python<'_>, &Setup) -> PyResult<()>) {
        if let Err(error) = Python::attach(|py| change(py, &self.setup)) {
            self.setup.spec.fail(error, None, now, "report");
        }
    }
}

impl DirectorPort<PyBodies> for PyDirector {
    fn report(&mut self, now: Time, id: ModuleId, report: Payload) {
        self.note(now, |py, setup| {
            let message = setup.message(py, &report)?;
            setup.reports.bind(py).set_item(id.0, message)
        });
        self.last_change = now;
        self.ask(now);
    }
    fn died(&mut self, now: Time, id: ModuleId) {
        self.faults.died(id);
        self.alive[id.index()] = false;
        self.dying = self.dying.saturating_sub(1);
        self.last_change = now;
        self.note(now, |py, setup| {
            for by_module in [&setup.modules, &setup.reports] {
                by_module.bind(py).call_method1("pop", (id.0, py.None()))?;
            }
            Ok(())
        });
        self.ask(now);
    }
    fn started(&mut self, now: Time, id: ModuleId) {
        self.alive[id.index()] = true;
        self.last_change = now;
    }
    fn wake(&mut self, now: Time, world: &mut PyBodies) {
        if self.setup.spec.has_failed() && !self.is_over {
            return self.close();
        }
        while let Some(fault) = self.faults.due(now) {
            let alive = fault.module().is_some_and(|id| self.alive[id.index()]);
            match fault {
                Fault::Kill(_) => self.dying += usize::from(alive),
                Fault::Stick(id) | Fault::Unstick(id) => {
                    if let Some(cubes) = world.cubes_mut() {
                        cubes.set_stuck(id, matches!(fault, Fault::Stick(_)));
                    }
                }
                _ => {}
            }
            let effect = if alive { "it was running" } else { "it was dead" };
            self.faults.inject(now, fault, alive, effect.to_owned(), &mut self.commands);
            self.last_change = now;
        }
        if now >= self.ask_at {
            self.ask_at = now + self.setup.move_time;
            self.ask(now);
        }
        let waits = self.faults.is_pending() || self.dying > 0 || now < self.stop.planned_until;
        let is_silent = self.setup.spec.until.is_some() && now >= self.last_change + self.stop.stall;
        if now >= self.stop.timeout {
            self.end(now, Outcome::Timeout);
        } else if is_silent && !waits {
            self.end(now, Outcome::Deadlock);
        }
    }
    fn input(&mut self, now: Time, kind: &str, bytes: &[u8]) -> Result<(), String> {
        if self.is_over {
            return Err("the run is over".to_owned());
        }
        self.faults.input(now, kind, bytes, self.alive.len(), &[])
    }
    fn wake_at(&self) -> Time {
        if self.is_over {
            Time::NEVER
        } else if self.setup.spec.has_failed() {
            Time::ZERO
        } else {
            // A standstill is noticed at the next question.
            self.faults.next_at().min(self.ask_at).min(self.stop.timeout)
        }
    }
    fn poll(&mut self) -> Option<Command<Never>> {
        self.commands.pop_front()
    }
    fn struck(&self) -> &[FaultRecord] {
        self.faults.struck()
    }
}
