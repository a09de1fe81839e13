//! Bodies of cubes that grow from others at growing sizes on the simulated link, with all invariants checked, and how
//! time, moves and messages grow with the size: slab to sphere (thesis 4.1.2), and pyramids upon plates, which the parallel
//! construction of Thalamy, Piranda, Lassabe and Bourgeois builds (2019, "Scaffold-Based Asynchronous Distributed
//! Self-Reconfiguration By Continuous Module Flow").
//!
//! Beside moves and time are lower bounds for every protocol (`matching`, `bottleneck`), computed exactly for each size.
//! Exponents are fits over the measured sizes, also those of the lower bounds: they bound nothing. The bounds of a large size take
//! as long as its run, so a run is told before they are computed.

use super::BenchError;
use super::bottleneck::least_move_times;
use super::machine::CpuWatch;
use super::matching::least_moves;
use super::walking::{Walking, WalkingCounts};
use metamorph_console::terminal::Live;
use metamorph_families::cube::Cubes;
use metamorph_families::runnable::Runnable;
use metamorph_families::simulated::simulation;
use metamorph_processes::family::read_text;
use metamorph_protocol::coverage;
use metamorph_protocol::lattice::Cell;
use metamorph_report::statistics::PowerLaw;
use metamorph_scenario::{LinkKind, Overrides, Plan};
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_sim_bridge::director::progress::Progress;
use metamorph_text::format::{digits, many};
use serde::Serialize;
use std::collections::BTreeMap;

/// The radius of the smallest ball, in half cells.
const SMALLEST: u32 = 2;

/// Goal of the growth and the body it starts from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Shape {
    /// A ball, in scaffold growth, from a slab of one layer.
    Ball,
    /// A pyramid, in scaffold growth, from a plate as wide as its base.
    SolidPlate,
    /// The same from a plate that is a scaffold itself: bars along the three axes, with tunnels in between.
    PorousPlate,
}

impl Shape {
    /// Returns its sizes: modules along a side of the slab, or layers of the pyramid and of the plate.
    fn sizes(self) -> &'static [(u16, u16)] {
        match self {
            Shape::Ball => &[(10, 1), (20, 1), (30, 1), (50, 1), (70, 1), (100, 1)],
            Shape::SolidPlate => &[(5, 3), (9, 3), (15, 6)],
            Shape::PorousPlate => &[(5, 5), (9, 7), (15, 11), (21, 15)],
        }
    }

    /// Returns the number by which the size is measured when growth is fitted.
    pub fn size(self, row: &Row) -> u64 {
        if self == Shape::Ball { row.modules } else { row.goal }
    }
}

/// The results for all sizes.
#[derive(Debug, Serialize)]
pub struct Growth {
    /// Goal and initial body. Growth is fitted over the modules of a slab, and over the goal cells of a pyramid.
    pub shape: Shape,
    /// A row for each size.
    pub rows: Vec<Row>,
    /// Growth of the scenario time until the goal is complete.
    pub makespan: Option<PowerLaw>,
    /// Growth of the moves.
    pub moves: Option<PowerLaw>,
    /// Growth of the lower bound of the moves over these sizes. The fit itself is not a bound.
    pub least_moves: Option<PowerLaw>,
    /// Growth of the messages.
    pub messages: Option<PowerLaw>,
}

/// The result for one size.
#[derive(Debug, Serialize)]
pub struct Row {
    /// Modules at the start, cells of the goal, and its layers.
    pub modules: u64,
    pub goal: u64,
    pub layers: u64,
    /// The sum of the sides of the box around start and goal, in cells.
    pub box_sides: u64,
    /// The outcome, and the number of violations.
    pub outcome: String,
    pub violations: u64,
    /// Scenario seconds until the last cell was filled, and their lower bound: the bottleneck of the best assignment of cubes
    /// to goal cells. A move takes one second.
    pub makespan_s: f64,
    pub least_makespan_s: u64,
    /// How freely modules walk.
    pub walking: Walking,
    /// Moves completed, and their lower bound: the cost of the best assignment of cubes to goal cells.
    pub moves: u64,
    pub least_moves: u64,
    /// Moves divided by the lower bound.
    pub times_least: f64,
    /// Messages sent, in all and by class.
    pub messages: u64,
    pub by_class: BTreeMap<String, u64>,
    pub messages_per_move: f64,
    /// Processor time of the run in seconds.
    pub cpu_s: f64,
    pub trace_hash: String,
}

