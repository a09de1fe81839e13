//! The proofs of `tests/proofs`: safety for any number of modules and hosts, by z3.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::root;
use metamorph_tests::required::{Check, skip};
use serde_json::Value;
use std::path::PathBuf;
use std::process::Command;

/// Seeded defects of the code that the models refuse. Further ones are of the models alone.
const DEFECTS: [&str; 27] = [
    "IgnoreTurns",
    "TrustArrival",
    "OneColour",
    "ClusterOrder",
    "BelieveAfterRestart",
    "GrantAfterRestart",
    "ShortLease",
    "NoDeadline",
    "IgnoreLocks",
    "ReserveTwice",
    "NoListening",
    "IgnoreSkew",
    "AdoptUnacknowledged",
    "DropSilentChildren",
    "IgnoreStrangers",
    "LetGoUnproved",
    "ChildProves",
    "ForgetSaid",
    "LetGoOldDeath",
    "GrantEverything",
    "AskNone",
    "ForgetLocks",
    "OutstayLease",
    "LeaseByHearing",
    "TakeDoubled",
    "SkipGaps",
    "TrustAnyLife",
];

/// Returns a Python that has z3: that of `.ci/run`, or the system's.
fn prover() -> Option<PathBuf> {
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), PathBuf::from);
    let has_z3 = |python: &PathBuf| {
        let asked = Command::new(python).args(["-c", "import z3"]).output();
        asked.is_ok_and(|output| output.status.success())
    };
    [target.join("proofs/bin/python"), PathBuf::from("python3")].into_iter().find(has_z3)
}

#[test]
fn the_protocols_are_safe_for_any_number_of_modules() {
    let Some(python) = prover() else {
        return skip(
            Check::Proofs,
            "there is no Python with z3 (pip install -r tests/proofs/requirements.txt)",
        );
    };
    let output = Command::new(python)
        .args(["-B", "tests/proofs/prove.py", "--defects", "--json"])
        .current_dir(root())
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    let all: Value = serde_json::from_str(&text).unwrap_or_else(|error| panic!("{error}: {output:?}"));
    assert!(output.status.success() && all["is_fine"] == true, "{text}");
    let parts = all["parts"].as_array().unwrap();
    let page = std::fs::read_to_string(root().join("docs/proofs.md")).unwrap();
    for part in parts {
        let (title, proved) = (part["title"].as_str().unwrap(), part["proved"].as_u64().unwrap());
        let row = page.lines().find(|line| line.starts_with(&format!("| {title} |")));
        let is_told = row.is_some_and(|row| row.ends_with(&format!("| {proved} |")));
        assert!(is_told, "docs/proofs.md: {title} has {proved} obligations");
    }
    let refusals: Vec<&Value> = parts.iter().flat_map(|part| part["refused"].as_array().unwrap()).collect();
    let is_missing = |defect: &&str| !refusals.iter().any(|refusal| refusal["defect"] == **defect);
    let missing: Vec<&str> = DEFECTS.into_iter().filter(is_missing).collect();
    assert!(missing.is_empty(), "not refused: {missing:?}");
    let by_run = refusals.iter().filter(|refusal| refusal["by"].as_str().unwrap().starts_with("run")).count();
    let counts = format!(
        "{} variants with a defect are refused, {by_run} by a written run and {} by a counterexample",
        refusals.len(),
        refusals.len() - by_run
    );
    assert!(page.replace('\n', " ").contains(&counts), "docs/proofs.md: {counts}");
}
