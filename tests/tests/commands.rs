//! Commands to a run in progress: who may give them, their effect, and that a run with them can be repeated, replayed and
//! resumed.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]
#![allow(clippy::print_stdout, reason = "shown only on failure or with --nocapture")]

use metamorph_module_agent::journal_file;
use metamorph_protocol::rng::Rng;
use metamorph_tests::chaos::{signal_to, wait_until};
use metamorph_tests::command::{report, run, run_processes, scenario};
use metamorph_tests::view::View;
use metamorph_world_controller::record::journal::parts_of;
use metamorph_world_controller::report::schema::Report;
use metamorph_world_controller::swarm::clean;
use rustix::process::Signal;
use serde_json::{Value, json};
use std::fs;
use std::io::Read;
use std::path::Path;
use std::time::Duration;

fn body(session: &str, n: u64, commands: &[&str]) -> String {
    json!({ "version": 1, "session": session, "n": n, "commands": commands }).to_string()
}

/// A run of a scenario with a page that can control it, with its journal and report in a directory.
fn start(directory: &Path, name: &str, link: &str, options: &[&str]) -> View {
    let file = scenario(name).display().to_string();
    let path = |name: &str| directory.join(name).display().to_string();
    let fixed = ["run", &file, "--link", link, "--view", "--control", "--quiet"];
    let (journal, json) = (path("journal"), path("report.json"));
    let files = ["--journal", journal.as_str(), "--json", json.as_str()];
    View::start(&[&fixed[..], &files, options].concat())
}

/// Returns the report of a run, once it is over.
fn ended(directory: &Path) -> Report {
    let file = directory.join("report.json");
    let mut found = None;
    wait_until("the report", || {
        found = fs::read_to_string(&file).ok().filter(|text| serde_json::from_str::<Value>(text).is_ok());
        found.is_some()
    });
    report(&found.unwrap())
}

/// Returns the faults that were commands, as text.
fn commanded(report: &Report) -> Vec<String> {
    let commands = report.faults.iter().filter(|f| f.by == "operator 1");
    commands.map(|f| f.module.map_or(f.fault.clone(), |id| format!("{} {id}", f.fault))).collect()
}

