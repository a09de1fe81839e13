//! The agreement of a reading of the thesis's text with its tables: exact tests of the share built, by
//! strategy and goal, over all of these together, and over kinds.

use super::Goal;
use super::compare::Runs;
use super::published::{KINDS, STRATEGIES, deadlocks};
use metamorph_protocol::metamodule::params::Strategy;
use metamorph_protocol::roombots::Kind;
use metamorph_report::statistics::{Discrepancy, Observed, Rate, fisher};
use serde::{Deserialize, Serialize};

/// A reading of the text beside the tables.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Fit {
    /// Its name.
    pub reading: String,
    /// Its description.
    pub says: String,
    /// Each strategy with each goal.
    pub cells: Vec<FitCell>,
    /// The test over all of these, each a sample with our rate as probability.
    pub all_cells: Option<Discrepancy>,
    /// Each kind, over strategies and goals.
    pub kinds: Vec<FitKind>,
    /// The test over the kinds.
    pub all_kinds: Option<Discrepancy>,
}

/// Published and own runs of a strategy and goal, of all kinds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FitCell {
    /// `box` or `chair`.
    pub goal: String,
    /// `greedy`, `slope` or `step`.
    pub strategy: String,
    /// Runs of the thesis that were built.
    pub published_built: u64,
    /// Runs of the thesis.
    pub published_runs: u64,
    /// The share of the thesis's runs that was built, with its interval.
    pub published: Option<Rate>,
    /// The share of our runs, with its interval.
    pub ours: Option<Rate>,
    /// Fisher's exact test of the two.
    pub p: Option<f64>,
}

/// Published and own runs of a kind.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FitKind {
    /// `PAR`, `PER`, `SRS` or `SRZ`.
    pub kind: String,
    /// Runs of the thesis that were built.
    pub published_built: u64,
    /// Runs of the thesis.
    pub published_runs: u64,
    /// The share of our runs that was built, with goals and strategies weighted as in the thesis.
    pub ours: f64,
}

/// A test of the published counts alone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PublishedTest {
    /// The groups compared.
    pub what: String,
    /// Built runs and all runs, of the first and of the second group.
    pub counts: [(u64, u64); 2],
    /// Fisher's exact test.
    pub p: Option<f64>,
}

/// Returns the published runs that were built, and all.
fn counts(goal: Goal, kinds: &[Kind], strategies: &[Strategy]) -> (u64, u64) {
    let pairs = kinds.iter().flat_map(|k| strategies.iter().map(move |s| (*k, *s)));
    let cells: Vec<_> = pairs.flat_map(|(k, s)| goal.table().cells(k, s)).collect();
    (cells.len() as u64 - u64::from(deadlocks(&cells)), cells.len() as u64)
}

fn add(a: (u64, u64), b: (u64, u64)) -> (u64, u64) {
    (a.0 + b.0, a.1 + b.1)
}

/// Tests whether the published counts distinguish strategies and kinds, for these goals.
pub fn published_tests(goals: &[Goal]) -> Vec<PublishedTest> {
    let test =
        |what: String, a: (u64, u64), b: (u64, u64)| PublishedTest { what, counts: [a, b], p: fisher(a, b) };
    let mut tests = Vec::new();
    for goal in goals {
        for (a, b) in [(0, 1), (0, 2), (1, 2)] {
            let (a, b) = (STRATEGIES[a], STRATEGIES[b]);
            let what = format!("{}: {} against {}", goal.name(), a.name(), b.name());
            tests.push(test(what, counts(*goal, &KINDS, &[a]), counts(*goal, &KINDS, &[b])));
        }
    }
    let of = |kinds: &[Kind]| goals.iter().map(|g| counts(*g, kinds, &STRATEGIES)).fold((0, 0), add);
    let (par, others) = (of(&[Kind::Par]), of(&[Kind::Per, Kind::Srs, Kind::Srz]));
    tests.push(test("PAR against the other kinds".to_owned(), par, others));
    tests
}

impl Fit {
    /// Compares runs with the tables.
    pub fn of(reading: &str, says: &str, runs: &Runs) -> Fit {
        let goals: Vec<Goal> = runs.of.iter().map(|(goal, _)| *goal).collect();
        let rate = |wanted: &dyn Fn(Goal, &str, &str) -> bool| {
            let ours = runs.pooled(|goal, kind, strategy, _| wanted(goal, kind, strategy));
            (ours.built, ours.runs)
        };
        let mut cells = Vec::new();
        for goal in &goals {
            for strategy in STRATEGIES {
                let theirs = counts(*goal, &KINDS, &[strategy]);
                let ours = rate(&|g, _, s| g == *goal && s == strategy.name());
                cells.push(FitCell {
                    goal: goal.name().to_owned(),
                    strategy: strategy.name().to_owned(),
                    published_built: theirs.0,
                    published_runs: theirs.1,
                    published: Rate::wilson(theirs.0, theirs.1),
                    ours: Rate::wilson(ours.0, ours.1),
                    p: fisher(theirs, ours),
                });
            }
        }
        let of_kind = |kind: Kind| {
            let (mut published, mut expected) = ((0, 0), 0.0);
            for goal in &goals {
                for strategy in STRATEGIES {
                    let theirs = counts(*goal, &[kind], &[strategy]);
                    let (built, all) =
                        rate(&|g, k, s| g == *goal && k == kind.name() && s == strategy.name());
                    published = add(published, theirs);
                    expected += theirs.1 as f64 * built as f64 / all.max(1) as f64;
                }
            }
            FitKind {
                kind: kind.name().to_owned(),
                published_built: published.0,
                published_runs: published.1,
                ours: expected / published.1.max(1) as f64,
            }
        };
        let kinds: Vec<FitKind> = KINDS.into_iter().map(of_kind).collect();
        let observed = |successes, trials, expected| Observed { successes, trials, expected };
        let of_cell = |c: &FitCell| Some(observed(c.published_built, c.published_runs, c.ours?.rate));
        let groups: Option<Vec<Observed>> = cells.iter().map(of_cell).collect();
        let of_kinds: Vec<Observed> =
            kinds.iter().map(|k| observed(k.published_built, k.published_runs, k.ours)).collect();
        Fit {
            reading: reading.to_owned(),
            says: says.to_owned(),
            all_cells: groups.and_then(|groups| Discrepancy::of(&groups)),
            cells,
            kinds,
            all_kinds: Discrepancy::of(&of_kinds),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Verified by hand: R's `fisher.test(matrix(c(10, 6, 8, 8), 2))` gives 0.7224, and PAR with 5 of 21
    /// against 48 of 63 gives 4e-5.
    #[test]
    fn the_published_counts_order_kinds_and_not_strategies() {
        let tests = published_tests(&Goal::ALL);
        let of = |what: &str| tests.iter().find(|t| t.what == what).unwrap();
        let chair = of("chair: greedy against step");
        assert_eq!(chair.counts, [(10, 16), (8, 16)]);
        assert!((chair.p.unwrap() - 0.722).abs() < 1e-3, "{chair:?}");
        let kinds = of("PAR against the other kinds");
        assert_eq!(kinds.counts, [(5, 21), (48, 63)]);
        assert!((3e-5..5e-5).contains(&kinds.p.unwrap()), "{kinds:?}");
        let strategies = tests.iter().filter(|t| !t.what.starts_with("PAR"));
        assert!(strategies.map(|t| t.p.unwrap()).all(|p| p > 0.05));
    }
}
