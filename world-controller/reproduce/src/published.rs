//! The published numbers: Tables 4.1 and 4.2, cell by cell and with the printed sums, and the true sums of
//! the cells. Absent: judging (see `compare`).

use metamorph_protocol::metamodule::params::Strategy;
use metamorph_protocol::roombots::Kind;
use serde::{Deserialize, Serialize};

/// The kinds in the order of the rows.
pub const KINDS: [Kind; 4] = [Kind::Par, Kind::Per, Kind::Srs, Kind::Srz];
/// The strategies in the order of the columns.
pub const STRATEGIES: [Strategy; 3] = Strategy::PUBLISHED;

/// One experiment: its collisions, and whether it ended in a deadlock (`*`).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Cell {
    /// Collisions. Those of deadlocks are left out of the sums.
    pub collisions: u32,
    /// True if the goal was not built.
    pub deadlock: bool,
}

impl Cell {
    /// Formats it as printed.
    pub fn text(self) -> String {
        format!("{}{}", self.collisions, if self.deadlock { "*" } else { "" })
    }
}

/// A printed sum, and the sum of its cells.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Sum {
    /// Name of the sum: `DL of PAR`, `CL of slope`.
    pub what: String,
    /// The printed sum.
    pub printed: u32,
    /// The sum of the cells.
    pub cells: u32,
}

impl Sum {
    /// Returns true if the two are equal.
    pub fn agrees(&self) -> bool {
        self.printed == self.cells
    }
}

/// A table of the thesis. For each kind and strategy some experiments, then deadlocks (DL) and collisions
/// (CL) of the kind.
pub struct Table {
    /// A row of each kind as printed; `|` between strategies.
    rows: [&'static str; 4],
    /// The last but one line: deadlocks of each strategy and of all.
    deadlocks: [u32; 4],
    /// The last line: collisions of each strategy.
    collisions: [u32; 3],
}

/// Table 4.1: four metamodules, the box, three experiments each.
pub const TABLE_4_1: Table = Table {
    rows: [
        "4* 0 0* | 0* 2 12* | 0* 2 2* | 6 4",
        "5* 0 2* | 1* 1 0 | 0 1 0 | 3 2",
        "0 0 0 | 0* 3 5 | 0 0 1 | 1 9",
        "0 1 0 | 0 0 0 | 1 0 0 | 0 2",
    ],
    deadlocks: [4, 4, 2, 10],
    collisions: [1, 4, 5],
};

/// Table 4.2: six metamodules, the chair, four experiments each.
pub const TABLE_4_2: Table = Table {
    rows: [
        "0* 0* 1* 3 | 7* 1* 1* 0 | 9* 2* 1* 2* | 10 3",
        "1 6 0* 8 | 2 1 2 1 | 5 1 1 1* | 2 28",
        "0* 2 1 0 | 1* 1* 1 0* | 8 7 0 6 | 4 25",
        "0 0 2 0* | 0* 2 0 3 | 2 0* 1* 4* | 5 9",
    ],
    deadlocks: [6, 7, 8, 21],
    collisions: [25, 12, 30],
};

impl Table {
    /// Splits a row into groups: one for each strategy, and the sums.
    fn row(&self, kind: Kind) -> Vec<&'static str> {
        let row = KINDS.iter().position(|k| *k == kind);
        row.map_or(Vec::new(), |i| self.rows[i].split('|').collect())
    }

    /// Returns the experiments with a kind and a strategy; empty for a strategy that the thesis does not
    /// have.
    pub fn cells(&self, kind: Kind, strategy: Strategy) -> Vec<Cell> {
        let column = STRATEGIES.iter().position(|s| *s == strategy);
        let group = column.and_then(|i| self.row(kind).get(i).copied()).unwrap_or_default();
        group.split_whitespace().map(cell).collect()
    }

