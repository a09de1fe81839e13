//! Free modules as processes carry out a central plan, as the simulated ones do, and survive the death of agents.
#![allow(clippy::print_stdout, reason = "shown only on failure or with --nocapture")]

use metamorph_tests::command::{on, refused, report, run, run_processes, scenario};
use metamorph_tests::statistics::seeds_or;
use metamorph_world_controller::report::schema::Report;
use serde_json::Value;

/// Runs the line of four that becomes a loop, and returns its report after the common checks.
fn line_to_loop(link: &str, options: &[&str]) -> Report {
    let path = scenario("line-to-loop.toml").display().to_string();
    let fixed = ["run", path.as_str(), "--link", link, "--json", "-"];
    let args = [&fixed, options].concat();
    let ran = if link == "ipc" { run_processes(&args) } else { run(&args) };
    println!("{}", ran.err);
    let report = report(&ran.out);
    assert_eq!((report.family.as_str(), report.link.as_str()), ("free-module", link));
    assert_eq!((report.invariants.broken, report.collisions.suffered), (0, 0), "{:?}", report.invariants);
    report
}

fn plan(report: &Report) -> &Value {
    &report.family_parts["free_modules"]["plan"]
}

/// Runs it as processes with one agent killed and restarted, and returns the hash of the plan.
fn killed_and_restarted(number: u64) -> String {
    let (module, at) = (number % 4, 200 + number * 370 % 6_000);
    // Beside the one that the scenario kills.
    let (seed, kill) = (number.to_string(), format!("{module}@{at}ms"));
    let report = line_to_loop("ipc", &["--time-scale", "20", "--seed", &seed, "--restart", &kill]);
    assert_eq!(report.outcome, "built", "run {number}, {kill}: {}", report.reason);
    assert_eq!((report.agents.launched, report.agents.alive), (4, 4), "run {number}");
    assert!(report.agents.crashed > 0, "run {number}");
    plan(&report)["hash"].as_str().expect("a plan has a hash").to_owned()
}

/// The plan of the processes is that of the simulation, and the loop is closed whatever agent dies.
fn loops_are_closed(runs: std::ops::Range<u64>) {
    let simulated = line_to_loop("sim", &[]);
    assert_eq!(simulated.outcome, "built", "{}", simulated.reason);
    assert_eq!(
        (plan(&simulated)["actions"].as_u64(), plan(&simulated)["bound"].as_u64()),
        (Some(6), Some(6))
    );
    for number in runs.clone() {
        assert_eq!(plan(&simulated)["hash"], killed_and_restarted(number), "run {number}");
    }
    println!("{} loops closed", runs.end - runs.start);
}

#[test]
fn four_processes_close_the_loop_although_one_is_killed() {
    loops_are_closed(0..3);
}

/// `cargo test -p metamorph-tests a_hundred_loops -- --ignored --nocapture`, or some of the runs with
/// `METAMORPH_SEEDS=0..50` before it.
#[test]
#[ignore = "minutes: a hundred runs of processes"]
fn a_hundred_loops_of_processes() {
    loops_are_closed(seeds_or(0..100));
}

/// Journals of free modules replay, also of turns that carry others.
#[test]
fn a_journal_replays() {
    let directory = tempfile::tempdir().expect("a directory");
    let journal = directory.path().join("journal").display().to_string();
    line_to_loop("sim", &["--journal", &journal]);
    let replayed = run(&["replay", &journal]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
    let told = run(&["replay", &journal, "--agent", "3"]);
    for part in ["is carried by a turn of", "of plan 1", "closed: C0"] {
        assert!(told.out.contains(part), "`{part}` is missing: {}", told.out);
    }
    let picture = directory.path().join("picture.svg").display().to_string();
    let drawn = run(&["render", &journal, "--out", &picture]);
    assert_eq!(drawn.code, Some(0), "{drawn:?}");
}

const TEXT: &str = "version = 1\n[swarm]\nfamily = \"free-module\"\nSTART\n[[goal]]\nshape = \"GOAL\"\n";

fn text(start: &str, goal: &str) -> String {
    TEXT.replace("START", start).replace("GOAL", goal)
}

#[test]
fn impossible_scenarios_are_refused() {
    let cases = [
        ("start = \"line:4\"", "loop:3x4", "the start has 4 modules and the goal 5"),
        ("start = \"ring:4\"", "loop:3x3", "no shape is called `ring:4`"),
        ("start = \"line:99\"", "loop:3x3", "99 modules, but"),
        ("start = \"nowhere.json\"", "loop:3x3", "cannot be read"),
        ("start = \"ell:4\"\ntypes = \"000\"", "loop:3x3", "the start is ell:4"),
        ("start = \"line:4\"\ntypes = \"0x\"", "loop:3x3", "`0x` are not the types of 3 connections"),
        ("start = \"line:2\"\njoints_deg = [[0, 0, 0]]", "ell:2", "lists 1 modules, and the start has 2"),
        ("start = \"line:1\"\njoints_deg = [[0, 45, 0]]", "line:1", "module 0: "),
        ("start = \"line:2\"\nbody = \"clay\"", "ell:2", "unknown body `clay`"),
        ("start = \"line:2\"\nkind = \"SRS\"", "ell:2", "for the family `metamodule`"),
        ("", "ell:2", "has no `start`"),
    ];
    for (start, goal, reason) in cases {
        refused(&text(start, goal), &["check", "{}"], &[reason]);
    }
    let more = [
        ("[protocol]\nweight = 0.5", "weight is 0.5"),
        ("[protocol]\ntrials = 3", "`trials` is for body physics"),
        ("[protocol]\nwork = 0", "work is 0"),
        ("[protocol]\nmemory_mib = 1", "memory_mib is 1"),
        ("[protocol]\nstrategy = \"greedy\"", "unknown strategy `greedy`"),
        ("[[goal]]\nshape = \"line:2\"", "one goal"),
    ];
    for (section, reason) in more {
        refused(&format!("{}{section}\n", text("start = \"line:2\"", "ell:2")), &["check", "{}"], &[reason]);
    }
}

/// A goal that is there at the start takes no plan, and one that no module can act for ends with its proof.
#[test]
fn goals_that_are_there_or_out_of_reach() {
    let there = on(&text("start = \"line:3\"", "line:3"), &["run", "{}", "--json", "-"]);
    let built = report(&there.out);
    assert_eq!(
        (there.code, built.outcome.as_str(), plan(&built)["plans"].as_u64()),
        (Some(0), "built", Some(0))
    );
    let stuck = "[[fault]]\nstick = [0, 1, 2]\nat = \"0s\"\n";
    let never =
        on(&format!("{}{stuck}", text("start = \"line:3\"", "loop:2x3")), &["run", "{}", "--json", "-"]);
    let report = report(&never.out);
    assert_eq!((never.code, report.outcome.as_str()), (Some(3), "deadlock"), "{}", report.reason);
}
