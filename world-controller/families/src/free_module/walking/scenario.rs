//! The parts of a scenario that only walking structures have: structure, goal, network, gaits and how they are learnt.

use super::error::WalkError;
use super::{BODY, Walk};
use crate::connection;
use crate::free_module::scenario::{BODY as LATTICE, refuse, strategy};
use metamorph_free_modules::gait::ask_tell::Method;
use metamorph_free_modules::gait::elites::{self, Elite};
use metamorph_free_modules::gait::file;
use metamorph_free_modules::gait::space::Space;
use metamorph_free_modules::gait::tuner::{Choice, Known};
use metamorph_free_modules::plan::connected::{Connected, connected};
use metamorph_free_modules::plan::input::read_structure_file;
use metamorph_protocol::free_module::gait::WalkSetup;
use metamorph_protocol::free_module::named;
use metamorph_protocol::free_module::network::NetworkKind;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::time::Span;
use metamorph_scenario::bounds::Bounds;
use metamorph_scenario::diagnostics::{At, Diagnostics, Place};
use metamorph_scenario::error::ScenarioError;
use metamorph_scenario::family::{DraftContext, FamilySpec, Patience, RawSwarm, Sections, Swarm};
use metamorph_scenario::raw::{goal_sections, protocol_section};
use metamorph_scenario::table::{Read, Section, elements};
use metamorph_sim_bridge::free_module::physics::{self, Down};
use metamorph_sim_bridge::free_module::walking::goal::Goal;
use metamorph_text::escape::Shown;
use std::collections::BTreeSet;
use std::ops::RangeInclusive;
use std::sync::Arc;

/// Learners after a failure, the default first.
pub const LEARNERS: [(&str, Option<Method>); 6] = [
    ("bayes", Some(Method::Bayes)),
    ("cma", Some(Method::Cma)),
    ("repertoire", Some(Method::Repertoire)),
    ("pso", Some(Method::Pso)),
    ("random", Some(Method::Random)),
    ("none", None),
];
/// The networks.
pub const NETWORKS: [NetworkKind; 4] = NetworkKind::ALL;
/// Default friction.
pub const FRICTION: f64 = 0.8;
/// The largest friction.
const MOST_FRICTION: f64 = 10.0;
/// Default number of gaits tried after a failure.
pub const DEFAULT_TRIALS: u64 = 20;
/// The largest number of gaits tried after a failure.
pub const MOST_TRIALS: u64 = 10_000;
/// Default time of a trial: a period to go over to the gait, and two that count.
pub const DEFAULT_TRIAL: Span = Span::secs(15);
/// Shortest time of a trial.
pub const SHORTEST_TRIAL: Span = Span::secs(8);
/// Longest time of a trial.
pub const LONGEST_TRIAL: Span = Span::secs(600);

const START: &str = "start = \"quad5-sym\"";
const WALK: &str = "walk = { for = \"60s\", speed_at_least = \"15mm/s\" }";
const GROUND: &str = "ground = { slope = \"10deg\" }";
/// The steepest ground in degrees.
pub const STEEPEST: f64 = 45.0;
/// The fastest turn in degrees a second: half a turn in the time over which the speed is measured.
pub const FASTEST_TURN: f64 = 18.0;
const GAITS: &str = "gaits = [\"gait.json\"]";

/// The family's parts as written.
#[derive(Debug)]
pub struct RawWalk {
    start: Option<At<String>>,
    structure: Option<Connected>,
    down: Down,
    friction: f64,
    slope_deg: f64,
    /// No beat of a scenario applies to it.
    beat: Option<At<Span>>,
    goal: Option<Goal>,
    name: Option<String>,
    network: NetworkKind,
    gaits: Option<(Place, Vec<Known>)>,
    elites: Vec<Elite>,
    method: Option<Method>,
    trials: u64,
    trial: Span,
}

