//! Packed scenarios: one file that makes the same runs wherever it is.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{command, on, refused, report, run, scenario, scenarios};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// Scenario time after which runs are compared, so that each takes a moment only.
const UNTIL: &str = "stop.timeout=20s";

/// Packs a scenario into a file, and returns the text.
fn packed(file: &str, into: &Path) -> String {
    let ran = run(&["sweep", file, "--pack", &into.display().to_string()]);
    assert_eq!((ran.code, ran.err.as_str()), (Some(0), ""), "{ran:?}");
    assert!(ran.out.contains("has the scenario and"), "{ran:?}");
    fs::read_to_string(into).unwrap()
}

/// Returns the trace and the state hash of a simulated run from a directory.
fn hashes(file: &str, directory: &Path) -> (String, String) {
    let run = |options: &[&str]| {
        let args = [&["run", file, "--link", "sim", "--json", "-", "--quiet"], options].concat();
        command(&args).current_dir(directory).output().unwrap()
    };
    let mut output = run(&["--set", UNTIL]);
    if output.status.code() == Some(2) {
        // Some have faults after that time, and must run on.
        output = run(&[]);
    }
    let report = report(&String::from_utf8(output.stdout).unwrap());
    (report.trace_hash.unwrap(), report.state_hash.unwrap())
}

#[test]
fn shipped_scenarios_have_the_same_hashes_packed_and_unpacked() {
    let (here, elsewhere) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let mut with_files = BTreeSet::new();
    for path in scenarios() {
        let (file, name) =
            (path.display().to_string(), path.file_stem().unwrap().to_str().unwrap().to_owned());
        let text = packed(&file, &here.path().join(format!("{name}.toml")));
        let unpacked = fs::read_to_string(&path).unwrap();
        assert!(text.starts_with(&unpacked), "{name}");
        // Nothing that the scenario names is there.
        fs::write(elsewhere.path().join("packed.toml"), &text).unwrap();
        let ran = run(&["check", &elsewhere.path().join("packed.toml").display().to_string()]);
        assert_eq!(ran.code, Some(0), "{ran:?}");
        // The same text makes the same runs.
        if text.len() > unpacked.len() {
            assert_eq!(hashes("packed.toml", elsewhere.path()), hashes(&file, here.path()), "{name}");
            with_files.insert(name);
        }
    }
    for name in ["rabbit", "arch", "quadruped"] {
        assert!(with_files.contains(name), "{with_files:?}");
    }
}

#[test]
fn a_shipped_scenario_is_packed_by_its_name_and_a_packed_one_stays_as_it_is() {
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name);
    let text = packed("arch", &path("a.toml"));
    let begins = "\n[[file]]\nname = \"../shapes/arch.stl\"\ntext = '''\nsolid arch\n";
    assert!(text.contains(begins), "{text}");
    assert_eq!(packed(&path("a.toml").display().to_string(), &path("b.toml")), text);
    assert_eq!(packed(&scenario("arch.toml").display().to_string(), &path("c.toml")), text);
    let sweep = |file: &str, out: &str| {
        let out = path(out).display().to_string();
        let ran = run(&["sweep", file, "--seeds", "0..2", "--set", UNTIL, "--out", &out, "--quiet"]);
        assert_eq!(ran.code, Some(0), "{ran:?}");
        fs::read_to_string(Path::new(&out).join("runs.csv")).unwrap()
    };
    assert_eq!(sweep(&path("a.toml").display().to_string(), "packed"), sweep("arch", "unpacked"));
}