/// Measures all sizes of a shape with up to `most` modules, with one seed. `tell` is handed each run as soon as it has ended.
pub fn measure(
    shape: Shape,
    (most, seed): (u64, u64),
    live: &mut Live,
    tell: &dyn Fn(&Run),
) -> Result<Growth, BenchError> {
    let mut rows = Vec::new();
    for size in shape.sizes() {
        let plan = match shape {
            Shape::Ball => read(&ball(size.0, SMALLEST), seed)?,
            Shape::SolidPlate | Shape::PorousPlate => read(&pyramid(shape, *size), seed)?,
        };
        if cubes(&plan)?.cells.len() as u64 <= most {
            let plan = if shape == Shape::Ball { largest_ball(size.0, plan)? } else { plan };
            rows.push(row(&plan, live, tell)?);
        }
    }
    let grows = |f: fn(&Row) -> f64| {
        PowerLaw::of(&rows.iter().map(|r| (shape.size(r) as f64, f(r))).collect::<Vec<_>>())
    };
    Ok(Growth {
        shape,
        makespan: grows(|r| r.makespan_s),
        moves: grows(|r| r.moves as f64),
        least_moves: grows(|r| r.least_moves as f64),
        messages: grows(|r| r.messages as f64),
        rows,
    })
}

/// Returns a scenario with a start, a goal and its seed.
fn scenario(start: &str, goal: &str, seed: [u16; 3]) -> String {
    format!(
        "version = 1\n\
         [swarm]\nstart = {start}\nmove_time = \"1s\"\n\
         [[goal]]\nshape = {goal}\nseed = {seed:?}\ngrowth = \"scaffold\"\n\
         [link]\ndelay = \"50ms..200ms\"\n\
         [stop]\ntimeout = \"20000s\"\n"
    )
}

/// Returns the shape of a box.
fn block(min: [u16; 3], max: [u16; 3]) -> String {
    format!("{{ box = {{ min = {min:?}, max = {max:?} }} }}")
}

/// Returns the shape of several.
fn union(parts: impl Iterator<Item = String>) -> String {
    format!("{{ union = [{}] }}", parts.collect::<Vec<_>>().join(", "))
}

/// Returns a scenario with a slab and a ball.
fn ball(side: u16, half_cells: u32) -> String {
    let (last, middle) = (side - 1, side / 2);
    let radius = f64::from(half_cells) / 2.0;
    let sphere = format!("{{ sphere = {{ center = [{middle}, {middle}, 0], radius = {radius:.1} }} }}");
    scenario(&block([0, 0, 0], [last, last, 0]), &sphere, [middle, middle, 0])
}

/// Returns a scenario with a plate and a pyramid. The lowest layer of the pyramid is the highest of the plate; each layer is
/// two cells narrower than the one below.
fn pyramid(shape: Shape, (layers, thick): (u16, u16)) -> String {
    let (last, top) = (2 * layers - 2, thick - 1);
    let plate = if shape == Shape::SolidPlate {
        block([0, 0, 0], [last, last, top])
    } else {
        let even = |end: u16| (0..=end).step_by(2);
        let crossing = |a: u16, b: u16| even(a).flat_map(move |a| even(b).map(move |b| (a, b)));
        let columns = crossing(last, last).map(|(x, y)| block([x, y, 0], [x, y, top]));
        let along_x = crossing(last, top).map(|(y, z)| block([0, y, z], [last, y, z]));
        let along_y = crossing(last, top).map(|(x, z)| block([x, 0, z], [x, last, z]));
        union(columns.chain(along_x).chain(along_y))
    };
    let goal = (0..layers).map(|k| block([k, k, top + k], [last - k, last - k, top + k]));
    scenario(&plate, &union(goal), [layers - 1, layers - 1, top])
}

fn read(text: &str, seed: u64) -> Result<Plan, BenchError> {
    let overrides = Overrides { link: LinkKind::Sim, seed: Some(seed), ..Overrides::default() };
    read_text("bench", text, &overrides).map_err(|diagnostics| BenchError::Wrong(diagnostics.to_string()))
}

/// Returns the scenario with the largest ball of at most three quarters of the modules of a slab; `best` has the smallest.
fn largest_ball(side: u16, mut best: Plan) -> Result<Plan, BenchError> {
    let modules = u64::from(side).pow(2);
    // A scaffold fills half of a ball, so the cube root of the modules exceeds any radius. Balls that are too
    // thin somewhere are skipped.
    for half_cells in (SMALLEST + 1..).take_while(|h| u64::from(*h).pow(3) <= 8 * modules) {
        if let Ok(larger) = read(&ball(side, half_cells), best.seed)
            && goal_cells(&larger)?.len() as u64 * 4 <= modules * 3
        {
            best = larger;
        }
    }
    Ok(best)
}

