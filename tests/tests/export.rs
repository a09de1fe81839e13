//! A journal as an MCAP recording: read with an independent reader of the format, every update holds every
//! body, and the last one shows the final positions.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{Ran, run, run_processes, scenario};
use metamorph_tests::journal_file::half;
use metamorph_tests::json_schema::Schema;
use metamorph_world_controller::family::cube::Cubes;
use metamorph_world_controller::family::read_file;
use metamorph_world_controller::report::schema::Report;
use metamorph_world_controller::scenario::{LinkKind, Overrides};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// One update: its time, and its entities by name.
struct Update {
    at: u64,
    entities: BTreeMap<String, Value>,
}

impl Update {
    fn cells(&self) -> BTreeSet<[i64; 3]> {
        self.entities.values().flat_map(cubes).map(cell).collect()
    }
    fn process(&self, id: u32) -> &str {
        let entity = &self.entities[&format!("module {id}")];
        let pairs = entity["metadata"].as_array().unwrap();
        pairs.iter().find(|p| p["key"] == "process").unwrap()["value"].as_str().unwrap()
    }
    fn colour(&self, id: u32) -> &Value {
        &self.entities[&format!("module {id}")]["cubes"][0]["color"]
    }
}

fn cubes(entity: &Value) -> &Vec<Value> {
    entity["cubes"].as_array().unwrap()
}

fn cell(cube: &Value) -> [i64; 3] {
    let at = &cube["pose"]["position"];
    [&at["x"], &at["y"], &at["z"]].map(|c| c.as_f64().unwrap().floor() as i64)
}

/// Reads a recording: updates, and lines of the log. Every message is valid by the schema that comes with it.
fn read(mcap: &Path) -> (Vec<Update>, Vec<String>) {
    let bytes = fs::read(mcap).unwrap();
    let (mut updates, mut log, mut before) = (Vec::<Update>::new(), Vec::new(), 0);
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        let message = message.unwrap();
        assert!(message.log_time >= before, "times go back");
        before = message.log_time;
        let schema = message.channel.schema.as_ref().unwrap();
        let encodings = (schema.encoding.as_str(), message.channel.message_encoding.as_str());
        assert_eq!(encodings, ("jsonschema", "json"));
        let content: Value = serde_json::from_slice(&message.data).unwrap();
        let text: Value = serde_json::from_slice(&schema.data).unwrap();
        Schema::new(&text).accepts(&content, &schema.name);
        let stamp = json!({ "sec": before / 1_000_000_000, "nsec": before % 1_000_000_000 });
        match (schema.name.as_str(), message.channel.topic.as_str()) {
            ("foxglove.SceneUpdate", "/modules") => {
                let entities = content["entities"].as_array().unwrap().iter();
                let entities = entities.map(|entity| {
                    assert_eq!((&entity["timestamp"], &entity["frame_id"]), (&stamp, &json!("world")));
                    (entity["id"].as_str().unwrap().to_owned(), entity.clone())
                });
                updates.push(Update { at: before, entities: entities.collect() });
            }
            ("foxglove.Log", "/log") => {
                assert_eq!(content["timestamp"], stamp);
                log.push(content["message"].as_str().unwrap().to_owned());
            }
            other => panic!("a message of {other:?}"),
        }
    }
    (updates, log)
}

struct Exported {
    directory: TempDir,
    report: Report,
    ran: Ran,
    updates: Vec<Update>,
    log: Vec<String>,
}

/// Runs a scenario and exports a recording of it.
fn exported(name: &str, args: &[&str], options: &[&str]) -> Exported {
    let directory = tempfile::tempdir().unwrap();
    let [journal, mcap] = ["run.journal", "run.mcap"].map(|name| directory.path().join(name));
    let (journal, target) = (journal.to_str().unwrap(), mcap.to_str().unwrap());
    let path = scenario(name);
    let line = ["run", path.to_str().unwrap(), "--journal", journal, "--quiet", "--json", "-"];
    let report: Report = serde_json::from_str(&run_processes(&[&line, args].concat()).out).unwrap();
    let ran = run(&[&["export", journal, "--mcap", target], options].concat());
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let (updates, log) = read(&mcap);
    Exported { directory, report, ran, updates, log }
}