impl RawWalk {
    /// Reads the sections of a walking structure, but for `body`.
    pub fn read(
        mut swarm: Section<'_, '_>,
        others: &Sections<'_, '_>,
        diagnostics: &mut Diagnostics,
    ) -> RawWalk {
        let start = swarm.need::<String>("start", START, diagnostics);
        let mut raw = RawWalk {
            structure: start.as_ref().and_then(|start| read_structure(start, diagnostics)),
            start,
            down: Down::DEFAULT,
            friction: FRICTION,
            slope_deg: 0.0,
            beat: None,
            goal: None,
            name: None,
            network: NetworkKind::BlfSym,
            gaits: None,
            elites: Vec::new(),
            method: LEARNERS[0].1,
            trials: DEFAULT_TRIALS,
            trial: DEFAULT_TRIAL,
        };
        if let Some(At { value, place }) = swarm.get::<String>("down", diagnostics) {
            let down = value.parse().map_err(WalkError::Down);
            raw.down = diagnostics.note(&place, down).unwrap_or(raw.down);
        }
        if let Some(At { value, place }) = swarm.get::<f64>("friction", diagnostics) {
            let friction = (0.0..=MOST_FRICTION).contains(&value).then_some(value);
            raw.friction =
                diagnostics.note(&place, friction.ok_or(WalkError::Friction(value))).unwrap_or(raw.friction);
        }
        if let Some(node) = swarm.node("ground")
            && let Some(mut ground) = Section::of(node, "ground", GROUND, diagnostics)
        {
            let slope = quantity(&mut ground, "slope", "deg", 0.0..=STEEPEST, diagnostics);
            raw.slope_deg = slope.unwrap_or(raw.slope_deg);
            ground.finish(diagnostics);
        }
        let of_lattice = ["types", "joints_deg", "turn_time", connection::KEY];
        refuse(&mut swarm, &of_lattice, [BODY, LATTICE], diagnostics);
        swarm.finish(diagnostics);
        for (i, mut section) in goal_sections(others.goals, WALK, diagnostics).into_iter().enumerate() {
            if i > 0 {
                diagnostics.add(section.place().clone(), WalkError::SecondGoal);
            }
            raw.name = section.get("name", diagnostics).map(|name| name.value);
            raw.goal = read_goal(&mut section, diagnostics);
            refuse(&mut section, &["shape"], [BODY, LATTICE], diagnostics);
            section.finish(diagnostics);
        }
        match protocol_section(others.protocol, GAITS, diagnostics) {
            Some(section) => raw.read_protocol(section, diagnostics),
            None => diagnostics.add(
                Place::File,
                ScenarioError::Missing { key: "gaits", section: "[protocol]".to_owned(), example: GAITS },
            ),
        }
        raw
    }

    fn read_protocol(&mut self, mut section: Section<'_, '_>, diagnostics: &mut Diagnostics) {
        strategy(&mut section, BODY, diagnostics);
        let of_plans = ["collision", "connectors", "objective", "weight", "work", "memory_mib"];
        refuse(&mut section, &of_plans, [BODY, LATTICE], diagnostics);
        let networks = NETWORKS.map(|kind| (kind.name(), kind));
        self.network = section.choice("network", "network", &networks, diagnostics).unwrap_or(self.network);
        self.method = section.choice("relearn", "learner", &LEARNERS, diagnostics).unwrap_or(self.method);
        if let Some(At { value, place }) = section.get::<u64>("trials", diagnostics) {
            self.trials = value;
            if !(1..=MOST_TRIALS).contains(&value) {
                diagnostics.add(place, range("trials", value, 1, MOST_TRIALS));
            }
        }
        if let Some(At { value, place }) = section.get::<Span>("trial", diagnostics) {
            self.trial = value;
            if !(SHORTEST_TRIAL..=LONGEST_TRIAL).contains(&value) {
                diagnostics.add(place, range("trial", value, SHORTEST_TRIAL, LONGEST_TRIAL));
            }
        }
        match section.node("gaits") {
            None => section.missing("gaits", GAITS, diagnostics),
            Some(node) => {
                let listed = elements(node, GAITS, diagnostics);
                let mut known: Vec<Known> = Vec::new();
                for node in listed.into_iter().flat_map(|listed| listed.iter()) {
                    let path = String::read(node, diagnostics).map(|text| At::new(text, node.span()));
                    known.extend(path.and_then(|path| self.read_gait(&path, &known, diagnostics)));
                }
                self.gaits = Some((node.span().into(), known));
            }
        }
        section.finish(diagnostics);
    }

