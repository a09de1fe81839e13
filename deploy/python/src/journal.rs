//! A journal, read once: what happened, and where the modules were.

use crate::protocol::Protocol;
use crate::protocol::family::PySwarm;
use crate::protocol::spec::{Spec, showing};
use crate::raised::raise;
use metamorph_protocol::counters::Class;
use metamorph_protocol::time::Time;
use metamorph_world_controller::family::{self, of};
use metamorph_world_controller::record::journal::{Consumed, Event as Recorded, Journal as File};
use metamorph_world_controller::report::message_timeline::Bin;
use metamorph_world_controller::run::replay::Request;
use metamorph_world_controller::scenario::Plan;
use metamorph_world_controller::view::export::csv::{Figures, ModuleFigures};
use metamorph_world_controller::view::figure::snapshot::{Body, Playback, Process};
use metamorph_world_controller::view::scene::{Event, Scene};
use metamorph_world_controller::view::visible::GoalView;
use pyo3::prelude::*;
use pyo3::types::PyBytes;
use std::fmt::Display;
use std::path::PathBuf;
use std::sync::Arc;

/// Code of a module whose state is unknown. The codes of roles are 1 to 3.
const UNKNOWN: u8 = 0;
/// Code of a paused module.
const PAUSED: u8 = 4;
/// Code of a dead module.
const DEAD: u8 = 5;

