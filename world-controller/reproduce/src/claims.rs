//! Statements of the thesis about its experiment (4.1.3, 4.1.4, Figure 4.5), each judged twice: by the
//! printed tables, and by the share of samples of the same size from our runs that show it.
//!
//! A statement compares groups of runs by one number. The same code judges tables and runs, so that
//! contradictions between a statement and the tables are found. Absent: statements that no run can show.

use super::Goal;
use super::compare::{Claim, Runs};
use super::published::{KINDS, STRATEGIES};
use super::resample::Run;
use metamorph_protocol::metamodule::blueprint::SeedOrder;
use metamorph_protocol::metamodule::params::Strategy;
use metamorph_protocol::roombots::Kind;
use metamorph_report::statistics::fisher;
use metamorph_text::format::percent;

/// A statement holds if at least this share of the sampled experiments shows it, and fails if at most the
/// complement does.
const SURE: f64 = 0.95;
/// Significance level: accepted rate of false findings of each of the three tests between two orders; 5 % for all of
/// them together.
const SIGNIFICANT: f64 = 0.05 / 3.0;

/// The grouping of runs.
#[derive(Clone, Copy)]
enum By {
    Goal,
    Kind,
    Strategy,
    Order,
}

/// The number compared: the share built, or a mean of the built runs.
#[derive(Clone, Copy)]
enum Metric {
    Built,
    Collisions,
    Moves,
}

/// A group and its number.
struct Value {
    name: &'static str,
    value: f64,
    runs: u64,
}

/// A statement.
pub struct Statement {
    says: &'static str,
    /// Its goal; `None` for all that were run.
    goal: Option<Goal>,
    /// Its strategy; `None` for all three.
    strategy: Option<Strategy>,
    by: By,
    metric: Metric,
    shows: fn(&[Value]) -> bool,
}

const fn says(
    says: &'static str,
    goal: Option<Goal>,
    by: By,
    metric: Metric,
    shows: fn(&[Value]) -> bool,
) -> Statement {
    Statement { says, goal, strategy: None, by, metric, shows }
}

const BOX: Option<Goal> = Some(Goal::Box);
const CHAIR: Option<Goal> = Some(Goal::Chair);

/// Statements about the box.
pub const OF_TABLE_4_1: [Statement; 2] = [
    says("greedy tends to dominate for the box (most often built)", BOX, By::Strategy, Metric::Built, |v| {
        above(v, &["greedy"])
    }),
    says(
        "greedy tends to dominate for the box (fewest collisions)",
        BOX,
        By::Strategy,
        Metric::Collisions,
        |v| below(v, &["greedy"]),
    ),
];

/// Statements about the chair, and about both.
pub const OF_TABLE_4_2: [Statement; 6] = [
    says(
        "SRS and PER are more successful on average than the other kinds",
        None,
        By::Kind,
        Metric::Built,
        |v| above(v, &["SRS", "PER"]),
    ),
    says(
        "by its tables alone, PAR is less successful than the other kinds",
        None,
        By::Kind,
        Metric::Built,
        |v| below(v, &["PAR"]),
    ),
    says(
        "slope is better than the two others on average (chair most often built)",
        CHAIR,
        By::Strategy,
        Metric::Built,
        |v| above(v, &["slope"]),
    ),
    says(
        "slope is better than the two others on average (fewest collisions with the chair)",
        CHAIR,
        By::Strategy,
        Metric::Collisions,
        |v| below(v, &["slope"]),
    ),
    says(
        "the strategies with repulsion reduce deadlocks, especially in complex cases (4.1.4)",
        CHAIR,
        By::Strategy,
        Metric::Built,
        |v| below(v, &["greedy"]),
    ),
    says("the three seeding orders do not differ significantly", CHAIR, By::Order, Metric::Built, |v| {
        let counts: Vec<_> = v.iter().map(|v| ((v.value * v.runs as f64).round() as u64, v.runs)).collect();
        let pairs = (0..counts.len()).flat_map(|i| (0..i).map(move |j| (i, j)));
        let mut tests = pairs.filter_map(|(i, j)| fisher(counts[i], counts[j]));
        counts.len() == 3 && tests.all(|p| p >= SIGNIFICANT)
    }),
];

/// Statements about the moves.
pub const OF_FIGURE_4_5: [Statement; 8] = [
    says("the box takes 20 moves on average", BOX, By::Goal, Metric::Moves, |v| {
        v.iter().all(|v| v.value.round() == 20.0)
    }),
    says("the box: PAR needs the most moves", BOX, By::Kind, Metric::Moves, |v| above(v, &["PAR"])),
    says("the box: SRZ needs the fewest moves", BOX, By::Kind, Metric::Moves, |v| below(v, &["SRZ"])),
    says("the box: greedy tends to need the fewest moves", BOX, By::Strategy, Metric::Moves, |v| {
        below(v, &["greedy"])
    }),
    says("the chair needs more moves than the box", None, By::Goal, Metric::Moves, |v| above(v, &["chair"])),
    says("the chair: step needs the most moves", CHAIR, By::Strategy, Metric::Moves, |v| above(v, &["step"])),
    says("the chair: slope needs the fewest moves", CHAIR, By::Strategy, Metric::Moves, |v| {
        below(v, &["slope"])
    }),
    Statement {
        says: "the chair: with step only PAR and SRS complete it",
        goal: CHAIR,
        strategy: Some(Strategy::Step),
        by: By::Kind,
        metric: Metric::Built,
        shows: |v| v.len() == 4 && v.iter().all(|v| (v.value > 0.0) == ["PAR", "SRS"].contains(&v.name)),
    },
];