#[test]
fn a_recording_of_cubes_shows_all_cubes_and_ends_as_the_run_did() {
    for link in ["sim", "ipc"] {
        let Exported { directory, report, ran, updates, log } =
            exported("arch.toml", &["--link", link, "--kill", "23@1s"], &[]);
        assert_eq!(report.outcome, "built");
        let overrides = Overrides { link: LinkKind::Sim, ..Overrides::default() };
        let plan = read_file(&scenario("arch.toml"), &overrides).unwrap();
        let swarm = plan.swarm.of::<Cubes>().expect("cubes");
        let triple = |cell| <[i16; 3]>::from(cell).map(i64::from);

        // Every cube is in every update, and no two are in one cell.
        assert!(updates.len() > 20, "{}", updates.len());
        for update in &updates {
            assert!(update.entities.values().all(|entity| cubes(entity).len() == 1));
            assert_eq!((update.entities.len(), update.cells().len()), (24, 24), "at {} ns", update.at);
        }
        let [first, .., last] = &updates[..] else { panic!("updates") };
        assert_eq!(first.cells(), swarm.cells.iter().copied().map(triple).collect());
        let filled = last.cells();
        let missing = swarm.setup.goals[0].cells().map(triple).find(|cell| !filled.contains(cell));
        assert_eq!(missing, None, "on {link}");

        // Not more often than configured, but for the last one; never later than the run.
        assert!(updates.windows(2).rev().skip(1).all(|pair| pair[1].at - pair[0].at >= 100_000_000));
        // Agents of processes may write a little after the end.
        let end = (report.time.virtual_s * 1e9).round() as u64;
        assert!(link == "ipc" || last.at <= end, "{} after {end}", last.at);

        // The killed one is dead from then on, and drawn unlike all others.
        let second = 1_000_000_000;
        let death = updates.iter().position(|u| u.process(23) == "dead").unwrap();
        assert!(updates[death].at >= second && updates[death - 1].at < 2 * second);
        assert!(updates[..death].iter().all(|u| u.process(23) == "alive"));
        assert!(updates[death..].iter().all(|u| u.process(23) == "dead"));
        assert!((0..23).all(|id| last.process(id) == "alive" && last.colour(id) != last.colour(23)));
        assert!(log[0].contains("kill 23") && log.last().unwrap().contains("built"), "{log:?}");
        assert!(ran.out.contains("24 modules in ") && !ran.out.contains("note: "), "{ran:?}");

        let [journal, mcap] = ["run.journal", "run.mcap"].map(|f| directory.path().join(f));
        let (before, args) =
            (fs::read(&mcap).unwrap(), [journal.to_str().unwrap(), "--mcap", mcap.to_str().unwrap()]);
        let again = run(&[&["export"], &args[..]].concat());
        assert!(again.code == Some(2) && again.err.contains("fix: "), "{again:?}");
        assert_eq!(fs::read(&mcap).unwrap(), before, "a file was written over");
    }
}

#[test]
fn metamodules_have_four_cubes_each() {
    let Exported { report, updates, .. } = exported("box.toml", &["--link", "sim"], &["--every", "1000"]);
    for update in &updates {
        let each: Vec<usize> = update.entities.values().map(|entity| cubes(entity).len()).collect();
        assert_eq!(each, [4; 4]);
    }
    // While a joint turns a body may pass through cells of another; when all rest, none does.
    assert_eq!(updates.last().unwrap().cells().len(), 16, "{}", report.outcome);
    assert!(updates.windows(2).rev().skip(1).all(|pair| pair[1].at - pair[0].at >= 1_000_000_000));
}

#[test]
fn a_cut_journal_is_exported_as_far_as_it_goes() {
    let Exported { directory, updates, .. } = exported("arch.toml", &["--link", "sim"], &[]);
    let [journal, cut, mcap] = ["run.journal", "cut.journal", "cut.mcap"].map(|f| directory.path().join(f));
    let whole = fs::read(&journal).unwrap();
    fs::write(&cut, half(&whole)).unwrap();
    let ran = run(&["export", cut.to_str().unwrap(), "--mcap", mcap.to_str().unwrap()]);
    assert!(ran.code == Some(0) && ran.out.contains("note: "), "{ran:?}");
    let (seen, log) = read(&mcap);
    assert!(seen.len() > 5 && seen.len() < updates.len());
    for (one, other) in seen.iter().zip(&updates).take(seen.len() - 1) {
        assert!(one.at == other.at && one.entities == other.entities, "at {} ns", one.at);
    }
    assert!(ran.out.contains(log.last().unwrap()), "{log:?}");
}

