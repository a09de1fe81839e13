//! The strategy `planned` beside those by which each metamodule decides for itself, on the thesis's experiment
//! (4.1.3), also with connections that fail (4.2.3) and with a crash.

use super::PlannerTable;
use crate::error::ReproduceError;
use crate::published::KINDS;
use crate::{Experiment, Goal, Request};
use metamorph_console::interrupt::Interrupt;
use metamorph_experiments::sweep::summary::Combination;
use metamorph_experiments::sweep::{Progress, Scenario, run};
use metamorph_protocol::metamodule::params::Strategy;
use metamorph_report::statistics::Spread;
use metamorph_scenario::Overrides;
use metamorph_scenario::grid::{Axis, Grid, Seeds};
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_text::format::count;

/// A condition of the runs.
struct Condition {
    name: &'static str,
    /// Keys of the scenario with their values.
    keys: &'static [(&'static str, &'static str)],
    /// True if one of the metamodules crashes, and one is spare.
    crash: bool,
}

const CONDITIONS: [Condition; 3] = [
    Condition { name: "nothing breaks", keys: &[], crash: false },
    Condition { name: "5 % of connections fail", keys: &[("swarm.failed_connections", "5%")], crash: false },
    Condition {
        name: "5 % fail, one of the metamodules crashes, one is spare",
        keys: &[("swarm.failed_connections", "5%"), ("protocol.relocate", "true")],
        crash: true,
    },
];
/// The crash.
const CRASH: &str = "\n[[fault]]\ncrash = { count = 1, between = \"0s..90s\" }\n";

/// Makes the table; an interrupted one has the rows so far.
pub fn table(request: &Request, stop: &Interrupt) -> Result<PlannerTable, ReproduceError> {
    let mut table = PlannerTable::new(Experiment::Planned);
    for goal in Goal::ALL {
        for condition in &CONDITIONS {
            if stop.is_set() {
                return Ok(table);
            }
            table.row(format!("{}, {}", goal.name(), condition.name), "", "");
            let text = goal.text().to_owned() + if condition.crash { CRASH } else { "" };
            let scenario =
                Scenario { origin: format!("{}.toml", goal.name()), text, overrides: Overrides::default() };
            let grid = Grid::new(Seeds { from: 0, until: request.seeds }, axes(goal, condition))?;
            let progress = Progress::new(&grid, None);
            let tallies = run(&scenario, &grid, progress, request.jobs, stop, !request.quiet)?;
            let summary = tallies.summary(&scenario.name(), &grid);
            for strategy in Strategy::ALL {
                let of: Vec<&Combination> =
                    summary.combinations.iter().filter(|c| c.values[1] == strategy.name()).collect();
                let published = published(goal, strategy).filter(|_| condition.keys.is_empty());
                let built = (
                    of.iter().map(|c| c.ended(Outcome::Built)).sum::<u64>(),
                    of.iter().map(|c| c.runs).sum::<u64>(),
                );
                let printed = published.map_or(String::new(), |(built, all)| format!("{built} of {all}"));
                let row = table.share(format!("  {}: built", strategy.name()), printed, built);
                if let Some(published) = published {
                    row.against(built, published);
                }
                table.row("    means of these", "", ours(&of));
            }
        }
    }
    table.notes = vec![
        format!("{} seeds for each of 4 kinds; means of the runs that were built", count(request.seeds)),
        "published: runs without a deadlock in tables 4.1 and 4.2; moves, times and messages are not given"
            .to_owned(),
        "messages are those between metamodules; `planned` has orders and reports of the controller besides"
            .to_owned(),
    ];
    Ok(table)
}

/// Returns the kinds, the strategies, and the condition's keys with one value each.
fn axes(goal: Goal, condition: &Condition) -> Vec<Axis> {
    let axis = |key: &str, values: Vec<&str>| Axis {
        key: key.to_owned(),
        values: values.into_iter().map(str::to_owned).collect(),
    };
    let kinds = KINDS.iter().map(|k| k.name()).collect();
    let strategies = Strategy::ALL.iter().map(|s| s.name()).collect();
    let mut all = vec![axis("swarm.kind", kinds), axis("protocol.strategy", strategies)];
    all.extend(condition.keys.iter().map(|(key, value)| axis(key, vec![value])));
    if condition.crash {
        all.push(axis("swarm.count", vec![if goal == Goal::Box { "5" } else { "7" }]));
    }
    all
}

/// Returns the published runs that did not deadlock, and all; `None` for a strategy that is not published.
fn published(goal: Goal, strategy: Strategy) -> Option<(u64, u64)> {
    let cells: Vec<_> = KINDS.iter().flat_map(|kind| goal.table().cells(*kind, strategy)).collect();
    let built = cells.iter().filter(|c| !c.deadlock).count();
    (!cells.is_empty()).then_some((built as u64, cells.len() as u64))
}

/// Returns our figures of a strategy, over all kinds.
fn ours(of: &[&Combination]) -> String {
    let violations: u64 = of.iter().map(|c| c.violations).sum();
    let mean = |spread: &dyn Fn(&Combination) -> Option<Spread>| {
        let spreads = || of.iter().filter_map(|c| spread(c));
        let values: u64 = spreads().map(|s| s.count).sum();
        spreads().map(|s| s.mean * s.count as f64).sum::<f64>() / values.max(1) as f64
    };
    let broken = if violations == 0 { String::new() } else { format!("; {violations} violations") };
    format!(
        "{:.1} moves, {:.0} s, {:.0} messages, {:.2} collisions prevented{broken}",
        mean(&|c| c.moves),
        mean(&|c| c.makespan_s),
        mean(&|c| c.messages),
        mean(&|c| c.collisions)
    )
}
