//! Commands of every day: scenarios by their names, and what helps where a name is wrong.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{Ran, command, metamorph, scenario, scenarios};
use metamorph_tests::required::{Check, skip};
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::Stdio;

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
    assert!(ran.code == Some(0) && ran.out.starts_with("swarm  2 of 2 runs"), "{ran:?}");
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

/// Two sweeps of one scenario with another protocol differ; two sweeps with other seeds do not; a sweep equals
/// itself.
#[test]
fn sweeps_are_compared_by_statistics() {
    let directory = tempfile::tempdir().unwrap();
    let at = |args: &[&str]| within(directory.path(), args);
    let cycles = fs::read_to_string(metamorph_tests::command::scenario("line-to-box.toml")).unwrap();
    fs::write(directory.path().join("cycles.toml"), cycles + "\n[protocol]\nconnectivity = \"cycles\"\n")
        .unwrap();
    for (scenario, seeds, out) in [
        ("line-to-box", "0..40", "forest"),
        ("line-to-box", "100..140", "again"),
        ("cycles.toml", "0..40", "cycles"),
    ] {
        let ran = at(&["sweep", scenario, "--seeds", seeds, "--out", out, "--quiet"]);
        assert_eq!(ran.code, Some(0), "{ran:?}");
    }
    let lines = |a: &str, b: &str, more: &[&str]| {
        let ran = at(&[&["diff", a, b, "--quiet", "--json", "-"], more].concat());
        json(&ran)["lines"].as_array().unwrap().clone()
    };
    let differing = |lines: &[Value]| lines.iter().filter(|line| line["differs"] == true).count();
    let found = lines("forest", "cycles", &[]);
    assert!(found.len() > 5 && differing(&found) > 0, "{found:?}");
    let messages = found.iter().find(|line| line["measure"] == "messages").unwrap();
    let number = |key: &str| messages[key].as_f64().unwrap();
    assert!(number("low") <= number("by") && number("by") <= number("high"), "{messages}");
    assert_eq!((messages["n_a"].as_u64(), messages["n_b"].as_u64()), (Some(40), Some(40)));
    // Searches for cycles are most of what connecting cycles send to stay connected; nothing else is ten times as much.
    let tenfold = lines("forest", "cycles", &["--at-least", "1000%"]);
    let tenfold: Vec<&Value> =
        tenfold.iter().filter(|line| line["differs"] == true).map(|line| &line["measure"]).collect();
    assert_eq!(tenfold, ["  connectivity"]);
    assert_eq!(differing(&lines("forest", "again", &[])), 0);
    let same = lines("forest", "forest", &[]);
    assert!(same.iter().all(|line| line["by"] == 0.0 && line["p"].as_f64() > Some(0.99)), "{same:?}");
    let ran = at(&["diff", "forest", "cycles"]);
    assert!(ran.out.contains("differs") && ran.out.contains("95 % interval"), "{}", ran.out);
    // Keys that both vary.
    let vary = ["--seeds", "0..6", "--vary", "link.loss=0%,5%", "--vary", "swarm.move_time=1s,2s"];
    for out in ["v", "w"] {
        let ran = at(&[&["sweep", "line-to-box", "--quiet", "--out", out], &vary[..]].concat());
        assert_eq!(ran.code, Some(0), "{ran:?}");
    }
    let groups = |more: &[&str]| {
        let found = lines("v", "w", more);
        let runs = found[0]["n_a"].as_u64().unwrap();
        (found.iter().map(|line| line["values"].to_string()).collect::<BTreeSet<_>>().len(), runs)
    };
    assert_eq!(groups(&[]), (4, 6));
    assert_eq!(groups(&["--by", "link.loss"]), (2, 12));
    assert_eq!(groups(&["--by", "link.loss", "--by", "swarm.move_time"]), (4, 6));
    let ran = at(&["diff", "v", "w", "--by", "link.lost"]);
    assert_eq!(ran.code, Some(2), "{ran:?}");
    assert!(ran.err.contains("name one of link.loss, swarm.move_time"), "{}", ran.err);
    // Plots: of one sweep, and of the differences between two, with the tables behind them.
    let read = |name: &str| fs::read_to_string(directory.path().join(name)).unwrap();
    let drawn = |svg: &str| {
        let count = |tag: &str| svg.matches(tag).count();
        assert!(svg.starts_with("<svg xmlns=") && !svg.contains("class="), "{svg}");
        (count("<circle"), count("<title"))
    };
    let ran = at(&["render", "v", "--out", "built.svg", "--table", "built.csv", "--quiet"]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(0), ""), "{ran:?}");
    assert_eq!(drawn(&read("built.svg")), (4, 4));
    let table = read("built.csv");
    assert!(table.starts_with("link.loss,swarm.move_time,runs,built,rate,low,high\n0%,1s,6,6,1,"), "{table}");
    let ran = at(&["render", "v", "--plot", "makespan", "--out", "m.svg", "--table", "m.csv", "--quiet"]);
    assert_eq!((ran.code, drawn(&read("m.svg"))), (Some(0), (4, 4)), "{ran:?}");
    assert_eq!(read("m.csv").lines().map(|line| line.split(',').count()).collect::<Vec<_>>(), [12; 5]);
    let ran = at(&["diff", "forest", "cycles", "--plot", "forest.svg", "--quiet"]);
    let undrawn = found.iter().filter(|line| line["rate"] == false && line["a"] == 0.0).count();
    assert_eq!((ran.code, drawn(&read("forest.svg")).0 + undrawn), (Some(0), found.len()), "{ran:?}");
    for (command, reason) in [
        (&["render", "v", "--out", "x.png"][..], "a plot is an SVG"),
        (
            &["render", "line-to-box", "--plot", "moves", "--out", "x.svg"],
            "only sweeps and reports are plotted",
        ),
        (
            &["diff", "cycles.toml", "cycles.toml", "--plot", "x.svg"],
            "two reports have no keys and no intervals",
        ),
    ] {
        let ran = at(command);
        assert_eq!((ran.code, ran.out.as_str()), (Some(2), ""), "{ran:?}");
        assert!(ran.err.contains(reason) && ran.err.contains("\n  fix: "), "{}", ran.err);
    }
    // What is no sweep is refused.
    fs::create_dir(directory.path().join("empty")).unwrap();
    for (a, b, reason) in [
        ("forest", "empty", "empty: "),
        ("forest", "none", "one is a directory and the other one is a file"),
        ("none", "none", "none: cannot read it"),
        ("cycles.toml", "cycles.toml", "this is not JSON"),
    ] {
        let ran = at(&["diff", a, b]);
        assert_eq!((ran.code, ran.out.as_str()), (Some(2), ""), "{ran:?}");
        assert!(ran.err.contains(reason) && ran.err.contains("\n  fix: "), "{}", ran.err);
    }
}

