//! `metamorph plan` as a user runs it: answers, exit codes, plan files, and every bad input.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{Ran, command, run};
use metamorph_tests::json_schema::Schema;
use metamorph_world_controller::experiments::reproduce::planners::SCHEMA;
use rustix::process::{Pid, Signal, kill_process};
use serde_json::{Value, json};
use std::fs;
use std::io::Read;
use std::path::Path;
use std::process::Stdio;
use std::thread::park_timeout;
use std::time::Duration;

fn refused(args: &[&str], parts: &[&str]) {
    let ran = run(args);
    assert_eq!(ran.code, Some(2), "{args:?}: {ran:?}");
    assert!(ran.out.is_empty(), "{ran:?}");
    for part in parts.iter().chain(&["fix: "]) {
        assert!(ran.err.contains(part), "{args:?}: `{part}` is missing in: {}", ran.err);
    }
    assert!(!ran.err.contains("panicked"), "{}", ran.err);
}

fn answer(args: &[&str]) -> (Ran, Value) {
    let ran = run(&[args, &["--json", "-", "--quiet"]].concat());
    let value = serde_json::from_str(&ran.out).unwrap_or_else(|e| panic!("{e}: {ran:?}"));
    (ran, value)
}

#[test]
fn a_line_becomes_a_loop_and_the_plan_checks() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("plan.json").display().to_string();
    for collision in ["final", "core", "strict"] {
        let args = ["plan", "--from", "line:4", "--to", "loop:3x3", "--types", "000"];
        let ran = run(&[&args[..], &["--collision", collision, "-o", &file]].concat());
        assert_eq!(ran.code, Some(0), "{ran:?}");
        assert!(ran.out.contains("optimal: 6 actions, proved"), "{}", ran.out);
        assert!(ran.out.contains("attach"), "{}", ran.out);
        let ran = run(&["plan", "--check", &file]);
        assert_eq!((ran.code, ran.out.contains("valid: 6 actions")), (Some(0), true), "{ran:?}");
    }
}

#[test]
fn other_engines_and_objectives_answer_the_same_question() {
    let base = ["plan", "--from", "line:3", "--to", "loop:2x3", "--collision", "final"];
    for planner in ["auto", "astar", "ara", "ida"] {
        let (ran, value) = answer(&[&base[..], &["--planner", planner]].concat());
        assert_eq!((ran.code, &value["cost"], &value["verdict"]), (Some(0), &json!(4), &json!("optimal")));
    }
    for (objective, cost) in [("connections", 1), ("moves", 1), ("turns", 3)] {
        let (ran, value) = answer(&[&base[..], &["--objective", objective]].concat());
        assert_eq!((ran.code, &value["cost"]), (Some(0), &json!(cost)), "{objective}: {value}");
    }
    let (_, value) = answer(&[&base[..], &["--weight", "2"]].concat());
    assert!(value["factor"].as_f64().unwrap() <= 2.0, "{value}");
    let (_, value) = answer(&[&base[..], &["--connectors", "active"]].concat());
    assert!(value["cost"].as_u64().unwrap() >= 4, "{value}");
}