#[test]
fn other_files_and_old_journals_are_refused_and_no_file_is_written() {
    let Exported { directory, .. } = exported("arch.toml", &["--link", "sim"], &[]);
    let [journal, out] = ["run.journal", "out.mcap"].map(|f| directory.path().join(f));
    let (path, target) = (journal.to_str().unwrap(), out.to_str().unwrap());
    let whole = fs::read(&journal).unwrap();
    // The version follows the eight bytes that identify a journal.
    let old = [&whole[..8], &[0, 0], &whole[10..]].concat();
    for (content, part) in [
        (&b"this is not a journal"[..], "is not a journal"),
        (&whole[..5], "ends within its head"),
        (&whole[..40], "ends within its head"),
        (&old, "is a journal of version 0"),
    ] {
        fs::write(&journal, content).unwrap();
        let ran = run(&["export", path, "--mcap", target]);
        assert!(ran.code == Some(2) && ran.err.contains(part) && ran.err.contains("fix: "), "{ran:?}");
        assert!(!out.exists(), "{part}");
    }
    fs::write(&journal, &whole).unwrap();
    let ran = run(&["export", path, "--mcap", "/nowhere/out.mcap"]);
    assert!(ran.code == Some(2) && ran.err.contains("--mcap /nowhere/out.mcap"), "{ran:?}");
    let ran = run(&["export", "/nowhere/run.journal", "--mcap", target]);
    assert!(ran.code == Some(2) && ran.err.contains("/nowhere/run.journal") && !out.exists(), "{ran:?}");
}

/// A log for ShiViz: each module counts its inputs, and an input that is a message knows what its sender knew.
#[test]
fn a_log_for_shiviz_has_vector_clocks() {
    let dir = TempDir::new().unwrap();
    let path = |name: &str| dir.path().join(name).display().to_string();
    let journal = path("run.journal");
    run(&["run", "box", "--link", "sim", "--quiet", "--journal", &journal, "--restart", "2@20s"]);
    let written = run(&["export", &journal, "--shiviz", &path("run.log")]);
    assert_eq!(written.code, Some(0), "{written:?}");
    let text = fs::read_to_string(path("run.log")).unwrap();
    let mut lines = text.lines();
    let expression = lines.next().unwrap();
    assert!(["event", "host", "clock"].iter().all(|group| expression.contains(&format!("(?<{group}>"))));
    assert_eq!(lines.next(), Some(""), "there is one run");
    let lines: Vec<&str> = lines.collect();
    let mut clocks: BTreeMap<String, BTreeMap<String, u64>> = BTreeMap::new();
    let mut heard = 0;
    for entry in lines.chunks(2) {
        let [what, clock] = entry else { panic!("{entry:?}") };
        let (host, clock) = clock.split_once(' ').unwrap();
        let clock: BTreeMap<String, u64> = serde_json::from_str(clock).unwrap();
        let before = clocks.insert(host.to_owned(), clock.clone()).unwrap_or_default();
        assert_eq!(clock[host], before.get(host).copied().unwrap_or(0) + 1, "{what}");
        assert!(before.iter().all(|(other, n)| clock[other] >= *n), "{what}");
        // Never more than the others have counted themselves.
        assert!(clock.iter().all(|(other, n)| clocks[other][other] >= *n), "{what}");
        if let Some((_, rest)) = what.split_once("hears from ") {
            let sender = format!("module-{}", rest.split(':').next().unwrap());
            let is_known =
                clock.keys().any(|known| *known == sender || known.starts_with(&format!("{sender}.")));
            assert!(is_known, "{what}: {clock:?}");
            heard += 1;
        }
    }
    let hosts: BTreeSet<&str> = clocks.keys().map(String::as_str).collect();
    assert_eq!(hosts, BTreeSet::from(["module-0", "module-1", "module-2", "module-2.1", "module-3"]));
    assert!(heard > 100, "{heard} messages");
    // A part of the run counts from its beginning.
    run(&["export", &journal, "--shiviz", &path("part.log"), "--during", "30s..40s"]);
    let part = fs::read_to_string(path("part.log")).unwrap();
    assert!(part.len() < text.len() / 2 && part.lines().nth(2).unwrap().starts_with("30."), "{part}");
    for (window, why) in
        [("5000s..6000s", "no agent took an input then"), ("5s..4s", "must be later"), ("5s", "two times")]
    {
        let refused = run(&["export", &journal, "--shiviz", &path("none.log"), "--during", window]);
        assert!(refused.code == Some(2) && refused.err.contains(why), "{window}: {refused:?}");
    }
}