#[test]
fn a_simulated_run_with_commands_is_exported_as_a_scenario() {
    let directory = tempfile::tempdir().unwrap();
    let view = start(directory.path(), "swarm.toml", "sim", &[]);
    let (status, answer) = view.post(&body("a", 1, &["kill 3", "pause 5"]));
    assert_eq!(
        (status, &answer["result"], &answer["operator"]),
        (200, &json!("taken"), &json!(1)),
        "{answer}"
    );
    // The same number is the same request: it gets the same answer and has no effect.
    assert_eq!(view.post(&body("a", 1, &["kill 9"])), (200, answer.clone()));
    let (status, again) = view.post(&body("a", 2, &["resume 5"]));
    assert_eq!(status, 200, "{again}");
    assert!(again["at_s"].as_f64() > answer["at_s"].as_f64());
    // All of a request or nothing of it.
    let (status, refused) = view.post(&body("a", 3, &["kill 4", "resume 6"]));
    assert_eq!((status, refused["why"].as_str()), (200, Some("module 6 is not paused")));
    let commands = ended(directory.path());
    assert_eq!(commanded(&commands), ["kill 3", "pause 5", "resume 5"]);
    assert_eq!(view.post(&body("a", 4, &["kill 4"])).0, 410, "the run is over");
    assert_eq!(view.end(), Some(0));

    let (journal, file) = (directory.path().join("journal"), directory.path().join("session.toml"));
    let (journal, file) = (journal.display().to_string(), file.display().to_string());
    let exported = run(&["export", &journal, "--commands", &file]);
    assert_eq!(exported.code, Some(0), "{exported:?}");
    assert!(exported.out.contains("3 commands"), "{exported:?}");
    let repeated = run(&["run", &file, "--link", "sim", "--json", "-"]);
    let repeated = report(&repeated.out);
    assert_eq!(repeated.trace_hash, commands.trace_hash);
    assert_eq!(repeated.state_hash, commands.state_hash);
    assert_eq!(commanded(&repeated), commanded(&commands));
    let replayed = run(&["replay", &journal]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
}

/// Runs the scenario that a journal's commands make, and replays the journal. Returns both reports.
fn repeated(directory: &Path, first: &Report) -> Report {
    let (journal, file) = (directory.join("journal"), directory.join("session.toml"));
    let (journal, file) = (journal.display().to_string(), file.display().to_string());
    let exported = run(&["export", &journal, "--commands", &file]);
    assert_eq!(exported.code, Some(0), "{exported:?}");
    let again = report(&run(&["run", &file, "--link", "sim", "--json", "-"]).out);
    assert_eq!((&again.trace_hash, &again.state_hash), (&first.trace_hash, &first.state_hash));
    let replayed = run(&["replay", &journal]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
    again
}

#[test]
fn links_are_changed_and_cubes_are_steered() {
    let directory = tempfile::tempdir().unwrap();
    let view = start(directory.path(), "swarm.toml", "sim", &[]);
    let first = ["loss 100% for 20s", "partition 3..5 for 30s", "hold 7 for 9s", "goto 9 [0, 0, 5] for 5s"];
    let (status, answer) = view.post(&body("a", 1, &first));
    assert_eq!((status, &answer["result"]), (200, &json!("taken")), "{answer}");
    for (n, (command, why)) in [
        ("partition 3..4000", "there is no module 4000"),
        ("partition 5..3", "`partition 5..3` is no command"),
        ("loss 101%", "`loss 101%` is no command"),
        ("take 7 0", "family: "),
        ("swap 7 8", "family: "),
        ("tune strategy=step", "is no fault"),
    ]
    .into_iter()
    .enumerate()
    {
        let (_, refused) = view.post(&body("a", 2 + n as u64, &[command]));
        assert!(refused["why"].as_str().is_some_and(|text| text.contains(why)), "{command}: {refused}");
    }
    let report = ended(directory.path());
    // What ends by itself is told as well.
    assert_eq!(commanded(&report), ["loss", "partition", "hold 7", "goto 9", "loss", "partition"]);
    assert_eq!((report.outcome.as_str(), report.invariants.broken), ("built", 0));
    assert!(report.messages.all.lost > 0, "{:?}", report.messages);
    assert_eq!(view.end(), Some(0));
    assert_eq!(commanded(&repeated(directory.path(), &report)), commanded(&report));
}

#[test]
fn processes_obey_commands() {
    let directory = tempfile::tempdir().unwrap();
    let view = start(directory.path(), "swarm.toml", "ipc", &[]);
    let (status, answer) =
        view.post(&body("a", 1, &["kill 3", "stick 7", "loss 30% for 3s", "hold 8 for 2s"]));
    assert!(status == 200 || status == 202, "{answer}");
    let report = ended(directory.path());
    assert_eq!(commanded(&report)[..4], ["kill 3", "stick 7", "loss", "hold 8"]);
    assert_eq!((report.outcome.as_str(), report.agents.crashed), ("built", 2), "{report:?}");
    assert!(report.messages.all.lost > 0, "{:?}", report.messages);
    assert_eq!(view.end(), Some(0));
    let journal = directory.path().join("journal").display().to_string();
    let replayed = run_processes(&["replay", &journal]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
}

#[test]
fn a_resumed_run_has_had_its_commands() {
    let directory = tempfile::tempdir().unwrap();
    let mut view = start(directory.path(), "swarm.toml", "ipc", &["--patience", "60s"]);
    let mut answer = (0, Value::Null);
    wait_until("the command to be taken", || {
        answer = view.post(&body("a", 1, &["kill 3", "partition 5 for 600s"]));
        answer.0 == 200
    });
    let (_, restart) = view.post(&body("a", 2, &["partition off", "loss 50% for 5s", "restart 3"]));
    assert_eq!(restart["result"], "taken", "{restart}");
    // Acknowledged, so it is in the journal.
    signal_to(view.process.id() as i32, Signal::KILL);
    view.process.wait().unwrap();
    let journal = directory.path().join("journal").display().to_string();
    let resumed = run_processes(&["resume", &journal, "--json", "-", "--quiet"]);
    let _ = clean();
    let given = ["kill 3", "partition", "partition", "loss", "restart 3"];
    assert_eq!(commanded(&report(&resumed.out))[..5], given, "{resumed:?}");
    let replayed = run(&["replay", &journal]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
}

/// Draws commands that follow each other; some will be refused.
fn drawn(rng: &mut Rng, modules: u64, is_metamodule: bool) -> Vec<String> {
    let (id, other, lease) = (rng.below(modules), rng.below(modules), 1 + rng.below(20));
    let place = format!("[{}, {}, 0]", rng.below(13), rng.below(13));
    let one = match rng.below(if is_metamodule { 18 } else { 11 }) {
        0 => format!("kill {id}"),
        1 => format!("restart {id}"),
        2 => format!("stick {id}"),
        3 => format!("unstick {id}"),
        // What is paused for ever keeps a run from its end.
        4 => return vec![format!("pause {id}"), format!("resume {id}")],
        5 => format!("loss {}% for {lease}s", 10 * rng.below(11)),
        6 => format!("partition {}..{} for {lease}s", id.min(other), id.max(other)),
        7 => ["loss off", "partition off"][rng.below(2) as usize].to_owned(),
        8 => format!("goto {id} {place} for {lease}s"),
        9 => format!("hold {id} for {lease}s"),
        10 => format!("release {id}"),
        11 => format!("take {id} {} for {lease}s", rng.below(4)),
        12 => format!("swap {id} {other}"),
        13 => format!("goal.move [{}, {}]", rng.below(3), rng.below(3)),
        14 => "goal.set 1".to_owned(),
        15 => format!("goal.turn {}", rng.below(4)),
        16 => format!("goal.order {}", ["circular", "crosswise", "at-once"][rng.below(3) as usize]),
        _ => format!("{} {place}", ["block", "unblock"][rng.below(2) as usize]),
    };
    vec![one]
}

/// Returns the commands in a journal, in their order.
fn in_journal(directory: &Path) -> Vec<String> {
    let (journal, file) = (directory.join("journal"), directory.join("session.toml"));
    let exported =
        run(&["export", &journal.display().to_string(), "--commands", &file.display().to_string()]);
    assert_eq!(exported.code, Some(0), "{exported:?}");
    let text = fs::read_to_string(file).unwrap();
    let lists = text.lines().filter_map(|line| line.strip_prefix("do = [\"")?.strip_suffix("\"]"));
    lists.flat_map(|list| list.split("\", \"")).map(str::to_owned).collect()
}

/// Gives drawn commands to a run of processes, kills its controller at a drawn moment, which may come before an answer,
/// resumes it, and replays its journal. Returns false if the run was over before.
fn killed_and_resumed(seed: u64) -> bool {
    let mut rng = Rng::named(seed, "killed session", 0);
    let is_metamodule = seed % 2 == 1;
    let (file, scale, modules) = if is_metamodule { ("box.toml", "20", 4) } else { ("swarm.toml", "8", 42) };
    let directory = tempfile::tempdir().unwrap();
    let number = seed.to_string();
    let options = ["--patience", "60s", "--time-scale", scale, "--seed", &number];
    let mut view = start(directory.path(), file, "ipc", &options);
    let journal = directory.path().join("journal");
    let is_over = || directory.path().join("report.json").exists();
    let recorded = || {
        let controller = parts_of(&journal).join("controller");
        journal_file::Reader::open(&controller).map_or(0, Iterator::count)
    };
    let (mut acknowledged, mut n) = (Vec::new(), 0);
    for _ in 0..1 + rng.below(6) {
        // Some are given at once, others after a while.
        let records = recorded() + rng.below(60) as usize;
        wait_until("the run to get so far", || is_over() || recorded() >= records);
        for command in drawn(&mut rng, modules, is_metamodule) {
            n += 1;
            let mut answer = (0, Value::Null);
            wait_until("the command to be answered", || {
                answer = view.post(&body("a", n, &[&command]));
                answer.0 == 200 || answer.0 == 410
            });
            if answer.1["result"] == "taken" {
                acknowledged.push(command);
            }
        }
    }
    let unheard = (rng.below(2) == 0).then(|| format!("stick {}", rng.below(modules)));
    let mut answer = unheard.as_ref().map(|command| view.post_unheard(&body("a", n + 1, &[command])));
    if answer.is_some() {
        // From before the command is read until after it is answered.
        std::thread::park_timeout(Duration::from_micros(rng.below(60_000)));
    } else {
        let records = recorded() + rng.below(100) as usize;
        wait_until("the run to get so far", || is_over() || recorded() >= records);
    }
    if is_over() {
        return false;
    }
    signal_to(view.process.id() as i32, Signal::KILL);
    view.process.wait().unwrap();
    let mut heard = String::new();
    // The connection ends with the controller.
    let _ = answer.as_mut().map(|answer| answer.read_to_string(&mut heard));
    let resumed = run_processes(&["resume", &journal.display().to_string(), "--json", "-", "--quiet"]);
    let _ = clean();
    let report = report(&resumed.out);
    assert!(matches!(resumed.code, Some(0 | 3 | 4)), "seed {seed}: {resumed:?}");
    assert_eq!((report.invariants.broken, report.collisions.suffered), (0, 0), "seed {seed}: {report:?}");
    // What was acknowledged is in the journal, once. What was not either is, or never takes effect.
    let given = in_journal(directory.path());
    let (first, rest) = given.split_at(acknowledged.len().min(given.len()));
    assert_eq!(first, acknowledged, "seed {seed}: {resumed:?}");
    assert!(
        rest.is_empty() || Some(rest) == unheard.as_slice().into(),
        "seed {seed}: {rest:?}, sent {unheard:?}"
    );
    assert!(!heard.contains("taken") || rest.len() == 1, "seed {seed}: {heard}");
    let replayed = run(&["replay", &journal.display().to_string()]);
    assert_eq!(replayed.code, Some(0), "seed {seed}: {replayed:?}");
    println!(
        "seed {seed}: {} commands, {}, {}",
        given.len(),
        report.outcome,
        if heard.is_empty() { "killed" } else { "answered" }
    );
    true
}

#[test]
fn killed_sessions_are_resumed() {
    let killed = (1_000..).filter(|seed| killed_and_resumed(*seed)).take(2).count();
    assert_eq!(killed, 2);
}

/// `cargo test -p metamorph-tests commands::fifty -- --ignored --nocapture`
#[test]
#[ignore = "takes minutes"]
fn fifty_killed_sessions_are_resumed() {
    let killed = (0..).filter(|seed| killed_and_resumed(*seed)).take(50).count();
    assert_eq!(killed, 50);
}

/// What programs of other users and pages of other servers can send.
#[test]
fn hostile_requests_change_nothing() {
    let directory = tempfile::tempdir().unwrap();
    let view = start(directory.path(), "swarm.toml", "sim", &[]);
    let (host, root) = view.parts();
    let good = body("a", 1, &["kill 3"]);
    let path = format!("{root}command");
    let (post, all, headers) = (View::post_request, view.headers().concat(), view.hostile_headers());
    for (expected, headers) in &headers {
        let (status, answer) = view.raw(&post(&path, host, headers, &good));
        assert_eq!(status, *expected, "{headers}: {answer}");
    }
    for other in ["evil.example", "127.0.0.1", "127.0.0.1:1", "evil.example:80"] {
        assert_eq!(view.raw(&post(&path, other, &all, &good)).0, 403, "{other}");
    }
    for wrong in [
        "/command",
        "/x/command",
        &format!("{root}Command"),
        &format!("{root}command/"),
        &format!("{root}../command"),
        &root.replace('/', ""),
    ] {
        let status = view.raw(&post(wrong, host, &all, &good)).0;
        assert!(status == 404 || status == 405 || status == 400, "{wrong}: {status}");
    }
    for method in ["PUT", "DELETE", "OPTIONS", "PATCH", "GET", "HEAD"] {
        let request = post(&path, host, &all, &good).replacen("POST", method, 1);
        let status = view.raw(&request).0;
        assert!(status == 405 || status == 404, "{method}: {status}");
    }
    let deep = format!(
        "{{\"version\":1,\"session\":{}1{},\"n\":1,\"commands\":[]}}",
        "[".repeat(9_000),
        "]".repeat(9_000)
    );
    let many: Vec<&str> = vec!["kill 1"; 65];
    let bodies = [
        (400, String::new()),
        (400, "kill 3".to_owned()),
        (400, "null".to_owned()),
        (400, "[]".to_owned()),
        (400, good.replace('}', "")),
        (400, good.replace("\"n\":1", "\"n\":-1")),
        (400, good.replace("\"n\":1", "\"n\":1.5")),
        (400, good.replace("\"version\":1", "\"version\":2")),
        (400, good.replace("\"session\"", "\"sessions\"")),
        (400, good.replace("\"a\"", "\"\"")),
        (400, good.replace("\"a\"", &format!("\"{}\"", "a".repeat(65)))),
        (400, body("a", 1, &[])),
        (400, deep),
        (413, body("a", 1, &["x".repeat(70_000).as_str()])),
        (409, body("a", 7, &["kill 3"])),
        (409, body("a", 0, &["kill 3"])),
        (429, body("b", 1, &many)),
        (200, body("c", 1, &["kill 4000"])),
        (200, body("c", 2, &["launch 3"])),
        (200, body("c", 3, &["kill 3; at 0 ns by operator 0: kill 4"])),
        (200, body("c", 4, &["kill 3", "block [0, 0, 0]"])),
    ];
    for (expected, body) in &bodies {
        let (status, answer) = view.raw(&post(&path, host, &all, body));
        assert_eq!(status, *expected, "{}: {answer}", &body[..body.len().min(200)]);
        assert!(answer.contains("\"refused\""), "{answer}");
    }
    let invalid = [b"\xff\xfe".as_slice(), b"{\"version\":1,\"session\":\"\xc3\x28\"}"];
    for bytes in invalid {
        let text = post(&path, host, &all, "")
            .replace("Content-Length: 0", &format!("Content-Length: {}", bytes.len()));
        assert_eq!(view.raw_bytes(&[text.as_bytes(), bytes].concat()).0, 400);
    }
    // Session c holds the control now.
    assert_eq!(view.post(&good).0, 423);
    let report = ended(directory.path());
    assert!(report.faults.iter().all(|f| f.by == "scenario"), "{:?}", report.faults);
    assert_eq!(view.end(), Some(0));
    let file = scenario("swarm.toml").display().to_string();
    let undisturbed = run(&["run", &file, "--link", "sim", "--json", "-", "--quiet"]);
    assert_eq!(metamorph_tests::command::report(&undisturbed.out).trace_hash, report.trace_hash);
}

#[test]
fn one_page_at_a_time_has_the_control() {
    let directory = tempfile::tempdir().unwrap();
    let view = start(directory.path(), "swarm.toml", "sim", &[]);
    assert_eq!(view.post(&body("first", 1, &["stick 3"])).0, 200);
    assert_eq!(view.post(&body("second", 1, &["stick 4"])).0, 423);
    let over = body("second", 1, &["stick 4"]).replace("\"n\"", "\"take_over\":true,\"n\"");
    let (status, answer) = view.post(&over);
    assert_eq!((status, answer["operator"].as_u64()), (200, Some(2)));
    assert_eq!(view.post(&body("first", 2, &["unstick 3"])).0, 423);
}

#[test]
fn tables_of_commands_are_checked() {
    let text = fs::read_to_string(scenario("swarm.toml")).unwrap();
    let cases = [
        ("at = \"2s\"", "do"),
        ("do = [\"kill 3\"]", "at"),
        ("at = \"2s\"\ndo = []", "number of commands"),
        ("at = \"2s\"\ndo = [\"explode 3\"]", "`explode 3` is no fault"),
        ("at = \"2s\"\ndo = [\"kill 4000\"]", "module 4000"),
        ("at = \"2s\"\ndo = [\"partition 3..4000\"]", "module 4000"),
        ("at = \"2s\"\ndo = [\"loss 5% for 0s\"]", "`loss 5% for 0s` is no command"),
        ("at = \"2s\"\ndo = \"kill 3\"", "expected a list"),
        ("at = \"2s\"\noperator = 70000\ndo = [\"kill 3\"]", "number of the operator"),
        ("at = \"1000000s\"\ndo = [\"kill 3\"]", "1000000"),
        ("at = \"2s\"\nby = 1\ndo = [\"kill 3\"]", "by"),
    ];
    for (table, part) in cases {
        metamorph_tests::command::refused(
            &format!("{text}\n[[command]]\n{table}\n"),
            &["check", "{}"],
            &[part],
        );
    }
}
