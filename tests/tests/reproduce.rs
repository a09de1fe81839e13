//! `metamorph reproduce` as a user runs it.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::run;
use metamorph_world_controller::experiments::reproduce::compare::{Reproduction, SCHEMA};
use serde_json::Value;
use std::fs;

#[test]
fn published_and_own_numbers_stand_side_by_side() {
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("results");
    let json = directory.path().join("numbers.json");
    let (out_text, json_text) = (out.display().to_string(), json.display().to_string());
    let ran = run(&["reproduce", "4.1", "--seeds", "1", "--out", &out_text, "--json", &json_text]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    for part in [
        "Table 4.1: four metamodules build the box",
        "4* 0 0*",
        "CL of slope is printed as 4, its cells add up to 11",
        "negotiated",
        "95 % interval",
        "What the thesis does not say",
        "re-implemented: the nearest reading",
        "locks on swept cells alone",
        "protocol.precedence=off",
        "starts redrawn because a metamodule was enclosed",
        "What the nearest reading leaves unexplained",
        "Start positions",
    ] {
        assert!(ran.out.contains(part), "`{part}` is missing in {}", ran.out);
    }
    let all: Reproduction = serde_json::from_str(&fs::read_to_string(&json).unwrap()).unwrap();
    // 4 kinds and 3 orders, with 4 strategies, and with 3 without precedence; 13 assumptions with 3 and 3 with 2.
    let runs = 4 * 3 * (4 + 3 + 13 * 3 + 3 * 2);
    assert_eq!((all.schema, all.runs, all.runs_planned, all.violations), (SCHEMA, runs, runs, 0));
    assert_eq!((all.fits.len(), all.fits[0].cells.len(), all.redrawn.len()), (2, 3, 4));
    // Three orders besides.
    assert_eq!(all.assumptions.len(), 13 + 3 + 3);
    assert!(all.assumptions.iter().flat_map(|a| &a.built).all(|b| b.runs > 0));
    assert_eq!(all.experiments[0].cells.len(), 16);
    for file in [
        "report.html",
        "box.toml",
        "box/manifest.json",
        "box/runs.csv",
        "box/summary.json",
        "box/report.html",
    ] {
        assert!(out.join(file).is_file(), "{file} is missing");
    }
    let page = fs::read_to_string(out.join("report.html")).unwrap();
    assert!(page.contains("metamorph reproduce 4.1 --seeds 1") && page.contains("4, really 11"));
    // One of the runs alone, from the scenario that the command wrote.
    let runs = fs::read_to_string(out.join("box/runs.csv")).unwrap();
    let line = runs.lines().find(|line| line.contains(",SRS,negotiated,crosswise,")).unwrap();
    let scenario = out.join("box.toml").display().to_string();
    let ran = run(&[
        "run",
        &scenario,
        "--link",
        "sim",
        "--seed",
        "0",
        "--quiet",
        "--json",
        "-",
        "--set",
        "swarm.kind=SRS",
        "--set",
        "protocol.strategy=negotiated",
        "--set",
        "goal.0.order=crosswise",
    ]);
    let report: serde_json::Value = serde_json::from_str(&ran.out).unwrap();
    let [trace, state] = ["trace_hash", "state_hash"].map(|hash| report[hash].as_str().unwrap());
    assert!(line.ends_with(&format!("{trace},{state}")), "{line} {trace} {state}");
}

#[test]
fn bad_arguments_are_refused() {
    let full = tempfile::tempdir().unwrap();
    fs::write(full.path().join("something"), "").unwrap();
    let full = full.path().display().to_string();
    let cases: &[(&[&str], &str)] = &[
        (&[], "EXPERIMENT"),
        (
            &["4.3"],
            "[possible values: 4.1, 4.2, fig4.5, gripping, stoy, why, graph-signature, on-grid, reward-map, planned, thesis-7, torque, transport, appendix-b, c.6, 8.2, e]",
        ),
        (&["4.1", "--seeds", "0"], "--seeds"),
        (&["4.1", "--seeds", "1000000"], "--seeds"),
        (&["4.1", "--out", &full], "is not empty\n  fix: "),
        (&["4.1", "--json", "/no/such/directory/numbers.json"], "cannot write there"),
    ];
    for (args, part) in cases {
        let ran = run(&[&["reproduce"], *args].concat());
        assert_eq!(ran.code, Some(2), "{args:?}: {ran:?}");
        assert!(ran.err.contains(part) && ran.out.is_empty(), "`{part}` is missing in: {}", ran.err);
    }
    let help = run(&["reproduce", "--help"]).out;
    for part in ["fig4.5", "--seeds", "--jobs", "--out", "--json", "Exit codes", "Examples"] {
        assert!(help.contains(part), "`{part}` is missing in {help}");
    }
}

/// Pairings of the thesis: no method finds more pairs than a maximum matching, and the printed F of the study is that of
/// one factor.
#[test]
fn pairings_and_the_study_stand_beside_the_printed_numbers() {
    let ran = run(&["reproduce", "c.6", "8.2", "--seeds", "3", "--json", "-"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let answer: serde_json::Value = serde_json::from_str(&ran.out).unwrap();
    let row = |table: usize, what: &str| {
        let rows = answer["planners"][table]["rows"].as_array().unwrap();
        let row = rows.iter().find(|row| row["what"] == what).unwrap();
        (row["published"].as_str().unwrap().to_owned(), row["ours"].as_str().unwrap().to_owned())
    };
    assert_eq!(row(0, "graphs with more pairs than a maximum matching").1, "0 of 90");
    let (published, ours) = row(1, "local precision p_l, mobility");
    assert_eq!(row(1, "global precision p_g, augmented, dynamic"), ("1.12 (.081)".to_owned(), String::new()));
    assert!(published.starts_with("F(1,46) 5.86") && ours.starts_with("F(1,46) 5.861, p 0.0195"), "{ours}");
}

/// The order of appendix B leaves the plate of a table over, and one of its two measures cannot be computed.
#[test]
fn appendix_b_contradicts_itself_on_a_table() {
    let ran = run(&["reproduce", "appendix-b"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let first = ran.out.find("32.27").unwrap();
    assert!(ran.out.find("35.59").unwrap() > first);
    for part in ["SC overflows double precision", "contradiction 1", "contradiction 2", "--planner thesis"] {
        assert!(ran.out.contains(part), "`{part}` is missing in {}", ran.out);
    }
}

/// Trials that are kept are not repeated, and a figure of a sample has its interval and its test.
#[test]
fn trials_are_kept_and_continued() {
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("runs").display().to_string();
    let stoy = |seeds: &str| {
        let ran = run(&["reproduce", "stoy", "--seeds", seeds, "--out", &out, "--json", "-"]);
        assert_eq!(ran.code, Some(0), "{ran:?}");
        serde_json::from_str::<serde_json::Value>(&ran.out).unwrap()
    };
    let kept = || fs::read_to_string(directory.path().join("runs/stoy.jsonl")).unwrap();
    let first = stoy("1");
    // A head, four sizes and five delays.
    assert_eq!(kept().lines().count(), 1 + 4 + 5);
    assert_eq!(stoy("1"), first);
    let second = stoy("2");
    assert_eq!(kept().lines().count(), 1 + 2 * (4 + 5));
    let rows = second["planners"][0]["rows"].as_array().unwrap();
    let row = |what: &str| rows.iter().find(|row| row["what"] == what).unwrap();
    let built = row("1058 modules: built");
    assert_eq!((built["ours"].as_str(), built["n"].as_u64()), (Some("100.0%"), Some(2)), "{built}");
    assert!(built["interval"].as_str().unwrap().ends_with(" to 100.0%"), "{built}");
    let exponent = row("moves grow as N to the power of")["ours"].as_str().unwrap().parse::<f64>().unwrap();
    assert!((1.0..2.0).contains(&exponent), "{exponent}");
    // Where messages take the same time, the published rule is safe.
    let safe = rows.iter().find(|row| row["what"].as_str().unwrap().ends_with("50 ms each: safe")).unwrap();
    assert_eq!(safe["ours"], "100.0%", "{safe}");
}

/// The shares that decide the outcome: a table, a figure, and trials from which the same command continues.
#[test]
fn what_decides_is_split_into_shares() {
    let dir = tempfile::tempdir().unwrap();
    let path = |name: &str| dir.path().join(name).display().to_string();
    let out = path("placements");
    let table = |seeds: &str, json: &str| {
        let ran = run(&["reproduce", "why", "--seeds", seeds, "--out", &out, "--json", json, "--quiet"]);
        assert_eq!(ran.code, Some(0), "{ran:?}");
        let json: Value = serde_json::from_str(&std::fs::read_to_string(json).unwrap()).unwrap();
        json["planners"][0]["rows"].as_array().unwrap().clone()
    };
    assert!(table("2", &path("two.json")).iter().all(|row| !row["ours"].as_str().unwrap().contains("NaN")));
    let rows = table("12", &path("twelve.json"));
    assert!(rows.len() > 20 && rows.iter().all(|row| row["n"] == 12), "{rows:?}");
    let lines = std::fs::read_to_string(dir.path().join("placements/why.jsonl")).unwrap().lines().count();
    assert_eq!(lines, 1 + 2 * 12);
    let svg = path("shares.svg");
    let drawn = run(&["reproduce", "why", "--seeds", "12", "--out", &out, "--plot", &svg, "--quiet"]);
    let figure = std::fs::read_to_string(&svg).unwrap();
    assert!(drawn.code == Some(0) && figure.starts_with("<svg ") && !figure.contains("NaN"), "{drawn:?}");
    let refused = run(&["reproduce", "stoy", "--seeds", "1", "--plot", &svg]);
    assert!(refused.code == Some(2) && refused.err.contains("only `why` has a plot"), "{refused:?}");
}
