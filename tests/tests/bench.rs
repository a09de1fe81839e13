//! `metamorph bench`: exact figures are right, and files are written.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::run;
use serde_json::Value;

/// Runs a benchmark and reads the file that it has written.
fn bench(args: &[&str]) -> Value {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("bench.json");
    let ran = run(&[&["bench", "--quiet", "--json", path.to_str().unwrap()], args].concat());
    assert_eq!((ran.code, ran.out.as_str(), ran.err.as_str()), (Some(0), "", ""), "{args:?}");
    let results: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    assert_eq!((results["format"].as_str(), results["schema"].as_u64()), (Some("metamorph-bench"), Some(2)));
    results
}

#[test]
fn simulated_runs_have_the_exact_figures() {
    let results = bench(&["flood", "growth", "--most", "1000"]);
    let flood = &results["flood"];
    assert_eq!(flood.as_array().map(Vec::len), Some(1));
    // 2E − (N − 1) with N = 1,000 and E = 3 · 10² · 9.
    assert_eq!(flood[0]["messages"].as_u64(), Some(4_401));
    assert!(flood[0]["bytes_per_module"].as_f64().unwrap() > 0.0);
    let rows = results["growth"]["rows"].as_array().unwrap();
    assert_eq!(rows.len(), 3);
    for row in rows {
        assert_eq!((row["outcome"].as_str(), row["violations"].as_u64()), (Some("built"), Some(0)));
        assert!(row["moves"].as_u64() >= row["least_moves"].as_u64(), "{row}");
        let (walking, denials) = (&row["walking"], &row["walking"]["denials"]);
        assert!(walking["moving"].as_f64().unwrap() > 0.0 && denials["occupied"].is_u64(), "{row}");
        // Every move was asked for.
        assert!(walking["attempts_per_move"].as_f64().unwrap() >= 1.0, "{row}");
    }
    // The lower bound of the moves: the costs of the best assignments.
    let least: Vec<u64> = rows.iter().filter_map(|row| row["least_moves"].as_u64()).collect();
    assert_eq!(least, [60, 824, 3_096]);
    assert!(results["growth"]["makespan"]["exponent"].is_f64() && results["swarm"].is_null());
}

#[test]
fn a_swarm_of_processes_is_measured() {
    let results = bench(&["swarm", "--most", "100"]);
    let rows = results["swarm"]["rows"].as_array().unwrap();
    assert_eq!((rows.len(), rows[0]["modules"].as_u64()), (1, Some(100)));
    // 4 · 5 · 5 modules have 235 contacts.
    assert_eq!(rows[0]["messages"].as_u64(), Some(371));
    assert!(rows[0]["pss_bytes"].as_u64() > Some(0));
}

#[test]
fn a_file_that_cannot_be_written_is_refused_first() {
    let ran = run(&["bench", "flood", "--json", "/nowhere/bench.json"]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(2), ""));
    assert!(ran.err.contains("/nowhere/bench.json") && ran.err.contains("fix:"), "{}", ran.err);
}