/// Judges the words "than the three other types", which the thesis says of SRS and PER although there are
/// only four types.
pub fn other_types() -> Claim {
    let others = KINDS.iter().filter(|k| ![Kind::Srs, Kind::Per].contains(k)).count();
    Claim {
        says: "there are three other types than SRS and PER".to_owned(),
        found: format!("its tables have {others}"),
        by_tables: Some(others == 3),
        chance: None,
        holds: None,
    }
}

/// Formats a probability. Small ones are in scientific notation, so that only an exact zero is shown as 0.
pub fn probability(p: f64) -> String {
    match p {
        0.0 => "0".to_owned(),
        p if p < 0.001 => format!("{p:.0e}"),
        p if p < 0.1 => format!("{p:.3}"),
        p => format!("{p:.2}"),
    }
}

/// Returns true if all of these groups have more than every other one, and there is another.
fn above(values: &[Value], names: &[&str]) -> bool {
    let of = |named: bool| values.iter().filter(move |v| names.contains(&v.name) == named).map(|v| v.value);
    let least = of(true).min_by(f64::total_cmp);
    let most = of(false).max_by(f64::total_cmp);
    least.zip(most).is_some_and(|(least, most)| least > most)
}

/// Returns true if all of these groups have less than every other one, and there is another.
fn below(values: &[Value], names: &[&str]) -> bool {
    let of = |named: bool| values.iter().filter(move |v| names.contains(&v.name) == named).map(|v| v.value);
    let most = of(true).max_by(f64::total_cmp);
    let least = of(false).min_by(f64::total_cmp);
    most.zip(least).is_some_and(|(most, least)| most < least)
}

impl By {
    fn names(self) -> Vec<&'static str> {
        match self {
            By::Goal => Goal::ALL.map(Goal::name).into(),
            By::Kind => KINDS.map(|k| k.name()).into(),
            By::Strategy => STRATEGIES.map(Strategy::name).into(),
            By::Order => SeedOrder::ALL.map(SeedOrder::name).into(),
        }
    }
}

impl Metric {
    fn text(self, value: f64) -> String {
        match self {
            Metric::Built => percent(value),
            Metric::Collisions | Metric::Moves => format!("{value:.1}"),
        }
    }
}

impl Statement {
    /// Judges the statement by the published runs, by all of ours, and by experiments sampled from ours.
    pub fn judge(&self, published: &[Run], all: &Runs, drawn: &[Vec<Run>]) -> Claim {
        let shown: Vec<bool> = drawn.iter().filter_map(|runs| self.shows(&self.of_runs(runs))).collect();
        let chance = (!shown.is_empty())
            .then(|| shown.iter().filter(|shows| **shows).count() as f64 / shown.len() as f64);
        let tables = self.of_runs(published);
        let in_tables = match self.shows(&tables) {
            Some(_) => format!("; in the tables of the thesis {}", self.list(&tables)),
            None => String::new(),
        };
        Claim {
            says: self.says.to_owned(),
            found: format!("{}{in_tables}", self.list(&self.of_all(all))),
            by_tables: self.shows(&tables),
            chance,
            holds: chance.and_then(|c| (c >= SURE || c <= 1.0 - SURE).then_some(c >= SURE)),
        }
    }

    /// Returns whether these numbers show the statement; `None` if some are missing.
    fn shows(&self, values: &[Value]) -> Option<bool> {
        let enough = match self.by {
            By::Goal => self.goal.map_or(Goal::ALL.len(), |_| 1),
            _ => 2,
        };
        (values.len() >= enough).then(|| (self.shows)(values))
    }

    fn list(&self, values: &[Value]) -> String {
        if values.is_empty() {
            return "none was built".to_owned();
        }
        let one = |v: &Value| format!("{} {}", v.name, self.metric.text(v.value));
        values.iter().map(one).collect::<Vec<_>>().join(", ")
    }

    fn of_runs(&self, runs: &[Run]) -> Vec<Value> {
        let wanted =
            |r: &&Run| self.goal.is_none_or(|g| g == r.goal) && self.strategy.is_none_or(|s| s == r.strategy);
        let name = |r: &Run| match self.by {
            By::Goal => Some(r.goal.name()),
            By::Kind => Some(r.kind.name()),
            By::Strategy => Some(r.strategy.name()),
            By::Order => r.order.map(SeedOrder::name),
        };
        let group = |of: &'static str| {
            let (mut sum, mut n) = (0.0, 0);
            for run in runs.iter().filter(wanted).filter(|r| name(r) == Some(of)) {
                let value = match self.metric {
                    Metric::Built => Some(f64::from(u8::from(run.built))),
                    Metric::Collisions => run.collisions,
                    Metric::Moves => run.moves,
                };
                sum += value.unwrap_or(0.0);
                n += u64::from(value.is_some());
            }
            (n > 0).then(|| Value { name: of, value: sum / n as f64, runs: n })
        };
        self.by.names().into_iter().filter_map(group).collect()
    }

    fn of_all(&self, all: &Runs) -> Vec<Value> {
        let group = |of: &'static str| {
            let ours = all.pooled(|goal, kind, strategy, order| {
                let name = match self.by {
                    By::Goal => goal.name(),
                    By::Kind => kind,
                    By::Strategy => strategy,
                    By::Order => order,
                };
                name == of
                    && self.goal.is_none_or(|g| g == goal)
                    && self.strategy.is_none_or(|s| s.name() == strategy)
            });
            let value = match self.metric {
                Metric::Built => (ours.runs > 0).then(|| ours.built as f64 / ours.runs as f64),
                Metric::Collisions => ours.collisions,
                Metric::Moves => ours.moves,
            };
            value.map(|value| Value { name: of, value, runs: ours.runs })
        };
        self.by.names().into_iter().filter_map(group).collect()
    }
}
