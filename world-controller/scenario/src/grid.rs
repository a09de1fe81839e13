//! The runs of a sweep: every seed of a range with every combination of varied values, numbered.
//!
//! Run number `combination * seeds + (seed - first seed)`; the last varied key changes fastest from
//! combination to combination. Numbers determine the order of results and which runs remain, so they must not
//! depend on anything else.

use crate::settings::Setting;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::fmt;
use thiserror::Error;

/// Largest number of runs of one sweep.
pub const MAX_RUNS: u64 = 10_000_000;
/// Largest number of combinations of one sweep.
pub const MAX_COMBINATIONS: u64 = 10_000;
/// Largest number of parts of a sweep.
pub const MAX_PARTS: u64 = 100_000;

/// Why seeds or variations are invalid.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum GridError {
    /// Not of the form `A..B`.
    #[error(
        "--seeds {0}: `{0}` is not of the form A..B\n  fix: write for example `0..1000` for the seeds 0 to 999"
    )]
    Seeds(String),
    /// An empty range.
    #[error("--seeds {seeds}: there is no seed in this range; the second number is not included\n  fix: write for example `{from}..{until}`", from = .seeds.from, until = .seeds.from.saturating_add(100))]
    NoSeed {
        /// The range.
        seeds: Seeds,
    },
    /// Not of the form `KEY=VALUE,VALUE`.
    #[error(
        "--vary {0}: this is not of the form KEY=VALUE,VALUE\n  fix: write for example `link.loss=0%,1%,5%`"
    )]
    Form(String),
    /// An empty value.
    #[error(
        "--vary {0}: one of the values is empty\n  fix: write a value after the = and after every comma; an empty text is `\"\"`"
    )]
    EmptyValue(String),
    /// A control character, such as a line break, which would break the lines of the results.
    #[error("--vary {}: it contains a control character\n  fix: write it in one line", .0.escape_debug())]
    Control(String),
    /// A duplicate value.
    #[error("--vary {axis}: the value `{value}` is there twice\n  fix: remove one of them")]
    Twice {
        /// The argument.
        axis: String,
        /// The value.
        value: String,
    },
    /// A key varied by two arguments, or a table and a key in it.
    #[error(
        "--vary {axis}: `{key}` overlaps with `{by}`, which another --vary sets\n  fix: write all values of a key in one --vary, and do not vary a table together with keys in it"
    )]
    Overlap {
        /// The argument.
        axis: String,
        /// Its key.
        key: String,
        /// The key of the other argument.
        by: String,
    },
    /// A varied seed; seeds are given as a range.
    #[error(
        "--vary {0}: the seed is given with --seeds\n  fix: write for example `--seeds 0..1000` and leave this out"
    )]
    Seed(String),
    /// Not a part of a sweep.
    #[error(
        "--part {0}: that is no part of a sweep\n  fix: write I/N, the part I of N from 1 to N, such as `--part 3/16`; {MAX_PARTS} parts are the maximum"
    )]
    Part(String),
    /// Too many combinations.
    #[error(
        "--vary: there are {0} combinations; {MAX_COMBINATIONS} is the maximum\n  fix: vary fewer keys or values at a time"
    )]
    Combinations(u64),
    /// Too many runs.
    #[error("--seeds {seeds}: {combinations} combinations with {each} seeds each are too many runs; {MAX_RUNS} is the maximum\n  fix: take fewer seeds, such as `{from}..{until}`",
        each = .seeds.len(), from = .seeds.from, until = .seeds.from.saturating_add(MAX_RUNS / combinations))]
    Runs {
        /// The seeds.
        seeds: Seeds,
        /// The number of combinations.
        combinations: u64,
    },
}

/// A range of seeds, `from..until`, excluding `until`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Seeds {
    /// The first seed.
    pub from: u64,
    /// The end of the range, exclusive.
    pub until: u64,
}

impl Seeds {
    /// Reads `A..B`.
    pub fn parse(text: &str) -> Result<Seeds, GridError> {
        let read = || {
            let (from, until) = text.split_once("..")?;
            Some(Seeds { from: from.trim().parse().ok()?, until: until.trim().parse().ok()? })
        };
        let seeds = read().ok_or_else(|| GridError::Seeds(text.to_owned()))?;
        if seeds.is_empty() { Err(GridError::NoSeed { seeds }) } else { Ok(seeds) }
    }
    /// Returns the number of seeds.
    pub const fn len(self) -> u64 {
        self.until.saturating_sub(self.from)
    }
    /// Returns true if there are no seeds.
    pub const fn is_empty(self) -> bool {
        self.len() == 0
    }
}

