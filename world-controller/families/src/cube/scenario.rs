//! The parts of a scenario that only cubes have: start and goal shapes, and the protocol's options. Reads and
//! checks them, and creates the swarm.

use super::Cubes;
use super::bounds::bounds;
use metamorph_protocol::cube::params::{Connectivity, Params, Setup};
use metamorph_protocol::goal::{Goal, Growth};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::shape::Shape;
use metamorph_protocol::time::Span;
use metamorph_scenario::diagnostics::{At, Diagnostics};
use metamorph_scenario::error::{MAX_VOLUME, ScenarioError};
use metamorph_scenario::family::{DraftContext, FamilySpec, Patience, RawSwarm, Sections, Swarm};
use metamorph_scenario::raw::{goal_sections, protocol_section};
use metamorph_scenario::shapes::{Layout, check_box, sides};
use metamorph_scenario::table::Section;
use std::cmp::Reverse;
use std::sync::Arc;

/// A goal as written.
#[derive(Clone, Debug)]
struct RawGoal {
    name: Option<String>,
    /// `None` if it could not be read.
    shape: Option<At<Shape>>,
    seed: Option<At<Cell>>,
    growth: Growth,
}

/// The family's parts as written.
#[derive(Clone, Debug, Default)]
pub struct RawCubes {
    /// The start shape; `None` if it could not be read.
    start: Option<At<Shape>>,
    /// The time of a move.
    move_time: Option<At<Span>>,
    goals: Vec<RawGoal>,
    connectivity: Connectivity,
    co_owners: Option<bool>,
}

/// Default of `co_owners`: whether all neighbours of a cell are asked before it is entered.
pub const CO_OWNERS: bool = true;
const START: &str = "start = { box = { min = [0, 0, 0], max = [5, 5, 0] } }";
const GOAL: &str = "shape = { sphere = { center = [0, 0, 2], radius = 3 } }";
/// The growths of a goal. The first is the default.
pub const GROWTH: [(&str, Growth); 2] = [("solid", Growth::Solid), ("scaffold", Growth::Scaffold)];
/// The connectivity checks, which keep the body in one piece.
pub const CONNECTIVITY: [(&str, Connectivity); 3] = [
    ("forest", Connectivity::Forest),
    ("cycles", Connectivity::Cycles),
    ("gradient", Connectivity::Gradient),
];
/// Whether modules stay with a dead neighbour. Leaving it could split the body, so only `hold` is supported;
/// the key exists so that scenarios can state what they rely on. The first is the default.
pub const DEAD: [(&str, bool); 2] = [("hold", true), ("abandon", false)];

impl RawCubes {
    /// Reads the sections of cubes. The shared keys of `swarm` have been read already; its other keys, and
    /// all of `others`, are read here.
    pub fn read(
        mut swarm: Section<'_, '_>,
        others: &Sections<'_, '_>,
        diagnostics: &mut Diagnostics,
    ) -> RawCubes {
        let mut raw = RawCubes {
            start: swarm.need("start", START, diagnostics),
            move_time: swarm.get("move_time", diagnostics),
            ..RawCubes::default()
        };
        swarm.finish(diagnostics);
        for mut section in goal_sections(others.goals, GOAL, diagnostics) {
            raw.goals.push(RawGoal {
                name: section.get("name", diagnostics).map(|n| n.value),
                shape: section.need("shape", GOAL, diagnostics),
                seed: section.get("seed", diagnostics),
                growth: section.choice("growth", "growth", &GROWTH, diagnostics).unwrap_or_default(),
            });
            section.finish(diagnostics);
        }
        let example = "connectivity = \"forest\"";
        if let Some(section) = protocol_section(others.protocol, example, diagnostics) {
            raw.read_protocol(section, diagnostics);
        }
        raw
    }

    fn read_protocol(&mut self, mut section: Section<'_, '_>, diagnostics: &mut Diagnostics) {
        let connectivity = section.choice("connectivity", "connectivity", &CONNECTIVITY, diagnostics);
        self.connectivity = connectivity.unwrap_or_default();
        let dead = section.node("dead").map(|node| node.span());
        if let (Some(false), Some(place)) =
            (section.choice("dead", "policy for dead modules", &DEAD, diagnostics), dead)
        {
            let what = "letting go of dead modules".to_owned();
            diagnostics.add(
                place,
                ScenarioError::NotYet { what, instead: "write `dead = \"hold\"`, or leave it out" },
            );
        }
        self.co_owners = section.get("co_owners", diagnostics).map(|c| c.value);
        section.finish(diagnostics);
    }
}

