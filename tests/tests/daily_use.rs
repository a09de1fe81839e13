//! Commands of every day: scenarios by their names, and what helps where a name is wrong.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{Ran, command, scenarios};
use serde_json::Value;
use std::fs;
use std::path::Path;

/// Runs a command in a directory.
fn within(directory: &Path, args: &[&str]) -> Ran {
    command(args).current_dir(directory).output().unwrap().into()
}

fn json(ran: &Ran) -> Value {
    assert_eq!(ran.code, Some(0), "{ran:?}");
    serde_json::from_str(&ran.out).unwrap_or_else(|error| panic!("{error}: {}", ran.out))
}

/// In an empty directory every shipped scenario is found by its name, and its report and journal name it so.
#[test]
fn shipped_scenarios_are_found_by_name() {
    let directory = tempfile::tempdir().unwrap();
    let at = |args: &[&str]| within(directory.path(), args);
    let listed = json(&at(&["scenarios", "--json"]));
    let names: Vec<&str> = listed.as_array().unwrap().iter().map(|s| s["name"].as_str().unwrap()).collect();
    let mut files: Vec<String> =
        scenarios().iter().map(|path| path.file_stem().unwrap().to_str().unwrap().to_owned()).collect();
    files.sort();
    assert_eq!(names, files);
    let table = at(&["scenarios"]);
    assert!(names.iter().all(|name| table.out.contains(name)), "{table:?}");
    for name in &names {
        let ran = at(&["check", name, "--link", "sim"]);
        assert_eq!(ran.code, Some(0), "{ran:?}");
        assert!(ran.out.contains(&format!("metamorph run {name} --link sim")), "{}", ran.out);
    }
    let ran = at(&["run", "swarm", "--link", "sim", "--quiet", "--json", "-", "--journal", "run.journal"]);
    let report = json(&ran);
    assert_eq!((report["file"].as_str(), report["outcome"].as_str()), (Some("swarm"), Some("built")));
    assert_eq!(at(&["replay", "run.journal", "--quiet"]).code, Some(0));
    // A solid that a shipped scenario names is in the program too, also when a journal is read.
    let ran = at(&["run", "arch", "--link", "sim", "--quiet", "--journal", "arch.journal"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    assert_eq!(at(&["replay", "arch.journal", "--quiet", "--until", "1s"]).code, Some(0));
    let ran = at(&["sweep", "swarm", "--seeds", "0..2"]);
    assert!(ran.out.contains("metamorph sweep swarm --seeds 0..2"), "{ran:?}");
    let ran = at(&["render", "swarm", "--at", "0s", "--quiet"]);
    assert!(ran.out.contains("metamorph render swarm --at 0s"), "{ran:?}");
}

#[test]
fn files_win_over_shipped_names() {
    let directory = tempfile::tempdir().unwrap();
    let text = fs::read_to_string(metamorph_tests::command::scenario("line-to-box.toml")).unwrap();
    let at = |args: &[&str]| within(directory.path(), args);
    fs::write(directory.path().join("swarm.toml"), &text).unwrap();
    let ran = at(&["check", "swarm", "--link", "sim"]);
    assert!(ran.out.contains("metamorph run swarm.toml"), "{ran:?}");
    fs::write(directory.path().join("swarm"), &text).unwrap();
    let ran = at(&["check", "swarm", "--link", "sim"]);
    assert!(ran.out.contains("metamorph run ./swarm "), "{ran:?}");
    assert!(ran.err.contains("this file is read, not the scenario of this name"), "{ran:?}");
    // A directory of that name is not a scenario.
    fs::create_dir(directory.path().join("chair")).unwrap();
    assert_eq!(at(&["check", "chair", "--link", "sim"]).code, Some(0));
}

#[test]
fn wrong_names_are_refused_with_similar_ones() {
    let directory = tempfile::tempdir().unwrap();
    fs::write(directory.path().join("tower.toml"), "").unwrap();
    let cases = [
        ("swram", "fix: did you mean `swarm`?"),
        ("slab-to-speher", "fix: did you mean `slab-to-sphere`?"),
        ("towr.toml", "fix: did you mean `tower.toml`?"),
        ("unlike-all.toml", "`metamorph scenarios` lists the scenarios"),
    ];
    for (name, fix) in cases {
        for command in [&["run", "--link", "sim", name][..], &["sweep", "--seeds", "0..1", name]] {
            let ran = within(directory.path(), command);
            assert_eq!((ran.code, ran.out.as_str()), (Some(2), ""), "{ran:?}");
            assert!(ran.err.contains("there is no such file") && ran.err.contains(fix), "{}", ran.err);
        }
    }
}
