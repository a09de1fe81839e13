//! `metamorph point` hands the tiles that a person selects to a swarm of processes (thesis 9.2).
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{command, run, scenario};
use metamorph_tests::view::View;
use serde_json::Value;
use std::fmt::Write as _;
use std::fs;
use std::io::Write as _;
use std::path::Path;
use std::process::Stdio;

/// Length of the edge of a tile in metres.
const TILE: f64 = 0.11;

/// Returns the samples of a person who stands at the corner of the floor and points at each tile for six seconds, 25 in a second.
fn samples(tiles: &[[i32; 2]]) -> String {
    let (head, mut lines) = ([0.0, 0.0, 1.7], String::new());
    for (i, tile) in (0..).zip(tiles) {
        let on_floor = [f64::from(tile[0]) * TILE, f64::from(tile[1]) * TILE, 0.0];
        let hand: Vec<f64> = head.iter().zip(on_floor).map(|(a, b)| a + 0.3 * (b - a)).collect();
        for sample in 0..150 {
            let t = f64::from(150 * i + sample) / 25.0;
            writeln!(lines, r#"{{"t": {t}, "head": {head:?}, "hand": {hand:?}}}"#).unwrap();
        }
    }
    lines
}

/// Runs `point` on these samples, and returns its exit code, the lines with a command, and its errors.
fn point(control: &Path, module: &str, samples: &str) -> (Option<i32>, Vec<Value>, String) {
    let control = control.display().to_string();
    let mut child = command(&["point", "--control", &control, "--module", module, "--for", "90s"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // A program that ends with an error does not read on.
    let _ = child.stdin.take().unwrap().write_all(samples.as_bytes());
    let output = child.wait_with_output().unwrap();
    let lines = String::from_utf8(output.stdout).unwrap();
    let answers = lines.lines().map(|line| serde_json::from_str::<Value>(line).unwrap());
    let commanded = answers.filter(|answer| answer.get("command").is_some()).collect();
    (output.status.code(), commanded, String::from_utf8(output.stderr).unwrap())
}

#[test]
fn a_selected_tile_is_where_a_metamodule_of_processes_goes() {
    let directory = tempfile::tempdir().unwrap();
    let file = scenario("box.toml").display().to_string();
    let journal = directory.path().join("journal").display().to_string();
    // One metamodule dies before; the commands are to two others.
    let options = ["--link", "ipc", "--view", "--control", "--quiet", "--kill", "3@1s"];
    let view = View::start(&[&["run", &file, "--journal", &journal], &options[..]].concat());
    let control = directory.path().join("control");
    fs::write(&control, format!("{}#c={}\n", view.address, view.secret)).unwrap();

    let (code, commanded, errors) = point(&control, "0", &samples(&[[2, 9], [40, 9]]));
    assert_eq!(code, Some(0), "{errors}");
    let said = |i: usize| (commanded[i]["command"].as_str().unwrap(), &commanded[i]["answer"]["result"]);
    assert_eq!(commanded.len(), 2, "{commanded:?}");
    assert_eq!(said(0), ("goto 0 [2, 9, 0] for 90s", &Value::from("taken")), "{commanded:?}");
    // The run says why it does not do what it is told.
    assert_eq!(said(1), ("goto 0 [40, 9, 0] for 90s", &Value::from("refused")), "{commanded:?}");
    assert!(commanded[1]["answer"]["why"].as_str().unwrap().contains("floor"), "{commanded:?}");

    view.end();
    let (code, _, errors) = point(&control, "0", &samples(&[[2, 9]]));
    assert_eq!(code, Some(1), "{errors}");
    assert!(errors.contains("the run cannot be commanded") && errors.contains("fix: "), "{errors}");
    let replayed = run(&["replay", &journal]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
    let commands = directory.path().join("session.toml").display().to_string();
    assert_eq!(run(&["export", &journal, "--commands", &commands]).code, Some(0));
    assert!(fs::read_to_string(&commands).unwrap().contains("goto 0 [2, 9, 0] for 90s"));
}

#[test]
fn control_and_module_go_together() {
    for args in
        [&["--control", "x"][..], &["--module", "1"], &["--control", "x", "--module", "1", "--for", "601s"]]
    {
        let ran = run(&[&["point"], args].concat());
        assert_eq!(ran.code, Some(2), "{args:?}: {ran:?}");
    }
    let ran = run(&["point", "--control", "/nowhere/control", "--module", "1"]);
    assert_eq!(ran.code, Some(2), "{ran:?}");
    assert!(ran.err.contains("/nowhere/control") && ran.err.contains("fix: "), "{}", ran.err);
}
