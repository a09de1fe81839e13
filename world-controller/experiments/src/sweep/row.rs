//! One run as a line of `runs.csv`.
//!
//! A line has the number of the run, the values of its combination, and the fields of [`Row`] in their order.
//! No field contains a line break.

use csv::StringRecord;
use metamorph_protocol::counters::Class;
use metamorph_report::schema::Report;
use metamorph_scenario::grid::Grid;
use metamorph_sim_bridge::director::outcome::Outcome;
use serde::{Deserialize, Serialize};
use std::io::Write;
use thiserror::Error;

/// The result of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// The seed.
    pub seed: u64,
    /// The outcome.
    pub outcome: Outcome,
    /// Why the goal was not built, in one word: the reason of the standstill, or the first violated
    /// invariant.
    pub reason: String,
    /// Filled cells of the last goal.
    pub filled: u64,
    /// Goal cells.
    pub cells: u64,
    /// Moves completed.
    pub moves: u64,
    /// Steps of joints; for metamodules only.
    pub turns: Option<u64>,
    /// Standstills in the course of the run.
    pub standstills: u64,
    /// Standstills that the controller resolved.
    pub rescued: u64,
    /// Moves of cubes that the controller called.
    pub called: u64,
    /// Moves that the controller led by a plan.
    pub led: u64,
    /// Attempts to use one cell twice that negotiation prevented.
    pub collisions_prevented: u64,
    /// Attempts to use one cell twice that the body refused.
    pub collisions_refused: u64,
    /// Attempts to use one cell twice that succeeded.
    pub collisions_suffered: u64,
    /// Messages of class gradient.
    pub sent_gradient: u64,
    /// Messages of class seed.
    pub sent_seed: u64,
    /// Messages of class connectivity.
    pub sent_connectivity: u64,
    /// Messages of class negotiation.
    pub sent_negotiation: u64,
    /// Messages of class world.
    pub sent_world: u64,
    /// Messages of class liveness.
    pub sent_liveness: u64,
    /// Messages of class gait.
    pub sent_gait: u64,
    /// Latency that half of the messages do not exceed, in seconds of scenario time; `None` if none was delivered.
    pub latency_p50_s: Option<f64>,
    /// Latency that 99 % of the messages do not exceed.
    pub latency_p99_s: Option<f64>,
    /// Time at which the last goal cell was filled, in seconds of scenario time, if all were.
    pub makespan_s: Option<f64>,
    /// End of the run in seconds of scenario time.
    pub end_s: f64,
    /// Faults that struck.
    pub faults_struck: u64,
    /// Violations of invariants.
    pub violations: u64,
    /// A hash of all events: their times, modules and kinds.
    pub trace_hash: String,
    /// A hash of the states of all agents and bodies, at regular points of the run and at its end.
    pub state_hash: String,
}

impl Row {
    /// The names of the columns.
    pub const COLUMNS: [&str; 29] = [
        "seed",
        "outcome",
        "reason",
        "filled",
        "cells",
        "moves",
        "turns",
        "standstills",
        "rescued",
        "called",
        "led",
        "collisions_prevented",
        "collisions_refused",
        "collisions_suffered",
        "sent_gradient",
        "sent_seed",
        "sent_connectivity",
        "sent_negotiation",
        "sent_world",
        "sent_liveness",
        "sent_gait",
        "latency_p50_s",
        "latency_p99_s",
        "makespan_s",
        "end_s",
        "faults_struck",
        "violations",
        "trace_hash",
        "state_hash",
    ];

    /// Creates the row of a report.
    pub fn of(report: &Report) -> Row {
        let outcome = Outcome::ALL.into_iter().find(|o| o.name() == report.outcome);
        let outcome = outcome.expect("invariant: reports name an outcome");
        let sent = |class: Class| report.messages.by_class.get(class.name()).map_or(0, |c| c.sent);
        let broken = report.invariants.violated.first().map(|v| &v.invariant);
        let reason = match outcome {
            Outcome::Built => None,
            Outcome::Unsafe => broken,
            _ => report.unbuilt.as_ref().map(|stall| &stall.reason),
        };
        let built = outcome == Outcome::Built;
        Row {
            seed: report.seed,
            outcome,
            reason: reason.cloned().unwrap_or_default(),
            filled: report.goal.filled,
            cells: report.goal.cells,
            moves: report.moves,
            turns: report.family_text.joint_steps,
            standstills: report.standstills.as_ref().map_or(0, |s| s.count),
            rescued: report.standstills.as_ref().map_or(0, |s| s.rescued),
            called: report.move_details.called,
            led: report.move_details.led,
            collisions_prevented: report.collisions.prevented,
            collisions_refused: report.collisions.refused,
            collisions_suffered: report.collisions.suffered,
            sent_gradient: sent(Class::Gradient),
            sent_seed: sent(Class::Seed),
            sent_connectivity: sent(Class::Connectivity),
            sent_negotiation: sent(Class::Negotiation),
            sent_world: sent(Class::World),
            sent_liveness: sent(Class::Liveness),
            sent_gait: sent(Class::Gait),
            latency_p50_s: report.messages.latency.as_ref().map(|l| l.all.p50_s),
            latency_p99_s: report.messages.latency.as_ref().map(|l| l.all.p99_s),
            makespan_s: report.stages.last().and_then(|s| s.built_s).filter(|_| built),
            end_s: report.time.virtual_s,
            faults_struck: report.faults.len() as u64,
            violations: report.invariants.broken,
            trace_hash: report.trace_hash.clone().unwrap_or_default(),
            state_hash: report.state_hash.clone().unwrap_or_default(),
        }
    }