#[test]
fn reports_are_compared_field_by_field() {
    let directory = tempfile::tempdir().unwrap();
    let at = |args: &[&str]| within(directory.path(), args);
    for (seed, out) in [("1", "a.json"), ("1", "again.json"), ("2", "b.json")] {
        let ran = at(&["run", "swarm", "--link", "sim", "--seed", seed, "--quiet", "--json", out]);
        assert_eq!(ran.code, Some(0), "{ran:?}");
    }
    let plotted = at(&["render", "a.json", "--table", "a.csv", "--quiet"]);
    assert_eq!(plotted.code, Some(0), "{plotted:?}");
    let table = fs::read_to_string(directory.path().join("a.csv")).unwrap();
    assert!(
        table.starts_with("class,sent,delivered,lost\ngradient,") && table.lines().count() == 8,
        "{table}"
    );
    let same = at(&["diff", "a.json", "again.json"]);
    assert!(same.out.contains("the same run: the trace hashes are equal"), "{}", same.out);
    let same = json(&at(&["diff", "a.json", "again.json", "--quiet", "--json", "-"]));
    assert_eq!(
        (&same["same_run"], same["differences"].as_array().unwrap().len()),
        (&Value::Bool(true), 0),
        "{same}"
    );
    let other = json(&at(&["diff", "a.json", "b.json", "--quiet", "--json", "-"]));
    let fields: Vec<&str> =
        other["differences"].as_array().unwrap().iter().map(|d| d["field"].as_str().unwrap()).collect();
    assert!(["seed", "trace_hash"].iter().all(|field| fields.contains(field)), "{fields:?}");
}

