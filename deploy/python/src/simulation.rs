//! Runs on the simulated link, at once or in steps.

use crate::scenario::{Plan, raise};
use metamorph_protocol::counters::Class;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::time::{Span, Time};
use metamorph_world_controller::console::stopwatch::Stopwatch;
use metamorph_world_controller::family::{self, of};
use metamorph_world_controller::record::journal::JournalSession;
use metamorph_world_controller::run::simulated::{self, SteppedRun};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use std::path::PathBuf;
use std::time::Duration;

/// Time between two looks for signals.
const PATIENCE: Duration = Duration::from_millis(50);
/// Events between two looks at the clock.
const EVENTS: u64 = 256;

fn json(value: &impl serde::Serialize) -> PyResult<String> {
    serde_json::to_string(value).map_err(|e| PyValueError::new_err(e.to_string()))
}

/// Simulates a scenario to its end and returns the report as JSON.
#[pyfunction]
#[pyo3(signature = (plan, journal, timeout_s))]
pub fn run(
    py: Python<'_>,
    plan: &Plan,
    journal: Option<PathBuf>,
    timeout_s: Option<f64>,
) -> PyResult<String> {
    let keeping = journal.map(|file| JournalSession::simulated(&file, &plan.plan)).transpose();
    let keeping = keeping.map_err(|e| raise(py, "JournalError", (e.to_string(),)))?;
    let since = Stopwatch::start();
    let (report, interrupted) = py.detach(|| {
        let (mut looked, mut interrupted) = (Stopwatch::start(), None);
        let mut watch = |_, _: &dyn Fn() -> _| {
            if looked.elapsed() >= PATIENCE {
                looked = Stopwatch::start();
                interrupted = Python::attach(|py| py.check_signals()).err();
            }
            interrupted.is_none() && timeout_s.is_none_or(|most| since.elapsed().as_secs_f64() < most)
        };
        let simulation =
            simulated::Simulation { since, watch: &mut watch, keeping, scribe: None, search: true };
        (of(&plan.plan).simulate(&plan.plan, simulation).0, interrupted)
    });
    interrupted.map_or_else(|| json(&report), Err)
}

/// A simulated run that is carried out in steps.
#[pyclass(module = "metamorph._metamorph")]
pub struct Simulation {
    run: Box<dyn SteppedRun>,
    events: u64,
    over: bool,
}

#[pymethods]
impl Simulation {
    /// Begins a run.
    #[new]
    fn new(plan: &Plan) -> Simulation {
        Simulation { run: family::begin(&plan.plan), events: 0, over: false }
    }
    /// Carries out events of the kernel; returns how many: fewer only at the end.
    fn step(&mut self, py: Python<'_>, events: u64) -> PyResult<u64> {
        if events <= EVENTS {
            return Ok(self.carry_out(events));
        }
        let mut left = events;
        while left > 0 && !self.over {
            left -= py.detach(|| self.slice(left, None));
            py.check_signals()?;
        }
        Ok(events - left)
    }
    /// Runs until a time in nanoseconds; returns true if the run is over.
    fn run_until(&mut self, py: Python<'_>, until_ns: u64) -> PyResult<bool> {
        let until = Time(until_ns);
        while !self.over && self.run.now() < until {
            py.detach(|| self.slice(u64::MAX, Some(until)));
            py.check_signals()?;
        }
        Ok(self.over)
    }
    #[getter]
    fn now_ns(&self) -> u64 {
        self.run.now().0
    }
    #[getter]
    fn events(&self) -> u64 {
        self.events
    }
    #[getter]
    fn done(&self) -> bool {
        self.over
    }
    #[getter]
    fn modules(&self) -> usize {
        self.run.modules()
    }
    #[getter]
    fn trace_hash(&self) -> String {
        format!("{:016x}", self.run.trace_hash())
    }
    #[getter]
    fn state_hash(&self) -> String {
        format!("{:016x}", self.run.state_hash())
    }
    /// Injects a fault, such as `kill 7`. Returns its time in nanoseconds.
    fn inject(&mut self, fault: &str) -> PyResult<u64> {
        let fault = fault.parse().map_err(PyValueError::new_err)?;
        self.run.inject(fault).map(|at| at.0).map_err(PyValueError::new_err)
    }
    /// Returns the cells of all modules: three numbers of 16 bits each, in the byte order of the machine.
    fn cells<'py>(&self, py: Python<'py>) -> Bound<'py, PyBytes> {
        let cells = self.run.cells();
        let numbers = cells.iter().flat_map(|c| [c.x, c.y, c.z]);
        PyBytes::new(py, &numbers.flat_map(i16::to_ne_bytes).collect::<Vec<u8>>())
    }
    /// Returns for each module: cell, whether its process lives, role, activity, goal, level, gradient, and the modules
    /// that it has granted a lock and that it waits for.
    #[allow(clippy::type_complexity, reason = "a row of a table, named in Python")]
    fn state(
        &self,
    ) -> Vec<((i16, i16, i16), bool, String, String, u16, Option<u16>, Option<u32>, Option<u32>, Option<u32>)>
    {
        let row = |id| {
            let module = self.run.module(ModuleId(id));
            let s = module.summary.unwrap_or_default();
            let (cell, lock, waits_for) = (module.cell, s.lock.map(|m| m.0), s.waits_for.map(|m| m.0));
            (
                (cell.x, cell.y, cell.z),
                module.is_alive,
                s.role,
                s.activity,
                s.goal,
                s.level,
                s.gradient,
                lock,
                waits_for,
            )
        };
        (0..self.run.modules() as u32).map(row).collect()
    }
    /// Returns for each class of messages: name, sent, delivered, lost, duplicated, overflowed, expired, refused, bytes.
    fn messages(&self) -> Vec<(&'static str, [u64; 8])> {
        let tally = self.run.tally();
        let row = |class: Class| {
            let c = &tally[class];
            let counts =
                [c.sent, c.delivered, c.lost, c.duplicated, c.overflowed, c.expired, c.refused, c.bytes];
            (class.name(), counts)
        };
        Class::ALL.into_iter().map(row).collect()
    }
    /// Returns the report so far as JSON.
    fn report(&self) -> PyResult<String> {
        json(&self.run.report())
    }
}

impl Simulation {
    fn carry_out(&mut self, events: u64) -> u64 {
        let mut done = 0;
        while done < events && !self.over {
            if self.run.step() {
                done += 1;
            } else {
                self.over = true;
            }
        }
        self.events += done;
        done
    }

    /// Works for about as long as signals may wait: at most `events`, or until a time.
    fn slice(&mut self, events: u64, until: Option<Time>) -> u64 {
        let (since, mut done) = (Stopwatch::start(), 0);
        while done < events && !self.over && since.elapsed() < PATIENCE {
            match until {
                None => done += self.carry_out((events - done).min(EVENTS)),
                Some(until) => {
                    let next = (self.run.now() + Span::millis(100)).min(until);
                    self.over = self.run.run_until(next);
                    if self.run.now() >= until {
                        break;
                    }
                }
            }
        }
        done
    }
}
