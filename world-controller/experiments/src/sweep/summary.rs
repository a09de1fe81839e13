//! Aggregates the runs of each combination while they come in, then writes `summary.json`. A field of the
//! summary is never renamed, redefined or removed without a new [`SCHEMA`]; new fields may be added.

use super::row::Row;
use metamorph_report::statistics::{Rate, Spread};
use metamorph_scenario::grid::{Axis, Grid, Seeds};
use metamorph_sim_bridge::director::outcome::Outcome;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The version of the layout of `summary.json`.
pub const SCHEMA: u32 = 1;

/// The results of a sweep.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Summary {
    /// The version of this layout.
    pub schema: u32,
    /// The version of the program that ran.
    pub version: String,
    /// The scenario's file as it was typed, or its last part if that was an absolute path.
    pub scenario: String,
    /// The seeds of every combination; the end is exclusive.
    pub seeds: Seeds,
    /// The varied keys.
    pub vary: Vec<Axis>,
    /// Runs asked for.
    pub runs_planned: u64,
    /// Runs done; fewer if the sweep was interrupted.
    pub runs: u64,
    /// Violations of invariants in all runs. Must be 0.
    pub violations: u64,
    /// The confidence of the intervals of rates: 0.95.
    pub confidence: f64,
    /// Every combination of values, in the order of the runs.
    pub combinations: Vec<Combination>,
}

/// The runs of one combination.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct Combination {
    /// Its values, one for each varied key.
    pub values: Vec<String>,
    /// Runs done.
    pub runs: u64,
    /// Runs by outcome: built, deadlock, livelock, timeout, unsafe.
    pub outcomes: BTreeMap<String, u64>,
    /// Runs that were not built by their reason, in one word.
    pub reasons: BTreeMap<String, u64>,
    /// The share of runs that were built, with its interval by Wilson; null without runs.
    pub built_rate: Option<Rate>,
    /// Violations of invariants. Must be 0.
    pub violations: u64,
    /// Moves completed in the runs that were built; null if none was built, as for the other spreads.
    pub moves: Option<Spread>,
    /// Messages sent in the runs that were built.
    pub messages: Option<Spread>,
    /// Attempts to use one cell twice in the runs that were built: prevented, refused and suffered.
    pub collisions: Option<Spread>,
    /// Seconds of scenario time until the last goal cell was filled, in the runs that were built.
    pub makespan_s: Option<Spread>,
}

impl Combination {
    /// Returns the number of runs with this outcome.
    pub fn ended(&self, outcome: Outcome) -> u64 {
        self.outcomes.get(outcome.name()).copied().unwrap_or(0)
    }
}

/// Counts runs as they come in, in any order.
#[derive(Clone, Debug)]
pub struct Tallies(Vec<Tally>);

#[derive(Clone, Debug, Default)]
struct Tally {
    runs: u64,
    outcomes: BTreeMap<Outcome, u64>,
    reasons: BTreeMap<String, u64>,
    violations: u64,
    moves: Vec<f64>,
    messages: Vec<f64>,
    collisions: Vec<f64>,
    makespan_s: Vec<f64>,
}

impl Tallies {
    /// Creates empty counts.
    pub fn new(grid: &Grid) -> Tallies {
        Tallies(vec![Tally::default(); grid.combinations() as usize])
    }

    /// Counts a run.
    pub fn add(&mut self, combination: u64, row: &Row) {
        let tally = &mut self.0[combination as usize];
        tally.runs += 1;
        tally.violations += row.violations;
        *tally.outcomes.entry(row.outcome).or_default() += 1;
        if row.outcome != Outcome::Built {
            *tally.reasons.entry(row.reason.clone()).or_default() += 1;
            return;
        }
        tally.moves.push(row.moves as f64);
        tally.messages.push(row.messages() as f64);
        tally.collisions.push(row.collisions() as f64);
        tally.makespan_s.extend(row.makespan_s);
    }

    /// Returns the number of runs and of violations counted.
    pub fn totals(&self) -> (u64, u64) {
        self.0.iter().fold((0, 0), |(runs, broken), t| (runs + t.runs, broken + t.violations))
    }

    /// Returns the summary of all counts.
    pub fn summary(self, scenario: &str, grid: &Grid) -> Summary {
        let (runs, violations) = self.totals();
        let combination = |(i, tally): (u64, Tally)| tally.summary(grid.values(i));
        Summary {
            schema: SCHEMA,
            version: metamorph_text::version::version().to_owned(),
            scenario: scenario.to_owned(),
            seeds: grid.seeds,
            vary: grid.vary.clone(),
            runs_planned: grid.runs(),
            runs,
            violations,
            confidence: 0.95,
            combinations: (0..).zip(self.0).map(combination).collect(),
        }
    }
}

impl Tally {
    fn summary(mut self, values: Vec<&str>) -> Combination {
        let built = self.outcomes.get(&Outcome::Built).copied().unwrap_or(0);
        let ends = [Outcome::Built, Outcome::Deadlock, Outcome::Livelock, Outcome::Timeout, Outcome::Unsafe];
        let count = |o: Outcome| (o.name().to_owned(), self.outcomes.get(&o).copied().unwrap_or(0));
        Combination {
            values: values.into_iter().map(str::to_owned).collect(),
            runs: self.runs,
            outcomes: ends.into_iter().map(count).collect(),
            reasons: self.reasons,
            built_rate: Rate::wilson(built, self.runs),
            violations: self.violations,
            moves: Spread::of(&mut self.moves),
            messages: Spread::of(&mut self.messages),
            collisions: Spread::of(&mut self.collisions),
            makespan_s: Spread::of(&mut self.makespan_s),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::testing::row;
    use super::*;

    #[test]
    fn only_built_runs_count_for_numbers_and_all_for_rates() {
        let grid = Grid::new(Seeds { from: 0, until: 4 }, vec![Axis::parse("a=x,y").unwrap()]).unwrap();
        let mut tallies = Tallies::new(&grid);
        let clean = |seed| Row { violations: 0, ..row(seed) };
        tallies.add(0, &Row { moves: 10, ..clean(0) });
        tallies.add(0, &Row { moves: 30, ..clean(1) });
        let failed = |outcome, reason: &str| Row { outcome, reason: reason.into(), moves: 99, ..clean(2) };
        tallies.add(0, &failed(Outcome::Deadlock, "pinned"));
        tallies.add(0, &Row { violations: 7, ..failed(Outcome::Unsafe, "body-connected") });
        let summary = tallies.summary("a.toml", &grid);
        assert_eq!((summary.runs, summary.runs_planned, summary.violations), (4, 8, 7));
        let [first, second] = &summary.combinations[..] else { panic!("{summary:?}") };
        let moves = first.moves.unwrap();
        assert_eq!((moves.count, moves.mean, moves.max), (2, 20.0, 30.0));
        let (messages, collisions) = (row(0).messages() as f64, row(0).collisions() as f64);
        assert_eq!(first.messages.unwrap().mean, messages);
        assert_eq!(first.collisions.unwrap().mean, collisions);
        assert_eq!((first.makespan_s.unwrap().mean, first.built_rate.unwrap().rate), (1.25, 0.5));
        assert_eq!((first.ended(Outcome::Deadlock), first.ended(Outcome::Timeout)), (1, 0));
        assert_eq!(
            first.reasons.keys().map(String::as_str).collect::<Vec<_>>(),
            ["body-connected", "pinned"]
        );
        assert_eq!((second.runs, second.built_rate, second.moves), (0, None, None));
    }
}