/// Every check says what it found and what is needed; a swarm that is too large for this machine's limits cannot
/// run, and the check that fails says what to change.
#[test]
fn doctor_names_what_limits_a_swarm() {
    let directory = tempfile::tempdir().unwrap();
    let checks = |ran: &Ran| -> Vec<Value> {
        serde_json::from_str(&ran.out).unwrap_or_else(|e| panic!("{e}: {ran:?}"))
    };
    let few = within(directory.path(), &["doctor", "--modules", "1", "--json"]);
    let few = checks(&few);
    assert!(few.len() >= 9, "{few:?}");
    for check in &few {
        for key in ["name", "state", "found", "needs", "otherwise", "fix"] {
            assert!(check[key].as_str().is_some_and(|text| !text.is_empty()), "{key}: {check}");
        }
    }
    // With few open files, as a shell passes the limit on.
    let mut shell = std::process::Command::new("sh");
    shell.arg("-c").arg("ulimit -n 1200 && exec \"$0\" doctor --modules 1000 --json");
    let ran: Ran = shell.arg(metamorph_tests::command::metamorph()).output().unwrap().into();
    assert_eq!(ran.code, Some(1), "{ran:?}");
    let files = checks(&ran).into_iter().find(|check| check["name"] == "open files, hard limit").unwrap();
    assert_eq!((files["state"].as_str(), files["found"].as_str()), (Some("fail"), Some("1,200")), "{files}");
    assert!(
        files["fix"].as_str().unwrap().contains("nofile")
            || files["fix"].as_str().unwrap().contains("NOFILE")
    );
    let text = within(directory.path(), &["doctor", "--modules", "16000"]);
    assert!(text.out.contains("a swarm of 16,000 modules can"), "{text:?}");
    assert_eq!(within(directory.path(), &["doctor", "--modules", "16001"]).code, Some(2));
}

#[test]
fn new_scenarios_can_be_run_and_overwrite_nothing() {
    let directory = tempfile::tempdir().unwrap();
    let at = |args: &[&str]| within(directory.path(), args);
    for (file, options) in [
        ("a.toml", &[][..]),
        ("b.toml", &["--family", "metamodule"]),
        ("c.toml", &["--like", "swarm", "--minimal"]),
    ] {
        let ran = at(&[&["new", file][..], options].concat());
        assert_eq!(ran.code, Some(0), "{ran:?}");
        let ran = at(&["check", file, "--link", "sim"]);
        assert_eq!(ran.code, Some(0), "{ran:?}");
        let before = fs::read(directory.path().join(file)).unwrap();
        assert_eq!(at(&["new", file]).code, Some(2));
        assert_eq!(fs::read(directory.path().join(file)).unwrap(), before);
    }
    for (options, fix) in [
        (&["--family", "cubes"][..], "fix: name one of cube, metamodule"),
        (&["--like", "swram"], "fix: did you mean `swarm`?"),
    ] {
        let ran = at(&[&["new", "d.toml"][..], options].concat());
        assert_eq!(ran.code, Some(2), "{ran:?}");
        assert!(ran.err.contains(fix), "{}", ran.err);
    }
    assert!(!directory.path().join("d.toml").exists());
}

