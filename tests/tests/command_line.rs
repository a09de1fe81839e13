//! The command line as a user runs it: exit codes, errors, streams.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{command, on, refused, report, run, scenario, surprises};
use metamorph_world_controller::report::schema::SCHEMA;
use std::fs;
use std::io::Read;
use std::process::Stdio;

const SMALL: &str = r#"
version = 1
name = "small"

[swarm]
start = { box = { min = [0, 0, 0], max = [5, 3, 0] } }

[[goal]]
shape = { box = { min = [0, 0, 0], max = [4, 4, 0] } }
growth = "scaffold"
[stop]
timeout = "500s"
"#;

/// Returns the text with one line changed; the line must be there.
fn with(old: &str, new: &str) -> String {
    assert!(SMALL.contains(old), "{old}");
    SMALL.replace(old, new)
}

#[test]
fn bad_scenarios_are_refused_with_place_reason_and_fix() {
    let goal = "shape = { box = { min = [0, 0, 0], max = [4, 4, 0] } }";
    let start = "start = { box = { min = [0, 0, 0], max = [5, 3, 0] } }";
    let cases: &[(String, &[&str])] = &[
        // Malformed TOML.
        (with("name = \"small\"", "name = small"), &["scenario.toml:3:8:", "not TOML", "name = small"]),
        (with("[swarm]", "[swarm"), &["scenario.toml:5:", "not TOML"]),
        // Unknown keys.
        (
            with("timeout", "time_out"),
            &["scenario.toml:12:1:", "unknown key `time_out`", "did you mean `timeout`?"],
        ),
        (with("[stop]", "[stopp]"), &["unknown key `stopp`", "did you mean `stop`?"]),
        (with("min = [0, 0, 0], max = [4", "mni = [0, 0, 0], max = [4"), &["unknown key `mni`", "no `min`"]),
        // Unknown names.
        (
            with("[stop]", "[protocol]\nstrategy = \"greedy\"\n[stop]"),
            &["scenario.toml:12:1:", "`strategy` in [protocol] is for the family `metamodule`"],
        ),
        (
            with("[stop]", "[protocol]\nprecedence = \"off\"\n[stop]"),
            &["scenario.toml:12:1:", "`precedence` in [protocol] is for the family `metamodule`"],
        ),
        (
            with("[swarm]", "[swarm]\nturn_time = \"1s\""),
            &["scenario.toml:6:1:", "`turn_time` in [swarm] is for the family `metamodule`"],
        ),
        (with(goal, &format!("{goal}\norder = \"circular\"")), &["`order` in [[goal]] is for the family"]),
        (
            with("[stop]", "[protocol]\nconnectivity = \"forrest\"\n[stop]"),
            &["unknown connectivity `forrest`", "did you mean `forest`?"],
        ),
        (with("[stop]", "[protocol]\ndead = \"bury\"\n[stop]"), &["unknown policy", "hold, abandon"]),
        (with("[swarm]", "[swarm]\nfamily = \"cubes\""), &["unknown family `cubes`", "did you mean `cube`?"]),
        // A scenario of cubes declared as one of metamodules.
        (
            with("[swarm]", "[swarm]\nfamily = \"metamodule\""),
            &["unknown key `box` in floor", "two coordinates of a connector"],
        ),
        (with("growth = \"scaffold\"", "growth = \"quick\""), &["unknown growth `quick`", "solid, scaffold"]),
        // The goal and the swarm.
        (
            with("max = [4, 4, 0]", "max = [9, 9, 0]"),
            &["scenario.toml:9:", "the goal has", "the swarm has 24 modules", "too few"],
        ),
        (with("max = [4, 4, 0]", "max = [4, 4, -1]"), &["inside out"]),
        (
            with(goal, "shape = { box = { min = [9, 9, 9], max = [11, 11, 9] } }"),
            &["scenario.toml:9:", "no cell of the goal is occupied"],
        ),
        (
            with(goal, &format!("{goal}\nseed = [9, 9, 9]")),
            &["the seed [9, 9, 9] is not occupied", "such as ["],
        ),
        (
            with(goal, &format!("{goal}\nseed = [5, 0, 0]")),
            &["scenario.toml:10:8:", "the seed [5, 0, 0] is not a cell of the goal"],
        ),
        (with(goal, "shape = { cells = [[0, 0, 0], [2, 0, 0]] }"), &["not connected to the seed"]),
        (with("[[goal]]\nshape", "[goals]\nshape"), &["no [[goal]]", "did you mean `goal`?"]),
        (
            format!("{SMALL}\n[[goal]]\nshape = {{ box = {{ min = [5, 0, 0], max = [5, 3, 0] }} }}\n"),
            &["is occupied by the previous goal"],
        ),
        // The start.
        (
            with(start, "start = { cells = [[0, 0, 0], [2, 2, 2], [0, 0, 1]] }"),
            &["scenario.toml:6:", "2 parts that do not touch", "[0, 0, 0], [2, 2, 2]"],
        ),
        (
            with(start, "start = { cells = [[0, 0, 0], [1, 0, 0], [0, 0, 0]] }"),
            &["scenario.toml:6:42:", "[0, 0, 0] is listed twice"],
        ),
        (with(start, "start = { cells = [] }"), &["no cell"]),
        (with(start, ""), &["[swarm] has no `start`"]),
        (with("max = [5, 3, 0]", "max = [5, 3]"), &["three coordinates"]),
        (with("max = [5, 3, 0]", "max = [16000, 16000, 16000]"), &["the maximum"]),
        (with("max = [5, 3, 0]", "max = [50000, 3, 0]"), &["50000", "16383"]),
        (with("max = [5, 3, 0]", "max = [5, 3, 1e9]"), &["expected a whole number"]),
        // Faults.
        (
            format!("{SMALL}\n[[fault]]\nkill = 24\nat = \"1s\"\n"),
            &["scenario.toml:15:8:", "no module 24", "modules 0 to 23"],
        ),
        (format!("{SMALL}\n[[fault]]\nkill = 3\nat = \"-1s\"\n"), &["scenario.toml:16:6:", "negative"]),
        (format!("{SMALL}\n[[fault]]\nkill = 3\nat = 2\n"), &["no known unit"]),
        (format!("{SMALL}\n[[fault]]\nkill = 3\n"), &["[[fault]] has no `at`"]),
        (format!("{SMALL}\n[[fault]]\nkill = 3\npause = 4\nat = \"1s\"\n"), &["kill and pause"]),
        (
            format!("{SMALL}\n[[fault]]\nkil = 3\nat = \"1s\"\n"),
            &["unknown key `kil`", "did you mean `kill`?"],
        ),
        (
            format!("{SMALL}\n[[fault]]\npause = 3\nfrom = \"3s\"\nuntil = \"3s\"\n"),
            &["begins at 3s and ends at 3s"],
        ),
        (format!("{SMALL}\n[[fault]]\nkill = 3\nat = \"501s\"\n"), &["the run ends at 500s"]),
        (
            format!("{SMALL}\n[[fault]]\nrestart = 3\nat = \"1s\"\nmemory = true\n"),
            &["restart with memory", "not supported yet"],
        ),
        (
            format!("{SMALL}\n[[fault]]\ncontroller = \"kill\"\nat = \"1s\"\n"),
            &["controller", "not supported yet"],
        ),
        (
            format!("{SMALL}\n[[fault]]\nobstacle = [9, 9, 9]\nat = \"1s\"\n"),
            &["scenario.toml:15:1:", "`obstacle` in [[fault]] is for the family `metamodule`"],
        ),
        (
            format!("{SMALL}\n[[fault]]\ncrash = {{ count = 25, between = \"0s..9s\" }}\n"),
            &["not between 0 and 24"],
        ),
        // Times, probabilities, versions.
        (with("timeout = \"500s\"", "timeout = \"-5s\""), &["scenario.toml:12:11:", "`-5s` is negative"]),
        (with("[stop]", "[link]\nloss = \"120%\"\n[stop]"), &["`120%` is not between 0 and 1"]),
        (with("[stop]", "[link]\nloss = -0.1\n[stop]"), &["`-0.1` is not between 0 and 1"]),
        (with("[stop]", "[link]\ndelay = \"9ms..1ms\"\n[stop]"), &["begins at 9ms and ends at 1ms"]),
        (with("[stop]", "[process]\ntime_scale = 0\n[stop]"), &["time_scale is 0"]),
        (with("version = 1", "version = 2"), &["scenario.toml:2:11:", "version 2", "reads version 1"]),
        (with("version = 1", ""), &["no `version`"]),
        (with("name = \"small\"", "name = 5"), &["expected text in quotes, found a whole number"]),
        (String::new(), &["no `version`", "no `swarm`", "no [[goal]]"]),
    ];
    for (text, parts) in cases {
        refused(text, &["check", "{}", "--link", "sim"], parts);
    }
}

