//! Slab to sphere (thesis 4.1.2) at growing sizes on the simulated link, with all invariants checked,
//! and how time, moves and messages grow with the number of modules.
//!
//! Beside the moves stands a number that no protocol can go below: a move changes no coordinate by
//! more than one cell, so whatever has to come closer to the seed crosses every cube around it.

use super::machine::CpuWatch;
use super::{BenchError, Fit, fit};
use crate::scenario::{LinkKind, Overrides, Swarm, read_text};
use crate::simulated::simulate;
use crate::stopwatch::Stopwatch;
use crate::terminal::Live;
use crate::wording::many;
use metamorph_protocol::lattice::Cell;
use serde::Serialize;
use std::collections::BTreeMap;

/// Modules along a side of the slab.
const SIDES: [u16; 6] = [10, 20, 30, 50, 70, 100];

/// What all sizes came to.
#[derive(Debug, Serialize)]
pub struct Growth {
    /// A row for each size.
    pub rows: Vec<Row>,
    /// How the scenario time until the ball stands grows with the number of modules.
    pub makespan: Option<Fit>,
    /// How the moves grow.
    pub moves: Option<Fit>,
    /// How the least number of moves grows.
    pub least_moves: Option<Fit>,
    /// How the messages grow.
    pub messages: Option<Fit>,
}

/// One size.
#[derive(Debug, Serialize)]
pub struct Row {
    /// Modules of the slab, and cells of the goal.
    pub modules: u64,
    pub goal: u64,
    /// How it ended, and how many invariants broke.
    pub outcome: String,
    pub violations: u64,
    /// Scenario seconds until the last cell was filled; a move takes one.
    pub makespan_s: f64,
    /// Moves completed, and a number that they cannot be below.
    pub moves: u64,
    pub least_moves: u64,
    /// Messages sent, and the same by class.
    pub messages: u64,
    pub by_class: BTreeMap<String, u64>,
    pub messages_per_move: f64,
    /// Processor time of the run in seconds.
    pub cpu_s: f64,
    pub trace_hash: String,
}

/// All sizes up to `most` modules.
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

/// A slab and a ball.
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

/// The largest ball of at most three quarters of the modules of a slab.
fn row(side: u16, live: &mut Live) -> Result<Row, BenchError> {
    let modules = u64::from(side).pow(2);
    let overrides = Overrides { link: LinkKind::Sim, ..Overrides::default() };
    let plan_of = |half_cells| {
        let plan = read_text("bench", &scenario(side, half_cells), &overrides)
            .map_err(|problems| BenchError::Wrong(problems.to_string()))?;
        match &plan.swarm {
            Swarm::Cubes(cubes) => {
                let goal = cubes.setup.goals.first().map_or(0, |g| g.len() as u64);
                Ok((goal, least_moves(&cubes.cells, &cubes.setup.goals[0]), plan))
            }
            Swarm::Metamodules(_) => Err(BenchError::Wrong("the scenario is not one of cubes".to_owned())),
        }
    };
    let mut best = plan_of(2)?;
    // A scaffold fills half of a ball, so that a radius of the cube root of the modules is too large.
    // One that is too thin somewhere is passed over.
    for half_cells in (3..).take_while(|h| u64::from(*h).pow(3) <= 8 * modules) {
        if let Ok(larger) = plan_of(half_cells)
            && larger.0 * 4 <= modules * 3
        {
            best = larger;
        }
    }
    let (goal, least_moves, plan) = best;
    let watch = CpuWatch::start();
    let report = simulate(&plan, Stopwatch::start(), |now, so_far| {
        live.show(|| {
            let so_far = crate::report::progress(&plan, now, &so_far());
            format!("growth of {}: {so_far}", many(modules as u64, "module"))
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
        messages: report.messages.all.sent,
        by_class,
        messages_per_move: report.messages.all.sent as f64 / report.moves.max(1) as f64,
        cpu_s: watch.elapsed().as_secs_f64(),
        trace_hash: report.trace_hash.clone().unwrap_or_default(),
    })
}

/// How often somebody at least has to cross a cube around the seed: for each cube, the goal cells
/// within it that those who are within it already cannot fill.
fn least_moves(start: &[Cell], goal: &metamorph_protocol::goal::Goal) -> u64 {
    let seed = goal.seed();
    let radius = |c: Cell| {
        let far = [c.x.abs_diff(seed.x), c.y.abs_diff(seed.y), c.z.abs_diff(seed.z)];
        usize::from(far.into_iter().max().unwrap_or(0))
    };
    let mut missing: BTreeMap<usize, i64> = BTreeMap::new();
    for cell in goal.cells() {
        *missing.entry(radius(cell)).or_default() += 1;
    }
    for cell in start {
        *missing.entry(radius(*cell)).or_default() -= 1;
    }
    let outermost = missing.keys().last().copied().unwrap_or(0);
    let (mut within, mut crossings) = (0, 0);
    for r in 0..=outermost {
        within += missing.get(&r).copied().unwrap_or(0);
        crossings += within.max(0) as u64;
    }
    crossings
}
