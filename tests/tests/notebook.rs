//! The example notebook is valid, and reads columns that a sweep writes. Not here: running it, which would
//! need Python.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{root, run, scenario};
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;

#[test]
fn the_notebook_reads_columns_of_a_sweep() {
    let text = fs::read_to_string(root().join("deploy/notebooks/runs.ipynb")).unwrap();
    let notebook: Value = serde_json::from_str(&text).unwrap();
    assert_eq!((&notebook["nbformat"], &notebook["nbformat_minor"]), (&4.into(), &5.into()));
    assert!(notebook["metadata"].is_object());
    let (mut ids, mut code) = (BTreeSet::new(), String::new());
    for cell in notebook["cells"].as_array().unwrap() {
        assert!(ids.insert(cell["id"].as_str().unwrap().to_owned()), "two cells have one id");
        let source = cell["source"].as_array().unwrap().iter().map(|line| line.as_str().unwrap());
        match cell["cell_type"].as_str().unwrap() {
            "markdown" => {}
            "code" => {
                // No results of a run are stored.
                assert!(cell["execution_count"].is_null() && cell["outputs"].as_array().unwrap().is_empty());
                code.extend(source);
                code.push('\n');
            }
            other => panic!("a cell of the type {other}"),
        }
    }
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("out");
    let path = scenario("arch.toml");
    let args =
        ["sweep", path.to_str().unwrap(), "--seeds", "0..2", "--quiet", "--out", out.to_str().unwrap()];
    assert_eq!(run(&args).code, Some(0));
    let header = fs::read_to_string(out.join("runs.csv")).unwrap();
    let columns: Vec<&str> = header.lines().next().unwrap().split(',').collect();
    assert!(columns.iter().any(|c| c.starts_with("sent_")) && columns.contains(&"seed"));
    let mut read = 0;
    for name in code.split("runs[\"").skip(1).map(|rest| rest.split('"').next().unwrap()) {
        let made_here = code.contains(&format!("runs[\"{name}\"] = "));
        assert!(made_here || columns.contains(&name), "a sweep writes no column `{name}`");
        read += usize::from(!made_here);
    }
    assert!(read > 4, "the columns were not found");
}