#[test]
fn all_errors_are_shown_at_once() {
    let text = with("timeout = \"500s\"", "timeout = \"-5s\"\nstal = \"3s\"").replace("name", "nmae");
    refused(
        &text,
        &["run", "{}", "--link", "sim"],
        &["negative", "did you mean `stall`?", "did you mean `name`?"],
    );
}

#[test]
fn bad_options_are_refused_like_lines_of_the_scenario() {
    let cases: &[(&[&str], &[&str])] = &[
        (&["--kill", "999@2s"], &["--kill 999@2s: there is no module 999", "modules 0 to 23"]),
        (&["--kill", "3@-2s"], &["--kill 3@-2s: ", "negative"]),
        (&["--kill", "three@2s"], &["`three@2s` is not of the form ID@T"]),
        (&["--kill", "-3@2s"], &["not of the form ID@T"]),
        (&["--pause", "3@2s"], &["not of the form ID@T..T"]),
        (&["--pause", "3@2s..1s"], &["begins at 2s and ends at 1s"]),
        (&["--restart", "24@1s"], &["no module 24"]),
        (&["--kill", "3@9999s"], &["the run ends at 500s"]),
        (&["--loss", "-5%"], &["--loss -5%: `-5%` is not between 0 and 1"]),
        (&["--dup", "much"], &["`much` is not a probability"]),
        (&["--delay", "5"], &["no known unit"]),
        (&["--time-scale", "-1"], &["time_scale is -1"]),
        (&["--set", "link.lose=5%"], &["--set link.lose=5%: unknown key `lose`", "did you mean `loss`?"]),
        (&["--set", "loss=5%"], &["--set loss=5%: unknown key `loss`", "did you mean `link.loss`?"]),
        (&["--set", "timeout=5s"], &["did you mean `stop.timeout`?"]),
        (&["--set", "co_owners=false"], &["did you mean `protocol.co_owners`?"]),
        (&["--set", "link.loss=120%"], &["--set link.loss=120%: `120%` is not between 0 and 1"]),
        (&["--set", "link.loss"], &["--set link.loss: `link.loss` is not of the form KEY=VALUE"]),
        (
            &["--json", "/no/such/directory/report.json"],
            &["--json /no/such/directory/report.json: cannot write"],
        ),
    ];
    for (options, parts) in cases {
        let args = [&["run", "{}", "--link", "sim"], *options].concat();
        refused(SMALL, &args, parts);
    }
}

