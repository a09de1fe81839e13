//! Slab to sphere (thesis 4.1.2) at growing sizes on the simulated link, with all invariants checked, and how
//! time, moves and messages grow with the number of modules.
//!
//! Beside the moves is a lower bound for every protocol (`matching`), computed exactly for each size.
//! Exponents are fits over the measured sizes, also that of the lower bound: they bound nothing.

use super::machine::CpuWatch;
use super::matching::least_moves;
use super::{BenchError, Fit, fit};
use crate::console::format::many;
use crate::console::stopwatch::Stopwatch;
use crate::console::terminal::Live;
use crate::family::cube::Cubes;
use crate::family::{read_text, simulate};
use crate::scenario::{LinkKind, Overrides, Plan};
use metamorph_protocol::lattice::Cell;
use serde::Serialize;
use std::collections::BTreeMap;

/// Modules along a side of the slab.
const SIDES: [u16; 6] = [10, 20, 30, 50, 70, 100];

/// The results for all sizes.
#[derive(Debug, Serialize)]
pub struct Growth {
    /// A row for each size.
    pub rows: Vec<Row>,
    /// Growth of the scenario time until the ball is complete.
    pub makespan: Option<Fit>,
    /// Growth of the moves.
    pub moves: Option<Fit>,
    /// Growth of the lower bound of the moves over these sizes. The fit itself is not a bound.
    pub least_moves: Option<Fit>,
    /// Growth of the messages.
    pub messages: Option<Fit>,
}

/// The result for one size.
#[derive(Debug, Serialize)]
pub struct Row {
    /// Modules of the slab, and cells of the goal.
    pub modules: u64,
    pub goal: u64,
    /// The outcome, and the number of violations.
    pub outcome: String,
    pub violations: u64,
    /// Scenario seconds until the last cell was filled; a move takes one second.
    pub makespan_s: f64,
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

/// Measures all sizes up to `most` modules.
pub fn measure(most: u64, live: &mut Live) -> Result<Growth, BenchError> {
    let mut rows = Vec::new();
    for side in SIDES.into_iter().filter(|side| u64::from(*side).pow(2) <= most) {
        rows.push(row(side, live)?);
    }
    let grows = |f: fn(&Row) -> f64| fit(&rows.iter().map(|r| (r.modules as f64, f(r))).collect::<Vec<_>>());
    Ok(Growth {
        makespan: grows(|r| r.makespan_s),
        moves: grows(|r| r.moves as f64),
        least_moves: grows(|r| r.least_moves as f64),
        messages: grows(|r| r.messages as f64),
        rows,
    })
}

/// Returns a scenario with a slab and a ball.
fn scenario(side: u16, half_cells: u32) -> String {
    let (last, middle) = (side - 1, side / 2);
    let radius = f64::from(half_cells) / 2.0;
    format!(
        "version = 1\nseed = 1\n\
         [swarm]\nstart = {{ box = {{ min = [0, 0, 0], max = [{last}, {last}, 0] }} }}\nmove_time = \"1s\"\n\
         [[goal]]\nshape = {{ sphere = {{ center = [{middle}, {middle}, 0], radius = {radius:.1} }} }}\n\
         seed = [{middle}, {middle}, 0]\n\
         [link]\ndelay = \"50ms..200ms\"\n\
         [stop]\ntimeout = \"20000s\"\n"
    )
}

fn cubes(plan: &Plan) -> Result<&Cubes, BenchError> {
    plan.swarm.of().ok_or_else(|| BenchError::Wrong("the scenario is not one of cubes".to_owned()))
}

/// Measures the largest ball of at most three quarters of the modules of a slab.
fn row(side: u16, live: &mut Live) -> Result<Row, BenchError> {
    let modules = u64::from(side).pow(2);
    let overrides = Overrides { link: LinkKind::Sim, ..Overrides::default() };
    let plan_of = |half_cells| {
        let plan = read_text("bench", &scenario(side, half_cells), &overrides)
            .map_err(|diagnostics| BenchError::Wrong(diagnostics.to_string()))?;
        let goal = cubes(&plan)?.setup.goals.first().map_or(0, |g| g.len() as u64);
        Ok::<_, BenchError>((goal, plan))
    };
    let mut best = plan_of(2)?;
    // A scaffold fills half of a ball, so the cube root of the modules exceeds any radius. Balls that are too
    // thin somewhere are skipped.
    for half_cells in (3..).take_while(|h| u64::from(*h).pow(3) <= 8 * modules) {
        if let Ok(larger) = plan_of(half_cells)
            && larger.0 * 4 <= modules * 3
        {
            best = larger;
        }
    }
    let (goal, plan) = best;
    let Cubes { cells, setup } = cubes(&plan)?;
    let cells_of_goal: Vec<Cell> = setup.goals.first().map_or(Vec::new(), |g| g.cells().collect());
    let least_moves = least_moves(cells, &cells_of_goal)
        .ok_or_else(|| BenchError::Wrong("the goal has too many cells".to_owned()))?;
    let watch = CpuWatch::start();
    let (report, _) = simulate(&plan, Stopwatch::start(), &mut |now, so_far| {
        live.show(|| {
            let so_far = crate::report::progress(&plan, now, &so_far());
            format!("growth of {}: {so_far}", many(modules, "module"))
        });
        true
    });
    live.clear();
    let by_class = report.messages.by_class.iter().map(|(class, c)| (class.clone(), c.sent)).collect();
    Ok(Row {
        modules,
        goal,
        outcome: report.outcome.clone(),
        violations: report.invariants.broken,
        makespan_s: report.stages.first().and_then(|s| s.built_s).unwrap_or(report.time.virtual_s),
        moves: report.moves,
        least_moves,
        times_least: report.moves as f64 / least_moves.max(1) as f64,
        messages: report.messages.all.sent,
        by_class,
        messages_per_move: report.messages.all.sent as f64 / report.moves.max(1) as f64,
        cpu_s: watch.elapsed().as_secs_f64(),
        trace_hash: report.trace_hash.clone().unwrap_or_default(),
    })
}