/// Runs `doctor` where shared memory has this size, after a shell command, and returns one of its checks. `None` if the
/// system allows no such thing.
fn doctor_with_shared_memory(size: &str, modules: &str, before: &str, name: &str) -> Option<(Ran, Value)> {
    let script = format!(
        "mount -t tmpfs -o size={size} tmpfs /dev/shm || exit 77; {before}; exec \"$0\" doctor --modules {modules} --json"
    );
    let unshare = ["--map-root-user", "--mount", "--", "sh", "-c", &script];
    let Ok(ran) = std::process::Command::new("unshare").args(unshare).arg(metamorph()).output() else {
        skip(Check::Mounts, "there is no unshare on this machine");
        return None;
    };
    let ran = Ran::from(ran);
    if ran.code == Some(77) || ran.err.starts_with("unshare:") {
        skip(Check::Mounts, &format!("shared memory cannot be made small here: {}", ran.err));
        return None;
    }
    let checks: Vec<Value> = serde_json::from_str(&ran.out).unwrap_or_else(|e| panic!("{e}: {ran:?}"));
    let check = checks.into_iter().find(|check| check["name"] == name).unwrap();
    Some((ran, check))
}

/// 64 MB of shared memory, the default of containers, are enough for 200 modules and not for 1,058.
#[test]
fn doctor_names_small_shared_memory() {
    let check = |size, modules| doctor_with_shared_memory(size, modules, ":", "shared memory, free");
    let Some((_, free)) = check("64m", "200") else { return };
    assert_eq!(free["state"], "ok", "{free}");
    let (ran, free) = check("64m", "1058").unwrap();
    assert_eq!((ran.code, free["state"].as_str()), (Some(1), Some("fail")), "{ran:?}");
    assert!(
        free["fix"].as_str().unwrap().contains("size=") && free["otherwise"] == "`run` refuses to start",
        "{free}"
    );
    let (_, free) = check("16m", "200").unwrap();
    assert_eq!(free["state"], "fail", "{free}");
}

/// The directory of a run without an owner is a leftover, and a warning.
#[test]
fn doctor_names_leftovers() {
    let check = |before| doctor_with_shared_memory("64m", "1", before, "leftovers");
    let Some((_, none)) = check(":") else { return };
    assert_eq!((none["state"].as_str(), none["found"].as_str()), (Some("ok"), Some("0 dead runs")), "{none}");
    let (ran, one) = check("mkdir /dev/shm/mm0000000001").unwrap();
    assert_eq!((one["state"].as_str(), one["found"].as_str()), (Some("warn"), Some("1 dead run")), "{one}");
    assert!(ran.code == Some(0) && one["fix"] == "metamorph clean", "{ran:?}");
}

/// A scaffold leaves cells out. Nothing may pass that for the shape that was drawn.
#[test]
fn all_that_is_drawn_is_built_or_said_to_be_left_out() {
    let head = "version = 1\n[swarm]\nstart = { box = { min = [0, 0, 0], max = [9, 9, 0] } }\n[[goal]]\n";
    let block = "shape = { box = { min = [0, 0, 0], max = [4, 2, 2] } }\n";
    let ball = "shape = { sphere = { center = [4, 4, 0], radius = 1 } }\n";
    // Steps of one cell in width, so that only every second cell is at even distances from a seed.
    let stairs = "shape = { union = [{ box = { min = [0, 0, 0], max = [3, 3, 0] } }, { box = { min = [0, 1, 1], max = [2, 3, 1] } }, \
                  { box = { min = [0, 2, 2], max = [1, 3, 2] } }] }\n";
    // The shape, its growth, and the cells of the goal and of the shape.
    let cases = [
        (block, "", 45, 45),
        (block, "growth = \"scaffold\"\n", 32, 45),
        (block, "growth = \"scaffold\"\nseed = [2, 2, 0]\n", 32, 45),
        (block, "growth = \"scaffold\"\nseed = [1, 1, 0]\n", 8, 45),
        (ball, "", 7, 7),
        (stairs, "", 29, 29),
    ];
    let directory = tempfile::tempdir().unwrap();
    let at = |args: &[&str]| within(directory.path(), args);
    for (shape, growth, cells, drawn) in cases {
        fs::write(directory.path().join("a.toml"), [head, shape, growth].concat()).unwrap();
        let said = format!("{cells} of the {drawn} cells of your shape");
        let is_whole = cells == drawn;
        let checked = at(&["check", "a.toml"]);
        assert_eq!(checked.out.contains(&said), !is_whole, "{growth}{shape}{}", checked.out);
        let ran = at(&[
            "run",
            "a.toml",
            "--link",
            "sim",
            "--json",
            "-",
            "--html",
            "r.html",
            "--journal",
            "r.journal",
        ]);
        let report = json(&ran);
        assert_eq!(
            (&report["outcome"], &report["goal"]["cells"]),
            (&"built".into(), &cells.into()),
            "{growth}{shape}"
        );
        assert_eq!(report["stages"][0]["omitted"], drawn - cells);
        let page = fs::read_to_string(directory.path().join("r.html")).unwrap();
        assert_eq!((ran.err.contains(&said), page.contains(&said)), (!is_whole, !is_whole), "{}", ran.err);
        let drawn_to = at(&["render", "r.journal", "--out", "r.svg"]);
        assert_eq!(drawn_to.code, Some(0), "{drawn_to:?}");
        let legend = format!("goal ({cells} of the {drawn} cells of the shape)");
        assert_eq!(fs::read_to_string(directory.path().join("r.svg")).unwrap().contains(&legend), !is_whole);
    }
}