/// A goal with joint values is one configuration; both engines find the same number of actions.
#[test]
fn a_goal_with_joint_values_is_reached_from_both_ends() {
    let directory = tempfile::tempdir().unwrap();
    let (plan, goal) = (directory.path().join("plan.json"), directory.path().join("goal.json"));
    let file = plan.display().to_string();
    let from = ["plan", "--from", "line:3", "--types", "01", "--to", "loop:2x3"];
    assert_eq!(run(&[&from[..], &["-o", &file]].concat()).code, Some(0));
    let text: Value = serde_json::from_str(&fs::read_to_string(&plan).unwrap()).unwrap();
    fs::write(&goal, text["start"].to_string()).unwrap();
    let goal = goal.display().to_string();
    let base = ["plan", "--from", "line:3", "--types", "00", "--collision", "final", "--to", &goal];
    for (planner, name) in [("auto", "bidirectional"), ("astar", "astar")] {
        let (ran, found) = answer(&[&base[..], &["--planner", planner]].concat());
        let expected = (Some(0), &json!(name), &json!(12), &json!("optimal"));
        assert_eq!((ran.code, &found["planner"], &found["cost"], &found["verdict"]), expected, "{ran:?}");
    }
    // Two modules never let go of each other, so the rotation of their connection stays.
    let from = ["plan", "--from", "line:2", "--types", "1", "--to", "line:2", "-o", &file];
    assert_eq!(run(&from).code, Some(0));
    let text: Value = serde_json::from_str(&fs::read_to_string(&plan).unwrap()).unwrap();
    fs::write(&goal, text["start"].to_string()).unwrap();
    let base = ["plan", "--from", "line:2", "--types", "0", "--collision", "final", "--to", &goal];
    for planner in ["bidirectional", "astar"] {
        let (ran, found) = answer(&[&base[..], &["--planner", planner]].concat());
        assert_eq!((ran.code, &found["verdict"]), (Some(3), &json!("impossible")), "{ran:?}");
    }
    // The start itself: an empty plan.
    let (ran, none) = answer(&["plan", "--from", &goal, "--to", &goal]);
    assert_eq!((ran.code, &none["cost"], &none["plan"]["actions"]), (Some(0), &json!(0), &json!([])));
}

#[test]
fn what_is_impossible_is_proved_and_what_is_too_much_is_bounded() {
    // Two modules in a line never let go of each other's ends.
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("side.json");
    let side = json!({ "format": "metamorph structure", "version": 1,
        "modules": [[[0, 0, 0], [1, 0, 0]], [[0, 1, 0], [1, 1, 0]]], "joined": [[[0, 0, 0], [0, 1, 0]]] });
    fs::write(&path, side.to_string()).unwrap();
    let side = path.display().to_string();
    let (ran, value) = answer(&["plan", "--from", "line:2", "--to", &side, "--collision", "final"]);
    assert_eq!((ran.code, &value["verdict"]), (Some(3), &json!("impossible")), "{value}");
    let hard = ["plan", "--from", "quadruped:6", "--to", "line:6", "--work", "50"];
    let (ran, value) = answer(&hard);
    assert_eq!((ran.code, &value["verdict"]), (Some(4), &json!("undecided")), "{value}");
    assert!(value["lower"].as_u64().unwrap() >= 2, "{value}");
    assert_eq!(value["ended_by"], "work");
    let ran = run(&["plan", "--from", "quadruped:6", "--to", "line:6", "--timeout", "100ms"]);
    assert_eq!(ran.code, Some(4), "{ran:?}");
    assert!(ran.out.contains("no plan was found (out of time); every plan costs at least"), "{}", ran.out);
}

#[test]
fn counts_distances_and_names() {
    let (_, counted) = answer(&["plan", "--count", "line:2", "--collision", "final"]);
    assert_eq!(counted["shapes"]["levels"], json!([1, 1, 4, 1]));
    assert_eq!(counted["configurations"]["total"], 666);
    let (_, counted) = answer(&["plan", "--count", "line:3", "--work", "1000", "--collision", "final"]);
    assert_eq!((&counted["shapes"]["total"], &counted["shapes"]["complete"]), (&json!(187), &json!(true)));
    assert_eq!(counted["configurations"]["complete"], false);
    let (_, distance) = answer(&["plan", "--distance", "line:4", "loop:3x3"]);
    assert_eq!((&distance["shape"], &distance["shape_exact"]), (&json!(4), &json!(true)));
    assert_eq!(distance["joins"], 4);
    let (_, same) = answer(&["plan", "--distance", "ell:4", "ell:4"]);
    assert_eq!(
        (&same["shape"], &same["hausdorff_squared"], &same["assignment"]),
        (&json!(0), &json!(0), &json!(0))
    );
    assert_eq!(same["common_subgraph"], 3);
    let ran = run(&["plan", "--recognise", "loop:3x3"]);
    assert!(ran.out.contains("loop:3x3: 4 modules with 4 joined faces"), "{ran:?}");
}

