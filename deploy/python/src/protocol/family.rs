//! The family of protocols in Python: its part of scenarios, and its runs.

use super::agent::PyAgent;
use super::bodies::{Check, PyBodies};
use super::director::PyDirector;
use super::setup::{Setup, Value, wrong};
use super::spec::Spec;
use metamorph_protocol::agent::Agent as _;
use metamorph_protocol::defects::Defect;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::shape::Shape;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::cube::audit::audit_every;
use metamorph_sim_bridge::cube::world::CubeWorld;
use metamorph_sim_bridge::director::port::DirectorPort as _;
use metamorph_sim_bridge::director::progress::Progress;
use metamorph_sim_bridge::director::standstills::Standstills;
use metamorph_sim_bridge::world::contact_graph::ContactGraph;
use metamorph_sim_bridge::world::invariants::{Invariant, Violation};
use metamorph_world_controller::family::generated::{Dice, GeneratedSwarm};
use metamorph_world_controller::family::graphs::contacts::{self, Contacts};
use metamorph_world_controller::family::{ExploredFamily, FamilyParts, cube};
use metamorph_world_controller::report::family_part::{FamilyPart, FamilyText};
use metamorph_world_controller::report::run_result::RunResult;
use metamorph_world_controller::run::runnable::{Runnable, stage};
use metamorph_world_controller::scenario::Plan;
use metamorph_world_controller::scenario::bounds::Bounds;
use metamorph_world_controller::scenario::definitions::{of, or, said, seldom, table};
use metamorph_world_controller::scenario::diagnostics::{At, Diagnostics, Place};
use metamorph_world_controller::scenario::error::ScenarioError;
use metamorph_world_controller::scenario::family::{
    DraftContext, FamilySchema, FamilySpec, Patience, RawSwarm, ScenarioFamily, Sections, Swarm, SwarmPlan,
    Words,
};
use metamorph_world_controller::scenario::plan::BEAT;
use metamorph_world_controller::scenario::raw::protocol_section;
use metamorph_world_controller::scenario::shapes::{KINDS, Layout, check_box};
use metamorph_world_controller::scenario::table::Section;
use pyo3::prelude::*;
use serde_json::json;
use std::fmt::{self, Write};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use toml::de::DeValue;

/// The name of the family.
pub const NAME: &str = "python";
/// The name of the invariants that come with a call.
const OF_PROTOCOL: Invariant = Invariant::new("of-protocol");
/// Default time without progress after which a run counts as a standstill.
const STALL: Span = Span::secs(60);
const START: &str = "start = { box = { min = [0, 0, 0], max = [5, 5, 0] } }";
const PARAMETER: &str = "repeat = \"500ms\"";

/// The family.
pub struct PythonFamily;

/// The parts as written.
#[derive(Debug)]
struct RawPython {
    start: Option<At<Shape>>,
    /// The graph of contacts, of modules that do not move.
    contacts: Option<At<Contacts>>,
    move_time: Option<At<Span>>,
    parameters: Vec<(String, At<Value>)>,
    spec: Option<Arc<Spec>>,
}

/// Which bodies modules have.
#[derive(Clone, Debug)]
enum Placed {
    /// Cubes in these cells.
    Cubes(Arc<[Cell]>),
    /// Bodies that do not move, with a graph of contacts.
    Graph(Contacts, Arc<ContactGraph>),
}

/// Modules with a protocol in Python.
#[derive(Debug)]
pub struct PySwarm {
    placed: Placed,
    pub setup: Arc<Setup>,
}

fn problem(reason: impl Into<String>, fix: impl Into<String>) -> ScenarioError {
    ScenarioError::OfFamily { reason: reason.into(), fix: fix.into() }
}