/// A file that something else wrote, such as a scenario, is replaced only with `--force`.
#[test]
fn only_own_files_are_replaced() {
    let directory = tempfile::tempdir().unwrap();
    let (at, file) = (|args: &[&str]| within(directory.path(), args), directory.path().join("mine"));
    let run = ["run", "swarm", "--link", "sim", "--quiet"];
    let mine = "version = 1\n[swarm]\n";
    for (option, kind) in [("--journal", "a journal"), ("--json", "a JSON document"), ("--html", "a page")] {
        fs::write(&file, mine).unwrap();
        let refused = at(&[&run[..], &[option, "mine"]].concat());
        assert_eq!(
            (refused.code, fs::read_to_string(&file).unwrap().as_str()),
            (Some(2), mine),
            "{refused:?}"
        );
        assert!(
            refused.err.contains(&format!("not {kind} of this program")) && refused.err.contains("--force")
        );
        for more in [&["--force"][..], &[]] {
            let ran = at(&[&run[..], &[option, "mine"], more].concat());
            assert_eq!(ran.code, Some(0), "{ran:?}");
        }
    }
    for _ in 0..2 {
        assert_eq!(at(&[&run[..], &["--csv", "tables"]].concat()).code, Some(0));
    }
    fs::write(directory.path().join("tables/time.csv"), "Name,Surname\n").unwrap();
    assert_eq!(at(&[&run[..], &["--csv", "tables"]].concat()).code, Some(2));
}

/// A goal that needs every module, of which some are killed: `check` warns, and the run ends when nothing can change.
#[test]
fn a_goal_without_spares_is_warned_of_and_given_up_in_time() {
    let directory = tempfile::tempdir().unwrap();
    let at = |args: &[&str]| within(directory.path(), args);
    let text = "version = 1\n[swarm]\nstart = { box = { min = [0, 0, 0], max = [11, 9, 0] } }\nmove_time = \"1s\"\n[[goal]]\n\
                shape = { box = { min = [3, 3, 0], max = [7, 6, 5] } }\n[[fault]]\nkill = [3, 77]\nat = \"5s\"\n";
    fs::write(directory.path().join("a.toml"), text).unwrap();
    let checked = at(&["check", "a.toml"]);
    assert!(
        checked.out.contains("warning   goal 1: 120 modules for 120 cells; 2 are to be killed"),
        "{}",
        checked.out
    );
    let few = at(&["check", "a.toml", "--set", "goal.0.shape.box.max=[7, 6, 4]"]);
    assert!(!few.out.contains("warning"), "100 cells leave 18 spares: {}", few.out);
    let ran = at(&["run", "a.toml", "--link", "sim", "--json", "-"]);
    let report: Value = serde_json::from_str(&ran.out).unwrap();
    let stall = &report["deadlocks"][0];
    assert_eq!(
        (&report["outcome"], &stall["reason"]),
        (&"deadlock".into(), &"material-exhausted".into()),
        "{}",
        ran.err
    );
    // The default bound of a deadlock is 300 s.
    let waited = report["time"]["virtual_s"].as_f64().unwrap() - stall["since_s"].as_f64().unwrap();
    assert!(waited < 100.0, "{waited} s after the last move");
    let left = stall["waiting"].as_array().unwrap();
    assert!(
        !left.is_empty() && left.iter().all(|w| w["why"].as_str().is_some_and(|why| !why.is_empty())),
        "{stall}"
    );
}