/// A tower bends into a loop in eight actions on the ground, and in six in the air. A plan in which something else is held
/// does not check.
#[test]
fn structures_on_the_ground_are_planned_and_checked() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("plan.json").display().to_string();
    let base = ["plan", "--from", "line:4", "--to", "loop:3x3", "--collision", "core", "-o", &file];
    let ran = run(&[&base[..], &["--floor", "--gravity", "--up", "x"]].concat());
    assert!(ran.out.contains("optimal: 8 actions, proved"), "{ran:?}");
    let ran = run(&["plan", "--check", &file]);
    assert_eq!((ran.code, ran.out.contains("valid: 8 actions")), (Some(0), true), "{ran:?}");
    let mut plan: Value = serde_json::from_str(&fs::read_to_string(&file).unwrap()).unwrap();
    for (held, reason) in [(3, ", action "), (9, "module 9, which does not exist")] {
        plan["ground"]["module"] = json!(held);
        fs::write(&file, plan.to_string()).unwrap();
        let ran = run(&["plan", "--check", &file]);
        assert_eq!((ran.code, ran.err.contains(reason)), (Some(8), true), "{ran:?}");
    }
}

fn write(directory: &Path, name: &str, content: &str) -> String {
    let path = directory.join(name);
    fs::write(&path, content).unwrap();
    path.display().to_string()
}

