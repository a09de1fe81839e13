//! A summary as text for the terminal: outcomes of the runs of each combination, then statistics of those
//! that were built.

use super::summary::{Combination, Summary};
use metamorph_report::statistics::{Spread, rate};
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_text::format::{count, many, number};
use metamorph_text::paint::Paint;
use metamorph_text::table::Table;

/// Largest number of combinations shown; `summary.json` has them all.
const SHOWN_MAX: usize = 100;

/// Formats both tables.
pub fn table(summary: &Summary, paint: Paint) -> String {
    let shown = &summary.combinations[..summary.combinations.len().min(SHOWN_MAX)];
    let mut ends = Table::new(&summary.vary.iter().map(|a| a.key.as_str()).collect::<Vec<_>>());
    ends.head(&[
        "runs",
        "built",
        "rate",
        "95 % interval",
        "deadlock",
        "livelock",
        "timeout",
        "unsafe",
        "violations",
    ]);
    let mut numbers = Table::new(&summary.vary.iter().map(|a| a.key.as_str()).collect::<Vec<_>>());
    for name in ["moves", "messages", "collisions", "makespan s"] {
        numbers.head(&[name, "median", "p95"]);
    }
    for c in shown {
        let (rate, interval) = rate(c.built_rate);
        let mut row = vec![count(c.runs), count(c.ended(Outcome::Built)), rate, interval];
        row.extend(
            [Outcome::Deadlock, Outcome::Livelock, Outcome::Timeout, Outcome::Unsafe]
                .map(|o| count(c.ended(o))),
        );
        row.push(count(c.violations));
        ends.row(&c.values, row);
        numbers.row(&c.values, spreads(c).into_iter().flat_map(of_built).collect());
    }
    let mut out = format!(
        "{}  {} of {}, seeds {}\n\n",
        summary.scenario,
        count(summary.runs),
        many(summary.runs_planned, "run"),
        summary.seeds
    );
    out += &ends.text(paint);
    out += "\nOf the runs that were built: mean, median, 95 % quantile\n";
    out += &numbers.text(paint);
    match summary.combinations.len() - shown.len() {
        0 => {}
        more => out += &format!("  … and {}\n", many(more as u64, "more combination")),
    }
    if summary.violations > 0 {
        out += &paint.bad(&format!("\n{} of invariants\n", many(summary.violations, "violation")));
    }
    out
}

fn spreads(c: &Combination) -> [Option<Spread>; 4] {
    [c.moves, c.messages, c.collisions, c.makespan_s]
}

/// Formats mean, median and 95 % quantile.
fn of_built(spread: Option<Spread>) -> [String; 3] {
    match spread {
        Some(s) => [s.mean, s.median, s.p95].map(number),
        None => ["–", "–", "–"].map(str::to_owned),
    }
}