/// Colours are for terminals unless they are asked for; `render` has an option of the same name for its figures.
#[test]
fn colours_are_chosen() {
    let directory = tempfile::tempdir().unwrap();
    let run = ["run", "swarm", "--link", "sim"];
    let has_colour = |args: &[&str]| {
        let ran = within(directory.path(), args);
        assert_eq!(ran.code, Some(0), "{ran:?}");
        ran.out.contains('\u{1b}')
    };
    for (options, expected) in
        [(&[][..], false), (&["--color", "always"], true), (&["--color", "never"], false)]
    {
        assert_eq!(has_colour(&[&run[..], options].concat()), expected, "{options:?}");
        assert_eq!(has_colour(&[options, &run[..]].concat()), expected, "{options:?} before the command");
    }
    has_colour(&["--color", "never", "render", "swarm", "--color", "level", "--out", "a.svg"]);
    assert_eq!(within(directory.path(), &["run", "swarm", "--color", "blue"]).code, Some(2));
}

/// A scenario is changed by the same options wherever it is simulated, and a sweep says how to repeat one of its runs.
#[test]
fn options_of_a_scenario_are_the_same_everywhere() {
    let directory = tempfile::tempdir().unwrap();
    let at = |args: &[&str]| within(directory.path(), args);
    let changes = [
        ["--partition", "3,4@1s..2s"],
        ["--kill", "5@1s"],
        ["--restart", "5@3s"],
        ["--loss", "2%"],
        ["--delay", "20ms"],
        ["--dup", "1%"],
        ["--reorder", "1%"],
        ["--rescue", "off"],
        ["--set", "stop.timeout=2000s"],
    ]
    .concat();
    let run = |seed| {
        [&["run", "swarm", "--link", "sim", "--quiet", "--json", "-", "--seed", seed][..], &changes].concat()
    };
    let ran = json(&at(&run("1")));
    let faults: Vec<&str> =
        ran["faults"].as_array().unwrap().iter().filter_map(|fault| fault["fault"].as_str()).collect();
    assert!(["partition", "heal", "kill", "restart"].iter().all(|name| faults.contains(name)), "{faults:?}");
    let swept = at(&[&["sweep", "swarm", "--seeds", "0..2", "--out", "results"][..], &changes].concat());
    assert_eq!(swept.code, Some(0), "{swept:?}");
    let rows = fs::read_to_string(directory.path().join("results/runs.csv")).unwrap();
    assert!(rows.contains(ran["trace_hash"].as_str().unwrap()), "{rows}");
    let other = at(&["sweep", "swarm", "--seeds", "0..2", "--out", "results", "--resume"]);
    assert!(other.code == Some(2) && other.err.contains("--partition 3,4@1s..2s"), "{other:?}");
    let drawn =
        at(&[&["render", "swarm", "--at", "2500ms", "--quiet", "--out", "a.svg"][..], &changes].concat());
    assert_eq!(drawn.code, Some(0), "{drawn:?}");
    let figure = fs::read_to_string(directory.path().join("a.svg")).unwrap();
    assert!(
        figure.contains("--partition 3,4@1s..2s") && figure.contains("--loss 2%"),
        "the figure says how it was made"
    );
    at(&["run", "swarm", "--link", "sim", "--quiet", "--journal", "a.journal"]);
    for command in ["render", "view"] {
        for option in [["--rescue", "off"], ["--partition", "3@1s..2s"]] {
            let refused = at(&[
                &[command, "a.journal", "--out", "b.svg"][..if command == "view" { 2 } else { 4 }],
                &option,
            ]
            .concat());
            assert!(refused.code == Some(2) && refused.err.contains(option[0]), "{refused:?}");
        }
    }
    for wrong in ["3", "x@1s..2s", "3@1s", "3@2s..1s", "42@1s..2s", "@1s..2s"] {
        let refused = at(&["check", "swarm", "--partition", wrong]);
        assert!(refused.code == Some(2) && refused.err.contains("--partition"), "{wrong}: {refused:?}");
    }
}