    /// Returns the number of messages sent.
    pub fn messages(&self) -> u64 {
        self.sent_gradient
            + self.sent_seed
            + self.sent_connectivity
            + self.sent_negotiation
            + self.sent_world
            + self.sent_liveness
            + self.sent_gait
    }
    /// Returns the number of attempts to use one cell twice.
    pub fn collisions(&self) -> u64 {
        self.collisions_prevented + self.collisions_refused + self.collisions_suffered
    }
}

/// Why a line is not a run of this sweep.
#[derive(Debug, Error)]
pub enum RowError {
    /// Not the fields of a run.
    #[error("it is not a run: {0}")]
    Fields(#[from] csv::Error),
    /// The number of fields is wrong.
    #[error("it has {found} fields instead of {expected}")]
    Length {
        /// The number found.
        found: usize,
        /// The number expected.
        expected: usize,
    },
    /// Its values contradict its number.
    #[error("its number, its seed and its values are not those of a run of this sweep")]
    Other,
}

/// Writes the heading.
pub fn write_header<W: Write>(out: &mut csv::Writer<W>, grid: &Grid) -> csv::Result<()> {
    let keys = grid.vary.iter().map(|axis| axis.key.as_str());
    out.write_record(["run"].into_iter().chain(keys).chain(Row::COLUMNS))
}

/// Writes the line of a run.
pub fn write<W: Write>(out: &mut csv::Writer<W>, grid: &Grid, run: u64, row: &Row) -> csv::Result<()> {
    out.serialize((run, grid.values(grid.combination(run)), row))
}

/// Reads the line of a run.
pub fn read(line: &[u8], grid: &Grid) -> Result<(u64, Row), RowError> {
    let mut reader = csv::ReaderBuilder::new().has_headers(false).buffer_capacity(1 << 10).from_reader(line);
    let mut record = StringRecord::new();
    reader.read_record(&mut record)?;
    let (found, keys) = (record.len(), grid.vary.len());
    let expected = 1 + keys + Row::COLUMNS.len();
    if found != expected {
        return Err(RowError::Length { found, expected });
    }
    let run: u64 = record[0].parse().map_err(|_| RowError::Other)?;
    let row: Row = record.iter().skip(1 + keys).collect::<StringRecord>().deserialize(None)?;
    let values = || grid.values(grid.combination(run));
    if run >= grid.runs() || row.seed != grid.seed(run) || !record.iter().skip(1).take(keys).eq(values()) {
        return Err(RowError::Other);
    }
    Ok((run, row))
}

#[cfg(test)]
mod tests {
    use super::super::testing::row;
    use super::*;
    use metamorph_scenario::grid::{Axis, Seeds};

    fn grid() -> Grid {
        let axis = |text| Axis::parse(text).unwrap();
        let vary = vec![axis("a=\"x,\"\"y\", z "), axis("b=[1, 2],3")];
        Grid::new(Seeds { from: 7, until: 9 }, vary).unwrap()
    }

    fn lines(run: u64, row: &Row) -> String {
        let mut out = csv::WriterBuilder::new().has_headers(false).from_writer(Vec::new());
        write_header(&mut out, &grid()).unwrap();
        write(&mut out, &grid(), run, row).unwrap();
        String::from_utf8(out.into_inner().unwrap()).unwrap()
    }

    #[test]
    fn lines_are_read_as_they_were_written() {
        for (run, expected) in
            [(0, row(7)), (7, Row { outcome: Outcome::Deadlock, turns: None, makespan_s: None, ..row(8) })]
        {
            let text = lines(run, &expected);
            let (header, line) = text.trim_end().split_once('\n').unwrap();
            assert_eq!(read(line.as_bytes(), &grid()).unwrap(), (run, expected));
            assert_eq!(header.split(',').count(), 3 + Row::COLUMNS.len());
        }
    }

    /// The columns of the heading are the fields, in their order.
    #[test]
    fn columns_are_the_fields() {
        let mut out = csv::Writer::from_writer(Vec::new());
        out.serialize(row(7)).unwrap();
        let text = String::from_utf8(out.into_inner().unwrap()).unwrap();
        assert_eq!(text.lines().next().unwrap(), Row::COLUMNS.join(","));
    }

    #[test]
    fn other_lines_are_refused() {
        let text = lines(0, &row(7));
        let line = text.lines().nth(1).unwrap();
        for (old, new) in [
            ("0,", "1,"),
            ("0,", "8,"),
            ("0,", "-,"),
            (",7,", ",8,"),
            ("built", "bilt"),
            ("[1, 2]", "[1]"),
            (",1.25,", ",,,"),
            (",23,", ",x,"),
        ] {
            assert!(line.contains(old), "{old}");
            assert!(read(line.replacen(old, new, 1).as_bytes(), &grid()).is_err(), "{old} -> {new}");
        }
        assert!(read(b"", &grid()).is_err() && read(&[0xFF, b',', 0xFF], &grid()).is_err());
    }
}