fn parameters(others: &Sections<'_, '_>, diagnostics: &mut Diagnostics) -> Vec<(String, At<Value>)> {
    let is_table = protocol_section(others.protocol, PARAMETER, diagnostics).is_some();
    let Some(DeValue::Table(table)) = others.protocol.filter(|_| is_table).map(|node| node.get_ref()) else {
        return Vec::new();
    };
    let mut found = Vec::new();
    for (key, node) in table.iter() {
        let value = match node.get_ref() {
            DeValue::String(text) => Some(Value::Text(text.to_string())),
            DeValue::Integer(number) => {
                i64::from_str_radix(number.as_str(), number.radix()).ok().map(Value::Number)
            }
            DeValue::Boolean(flag) => Some(Value::Flag(*flag)),
            _ => None,
        };
        match value {
            Some(value) => found.push((key.get_ref().to_string(), At::new(value, node.span()))),
            None => diagnostics.add(
                node.span(),
                problem(
                    "a parameter is a text, a whole number or a flag",
                    format!("write for example `{PARAMETER}`"),
                ),
            ),
        }
    }
    found
}

impl ScenarioFamily for PythonFamily {
    fn name(&self) -> &'static str {
        NAME
    }
    fn needs_goal(&self) -> bool {
        false
    }
    fn read(
        &self,
        mut swarm: Section<'_, '_>,
        others: &Sections<'_, '_>,
        diagnostics: &mut Diagnostics,
    ) -> Box<dyn RawSwarm> {
        let has_graph = !swarm.present(&["graph"]).is_empty();
        if has_graph && !swarm.present(&["start"]).is_empty() {
            let reason = "[swarm] has both `start` and `graph`";
            diagnostics
                .add(swarm.place().clone(), problem(reason, "keep one: cubes, or a graph of contacts"));
        }
        let contacts = has_graph.then(|| contacts::read(&mut swarm, diagnostics)).flatten();
        let start =
            if has_graph { swarm.get("start", diagnostics) } else { swarm.need("start", START, diagnostics) };
        let move_time = swarm.get("move_time", diagnostics);
        swarm.finish(diagnostics);
        let parameters = parameters(others, diagnostics);
        Box::new(RawPython { start, contacts, move_time, parameters, spec: Spec::read() })
    }
    fn schema(&self) -> FamilySchema {
        FamilySchema {
            swarm: table(
                "Cubes, or modules that do not move, with a protocol written in Python.",
                &[],
                json!({
                    "family": { "const": NAME },
                    "start": said("The cells of the cubes at the start; or `graph`.", of("shape")),
                    "graph": Contacts::schema(),
                    "move_time": said("How long a move takes.", or(BEAT.to_string(), of("time"))),
                    "failed_connections": seldom("How often a move fails."),
                }),
            ),
            goal: table("There are none.", &[], json!({})),
            protocol: table("The parameters of the class.", &[], json!({})),
            shapes: &KINDS,
            definitions: Vec::new(),
        }
    }
}

impl RawPython {
    fn setup(&self, move_time: Span, diagnostics: &mut Diagnostics) -> Option<Setup> {
        let Some(spec) = &self.spec else {
            let reason = "the scenario is for a protocol written in Python, and none is given";
            let fix = "pass the class: `metamorph.run(scenario, protocol=...)`";
            diagnostics.add(Place::File, problem(reason, fix));
            return None;
        };
        let setup = Python::attach(|py| {
            let (mut values, mut is_right) = (Vec::new(), true);
            for (name, At { value, place }) in &self.parameters {
                let found = if spec.is_stand_in { None } else { wrong(py, spec, name, value)? };
                match found {
                    None => values.push((name.clone(), value.clone())),
                    Some((reason, fix)) => {
                        diagnostics.add(place.clone(), problem(reason, fix));
                        is_right = false;
                    }
                }
            }
            is_right.then(|| Setup::new(py, spec, values, move_time)).transpose()
        });
        setup.unwrap_or_else(|error| {
            spec.fail(error, None, Time::ZERO, "the class");
            None
        })
    }
}

