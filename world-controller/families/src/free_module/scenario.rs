//! The parts of a scenario that only free modules have: start, goal and joint values, and how plans are made.

use super::FreeModules;
use super::bounds::bounds;
use super::error::FreeModuleError;
use super::walking::{self, RawWalk};
use crate::connection::{self, RawConnection};
use metamorph_free_modules::plan::input::{Structured, structured};
use metamorph_protocol::assembly::action::Connectors;
use metamorph_protocol::assembly::collision::Model;
use metamorph_protocol::assembly::configuration::Configuration;
use metamorph_protocol::assembly::named;
use metamorph_protocol::assembly::space::{Goal, Objective};
use metamorph_protocol::free_module::reconfiguration::LatticeSetup;
use metamorph_protocol::free_module::reconfiguration::planning::Planner;
use metamorph_protocol::plan::Limits;
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::roombots::posture::Posture;
use metamorph_protocol::time::Span;
use metamorph_scenario::diagnostics::{At, Diagnostics, Place};
use metamorph_scenario::error::ScenarioError;
use metamorph_scenario::family::{DraftContext, FamilySpec, Patience, RawSwarm, Sections, Swarm};
use metamorph_scenario::raw::{goal_sections, protocol_section};
use metamorph_scenario::table::{Node, Read, Section, elements, wrong};
use std::sync::Arc;

/// The body on the lattice.
pub const BODY: &str = "lattice";
/// The only strategy.
pub const STRATEGY: &str = "planned";
/// Collision models of a turn by name, the default first. They differ in how close a turn may come to other bodies.
pub const COLLISIONS: [(&str, Model); 3] =
    [("strict", Model::Strict), ("core", Model::Core), ("final", Model::Final)];
/// Which connectors can connect, the default first.
pub const CONNECTORS: [(&str, Connectors); 2] = [("all", Connectors::All), ("active", Connectors::Active)];
/// Cost functions of a plan by name, the default first.
pub const OBJECTIVES: [(&str, Objective); 4] = [
    ("actions", Objective::Actions),
    ("connections", Objective::Connections),
    ("turns", Objective::Turns),
    ("moves", Objective::Moves),
];
/// Default factor of the least cost within which a plan is good enough.
pub const WEIGHT: f64 = 1.0;
/// The largest factor.
pub const MAX_WEIGHT: f64 = 100.0;
/// Default number of expansions of one plan.
pub const WORK: u64 = 20_000;
/// The largest number of expansions of one plan.
pub const MAX_WORK: u64 = 1_000_000_000;
/// Default size of the memory of one plan, in MiB.
pub const MEMORY: u64 = 256;
/// Smallest size of the memory of one plan, in MiB.
pub const LEAST_MEMORY: u64 = (Limits::LEAST_MEMORY >> 20) as u64;
/// Largest size of the memory of one plan, in MiB.
pub const MAX_MEMORY: u64 = 65_536;

const START: &str = "start = \"line:4\"";
const SHAPE: &str = "shape = \"loop:3x3\"";
const JOINTS: &str = "joints_deg = [[0, 0, 0], [0, 90, 0]]";

/// A structure as written, and what it is.
#[derive(Clone, Debug)]
struct Named {
    text: String,
    place: Place,
    structure: Structured,
}

/// Joint values of one module as written.
#[derive(Clone, Copy, Debug)]
struct Angles([f64; 3]);

/// Joint values as written.
#[derive(Clone, Debug)]
struct Joints(Vec<Angles>);

/// The family's parts as written.
#[derive(Debug)]
pub struct RawFreeModules {
    start: Option<Named>,
    types: Option<At<String>>,
    joints: Option<At<Joints>>,
    turn_time: Option<At<Span>>,
    connection: Option<RawConnection>,
    goal: Option<Named>,
    name: Option<String>,
    collision: Model,
    connectors: Connectors,
    objective: Objective,
    weight: Option<At<f64>>,
    work: Option<At<u64>>,
    memory: Option<At<u64>>,
}

