//! A summary as text for the terminal: how the runs of each combination ended, then the numbers of
//! those that were built.

use super::statistics::{Rate, Spread};
use super::summary::{Combination, Summary};
use crate::terminal::Paint;
use crate::wording::{count, many};
use metamorph_sim_bridge::outcome::Outcome;

/// Combinations shown; `summary.json` has them all.
const SHOWN: usize = 100;
/// Longer values are cut.
const WIDTH: usize = 32;

/// Both tables.
pub fn table(summary: &Summary, paint: Paint) -> String {
    let shown = &summary.combinations[..summary.combinations.len().min(SHOWN)];
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

/// Mean, median and 95 % quantile.
fn of_built(spread: Option<Spread>) -> [String; 3] {
    match spread {
        Some(s) => [s.mean, s.median, s.p95].map(number),
        None => ["–", "–", "–"].map(str::to_owned),
    }
}

/// A rate and its interval, in percent.
pub fn rate(rate: Option<Rate>) -> (String, String) {
    match rate {
        Some(r) => (percent(r.rate), format!("{} to {}", percent(r.low), percent(r.high))),
        None => ("–".to_owned(), "–".to_owned()),
    }
}

/// A share in percent with one digit more.
pub fn percent(share: f64) -> String {
    format!("{:.1}%", share * 100.0)
}

/// A number with as many digits as one wants to read.
pub fn number(n: f64) -> String {
    match n {
        1_000.0.. => count(n.round() as u64),
        100.0.. => format!("{n:.0}"),
        _ => format!("{n:.1}"),
    }
}

/// Columns of text: keys to the left, numbers to the right.
pub struct Table {
    keys: usize,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// A table with these columns of keys.
    pub fn new(keys: &[&str]) -> Table {
        Table { keys: keys.len(), rows: vec![keys.iter().map(|k| cut(k)).collect()] }
    }
    /// More columns, for numbers.
    pub fn head(&mut self, names: &[&str]) {
        self.rows[0].extend(names.iter().map(|n| (*n).to_owned()));
    }
    /// A row.
    pub fn row(&mut self, keys: &[String], numbers: Vec<String>) {
        self.rows.push(keys.iter().map(|k| cut(k)).chain(numbers).collect());
    }
    /// A row whose keys are not cut.
    pub fn whole_row(&mut self, keys: &[String], numbers: Vec<String>) {
        self.rows.push(keys.iter().cloned().chain(numbers).collect());
    }
    /// The table, the first line painted.
    pub fn text(&self, paint: Paint) -> String {
        let length = |text: &String| text.chars().count();
        let columns = self.rows[0].len();
        let widths: Vec<usize> = (0..columns)
            .map(|i| self.rows.iter().filter_map(|row| row.get(i)).map(length).max().unwrap_or(0))
            .collect();
        let mut out = String::new();
        for (i, row) in self.rows.iter().enumerate() {
            let mut line = String::new();
            for (j, (cell, width)) in row.iter().zip(&widths).enumerate() {
                line += "  ";
                line += &if j < self.keys { format!("{cell:<width$}") } else { format!("{cell:>width$}") };
            }
            let line = line.trim_end();
            out += &if i == 0 { paint.strong(line) } else { line.to_owned() };
            out.push('\n');
        }
        out
    }
}

fn cut(text: &str) -> String {
    if text.chars().count() <= WIDTH {
        return text.to_owned();
    }
    text.chars().take(WIDTH - 1).chain(['…']).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_stand_below_each_other() {
        let mut table = Table::new(&["key"]);
        table.head(&["n", "much"]);
        table.row(&["ä".into()], vec!["1,000".into(), "2".into()]);
        table.row(&["x".repeat(40)], vec!["3".into(), "4".into()]);
        let text = table.text(Paint::PLAIN);
        let lines: Vec<Vec<char>> = text.lines().map(|l| l.chars().collect()).collect();
        assert_eq!(lines.len(), 3);
        assert!(lines.iter().all(|l| l.len() == lines[0].len()), "{text}");
        assert!(text.lines().nth(2).unwrap().contains(&format!("{}…", "x".repeat(WIDTH - 1))));
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!(
            [0.04, 99.94, 123.4, 1234.4, 1e6].map(number),
            ["0.0", "99.9", "123", "1,234", "1,000,000"]
        );
        assert_eq!(percent(0.1234), "12.3%");
    }
}
