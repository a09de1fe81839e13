//! `metamorph robot` as people meet it: answers, errors, exit codes, closed pipes.

use serde_json::Value;
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};

fn metamorph(args: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_metamorph"));
    command.arg("robot").args(args.split_whitespace());
    // Tests leave the cache of the person alone.
    command.env("XDG_CACHE_HOME", scratch("cache"));
    command
}

fn scratch(name: &str) -> PathBuf {
    std::env::temp_dir().join(format!("metamorph-robot-cli-{}", std::process::id())).join(name)
}

fn run(args: &str) -> Output {
    metamorph(args).output().expect("the program is built with the tests")
}

fn text(args: &str) -> String {
    let output = run(args);
    assert!(output.status.success(), "{args}: {}", String::from_utf8_lossy(&output.stderr));
    assert!(output.stderr.is_empty(), "{args}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("answers are UTF-8")
}

fn json(args: &str) -> Value {
    let answer = text(&format!("{args} --json"));
    serde_json::from_str(&answer).unwrap_or_else(|e| panic!("{args}: {e}\n{answer}"))
}

#[test]
fn table_2_2_has_published_and_own_counts() {
    let shown = text("table 2.2");
    for part in ["published", "20 (8)", "55 (20)", "53 (19)", "28 (12)", "mirror images", "random starts"] {
        assert!(shown.contains(part), "{part}\n{shown}");
    }
    let value = json("table 2.2");
    assert_eq!(value["published"], serde_json::json!([2, 19, 38, 43, 35]));
    assert_eq!(value["rows"][0]["states"], serde_json::json!([4, 20, 36, 34, 36]));
    assert_eq!(value["rows"][3]["states"], serde_json::json!([4, 28, 55, 53, 55]));
    assert!(text("table 6.1").contains("P3  shift (1, 0)  turn   90°  joint angles [[120, 180, -120]]"));
}

#[test]
fn shapes_and_moves_come_from_the_database() {
    assert!(text("shapes PAR").contains("never with lattice angles"));
    assert_eq!(json("shapes")["shapes"].as_array().unwrap().len(), 20);
    let per = json("moves PER");
    assert_eq!(per["landings"].as_array().unwrap().len(), 34);
    assert_eq!(per["strict_steps"], 3000);
    let way = json("moves srs --to U --from 0,0,120,0,0,0");
    let steps = way["steps"].as_array().unwrap();
    assert!(!steps.is_empty() && !way["core"].as_array().unwrap().is_empty(), "{way}");
    let output = run("moves PAR --to U");
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("cannot take shape U"));
}

#[test]
fn forward_and_inverse_agree() {
    let up = json("fk PER 0 0 0 0 0 0 --connector all");
    assert_eq!(up["head"][2][3], 4.0);
    assert_eq!(up["lattice"]["shape"], "I");
    assert_eq!(up["connectors"].as_array().unwrap().len(), 20);
    assert!(text("fk single -120 90 -120").contains("head lands on (0, 1, 2)"));

    let back = json("ik SRS --like 10,-20,30,40,-50,60");
    let found = back["solutions"].as_array().unwrap();
    let close = |s: &Value| {
        let q = s["joint_angles"].as_array().unwrap();
        q.iter()
            .zip([10.0, -20.0, 30.0, 40.0, -50.0, 60.0])
            .all(|(a, b)| (a.as_f64().unwrap() - b).abs() < 1e-6)
    };
    assert!(found.iter().any(close), "{back}");
    assert!(text("ik PAR --grid 2,1,3").contains("solution"));
    assert!(text("ik SRS --grid -1,2,0").contains("solution"));
    assert!(text("ik PAR --grid 2,1,3 --solver damped").contains("1 solution"));
    let pose = "0,-1,0,0,-1,0,0,0,0,0,-1,4";
    assert!(text(&format!("ik PAR --matrix {pose}")).contains("0.0000    0.0000    0.0000"));
}

#[test]
fn out_of_reach_is_an_answer_of_its_own() {
    let output = run("ik PER --grid 9,0,0");
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("out of reach"));
    let output = run("ik PER --grid 9,0,0 --json");
    assert_eq!(output.status.code(), Some(1));
    let value: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(value["reason"].as_str().unwrap().contains("out of reach"));
}

#[test]
fn wrong_questions_end_with_2_and_say_what_to_do() {
    for (args, part) in [
        ("fk SRX 0 0 0", "PAR, SRS, PER, SRZ"),
        ("fk PER 0 0 0", "PER has 6 joints, but 3 angles were given"),
        ("fk single 0 nan 0", "joint 2"),
        ("fk single 0 0 inf", "joint 3"),
        ("fk single 0 0 0 --connector C9X", "C0X"),
        ("fk single 0 0 0 --connector 2:C0X", "no second module"),
        ("fk single 0 0 0 --payload=-1", "kilograms"),
        ("fk single zero 0 0", "zero"),
        ("ik PER", "--grid"),
        ("ik PER --grid 1,2", "2,1,3"),
        ("ik PER --grid 1,2,7", "0, 1, 2, 3"),
        ("ik PER --matrix 1,2,3", "12 numbers"),
        ("ik PER --matrix 2,0,0,0,0,1,0,0,0,0,1,1", "not a rigid one"),
        ("ik PER --matrix nan,0,0,0,0,1,0,0,0,0,1,1", "not finite"),
        ("moves PER --to X", "I, L, S, U, 3D-S"),
        ("moves PER --to I --from 45,0,0,0,0,0", "joint 1 at 45° is not on the lattice"),
        ("moves PER --to I --from=120,180,-120,0,0,0", "below the floor"),
        ("table 9.9", "2.2"),
        ("svg PER 1 2 3", "6 joints"),
        ("dance", "dance"),
    ] {
        let output = run(args);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{args}: {said}");
        assert!(said.contains(part), "{args}: {said}");
        assert!(!said.contains("panicked"), "{args}: {said}");
    }
}

