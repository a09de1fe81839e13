//! Text columns for the terminal.

use crate::paint::Paint;

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
    /// Formats the table, with its heading painted.
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
}
