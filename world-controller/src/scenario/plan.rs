//! From a scenario as written to a plan that can be run: every check that needs more than one value.

use super::faults::{self, Bounds};
use super::flaw::{Flaw, LONGEST, MAX_MODULES, MAX_VOLUME, SHORTEST};
use super::problems::{At, Place, Problems};
use super::raw::{Raw, RawGoal, default_delay};
use super::shapes::lay_out;
use super::table::Delay;
use super::{LinkKind, Overrides, Plan, StagePlan};
use metamorph_protocol::cube::params::{Params, Setup};
use metamorph_protocol::goal::Goal;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::shape::components;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::director::Stop;
use std::sync::Arc;

/// Scenario seconds per second on the process link, if the scenario does not say.
const TIME_SCALE: f64 = 20.0;

/// Checks everything and makes the plan. Without one there is at least one problem.
pub fn make(raw: &Raw, overrides: &Overrides, problems: &mut Problems) -> Option<Plan> {
    let move_time =
        bounded(&raw.move_time, "move_time", SHORTEST, LONGEST, problems).unwrap_or(Span::secs(1));
    let cells = start_cells(raw, problems);
    let shapes: Vec<Option<Vec<Cell>>> = raw.goals.iter().map(|goal| goal_cells(goal, problems)).collect();
    let sides = check_box(cells.iter().flatten().chain(shapes.iter().flatten().flatten()), problems)?;
    let goals = match &cells {
        Some(cells) => compile_goals(&raw.goals, &shapes, cells, problems),
        None => Vec::new(),
    };
    let mut stop = stop(raw, move_time, sides, raw.goals.len(), problems);
    let modules = cells.as_ref().map_or(0, Vec::len);
    let (mut link, usual_delay) = link(raw, overrides.link, move_time, problems);
    let mut schedule = Default::default();
    if modules > 0 {
        let bounds = Bounds { modules, timeout: stop.timeout.since(Time::ZERO), seed: raw.seed };
        (schedule, link.partitions) = faults::compile(&raw.faults, &bounds, problems);
        stop.planned_until = link.partitions.iter().map(|p| p.until).max().unwrap_or(Time::ZERO);
    }
    let time_scale = time_scale(raw, problems);
    if !problems.is_empty() {
        return None;
    }
    let range = u16::try_from(sides * 4).unwrap_or(u16::MAX).min(60_000);
    let params = Params {
        connectivity: raw.connectivity,
        co_owners: raw.co_owners,
        ..Params::scaled(move_time, usual_delay, range)
    };
    let names = |(i, goal): (usize, &RawGoal)| goal.name.clone().unwrap_or_else(|| format!("goal {}", i + 1));
    Some(Plan {
        name: raw.name.clone(),
        description: raw.description.clone(),
        origin: String::new(),
        text: Arc::from(""),
        overrides: overrides.clone(),
        seed: raw.seed,
        cells: cells?,
        stages: raw.goals.iter().enumerate().map(names).map(|name| StagePlan { name }).collect(),
        setup: Arc::new(Setup { params, goals }),
        link,
        failure: raw.failed_connections.as_ref().map_or(Ratio::ZERO, |f| f.value),
        schedule,
        stop,
        time_scale,
    })
}

fn bounded(
    span: &Option<At<Span>>,
    what: &'static str,
    low: Span,
    high: Span,
    problems: &mut Problems,
) -> Option<Span> {
    let At { value, place } = span.as_ref()?;
    if (low..=high).contains(value) {
        return Some(*value);
    }
    let flaw = Flaw::Range { what, got: value.to_string(), low: low.to_string(), high: high.to_string() };
    problems.add(place.clone(), flaw);
    None
}

fn start_cells(raw: &Raw, problems: &mut Problems) -> Option<Vec<Cell>> {
    let start = raw.start.as_ref()?;
    let cells = problems.note(&start.place, lay_out(&start.value))?;
    if cells.len() > MAX_MODULES {
        problems.add(start.place.clone(), Flaw::TooMany(cells.len()));
        return None;
    }
    let parts = components(&cells);
    if parts.len() > 1 {
        let examples: Vec<String> = parts.iter().take(4).map(|part| part[0].to_string()).collect();
        let mut examples = examples.join(", ");
        if parts.len() > 4 {
            examples.push_str(", …");
        }
        problems.add(start.place.clone(), Flaw::DisconnectedStart { count: parts.len(), examples });
    }
    Some(cells)
}

fn goal_cells(goal: &RawGoal, problems: &mut Problems) -> Option<Vec<Cell>> {
    let shape = goal.shape.as_ref()?;
    problems.note(&shape.place, lay_out(&shape.value))
}

/// The sum of the sides of the box around all cells; none if that box is too large to keep in memory.
fn check_box<'c>(cells: impl Iterator<Item = &'c Cell>, problems: &mut Problems) -> Option<u64> {
    let mut bounds: Option<([i16; 3], [i16; 3])> = None;
    for cell in cells {
        let at: [i16; 3] = (*cell).into();
        let (min, max) = bounds.get_or_insert((at, at));
        for axis in 0..3 {
            min[axis] = min[axis].min(at[axis]);
            max[axis] = max[axis].max(at[axis]);
        }
    }
    let (min, max) = bounds.unwrap_or_default();
    let side = |axis: usize| u64::from(max[axis].abs_diff(min[axis])) + 1;
    let volume = side(0) * side(1) * side(2);
    if volume > MAX_VOLUME {
        problems.add(Place::File, Flaw::TooWide(volume));
        return None;
    }
    Some(side(0) + side(1) + side(2))
}

