//! The parts of a scenario that only metamodules have: kind, floor and start places, seeds in levels, the
//! strategy. Reads and checks them, and creates the swarm.
//!
//! Coordinates of the floor are pairs of connectors. Not here: drawing random places, which the protocol's
//! library does.

use super::Metamodules;
use super::asking::RawAsking;
use super::bounds::bounds;
use super::elements::{self, RawElement, Surroundings};
use super::error::{MAX_COMMUNICATION_RANGE, MAX_FLOOR, MAX_METAMODULES, MetamoduleError};
use super::field::RawField;
use super::motion_database::motions;
use crate::connection::{self, RawConnection};
use metamorph_protocol::lattice::{Cell, Face};
use metamorph_protocol::metamodule::blueprint::{
    Blueprint, BlueprintError, Seed, SeedOrder, box_of_four, chair_of_six,
};
use metamorph_protocol::metamodule::motions::Motions;
use metamorph_protocol::metamodule::params::{
    Detector, Floor, LEAST_COMMUNICATION_RANGE, Params, SeedAuthority, Setup, Strategy,
};
use metamorph_protocol::metamodule::pose::{Pose, to_world};
use metamorph_protocol::metamodule::start::{Start, draw_start};
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::roombots::grid::GridState;
use metamorph_protocol::roombots::posture::Posture;
use metamorph_protocol::time::{Span, Time};
use metamorph_scenario::diagnostics::{At, Diagnostics, Place};
use metamorph_scenario::error::ScenarioError;
use metamorph_scenario::family::{
    DraftContext, FamilySpec, Patience, RawSwarm, SectionKind, Sections, Swarm,
};
use metamorph_scenario::raw::{goal_sections, protocol_section};
use metamorph_scenario::table::{Connector, Node, Read, Section, elements as list, wrong};
use std::sync::Arc;
use toml::de::DeValue;

/// The start places as written.
#[derive(Clone, Debug, Default)]
enum RawStart {
    /// Drawn from the seed of the run.
    #[default]
    Random,
    /// Drawn likewise, in this area of the floor.
    Within(Floor),
    /// At these connectors, rotated by quarter turns.
    Listed(Vec<At<GridState>>),
}

/// A goal as written.
#[derive(Clone, Debug)]
struct RawGoal {
    name: Option<String>,
    place: Place,
    at: Option<At<Span>>,
    /// The seeds, level by level; `None` if they could not be read.
    levels: Option<Vec<Vec<At<Seed>>>>,
    order: SeedOrder,
}

/// The family's parts as written.
#[derive(Clone, Debug)]
pub struct RawMetamodules {
    place: Place,
    kind: Kind,
    count: Option<At<u64>>,
    /// The time of a step of a joint, and of a connection.
    turn_time: Option<At<Span>>,
    floor: Floor,
    communication_range: Option<At<u64>>,
    start: At<RawStart>,
    elements: Vec<RawElement>,
    connection: Option<RawConnection>,
    goals: Vec<RawGoal>,
    strategy: Strategy,
    field: RawField,
    asking: RawAsking,
    seed_authority: SeedAuthority,
    relocate: bool,
    detector: Option<At<bool>>,
    /// Whether metamodules decide for themselves where a plan leaves seeds unfilled.
    fallback: Option<At<bool>>,
}

const GOAL: &str = "shape = { box = [5, 5] }";
const SEED: &str = "{ foot = [5, 5], directions = [\"up\", \"up\", \"east\"] }";
const LEVELS: &str = "[[{ foot = [5, 5], directions = [\"up\", \"up\", \"east\"] }]]";
/// Default kind of metamodules.
pub const KIND: Kind = Kind::Srs;
/// Default floor: that of the published experiment.
pub const FLOOR: Floor = Floor { min: (0, 0), max: (12, 12) };
/// Default number of quarter turns of a listed place.
pub const CLASS: u64 = 0;
const FLOOR_EXAMPLE: &str = "{ min = [0, 0], max = [12, 12] }";
const START: &str = "start = [{ at = [1, 2], class = 0 }]";
/// Directions from cell to cell.
pub const FACES: [(&str, Face); 6] = [
    ("up", Face::Up),
    ("down", Face::Down),
    ("north", Face::North),
    ("south", Face::South),
    ("east", Face::East),
    ("west", Face::West),
];