/// Reads the sections of free modules, by their body. The shared keys of `swarm` have been read already; its other keys,
/// and all of `others`, are read here.
pub fn read(
    mut swarm: Section<'_, '_>,
    others: &Sections<'_, '_>,
    diagnostics: &mut Diagnostics,
) -> Box<dyn RawSwarm> {
    let bodies = [(BODY, false), (walking::BODY, true)];
    if swarm.choice("body", "body", &bodies, diagnostics) == Some(true) {
        return Box::new(RawWalk::read(swarm, others, diagnostics));
    }
    Box::new(RawFreeModules::read(swarm, others, diagnostics))
}

/// The strategies, each with its body.
const STRATEGIES: [(&str, &str); 2] = [(STRATEGY, BODY), (walking::STRATEGY, walking::BODY)];

/// Refuses keys of a section that belong to the other body.
pub fn refuse(
    section: &mut Section<'_, '_>,
    keys: &[&'static str],
    [ours, theirs]: [&'static str; 2],
    diagnostics: &mut Diagnostics,
) {
    for what in keys.iter().copied() {
        if let Some(node) = section.node(what) {
            diagnostics.add(node.span(), FreeModuleError::OtherBody { what, theirs, ours });
        }
    }
}

/// Reads the strategy, which must be that of the body.
pub fn strategy(section: &mut Section<'_, '_>, ours: &'static str, diagnostics: &mut Diagnostics) {
    let Some(chosen) = section.choice_at("strategy", "strategy", &STRATEGIES, diagnostics) else { return };
    let other = STRATEGIES.into_iter().find(|(_, theirs)| *theirs == chosen.value && *theirs != ours);
    if let Some((what, theirs)) = other {
        diagnostics.add(chosen.place, FreeModuleError::OtherBody { what, theirs, ours });
    }
}

impl RawFreeModules {
    /// Reads the sections of free modules on the lattice, but for `body`.
    fn read(
        mut swarm: Section<'_, '_>,
        others: &Sections<'_, '_>,
        diagnostics: &mut Diagnostics,
    ) -> RawFreeModules {
        let start = swarm.need::<String>("start", START, diagnostics);
        let mut raw = RawFreeModules {
            start: start.and_then(|start| read_structure(start, diagnostics)),
            types: swarm.get("types", diagnostics),
            joints: swarm.get("joints_deg", diagnostics),
            turn_time: swarm.get("turn_time", diagnostics),
            connection: RawConnection::read(swarm.node(connection::KEY), diagnostics),
            goal: None,
            name: None,
            collision: Model::Strict,
            connectors: Connectors::All,
            objective: Objective::Actions,
            weight: None,
            work: None,
            memory: None,
        };
        let bodies = [BODY, walking::BODY];
        refuse(&mut swarm, &walking::SWARM_KEYS, bodies, diagnostics);
        swarm.finish(diagnostics);
        for (i, mut section) in goal_sections(others.goals, SHAPE, diagnostics).into_iter().enumerate() {
            if i > 0 {
                diagnostics.add(section.place().clone(), FreeModuleError::SecondGoal);
            }
            raw.name = section.get("name", diagnostics).map(|name| name.value);
            let shape = section.need::<String>("shape", SHAPE, diagnostics);
            raw.goal = shape.and_then(|shape| read_structure(shape, diagnostics));
            refuse(&mut section, &walking::GOAL_KEYS, bodies, diagnostics);
            section.finish(diagnostics);
        }
        if let Some(section) = protocol_section(others.protocol, "collision = \"core\"", diagnostics) {
            raw.read_protocol(section, diagnostics);
        }
        raw
    }

    fn read_protocol(&mut self, mut section: Section<'_, '_>, diagnostics: &mut Diagnostics) {
        strategy(&mut section, BODY, diagnostics);
        refuse(&mut section, &walking::PROTOCOL_KEYS, [BODY, walking::BODY], diagnostics);
        let collision = section.choice("collision", "collision model", &COLLISIONS, diagnostics);
        self.collision = collision.unwrap_or(self.collision);
        let connectors = section.choice("connectors", "choice of connectors", &CONNECTORS, diagnostics);
        self.connectors = connectors.unwrap_or(self.connectors);
        let objective = section.choice("objective", "objective", &OBJECTIVES, diagnostics);
        self.objective = objective.unwrap_or(self.objective);
        self.weight = section.get("weight", diagnostics);
        self.work = section.get("work", diagnostics);
        self.memory = section.get("memory_mib", diagnostics);
        section.finish(diagnostics);
    }

    /// Returns the configuration of the start.
    fn configuration(&self, diagnostics: &mut Diagnostics) -> Option<Configuration> {
        let Named { text, structure, .. } = self.start.as_ref()?;
        let types = self.types.as_ref();
        let shape = match structure {
            Structured::Shape(shape) => shape,
            Structured::Configuration(configuration) => {
                let keys = [
                    ("types", types.map(|t| &t.place)),
                    ("joints_deg", self.joints.as_ref().map(|j| &j.place)),
                ];
                for (key, place) in keys {
                    if let Some(place) = place {
                        diagnostics.add(place.clone(), FreeModuleError::JointsTwice(key));
                    }
                }
                return Some(*configuration);
            }
        };
        let is_line = text.starts_with("line:");
        match (types, &self.joints) {
            (Some(types), _) if !is_line => {
                diagnostics.add(types.place.clone(), FreeModuleError::TypesOfNoLine(text.clone()));
                None
            }
            (Some(types), Some(_)) => {
                diagnostics.add(types.place.clone(), FreeModuleError::JointsTwice("types"));
                None
            }
            (Some(At { value, place }), None) => {
                let connections = shape.len() - 1;
                let digits: Option<Vec<u8>> = value.chars().map(|c| c.to_digit(4).map(|d| d as u8)).collect();
                let line = digits.filter(|d| d.len() == connections).and_then(|d| named::line(&d));
                if line.is_none() {
                    let got = value.chars().take(40).collect();
                    diagnostics.add(place.clone(), FreeModuleError::Types { got, connections });
                }
                line
            }
            (None, Some(joints)) => {
                let steps = steps(joints, shape.len(), diagnostics)?;
                Some(shape.filled(|module| (0, steps[module])))
            }
            (None, None) if is_line => named::line(&vec![0; shape.len() - 1]),
            (None, None) => Some(shape.filled(|_| (0, [0; 3]))),
        }
    }

    fn planner(&self, goal: Goal, diagnostics: &mut Diagnostics) -> Option<Planner> {
        let weight = self.weight.as_ref().map_or(WEIGHT, |w| w.value);
        if let Some(place) =
            self.weight.as_ref().map(|w| &w.place).filter(|_| !(1.0..=MAX_WEIGHT).contains(&weight))
        {
            let (got, low, high) = (weight.to_string(), WEIGHT.to_string(), MAX_WEIGHT.to_string());
            diagnostics.add(place.clone(), ScenarioError::Range { what: "weight", got, low, high });
        }
        let work = within(&self.work, "work", WORK, 1..=MAX_WORK, diagnostics);
        let memory = within(&self.memory, "memory_mib", MEMORY, LEAST_MEMORY..=MAX_MEMORY, diagnostics);
        diagnostics.is_empty().then(|| Planner {
            goal,
            collision: self.collision,
            connectors: self.connectors,
            objective: self.objective,
            weight: (weight * 100.0).round() as u32,
            limits: Limits { memory: (memory as usize) << 20, work },
        })
    }
}

fn within(
    written: &Option<At<u64>>,
    what: &'static str,
    default: u64,
    range: std::ops::RangeInclusive<u64>,
    diagnostics: &mut Diagnostics,
) -> u64 {
    let Some(At { value, place }) = written else { return default };
    if !range.contains(value) {
        let (low, high) = (range.start().to_string(), range.end().to_string());
        diagnostics.add(place.clone(), ScenarioError::Range { what, got: value.to_string(), low, high });
    }
    *value
}

/// Returns the joint values in steps.
fn steps(joints: &At<Joints>, modules: usize, diagnostics: &mut Diagnostics) -> Option<Vec<[u8; 3]>> {
    let At { value: Joints(angles), place } = joints;
    if angles.len() != modules {
        let listed = angles.len();
        diagnostics.add(place.clone(), FreeModuleError::JointsCount { listed, modules });
        return None;
    }
    let mut all = Vec::new();
    for (module, Angles(degrees)) in angles.iter().enumerate() {
        // Larger numbers cannot be distinguished from multiples of a step.
        let degrees = degrees.map(|d| if d.abs() <= 360.0 { d } else { f64::NAN });
        match Posture::from_degrees(Kind::Single, &degrees, 1e-6) {
            Ok(posture) => {
                all.push(posture.steps().try_into().expect("invariant: a module has three joints"))
            }
            Err(error) => {
                diagnostics.add(place.clone(), FreeModuleError::off_lattice(module, &error));
                return None;
            }
        }
    }
    Some(all)
}

/// Interprets a start or a goal: a shape by name, or a file.
fn read_structure(text: At<String>, diagnostics: &mut Diagnostics) -> Option<Named> {
    let At { value: text, place } = text;
    // Names of shapes have a colon and neither dots nor slashes.
    let path = if text.contains(['.', '/']) {
        let file = diagnostics.file(&text);
        diagnostics.note(&place, file)?.display().to_string()
    } else {
        text.clone()
    };
    let found = structured(&diagnostics.sources(), "the structure", &path).map_err(|error| {
        let (reason, fix) = error.reason_and_fix();
        FreeModuleError::Structure { reason, fix }
    });
    let structure = diagnostics.note(&place, found)?;
    Some(Named { text, place, structure })
}

impl RawSwarm for RawFreeModules {
    fn time_step(&self) -> (&Option<At<Span>>, &'static str) {
        (&self.turn_time, "turn_time")
    }
    fn draft(&self, context: &DraftContext, diagnostics: &mut Diagnostics) -> Option<FamilySpec> {
        let DraftContext { time_step, usual_delay, passage, skew, .. } = *context;
        let setup = LatticeSetup { skew, ..LatticeSetup::scaled(time_step, usual_delay) };
        let start = self.configuration(diagnostics);
        let modules = self.start.as_ref().map_or(0, |start| start.structure.shape().len());
        if let (Some(goal), true) = (&self.goal, modules > 0) {
            let n = goal.structure.shape().len();
            if n != modules {
                diagnostics.add(goal.place.clone(), FreeModuleError::Unequal { start: modules, goal: n });
            }
        }
        let mut spec = FamilySpec {
            swarm: None,
            modules,
            start_within: Some(setup.lease),
            goals: vec![self.name.clone().unwrap_or_else(|| "goal 1".to_owned())],
            patience: Patience { bounds: bounds(&setup, modules, passage), livelock: 16, timeout: 4 },
        };
        let (Some(from), Some(to), Some(start)) = (&self.start, &self.goal, start) else { return Some(spec) };
        let goal = match &to.structure {
            Structured::Shape(shape) => Goal::Shape(*shape),
            Structured::Configuration(configuration) => Goal::Configuration(*configuration),
        };
        let connection = self.connection.as_ref().map(|written| written.without_weight(diagnostics));
        spec.swarm = self.planner(goal, diagnostics).map(|planner| {
            let (from, to) = (from.text.clone(), to.text.clone());
            Swarm::new(FreeModules { from, to, start, planner, connection, setup: Arc::new(setup) })
        });
        Some(spec)
    }
}

impl Read for Joints {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Joints> {
        let all = elements(node, JOINTS, diagnostics)?.iter().map(|node| Angles::read(node, diagnostics));
        all.collect::<Option<_>>().map(Joints)
    }
}

impl Read for Angles {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Angles> {
        let all = elements(node, JOINTS, diagnostics)?.iter().map(|node| f64::read(node, diagnostics));
        let angles: Vec<f64> = all.collect::<Option<_>>()?;
        let three = <[f64; 3]>::try_from(angles).ok();
        if three.is_none() {
            diagnostics.add(node.span(), wrong("three angles in degrees", node.get_ref(), JOINTS));
        }
        three.map(Angles)
    }
}
