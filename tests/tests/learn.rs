//! `metamorph learn` as a user runs it: the same file each time, after an interruption too, and errors that help.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{command, root, run};
use metamorph_tests::json_schema::Schema;
use serde_json::{Value, json};
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

/// A study that takes a second: gaits of 5 s with one friction.
const SHORT: [&str; 6] = ["learn", "tripod4", "--trial", "5s", "--fitness", "thesis"];

fn learn(more: &[&str]) -> metamorph_tests::command::Ran {
    run(&[&SHORT, more].concat())
}

fn read(path: &Path) -> Value {
    serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap()
}

#[test]
fn a_study_is_the_same_whatever_the_threads_and_interruptions() {
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name);
    let text = |name: &str| path(name).display().to_string();
    let whole = learn(&["--trials", "13", "--jobs", "1", "--write", &text("whole")]);
    assert_eq!(whole.code, Some(0), "{whole:?}");
    for part in ["tripod4", "blf-sym", "cma", "seed 1", "best: "] {
        assert!(whole.out.contains(part), "`{part}` is missing in {}", whole.out);
    }
    // Ended in the middle of a generation, and resumed by another number of threads.
    assert_eq!(learn(&["--trials", "7", "--jobs", "2", "--write", &text("parts")]).code, Some(0));
    let resumed = learn(&["--trials", "13", "--jobs", "2", "--write", &text("parts"), "--resume"]);
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    assert_eq!(read(&path("parts")), read(&path("whole")));
    let file = read(&path("whole"));
    let trials = file["runs"][0]["trials"].as_array().unwrap();
    let fitness = |t: &Value| t["fitness_mm_s"].as_f64().unwrap();
    let best = trials.iter().map(fitness).fold(0.0, f64::max);
    assert!(trials.len() == 13 && best > 1.0, "{best} mm/s");
    assert_eq!(fitness(&file["best"]), best);
    let schema: Value = serde_json::from_str(&run(&["schema", "gait"]).out).unwrap();
    Schema::new(&schema).accepts(&file, "the gait");
    // The gait of the file is worth what it says, and is where learning with a dead module begins.
    let again = learn(&["--trials", "1", "--from", &text("whole")]);
    let speed = format!("{best:.1}");
    assert!(again.out.contains("the gait of --from: ") && again.out.contains(&speed[..3]), "{again:?}");
    let dead = learn(&["--trials", "1", "--dead", "0", "--from", &text("whole"), "--json", "-"]);
    let dead: Value = serde_json::from_str(&dead.out).unwrap();
    let joints: Vec<u64> =
        dead["best"]["joints"].as_array().unwrap().iter().map(|j| j["joint"].as_u64().unwrap()).collect();
    assert_eq!(joints, [3, 6, 9], "hips move into the limbs");
}