    /// Returns all printed sums.
    pub fn sums(&self) -> Vec<Sum> {
        let all = |kinds: &[Kind], strategies: &[Strategy]| -> Vec<Cell> {
            let pairs = kinds.iter().flat_map(|k| strategies.iter().map(move |s| (*k, *s)));
            pairs.flat_map(|(k, s)| self.cells(k, s)).collect()
        };
        let mut sums = Vec::new();
        let mut add = |what: String, printed, cells| sums.push(Sum { what, printed, cells });
        for kind in KINDS {
            let cells = all(&[kind], &STRATEGIES);
            let printed: Vec<u32> = self.row(kind).last().map_or(Vec::new(), |text| numbers(text));
            add(format!("DL of {kind}"), printed[0], deadlocks(&cells));
            add(format!("CL of {kind}"), printed[1], collisions(&cells));
        }
        for (i, strategy) in STRATEGIES.into_iter().enumerate() {
            let cells = all(&KINDS, &[strategy]);
            add(format!("DL of {}", strategy.name()), self.deadlocks[i], deadlocks(&cells));
            add(format!("CL of {}", strategy.name()), self.collisions[i], collisions(&cells));
        }
        add("DL of all".to_owned(), self.deadlocks[3], deadlocks(&all(&KINDS, &STRATEGIES)));
        sums
    }
}

/// Returns the number of deadlocks.
pub fn deadlocks(cells: &[Cell]) -> u32 {
    cells.iter().filter(|c| c.deadlock).count() as u32
}

/// Returns the collisions of the experiments without a deadlock.
pub fn collisions(cells: &[Cell]) -> u32 {
    cells.iter().filter(|c| !c.deadlock).map(|c| c.collisions).sum()
}

fn cell(text: &str) -> Cell {
    let (number, deadlock) = text.strip_suffix('*').map_or((text, false), |number| (number, true));
    Cell { collisions: number.parse().expect("invariant: the tables above hold numbers"), deadlock }
}

fn numbers(text: &str) -> Vec<u32> {
    let number = |n: &str| n.parse().expect("invariant: the tables above hold numbers");
    text.split_whitespace().map(number).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_are_whole() {
        for (table, each) in [(&TABLE_4_1, 3), (&TABLE_4_2, 4)] {
            for kind in KINDS {
                for strategy in STRATEGIES {
                    assert_eq!(table.cells(kind, strategy).len(), each, "{kind} {}", strategy.name());
                }
                assert!(table.cells(kind, Strategy::Negotiated).is_empty());
            }
            assert_eq!(table.sums().len(), 4 * 2 + 3 * 2 + 1);
        }
        let first = TABLE_4_1.cells(Kind::Par, Strategy::Greedy);
        assert_eq!(first.iter().map(|c| c.text()).collect::<Vec<_>>(), ["4*", "0", "0*"]);
        assert_eq!((deadlocks(&first), collisions(&first)), (2, 0));
    }

    /// Two of the printed sums are not those of their cells; all others are.
    #[test]
    fn two_printed_sums_disagree_with_their_cells() {
        let wrong = |table: &Table| -> Vec<(String, u32, u32)> {
            let sums = table.sums().into_iter().filter(|s| !s.agrees());
            sums.map(|s| (s.what, s.printed, s.cells)).collect()
        };
        assert_eq!(wrong(&TABLE_4_1), [("CL of slope".to_owned(), 4, 11)]);
        assert_eq!(wrong(&TABLE_4_2), [("CL of greedy".to_owned(), 25, 23)]);
    }

    /// Kinds and strategies count the same cells, so that their sums over the whole table agree.
    #[test]
    fn rows_and_columns_sum_up_to_the_same() {
        for (table, deadlocks, collisions) in [(&TABLE_4_1, 10, 17), (&TABLE_4_2, 21, 65)] {
            let sums = table.sums();
            let total = |what: &str, of: &[&str]| -> u32 {
                of.iter()
                    .flat_map(|o| sums.iter().find(|s| s.what == format!("{what} of {o}")))
                    .map(|s| s.cells)
                    .sum()
            };
            for of in [&["PAR", "PER", "SRS", "SRZ"][..], &["greedy", "slope", "step"]] {
                assert_eq!((total("DL", of), total("CL", of)), (deadlocks, collisions));
            }
        }
    }
}