    /// Reads the gait file of a path, and for which dead modules it is.
    fn read_gait(
        &mut self,
        path: &At<String>,
        known: &[Known],
        diagnostics: &mut Diagnostics,
    ) -> Option<Known> {
        let At { value: text, place } = path;
        let structure = &self.structure.as_ref()?.structure;
        let resolved = diagnostics.file(text);
        let resolved = diagnostics.note(place, resolved)?;
        let found = (|| {
            let document = file::read(&diagnostics.sources(), &text.shown(), &resolved)
                .map_err(|e| WalkError::file(&e))?;
            let hash = metamorph_text::format::digits(structure.fingerprint());
            let gait = file::best(&text.shown(), &document, &hash, structure.bound())
                .map_err(|e| WalkError::file(&e))?;
            let space = Space::of(structure, self.network).ok().filter(|_| document.study.dead.is_empty());
            let repertoire = space.map(|space| elites::of_file(&document, &space)).unwrap_or_default();
            let theirs = document.study.network;
            if theirs != self.network.name() {
                return Err(WalkError::Network { ours: self.network, theirs: theirs.shown() });
            }
            let dead: BTreeSet<ModuleId> = document.study.dead.iter().map(|m| ModuleId(*m)).collect();
            if known.iter().any(|other| other.dead == dead) {
                return Err(WalkError::Twice(document.study.dead));
            }
            let speed_mm_s = document.best.map_or(0.0, |best| best.fitness_mm_s);
            Ok((Known { dead, gait, speed_mm_s }, repertoire))
        })();
        let (known, repertoire) = diagnostics.note(place, found)?;
        if known.dead.is_empty() {
            self.elites = repertoire;
        }
        Some(known)
    }

    /// Returns the swarm, if nothing is wrong with it.
    fn swarm(&self, seed: u64, diagnostics: &mut Diagnostics) -> Option<Walk> {
        let (start, read) = (self.start.as_ref()?, self.structure.as_ref()?);
        let (place, known) = self.gaits.as_ref()?;
        if diagnostics.is_empty() && !known.iter().any(|known| known.dead.is_empty()) {
            diagnostics.add(place.clone(), WalkError::NotWhole);
        }
        let structure = read.structure.clone();
        let bound = structure.bound();
        let choice = Choice {
            structure,
            network: self.network,
            known: known.clone(),
            elites: self.elites.clone(),
            method: self.method,
            trials: u32::try_from(self.trials).unwrap_or(u32::MAX),
            seed,
        };
        let walk = Walk {
            start: start.value.clone(),
            joints_deg: read.joints_deg.clone().unwrap_or_else(|| vec![[0.0; 3]; bound]),
            down: self.down,
            friction: self.friction as f32,
            slope_deg: self.slope_deg,
            choice: Arc::new(choice),
            trial: self.trial,
            goal: self.goal?,
            setup: Arc::new(WalkSetup::new(self.network)),
        };
        let bodies = walk.bodies().map_err(WalkError::Bodies);
        diagnostics.note(&start.place, bodies)?;
        Some(walk)
    }
}

/// Returns the error of a value beyond its bounds.
fn range<T: ToString>(what: &'static str, got: T, low: T, high: T) -> ScenarioError {
    ScenarioError::Range { what, got: got.to_string(), low: low.to_string(), high: high.to_string() }
}

