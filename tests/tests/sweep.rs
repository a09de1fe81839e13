//! `metamorph sweep` as a user runs it: results, resuming, errors.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{Ran, command, run};
use metamorph_world_controller::console::format::many;
use metamorph_world_controller::experiments::sweep::summary::{SCHEMA, Summary};
use std::fs;
use std::path::PathBuf;
use std::process::Stdio;
use tempfile::TempDir;

/// A small swarm that is built in some runs only: crashes are drawn from the seed.
const SMALL: &str = r#"
version = 1
name = "small"

[swarm]
start = { box = { min = [0, 0, 0], max = [4, 2, 0] } }

[[goal]]
shape = { box = { min = [0, 0, 0], max = [2, 3, 0] } }
growth = "solid"

[[fault]]
crash = { count = 1, between = "0s..30s" }

[stop]
timeout = "300s"
stall = "40s"
"#;

const VARY: [&str; 4] = ["--vary", "link.loss=0%,10%", "--vary", "protocol.connectivity=forest,cycles"];

/// A directory with the scenario in it.
struct Place(TempDir);

impl Place {
    fn new(text: &str) -> Place {
        let place = Place(tempfile::tempdir().unwrap());
        fs::write(place.at("small.toml"), text).unwrap();
        place
    }
    fn at(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
    /// Sweeps the scenario with these arguments.
    fn sweep(&self, args: &[&str]) -> Ran {
        let path = self.at("small.toml").display().to_string();
        run(&[&["sweep", path.as_str()], args].concat())
    }
    /// Sweeps twelve runs into a directory.
    fn twelve(&self, out: &str, args: &[&str]) -> Ran {
        let out = self.at(out).display().to_string();
        self.sweep(&[&["--seeds", "5..8", "--out", out.as_str()], &VARY[..], args].concat())
    }
    fn read(&self, out: &str, file: &str) -> String {
        fs::read_to_string(self.at(out).join(file)).unwrap()
    }
}

fn summary(text: &str) -> Summary {
    serde_json::from_str(text).unwrap_or_else(|error| panic!("{error}: {text}"))
}

/// Every file of a sweep.
const FILES: [&str; 3] = ["runs.csv", "summary.json", "report.html"];

#[test]
fn results_do_not_depend_on_the_number_of_threads() {
    let place = Place::new(SMALL);
    for (out, jobs) in [("one", "1"), ("two", "2"), ("many", "7")] {
        let ran = place.twelve(out, &["--jobs", jobs]);
        assert_eq!(ran.code, Some(0), "{ran:?}");
        assert_eq!(ran.err, "");
        for part in [
            "12 of 12 runs, seeds 5..8",
            "link.loss",
            "cycles",
            "95 % interval",
            "Of the runs that were built",
        ] {
            assert!(ran.out.contains(part), "`{part}` is missing in {}", ran.out);
        }
        for file in FILES {
            assert_eq!(place.read(out, file), place.read("one", file), "{out} {file}");
        }
    }
    let runs = place.read("one", "runs.csv");
    let lines: Vec<&str> = runs.lines().collect();
    assert!(lines[0].starts_with("run,link.loss,protocol.connectivity,seed,outcome,"), "{}", lines[0]);
    assert_eq!(lines.len(), 13);
    assert!(lines[1].starts_with("0,0%,forest,5,") && lines[12].starts_with("11,10%,cycles,7,"), "{runs}");
    let summary = summary(&place.read("one", "summary.json"));
    assert_eq!((summary.schema, summary.runs, summary.runs_planned, summary.violations), (SCHEMA, 12, 12, 0));
    let built: u64 = summary.combinations.iter().map(|c| c.outcomes["built"]).sum();
    assert_eq!(built as usize, lines.iter().filter(|line| line.contains(",built,")).count());
    for c in &summary.combinations {
        assert_eq!((c.runs, c.outcomes.values().sum::<u64>()), (3, 3));
        assert_eq!(c.moves.map_or(0, |m| m.count), c.outcomes["built"]);
    }
}

/// A run of a sweep is the run that `metamorph run` makes of the same values and seed.
#[test]
fn a_run_of_a_sweep_can_be_repeated_alone() {
    let place = Place::new(SMALL);
    assert_eq!(place.twelve("out", &[]).code, Some(0));
    let path = place.at("small.toml").display().to_string();
    let settings = ["--set", "link.loss=10%", "--set", "protocol.connectivity=cycles"];
    let args =
        [&["run", path.as_str(), "--link", "sim", "--quiet", "--json", "-", "--seed", "6"], &settings[..]]
            .concat();
    let report: serde_json::Value = serde_json::from_str(&run(&args).out).unwrap();
    let [trace, state] = ["trace_hash", "state_hash"].map(|hash| report[hash].as_str().unwrap());
    let (hashes, moves) = (format!("{trace},{state}"), report["moves"].as_u64().unwrap());
    let runs = place.read("out", "runs.csv");
    let line = runs.lines().find(|line| line.starts_with("10,")).unwrap();
    assert!(line.ends_with(&hashes) && line.contains(&format!(",{moves},")), "{line} {hashes} {moves}");
    assert!(report["repeat"].as_str().unwrap().contains("--set protocol.connectivity=cycles"), "{report}");
}

#[test]
fn a_cut_sweep_is_resumed() {
    let place = Place::new(SMALL);
    assert_eq!(place.twelve("whole", &[]).code, Some(0));
    let whole = place.read("whole", "runs.csv");
    let lines: Vec<&str> = whole.split_inclusive('\n').collect();
    let after_seven: usize = lines[..8].iter().map(|line| line.len()).sum();
    // In the middle of a line, at its end, before the first run, after the last, and with a run missing.
    let with_a_gap = [&lines[..4], &lines[6..9]].concat().concat();
    let cut = [&whole[..after_seven + 9], &whole[..after_seven], &whole[..20], &whole, &with_a_gap];
    for (i, left) in cut.into_iter().enumerate() {
        let out = format!("cut-{i}");
        fs::create_dir(place.at(&out)).unwrap();
        fs::copy(place.at("whole").join("manifest.json"), place.at(&out).join("manifest.json")).unwrap();
        fs::write(place.at(&out).join("runs.csv"), left).unwrap();
        let ran = place.twelve(&out, &["--resume"]);
        assert_eq!(ran.code, Some(0), "{ran:?}");
        for file in FILES {
            assert_eq!(place.read(&out, file), place.read("whole", file), "{i} {file}");
        }
        let done = left.matches('\n').count().saturating_sub(1);
        assert!(ran.out.contains(&format!("  {} in ", many(12 - done as u64, "run"))), "{i}: {}", ran.out);
    }
}

/// One command serves a job that is started again: `--resume` begins where nothing is yet, and runs only the seeds that are new.
#[test]
fn a_sweep_gets_more_seeds() {
    let place = Place::new(SMALL);
    assert_eq!(place.twelve("whole", &[]).code, Some(0));
    let out = place.at("out").display().to_string();
    for (seeds, new) in [("5..6", 4), ("5..8", 8), ("5..8", 0)] {
        let ran = place.sweep(&[&["--seeds", seeds, "--out", &out, "--resume"], &VARY[..]].concat());
        assert!(ran.code == Some(0) && ran.out.contains(&format!("  {} in ", many(new, "run"))), "{ran:?}");
    }
    for file in FILES {
        assert_eq!(place.read("out", file), place.read("whole", file), "{file}");
    }
}

#[test]
fn parts_of_a_sweep_are_joined_to_the_files_of_one_machine() {
    let place = Place::new(SMALL);
    assert_eq!(place.twelve("whole", &[]).code, Some(0));
    for (part, name) in [("1/3", "a"), ("2/3", "b"), ("3/3", "c")] {
        let ran = place.twelve(name, &["--part", part, "--resume"]);
        assert!(ran.code == Some(0) && ran.out.contains(&format!("the part {part}")), "{ran:?}");
        assert!(!place.at(name).join("summary.json").exists());
    }
    let [a, b, c, out] = ["a", "b", "c", "joined"].map(|name| place.at(name).display().to_string());
    let join = |parts: &[&str]| run(&[&["sweep", "--join"], parts, &["--out", &out]].concat());
    for (parts, part) in
        [(&[&a, &c][..], "1 part of 3 missing: 2/3"), (&[&a, &b, &c, &b], "the part 2/3 is in")]
    {
        let ran = join(&parts.iter().map(|part| part.as_str()).collect::<Vec<_>>());
        assert!(ran.code == Some(2) && ran.err.contains(part) && ran.err.contains("fix: "), "{ran:?}");
    }
    // A part that was cut off is named, and completed by the command that began it.
    let runs = place.read("b", "runs.csv");
    fs::write(place.at("b").join("runs.csv"), &runs[..runs.len() - 9]).unwrap();
    let ran = join(&[&a, &b, &c]);
    assert!(ran.code == Some(2) && ran.err.contains("2/3 in") && ran.err.contains("3 of 4 runs"), "{ran:?}");
    assert_eq!(place.twelve("b", &["--part", "2/3", "--resume"]).code, Some(0));
    let ran = join(&[&c, &b, &a]);
    assert!(ran.code == Some(0) && ran.out.contains("12 runs of 3 parts"), "{ran:?}");
    for file in FILES {
        assert_eq!(place.read("joined", file), place.read("whole", file), "{file}");
    }
}

#[test]
fn only_the_same_sweep_is_resumed() {
    let place = Place::new(SMALL);
    assert_eq!(place.twelve("out", &[]).code, Some(0));
    let out = place.at("out").display().to_string();
    let refused = |args: &[&str], parts: &[&str]| {
        let ran = place.sweep(args);
        assert_eq!(ran.code, Some(2), "{args:?}: {ran:?}");
        for part in parts.iter().chain(&["fix: "]) {
            assert!(ran.err.contains(part), "`{part}` is missing in: {}", ran.err);
        }
        assert!(ran.out.is_empty(), "{ran:?}");
    };
    let runs = place.read("out", "runs.csv");
    refused(&["--seeds", "5..8", "--out", &out], &["is not empty", "--resume"]);
    refused(&["--seeds", "5..8", "--out", &out, "--resume"], &["other variations", "there, none here"]);
    let other = [&["--seeds", "5..7", "--out", out.as_str(), "--resume"], &VARY[..]].concat();
    refused(&other, &["other seeds: 5..8 there, 5..7 here"]);
    let part = [&["--seeds", "5..8", "--out", out.as_str(), "--resume", "--part", "1/2"], &VARY[..]].concat();
    refused(&part, &["another part: the whole there, 1/2 here"]);
    refused(&["--seeds", "5..8", "--out", "/proc/nothing/here"], &["/proc/nothing/here", "cannot write"]);
    let file = place.at("small.toml").display().to_string();
    refused(&["--seeds", "5..8", "--out", &file], &["small.toml", "cannot write"]);
    fs::write(place.at("small.toml"), SMALL.replace("300s", "301s")).unwrap();
    let ran = place.twelve("out", &["--resume"]);
    assert_eq!(ran.code, Some(2), "{ran:?}");
    assert!(ran.err.contains("another scenario"), "{ran:?}");
    assert_eq!(place.read("out", "runs.csv"), runs, "a refused sweep changed the file");
}

#[test]
fn bad_arguments_are_named() {
    let place = Place::new(SMALL);
    let cases: &[(&[&str], &[&str])] = &[
        (&["--vary", "link.lose=1%"], &["--vary link.lose=1%: unknown key `lose`", "did you mean `loss`?"]),
        (
            &["--vary", "links.loss=1%"],
            &["--vary links.loss=1%: unknown key `links`", "did you mean `link`?"],
        ),
        (
            &["--vary", "link.loss=5%,120%"],
            &[
                "--vary link.loss=120%: `120%` is not between 0 and 1",
                "in the combination --vary link.loss=120%",
            ],
        ),
        (&["--vary", "link.loss=5%,much"], &["--vary link.loss=much: `much` is not a probability"]),
        (&["--vary", "goal.0.growth=solid,quick"], &["--vary goal.0.growth=quick: unknown growth `quick`"]),
        (&["--vary", "goal.1.growth=solid"], &["--vary goal.1.growth=solid: `goal` has no element 1"]),
        (&["--vary", "name.x=1"], &["--vary name.x=1: `name` is neither a table nor a list"]),
        (&["--vary", "swarm.start={ box = { min = [0,0,0]"], &["this is not TOML"]),
        // Where only values of the scenario are wrong together, the combination is named.
        (
            &["--vary", "swarm.start.box.max=[4, 2, 0],[1, 1, 0]", "--vary", "link.loss=0%"],
            &[
                "small.toml:9:",
                "too few",
                "in the combination --vary 'swarm.start.box.max=[1, 1, 0]' --vary link.loss=0%",
            ],
        ),
        (&["--vary", "link.loss"], &["--vary link.loss: this is not of the form"]),
        (&["--vary", "link.loss=1%,,2%"], &["one of the values is empty"]),
        (&["--vary", "link.loss=1%,1%"], &["the value `1%` is there twice"]),
        (&["--vary", "seed=1,2"], &["--vary seed=1,2: the seed is given with --seeds"]),
        (&["--vary", "link.loss=1%", "--vary", "link.loss=2%"], &["`link.loss` overlaps with"]),
        (&["--seeds", "0-5"], &["--seeds 0-5: ", "A..B"]),
        (&["--seeds", "5..5"], &["--seeds 5..5: there is no seed"]),
        (&["--seeds", "-1..5"], &["--seeds -1..5: "]),
        (&["--seeds", "0..20000000"], &["too many runs", "10000000"]),
    ];
    for (options, parts) in cases {
        let seeds: &[&str] = if options.contains(&"--seeds") { &[] } else { &["--seeds", "0..2"] };
        let ran = place.sweep(&[options, seeds].concat());
        assert_eq!(ran.code, Some(2), "{options:?}: {ran:?}");
        assert!(ran.out.is_empty(), "{ran:?}");
        for part in parts.iter().chain(&["fix: "]) {
            assert!(ran.err.contains(part), "`{part}` is missing in: {}", ran.err);
        }
    }
    for args in [&["--seeds", "0..2", "--resume"][..], &[], &["--seeds", "0..2", "--jobs", "0"]] {
        let ran = place.sweep(args);
        assert_eq!(ran.code, Some(2), "{ran:?}");
        assert!(ran.err.contains("--help"), "{ran:?}");
    }
    let broken = Place::new(&SMALL.replace("version = 1", "version = 2"));
    let ran = broken.sweep(&["--seeds", "0..2"]);
    assert_eq!(ran.code, Some(2), "{ran:?}");
    assert!(
        ran.err.contains("small.toml:2:11: the scenario has version 2") && !ran.err.contains("combination")
    );
}

#[test]
fn quiet_prints_nothing_and_help_is_complete() {
    let place = Place::new(SMALL);
    let ran = place.sweep(&["--seeds", "0..2", "--quiet"]);
    assert_eq!((ran.code, ran.out.as_str(), ran.err.as_str()), (Some(0), "", ""));
    let help = run(&["sweep", "--help"]).out;
    for part in [
        "--seeds <A..B>",
        "--vary",
        "--jobs",
        "--out",
        "--resume",
        "Exit codes",
        "Examples",
        "Ctrl-C",
        "runs.csv",
    ] {
        assert!(help.contains(part), "`{part}` is missing in {help}");
    }
}

/// An interrupted sweep keeps its results, says how to resume, and resuming gives the same results as without
/// the interruption.
#[test]
fn an_interrupt_keeps_the_results() {
    // The first combination ends at once, the other only after a long time.
    let text = SMALL
        .replace("timeout = \"300s\"", "timeout = \"300000h\"")
        .replace("stall = \"40s\"", "stall = \"200000h\"");
    let place =
        Place::new(&text.replace("count = 1, between = \"0s..30s\"", "count = 13, between = \"0s..1s\""));
    let out = place.at("out").display().to_string();
    let path = place.at("small.toml").display().to_string();
    let args = [
        "sweep",
        &path,
        "--seeds",
        "0..2",
        "--vary",
        "stop.timeout=3s,200000h",
        "--out",
        &out,
        "--jobs",
        "2",
    ];
    let mut child = command(&args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    // The first two runs are in the file as soon as both threads are busy with the others.
    let runs = place.at("out").join("runs.csv");
    let lines = || fs::read_to_string(&runs).map_or(0, |text| text.matches('\n').count());
    while lines() < 3 {
        assert_eq!(child.try_wait().unwrap(), None, "it ended early");
        std::thread::yield_now();
    }
    let kill = std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(kill.success());
    let ran = Ran::from(child.wait_with_output().unwrap());
    assert_eq!(ran.code, Some(7), "{ran:?}");
    for part in ["interrupted: 2 runs still to be done", "resume with  metamorph sweep", "--resume"] {
        assert!(ran.out.contains(part), "`{part}` is missing in {}", ran.out);
    }
    assert_eq!(lines(), 3);
    let summary = summary(&place.read("out", "summary.json"));
    assert_eq!((summary.runs, summary.runs_planned), (2, 4));
}