/// A journal holds the text of its scenario, so that one of a packed scenario replays without its files.
#[test]
fn a_journal_of_a_packed_scenario_replays_anywhere() {
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name).display().to_string();
    packed("rabbit", Path::new(&path("a.toml")));
    let (scenario, journal) = (path("a.toml"), path("run.journal"));
    let args = ["run", &scenario, "--link", "sim", "--set", UNTIL, "--journal", &journal, "--quiet"];
    assert!(run(&args).err.is_empty());
    fs::remove_file(path("a.toml")).unwrap();
    let ran = run(&["replay", &journal, "--quiet"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
}

/// A scenario with a shape from a file.
const SHAPED: &str = "version = 1
[swarm]
start = { box = { min = [0, 0, 0], max = [3, 3, 0] } }
[[goal]]
shape = { file = { path = \"NAME\" } }
";

#[test]
fn files_that_are_not_text_and_scenarios_in_json_are_packed() {
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name).display().to_string();
    let arch = fs::read_to_string(scenario("../shapes/arch.stl")).unwrap();
    fs::write(path("shape.stl"), arch.replace('\n', "\r\n")).unwrap();
    let text = fs::read_to_string(scenario("arch.toml")).unwrap();
    let text = text.replace("../shapes/arch.stl", "shape.stl");
    fs::write(path("s.toml"), &text).unwrap();
    let as_base64 = packed(&path("s.toml"), Path::new(&path("p.toml")));
    assert!(as_base64.contains("base64 = '''\nc29saW"), "{as_base64}");
    let expected = hashes("s.toml", directory.path());
    fs::remove_file(path("shape.stl")).unwrap();
    assert_eq!(hashes("p.toml", directory.path()), expected);

    fs::write(path("shape.stl"), arch).unwrap();
    let json: toml::Value = toml::from_str(&text).unwrap();
    fs::write(path("s.json"), serde_json::to_string(&json).unwrap()).unwrap();
    packed(&path("s.json"), Path::new(&path("p.json")));
    fs::remove_file(path("shape.stl")).unwrap();
    assert_eq!(hashes("p.json", directory.path()), expected);
}

#[test]
fn what_cannot_be_packed_is_refused_by_name() {
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name).display().to_string();
    for file in ["p.json", "p"] {
        let ran = run(&["sweep", "rabbit", "--pack", &path(file)]);
        assert_eq!((ran.code, ran.err.contains("ends in .toml")), (Some(2), true), "{ran:?}");
    }
    fs::write(path("taken.toml"), "mine").unwrap();
    let ran = run(&["sweep", "rabbit", "--pack", &path("taken.toml")]);
    assert!(ran.code != Some(0) && ran.err.contains("taken.toml"), "{ran:?}");
    assert_eq!(fs::read_to_string(path("taken.toml")).unwrap(), "mine");
    for option in [&["--seeds", "0..2"][..], &["--vary", "seed=1,2"], &["--set", "seed=2"], &["--out", "x"]] {
        let ran = run(&[&["sweep", "rabbit", "--pack", &path("p.toml")], option].concat());
        assert_eq!(ran.code, Some(2), "{ran:?}");
        assert!(ran.err.contains(option[0]) && ran.err.contains("--pack"), "{ran:?}");
    }
    let mut large = fs::read(scenario("../shapes/rabbit.stl")).unwrap();
    large.extend(std::iter::repeat_n(b'\n', 16 << 20));
    fs::write(path("large.stl"), large).unwrap();
    let text = fs::read_to_string(scenario("rabbit.toml")).unwrap();
    fs::write(path("s.toml"), text.replace("../shapes/rabbit.stl", "large.stl")).unwrap();
    let ran = run(&["sweep", &path("s.toml"), "--pack", &path("p.toml")]);
    assert!(ran.code == Some(2) && ran.err.contains("large.stl"), "{ran:?}");
    assert!(!Path::new(&path("p.toml")).exists());
}

#[test]
fn wrong_files_of_a_scenario_are_refused_with_their_place() {
    let shaped = |files: &str| SHAPED.replace("NAME", "a.toml") + files;
    let both = "[[file]]\nname = \"a.toml\"\ntext = \"\"\nbase64 = \"\"\n";
    refused(&shaped(both), &["check", "{}"], &["one of `text` and `base64`", "scenario.toml:6"]);
    refused(&shaped("[[file]]\nname = \"a.toml\"\n"), &["check", "{}"], &["found neither"]);
    refused(&shaped("[[file]]\ntext = \"\"\n"), &["check", "{}"], &["[[file]] has no `name`"]);
    let wrong = "[[file]]\nname = \"a.toml\"\nbase64 = \"?\"\n";
    refused(&shaped(wrong), &["check", "{}"], &["this is not Base64", "scenario.toml:8"]);
    let one = "[[file]]\nname = \"a.toml\"\ntext = \"\"\n";
    refused(&shaped(&one.repeat(2)), &["check", "{}"], &["two [[file]] with the name `a.toml`"]);
    refused(&format!("file = 3\n{}", shaped("")), &["check", "{}"], &["expected a list"]);
    // One that the scenario does not name does no harm: an option may name it.
    let plain = "{ box = { min = [0, 0, 0], max = [3, 3, 0] } }";
    let unnamed = SHAPED.replace("{ file = { path = \"NAME\" } }", plain);
    let ran = on(&(unnamed + one), &["check", "{}"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
}
