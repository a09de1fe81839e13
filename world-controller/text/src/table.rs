//! Text columns for the terminal.

use crate::paint::Paint;
use std::ops::Range;

/// Largest width of a key in columns; longer keys are cut.
const WIDTH: usize = 32;

/// Text columns: keys left-aligned, numbers right-aligned.
pub struct Table {
    keys: usize,
    rows: Vec<Vec<String>>,
}

impl Table {
    /// Creates a table with these key columns.
    pub fn new(keys: &[&str]) -> Table {
        Table { keys: keys.len(), rows: vec![keys.iter().map(|k| cut(k)).collect()] }
    }
    /// Adds number columns.
    pub fn head(&mut self, names: &[&str]) {
        self.rows[0].extend(names.iter().map(|n| (*n).to_owned()));
    }
    /// Adds a row.
    pub fn row(&mut self, keys: &[String], numbers: Vec<String>) {
        self.rows.push(keys.iter().map(|k| cut(k)).chain(numbers).collect());
    }
    /// Adds a row whose keys are not cut.
    pub fn whole_row(&mut self, keys: &[String], numbers: Vec<String>) {
        self.rows.push(keys.iter().cloned().chain(numbers).collect());
    }
    /// Formats the table, with its heading painted. If it is wider than a line, it is folded: further columns follow below, with
    /// the keys before them again.
    pub fn text(&self, paint: Paint) -> String {
        let length = |text: &String| text.chars().count();
        let columns = self.rows[0].len();
        let widths: Vec<usize> = (0..columns)
            .map(|i| self.rows.iter().filter_map(|row| row.get(i)).map(length).max().unwrap_or(0))
            .collect();
        let mut out = String::new();
        for part in self.parts(&widths, paint.width()) {
            for (i, row) in self.rows.iter().enumerate() {
                let mut line = String::new();
                for j in (0..self.keys).chain(part.clone()) {
                    let (cell, width) = (row.get(j).map_or("", String::as_str), widths[j]);
                    line += "  ";
                    line +=
                        &if j < self.keys { format!("{cell:<width$}") } else { format!("{cell:>width$}") };
                }
                let line = line.trim_end();
                out += &if i == 0 { paint.strong(line) } else { line.to_owned() };
                out.push('\n');
            }
        }
        out
    }
    /// Returns the number columns that stand side by side, at least one each time.
    fn parts(&self, widths: &[usize], line: usize) -> Vec<Range<usize>> {
        let together = |columns: &[usize]| columns.iter().map(|width| width + 2).sum::<usize>();
        let keys = together(&widths[..self.keys]);
        let mut parts: Vec<Range<usize>> = Vec::new();
        for column in self.keys..widths.len() {
            match parts.last_mut() {
                Some(last) if keys + together(&widths[last.start..=column]) <= line => last.end = column + 1,
                _ => parts.push(column..column + 1),
            }
        }
        if parts.is_empty() {
            parts.push(self.keys..self.keys);
        }
        parts
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
    fn a_wide_table_is_folded_with_its_keys() {
        let mut table = Table::new(&["key"]);
        table.head(&["first", "second", "third"]);
        table.row(&["a".into()], vec!["1".into(), "2".into(), "3".into()]);
        let text = table.text(Paint::PLAIN.within(22));
        assert_eq!(text, "  key  first  second\n  a        1       2\n  key  third\n  a        3\n");
        assert_eq!(table.text(Paint::PLAIN).lines().count(), 2);
        // A column is never left out.
        assert_eq!(table.text(Paint::PLAIN.within(1)).lines().count(), 6);
    }
}