impl fmt::Display for Seeds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}..{}", self.from, self.until)
    }
}

/// A key and its values.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Axis {
    /// The key, as for `--set`.
    pub key: String,
    /// Its values, as typed.
    pub values: Vec<String>,
}

impl Axis {
    /// Reads `KEY=VALUE,VALUE`. Commas in brackets and quotes belong to a value.
    pub fn parse(text: &str) -> Result<Axis, GridError> {
        if text.chars().any(char::is_control) {
            return Err(GridError::Control(text.to_owned()));
        }
        let (key, values) = text.split_once('=').ok_or_else(|| GridError::Form(text.to_owned()))?;
        let key = key.trim();
        if key.is_empty() {
            return Err(GridError::Form(text.to_owned()));
        }
        if key == "seed" {
            return Err(GridError::Seed(text.to_owned()));
        }
        let values: Vec<String> = split(values).into_iter().map(|v| v.trim().to_owned()).collect();
        let mut seen = BTreeSet::new();
        for value in &values {
            if value.is_empty() {
                return Err(GridError::EmptyValue(text.to_owned()));
            }
            if !seen.insert(value) {
                return Err(GridError::Twice { axis: text.to_owned(), value: value.clone() });
            }
        }
        Ok(Axis { key: key.to_owned(), values })
    }
}

impl fmt::Display for Axis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}={}", self.key, self.values.join(","))
    }
}

/// Splits at commas outside of brackets and quotes.
fn split(text: &str) -> Vec<&str> {
    let (mut parts, mut start, mut depth, mut quote) = (Vec::new(), 0, 0usize, None);
    for (i, c) in text.char_indices() {
        match (quote, c) {
            (Some(open), _) if c == open => quote = None,
            (Some(_), _) => {}
            (None, '"' | '\'') => quote = Some(c),
            (None, '[' | '{') => depth += 1,
            (None, ']' | '}') => depth = depth.saturating_sub(1),
            (None, ',') if depth == 0 => {
                parts.push(&text[start..i]);
                start = i + 1;
            }
            _ => {}
        }
    }
    parts.push(&text[start..]);
    parts
}

/// All runs of a sweep.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct Grid {
    /// The seeds, for every combination the same.
    pub seeds: Seeds,
    /// The varied keys.
    pub vary: Vec<Axis>,
}

impl Grid {
    /// Checks that all of this can be run.
    pub fn new(seeds: Seeds, vary: Vec<Axis>) -> Result<Grid, GridError> {
        for (i, axis) in vary.iter().enumerate() {
            let within = |inner: &str, outer: &str| {
                inner == outer || inner.strip_prefix(outer).is_some_and(|rest| rest.starts_with('.'))
            };
            let clash = |other: &&Axis| within(&axis.key, &other.key) || within(&other.key, &axis.key);
            if let Some(other) = vary[..i].iter().find(clash) {
                let (key, by) = (axis.key.clone(), other.key.clone());
                return Err(GridError::Overlap { axis: axis.to_string(), key, by });
            }
        }
        let combinations = vary.iter().fold(1u64, |n, axis| n.saturating_mul(axis.values.len() as u64));
        if combinations > MAX_COMBINATIONS {
            return Err(GridError::Combinations(combinations));
        }
        if seeds.len().saturating_mul(combinations) > MAX_RUNS {
            return Err(GridError::Runs { seeds, combinations });
        }
        Ok(Grid { seeds, vary })
    }

    /// Returns the number of combinations of values; one if nothing is varied.
    pub fn combinations(&self) -> u64 {
        self.vary.iter().map(|axis| axis.values.len() as u64).product()
    }
    /// Returns the number of runs.
    pub fn runs(&self) -> u64 {
        self.seeds.len() * self.combinations()
    }
    /// Returns the combination of a run.
    pub fn combination(&self, run: u64) -> u64 {
        run / self.seeds.len()
    }
    /// Returns the seed of a run.
    pub fn seed(&self, run: u64) -> u64 {
        self.seeds.from + run % self.seeds.len()
    }
    /// Returns the values of a combination, one for each varied key.
    pub fn values(&self, combination: u64) -> Vec<&str> {
        let mut rest = combination;
        let mut values: Vec<&str> = Vec::with_capacity(self.vary.len());
        for axis in self.vary.iter().rev() {
            let n = axis.values.len() as u64;
            values.push(&axis.values[(rest % n) as usize]);
            rest /= n;
        }
        values.reverse();
        values
    }
    /// Returns a combination as settings of the scenario.
    pub fn settings(&self, combination: u64) -> Vec<Setting> {
        let text = |(axis, value): (&Axis, &str)| format!("{}={value}", axis.key);
        let values = self.values(combination);
        self.vary.iter().zip(values).map(text).map(|text| Setting { option: "--vary", text }).collect()
    }
}

