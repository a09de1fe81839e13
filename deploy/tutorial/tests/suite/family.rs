//! A family that is no part of the program gets what the built-in ones have: scenarios that are checked,
//! both links, reports, journals and replay, recordings for viewers, and exploration.
#![allow(clippy::unwrap_used, reason = "what cannot be done here fails the test")]

use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

const SCENARIO: &str = "version = 1\n[swarm]\nfamily = \"election\"\ngraph = { grid = [4, 4] }\n\
    [protocol]\nrepeat = \"200ms\"\n[link]\nloss = \"10%\"\n[[fault]]\nkill = 5\nat = \"1s\"\n";

fn metamorph(directory: &Path, args: &[&str]) -> Output {
    let program = env!("CARGO_BIN_EXE_metamorph-election");
    Command::new(program).current_dir(directory).args(args).output().unwrap()
}

fn out(ran: &Output) -> String {
    String::from_utf8_lossy(&ran.stdout).into_owned()
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
        assert_eq!(
            (&report["goal"]["cells"], &report["goal"]["filled"]),
            (&15.into(), &15.into()),
            "{report}"
        );
        let repeat = report["repeat"].as_str().unwrap();
        assert!(repeat.starts_with(&format!("metamorph-election run a.toml --link {link}")), "{repeat}");
        let replayed = metamorph(at, &["replay", &journal]);
        assert_eq!(replayed.status.code(), Some(0), "{replayed:?}");
        let exported = metamorph(at, &["export", &journal, "--mcap", &format!("{link}.mcap")]);
        assert_eq!(exported.status.code(), Some(0), "{exported:?}");
        let drawn = metamorph(at, &["render", &journal, "--out", &format!("{link}.svg")]);
        assert_eq!(drawn.status.code(), Some(0), "{drawn:?}");
    }
    let told = metamorph(at, &["replay", "sim.journal", "--agent", "3"]);
    assert!(out(&told).contains("hears from") && out(&told).contains("the lowest is 0"), "{told:?}");
    let told = out(&metamorph(at, &["run", "a.toml", "--link", "sim"]));
    assert!(
        told.contains("15 of 15 modules done") && !told.contains("prevented") && !told.contains("move"),
        "{told}"
    );
}

/// Modules that are restarted hear of their contacts again, and tell them.
#[test]
fn restarted_modules_vote_again() {
    let directory = tempfile::tempdir().unwrap();
    fs::write(directory.path().join("a.toml"), SCENARIO).unwrap();
    for link in ["sim", "ipc"] {
        let report = report(directory.path(), link, &["--restart", "5@2s"]);
        let agents = &report["agents"];
        assert_eq!((&agents["restarted"], &agents["alive"]), (&1.into(), &16.into()), "{report}");
        assert_eq!(report["goal"]["filled"], 16, "{report}");
    }
}

#[test]
fn one_seed_is_one_run() {
    let directory = tempfile::tempdir().unwrap();
    fs::write(directory.path().join("a.toml"), SCENARIO).unwrap();
    let hash = || report(directory.path(), "sim", &[])["trace_hash"].clone();
    assert_eq!(hash(), hash());
}

/// Every kind of graph is built; where the seed draws it, other seeds draw another.
#[test]
fn graphs_of_all_kinds_are_run() {
    let directory = tempfile::tempdir().unwrap();
    fs::write(directory.path().join("edges.txt"), "# a triangle and a tail\n0 1 {}\n1 2\n2 0\n2 3\n")
        .unwrap();
    let graphs = [
        ("{ ring = 12 }", 12),
        ("{ line = 5 }", 5),
        ("{ torus = [3, 4, 3] }", 36),
        ("{ random = { modules = 20, degree = 3 } }", 20),
        ("{ contacts = [[0, 1], [1, 2]] }", 3),
        ("{ file = \"edges.txt\" }", 4),
    ];
    for (graph, modules) in graphs {
        let text = SCENARIO.replace("{ grid = [4, 4] }", graph).replace("kill = 5", "kill = 2");
        // Killing a module in the middle may cut the others off from each other.
        let text = text.split("[[fault]]").next().unwrap().to_owned();
        fs::write(directory.path().join("a.toml"), text).unwrap();
        let report = report(directory.path(), "sim", &[]);
        assert_eq!(report["goal"]["cells"], modules, "{graph}: {report}");
        let checked = metamorph(directory.path(), &["check", "a.toml"]);
        assert!(out(&checked).contains("modules that elect a leader"), "{checked:?}");
    }
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
    let graph = |graph: &str| SCENARIO.replace("{ grid = [4, 4] }", graph);
    complains(graph("{ ring = 2 }"), "a graph of 2 modules; it has from 3 to 8192");
    complains(graph("{ ring = 3, line = 4 }"), "a graph is one of ring, line, grid");
    complains(graph("{ circle = 3 }"), "unknown key `circle`");
    complains(graph("{ grid = [4] }"), "a grid has two or three sides");
    complains(graph("{ contacts = [[0, 1], [1, 0]] }"), "modules 1 and 0 touch each other twice");
    complains(graph("{ contacts = [[0, 1, 2]] }"), "a contact is between two modules");
    let star: Vec<String> = (1..=7).map(|i| format!("[0, {i}]")).collect();
    complains(graph(&format!("{{ contacts = [{}] }}", star.join(", "))), "module 0 has 7 contacts");
    complains(graph("{ file = \"none.txt\" }"), "none.txt");
    complains(SCENARIO.replace("graph =", "graphs ="), "[swarm] has no `graph`");
    complains(SCENARIO.replace("\"200ms\"", "200"), "`repeat`:");
    complains(SCENARIO.replace("repeat", "repeats"), "`repeats` is no parameter of this protocol");
    complains(format!("{SCENARIO}[[goal]]\nname = \"a\"\n"), "has no [[goal]]");
    let foreign = graph("{ ring = 9 }\nkind = \"SRS\"");
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