#[test]
fn bad_usage_has_its_exit_code() {
    for args in
        [&["rnu"][..], &[], &["run"], &["run", "a.toml", "--sead", "1"], &["run", "a.toml", "--seed", "x"]]
    {
        let ran = run(args);
        assert_eq!(ran.code, Some(2), "{ran:?}");
        assert!(ran.out.is_empty() && (ran.err.contains("Usage") || ran.err.contains("--help")), "{ran:?}");
    }
    assert!(run(&["run", "a.toml", "--sead", "1"]).err.contains("'--seed'"));
}

#[test]
fn unreadable_files_are_refused() {
    let ran = run(&["check", "no/such/file.toml"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("no/such/file.toml: cannot read") && ran.err.contains("fix: "), "{ran:?}");
    let ran = run(&["check", "deploy"]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("deploy: cannot read"), "{ran:?}");
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("bytes.toml");
    fs::write(&path, [0xFF, 0xFE, 0x80]).unwrap();
    let ran = run(&["check", &path.display().to_string()]);
    assert_eq!(ran.code, Some(2));
    assert!(ran.err.contains("not UTF-8"), "{ran:?}");
}

#[test]
fn help_is_enough_to_use_every_command() {
    for (args, parts) in [
        (&["--help"][..], &["run", "check", "clean", "Exit codes", "METAMORPH_LOG"][..]),
        (
            &["run", "--help"],
            &[
                "SCENARIO",
                "--link",
                "--seed",
                "--kill <ID@T>",
                "--pause <ID@T..T>",
                "--restart <ID@T>",
                "--loss",
                "--delay",
                "--dup",
                "--reorder",
                "--json",
                "--quiet",
                "--time-scale",
                "--set <KEY=VALUE>",
                "Examples",
                "Exit codes",
                "scenario times with a unit",
                "Ctrl-C",
            ],
        ),
        (&["check", "--help"], &["SCENARIO", "Examples", "Exit codes"]),
        (&["clean", "--help"], &["killed", "Exit codes"]),
        (&["--help"], &["\n  8  a replay differs", "\n  9  a journal is damaged"]),
        (&["replay", "--help"], &["Exit codes", "8  the replay differs", "9  the journal is damaged"]),
        (&["view", "--help"], &["Exit codes", "9  the journal is damaged"]),
        (&["resume", "--help"], &["Exit codes", "\n  9  the journal is damaged"]),
        (&["export", "--help"], &["Exit codes", "9  the journal is damaged"]),
        (&["explore", "--help"], &["--runs", "--seconds", "--seed", "--family", "Examples", "Exit codes"]),
    ] {
        let ran = run(args);
        assert_eq!(ran.code, Some(0), "{ran:?}");
        for part in parts {
            assert!(ran.out.contains(part), "`{part}` is missing in {args:?}: {}", ran.out);
        }
        assert!(!ran.out.contains("\x1b["), "colours although this is not a terminal");
        assert!(!ran.out.contains("\n  agent "), "the hidden command shows");
    }
}

#[test]
fn check_prints_the_plan() {
    let ran = on(SMALL, &["check", "{}", "--link", "sim", "--kill", "3@2s", "--loss", "5%"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    for part in ["24 modules", "goal 1: 21 cells", "loss 5%", "at 2s kill 3", "--kill 3@2s --loss 5%"] {
        assert!(ran.out.contains(part), "`{part}` is missing in {}", ran.out);
    }
}

/// The fields that scripts use, by their names in the file.
#[test]
fn json_goes_to_standard_output_alone() {
    let ran = on(SMALL, &["run", "{}", "--link", "sim", "--json", "-"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let report = report(&ran.out);
    assert_eq!((report.schema, report.outcome.as_str(), report.link.as_str()), (SCHEMA, "built", "sim"));
    assert_eq!((report.agents.launched, report.goal.cells, report.goal.filled), (24, 21, 21));
    assert_eq!(report.invariants.broken, 0);
    assert!(ran.err.contains("BUILT") && ran.err.contains("repeat with"), "{}", ran.err);
    let value: serde_json::Value = serde_json::from_str(&ran.out).unwrap();
    for path in [
        "/version",
        "/scenario",
        "/seed",
        "/agents/alive",
        "/agents/crashed",
        "/agents/restarted",
        "/deadlocks",
        "/livelocks",
        "/collisions/attempted",
        "/collisions/prevented",
        "/collisions/suffered",
        "/moves",
        "/messages/total",
        "/messages/bytes",
        "/messages/by_class/gradient/sent",
        "/messages/by_class/gradient/delivered",
        "/messages/by_class/gradient/lost",
        "/messages/by_class/gradient/duplicated",
        "/messages/by_class/gradient/overflowed",
        "/messages/by_class/gradient/bytes",
        "/body_messages",
        "/time/virtual_s",
        "/time/wall_s",
        "/time/setup_s",
        "/invariants/checked",
        "/invariants/violated",
        "/faults",
        "/trace_hash",
        "/state_hash",
        "/agents_hash",
        "/world_hash",
    ] {
        assert!(value.pointer(path).is_some(), "{path} is missing");
    }
}

#[test]
fn counts_add_up() {
    let args =
        ["run", "{}", "--link", "sim", "--json", "-", "--loss", "5%", "--dup", "5%", "--reorder", "5%"];
    let report = report(&on(SMALL, &args).out);
    for (class, c) in report.messages.by_class.iter().chain([(&"all".to_owned(), &report.messages.all)]) {
        let out = c.delivered + c.lost + c.overflowed + c.expired + c.refused;
        assert_eq!((c.sent + c.duplicated) as i64, out as i64 + c.in_flight, "{class}: {c:?}");
    }
    assert!(report.messages.all.lost > 0 && report.messages.all.duplicated > 0);
    assert_eq!(report.messages.total, report.messages.by_class.values().map(|c| c.sent).sum::<u64>());
}

#[test]
fn quiet_prints_nothing_and_the_file_is_written() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("report.json");
    fs::write(&file, "{\"schema\": 1, \"older\": \"and longer than nothing\"}").unwrap();
    let ran = on(SMALL, &["run", "{}", "--link", "sim", "--quiet", "--json", &file.display().to_string()]);
    assert_eq!((ran.code, ran.out.as_str(), ran.err.as_str()), (Some(0), "", ""));
    assert_eq!(report(&fs::read_to_string(&file).unwrap()).outcome, "built");
}

#[test]
fn one_seed_gives_one_trace_and_the_same_states_in_every_process() {
    let hashes = |seed: &str| {
        let args = ["run", "{}", "--link", "sim", "--quiet", "--json", "-", "--loss", "5%", "--seed", seed];
        let report = report(&on(SMALL, &args).out);
        let hashes = [report.trace_hash, report.state_hash, report.agents_hash, report.world_hash];
        hashes.map(|hash| hash.expect("the simulated link hashes its run"))
    };
    let (first, other) = (hashes("7"), hashes("8"));
    assert!(first.iter().all(|hash| hash.len() == 16));
    assert_eq!(first, hashes("7"));
    assert!(first.iter().zip(&other).all(|(a, b)| a != b), "{first:?} {other:?}");
}

#[test]
fn the_exit_code_tells_the_outcome() {
    let ran = on(&with("500s", "2s"), &["run", "{}", "--link", "sim", "--json", "-"]);
    assert_eq!((ran.code, report(&ran.out).outcome.as_str()), (Some(5), "timeout"), "{ran:?}");
    // All but two modules die at once: too few are left.
    let doomed =
        format!("{SMALL}stall = \"50s\"\n[[fault]]\ncrash = {{ count = 22, between = \"0s..1ms\" }}\n");
    let ran = on(&doomed, &["run", "{}", "--link", "sim", "--json", "-"]);
    let report = report(&ran.out);
    assert_eq!((ran.code, report.outcome.as_str()), (Some(3), "deadlock"), "{ran:?}");
    assert_eq!((report.deadlocks.len(), report.agents.crashed, report.faults.len()), (1, 22, 22));
    let stall = &report.deadlocks[0];
    assert!(stall.infeasible && !stall.unfilled.is_empty());
    assert_eq!((stall.possible.as_str(), stall.impossible_within.as_deref()), ("no", Some("anything")));
    assert!(report.time.slowed.is_none(), "simulated time has no clock");
}

#[test]
fn a_closed_pipe_is_no_panic() {
    for args in [&["run", "--link", "sim", "--json", "-"][..], &["check"], &["run", "--link", "sim"]] {
        let path = scenario("swarm.toml").display().to_string();
        let args = [&args[..1], &[path.as_str()], &args[1..]].concat();
        let mut child = command(&args).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop(child.stdout.take());
        let mut err = String::new();
        child.stderr.take().unwrap().read_to_string(&mut err).unwrap();
        let status = child.wait().unwrap();
        assert_eq!((status.code(), err.contains("panicked")), (Some(0), false), "{args:?}: {err}");
        assert!(!err.contains("standard output"), "{args:?}: {err}");
    }
}

#[test]
fn an_interrupt_ends_with_a_partial_report() {
    // A run that cannot end by itself for a long time.
    let text = format!("{}stall = \"900000h\"\nlivelock = \"900000h\"\n", with("500s", "1000000h"))
        + "[[fault]]\ncrash = { count = 22, between = \"0s..1ms\" }\n";
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("endless.toml");
    fs::write(&path, text).unwrap();
    let mut child = command(&["run", &path.display().to_string(), "--link", "sim", "--json", "-", "-v"])
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // The command announces the start; from then on signals are caught.
    let mut err = child.stderr.take().unwrap();
    let mut said = Vec::new();
    while !String::from_utf8_lossy(&said).contains("the simulation starts") {
        let mut byte = [0];
        assert_eq!(err.read(&mut byte).unwrap(), 1, "ended early: {}", String::from_utf8_lossy(&said));
        said.push(byte[0]);
    }
    let kill = std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(kill.success());
    let drain = std::thread::spawn(move || std::io::copy(&mut err, &mut std::io::sink()));
    let output = child.wait_with_output().unwrap();
    drain.join().unwrap().unwrap();
    let ran = metamorph_tests::command::Ran::from(output);
    assert_eq!((ran.code, report(&ran.out).outcome.as_str()), (Some(7), "aborted"), "{ran:?}");
}

/// The default link: a process per module, and a real kill.
#[test]
fn the_same_scenario_runs_as_processes() {
    let ran = on(SMALL, &["run", "{}", "--json", "-", "--kill", "23@500ms", "--time-scale", "10"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let report = report(&ran.out);
    assert_eq!((report.link.as_str(), report.outcome.as_str()), ("ipc", "built"));
    assert_eq!((report.agents.launched, report.agents.crashed, report.agents.alive), (24, 1, 23));
    assert_eq!(surprises(&report), [""; 0]);
    assert_eq!((report.trace_hash, report.invariants.broken), (None, 0));
    // What two runs of processes cannot share is left out of the comparison.
    assert_eq!(
        (report.state_hash, report.agents_hash, report.world_hash.map(|h| h.len())),
        (None, None, Some(16))
    );
    assert!(report.messages.all.delivered > 0 && report.body_messages > 0);
    // A run that has ended leaves nothing to remove; runs of other tests are not touched.
    let ran = run(&["clean"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
}

#[test]
fn the_report_for_people_is_one_file_that_loads_nothing() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("report.html");
    let path = scenario("swarm.toml").display().to_string();
    let html = file.display().to_string();
    let ran = run(&["run", &path, "--link", "sim", "--quiet", "--html", &html]);
    assert_eq!((ran.code, ran.out.as_str(), ran.err.as_str()), (Some(0), "", ""));
    let page = fs::read_to_string(&file).unwrap();
    for part in [
        "built",
        "32 of 32",
        "kill 41",
        "metamorph run",
        "--seed 1",
        "negotiation",
        "[[goal]]",
        "class=\"area moves\"",
    ] {
        assert!(page.contains(part), "`{part}` is missing");
    }
    for loaded in ["src=", "href=", "url(", "@import", "<script"] {
        assert!(!page.contains(loaded), "{loaded}");
    }
    let ran = run(&["run", &path, "--link", "sim", "--html", "/nowhere/report.html"]);
    assert!(
        ran.code == Some(2) && ran.err.contains("--html /nowhere/report.html") && ran.err.contains("fix: "),
        "{ran:?}"
    );
}