#[test]
fn a_posture_is_drawn() {
    let svg = text("svg SRZ 0 0 120 -120 0 0");
    assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
    assert!(svg.contains(">C3X<") && svg.contains("class=\"cell\""));
    assert_eq!(svg.matches("class=\"m2-upper\"").count(), 2);
    let file = scratch("posture.svg");
    std::fs::create_dir_all(file.parent().unwrap()).unwrap();
    assert!(text(&format!("svg single 10 20 30 --out {}", file.display())).contains("drawn to"));
    assert!(std::fs::read_to_string(&file).unwrap().starts_with("<svg"));
    let output = run("svg single 0 0 0 --out /proc/none/x.svg");
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("/proc/none/x.svg"));
}

#[test]
fn the_database_has_the_same_bytes_every_time() {
    let folder = scratch("bytes");
    std::fs::create_dir_all(&folder).unwrap();
    let write = |name: &str, more: &str| {
        let path = folder.join(name);
        text(&format!("database --out {} {more}", path.display()));
        std::fs::read(path).unwrap()
    };
    let first = write("first", "--no-cache");
    assert_eq!(first, write("second", ""));
    assert_eq!(first, write("third", ""));
}

/// A reader that goes away, as `head` does, is no reason to panic or to complain.
#[test]
fn a_closed_pipe_is_no_error() {
    for args in ["moves PER --json", "table 6.1", "svg PER 0 0 0 0 0 0"] {
        let mut child = metamorph(args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop(child.stdout.take());
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success(), "{args}");
        assert!(output.stderr.is_empty(), "{args}: {}", String::from_utf8_lossy(&output.stderr));
    }
}

/// Writes a scenario of upright metamodules at these connectors, each with its joints straight.
fn upright(name: &str, feet: &[(i16, i16)]) -> PathBuf {
    let seed =
        |(x, y): &(i16, i16)| format!("{{ foot = [{x}, {y}], directions = [\"up\", \"up\", \"up\"] }}");
    let seeds: Vec<String> = feet.iter().map(seed).collect();
    let text = format!(
        "version = 1\n[swarm]\nfamily = \"metamodule\"\n[[goal]]\nname = \"block\"\nlevels = [[{}]]\n",
        seeds.join(", ")
    );
    let path = scratch(name);
    std::fs::create_dir_all(path.parent().expect("it has one")).expect("a directory");
    std::fs::write(&path, text).expect("a file");
    path
}

#[test]
fn goals_are_taken_apart_to_find_an_order() {
    for (scenario, parts) in [("box", 4), ("chair", 6)] {
        let path = format!("{}/../deploy/scenarios/{scenario}.toml", env!("CARGO_MANIFEST_DIR"));
        let found = json(&format!("order {path}"));
        let steps = found["goals"][0]["steps"].as_array().expect("steps");
        let filled: usize = steps.iter().map(|step| step.as_array().expect("seeds").len()).sum();
        assert_eq!((filled, &found["goals"][0]["blocked"]), (parts, &serde_json::json!([])), "{found}");
    }
    // Three upright metamodules in a corner are possible; a fourth one that closes the square has no last step.
    let three = upright("three.toml", &[(5, 5), (6, 5), (5, 6)]);
    assert!(text(&format!("order {}", three.display())).contains("3 parts can be assembled"));
    let four = upright("four.toml", &[(5, 5), (6, 5), (5, 6), (6, 6)]);
    let ran = run(&format!("order {} --json", four.display()));
    assert_eq!(ran.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&ran.stderr).contains("no order of assembly: block"));
    let found: Value = serde_json::from_slice(&ran.stdout).expect("the answer is there");
    let blocked = found["goals"][0]["blocked"].as_array().expect("a list");
    // Each is blocked by its two neighbours; the one across the corner is in no way.
    let by: Vec<&Value> = blocked.iter().map(|part| &part["by"]).collect();
    assert_eq!(serde_json::json!(by), serde_json::json!([[2, 3], [1, 4], [1, 4], [2, 3]]), "{found}");
}

#[test]
fn scenarios_without_an_order_are_refused_with_the_reason() {
    let swarm = format!("{}/../deploy/scenarios/swarm.toml", env!("CARGO_MANIFEST_DIR"));
    for (path, reason) in [(swarm.as_str(), "no metamodules"), ("nowhere.toml", "nowhere.toml")] {
        let ran = run(&format!("order {path}"));
        let told = String::from_utf8_lossy(&ran.stderr).into_owned();
        assert!(ran.status.code() == Some(2) && told.contains(reason), "{told}");
    }
}