#[test]
fn bad_options_are_refused_with_place_reason_and_fix() {
    let to = ["--to", "line:4"];
    let plan = |from: &[&'static str]| [&["plan", "--from"][..], from, &to].concat();
    refused(&plan(&["circle:4"]), &["--from circle:4", "no shape is called"]);
    refused(&plan(&["line:x"]), &["`x` is not a size of a line"]);
    refused(&plan(&["line:0"]), &["`0` is not a size of a line"]);
    refused(&plan(&["line:17"]), &["17 modules", "at most 16", "metamodule"]);
    refused(&plan(&["line:18446744073709551616"]), &["not a size of a line"]);
    refused(&plan(&["loop:1x3"]), &["not a size of a loop", "2x2"]);
    refused(&plan(&["loop:3"]), &["not a size of a loop"]);
    refused(&plan(&["loop:99999999999x99999999999"]), &["at most 16"]);
    refused(&plan(&["quadruped:5"]), &["quadruped:4 and quadruped:6"]);
    refused(&plan(&["tree:4"]), &["not a size of a tree", "8x1"]);
    refused(&plan(&["tree:17x1"]), &["17 modules", "at most 16"]);
    refused(&plan(&["line:3"]), &["--to", "the start has 3 modules, the goal 4"]);
    refused(&plan(&["./nowhere.json"]), &["--from ./nowhere.json", "cannot be read"]);
    refused(&plan(&["line:4", "--types", "00"]), &["--types 00", "3 digits"]);
    refused(&plan(&["line:4", "--types", "004"]), &["--types 004"]);
    refused(&plan(&["ell:4", "--types", "000"]), &["the start is not a line"]);
    refused(&plan(&["line:4", "--weight", "0.5"]), &["--weight 0.5", "at least 1"]);
    refused(&plan(&["line:4", "--weight", "NaN"]), &["--weight NaN"]);
    refused(&plan(&["line:4", "--weight", "-1"]), &["--weight -1"]);
    refused(&plan(&["line:4", "--weight", "x"]), &["this is not a number"]);
    refused(&plan(&["line:4", "--weight", "2", "--planner", "ara"]), &["this planner has no single weight"]);
    refused(&plan(&["line:4", "--memory", "1MiB"]), &["--memory 1MiB", "less than a search needs", "16MiB"]);
    refused(&plan(&["line:4", "--memory", "15MiB"]), &["--memory 15MiB", "at least 16MiB"]);
    refused(&plan(&["line:4", "--weight", "101"]), &["--weight 101", "at most 100"]);
    refused(&plan(&["line:4", "--weight", "inf"]), &["--weight inf", "at most 100"]);
    refused(&plan(&["line:4", "--memory", "-5"]), &["--memory -5", "not a size"]);
    refused(&plan(&["line:4", "--memory", "99999999999GiB"]), &["more than a machine has"]);
    refused(&plan(&["line:4", "--timeout", "60"]), &["--timeout 60"]);
    refused(&plan(&["line:4", "--planner", "bidirectional"]), &["the goal has no joint values"]);
    refused(
        &plan(&["line:4", "--gravity"]),
        &["the start does not stand", "joint 1 of module 0 bears", "--hold"],
    );
    refused(&plan(&["line:4", "--floor", "--hold", "4"]), &["--hold 4", "no such module", "0 to 3"]);
    refused(&plan(&["line:4", "--floor", "--hold", "0:tail"]), &["--hold 0:tail", "no end `tail`"]);
    refused(&plan(&["line:4", "--hold", "1"]), &["--hold", "nothing is held"]);
    refused(&plan(&["line:4", "--up", "-y"]), &["--up", "no direction is up"]);
    refused(&["plan", "--distance", "line:4", "line:3"], &["--distance", "4 modules"]);
}

#[test]
fn bad_structures_are_refused_with_place_reason_and_fix() {
    let directory = tempfile::tempdir().unwrap();
    let structure = |modules: Value, joined: Value| {
        json!({ "format": "metamorph structure", "version": 1, "modules": modules, "joined": joined })
            .to_string()
    };
    let two = json!([[[0, 0, 0], [1, 0, 0]], [[2, 0, 0], [3, 0, 0]]]);
    let join = json!([[[1, 0, 0], [2, 0, 0]]]);
    let posed = |rotation: Value, joints: Value| json!([{ "cells": [[0, 0, 0], [0, 0, 1]], "foot_rotation": rotation, "joints_deg": joints }]);
    let unit = json!([[1, 0, 0], [0, 1, 0], [0, 0, 1]]);
    let cases = [
        ("empty", structure(json!([]), json!([])), "the structure has no modules"),
        (
            "overlap",
            structure(json!([[[0, 0, 0], [1, 0, 0]], [[1, 0, 0], [2, 0, 0]]]), json!([])),
            "both fill the cell",
        ),
        ("apart", structure(json!([[[0, 0, 0], [2, 0, 0]]]), json!([])), "are not neighbours"),
        ("untouched", structure(two.clone(), json!([[[0, 0, 0], [2, 0, 0]]])), "do not touch"),
        ("nowhere", structure(two.clone(), json!([[[1, 0, 0], [1, 1, 0]]])), "no module fills the cell"),
        ("itself", structure(two.clone(), json!([[[0, 0, 0], [1, 0, 0]]])), "both cells belong to module 0"),
        ("parted", structure(two.clone(), json!([])), "module 1 is not connected"),
        ("far", structure(json!([[[0, 0, 0], [9223372036854775807_i64, 0, 0]]]), json!([])), "farther apart"),
        ("angle", structure(posed(unit.clone(), json!([45, 0, 0])), json!([])), "joint 1 at 45"),
        ("huge", structure(posed(unit.clone(), json!([1e300, 0, 0])), json!([])), "not within"),
        (
            "mirror",
            structure(posed(json!([[1, 0, 0], [0, 1, 0], [0, 0, -1]]), json!([0, 0, 0])), json!([])),
            "not a rotation",
        ),
        ("other", structure(posed(unit, json!([120, 0, 0])), json!([])), "the second cell is"),
        ("many", structure(Value::Array(vec![json!([[0, 0, 0], [1, 0, 0]]); 17]), json!([])), "17 modules"),
        ("version", structure(two, join).replace("\"version\":1", "\"version\":2"), "version 2, not"),
        ("truncated", "{ \"format\": \"metamorph".to_owned(), "line 1, column"),
        ("nan", "{ \"format\": NaN }".to_owned(), "line 1, column"),
    ];
    for (name, text, reason) in cases {
        let file = write(directory.path(), &format!("{name}.json"), &text);
        refused(&["plan", "--recognise", &file], &["--recognise", name, reason]);
    }
    let long = directory.path().join("long.json");
    fs::File::create(&long).unwrap().set_len(1 << 30).unwrap();
    refused(&["plan", "--recognise", &long.display().to_string()], &["long.json", "longer than"]);
    refused(&["plan", "--recognise", &directory.path().display().to_string()], &["a directory"]);
}

/// Every way in which a plan can be wrong is named with its action.
#[test]
fn plans_that_do_not_check_are_told_apart() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("plan.json").display().to_string();
    let made = run(&["plan", "--from", "line:3", "--to", "loop:2x3", "-o", &file]);
    assert_eq!(made.code, Some(0), "{made:?}");
    let plan: Value = serde_json::from_str(&fs::read_to_string(&file).unwrap()).unwrap();
    let last = plan["actions"].as_array().unwrap().len() - 1;
    let changed = |name: &str, change: &dyn Fn(&mut Value)| {
        let mut other = plan.clone();
        change(&mut other);
        let file = write(directory.path(), name, &other.to_string());
        run(&["plan", "--check", &file])
    };
    let differs = |name: &str, change: &dyn Fn(&mut Value), reason: &str| {
        let ran = changed(name, change);
        assert_eq!(ran.code, Some(8), "{name}: {ran:?}");
        assert!(ran.err.contains(reason) && ran.err.contains("fix: "), "{name}: {}", ran.err);
    };
    differs("order.json", &|p| p["actions"].as_array_mut().unwrap().swap(0, last), "action 0: ");
    differs("cycle.json", &|p| p["actions"][0]["after"] = json!([last]), "not an earlier one");
    differs(
        "module.json",
        &|p| p["actions"][0]["do"] = json!({ "turn": [9, 1, 120] }),
        "there is no module 9",
    );
    differs(
        "joint.json",
        &|p| p["actions"][0]["do"] = json!({ "turn": [0, 4, 120] }),
        "not a step of a joint",
    );
    differs("cost.json", &|p| p["cost"] = json!(3), "its cost is 4");
    differs("bound.json", &|p| p["lower"] = json!(5), "at least 5");
    differs(
        "short.json",
        &|p| {
            p["actions"].as_array_mut().unwrap().pop();
            p["cost"] = json!(3);
            p["lower"] = json!(3);
        },
        "does not end in the goal",
    );
    differs(
        "bridge.json",
        &|p| {
            p["actions"][0]["do"] = json!({ "detach": [[0, "C3X"], [1, "C0X"]] });
        },
        "would no longer be connected",
    );
    let ran = changed("version.json", &|p| p["version"] = json!(7));
    assert!(ran.code == Some(2) && ran.err.contains("version 7, not `metamorph plan` version 1"), "{ran:?}");
    let ran = changed("unknown.json", &|p| p["extra"] = json!(1));
    assert!(ran.code == Some(2) && ran.err.contains("schema plan"), "{ran:?}");
    let text = fs::read_to_string(&file).unwrap();
    let cut = write(directory.path(), "cut.json", &text[..text.len() / 2]);
    assert_eq!(run(&["plan", "--check", &cut]).code, Some(2));
}