/// Compiles one goal after the other. A goal is judged only if the one before could be compiled,
/// because growth begins from what that one leaves behind.
fn compile_goals(
    raw: &[RawGoal],
    shapes: &[Option<Vec<Cell>>],
    start: &[Cell],
    problems: &mut Problems,
) -> Vec<Goal> {
    let mut goals: Vec<Goal> = Vec::new();
    for (goal, shape) in raw.iter().zip(shapes) {
        let (Some(shape), Some(at)) = (shape, &goal.shape) else { break };
        let before = goals.last();
        let occupied = |cell: &Cell| match before {
            None => start.binary_search(cell).is_ok(),
            Some(before) => before.contains(*cell),
        };
        let when = if before.is_none() { "at the start" } else { "by the goal before" };
        let middle = nearest_to_middle(shape, occupied);
        let seed = match (&goal.seed, middle) {
            (Some(At { value, place }), example) if !occupied(value) => {
                problems.add(place.clone(), Flaw::SeedEmpty { seed: *value, when, example });
                break;
            }
            (Some(At { value, .. }), _) => *value,
            (None, Some(cell)) => cell,
            (None, None) => {
                problems.add(at.place.clone(), Flaw::NoOverlap { when });
                break;
            }
        };
        let place = goal.seed.as_ref().map_or(&at.place, |s| &s.place);
        let Some(compiled) = problems.note(place, Goal::compile(shape, seed, goal.growth)) else { break };
        if compiled.len() > start.len() {
            let flaw = Flaw::TooFewModules { goal: compiled.len(), modules: start.len() };
            problems.add(at.place.clone(), flaw);
        }
        goals.push(compiled);
    }
    goals
}

/// The occupied cell of a shape that is nearest to the middle of the box around it.
fn nearest_to_middle(shape: &[Cell], occupied: impl Fn(&Cell) -> bool) -> Option<Cell> {
    let along = |pick: fn(&Cell) -> i16| {
        let coordinates = || shape.iter().map(pick);
        // Twice the middle, which is a whole number.
        i64::from(coordinates().min().unwrap_or(0)) + i64::from(coordinates().max().unwrap_or(0))
    };
    let middle = [along(|c| c.x), along(|c| c.y), along(|c| c.z)];
    let distance = |cell: &Cell| -> i64 {
        let at: [i16; 3] = (*cell).into();
        at.iter().zip(middle).map(|(a, m)| (2 * i64::from(*a) - m).pow(2)).sum()
    };
    shape.iter().filter(|c| occupied(c)).min_by_key(|c| (distance(c), **c)).copied()
}

/// When the run ends. The bounds grow with the body, because a module may have to walk all around
/// it before the next cell is filled: standing still for three diameters at 2.4 moves a cell.
fn stop(raw: &Raw, move_time: Span, sides: u64, goals: usize, problems: &mut Problems) -> Stop {
    let long = Span(u64::MAX / 4);
    let mut get = |span, what, default| bounded(span, what, Span(1), long, problems).unwrap_or(default);
    let stall = get(&raw.stall, "stall", move_time * (sides * 3 * 12 / 5).max(300));
    let livelock = get(&raw.livelock, "livelock", stall * 4);
    let timeout = get(&raw.timeout, "timeout", livelock * (3 * goals.max(1) as u64));
    Stop { timeout: Time::ZERO + timeout, stall, livelock, planned_until: Time::ZERO }
}

fn link(raw: &Raw, kind: LinkKind, move_time: Span, problems: &mut Problems) -> (LinkModel, Span) {
    if let Some(At { value: Delay(_, max), place }) = &raw.link.delay {
        bounded(&Some(At::new(*max, place.clone())), "the delay", Span::ZERO, LONGEST, problems);
    }
    let written = raw.link.delay.as_ref().map(|d| d.value);
    let Delay(delay_min, delay_max) = written.unwrap_or_else(|| default_delay(kind, move_time));
    let Delay(_, usual) = written.unwrap_or_else(|| default_delay(LinkKind::Sim, move_time));
    let ratio = |r: &Option<At<Ratio>>| r.as_ref().map_or(Ratio::ZERO, |r| r.value);
    let model = LinkModel {
        delay_min,
        delay_max,
        loss: ratio(&raw.link.loss),
        duplicate: ratio(&raw.link.duplicate),
        reorder: ratio(&raw.link.reorder),
        corrupt: ratio(&raw.link.corrupt),
        partitions: Vec::new(),
    };
    (model, usual)
}

fn time_scale(raw: &Raw, problems: &mut Problems) -> f64 {
    let Some(At { value, place }) = &raw.time_scale else { return TIME_SCALE };
    let (low, high) = (0.001, 10_000.0);
    if !(low..=high).contains(value) {
        let (low, high) = (low.to_string(), high.to_string());
        problems.add(place.clone(), Flaw::Range { what: "time_scale", got: value.to_string(), low, high });
    }
    *value
}
