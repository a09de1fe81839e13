//! Plots of a sweep as files, and the tables behind them.

use super::page::rows;
use super::summary::{Combination, Summary};
use clap::ValueEnum;
use maud::Markup;
use metamorph_report::plots::{boxes, intervals};
use metamorph_report::statistics::Spread;
use metamorph_sim_bridge::director::outcome::Outcome;

/// What is plotted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Quantity {
    /// The share of runs that were built
    Built,
    /// Moves completed
    Moves,
    /// Messages sent
    Messages,
    /// Attempts to use one cell twice
    Collisions,
    /// Seconds until the last goal cell was filled
    Makespan,
}

impl Quantity {
    /// Returns the spread of built runs; `None` for the share of runs that were built.
    fn spread(self) -> Option<fn(&Combination) -> Option<Spread>> {
        Some(match self {
            Quantity::Built => return None,
            Quantity::Moves => |c| c.moves,
            Quantity::Messages => |c| c.messages,
            Quantity::Collisions => |c| c.collisions,
            Quantity::Makespan => |c| c.makespan_s,
        })
    }
    /// Describes the plot.
    pub fn about(self) -> &'static str {
        match self {
            Quantity::Built => "Share of runs that were built, with its 95 % interval (Wilson)",
            Quantity::Moves => "Moves completed in built runs",
            Quantity::Messages => "Messages sent in built runs",
            Quantity::Collisions => "Attempts to use one cell twice in built runs",
            Quantity::Makespan => "Seconds until the last goal cell was filled, of built runs",
        }
    }
}

/// Plots a quantity, with a row for each combination.
pub fn plot(summary: &Summary, quantity: Quantity) -> Markup {
    match quantity.spread() {
        None => intervals(&rows(summary, |c| c.built_rate), quantity.about()),
        Some(of) => boxes(&rows(summary, of), quantity.about()),
    }
}

/// Returns the table behind a plot: the values of each combination, its runs, and the numbers drawn.
pub fn table(summary: &Summary, quantity: Quantity) -> Vec<Vec<String>> {
    let mut head: Vec<String> = summary.vary.iter().map(|axis| axis.key.clone()).collect();
    let numbers: &[&str] = match quantity {
        Quantity::Built => &["runs", "built", "rate", "low", "high"],
        _ => &["runs", "built", "mean", "median", "q1", "q3", "p5", "p95", "min", "max"],
    };
    head.extend(numbers.iter().map(|name| (*name).to_owned()));
    let mut table = vec![head];
    for c in &summary.combinations {
        let mut row = c.values.clone();
        row.extend([c.runs, c.ended(Outcome::Built)].map(|n| n.to_string()));
        let drawn: Vec<f64> = match quantity.spread() {
            None => c.built_rate.iter().flat_map(|r| [r.rate, r.low, r.high]).collect(),
            Some(of) => {
                let all = |s: Spread| [s.mean, s.median, s.q1, s.q3, s.p5, s.p95, s.min, s.max];
                of(c).into_iter().flat_map(all).collect()
            }
        };
        row.extend(drawn.iter().map(f64::to_string));
        // Quantities that were not measured leave their columns empty.
        row.resize(table[0].len(), String::new());
        table.push(row);
    }
    table
}
