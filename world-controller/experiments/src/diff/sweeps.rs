//! Two sweeps: which measures differ, by how much, with intervals.
//!
//! Rates of outcomes are over all runs; everything else is over built runs. Combinations are compared where both
//! sweeps have the same values of the keys that both vary.

use super::{Comparison, DiffError, SCHEMA};
use crate::sweep::row::Row;
use crate::sweep::store::{Runs, read_runs};
use maud::Markup;
use metamorph_report::plot_file;
use metamorph_report::plots::{Row as PlotRow, Shift, shifts};
use metamorph_report::statistics::{Spread, fisher};
use metamorph_report::two_samples::{Difference, Samples, holm, newcombe};
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_text::escape::Shown;
use metamorph_text::format::{count, many, number, percent};
use metamorph_text::paint::Paint;
use metamorph_text::table::Table;
use serde::Serialize;
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Significance level of a finding: the accepted rate of false findings.
const SIGNIFICANCE_LEVEL: f64 = 0.05;

/// A number of a run.
type Measure = (&'static str, fn(&Row) -> Option<f64>);

/// The measures of built runs.
const MEASURES: [Measure; 11] = [
    ("makespan, s", |row| row.makespan_s),
    ("moves", |row| Some(row.moves as f64)),
    ("collisions", |row| Some(row.collisions() as f64)),
    ("messages", |row| Some(row.messages() as f64)),
    ("  gradient", |row| Some(row.sent_gradient as f64)),
    ("  seed", |row| Some(row.sent_seed as f64)),
    ("  connectivity", |row| Some(row.sent_connectivity as f64)),
    ("  negotiation", |row| Some(row.sent_negotiation as f64)),
    ("  world", |row| Some(row.sent_world as f64)),
    ("  liveness", |row| Some(row.sent_liveness as f64)),
    ("  gait", |row| Some(row.sent_gait as f64)),
];

/// A measure of both sweeps.
#[derive(Clone, Debug, Serialize)]
struct Line {
    /// The values of the combination.
    values: BTreeMap<String, String>,
    measure: String,
    /// True for the share of an outcome.
    rate: bool,
    /// Runs of A that count.
    n_a: u64,
    n_b: u64,
    /// The share, or the median.
    a: f64,
    b: f64,
    /// The difference of shares, or the shift, with its 95 % interval.
    by: f64,
    low: f64,
    high: f64,
    /// P(B > A) + ½ P(B = A); of numbers only.
    larger: Option<f64>,
    p: f64,
    /// Adjusted for the number of lines.
    p_adjusted: f64,
    differs: bool,
}

fn lines(values: &BTreeMap<String, String>, a: &[Row], b: &[Row]) -> Vec<Line> {
    let mut lines = Vec::new();
    let line = |measure: &str, rate: bool, n: [u64; 2], of: [f64; 2], by: Difference, larger, p| Line {
        values: values.clone(),
        measure: measure.to_owned(),
        rate,
        n_a: n[0],
        n_b: n[1],
        a: of[0],
        b: of[1],
        by: by.by,
        low: by.low,
        high: by.high,
        larger,
        p,
        p_adjusted: p,
        differs: false,
    };
    for outcome in Outcome::ALL {
        let ended = |rows: &[Row]| {
            (rows.iter().filter(|row| row.outcome == outcome).count() as u64, rows.len() as u64)
        };
        let (of_a, of_b) = (ended(a), ended(b));
        if of_a.0 + of_b.0 == 0 {
            continue;
        }
        if let (Some(by), Some(p)) = (newcombe(of_a, of_b), fisher(of_a, of_b)) {
            let share = |(k, n): (u64, u64)| k as f64 / n as f64;
            let both = [share(of_a), share(of_b)];
            lines.push(line(outcome.name(), true, [of_a.1, of_b.1], both, by, None, p));
        }
    }
    for (name, measure) in MEASURES {
        let of = |rows: &[Row]| -> Vec<f64> {
            rows.iter().filter(|row| row.outcome == Outcome::Built).filter_map(measure).collect()
        };
        let (mut of_a, mut of_b) = (of(a), of(b));
        let n = [of_a.len() as u64, of_b.len() as u64];
        let medians = [Spread::of(&mut of_a), Spread::of(&mut of_b)].map(|s| s.map_or(0.0, |s| s.median));
        // Neither sweep has messages of some classes.
        if of_a.iter().chain(&of_b).all(|x| *x == 0.0) {
            continue;
        }
        if let Some(samples) = Samples::new(of_a, of_b) {
            let compared = samples.compare();
            lines.push(line(name, false, n, medians, compared.shift, Some(compared.larger), compared.p));
        }
    }
    lines
}

/// Decides which lines differ.
fn judge(lines: &mut [Line], at_least: f64) {
    let p: Vec<f64> = lines.iter().map(|line| line.p).collect();
    for (line, adjusted) in lines.iter_mut().zip(holm(&p)) {
        let margin = if line.rate { at_least } else { at_least * line.a.abs() };
        let beyond = at_least == 0.0 || line.low > margin || line.high < -margin;
        line.p_adjusted = adjusted;
        line.differs = adjusted < SIGNIFICANCE_LEVEL && beyond;
    }
}

/// Returns the rows of a sweep by the values of these keys.
fn groups(runs: &Runs, keys: &BTreeSet<String>) -> BTreeMap<BTreeMap<String, String>, Vec<Row>> {
    let mut groups: BTreeMap<BTreeMap<String, String>, Vec<Row>> = BTreeMap::new();
    for (values, row) in &runs.rows {
        let all = runs.keys.iter().cloned().zip(values.iter().cloned());
        groups.entry(all.filter(|(key, _)| keys.contains(key)).collect()).or_default().push(row.clone());
    }
    groups
}

fn read(path: &Path) -> Result<Runs, DiffError> {
    let wrong = |reason: String| DiffError::Sweep { path: path.to_owned(), reason };
    let runs = read_runs(path).map_err(|error| {
        let text = error.to_string();
        wrong(text.split("\n  fix:").next().unwrap_or_default().to_owned())
    })?;
    if runs.rows.is_empty() { Err(wrong("the sweep has no run".to_owned())) } else { Ok(runs) }
}

/// Returns the keys whose values are compared separately: those that both sweeps vary, or some of them.
fn keys(first: &Runs, second: &Runs, by: &[String]) -> Result<BTreeSet<String>, DiffError> {
    let both: BTreeSet<String> = first.keys.iter().filter(|key| second.keys.contains(key)).cloned().collect();
    // A key with one value in each sweep is set and not varied; it may be what is compared.
    let is_set = |runs: &Runs, key: &String| {
        let values =
            runs.keys.iter().position(|k| k == key).map(|i| runs.rows.iter().map(move |(v, _)| &v[i]));
        values.is_some_and(|values| values.collect::<BTreeSet<_>>().len() == 1)
    };
    if let Some(key) = by.iter().find(|key| !both.contains(*key)) {
        let known = both.iter().map(|key| key.shown().to_string()).collect::<Vec<_>>().join(", ");
        let known = if known.is_empty() { "none: both vary no key".to_owned() } else { known };
        return Err(DiffError::By { key: key.clone(), known });
    }
    if !by.is_empty() {
        return Ok(by.iter().cloned().collect());
    }
    Ok(both.into_iter().filter(|key| !is_set(first, key) || !is_set(second, key)).collect())
}

/// Compares two sweeps, separately for each value of the keys `by`.
pub fn compare(
    a: &Path,
    b: &Path,
    by: &[String],
    at_least: f64,
    paint: Paint,
) -> Result<Comparison, DiffError> {
    let (first, second) = (read(a)?, read(b)?);
    let keys = keys(&first, &second, by)?;
    let (of_a, of_b) = (groups(&first, &keys), groups(&second, &keys));
    let both: Vec<_> = of_a.iter().filter_map(|(values, a)| Some((values, a, of_b.get(values)?))).collect();
    if both.is_empty() {
        return Err(DiffError::Nothing(a.to_owned(), b.to_owned()));
    }
    let mut all: Vec<Line> = both.iter().flat_map(|(values, a, b)| lines(values, a, b)).collect();
    judge(&mut all, at_least);
    let mut text = String::new();
    for (name, path, runs) in [("A", a, &first), ("B", b, &second)] {
        text.push_str(&format!(
            "{name}  {}: {}, {}\n",
            path.shown(),
            runs.scenario.shown(),
            many(runs.rows.len() as u64, "run")
        ));
        if (runs.rows.len() as u64) < runs.planned {
            text.push_str(&format!("   note: {} were planned\n", many(runs.planned, "run")));
        }
    }
    for (values, ..) in &both {
        text.push('\n');
        if !values.is_empty() {
            let values: Vec<String> = values.iter().map(|(key, value)| format!("{key}={value}")).collect();
            text.push_str(&format!("{}\n", values.join(", ").shown()));
        }
        let own: Vec<&Line> = all.iter().filter(|line| line.values == **values).collect();
        text.push_str(&table(&own, paint));
        if own.iter().any(|line| line.rate && line.measure == Outcome::Built.name() && line.differs) {
            text.push_str("  note: the shares of built runs differ, so the other lines compare different sets of runs\n");
        }
    }
    text.push_str(&format!(
        "\nShares with intervals of Newcombe and Fisher's exact test; numbers of built runs with the shift of Hodges and\n\
         Lehmann and the test of Mann and Whitney. p is adjusted for {} by Holm; ~ is p ≥ 0.05{}.\n",
        many(all.len() as u64, "test"),
        if at_least > 0.0 {
            format!(", or an interval that is not wholly beyond {} %", at_least * 100.0)
        } else {
            String::new()
        }
    ));
    let json = json!({ "schema": SCHEMA, "kind": "sweeps", "at_least": at_least, "lines": all });
    let about = format!("{} (A) and {} (B): B − A, as a share of A", a.shown(), b.shown());
    Ok(Comparison { text, json, plot: plot_file::file(forest(&all, &about), &about) })
}

/// Plots the lines: differences of shares as they are, those of numbers as shares of the median in A.
fn forest(lines: &[Line], about: &str) -> Markup {
    let mut before = None;
    let row = |line: &Line| {
        let values: Vec<&str> = line.values.values().map(String::as_str).collect();
        let label =
            [values.join(" · "), line.measure.trim().to_owned()].into_iter().filter(|part| !part.is_empty());
        let of = if line.rate { 1.0 } else { line.a.abs() };
        let conclusion = if line.differs { "differs" } else { "~" };
        let shift = Shift { by: line.by / of, low: line.low / of, high: line.high / of, conclusion };
        PlotRow {
            label: label.collect::<Vec<_>>().join(": "),
            begins: before.replace(line.values.clone()).is_some_and(|values| values != line.values),
            value: Some(shift).filter(|_| of > 0.0),
        }
    };
    shifts(&lines.iter().map(row).collect::<Vec<_>>(), about)
}

fn table(lines: &[&Line], paint: Paint) -> String {
    let mut table = Table::new(&["measure"]);
    table.head(&["n A", "n B", "A", "B", "B − A", "95 % interval", "P(B > A)", "p", ""]);
    for line in lines {
        let signed = |x: f64| {
            let sign = if x < 0.0 { "−" } else { "+" };
            let size = x.abs();
            if line.rate { format!("{sign}{}", percent(size)) } else { format!("{sign}{}", number(size)) }
        };
        let plain = |x: f64| if line.rate { percent(x) } else { number(x) };
        let p = match line.p_adjusted {
            p if p < 0.0001 => "< 0.0001".to_owned(),
            p => format!("{p:.4}"),
        };
        let numbers = vec![
            count(line.n_a),
            count(line.n_b),
            plain(line.a),
            plain(line.b),
            signed(line.by),
            format!("{} to {}", signed(line.low), signed(line.high)),
            line.larger.map_or_else(String::new, |larger| format!("{larger:.2}")),
            p,
            if line.differs { "differs" } else { "~" }.to_owned(),
        ];
        table.row(std::slice::from_ref(&line.measure), numbers);
    }
    table.text(paint)
}
