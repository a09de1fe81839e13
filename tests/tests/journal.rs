//! Journals: a run can be replayed to the same states and counts, on either link and with all faults;
//! differences are found and named.
#![allow(clippy::print_stdout, reason = "shown only on failure or with --nocapture")]

use metamorph_module_agent::journal_file::{Head, Reader, VERSION, Writer};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::record::Sink;
use metamorph_protocol::rng::Rng;
use metamorph_tests::command::{Ran, metamorph, run, run_processes, scenario};
use metamorph_tests::journal_file::half;
use metamorph_world_controller::console::format::digits;
use metamorph_world_controller::family::replay;
use metamorph_world_controller::record::journal::{Consumed, Event, Journal, Record, Who, parts_of};
use metamorph_world_controller::run::replay::{Replayed, Request, text};
use std::path::Path;

/// Runs a scenario that ships with the program, with a journal.
fn record(name: &str, link: &str, options: &[&str], journal: &Path) -> Ran {
    let (path, file) = (scenario(name).display().to_string(), journal.display().to_string());
    let fixed = ["run", path.as_str(), "--link", link, "--json", "-", "--journal", file.as_str()];
    let args = [&fixed, options].concat();
    let ran = if link == "ipc" { run_processes(&args) } else { run(&args) };
    println!("{options:?} {}", ran.err);
    assert!(!parts_of(journal).exists(), "the parts are joined");
    ran
}

fn again(journal: &Path) -> Replayed {
    let request = Request { file: journal.to_owned(), until: None, agent: None };
    let (plan, replayed) = replay(&request).expect("the journal can be read");
    println!("{}", text(&plan, &replayed));
    replayed
}

fn report(ran: &Ran) -> serde_json::Value {
    serde_json::from_str(&ran.out).unwrap_or_else(|e| panic!("{e}: {ran:?}"))
}

/// Asserts that a replay has the states and counts of the run, with no part left out.
fn assert_same(ran: &Ran, replayed: &Replayed) {
    let report = report(ran);
    assert!(!report["notes"].to_string().contains("missing from the journal"), "{report}");
    assert_eq!(replayed.ended.as_deref(), report["outcome"].as_str());
    let (sent, counted) = (replayed.tally.total().sent, report["messages"]["total"].as_u64());
    println!("{sent} messages sent, counted in the run: {counted:?}");
    // A killed agent may have recorded a step that it had not counted yet.
    assert!(counted.is_some_and(|counted| sent >= counted && sent <= counted + 50));
    assert_eq!(replayed.difference, None);
    assert_eq!((replayed.troubles.as_slice(), replayed.done.unchecked), (&[] as &[String], 0));
    assert_eq!(report["world_hash"].as_str(), Some(digits(replayed.hashes.1).as_str()));
    assert!(replayed.done.steps > 100 && replayed.tally.total().delivered > 100);
}

#[test]
fn a_simulated_run_is_the_same_with_a_journal_and_in_its_replay() {
    let dir = tempfile::tempdir().expect("a directory");
    for (name, options) in [
        ("swarm.toml", &["--pause", "3@2s..6s", "--restart", "9@4s", "--loss", "2%", "--dup", "2%"][..]),
        ("chair-hardware.toml", &["--seed", "3"]),
    ] {
        let journal = dir.path().join(name);
        let with = record(name, "sim", options, &journal);
        let path = scenario(name).display().to_string();
        let fixed = ["run", path.as_str(), "--link", "sim", "--json", "-"];
        let without = run(&[&fixed, options].concat());
        for hash in ["trace_hash", "state_hash", "agents_hash", "world_hash"] {
            assert!(report(&with)[hash].is_string());
            assert_eq!(report(&with)[hash], report(&without)[hash], "{hash}");
        }
        let replayed = again(&journal);
        assert_same(&with, &replayed);
        assert_eq!(report(&with)["agents_hash"].as_str(), replayed.hashes.0.map(digits).as_deref());
    }
}