/// A learner that is killed in the middle of a trial goes on with that trial, and asks for what an undisturbed one asks for.
#[allow(clippy::disallowed_methods, reason = "waits for the file of another process, with a watchdog")]
#[test]
fn a_killed_learner_goes_on_with_the_trial() {
    let directory = tempfile::tempdir().unwrap();
    let text = |name: &str| directory.path().join(name).display().to_string();
    let args = ["--trials", "24", "--seeds", "3..4", "--jobs", "1", "--write"];
    let killed = text("killed");
    let mut child = command(&[&SHORT, &args[..], &[&killed]].concat()).spawn().unwrap();
    let watchdog = Instant::now() + Duration::from_secs(120);
    // The file is written after every round; then the next one is under way.
    while fs::read_to_string(&killed).is_err() && child.try_wait().unwrap().is_none() {
        assert!(Instant::now() < watchdog, "no round of trials ended");
        std::thread::sleep(Duration::from_millis(2));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    let trials = |name: &str| read(Path::new(name))["runs"][0]["trials"].as_array().unwrap().len();
    let done = trials(&killed);
    assert!((1..24).contains(&done), "{done} trials were done when it was killed");
    let resumed = learn(&[&args[..], &[&killed, "--resume"]].concat());
    assert_eq!(resumed.code, Some(0), "{resumed:?}");
    let whole = text("whole");
    assert_eq!(learn(&[&args[..], &[&whole]].concat()).code, Some(0));
    assert_eq!(read(Path::new(&killed)), read(Path::new(&whole)));
}

/// A gait is learnt for a direction, and for structures with a ring.
#[test]
fn directions_and_rings_are_learnt() {
    let learnt = |args: &[&str]| -> Value {
        let ran = run(&[args, &["--trials", "3", "--trial", "5s", "--json", "-"]].concat());
        assert_eq!(ran.code, Some(0), "{ran:?}");
        serde_json::from_str(&ran.out).unwrap()
    };
    let thesis = ["learn", "tripod4", "--fitness", "thesis"];
    let along = |heading: &str| {
        let file = learnt(&[&thesis[..], &["--heading", heading]].concat());
        file["runs"][0]["trials"][0]["fitness_mm_s"].as_f64().unwrap()
    };
    let (there, back) = (along("30deg"), along("-150deg"));
    assert!(there != 0.0 && (there + back).abs() < 1e-6, "{there} {back}");
    let ring = root().join("deploy/structures/struct10.json").display().to_string();
    let file = learnt(&["learn", &ring, "--fitness", "thesis"]);
    let trials = file["runs"][0]["trials"].as_array().unwrap();
    assert!(trials.iter().all(|t| t["broken"] == json!(false)), "{trials:?}");
}

#[test]
fn what_cannot_be_learnt_is_refused_with_a_fix() {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("gait.json").display().to_string();
    assert_eq!(learn(&["--trials", "1", "--write", &file]).code, Some(0));
    let mut other = read(Path::new(&file));
    other["version"] = json!(2);
    let newer = directory.path().join("newer.json").display().to_string();
    fs::write(&newer, other.to_string()).unwrap();
    for (args, code, parts) in [
        (vec!["learn", "nothing"], 2, vec!["nothing", "fix:"]),
        (vec!["learn", "struct10"], 2, vec!["struct10", "ring", "fix:"]),
        (vec!["learn", "quad5-sym", "--dead", "0,1,2,3,4"], 3, vec!["no joint moves"]),
        (vec!["learn", "quad5-sym", "--dead", "5"], 2, vec!["--dead 5", "fix:"]),
        (vec!["learn", "quad5-sym", "--trial", "4s"], 2, vec!["--trial", "5s", "fix:"]),
        (vec!["learn", "quad5-sym", "--trial", "5"], 2, vec!["--trial", "unit", "fix:"]),
        (vec!["learn", "quad5-sym", "--trials", "0"], 2, vec!["--trials", "fix:"]),
        (vec!["learn", "quad5-sym", "--heading", "45"], 2, vec!["--heading", "45deg", "fix:"]),
        (vec!["learn", "quad5-sym", "--seeds", "3..3"], 2, vec!["--seeds"]),
        (vec!["learn", "quad5-sym", "--down", "up"], 2, vec!["--down", "`up`", "fix:"]),
        (vec!["learn", "quad5-sym", "--from", &file], 2, vec!["--from", "fingerprint", "fix:"]),
        (vec!["learn", "tripod4", "--from", &file, "--method", "pso"], 2, vec!["--from", "pso", "fix:"]),
        (vec!["learn", "tripod4", "--from", &newer], 2, vec!["version 2", "metamorph schema gait"]),
        (vec!["learn", "tripod4", "--resume"], 2, vec!["--write"]),
        (
            vec!["learn", "tripod4", "--write", &file, "--resume"],
            2,
            vec!["--fitness", "robust", "thesis", "fix:"],
        ),
    ] {
        let ran = run(&args);
        assert_eq!(ran.code, Some(code), "{args:?}: {ran:?}");
        for part in parts {
            assert!(ran.err.contains(part), "{args:?}: `{part}` is missing in {}", ran.err);
        }
    }
}