impl RawSwarm for RawPython {
    fn time_step(&self) -> (&Option<At<Span>>, &'static str) {
        (&self.move_time, "move_time")
    }
    fn draft(&self, context: &DraftContext, diagnostics: &mut Diagnostics) -> Option<FamilySpec> {
        let placed = match &self.contacts {
            Some(At { value, place }) => {
                let graph = diagnostics.note(place, value.graph(PyAgent::PORTS, context.seed));
                graph.map(|graph| Placed::Graph(value.clone(), Arc::new(graph)))
            }
            None => {
                let mut layout = Layout::default();
                let cells = self.start.as_ref().and_then(|start| layout.start(start, diagnostics));
                check_box(cells.iter().flatten(), diagnostics)?;
                cells.map(|cells| Placed::Cubes(cells.into()))
            }
        };
        let setup = self.setup(context.time_step, diagnostics);
        let modules = placed.as_ref().map_or(0, |placed| placed.cells().len());
        let swarm = placed.zip(setup).map(|(placed, setup)| PySwarm { placed, setup: Arc::new(setup) });
        Some(FamilySpec {
            swarm: swarm.map(Swarm::new),
            modules,
            start_within: None,
            goals: vec!["until".to_owned()],
            patience: Patience { bounds: Bounds { stall: STALL, more_tries: 0 }, livelock: 1, timeout: 10 },
        })
    }
}

impl Placed {
    fn cells(&self) -> &[Cell] {
        match self {
            Placed::Cubes(cells) => cells,
            Placed::Graph(_, graph) => graph.cells(),
        }
    }
    /// Returns the same for another seed.
    fn with_seed(&self, seed: u64) -> Result<Placed, ScenarioError> {
        Ok(match self {
            Placed::Graph(contacts, _) if contacts.is_drawn() => {
                Placed::Graph(contacts.clone(), Arc::new(contacts.graph(PyAgent::PORTS, seed)?))
            }
            same => same.clone(),
        })
    }
}

impl SwarmPlan for PySwarm {
    fn family(&self) -> &'static str {
        NAME
    }
    fn modules(&self) -> usize {
        self.placed.cells().len()
    }
    fn protocol(&self) -> String {
        Python::attach(|py| {
            let name = self.setup.class.bind(py).name();
            name.map_or_else(|_| NAME.to_owned(), |name| name.to_string())
        })
    }
    /// Returns modules without a past: what they share belongs to one run.
    fn with_seed(&self, seed: u64) -> Result<Option<Swarm>, ScenarioError> {
        let setup = self.setup.again();
        let setup = setup.map_err(|e| problem(e.to_string(), "correct the class"))?;
        let placed = self.placed.with_seed(seed)?;
        Ok(Some(Swarm::new(PySwarm { placed, setup: Arc::new(setup) })))
    }
    fn defect(&self) -> Option<Defect> {
        None
    }
    fn with_defect(&self, _: Option<Defect>) -> Swarm {
        Swarm::new(PySwarm { placed: self.placed.clone(), setup: Arc::clone(&self.setup) })
    }
    fn describe(&self, _: &Plan, out: &mut String) -> fmt::Result {
        writeln!(
            out,
            "  swarm     {} modules with the protocol {}",
            self.placed.cells().len(),
            self.protocol()
        )
    }
    fn words(&self) -> &'static Words {
        &Words {
            module: "module",
            modules: "modules",
            cell: "goal",
            part: "goal",
            cells: "goals",
            filled: "reached",
            collisions: Some(["nothing", "the body"]),
            idle: "is alive",
            time_step: "move time",
            action: "move",
        }
    }
}

impl PySwarm {
    /// Returns how often each of the given invariants was called.
    fn invariant_calls(&self) -> Option<FamilyPart> {
        let invariants = &self.setup.spec.invariants;
        let calls = self.setup.calls.iter().map(|calls| calls.load(Ordering::Relaxed));
        let calls: Vec<_> = invariants
            .iter()
            .zip(calls)
            .map(|((name, _), calls)| json!({ "name": name, "calls": calls }))
            .collect();
        (!calls.is_empty()).then(|| FamilyPart {
            key: "protocol",
            value: json!({ "invariants": calls }),
            text: FamilyText::default(),
        })
    }

    /// Returns a check for each of the given invariants.
    fn checks(&self) -> Vec<(Invariant, Check)> {
        let numbers = 0..self.setup.spec.invariants.len();
        numbers.map(|i| (OF_PROTOCOL, self.check(i))).collect()
    }

