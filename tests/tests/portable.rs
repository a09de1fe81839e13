//! Files that are meant to be shared do not contain paths of this machine.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{command, root, run};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};

const SMALL: &str = r#"
version = 1
[swarm]
start = { box = { min = [0, 0, 0], max = [3, 2, 0] } }
[[goal]]
shape = { box = { min = [0, 0, 0], max = [2, 2, 0] } }
"#;

fn files(directory: &Path) -> Vec<PathBuf> {
    let paths = fs::read_dir(directory).unwrap().map(|entry| entry.unwrap().path());
    paths.flat_map(|path| if path.is_dir() { files(&path) } else { vec![path] }).collect()
}

#[test]
fn no_report_names_a_directory_of_this_machine() {
    let directory = tempfile::tempdir().unwrap();
    let at = |name: &str| directory.path().join(name).to_str().unwrap().to_owned();
    let scenario = at("the scenario.toml");
    fs::write(&scenario, SMALL).unwrap();
    let out = at("out");
    fs::create_dir(&out).unwrap();
    let at = |name: &str| format!("{out}/{name}");
    let commands: [&[&str]; 6] = [
        &["run", &scenario, "--link", "sim", "--json", &at("run.json"), "--html", &at("run.html")],
        &["run", &scenario, "--json", &at("ipc.json"), "--html", &at("ipc.html"), "--kill", "3@1s"],
        &["sweep", &scenario, "--seeds", "0..3", "--out", &at("sweep")],
        &["reproduce", "4.1", "--seeds", "1", "--out", &at("thesis"), "--json", &at("thesis.json")],
        &["explore", "--runs", "3", "--seed", "1", "--out", &at("explored"), "--json", &at("explore.json")],
        &["bench", "flood", "--most", "100", "--json", &at("bench.json")],
    ];
    for args in commands {
        let ran = run(args);
        assert_eq!(ran.code, Some(0), "{args:?}: {ran:?}");
    }
    let here = [directory.path().to_owned(), root()];
    let written = files(Path::new(&out));
    assert!(written.len() >= 16, "{written:?}");
    for file in &written {
        let text = String::from_utf8_lossy(&fs::read(file).unwrap()).into_owned();
        for place in &here {
            let at = text.find(place.to_str().unwrap());
            let around = at.map(|at| text[at..].chars().take(100).collect::<String>());
            assert_eq!(around, None, "{}", file.display());
        }
    }
    // The command in a report works in the directory of the scenario.
    let report: Value = serde_json::from_slice(&fs::read(at("run.json")).unwrap()).unwrap();
    assert_eq!(
        (&report["file"], &report["scenario"]),
        (&"the scenario.toml".into(), &"the scenario.toml".into())
    );
    assert_eq!(report["repeat"], "metamorph run 'the scenario.toml' --link sim --seed 1");
    let args = ["run", "the scenario.toml", "--link", "sim", "--seed", "1", "--json", "-"];
    let again = command(&args).current_dir(&directory).output().unwrap();
    let again: Value = serde_json::from_slice(&again.stdout).unwrap();
    assert_eq!(again["trace_hash"], report["trace_hash"]);
    // The command on the terminal works in the current directory.
    let ran = run(&["run", &scenario, "--link", "sim"]);
    assert!(ran.out.contains(&format!("repeat with metamorph run '{scenario}' --link sim")), "{}", ran.out);
    let relative =
        command(&["run", "deploy/scenarios/swarm.toml", "--link", "sim", "--json", "-"]).output().unwrap();
    let report: Value = serde_json::from_slice(&relative.stdout).unwrap();
    assert_eq!(report["file"], "deploy/scenarios/swarm.toml");
}