/// Returns faults of all kinds that processes have, at times drawn from the seed.
fn broken(seed: u64) -> Vec<String> {
    let mut random = Rng::named(seed, "journal faults", 0);
    let mut ms = |least: u64, span: u64| least + random.below(span);
    let (kill, pause, restart) = (ms(1_000, 9_000), ms(1_000, 9_000), ms(1_000, 9_000));
    let until = pause + ms(500, 8_000);
    let words = [
        "--seed".to_owned(),
        seed.to_string(),
        "--time-scale".to_owned(),
        "40".to_owned(),
        "--kill".to_owned(),
        format!("{}@{kill}ms", 35 + seed % 6),
        "--pause".to_owned(),
        format!("{}@{pause}ms..{until}ms", 14 + seed % 7),
        "--restart".to_owned(),
        format!("{}@{restart}ms", 28 + seed % 7),
        "--loss".to_owned(),
        format!("{}%", seed % 3),
    ];
    words.to_vec()
}

fn record_and_replay(seed: u64) {
    let dir = tempfile::tempdir().expect("a directory");
    let journal = dir.path().join("journal");
    let options = broken(seed);
    let options: Vec<&str> = options.iter().map(String::as_str).collect();
    let ran = record("swarm.toml", "ipc", &options, &journal);
    assert_same(&ran, &again(&journal));
}

#[test]
fn runs_of_processes_with_kills_and_pauses_replay() {
    (1..=2).for_each(record_and_replay);
}

#[test]
fn a_run_of_metamodule_processes_replays() {
    let dir = tempfile::tempdir().expect("a directory");
    let journal = dir.path().join("journal");
    let ran = record("chair-hardware.toml", "ipc", &["--time-scale", "50", "--seed", "18"], &journal);
    assert_same(&ran, &again(&journal));
}

/// `cargo test -p metamorph-tests a_hundred_runs_of_processes -- --ignored --nocapture`
#[test]
#[ignore = "minutes: a hundred runs of 42 processes"]
fn a_hundred_runs_of_processes_replay() {
    let mut same = 0;
    for seed in 1_000..1_100 {
        record_and_replay(seed);
        same += 1;
        println!("{same} runs of 42 processes, with a kill, a pause and a restart, replayed the same");
    }
}

fn read(path: &Path) -> (Head, Vec<Record>) {
    let mut reader = Reader::open(path).expect("a journal");
    (reader.head().clone(), reader.by_ref().map(|r| r.expect("it is sound")).collect())
}

fn write(path: &Path, head: &Head, records: &[Record]) {
    let mut writer = Writer::create(path, head).expect("a file");
    records.iter().for_each(|r| writer.put(r));
}

