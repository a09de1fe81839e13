//! A family that is no part of the program gets what the built-in ones have: scenarios that are checked,
//! both links, reports, journals and replay, recordings for viewers, and exploration.
#![allow(clippy::unwrap_used, reason = "what cannot be done here fails the test")]

use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

const SCENARIO: &str = "version = 1\n[swarm]\nfamily = \"election\"\nside = 4\n\
    [[goal]]\nname = \"a leader\"\n[link]\nloss = \"10%\"\n[[fault]]\nkill = 5\nat = \"1s\"\n";

fn metamorph(directory: &Path, args: &[&str]) -> Output {
    let program = env!("CARGO_BIN_EXE_metamorph-election");
    Command::new(program).current_dir(directory).args(args).output().unwrap()
}

fn report(directory: &Path, link: &str, more: &[&str]) -> Value {
    let args = [&["run", "a.toml", "--link", link, "-q", "--json", "-"], more].concat();
    let ran = metamorph(directory, &args);
    assert_eq!(ran.status.code(), Some(0), "{ran:?}");
    serde_json::from_slice(&ran.stdout).unwrap()
}

#[test]
fn a_family_of_ones_own_is_run_on_both_links_and_replayed() {
    let directory = tempfile::tempdir().unwrap();
    let at = directory.path();
    fs::write(at.join("a.toml"), SCENARIO).unwrap();
    for link in ["sim", "ipc"] {
        let journal = format!("{link}.journal");
        let report = report(at, link, &["--journal", &journal, "--html", &format!("{link}.html")]);
        assert_eq!(report["family"], "election");
        assert_eq!(report["agents"]["crashed"], 1, "{report}");
        assert_eq!(report["goal"]["cells"], 16, "{report}");
        let replayed = metamorph(at, &["replay", &journal]);
        assert_eq!(replayed.status.code(), Some(0), "{replayed:?}");
        let exported = metamorph(at, &["export", &journal, "--mcap", &format!("{link}.mcap")]);
        assert_eq!(exported.status.code(), Some(0), "{exported:?}");
    }
    let told = metamorph(at, &["replay", "sim.journal", "--agent", "3"]);
    assert!(String::from_utf8_lossy(&told.stdout).contains("the lowest number is 0"), "{told:?}");
}

#[test]
fn one_seed_is_one_run() {
    let directory = tempfile::tempdir().unwrap();
    fs::write(directory.path().join("a.toml"), SCENARIO).unwrap();
    let hash = || report(directory.path(), "sim", &[])["trace_hash"].clone();
    assert_eq!(hash(), hash());
}

#[test]
fn scenarios_of_the_family_are_checked() {
    let directory = tempfile::tempdir().unwrap();
    let complains = |text: String, about: &str| {
        fs::write(directory.path().join("a.toml"), text).unwrap();
        let ran = metamorph(directory.path(), &["check", "a.toml"]);
        let said = String::from_utf8_lossy(&ran.stderr);
        assert!(ran.status.code() == Some(2) && said.contains(about), "{said}");
    };
    complains(SCENARIO.replace("side = 4", "side = 400"), "side is 400, which is not between 1 and 100");
    complains(SCENARIO.replace("side", "sides"), "did you mean `side`?");
    let foreign = SCENARIO.replace("side = 4", "kind = \"SRS\"");
    complains(
        foreign,
        "`kind` in [swarm] is for the family `metamodule`; this scenario is of the family `election`",
    );
    complains(SCENARIO.replace("election", "elections"), "did you mean `election`?");
}

#[test]
fn the_family_is_explored() {
    let directory = tempfile::tempdir().unwrap();
    let args = ["explore", "--runs", "100", "--seed", "1", "--family", "election", "-q", "--json", "-"];
    let ran = metamorph(directory.path(), &args);
    let summary: Value = serde_json::from_slice(&ran.stdout).unwrap_or_else(|e| panic!("{e}: {ran:?}"));
    assert_eq!((&summary["runs"], &summary["family"]), (&100.into(), &"election".into()), "{summary}");
    assert!(summary["outcomes"]["built"].as_u64().unwrap() > 50, "{summary}");
    assert_eq!(ran.status.code(), Some(0), "{summary}");
}
