//! Scenarios that were read and checked.

use crate::protocol::family::PySwarm;
use crate::protocol::{Protocol, Setup};
use crate::raised::raise;
use metamorph_world_controller::family::{self, read_text};
use metamorph_world_controller::scenario::diagnostics::{Diagnostics, Place};
use metamorph_world_controller::scenario::error::ScenarioError;
use metamorph_world_controller::scenario::plan_summary::overview;
use metamorph_world_controller::scenario::settings::Setting;
use metamorph_world_controller::scenario::{self, LinkKind, Overrides};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::Arc;

fn invalid(py: Python<'_>, diagnostics: &Diagnostics, text: &str) -> PyErr {
    let problems = diagnostics.list().iter().map(|problem| {
        let (place, line, column) = match &problem.place {
            Place::File => ("file".to_owned(), None, None),
            Place::Option(option) => (option.clone(), None, None),
            Place::Text { start, .. } => {
                let before = text.get(..*start).unwrap_or(text);
                let line = before.matches('\n').count() + 1;
                let column = before.rsplit('\n').next().unwrap_or_default().chars().count() + 1;
                (format!("line {line}"), Some(line), Some(column))
            }
        };
        (place, line, column, problem.scenario_error.to_string(), problem.scenario_error.fix())
    });
    let problems = problems.collect::<Vec<_>>();
    raise(py, "ScenarioError", (diagnostics.to_string(), problems))
}

/// Returns the overrides of a simulated run with faults such as `kill 7@2s` and changes such as `change links=17@48213`.
/// Python has checked their verbs.
pub fn with_faults(faults: &[String]) -> Overrides {
    let mut overrides = Overrides { link: LinkKind::Sim, ..Overrides::default() };
    for (verb, target) in faults.iter().filter_map(|fault| fault.split_once(' ')) {
        let of_verb = match verb {
            "kill" => &mut overrides.kill,
            "pause" => &mut overrides.pause,
            "restart" => &mut overrides.restart,
            "change" => &mut overrides.change,
            _ => &mut overrides.partition,
        };
        of_verb.push(target.trim().to_owned());
    }
    overrides
}

/// A scenario with a seed, checked.
#[pyclass(frozen, module = "metamorph._metamorph")]
pub struct Plan {
    pub plan: scenario::Plan,
}

#[pymethods]
impl Plan {
    /// Reads the text of a scenario; `origin` names it in errors, and shapes are read from files beside it.
    /// `settings` are `KEY=VALUE`, `faults` such as `kill 7@2s`; `protocol` is that of a scenario of the family `python`.
    #[new]
    #[pyo3(signature = (origin, text, settings, faults, seed, protocol))]
    fn new(
        py: Python<'_>,
        origin: &str,
        text: &str,
        settings: Vec<String>,
        faults: Vec<String>,
        seed: Option<u64>,
        protocol: Option<&Protocol>,
    ) -> PyResult<Plan> {
        // The interpreter is held until the text is read.
        let _reading = protocol.map(|protocol| protocol.spec.reading());
        let settings = settings.into_iter().map(|text| Setting { option: "set", text }).collect();
        let overrides = Overrides { settings, seed, ..with_faults(&faults) };
        let read = read_text(origin, text, &overrides);
        protocol.map_or(Ok(()), |protocol| protocol.spec.check(py))?;
        match read {
            Ok(plan) => Ok(Plan { plan }),
            Err(diagnostics) => Err(invalid(py, &diagnostics, text)),
        }
    }
    /// Returns the same with another seed.
    fn with_seed(&self, seed: u64) -> PyResult<Plan> {
        let drawn = self.plan.with_seed(seed);
        let error = |e: ScenarioError| PyValueError::new_err(format!("{e}; {}", e.fix()));
        Ok(Plan { plan: drawn.map_err(error)? })
    }
    #[getter]
    fn title(&self) -> String {
        self.plan.title()
    }
    #[getter]
    fn family(&self) -> &'static str {
        self.plan.swarm.family()
    }
    #[getter]
    fn seed(&self) -> u64 {
        self.plan.seed
    }
    #[getter]
    fn modules(&self) -> usize {
        self.plan.swarm.len()
    }
    /// Returns what `metamorph check` prints.
    fn check(&self) -> String {
        overview(&self.plan)
    }
}

impl Plan {
    /// Returns what the agents share, if the scenario is for a protocol in Python.
    pub fn setup(&self) -> Option<Arc<Setup>> {
        self.plan.swarm.of::<PySwarm>().map(|swarm| Arc::clone(&swarm.setup))
    }
}

/// Reads a file, or a scenario that ships, as the command does. Returns how it is called in messages, and its text.
#[pyfunction]
pub fn load(py: Python<'_>, path: PathBuf) -> PyResult<(String, String)> {
    let loaded =
        scenario::load(family::sources(), &path).map_err(|diagnostics| invalid(py, &diagnostics, ""))?;
    Ok((loaded.origin, loaded.text))
}

/// Returns the names and texts of the scenarios that ship.
#[pyfunction]
pub fn shipped() -> Vec<(&'static str, &'static str)> {
    scenario::shipped::names().map(|n| (n, scenario::shipped::text(n).unwrap_or_default())).collect()
}