/// `-` is standard input, which may be JSON; a path where nothing is is called missing by every command.
#[test]
fn standard_input_is_read_and_missing_files_are_called_missing() {
    let directory = tempfile::tempdir().unwrap();
    let text = r#"{ "version": 1, "swarm": { "start": { "box": { "min": [0, 0, 0], "max": [5, 4, 0] } } },
                    "goal": [{ "shape": { "box": { "min": [1, 1, 0], "max": [3, 3, 1] } } }] }"#;
    for args in [
        &["run", "-", "--link", "sim"][..],
        &["check", "-"],
        &["sweep", "-", "--seeds", "0..2"],
        &["render", "-", "--at", "1s"],
    ] {
        let mut running = command(args)
            .current_dir(directory.path())
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        running.stdin.take().unwrap().write_all(text.as_bytes()).unwrap();
        let output = running.wait_with_output().unwrap();
        assert!(output.status.success() && !output.stdout.is_empty(), "{args:?}: {output:?}");
    }
    let missing = "there is no such file";
    for args in [
        &["run", "none.toml"][..],
        &["check", "none/none.toml"],
        &["view", "none"],
        &["view", "none.journal"],
        &["render", "none"],
        &["export", "none.journal", "--csv", "out"],
        &["replay", "none.journal"],
        &["resume", "none.journal"],
        &["diff", "none", "none"],
        &["shape", "none.stl"],
        &["plan", "--from", "none.json", "--to", "loop:3x3"],
        &["structure", "none.json"],
        &["room", "none.toml"],
        &["studio", "none.toml"],
        &["run", "swarm", "--hosts", "none.toml"],
    ] {
        let refused = within(directory.path(), args);
        assert!(refused.code != Some(0) && refused.err.contains(missing), "{args:?}: {refused:?}");
        assert!(!refused.err.contains("os error"), "{args:?}: {refused:?}");
    }
    let refused = within(directory.path(), &["run", "swarm", "--link", "sim", "--json", "none/a.json"]);
    assert!(refused.err.contains("its directory does not exist"), "{refused:?}");
}

/// Files of the program can be read, written and removed by their owner, whatever the umask.
#[test]
fn files_belong_to_their_owner_whatever_the_umask() {
    use std::os::unix::fs::PermissionsExt as _;
    let directory = tempfile::tempdir().unwrap();
    let [report, table] = ["report.json", "table"].map(|name| directory.path().join(name));
    let mut command = std::process::Command::new("sh");
    command
        .args(["-c", "umask 777; exec \"$@\"", "sh"])
        .arg(metamorph())
        .arg("run")
        .arg(scenario("swarm.toml"));
    command.args(["--link", "sim", "-q", "--json"]).arg(&report).arg("--csv").arg(&table);
    let ran: Ran = command.output().expect("a shell can be started").into();
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
    assert_eq!((mode(&report), mode(&table)), (0o600, 0o700));
    for entry in fs::read_dir(&table).unwrap().flatten() {
        assert_eq!(mode(&entry.path()), 0o600, "{}", entry.path().display());
    }
}