impl RawSwarm for RawCubes {
    fn time_step(&self) -> (&Option<At<Span>>, &'static str) {
        (&self.move_time, "move_time")
    }
    fn draft(&self, context: &DraftContext, diagnostics: &mut Diagnostics) -> Option<FamilySpec> {
        let DraftContext { time_step, usual_delay, passage, skew, .. } = *context;
        let mut layout = Layout::default();
        let cells = self.start.as_ref().and_then(|start| layout.start(start, diagnostics));
        let shapes: Vec<Option<Vec<Cell>>> =
            self.goals.iter().map(|goal| goal_cells(goal, &mut layout, diagnostics)).collect();
        let sides = check_box(cells.iter().flatten().chain(shapes.iter().flatten().flatten()), diagnostics)?;
        let goals = match &cells {
            Some(cells) => compile_goals(&self.goals, &shapes, cells, diagnostics),
            None => Vec::new(),
        };
        let omitted =
            goals.iter().zip(&shapes).map(|(goal, shape)| shape.as_ref().map_or(0, |s| s.len() - goal.len()));
        let omitted = omitted.collect();
        let name =
            |(i, goal): (usize, &RawGoal)| goal.name.clone().unwrap_or_else(|| format!("goal {}", i + 1));
        let range = u16::try_from(sides * 4).unwrap_or(u16::MAX).min(60_000);
        let params = Params {
            co_owners: self.co_owners.unwrap_or(CO_OWNERS),
            skew,
            ..Params::scaled(time_step, usual_delay, range).keeping(self.connectivity)
        };
        Some(FamilySpec {
            start_within: Some(params.start_within() + skew),
            modules: cells.as_ref().map_or(0, Vec::len),
            goals: self.goals.iter().enumerate().map(name).collect(),
            patience: Patience {
                bounds: bounds(&params, sides, passage),
                livelock: 4,
                timeout: 3 * self.goals.len().max(1) as u64,
            },
            swarm: cells.map(|cells| {
                Swarm::new(Cubes { cells: cells.into(), setup: Arc::new(Setup { params, goals }), omitted })
            }),
        })
    }
}

fn goal_cells(goal: &RawGoal, layout: &mut Layout, diagnostics: &mut Diagnostics) -> Option<Vec<Cell>> {
    let shape = goal.shape.as_ref()?;
    diagnostics.note(&shape.place, layout.cells(&shape.value))
}

/// Compiles the goals in order. A goal is checked only if the previous one could be compiled, because growth
/// starts from the cells that it fills.
fn compile_goals(
    raw: &[RawGoal],
    shapes: &[Option<Vec<Cell>>],
    start: &[Cell],
    diagnostics: &mut Diagnostics,
) -> Vec<Goal> {
    let mut goals: Vec<Goal> = Vec::new();
    let mut volume = 0;
    for (goal, shape) in raw.iter().zip(shapes) {
        let (Some(shape), Some(at)) = (shape, &goal.shape) else { break };
        // A goal has a table with an entry per cell of its bounding box.
        volume += sides(shape.iter()).iter().product::<u64>();
        if volume > MAX_VOLUME {
            diagnostics.add(at.place.clone(), ScenarioError::TooWide(volume));
            break;
        }
        let too_few = |cells| ScenarioError::TooFewModules {
            goal: cells,
            modules: start.len(),
            has_scaffold: goal.growth == Growth::Solid,
        };
        if goal.growth == Growth::Solid && shape.len() > start.len() {
            // Compiling a goal that is too large takes long.
            diagnostics.add(at.place.clone(), too_few(shape.len()));
            break;
        }
        let before = goals.last();
        let occupied = |cell: &Cell| match before {
            None => start.binary_search(cell).is_ok(),
            Some(before) => before.contains(*cell),
        };
        let when = if before.is_none() { "at the start" } else { "by the previous goal" };
        let seed = match (&goal.seed, default_seed(shape, goal.growth, occupied)) {
            (Some(At { value, place }), example) if !occupied(value) => {
                diagnostics.add(place.clone(), ScenarioError::SeedEmpty { seed: *value, when, example });
                break;
            }
            (Some(At { value, .. }), _) => *value,
            (None, Some(cell)) => cell,
            (None, None) => {
                diagnostics.add(at.place.clone(), ScenarioError::NoOverlap { when });
                break;
            }
        };
        let place = goal.seed.as_ref().map_or(&at.place, |s| &s.place);
        let Some(compiled) = diagnostics.note(place, Goal::compile(shape, seed, goal.growth)) else { break };
        if compiled.len() > start.len() {
            diagnostics.add(at.place.clone(), too_few(compiled.len()));
            break;
        }
        goals.push(compiled);
    }
    goals
}

/// Returns the occupied cell of a shape from which its growth fills most of it; of several, the one nearest to the centre of the
/// shape's bounding box.
fn default_seed(shape: &[Cell], growth: Growth, occupied: impl Fn(&Cell) -> bool) -> Option<Cell> {
    let along = |pick: fn(&Cell) -> i16| {
        let coordinates = || shape.iter().map(pick);
        // Twice the centre, which is a whole number.
        i64::from(coordinates().min().unwrap_or(0)) + i64::from(coordinates().max().unwrap_or(0))
    };
    let middle = [along(|c| c.x), along(|c| c.y), along(|c| c.z)];
    let distance = |cell: &Cell| -> i64 {
        let at: [i16; 3] = (*cell).into();
        at.iter().zip(middle).map(|(a, m)| (2 * i64::from(*a) - m).pow(2)).sum()
    };
    let nearest = |of: &dyn Fn(&Cell) -> bool| {
        shape.iter().filter(|c| occupied(c) && of(c)).min_by_key(|c| (distance(c), **c)).copied()
    };
    if growth == Growth::Solid {
        return nearest(&|_| true);
    }
    // A scaffold depends on its seed only by which coordinates are even.
    let parity = |c: &Cell| [c.x, c.y, c.z].map(|at| at.rem_euclid(2));
    let parities = (0..8).map(|bits: i16| [bits & 1, bits >> 1 & 1, bits >> 2]);
    let seeds = parities.filter_map(|of| nearest(&|c| parity(c) == of));
    let filled = |seed: &Cell| Goal::compile(shape, *seed, growth).map_or(0, |goal| goal.len());
    seeds.max_by_key(|seed| (filled(seed), Reverse((distance(seed), *seed))))
}
