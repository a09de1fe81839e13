//! Experiments of the size of the thesis's, as lists of single runs: the published one, and many samples of
//! our runs. A statement about 84 runs is judged by how often 84 of ours show it, not by what thousands of
//! ours can distinguish.

use super::Goal;
use super::compare::Runs;
use super::published::{KINDS, STRATEGIES, Table};
use metamorph_experiments::sweep::summary::Combination;
use metamorph_protocol::metamodule::blueprint::SeedOrder;
use metamorph_protocol::metamodule::params::Strategy;
use metamorph_protocol::rng::Rng;
use metamorph_protocol::roombots::Kind;
use metamorph_report::statistics::Spread;
use metamorph_sim_bridge::director::outcome::Outcome;

/// Number of experiments sampled.
pub const DRAWS: u64 = 2_000;

/// One run of an experiment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Run {
    /// Its goal.
    pub goal: Goal,
    /// Its kind of metamodules.
    pub kind: Kind,
    /// Its strategy.
    pub strategy: Strategy,
    /// The order of the seeds; unknown for the runs of the thesis.
    pub order: Option<SeedOrder>,
    /// True if the goal was built.
    pub built: bool,
    /// Its collisions, if it was built.
    pub collisions: Option<f64>,
    /// Its moves, if it was built; the thesis has no numbers.
    pub moves: Option<f64>,
}

/// Returns the runs of a published table.
pub fn published(goal: Goal, table: &Table) -> Vec<Run> {
    let mut runs = Vec::new();
    for kind in KINDS {
        for strategy in STRATEGIES {
            runs.extend(table.cells(kind, strategy).into_iter().map(|cell| Run {
                goal,
                kind,
                strategy,
                order: None,
                built: !cell.deadlock,
                collisions: (!cell.deadlock).then(|| f64::from(cell.collisions)),
                moves: None,
            }));
        }
    }
    runs
}

/// Our runs of one goal, kind and strategy, by order.
struct Source<'a> {
    goal: Goal,
    kind: Kind,
    strategy: Strategy,
    orders: Vec<(SeedOrder, &'a Combination)>,
}

/// Samples experiments with as many runs of each goal, kind and strategy as the thesis has; each run draws
/// its order, whether it is built, and its moves and collisions. Empty if some runs are missing.
pub fn draw(runs: &Runs) -> Vec<Vec<Run>> {
    let mut sources = Vec::new();
    for (goal, summary) in &runs.of {
        for kind in KINDS {
            for strategy in STRATEGIES {
                let of = |order: SeedOrder| {
                    let values = [kind.name(), strategy.name(), order.name()];
                    let found = summary.combinations.iter().find(|c| c.values == values)?;
                    (found.runs > 0).then_some((order, found))
                };
                let orders: Vec<_> = SeedOrder::ALL.into_iter().filter_map(of).collect();
                sources.push(Source { goal: *goal, kind, strategy, orders });
            }
        }
    }
    if sources.iter().any(|s| s.orders.is_empty()) {
        return Vec::new();
    }
    (0..DRAWS).map(|i| experiment(&sources, &mut Rng::named(0, "experiment", i))).collect()
}

fn experiment(sources: &[Source<'_>], stream: &mut Rng) -> Vec<Run> {
    let mut runs = Vec::new();
    for Source { goal, kind, strategy, orders } in sources {
        for _ in 0..goal.table().cells(*kind, *strategy).len() {
            let (order, from) = orders[stream.below(orders.len() as u64) as usize];
            let built = stream.below(from.runs) < from.ended(Outcome::Built);
            let mut one = |of: Option<Spread>| of.filter(|_| built).map(|s| value(&s, stream));
            let (collisions, moves) = (one(from.collisions), one(from.moves));
            let (goal, kind, strategy, order) = (*goal, *kind, *strategy, Some(order));
            runs.push(Run { goal, kind, strategy, order, built, collisions, moves });
        }
    }
    runs
}

/// Draws a value with this spread, by linear interpolation between the known quantiles.
fn value(spread: &Spread, stream: &mut Rng) -> f64 {
    const STEPS: u64 = 1_000;
    let at = stream.below(STEPS) as f64 / STEPS as f64;
    let s = spread;
    let known = [(0.0, s.min), (0.05, s.p5), (0.25, s.q1), (0.5, s.median), (0.75, s.q3), (0.95, s.p95)];
    let upper = known.iter().position(|(q, _)| *q > at);
    let (low, value) = known[upper.unwrap_or(known.len()) - 1];
    let (high, next) = upper.map_or((1.0, s.max), |i| known[i]);
    value + (next - value) * (at - low) / (high - low)
}