#[test]
fn plans_are_valid_by_their_schema() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("plan.json").display().to_string();
    assert_eq!(run(&["plan", "--from", "line:3", "--to", "loop:2x3", "-o", &file]).code, Some(0));
    let plan: Value = serde_json::from_str(&fs::read_to_string(&file).unwrap()).unwrap();
    for (name, document) in [("plan", &plan), ("structure", &plan["start"]), ("structure", &plan["goal"])] {
        let schema: Value = serde_json::from_str(&run(&["schema", name]).out).unwrap();
        Schema::new(&schema).accepts(document, name);
    }
}

/// Returns our figure of a row of a table of `reproduce`.
fn ours(all: &Value, table: usize, what: &str) -> String {
    let rows = all["planners"][table]["rows"].as_array().unwrap();
    let row = rows.iter().find(|r| r["what"].as_str().unwrap().contains(what));
    row.unwrap_or_else(|| panic!("{what}: {all}"))["ours"].as_str().unwrap().to_owned()
}

/// The report's planner finds longer plans than the shortest, and misses goals.
#[test]
fn the_planner_of_the_report_is_reproduced() {
    let (ran, all) = answer(&["reproduce", "graph-signature", "--seeds", "1"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    assert!(ours(&all, 0, "fewest actions").starts_with("6, proved"), "{all}");
    assert!(ours(&all, 0, "a goal that it misses").starts_with("yes"), "{all}");
    assert!(!all.to_string().contains("CONTRADICTION"), "{all}");
}

/// Published figures of planners stand beside ours, and are not sweeps.
#[test]
fn planners_of_the_sources_are_reproduced() {
    let (ran, all) = answer(&["reproduce", "on-grid", "reward-map", "planned", "--seeds", "4"]);
    assert_eq!((ran.code, &all["schema"]), (Some(0), &json!(SCHEMA)), "{ran:?}");
    assert_eq!(ours(&all, 0, "targets by their fewest primitives"), "2 3 6 8 4 1", "{all}");
    assert!(!all.to_string().contains("CONTRADICTION"), "{all}");
    assert!(ours(&all, 1, "exact moves").starts_with("0; "), "{all}");
    let ratio: f64 = ours(&all, 1, "tries per move")[..6].parse().unwrap();
    assert!((ratio - 1.0526).abs() < 0.01, "{ratio}");
    for strategy in ["  planned", "  negotiated"] {
        assert_eq!(ours(&all, 2, strategy), "100.0%", "{all}");
    }
    assert!(!all["planners"][2].to_string().contains("violation"), "{all}");
    refused(&["reproduce", "4.1", "on-grid"], &["on-grid: this experiment of a planner is not a sweep"]);
}

/// Options that have no effect on the question are refused, and so are numbers out of range, before any search.
#[test]
fn options_without_effect_are_refused() {
    let directory = tempfile::tempdir().unwrap();
    let plan = write(directory.path(), "plan.json", "{}");
    let line = ["plan", "--from", "line:4", "--to", "loop:3x3"];
    let cases: [(&[&str], &str); 12] = [
        (&["plan", "--check", &plan, "--seed", "1"], "cannot be used with"),
        (&["plan", "--check", &plan, "--weight", "2"], "cannot be used with"),
        (&["plan", "--check", &plan, "--json", "-"], "cannot be used with"),
        (&["plan", "--distance", "line:4", "ell:4", "--collision", "core"], "cannot be used with"),
        (&["plan", "--recognise", "line:4", "--work", "3"], "cannot be used with"),
        (&["plan", "--recognise", "line:4", "--view"], "cannot be used with"),
        (&["plan", "--count", "line:3", "--planner", "ara"], "cannot be used with"),
        (&["plan", "--count", "line:3", "--timeout", "5"], "--timeout 5"),
        (&[&line[..], &["--types", "000", "--seed", "1"]].concat(), "cannot be used with"),
        (&[&line[..], &["--port", "8080"]].concat(), "--view"),
        (&[&line[..], &["--seed", "-1"]].concat(), "invalid value '-1' for '--seed"),
        (&[&line[..], &["--work", "-1"]].concat(), "invalid value '-1' for '--work"),
    ];
    for (args, reason) in cases {
        let ran = run(args);
        assert!(ran.code == Some(2) && ran.out.is_empty() && ran.err.contains(reason), "{args:?}: {ran:?}");
    }
}

/// A plan that is too large, has no end or is cut anywhere is refused by its place.
#[test]
fn plan_files_that_are_no_plans_are_refused() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("plan.json").display().to_string();
    assert_eq!(run(&["plan", "--from", "line:2", "--to", "line:2", "-o", &file]).code, Some(0));
    let text = fs::read_to_string(&file).unwrap();
    let plan: Value = serde_json::from_str(&text).unwrap();
    let changed = |change: &dyn Fn(&mut Value)| {
        let mut other = plan.clone();
        change(&mut other);
        other.to_string()
    };
    let turn = |turn: Value| json!([{ "do": { "turn": turn }, "after": [], "from": "", "to": "" }]);
    let deep = "[".repeat(1_000_000);
    let cases = [
        ("empty", String::new(), 2, "line 1, column 0"),
        ("cut", text[..text.len() - 3].to_owned(), 2, "EOF while parsing an object"),
        ("deep", deep.clone(), 2, "line 1, column 1"),
        (
            "deeper",
            format!("{{ \"format\": \"metamorph plan\", \"version\": 1, \"x\": {deep}"),
            2,
            "line 1, column",
        ),
        ("older", changed(&|p| p["version"] = json!(0)), 2, "version 0, not `metamorph plan` version 1"),
        ("huge", changed(&|p| p["cost"] = json!(1e300)), 2, "expected u32"),
        ("negative", changed(&|p| p["cost"] = json!(-1)), 2, "expected u32"),
        ("module", changed(&|p| p["actions"] = turn(json!([u64::MAX, 1, 120]))), 8, "action 0"),
        ("degrees", changed(&|p| p["actions"] = turn(json!([0, 1, 32_768]))), 2, "expected i16"),
        (
            "angles",
            changed(&|p| p["start"]["modules"][0]["joints_deg"] = json!([0, 0])),
            2,
            "a module is two cells",
        ),
        ("none", changed(&|p| p["start"]["modules"] = json!([])), 2, "start: the structure has no modules"),
    ];
    for (name, text, code, reason) in cases {
        let file = write(directory.path(), &format!("{name}.json"), &text);
        let ran = run(&["plan", "--check", &file]);
        let told = ran.err.contains(name) && ran.err.contains(reason) && ran.err.contains("fix: ");
        assert!(ran.code == Some(code) && ran.out.is_empty() && told, "{name}: {ran:?}");
    }
    let long = directory.path().join("long.json");
    fs::File::create(&long).unwrap().set_len(1 << 30).unwrap();
    let written = "that `metamorph plan -o FILE` has written";
    refused(&["plan", "--check", &long.display().to_string()], &["long.json", "longer than", written]);
    refused(&["plan", "--check", "/dev/zero"], &["/dev/zero", "a device", written]);
}

/// Counting ends at its time limit.
#[test]
fn counting_stops_at_a_limit() {
    let (ran, counted) = answer(&["plan", "--count", "line:6", "--timeout", "200ms"]);
    assert_eq!((ran.code, &counted["configurations"]["complete"]), (Some(0), &json!(false)), "{ran:?}");
}

/// Whenever a search is cancelled, it answers with a valid plan or says that there is none, and with a bound.
#[test]
fn a_cancelled_search_has_a_valid_plan_or_none() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("plan.json").display().to_string();
    let base =
        ["plan", "--from", "tree:5x3", "--to", "line:5", "--collision", "final", "--quiet", "--json", "-"];
    for after in [0, 1, 40, 300, 1_000, 3_000] {
        let mut child =
            command(&[&base[..], &["-o", &file]].concat()).stdout(Stdio::piped()).spawn().unwrap();
        park_timeout(Duration::from_millis(after));
        // Before the program listens, the signal ends it as it would end any program.
        kill_process(Pid::from_child(&child), Signal::INT).unwrap();
        let mut out = String::new();
        child.stdout.take().unwrap().read_to_string(&mut out).unwrap();
        let status = child.wait().unwrap();
        if out.is_empty() {
            assert!(matches!(status.code(), None | Some(7)), "after {after} ms: {status}");
            continue;
        }
        let found: Value = serde_json::from_str(&out).unwrap();
        assert!(matches!(status.code(), Some(0 | 7)), "after {after} ms: {status}, {found}");
        match found["plan"].as_object() {
            None => assert_eq!((&found["verdict"], status.code()), (&json!("undecided"), Some(7)), "{found}"),
            Some(_) => {
                let ran = run(&["plan", "--check", &file]);
                assert!(ran.code == Some(0) && ran.out.starts_with("valid: "), "{ran:?}");
            }
        }
        assert!(found["lower"].as_u64().unwrap() > 0, "{found}");
    }
}