fn cubes(plan: &Plan) -> Result<&Cubes, BenchError> {
    plan.swarm.of().ok_or_else(|| BenchError::Wrong("the scenario is not one of cubes".to_owned()))
}

fn goal_cells(plan: &Plan) -> Result<Vec<Cell>, BenchError> {
    Ok(cubes(plan)?.setup.goals.first().map_or(Vec::new(), |g| g.cells().collect()))
}

/// Returns the length of the cells along an axis.
fn extent<'a>(cells: impl Iterator<Item = &'a Cell>, axis: fn(&Cell) -> i16) -> u64 {
    let range = cells.map(axis).fold(None, |range, at| {
        let (low, high) = range.unwrap_or((at, at));
        Some((at.min(low), at.max(high)))
    });
    range.map_or(0, |(low, high)| u64::from(high.abs_diff(low)) + 1)
}

/// The result of one run, before its lower bounds are known.
pub struct Run {
    pub modules: u64,
    pub outcome: String,
    pub violations: u64,
    pub makespan_s: f64,
    pub walking: Walking,
    pub moves: u64,
    pub messages: u64,
    pub by_class: BTreeMap<String, u64>,
    pub cpu_s: f64,
    pub trace_hash: String,
}

impl Run {
    /// Returns the messages for each move.
    pub fn messages_per_move(&self) -> f64 {
        self.messages as f64 / self.moves.max(1) as f64
    }
}

/// Carries out one run.
fn run(plan: &Plan, live: &mut Live) -> Result<Run, BenchError> {
    let modules = cubes(plan)?.cells.len() as u64;
    coverage::take();
    let (watch, mut sim, mut counts) =
        (CpuWatch::start(), simulation::<Cubes>(plan), WalkingCounts::default());
    let time_step = cubes(plan)?.time_step();
    while !sim.run_until(sim.now() + time_step) {
        counts.look_at(sim.agents().iter().map(|(_, cube)| cube));
        live.show(|| {
            let messages = Some(sim.tally().total().sent);
            let so_far = Progress { messages, ..Cubes::progress(sim.director()) };
            let so_far = metamorph_report::progress(plan, sim.now(), &so_far);
            format!("growth of {}: {so_far}", many(modules, "module"))
        });
    }
    live.clear();
    let monitor = sim.director().monitor();
    let outcome = monitor.outcome().map_or(Outcome::Aborted, |(_, outcome)| outcome);
    let built = sim.director().stages().first().and_then(|stage| stage.built);
    let moves = sim.world().motions().completed;
    Ok(Run {
        modules,
        outcome: outcome.name().to_owned(),
        violations: sim.violations().1,
        makespan_s: built.unwrap_or(sim.now()).as_secs_f64(),
        walking: counts.walking(moves),
        moves,
        messages: sim.tally().total().sent,
        by_class: sim.tally().iter().map(|(class, c)| (class.name().to_owned(), c.sent)).collect(),
        cpu_s: watch.elapsed().as_secs_f64(),
        trace_hash: digits(sim.trace().value()),
    })
}

/// Measures one run, tells of it, and computes its lower bounds.
fn row(plan: &Plan, live: &mut Live, tell: &dyn Fn(&Run)) -> Result<Row, BenchError> {
    let run = run(plan, live)?;
    tell(&run);
    let (cells, goal) = (&cubes(plan)?.cells, goal_cells(plan)?);
    let too_many = || BenchError::Wrong("the goal has too many cells".to_owned());
    let least_moves = least_moves(cells, &goal).ok_or_else(too_many)?;
    let least_makespan_s = least_move_times(cells, &goal).ok_or_else(too_many)?;
    let axes: [fn(&Cell) -> i16; 3] = [|c| c.x, |c| c.y, |c| c.z];
    Ok(Row {
        modules: run.modules,
        goal: goal.len() as u64,
        layers: extent(goal.iter(), |c| c.z),
        box_sides: axes.map(|axis| extent(cells.iter().chain(&goal), axis)).iter().sum(),
        messages_per_move: run.messages_per_move(),
        outcome: run.outcome,
        violations: run.violations,
        makespan_s: run.makespan_s,
        least_makespan_s,
        walking: run.walking,
        moves: run.moves,
        least_moves,
        times_least: run.moves as f64 / least_moves.max(1) as f64,
        messages: run.messages,
        by_class: run.by_class,
        cpu_s: run.cpu_s,
        trace_hash: run.trace_hash,
    })
}
