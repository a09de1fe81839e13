//! One scenario with many seeds and varied values, on several threads.

use crate::protocol::Protocol;
use crate::protocol::spec::Spec;
use crate::raised::raise;
use crate::scenario::with_faults;
use metamorph_world_controller::console::interrupt::Interrupt;
use metamorph_world_controller::console::stopwatch::Stopwatch;
use metamorph_world_controller::experiments::sweep::grid::{Axis, Grid, Part, Seeds};
use metamorph_world_controller::experiments::sweep::pool::{self, News, Work};
use metamorph_world_controller::experiments::sweep::row::{self, Row};
use metamorph_world_controller::experiments::sweep::{Scenario, SweepError};
use pyo3::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::time::Duration;

/// Time between two looks for signals, and two calls of `progress`.
const PAUSE: Duration = Duration::from_millis(100);

fn grid(py: Python<'_>, seeds: (u64, u64), vary: Vec<(String, Vec<String>)>) -> PyResult<Grid> {
    let vary = vary.into_iter().map(|(key, values)| Axis { key, values }).collect();
    Grid::new(Seeds { from: seeds.0, until: seeds.1 }, vary).map_err(|e| failed(py, &SweepError::Grid(e)))
}

fn failed(py: Python<'_>, e: &SweepError) -> PyErr {
    raise(py, "SweepError", (e.to_string(),))
}

/// Returns the manifest of a sweep, as it is in the directory of `metamorph sweep --out`.
#[pyfunction]
pub fn manifest(
    py: Python<'_>,
    origin: String,
    text: String,
    faults: Vec<String>,
    seeds: (u64, u64),
    vary: Vec<(String, Vec<String>)>,
) -> PyResult<String> {
    let scenario = Scenario { origin, text, overrides: with_faults(&faults) };
    Ok(scenario.manifest(&grid(py, seeds, vary)?).text())
}

/// Simulates every combination with every seed, and returns the runs as `runs.csv` has them. `vary` are the keys and
/// their values, `progress` is called with the numbers of runs done and to do, at most ten times a second. With a
/// `protocol`, this must be the only work of the process.
#[pyfunction]
#[pyo3(signature = (origin, text, faults, seeds, vary, jobs, progress, protocol))]
#[allow(clippy::too_many_arguments, reason = "called from one place in Python")]
pub fn sweep(
    py: Python<'_>,
    origin: String,
    text: String,
    faults: Vec<String>,
    seeds: (u64, u64),
    vary: Vec<(String, Vec<String>)>,
    jobs: NonZeroUsize,
    progress: Option<Py<PyAny>>,
    protocol: Option<&Protocol>,
) -> PyResult<String> {
    let grid = grid(py, seeds, vary)?;
    let scenario = Scenario { origin, text, overrides: with_faults(&faults) };
    let spec = protocol.map(|protocol| Arc::clone(&protocol.spec));
    let _reading = spec.as_ref().map(Spec::reading);
    let check = |py: Python<'_>| spec.as_ref().map_or(Ok(()), |spec| spec.check(py));
    let checked = scenario.check(&grid);
    check(py)?;
    checked.map_err(|e| failed(py, &e))?;
    let interrupt = Interrupt::default();
    let rows = py.detach(|| {
        let none = BTreeSet::new();
        let work = Work {
            scenario: &scenario,
            grid: &grid,
            part: Part::WHOLE,
            first: 0,
            done: &none,
            jobs,
            interrupt: &interrupt,
        };
        let mut rows: BTreeMap<u64, Box<Row>> = BTreeMap::new();
        let mut told = Stopwatch::start();
        let end = pool::run(work, |news| {
            let error = match news {
                News::Row(run, row) => {
                    rows.insert(run, row);
                    None
                }
                News::Defect(run) => Some(SweepError::Defect(scenario.repeat(&grid, run))),
                News::NoStart(run, error) => {
                    Some(SweepError::NoStart { repeat: scenario.repeat(&grid, run), error: Box::new(error) })
                }
                News::Nothing => None,
            };
            let tell = told.elapsed() >= PAUSE || error.is_some();
            if !tell {
                return Ok(());
            }
            told = Stopwatch::start();
            let result = Python::attach(|py| {
                py.check_signals()?;
                check(py)?;
                if let Some(progress) = &progress {
                    progress.call1(py, (rows.len(), grid.runs()))?;
                }
                error.map_or(Ok(()), |e| Err(failed(py, &e)))
            });
            if result.is_err() {
                interrupt.request();
            }
            result
        });
        end.map(|()| rows)
    })?;
    check(py)?;
    let mut out = csv::WriterBuilder::new().has_headers(false).from_writer(Vec::new());
    let written = row::write_header(&mut out, &grid)
        .and_then(|()| rows.iter().try_for_each(|(run, row)| row::write(&mut out, &grid, *run, row)));
    let text =
        written.ok().and_then(|()| out.into_inner().ok()).and_then(|bytes| String::from_utf8(bytes).ok());
    Ok(text.expect("invariant: rows are written to memory as text"))
}