fn read_structure(start: &At<String>, diagnostics: &mut Diagnostics) -> Option<Connected> {
    let At { value: text, place } = start;
    if let Some(structure) = named::structure(text) {
        return Some(Connected { structure, joints_deg: None });
    }
    // Names have neither dots nor slashes.
    if !text.contains(['.', '/']) {
        diagnostics.add(place.clone(), WalkError::Unknown(text.clone()));
        return None;
    }
    let path = diagnostics.file(text);
    let path = diagnostics.note(place, path)?;
    let name = text.shown();
    let found =
        read_structure_file(&diagnostics.sources(), &name, &path).and_then(|file| connected(&name, &file));
    diagnostics.note(place, found.map_err(|error| WalkError::file(&error)))
}

fn read_goal(section: &mut Section<'_, '_>, diagnostics: &mut Diagnostics) -> Option<Goal> {
    let Some(node) = section.node("walk") else {
        section.missing("walk", WALK, diagnostics);
        return None;
    };
    let mut walk = Section::of(node, "walk", WALK, diagnostics)?;
    let time = walk.need::<Span>("for", WALK, diagnostics);
    let speed = walk.need::<String>("speed_at_least", WALK, diagnostics);
    let heading_deg = quantity(&mut walk, "heading", "deg", -360.0..=360.0, diagnostics);
    let turn_deg_s = quantity(&mut walk, "turn", "deg/s", -FASTEST_TURN..=FASTEST_TURN, diagnostics);
    let place = walk.place().clone();
    walk.finish(diagnostics);
    let At { value, place: of_speed } = speed?;
    let number = value.strip_suffix("mm/s").and_then(|n| n.trim().parse::<f64>().ok());
    let speed = number.filter(|n| n.is_finite() && *n >= 0.0).ok_or_else(|| WalkError::Speed(value.shown()));
    let speed_mm_s = diagnostics.note(&of_speed, speed)?;
    if turn_deg_s.is_some_and(|turn| turn == 0.0 || speed_mm_s == 0.0) {
        diagnostics.add(place, WalkError::NoTurn);
    }
    Some(Goal { speed_mm_s, time: time?.value, heading_deg, turn_deg_s })
}

/// Reads a number with a unit.
fn quantity(
    section: &mut Section<'_, '_>,
    key: &'static str,
    unit: &'static str,
    range: RangeInclusive<f64>,
    diagnostics: &mut Diagnostics,
) -> Option<f64> {
    let At { value, place } = section.get::<String>(key, diagnostics)?;
    let number = value.strip_suffix(unit).and_then(|n| n.trim().parse::<f64>().ok());
    let wrong = || WalkError::Quantity { what: key, got: value.shown(), unit, range: range.clone() };
    let number = number.filter(|n| range.contains(n)).ok_or_else(wrong);
    diagnostics.note(&place, number)
}

impl RawSwarm for RawWalk {
    fn time_step(&self) -> (&Option<At<Span>>, &'static str) {
        (&self.beat, "turn_time")
    }
    fn draft(&self, context: &DraftContext, diagnostics: &mut Diagnostics) -> Option<FamilySpec> {
        let modules = self.structure.as_ref().map_or(0, |read| read.structure.bound());
        let swarm = self.swarm(context.seed, diagnostics);
        // A few trials without a step forward, besides what orders and reports take.
        let stall = self.trial * 4 + context.passage.late * 4;
        let patience = Patience {
            bounds: Bounds { stall, more_tries: context.passage.more_tries(1, modules as u64) },
            livelock: 1 + self.trials,
            timeout: 2,
        };
        Some(FamilySpec {
            swarm: swarm.map(Swarm::new),
            modules,
            start_within: None,
            goals: vec![self.name.clone().unwrap_or_else(|| "walk".to_owned())],
            patience,
        })
    }
}

const _: () = assert!(FRICTION as f32 == physics::FRICTION);
