//! Runs on the simulated link, at once or in steps.

use crate::protocol::Setup;
use crate::raised::raise;
use crate::scenario::Plan;
use metamorph_protocol::counters::Class;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::kernel::change::ChangeKind;
use metamorph_world_controller::console::stopwatch::Stopwatch;
use metamorph_world_controller::family;
use metamorph_world_controller::record::journal::JournalSession;
use metamorph_world_controller::run::PageChannels;
use metamorph_world_controller::run::simulated::{self, ForkError, SteppedRun};
use metamorph_world_controller::view::request::{Command, Kind, Origin};
use metamorph_world_controller::view::saved::Subject;
use metamorph_world_controller::view::scene_builder::Shared;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDict};
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// Time between two looks for signals.
const PATIENCE: Duration = Duration::from_millis(50);
/// Number of events between two looks at the clock.
const EVENTS: u64 = 256;

fn json(value: &impl serde::Serialize) -> PyResult<String> {
    serde_json::to_string(value).map_err(|e| PyValueError::new_err(e.to_string()))
}

/// Works without the interpreter, unless a protocol in Python would take it back for every event.
fn released<T: Send>(py: Python<'_>, release: bool, work: impl FnOnce() -> T + Send) -> T {
    if release { py.detach(work) } else { work() }
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
    let setup = plan.setup();
    let simulate = || {
        let (mut looked, mut interrupted) = (Stopwatch::start(), None);
        let mut watch = |_, _: &dyn Fn() -> _| {
            if looked.elapsed() >= PATIENCE {
                looked = Stopwatch::start();
                interrupted = Python::attach(|py| py.check_signals()).err();
            }
            interrupted.is_none() && timeout_s.is_none_or(|most| since.elapsed().as_secs_f64() < most)
        };
        let simulation = simulated::Simulation {
            since,
            watch: &mut watch,
            keeping,
            page: PageChannels::default(),
            search: true,
        };
        (simulated::simulate(&plan.plan, simulation).0, interrupted)
    };
    let (report, interrupted) = released(py, setup.is_none(), simulate);
    setup.map_or(Ok(()), |setup| setup.spec.check(py))?;
    interrupted.map_or_else(|| json(&report), Err)
}

/// A simulated run that is carried out in steps.
#[pyclass(module = "metamorph._metamorph")]
pub struct Simulation {
    run: Box<dyn SteppedRun>,
    events: u64,
    over: bool,
    /// Shared state of the agents, if the protocol is written in Python.
    setup: Option<Arc<Setup>>,
    /// Subject and scene of the run so far, with such a protocol. Other runs can be carried out again by the program, and are
    /// shown by it.
    shown: Option<(Subject, Shared)>,
}

#[pymethods]
impl Simulation {
    /// Begins a run.
    #[new]
    fn new(py: Python<'_>, plan: &Plan) -> PyResult<Simulation> {
        let plan_of_run = &plan.plan;
        let (run, shown) = match plan.setup() {
            None => (family::begin(plan_of_run), None),
            Some(_) => {
                let (run, scene) = family::begin_shown(plan_of_run);
                let (title, seed) = (plan_of_run.title(), plan_of_run.seed);
                let command = Command::Run(plan_of_run.repeat_with());
                let bodies = family::of(plan_of_run).shown(plan_of_run);
                (run, Some((Subject::new(bodies, Origin { title, seed, command }), scene)))
            }
        };
        let simulation = Simulation { run, events: 0, over: false, setup: plan.setup(), shown };
        simulation.check(py)?;
        Ok(simulation)
    }
    /// Carries out events of the kernel; returns how many: fewer only at the end.
    fn step(&mut self, py: Python<'_>, events: u64) -> PyResult<u64> {
        if events <= EVENTS {
            let done = self.carry_out(events);
            self.check(py)?;
            return Ok(done);
        }
        let mut left = events;
        while left > 0 && !self.over {
            left -= released(py, self.setup.is_none(), || self.slice(left, None));
            self.check(py)?;
            py.check_signals()?;
        }
        Ok(events - left)
    }
    /// Runs until a time in nanoseconds; returns true if the run is over.
    fn run_until(&mut self, py: Python<'_>, until_ns: u64) -> PyResult<bool> {
        let until = Time(until_ns);
        while !self.over && self.run.now() < until {
            released(py, self.setup.is_none(), || self.slice(u64::MAX, Some(until)));
            self.check(py)?;
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
    fn state_hash(&self, py: Python<'_>) -> PyResult<String> {
        let hash = self.run.state_hash();
        self.check(py)?;
        Ok(format!("{hash:016x}"))
    }
    /// Injects a fault, such as `kill 7`. Returns its time in nanoseconds.
    fn inject(&mut self, fault: &str) -> PyResult<u64> {
        let fault = fault.parse().map_err(PyValueError::new_err)?;
        self.run.inject(fault).map(|at| at.0).map_err(PyValueError::new_err)
    }
    /// Returns a copy of the run, which goes on independently.
    fn fork(&self) -> PyResult<Simulation> {
        // Those are recorded for pictures, which is not the reason.
        let is_in_python = self.setup.is_some();
        let run = if is_in_python { Err(ForkError::Family("a protocol in Python")) } else { self.run.fork() };
        let run = run.map_err(|error| PyValueError::new_err(error.to_string()))?;
        Ok(Simulation { run, events: self.events, over: self.over, setup: None, shown: None })
    }
    /// Gives the run other random numbers from now on: of `kind` `links` or `all`, selected by `number`. Returns the change.
    fn change(&mut self, kind: &str, number: u64) -> PyResult<String> {
        let kind = match kind {
            "links" => ChangeKind::Links(number),
            "all" => ChangeKind::All(number),
            _ => {
                return Err(PyValueError::new_err(format!(
                    "`{kind}` is no kind of stream; write links or all"
                )));
            }
        };
        Ok(self.run.change(kind).to_string())
    }
    /// Returns the objects of living modules by number; `None` if the protocol is not one in Python.
    fn objects(&self, py: Python<'_>) -> Option<Py<PyDict>> {
        self.setup.as_ref().map(|setup| setup.modules.clone_ref(py))
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
    /// Draws the run so far, as `render` does: a file of this format, with options as the query of an address. `None` if the
    /// protocol is not one in Python.
    fn render<'py>(
        &self,
        py: Python<'py>,
        format: &str,
        query: &str,
    ) -> PyResult<Option<Bound<'py, PyBytes>>> {
        let Some((subject, scene)) = &self.shown else { return Ok(None) };
        let kind = Kind::of_extension(format);
        let kind = kind.ok_or_else(|| PyValueError::new_err(format!("there is no format `{format}`")))?;
        scene.lock().reach(self.run.now());
        let drawn = subject.draw(scene, kind, query, &|| true).map_err(PyValueError::new_err)?;
        Ok(Some(PyBytes::new(py, &drawn.data)))
    }
    /// Returns the report so far as JSON.
    fn report(&self, py: Python<'_>) -> PyResult<String> {
        let report = self.run.report();
        self.check(py)?;
        json(&report)
    }
}

impl Simulation {
    fn check(&self, py: Python<'_>) -> PyResult<()> {
        self.setup.as_ref().map_or(Ok(()), |setup| setup.spec.check(py))
    }

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