    fn check(&self, number: usize) -> Check {
        let setup = Arc::clone(&self.setup);
        Box::new(move |now| {
            let (name, holds) = &setup.spec.invariants[number];
            if setup.spec.has_failed() {
                return Ok(());
            }
            setup.calls[number].fetch_add(1, Ordering::Relaxed);
            let said = Python::attach(|py| {
                let said = holds.bind(py).call1((&setup.modules, now.as_secs_f64()))?;
                said.extract::<Option<String>>()
            });
            match said {
                Ok(None) => Ok(()),
                Ok(Some(what)) => Err(format!("{name}: {what}")),
                Err(error) => {
                    setup.spec.fail(error, None, now, name.as_str());
                    Ok(())
                }
            }
        })
    }
}

impl Runnable for PySwarm {
    type World = PyBodies;
    type Director = PyDirector;

    fn setup(&self) -> &Arc<Setup> {
        &self.setup
    }
    fn world(&self, plan: &Plan) -> PyBodies {
        let only_at_audits = self.setup.spec.every.is_some();
        match &self.placed {
            Placed::Cubes(cells) => {
                let mut cubes = CubeWorld::new(cells, self.time_step(), plan.seed);
                cubes.set_failure(plan.failure);
                PyBodies::of_cubes(cubes, self.checks(), only_at_audits)
            }
            Placed::Graph(_, graph) => PyBodies::of_graph(graph, self.checks(), only_at_audits),
        }
    }
    fn director(&self, plan: &Plan) -> PyDirector {
        PyDirector::new(&self.setup, self.placed.cells().len(), plan.schedule.clone(), plan.stop)
    }
    fn time_step(&self) -> Span {
        self.setup.move_time
    }
    fn audit_every(&self) -> Span {
        self.setup.spec.every.unwrap_or(audit_every(self.time_step()))
    }
    fn progress(director: &PyDirector) -> Progress {
        director.progress()
    }
    fn account(&self, plan: &Plan, director: &PyDirector, world: &PyBodies) -> RunResult {
        let (crashed, restarted) = director.crashed_and_restarted();
        let motions = world.cubes().map(CubeWorld::motions).unwrap_or_default();
        RunResult {
            ended: director.ended(),
            progress: Progress { moves: motions.completed, ..director.progress() },
            crashed,
            restarted,
            stall: director.stall().cloned(),
            standstills: Standstills::default(),
            snapshot: None,
            struck: director.struck().to_vec(),
            prevented: 0,
            stages: plan.stages.iter().map(|plan| stage(&plan.name, &director.stage())).collect(),
            bodies: cube::move_report(&motions),
            moves: motions.completed,
            operator: None,
            family_part: self.invariant_calls(),
        }
    }
    fn last_check(world: &mut PyBodies, now: Time) -> (Vec<Violation>, u64) {
        let checked = world.cubes_mut().map(|cubes| {
            cubes.check_connected(now);
            (cubes.take_violations(), 1)
        });
        checked.unwrap_or_default()
    }
}

/// Exploration draws scenarios of built-in families only; what this one draws are cubes.
impl ExploredFamily for PythonFamily {
    fn generate(&self, dice: &mut Dice) -> Box<dyn GeneratedSwarm> {
        cube::CubeFamily.generate(dice)
    }
    fn smallest(&self) -> Box<dyn GeneratedSwarm> {
        cube::CubeFamily.smallest()
    }
    fn patience(&self, _: bool, _: u64) -> Option<(u64, u64)> {
        None
    }
    fn shrinking(&self) -> u64 {
        0
    }
}

impl FamilyParts for PythonFamily {
    type Swarm = PySwarm;

    fn places(&self, swarm: &PySwarm) -> Vec<Cell> {
        swarm.placed.cells().to_vec()
    }
    fn drawn_contacts(&self, swarm: &PySwarm) -> Vec<(ModuleId, ModuleId)> {
        match &swarm.placed {
            Placed::Cubes(_) => Vec::new(),
            Placed::Graph(_, graph) => graph.pairs(),
        }
    }
}