/// A false record in a journal is found, at that record.
#[test]
fn a_changed_journal_is_found_out() {
    let dir = tempfile::tempdir().expect("a directory");
    let (journal, changed) = (dir.path().join("journal"), dir.path().join("changed"));
    record("swarm.toml", "sim", &["--kill", "12@2s"], &journal);
    let (head, records) = read(&journal);
    let victim = Who::Agent(ModuleId(7), Default::default());
    let find = |what: &dyn Fn(&Event) -> bool| {
        let fits = |r: &Record| (r.who == victim || r.who == Who::Controller) && what(&r.event);
        records.len() / 4 + records[records.len() / 4..].iter().position(fits).expect("there is one")
    };
    let heard = |e: &Event| matches!(e, Event::Step(s) if matches!(s.input, Consumed::Message { .. }));
    let at = |i: usize, edit: &dyn Fn(&mut Event)| {
        let mut records = records.clone();
        edit(&mut records[i].event);
        write(&changed, &head, &records);
        again(&changed).difference.expect("it is found")
    };
    // Another state.
    let i = find(&heard);
    let found = at(i, &|e| {
        if let Event::Step(step) = e {
            step.digest ^= 1;
        }
    });
    assert_eq!((found.number, found.who), (i as u64 + 1, victim));
    assert!(found.what.contains("state"), "{found:?}");
    // A message that was never sent.
    let found = at(i, &|e| {
        if let Event::Step(step) = e
            && let Consumed::Message { name, .. } = &mut step.input
        {
            name.number += 100_000;
        }
    });
    assert_eq!((found.number, found.who), (i as u64 + 1, victim));
    assert!(found.what.contains("had not sent"), "{found:?}");
    // A message with another content.
    let found = at(i, &|e| {
        if let Event::Step(step) = e
            && let Consumed::Message { message, .. } = &mut step.input
        {
            message.bytes[0] ^= 1;
        }
    });
    assert_eq!((found.number, found.who), (i as u64 + 1, victim));
    // A body at another place.
    let i = find(&|e| matches!(e, Event::Advance { ended } if !ended.is_empty()));
    let found = at(i, &|e| {
        if let Event::Advance { ended } = e {
            ended[0].1.bytes[0] ^= 1;
        }
    });
    assert_eq!((found.number, found.who), (i as u64 + 1, Who::Controller));
    // A step that is missing.
    let i = find(&heard);
    let mut fewer = records.clone();
    fewer.remove(i);
    write(&changed, &head, &fewer);
    let found = again(&changed).difference.expect("it is found");
    assert!(found.number > i as u64, "{found:?}");
    // Another outcome.
    let i = find(&|e| matches!(e, Event::Ended { .. }));
    let found = at(i, &|e| {
        if let Event::Ended { outcome, .. } = e {
            *outcome = "deadlock".to_owned();
        }
    });
    assert!(found.what.contains("ended deadlock, and now it ends built"), "{found:?}");
}

/// As a user sees it: exit codes, the cut, the refusal by name, and the history of one agent.
#[test]
fn the_command_reports_its_findings() {
    let dir = tempfile::tempdir().expect("a directory");
    let journal = dir.path().join("journal");
    record("swarm.toml", "sim", &[], &journal);
    let file = journal.display().to_string();
    let whole = run(&["replay", &file]);
    assert_eq!(whole.code, Some(0), "{whole:?}");
    assert!(whole.out.contains("identical states and counts; the run ended built"), "{whole:?}");
    let agent = run(&["replay", &file, "--agent", "7", "--until", "5s"]);
    assert!(
        agent.out.contains("starts as incarnation 0 at [") && agent.out.contains("hears from "),
        "{agent:?}"
    );
    // For people: no line of it is the inside of a program.
    let inside = |line: &&str| [" {", "Some(", "Ok(", "ModuleId", "::"].iter().any(|i| line.contains(i));
    assert_eq!(agent.out.lines().filter(inside).collect::<Vec<_>>(), Vec::<&str>::new());
    let state = run(&["replay", &file, "--until", "5s"]);
    assert!(state.out.contains("module 41 at") && state.out.contains("dead"), "{state:?}");
    let unknown = run(&["replay", &file, "--agent", "42"]);
    assert!(unknown.code == Some(2) && unknown.err.contains("modules 0 to 41"), "{unknown:?}");

    let bytes = std::fs::read(&journal).expect("it is there");
    std::fs::write(&journal, half(&bytes)).expect("it can be written");
    let cut = run(&["replay", &file]);
    assert_eq!(cut.code, Some(0), "{cut:?}");
    assert!(cut.out.contains("cut off") && cut.out.contains("up to the end of the journal"), "{cut:?}");
    let mut other = bytes;
    other[8] += 1;
    std::fs::write(&journal, other).expect("it can be written");
    let old = run(&["replay", &file]);
    assert!(old.code == Some(2) && old.err.contains(&format!("version {VERSION}")), "{old:?}");
    let none = run(&["replay", "no-such-file"]);
    assert!(none.code == Some(2) && none.err.contains("no-such-file"), "{none:?}");
}