/// An event: time in nanoseconds, name, module, and a description.
type Row = (u64, &'static str, Option<u32>, String);

/// The figures of a module.
type ModuleRow = ([u64; 4], [u64; Class::ALL.len()], [u64; Class::ALL.len()], u64, [Option<u64>; 2]);

/// Why a run with a protocol in Python cannot be carried out again.
const NO_PROTOCOL: &str =
    "the protocol of this run is written in Python; name it: Journal(path, protocol=..., until=...)";

/// A journal.
#[pyclass(frozen, module = "metamorph._metamorph")]
pub struct Journal {
    file: PathBuf,
    plan: Plan,
    scene: Scene,
    /// The protocol, if it is one in Python that was named.
    protocol: Option<Arc<Spec>>,
}

fn failed(py: Python<'_>, error: &impl Display) -> PyErr {
    raise(py, "JournalError", (error.to_string(),))
}

#[pymethods]
impl Journal {
    /// Reads a journal; a damaged one is an error. `protocol` is that of a run of the family `python`.
    #[new]
    #[pyo3(signature = (path, protocol))]
    fn new(py: Python<'_>, path: PathBuf, protocol: Option<&Protocol>) -> PyResult<Journal> {
        let protocol = protocol.map(|protocol| Arc::clone(&protocol.spec));
        let recorded = match &protocol {
            Some(spec) => {
                // The interpreter is held until the scenario is read.
                let _reading = spec.reading();
                let recorded = family::recorded(&path);
                spec.check(py)?;
                recorded
            }
            None => py.detach(|| showing(|| family::recorded(&path))),
        };
        let family::Recorded { plan, scene, damage } = recorded.map_err(|e| failed(py, &e))?;
        damage.map_or(Ok(()), |damage| Err(failed(py, &damage)))?;
        Ok(Journal { file: path, plan, scene, protocol })
    }
    #[getter]
    fn family(&self) -> &'static str {
        self.plan.swarm.family()
    }
    #[getter]
    fn modules(&self) -> usize {
        self.plan.swarm.len()
    }
    #[getter]
    fn duration_ns(&self) -> u64 {
        self.scene.now().0
    }
    /// The names of states, by number.
    #[getter]
    fn state_names(&self) -> Vec<&'static str> {
        let roles = of(&self.plan).shown(&self.plan).words().roles.map(|role| role.name);
        [&["unknown"][..], &roles, &["paused", "dead"]].concat()
    }
    /// Returns what happened.
    fn events(&self) -> Vec<Row> {
        let roles = of(&self.plan).shown(&self.plan).words().roles;
        let row = |(at, event): &(Time, Event)| {
            let (name, module, text) = match event {
                Event::Motion(_) => return None,
                Event::Does(id, _, to) => ("moves", Some(*id), to.clone()),
                Event::Failed(id, why) => ("failed", Some(*id), (*why).to_owned()),
                Event::Refused(id) => ("refused", Some(*id), String::new()),
                Event::Tells(id, view) => {
                    let role = roles.get(usize::from(view.role)).map_or("", |role| role.name);
                    ("reports", Some(*id), role.to_owned())
                }
                Event::Died(id) => ("died", Some(*id), String::new()),
                Event::Started(id) => ("restarted", Some(*id), String::new()),
                Event::Paused(id) => ("paused", Some(*id), String::new()),
                Event::Resumed(id) => ("resumed", Some(*id), String::new()),
                Event::Injected(id, fault, effect) => ("fault", *id, format!("{fault}: {effect}")),
                Event::Obstacles(cells) => ("obstacles", None, format!("{cells:?}")),
                Event::Elements(all) => ("elements", None, format!("{all:?}")),
                Event::Goal(goal) if goal.number == GoalView::NONE => ("goal", None, "none".to_owned()),
                Event::Goal(goal) => ("goal", None, goal.number.to_string()),
            };
            Some((at.0, name, module.map(|id| id.0), text))
        };
        self.scene.events().iter().filter_map(row).collect()
    }
    /// Returns how many messages of each class were delivered in each span of `bin_ns`.
    fn messages(&self, py: Python<'_>, bin_ns: u64) -> PyResult<Vec<[u64; Class::ALL.len()]>> {
        let mut bins = vec![[0; Class::ALL.len()]; (self.scene.now().0 / bin_ns.max(1)) as usize + 1];
        let counted = py.detach(|| {
            for record in File::open(&self.file).map_err(|e| e.to_string())? {
                let record = record.map_err(|e| e.to_string())?;
                if let Recorded::Step(step) = &record.event
                    && let Consumed::Message { class, .. } = step.input
                    // Agents of a run of processes may be slightly ahead of the controller's records.
                    && let Some(bin) = bins.get_mut((record.at.0.min(self.scene.now().0) / bin_ns.max(1)) as usize)
                {
                    bin[class.index()] += 1;
                }
            }
            Ok::<_, String>(())
        });
        counted.map_err(|e| failed(py, &e))?;
        Ok(bins)
    }
    /// Returns the width of the time bins in nanoseconds, and of each the filled cells of the goal, all of them, the moves,
    /// and the messages delivered by class.
    fn bins(&self) -> (u64, Vec<Vec<u64>>) {
        let (width, bins) = self.scene.bins();
        let row = |bin: &Bin| [&[bin.filled, bin.goal, bin.moves][..], &bin.totals].concat();
        (width.0, bins.iter().map(row).collect())
    }
    /// Returns of each module its actions begun, failed and refused, the deaths of its process, its messages sent and
    /// received, the bytes received, and two quantiles of latency in nanoseconds.
    fn per_module(&self, py: Python<'_>) -> PyResult<Vec<ModuleRow>> {
        let figures = py.detach(|| Figures::read(&self.file, &self.scene)).map_err(|e| failed(py, &e))?;
        let row = |m: &ModuleFigures| {
            let quantile = |per_mille| m.latency.quantile(per_mille).map(|span| span.0);
            let counts = [m.actions, m.failed, m.refused, m.deaths];
            (counts, m.sent, m.received, m.received_bytes, [quantile(500), quantile(990)])
        };
        Ok(figures.modules.iter().map(row).collect())
    }
    /// Returns the cells of all modules at these times, in ascending order: three numbers of 16 bits each, in the byte
    /// order of the machine.
    fn positions<'py>(&self, py: Python<'py>, times: Vec<u64>) -> Bound<'py, PyBytes> {
        let bytes = self.at(&times, |body, bytes| {
            let cell = body.parts.first().map(|part| part.cell()).unwrap_or_default();
            bytes.extend([cell.x, cell.y, cell.z].iter().flat_map(|c| c.to_ne_bytes()));
        });
        PyBytes::new(py, &bytes)
    }
    /// Returns the numbers of the states of all modules at these times, in ascending order.
    fn states<'py>(&self, py: Python<'py>, times: Vec<u64>) -> Bound<'py, PyBytes> {
        let state = |body: &Body| match (body.process, body.view) {
            (Process::Dead, _) => DEAD,
            (Process::Paused, _) => PAUSED,
            (Process::Alive, None) => UNKNOWN,
            (Process::Alive, Some(view)) => view.role + 1,
        };
        PyBytes::new(py, &self.at(&times, |body, bytes| bytes.push(state(body))))
    }
    /// Carries the run out again. Returns the first difference from the journal.
    fn verify(&self, py: Python<'_>) -> PyResult<Option<String>> {
        let request = Request { file: self.file.clone(), until: None, agent: None };
        let replay = || family::replay(&request).map(|(_, replayed)| replayed);
        let replayed = match &self.protocol {
            Some(spec) => {
                let _reading = spec.reading();
                let replayed = replay();
                spec.check(py)?;
                replayed
            }
            None if self.plan.swarm.of::<PySwarm>().is_some() => return Err(failed(py, &NO_PROTOCOL)),
            None => py.detach(replay),
        };
        let replayed = replayed.map_err(|e| failed(py, &e))?;
        Ok(replayed.difference.map(|d| format!("record {} at {}: {}", d.number, d.at, d.what)))
    }
}

impl Journal {
    fn at(&self, times: &[u64], mut write: impl FnMut(&Body, &mut Vec<u8>)) -> Vec<u8> {
        let (swarm, mut bytes) = (of(&self.plan).shown(&self.plan), Vec::new());
        let mut playback = Playback::new(&self.scene, &*swarm);
        for at in times {
            playback.advance(Time(*at)).bodies.iter().for_each(|body| write(body, &mut bytes));
        }
        bytes
    }
}