/// A part of the runs of a sweep, for one of several machines. Neighbouring seeds and combinations are in different parts, so that
/// all take about as long; a run stays in its part when seeds are added at the end.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Part {
    /// Its number, from 0.
    index: u64,
    /// The number of parts.
    of: u64,
}

impl Part {
    /// The only part of a sweep that is not divided.
    pub const WHOLE: Part = Part { index: 0, of: 1 };

    /// Reads `I/N`, the part I of N, from 1 to N.
    ///
    /// # Errors
    /// If it is none.
    pub fn parse(text: &str) -> Result<Part, GridError> {
        let read = || {
            let (number, of) = text.split_once('/')?;
            let (number, of): (u64, u64) = (number.trim().parse().ok()?, of.trim().parse().ok()?);
            let is_part = (1..=MAX_PARTS).contains(&of) && (1..=of).contains(&number);
            is_part.then_some(Part { index: number.checked_sub(1)?, of })
        };
        read().ok_or_else(|| GridError::Part(text.to_owned()))
    }

    /// Returns the number of parts.
    pub const fn of(self) -> u64 {
        self.of
    }
    /// Returns true if the sweep is not divided.
    pub fn is_whole(&self) -> bool {
        self.of == 1
    }
    /// Returns true if a run belongs to this part.
    pub fn has(self, grid: &Grid, run: u64) -> bool {
        (grid.combination(run) + grid.seed(run) - grid.seeds.from) % self.of == self.index
    }
    /// Returns the first run of this part that is not before `run`; the number of all runs if there is none.
    pub fn next(self, grid: &Grid, run: u64) -> u64 {
        (run..grid.runs()).find(|run| self.has(grid, *run)).unwrap_or(grid.runs())
    }
    /// Returns the number of runs of this part.
    pub fn runs(self, grid: &Grid) -> u64 {
        if self.is_whole() {
            return grid.runs();
        }
        (0..grid.runs()).filter(|run| self.has(grid, *run)).count() as u64
    }
    /// Iterates over all parts of a sweep that this one is a part of.
    pub fn all(self) -> impl Iterator<Item = Part> {
        (0..self.of).map(move |index| Part { index, of: self.of })
    }
}

impl Default for Part {
    fn default() -> Part {
        Part::WHOLE
    }
}

impl TryFrom<String> for Part {
    type Error = GridError;

    fn try_from(text: String) -> Result<Part, GridError> {
        Part::parse(&text)
    }
}