/// A viewer finds all that it needs: the scenario, the places of bodies, the states of agents, the faults.
#[test]
fn a_journal_contains_all_that_a_viewer_needs() {
    let dir = tempfile::tempdir().expect("a directory");
    let journal = dir.path().join("journal");
    record("swarm.toml", "sim", &["--kill", "3@2s"], &journal);
    let journal = Journal::open(&journal).expect("it can be read");
    assert_eq!((journal.head().family.as_str(), journal.head().modules), ("cube", 42));
    assert!(journal.head().scenario.contains("[swarm]"));
    let records: Vec<Record> = journal.map(|r| r.expect("it is sound")).collect();
    let count = |what: &dyn Fn(&Event) -> bool| records.iter().filter(|r| what(&r.event)).count();
    assert_eq!(count(&|e| matches!(e, Event::Start { .. })), 42);
    assert!(count(&|e| matches!(e, Event::Advance { ended } if !ended.is_empty())) > 10);
    assert_eq!(count(&|e| matches!(e, Event::Injected { fault, .. } if fault == "kill 3")), 1);
    let finals = count(&|e| matches!(e, Event::State(s) if s.role == "final" && s.level == Some(0)));
    assert!(finals > 10);
    assert!(count(&|e| matches!(e, Event::State(s) if s.gradient.is_some())) > 10);
    assert!(count(&|e| matches!(e, Event::State(s) if s.lock.is_some())) > 0);
    assert!(records.is_sorted_by_key(|r| r.at), "records are in the order of time");
    assert!(matches!(records.last().map(|r| &r.event), Some(Event::Ended { .. })));
}

/// A journal that ends early says so to all that read it, wherever it was cut off.
#[test]
fn a_journal_without_its_end_says_so() {
    let dir = tempfile::tempdir().expect("a directory");
    let journal = dir.path().join("journal");
    record("swarm.toml", "sim", &["--kill", "3@2s"], &journal);
    let (head, records) = read(&journal);
    let cut = dir.path().join("cut");
    write(&cut, &head, &records[..records.len() / 2]);
    let (cut, svg) = (cut.display().to_string(), dir.path().join("a.svg").display().to_string());
    let (mcap, sdf) =
        (dir.path().join("a.mcap").display().to_string(), dir.path().join("a.sdf").display().to_string());
    for args in [
        vec!["replay", &cut],
        vec!["export", &cut, "--mcap", &mcap],
        vec!["export", &cut, "--sdf", &sdf],
        vec!["render", &cut, "--at", "end", "--out", &svg],
    ] {
        let ran = run(&args);
        assert!(format!("{}{}", ran.out, ran.err).contains("the journal has no end"), "{args:?}: {ran:?}");
    }
    assert_eq!(again(&journal).troubles, Vec::<String>::new());
}

/// A journal that could not be written whole is an error, and the report says why.
#[test]
fn a_journal_that_is_not_whole_is_an_error() {
    let dir = tempfile::tempdir().expect("a directory");
    for link in ["sim", "ipc"] {
        let (journal, report) = (dir.path().join(link), dir.path().join(format!("{link}.json")));
        let script = format!(
            "ulimit -f 200; exec {} run {} --link {link} --time-scale 40 --quiet --journal {} --json {}",
            metamorph().display(),
            scenario("swarm.toml").display(),
            journal.display(),
            report.display()
        );
        let ran = std::process::Command::new("bash").args(["-c", &script]).output().expect("a shell");
        let said = String::from_utf8_lossy(&ran.stderr);
        if link == "ipc" && said.contains("ulimit -f") && !report.exists() {
            // Shared memory counts as files, so the limit may refuse the run before it begins.
            assert_ne!(ran.status.code(), Some(0), "{said}");
            continue;
        }
        assert_eq!(ran.status.code(), Some(1), "{link}: {said}");
        assert!(said.contains("--journal") && said.contains("missing from the journal"), "{link}: {said}");
        let report: serde_json::Value =
            serde_json::from_slice(&std::fs::read(report).expect("a report")).expect("JSON");
        assert_eq!(report["outcome"], "built", "{link}");
        assert!(report["incomplete_journal"].is_string(), "{link}");
    }
}
