//! The figures of a run as tables agree with its report and with each other, on both links and for all families.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{Ran, run, run_processes, scenario};
use metamorph_world_controller::report::schema::{Quantiles, Report};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// A table: the numbers of each column, and texts as they are in the first.
struct Table {
    first: Vec<String>,
    columns: BTreeMap<String, Vec<Option<f64>>>,
}

impl Table {
    fn read(path: &Path) -> Table {
        let text = fs::read_to_string(path).unwrap();
        let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect::<Vec<String>>());
        let head = lines.next().unwrap();
        let rows: Vec<Vec<String>> = lines.collect();
        assert!(!rows.is_empty() && rows.iter().all(|row| row.len() == head.len()), "{text}");
        let column = |i: usize| rows.iter().map(|row| row[i].parse().ok()).collect();
        let columns = head.iter().enumerate().map(|(i, name)| (name.clone(), column(i))).collect();
        Table { first: rows.iter().map(|row| row[0].clone()).collect(), columns }
    }
    fn sum(&self, column: &str) -> u64 {
        self.columns[column].iter().flatten().sum::<f64>() as u64
    }
}

/// Runs a scenario with tables, and returns its report and the directory.
fn tabled(name: &str, options: &[&str]) -> (Report, tempfile::TempDir) {
    let directory = tempfile::tempdir().unwrap();
    let [tables, json] = ["tables", "report.json"].map(|n| directory.path().join(n).display().to_string());
    let file = scenario(name).display().to_string();
    let args = [&["run", &file, "--quiet", "--csv", &tables, "--json", &json], options].concat();
    let Ran { code, err, .. } = if options.contains(&"ipc") { run_processes(&args) } else { run(&args) };
    assert_eq!(code, Some(0), "{name}: {err}");
    (serde_json::from_str(&fs::read_to_string(json).unwrap()).unwrap(), directory)
}

/// Checks that the tables add up to the counts of the report.
fn add_up(report: &Report, directory: &Path) {
    let [modules, time, latency] =
        ["modules", "time", "latency"].map(|name| Table::read(&directory.join(format!("tables/{name}.csv"))));
    assert_eq!(modules.first.len() as u64, report.agents.launched);
    for (class, counts) in &report.messages.by_class {
        for (table, sent, delivered) in [(&modules, "sent", "received"), (&time, "sent", "delivered")] {
            let sums = [sent, delivered].map(|prefix| table.sum(&format!("{prefix}_{class}")));
            assert_eq!(sums, [counts.sent, counts.delivered], "{class}");
        }
        let of_class =
            latency.first.iter().zip(&latency.columns["messages"]).filter(|(name, _)| *name == class);
        assert_eq!(of_class.map(|(_, n)| n.unwrap() as u64).sum::<u64>(), counts.delivered, "{class}");
    }
    assert_eq!(modules.sum("deaths"), report.agents.crashed);
    if report.family == "cube" {
        assert_eq!(time.sum("actions"), report.moves);
    }
    // A structure that walks fills nothing; its report counts steps.
    if report.family != "free-module" {
        assert_eq!(time.columns["filled"].last().unwrap().unwrap() as u64, report.goal.filled);
    }
}

/// Returns a quantile of a class from the cells of `latency.csv`.
fn quantile(latency: &Table, class: &str, share: f64) -> f64 {
    let column = |name: &str, i: usize| latency.columns[name][i].unwrap();
    let mine: Vec<usize> = (0..latency.first.len()).filter(|i| latency.first[*i] == class).collect();
    let all: f64 = mine.iter().map(|i| column("messages", *i)).sum();
    let mut seen = 0.0;
    let cell = mine.into_iter().find(|i| {
        seen += column("messages", *i);
        seen >= share * all - 1e-9
    });
    column("greatest_s", cell.unwrap())
}

/// The latencies of the report are those that the records of the journal give.
#[test]
fn simulated_runs_have_tables() {
    for (name, options) in [
        (
            "swarm.toml",
            &["--loss", "5%", "--set", "link.delay=5ms..80ms", "--kill", "3@1s", "--pause", "7@2s..4s"][..],
        ),
        (
            "chair.toml",
            &["--set", "link.delay={quantiles=[[\"50%\",\"2ms\"],[\"99%\",\"20ms\"],[\"100%\",\"80ms\"]]}"],
        ),
        ("quadruped.toml", &["--set", "link.delay=1ms..9ms"]),
    ] {
        let (report, directory) = tabled(name, &[&["--link", "sim", "--seed", "5"], options].concat());
        add_up(&report, directory.path());
        let latency = Table::read(&directory.path().join("tables/latency.csv"));
        let told = report.messages.latency.unwrap();
        assert_eq!(told.channel, None);
        assert_eq!(told.all.count, report.messages.all.delivered);
        for (class, q) in &told.by_class {
            let Quantiles { p50_s, p90_s, p99_s, p999_s, greatest_s, .. } = *q;
            for (share, value) in
                [(0.5, p50_s), (0.9, p90_s), (0.99, p99_s), (0.999, p999_s), (1.0, greatest_s)]
            {
                assert_eq!(quantile(&latency, class, share), value, "{name}: {class} at {share}");
            }
        }
    }
}

/// A journal gives the same tables afterwards; without one there are none.
#[test]
fn a_journal_gives_the_same_tables() {
    let (_, directory) = tabled("swarm.toml", &["--link", "sim", "--seed", "2"]);
    let [tables, again] = ["tables", "again"].map(|name| directory.path().join(name));
    let journal = tables.join("run.journal").display().to_string();
    let ran = run(&["export", &journal, "--csv", &again.display().to_string()]);
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    for name in ["modules.csv", "time.csv", "latency.csv"] {
        assert_eq!(fs::read(tables.join(name)).unwrap(), fs::read(again.join(name)).unwrap(), "{name}");
    }
    let file = tables.join("time.csv").display().to_string();
    let refused = run(&["export", &journal, "--csv", &file]);
    assert_eq!(refused.code, Some(2));
    assert!(refused.err.contains("--csv") && refused.err.contains("fix:"), "{}", refused.err);
}

/// Processes measure all messages that are delivered, and part of the time is the machine's.
#[test]
fn runs_of_processes_have_tables() {
    let (report, directory) =
        tabled("swarm.toml", &["--link", "ipc", "--set", "fault=[]", "--set", "link.delay=20ms..40ms"]);
    add_up(&report, directory.path());
    let latency = report.messages.latency.unwrap();
    assert_eq!(latency.all.count, report.messages.all.delivered);
    assert!(latency.all.least_s >= 0.02, "{latency:?}");
    let channel = latency.channel.unwrap();
    assert_eq!(channel.count, latency.all.count);
    assert!(channel.least_s <= latency.all.greatest_s - 0.02, "{latency:?}");
}