/// Returns a seed as scenarios have it.
pub fn seed_text(seed: &Seed) -> String {
    let name = |face| FACES.iter().find(|(_, f)| *f == face).map_or("", |(name, _)| *name);
    let names: Vec<String> = seed.directions.iter().map(|face| format!("\"{}\"", name(*face))).collect();
    format!("{{ foot = [{}, {}], directions = [{}] }}", seed.foot.0, seed.foot.1, names.join(", "))
}

/// Behaviour of metamodules where a plan leaves seeds unfilled, the default first; true if they decide for themselves.
pub const FALLBACKS: [(&str, bool); 2] = [("negotiated", true), ("none", false)];
/// Which instance opens seeds.
pub const SEED_AUTHORITIES: [(&str, SeedAuthority); 2] =
    [("controller", SeedAuthority::Controller), ("neighbours", SeedAuthority::Neighbours)];
/// A goal of the thesis, by name.
type Library = (&'static str, fn(i16, i16) -> Vec<Vec<Seed>>);
/// The names of the goals of the thesis.
pub const SHAPES: [&str; 2] = ["box", "chair"];
const LIBRARY: [Library; 2] = [("box", box_of_four), ("chair", chair_of_six)];

impl RawMetamodules {
    /// Reads the sections of metamodules. The shared keys of `swarm` have been read already; its other keys,
    /// and all of `others`, are read here.
    pub fn read(
        mut swarm: Section<'_, '_>,
        others: &Sections<'_, '_>,
        diagnostics: &mut Diagnostics,
    ) -> RawMetamodules {
        let kinds = Kind::METAMODULES.map(|k| (k.name(), k));
        let start = swarm.get("start", diagnostics);
        let range = swarm.key_or_former("communication_range", "hearing");
        let mut raw = RawMetamodules {
            place: swarm.place().clone(),
            kind: swarm.choice("kind", "kind", &kinds, diagnostics).unwrap_or(KIND),
            count: swarm.get("count", diagnostics),
            turn_time: swarm.get("turn_time", diagnostics),
            floor: swarm.get::<RawFloor>("floor", diagnostics).map_or(FLOOR, |f| f.value.0),
            communication_range: swarm.get(range, diagnostics),
            start: start.unwrap_or_else(|| At { value: RawStart::Random, place: swarm.place().clone() }),
            elements: elements::read(swarm.node("element"), diagnostics),
            connection: RawConnection::read(swarm.node(connection::KEY), diagnostics),
            goals: Vec::new(),
            strategy: Strategy::default(),
            field: RawField::default(),
            asking: RawAsking::default(),
            seed_authority: SeedAuthority::default(),
            relocate: false,
            detector: None,
            fallback: None,
        };
        swarm.finish(diagnostics);
        raw.goals = goal_sections(others.goals, GOAL, diagnostics)
            .into_iter()
            .map(|section| read_goal(section, diagnostics))
            .collect();
        let example = "strategy = \"step\"";
        if let Some(mut section) = protocol_section(others.protocol, example, diagnostics) {
            let strategies = Strategy::ALL.map(|s| (s.name(), s));
            raw.strategy =
                section.choice("strategy", "strategy", &strategies, diagnostics).unwrap_or_default();
            raw.field = RawField::read(&mut section, diagnostics);
            raw.asking = RawAsking::read(&mut section, diagnostics);
            let key = section.key_or_former("seed_authority", "teller");
            raw.seed_authority =
                section.choice(key, "seed authority", &SEED_AUTHORITIES, diagnostics).unwrap_or_default();
            raw.relocate = section.get("relocate", diagnostics).is_some_and(|r| r.value);
            raw.detector = section.get("detector", diagnostics).filter(|d: &At<bool>| d.value);
            raw.fallback = section.choice_at("fallback", "fallback", &FALLBACKS, diagnostics);
            section.finish(diagnostics);
        }
        raw
    }

    fn blueprint(
        &self,
        goal: &RawGoal,
        motions: &Motions,
        diagnostics: &mut Diagnostics,
    ) -> Option<Blueprint> {
        let levels = goal.levels.as_ref()?;
        let bare: Vec<Vec<Seed>> = levels.iter().map(|l| l.iter().map(|s| s.value).collect()).collect();
        let seeds: Vec<&At<Seed>> = levels.iter().flatten().collect();
        let blueprint = Blueprint::new(&bare, goal.order).map_err(|error| {
            let guilty = match error {
                BlueprintError::Overlap { second: i, .. } | BlueprintError::Impossible(i) => seeds.get(i),
                BlueprintError::Empty | BlueprintError::TooMany(_) => None,
            };
            let place = guilty.map_or(&goal.place, |s| &s.place).clone();
            diagnostics.add(place, MetamoduleError::from(error));
        });
        let blueprint = blueprint.ok()?;
        for At { value: seed, place } in seeds {
            let (at, floor) = (seed.foot, self.floor);
            if !floor.has(at.0, at.1) {
                diagnostics.add(place.clone(), MetamoduleError::SeedOffFloor { at, floor });
            } else if !can_fill(motions, seed) {
                diagnostics.add(place.clone(), MetamoduleError::SeedShape { at, kind: self.kind });
            }
        }
        Some(blueprint)
    }

    /// Returns the times at which goals are replaced.
    fn changes(&self) -> impl Iterator<Item = &At<Span>> {
        self.goals.iter().filter_map(|goal| goal.at.as_ref())
    }

    /// Checks that goals are sorted by time.
    fn check_times(&self, diagnostics: &mut Diagnostics) {
        let mut before = Span::ZERO;
        for (i, goal) in self.goals.iter().enumerate() {
            match (&goal.at, i) {
                (Some(at), 0) => diagnostics.add(at.place.clone(), MetamoduleError::FirstGoalAt),
                (None, 0) => {}
                (None, _) => {
                    let (section, example) = ("a later [[goal]]".into(), "at = \"60s\"");
                    diagnostics
                        .add(goal.place.clone(), ScenarioError::Missing { key: "at", section, example });
                }
                (Some(At { value, place }), _) if *value <= before => {
                    diagnostics.add(place.clone(), MetamoduleError::GoalOrder { at: *value, before });
                }
                (Some(at), _) => before = at.value,
            }
        }
    }

    /// Returns the number of metamodules; `seeds` is the number that the largest goal needs.
    fn count(&self, seeds: usize, diagnostics: &mut Diagnostics) -> Option<usize> {
        let listed = match &self.start.value {
            RawStart::Random | RawStart::Within(_) => None,
            RawStart::Listed(places) => Some(places.len()),
        };
        let (metamodules, place) = match (&self.count, listed) {
            (Some(count), Some(listed)) if count.value != listed as u64 => {
                diagnostics.add(count.place.clone(), MetamoduleError::Count { count: count.value, listed });
                return None;
            }
            (Some(count), _) => {
                let most = MAX_METAMODULES as u64;
                (range(count, "count", 1, most, diagnostics)? as usize, &count.place)
            }
            (None, Some(listed)) => {
                let count = At::new(listed as u64, self.start.place.clone());
                let most = MAX_METAMODULES as u64;
                (range(&count, "the number of places", 1, most, diagnostics)? as usize, &self.start.place)
            }
            (None, None) => (seeds, &self.place),
        };
        if metamodules < seeds {
            diagnostics.add(place.clone(), MetamoduleError::TooFewMetamodules { seeds, metamodules });
        }
        Some(metamodules)
    }

    fn placed(
        &self,
        setup: Arc<Setup>,
        count: usize,
        seed: u64,
        diagnostics: &mut Diagnostics,
    ) -> Option<Swarm> {
        let drawn = match &self.start.value {
            RawStart::Random => Some(setup.floor),
            RawStart::Within(area) => Some(*area),
            RawStart::Listed(_) => None,
        };
        let start = match (&self.start.value, drawn) {
            (RawStart::Listed(places), _) => Start { poses: listed(&setup, places, diagnostics), redrawn: 0 },
            (_, area) => {
                let start = draw_start(&setup, area.unwrap_or(setup.floor), count, seed);
                diagnostics.note(&self.start.place, start.map_err(MetamoduleError::from))?
            }
        };
        let Start { poses, redrawn } = start;
        let changes = (1..).zip(self.changes()).map(|(goal, at)| (Time::ZERO + at.value, goal)).collect();
        let hands_over = self.fallback.as_ref().is_none_or(|f| f.value);
        let (relocate, connection) = (self.relocate, self.connection.as_ref().map(RawConnection::model));
        let swarm = Metamodules { drawn, poses, redrawn, setup, connection, changes, relocate, hands_over };
        diagnostics.note(&self.start.place, swarm.check_ports())?;
        Some(Swarm::new(swarm))
    }
}

impl RawSwarm for RawMetamodules {
    fn time_step(&self) -> (&Option<At<Span>>, &'static str) {
        (&self.turn_time, "turn_time")
    }
    fn check_end(&self, timeout: Span, diagnostics: &mut Diagnostics) {
        for At { value: at, place } in self.changes().filter(|c| c.value > timeout) {
            diagnostics.add(place.clone(), ScenarioError::AfterTheEnd { at: *at, timeout });
        }
    }
    fn draft(&self, context: &DraftContext, diagnostics: &mut Diagnostics) -> Option<FamilySpec> {
        let DraftContext { time_step, usual_delay, passage, skew, seed } = *context;
        // Invariant: only kinds of metamodules can be chosen, and the database is small enough for them.
        let motions = motions(diagnostics.families().sources, self.kind).ok()?;
        let goals: Vec<Option<Blueprint>> =
            self.goals.iter().map(|goal| self.blueprint(goal, &motions, diagnostics)).collect();
        let goals: Option<Vec<Blueprint>> = goals.into_iter().collect();
        self.check_times(diagnostics);
        let seeds = self.goals.iter().flat_map(|g| &g.levels).map(|l| l.iter().map(Vec::len).sum());
        let (most, all) = seeds.fold((0, 0), |(most, all): (usize, usize), n: usize| (most.max(n), all + n));
        let count = self.count(most, diagnostics)?;
        let mut params = Params::scaled(self.strategy, time_step, usual_delay);
        (params.skew, params.seed_authority) = (skew, self.seed_authority);
        if let Some(communication_range) = &self.communication_range {
            let (least, most) = (u64::from(LEAST_COMMUNICATION_RANGE), MAX_COMMUNICATION_RANGE);
            params.communication_range =
                range(communication_range, "communication range", least, most, diagnostics)? as u16;
        }
        self.field.apply(&mut params, diagnostics);
        self.asking.apply(&mut params, diagnostics);
        let metamodules = u16::try_from(count).unwrap_or(u16::MAX);
        if let Some(asked) = &self.detector {
            params.detector = Some(Detector { after: params.patience, metamodules });
            if !self.strategy.is_published() {
                diagnostics.add(asked.place.clone(), MetamoduleError::NoDetector(self.strategy.name()));
            }
        }
        if let Some(asked) = self.fallback.as_ref().filter(|_| self.strategy != Strategy::Planned) {
            diagnostics.add(asked.place.clone(), MetamoduleError::NoFallback(self.strategy.name()));
        }
        let name =
            |(i, goal): (usize, &RawGoal)| goal.name.clone().unwrap_or_else(|| format!("goal {}", i + 1));
        let mut draft = FamilySpec {
            swarm: None,
            modules: count,
            start_within: Some(params.lease),
            goals: self.goals.iter().enumerate().map(name).collect(),
            patience: Patience { bounds: bounds(&params, passage), livelock: 16, timeout: all as u64 + 1 },
        };
        if let (Some(goals), true) = (goals, diagnostics.is_empty()) {
            let around = Surroundings {
                floor: self.floor,
                goals: &goals,
                motions: &motions,
                strategy: self.strategy,
                communication_range: params.communication_range,
            };
            let elements = elements::checked(&self.elements, &around, diagnostics);
            if let (Some(elements), true) = (elements, diagnostics.is_empty()) {
                let setup = Setup { params, floor: self.floor, goals, motions, elements };
                draft.swarm = self.placed(Arc::new(setup), count, seed, diagnostics);
            }
        }
        Some(draft)
    }
}

/// Returns upright poses at these connectors.
fn listed(setup: &Setup, places: &[At<GridState>], diagnostics: &mut Diagnostics) -> Vec<Pose> {
    // Invariant: the zero posture stands upright and is in every database.
    let posture = setup.motions.table().find(Posture::zero(setup.kind())).unwrap_or(0);
    for (second, At { value, place }) in places.iter().enumerate() {
        let at = (value.x, value.y);
        if !setup.floor.has(at.0, at.1) {
            diagnostics.add(place.clone(), MetamoduleError::StartOffFloor { at, floor: setup.floor });
        }
        if let Some(first) = places[..second].iter().position(|p| (p.value.x, p.value.y) == at) {
            diagnostics.add(place.clone(), MetamoduleError::StartTwice { first, second, at });
        }
    }
    let upright = |state| Pose::standing(state, posture);
    places.iter().map(|p| upright(p.value)).collect()
}

/// Returns true if some reachable posture, in some orientation, fills the cells of a seed.
fn can_fill(motions: &Motions, seed: &Seed) -> bool {
    let (table, goal) = (motions.table(), seed.cells());
    let foot = |class| GridState::new(seed.foot.0, seed.foot.1, class);
    let fills = |cells: &[Cell]| (0..4).any(|class| cells.iter().map(|c| to_world(foot(class), *c)).eq(goal));
    table.chains().iter().any(|chain| fills(&chain.cells) && table.chain_is_main(chain))
}

fn range(
    number: &At<u64>,
    what: &'static str,
    low: u64,
    high: u64,
    diagnostics: &mut Diagnostics,
) -> Option<u64> {
    if (low..=high).contains(&number.value) {
        return Some(number.value);
    }
    let (got, low, high) = (number.value.to_string(), low.to_string(), high.to_string());
    diagnostics.add(number.place.clone(), ScenarioError::Range { what, got, low, high });
    None
}

fn read_goal(mut section: Section<'_, '_>, diagnostics: &mut Diagnostics) -> RawGoal {
    let orders = SeedOrder::ALL.map(|o| (o.name(), o));
    let name = section.get("name", diagnostics).map(|n| n.value);
    let at = section.get("at", diagnostics);
    let order = section.choice("order", "order", &orders, diagnostics).unwrap_or_default();
    let levels = match (section.node("shape"), section.node("levels")) {
        (Some(shape), None) => read_shape(shape, diagnostics),
        (None, Some(levels)) => read_levels(levels, diagnostics),
        (None, None) => {
            section.missing("shape", GOAL, diagnostics);
            None
        }
        (Some(_), Some(levels)) => {
            let (expected, found) = ("either `shape` or `levels`", "both");
            diagnostics.add(levels.span(), ScenarioError::Kind { expected, found, example: GOAL });
            None
        }
    };
    let place = section.place().clone();
    section.finish(diagnostics);
    RawGoal { name, place, at, levels, order }
}

/// Reads a goal of the thesis: its name and the corner of its place.
fn read_shape(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Vec<Vec<At<Seed>>>> {
    let mut section = Section::of(node, "the shape of a goal", "{ box = [5, 5] }", diagnostics)?;
    let named = LIBRARY.iter().filter_map(|(name, make)| Some((section.node(name)?, make)));
    let named: Vec<_> = named.collect();
    section.differs_between_families(SectionKind::Shape);
    let is_foreign = section.finish(diagnostics);
    if named.is_empty() && is_foreign {
        return None;
    }
    let [(corner, make)] = named[..] else {
        let (expected, found) = ("one shape, `box` or `chair`", "none or both");
        diagnostics.add(node.span(), ScenarioError::Kind { expected, found, example: "{ box = [5, 5] }" });
        return None;
    };
    let Connector(x, y) = Connector::read(corner, diagnostics)?;
    let at = |seed| At::new(seed, corner.span());
    Some(make(x, y).into_iter().map(|level| level.into_iter().map(at).collect()).collect())
}

fn read_levels(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Vec<Vec<At<Seed>>>> {
    let mut levels = Vec::new();
    for level in list(node, LEVELS, diagnostics)?.iter() {
        let seeds = list(level, LEVELS, diagnostics)?;
        if seeds.is_empty() {
            diagnostics.add(level.span(), MetamoduleError::from(BlueprintError::Empty));
        }
        let read = |n: &Node<'_>| read_seed(n, diagnostics).map(|seed| At::new(seed, n.span()));
        levels.push(seeds.iter().map(read).collect::<Option<_>>()?);
    }
    Some(levels)
}

fn read_seed(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Seed> {
    let mut section = Section::of(node, "a seed", SEED, diagnostics)?;
    let foot = section.need::<Connector>("foot", "foot = [5, 5]", diagnostics);
    let example = "directions = [\"up\", \"up\", \"east\"]";
    let directions = match section.node("directions") {
        Some(node) => directions(node, example, diagnostics),
        None => {
            section.missing("directions", example, diagnostics);
            None
        }
    };
    section.finish(diagnostics);
    let Connector(x, y) = foot?.value;
    Some(Seed { foot: (x, y), directions: directions? })
}

fn directions(node: &Node<'_>, example: &'static str, diagnostics: &mut Diagnostics) -> Option<[Face; 3]> {
    let array = list(node, example, diagnostics)?;
    let mut faces = Vec::new();
    for element in array.iter() {
        let got = String::read(element, diagnostics)?;
        let Some((_, face)) = FACES.iter().find(|(name, _)| *name == got) else {
            let known = FACES.iter().map(|(name, _)| *name).collect();
            diagnostics.add(element.span(), ScenarioError::Name { what: "direction", got, known });
            return None;
        };
        faces.push(*face);
    }
    let three = <[Face; 3]>::try_from(faces);
    if three.is_err() {
        let (expected, found) = ("three directions, from cell to cell", "a list of another length");
        diagnostics.add(node.span(), ScenarioError::Kind { expected, found, example });
    }
    three.ok()
}

/// A floor, as written in a scenario.
struct RawFloor(Floor);

impl Read for RawFloor {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<RawFloor> {
        let mut section = Section::of(node, "floor", FLOOR_EXAMPLE, diagnostics)?;
        let min = section.need::<Connector>("min", "min = [0, 0]", diagnostics);
        let max = section.need::<Connector>("max", "max = [12, 12]", diagnostics);
        section.finish(diagnostics);
        let (Connector(x0, y0), Connector(x1, y1)) = (min?.value, max?.value);
        for (low, high) in [(x0, x1), (y0, y1)] {
            let side = i32::from(high) - i32::from(low) + 1;
            if !(1..=i32::from(MAX_FLOOR)).contains(&side) {
                let what = "the number of connectors along a side of the floor";
                let (low, high) = ("1".into(), MAX_FLOOR.to_string());
                diagnostics.add(node.span(), ScenarioError::Range { what, got: side.to_string(), low, high });
                return None;
            }
        }
        Some(RawFloor(Floor { min: (x0, y0), max: (x1, y1) }))
    }
}

impl Read for RawStart {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<RawStart> {
        match node.get_ref() {
            DeValue::String(text) if text == "random" => Some(RawStart::Random),
            DeValue::String(text) => {
                let got = text.clone().into_owned();
                diagnostics
                    .add(node.span(), ScenarioError::Name { what: "start", got, known: vec!["random"] });
                None
            }
            DeValue::Array(places) => {
                let read = |n: &Node<'_>| read_place(n, diagnostics).map(|state| At::new(state, n.span()));
                places.iter().map(read).collect::<Option<_>>().map(RawStart::Listed)
            }
            DeValue::Table(_) => RawFloor::read(node, diagnostics).map(|floor| RawStart::Within(floor.0)),
            other => {
                let expected = "\"random\", an area or a list of places";
                diagnostics.add(node.span(), wrong(expected, other, START));
                None
            }
        }
    }
}

fn read_place(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<GridState> {
    let mut section = Section::of(node, "a place", "{ at = [1, 2], class = 0 }", diagnostics)?;
    let at = section.need::<Connector>("at", "at = [1, 2]", diagnostics);
    let class = section.get::<u64>("class", diagnostics).unwrap_or_else(|| At::new(CLASS, Place::File));
    let class = range(&class, "the class, which counts quarter turns,", 0, 3, diagnostics);
    section.finish(diagnostics);
    let Connector(x, y) = at?.value;
    Some(GridState::new(x, y, class? as u8))
}
