//! The strategy `planned` beside those by which each metamodule decides for itself, on the thesis's experiment
//! (4.1.3), also with connections that fail (4.2.3) and with a crash.

use super::PlannerTable;
use crate::console::format::count;
use crate::console::interrupt::Interrupt;
use crate::experiments::reproduce::published::KINDS;
use crate::experiments::reproduce::{Experiment, Goal, Request};
use crate::experiments::sweep::grid::{Axis, Grid, Seeds};
use crate::experiments::sweep::summary::Combination;
use crate::experiments::sweep::{Progress, Scenario, SweepError, run};
use crate::report::statistics::Spread;
use metamorph_protocol::metamodule::params::Strategy;
use metamorph_sim_bridge::director::outcome::Outcome;

/// What may break, and how the scenario says so.
const CONDITIONS: [(&str, &str, &str); 3] = [
    ("nothing breaks", "", ""),
    ("5 % of connections fail", "failed_connections = \"5%\"\n", ""),
    (
        "5 % fail, one of the metamodules crashes, one is spare",
        "failed_connections = \"5%\"\n",
        "\n[[fault]]\ncrash = { count = 1, between = \"0s..90s\" }\n",
    ),
];

/// Makes the table; an interrupted one has the rows so far.
pub fn table(request: &Request, stop: &Interrupt) -> Result<PlannerTable, SweepError> {
    let mut table = PlannerTable::new(Experiment::Planned);
    for goal in Goal::ALL {
        for (condition, swarm, fault) in CONDITIONS {
            if stop.is_set() {
                return Ok(table);
            }
            table.row(format!("{}, {condition}", goal.name()), "", "");
            let scenario = scenario(goal, swarm, fault);
            let grid = Grid::new(Seeds { from: 0, until: request.seeds }, axes())?;
            let progress = Progress::new(&grid, None);
            let tallies = run(&scenario, &grid, progress, request.jobs, stop, !request.quiet)?;
            let summary = tallies.summary(&scenario.name(), &grid);
            for strategy in Strategy::ALL {
                let of: Vec<&Combination> =
                    summary.combinations.iter().filter(|c| c.values[1] == strategy.name()).collect();
                let published = if fault.is_empty() && swarm.is_empty() {
                    published(goal, strategy)
                } else {
                    String::new()
                };
                table.row(format!("  {}", strategy.name()), published, ours(&of));
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

fn axes() -> Vec<Axis> {
    let axis = |key: &str, values: Vec<&str>| Axis {
        key: key.to_owned(),
        values: values.into_iter().map(str::to_owned).collect(),
    };
    let strategies = Strategy::ALL.iter().map(|s| s.name()).collect();
    vec![axis("swarm.kind", KINDS.iter().map(|k| k.name()).collect()), axis("protocol.strategy", strategies)]
}

fn scenario(goal: Goal, swarm: &str, fault: &str) -> Scenario {
    let spare = match goal {
        Goal::Box => "count = 5\n",
        Goal::Chair => "count = 7\n",
    };
    let count = if fault.is_empty() { "" } else { spare };
    let (text, relocates) = (goal.text(), if fault.is_empty() { "" } else { "relocate = true\n" });
    let text = text.replace("start = ", &format!("{swarm}{count}start = "));
    let text = text.replace("[protocol]\n", &format!("[protocol]\n{relocates}"));
    Scenario { origin: format!("{}.toml", goal.name()), text: text + fault }
}

/// Returns the share of the published runs that did not deadlock.
fn published(goal: Goal, strategy: Strategy) -> String {
    let cells: Vec<_> = KINDS.iter().flat_map(|kind| goal.table().cells(*kind, strategy)).collect();
    match cells.len() {
        0 => String::new(),
        n => format!("{} of {n}", cells.iter().filter(|c| !c.deadlock).count()),
    }
}

/// Returns our figures of a strategy, over all kinds.
fn ours(of: &[&Combination]) -> String {
    let runs: u64 = of.iter().map(|c| c.runs).sum();
    let built: u64 = of.iter().map(|c| c.ended(Outcome::Built)).sum();
    let violations: u64 = of.iter().map(|c| c.violations).sum();
    let mean = |spread: &dyn Fn(&Combination) -> Option<Spread>| {
        let spreads = || of.iter().filter_map(|c| spread(c));
        let values: u64 = spreads().map(|s| s.count).sum();
        spreads().map(|s| s.mean * s.count as f64).sum::<f64>() / values.max(1) as f64
    };
    let share = 100.0 * built as f64 / runs.max(1) as f64;
    let broken = if violations == 0 { String::new() } else { format!("; {violations} violations") };
    format!(
        "{share:.1} % of {} built; {:.1} moves, {:.0} s, {:.0} messages, {:.2} collisions prevented{broken}",
        count(runs),
        mean(&|c| c.moves),
        mean(&|c| c.makespan_s),
        mean(&|c| c.messages),
        mean(&|c| c.collisions)
    )
}