impl From<Part> for String {
    fn from(part: Part) -> String {
        part.to_string()
    }
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.index + 1, self.of)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seeds(text: &str) -> Seeds {
        Seeds::parse(text).unwrap()
    }
    fn axis(text: &str) -> Axis {
        Axis::parse(text).unwrap()
    }

    #[test]
    fn each_run_is_in_one_part_and_stays_there_when_seeds_are_added() {
        let grid =
            |until| Grid::new(Seeds { from: 7, until }, vec![Axis::parse("a=1,2,3").unwrap()]).unwrap();
        let (grid, more) = (grid(12), grid(40));
        let parts: Vec<Part> = Part::parse("1/4").unwrap().all().collect();
        assert_eq!(parts.iter().map(ToString::to_string).collect::<Vec<_>>(), ["1/4", "2/4", "3/4", "4/4"]);
        for run in 0..grid.runs() {
            let of = |grid: &Grid, run| parts.iter().position(|part| part.has(grid, run));
            let later = grid.combination(run) * more.seeds.len() + run % grid.seeds.len();
            assert!(of(&grid, run).is_some() && of(&grid, run) == of(&more, later), "{run}");
            assert_eq!(parts.iter().filter(|part| part.has(&grid, run)).count(), 1);
        }
        let counts: Vec<u64> = parts.iter().map(|part| part.runs(&grid)).collect();
        assert_eq!(
            (counts.iter().sum::<u64>(), counts.iter().max(), counts.iter().min()),
            (15, Some(&4), Some(&3))
        );
        assert_eq!((Part::WHOLE.next(&grid, 3), Part::WHOLE.next(&grid, 15)), (3, 15));
        for wrong in ["", "0/4", "5/4", "1/0", "1", "a/b", "-1/4"] {
            let error = Part::parse(wrong).unwrap_err().to_string();
            assert!(error.contains("no part of a sweep") && error.contains("fix: "), "{error}");
        }
    }

    #[test]
    fn the_end_of_a_range_is_not_in_it() {
        assert_eq!(seeds("0..1000").len(), 1000);
        assert_eq!(seeds(" 7 .. 8 "), Seeds { from: 7, until: 8 });
        assert_eq!(seeds("18446744073709551614..18446744073709551615").len(), 1);
        for wrong in ["", "5", "a..b", "1..", "..2", "-1..3", "0..=9", "1...2", "1..2..3"] {
            assert_eq!(Seeds::parse(wrong), Err(GridError::Seeds(wrong.into())), "{wrong}");
        }
        assert!(matches!(Seeds::parse("3..3"), Err(GridError::NoSeed { .. })));
        assert!(Seeds::parse("4..3").unwrap_err().to_string().contains("write for example `4..104`"));
    }

    #[test]
    fn commas_in_brackets_and_quotes_stay() {
        let values = |text| axis(text).values;
        assert_eq!(values("link.loss=0%, 1%"), ["0%", "1%"]);
        assert_eq!(
            values("a=[0, 1],{ x = [1, 2] },\"b,c\",'d,\"'"),
            ["[0, 1]", "{ x = [1, 2] }", "\"b,c\"", "'d,\"'"]
        );
        assert_eq!(axis("a=b=c").values, ["b=c"]);
        for (wrong, reason) in [
            ("link.loss", "not of the form"),
            ("=1", "not of the form"),
            ("a=", "empty"),
            ("a=1,,2", "empty"),
            ("a=1,2,1", "`1` is there twice"),
            ("a=1\n2", "control character"),
            ("seed=1,2", "--seeds"),
        ] {
            let error = Axis::parse(wrong).unwrap_err().to_string();
            assert!(error.contains(reason) && error.contains("\n  fix: "), "{wrong}: {error}");
        }
    }

    #[test]
    fn numbers_go_through_all_combinations_and_seeds() {
        let grid = Grid::new(seeds("5..8"), vec![axis("a=x,y"), axis("b.c=1,2,3")]).unwrap();
        assert_eq!((grid.combinations(), grid.runs()), (6, 18));
        let all: Vec<_> = (0..6).map(|c| grid.values(c).join("")).collect();
        assert_eq!(all, ["x1", "x2", "x3", "y1", "y2", "y3"]);
        let runs: Vec<_> = (0..18).map(|run| (grid.combination(run), grid.seed(run))).collect();
        assert_eq!((runs[0], runs[2], runs[3], runs[17]), ((0, 5), (0, 7), (1, 5), (5, 7)));
        let settings: Vec<_> = grid.settings(3).iter().map(Setting::to_string).collect();
        assert_eq!(settings, ["--vary a=y", "--vary b.c=1"]);
        let plain = Grid::new(seeds("0..4"), vec![]).unwrap();
        assert_eq!((plain.combinations(), plain.runs(), plain.values(0).len()), (1, 4, 0));
    }

    #[test]
    fn too_much_and_twice_are_refused() {
        let many = |key: &str, n: usize| {
            let values: Vec<String> = (0..n).map(|i| i.to_string()).collect();
            axis(&format!("{key}={}", values.join(",")))
        };
        assert!(Grid::new(seeds("0..1000"), vec![many("a", 100), many("b", 100)]).is_ok());
        let error = Grid::new(seeds("0..1"), vec![many("a", 101), many("b", 100)]).unwrap_err();
        assert_eq!(error, GridError::Combinations(10_100));
        let error = Grid::new(seeds("0..1001"), vec![many("a", 100), many("b", 100)]).unwrap_err();
        assert!(error.to_string().contains("such as `0..1000`"), "{error}");
        let error = Grid::new(seeds("0..18446744073709551615"), vec![]).unwrap_err();
        assert!(error.to_string().contains("such as `0..10000000`"), "{error}");
        for (a, b) in [("a=1", "a=2"), ("a=1", "a.b=2"), ("a.b=1", "a=2")] {
            let error = Grid::new(seeds("0..1"), vec![axis(a), axis(b)]).unwrap_err();
            assert!(matches!(error, GridError::Overlap { .. }), "{error}");
        }
        assert!(Grid::new(seeds("0..1"), vec![axis("a.b=1"), axis("a.bc=2")]).is_ok());
    }
}
