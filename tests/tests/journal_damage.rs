//! Damaged journals: an error with an exit code of its own that names the place, in every command that reads
//! journals. The traces of a killed writer are not damage.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_module_agent::journal_file::{Head, Reader, RunId, Writer, agent_part, controller_part};
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::record::{Event, Record, Sink, Who};
use metamorph_tests::chaos::signal_to;
use metamorph_tests::command::{Ran, command, run, scenario};
use metamorph_tests::journal_file::frames;
use metamorph_world_controller::record::journal::parts_of;
use rustix::process::Signal;
use std::collections::BTreeMap;
use std::fs;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::Stdio;

const DAMAGED: Option<i32> = Some(9);

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Simulates a scenario that ships with the program.
fn record(journal: &Path, seed: &str) {
    let path = scenario("swarm.toml");
    let ran = run(&["run", text(&path), "--link", "sim", "-q", "--seed", seed, "--journal", text(journal)]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
}

/// Splits a journal into the parts that a run of processes would have left, in the directory beside `file`.
fn split(journal: &Path, file: &Path) -> PathBuf {
    let dir = parts_of(file);
    fs::create_dir(&dir).unwrap();
    let mut reader = Reader::open(journal).unwrap();
    let head = reader.head().clone();
    let Head::Run(run) = &head else { panic!("the head of a run") };
    let run = run.run;
    let mut parts = BTreeMap::new();
    for record in reader.by_ref().map(Result::unwrap) {
        let part = parts.entry(record.who).or_insert_with(|| {
            let (path, head) = match record.who {
                Who::Controller => (controller_part(&dir), head.clone()),
                Who::Agent(id, life) => {
                    (agent_part(&dir, id, life), Head::Part { run, id, incarnation: life })
                }
            };
            Writer::create(&path, &head).unwrap()
        });
        part.put(&record);
    }
    dir
}

/// Runs `view` on a file until the page is served, and ends it.
fn view(file: &Path) -> Ran {
    let mut view =
        command(&["view", text(file)]).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut lines = BufReader::new(view.stdout.take().unwrap()).lines().map_while(Result::ok);
    let out = lines.find(|line| line.contains("http://"));
    signal_to(view.id() as i32, Signal::INT);
    let mut err = String::new();
    view.stderr.take().unwrap().read_to_string(&mut err).unwrap();
    Ran { code: view.wait().unwrap().code(), out: out.unwrap_or_default(), err }
}

fn assert_damaged(ran: &Ran, file: &Path, what: &str) {
    assert_eq!(ran.code, DAMAGED, "{ran:?}");
    for part in [text(file), "damaged at byte", what, "fix: "] {
        assert!(ran.err.contains(part), "`{part}` is missing: {ran:?}");
    }
}

/// Asserts that every command that reads a journal reports damage in `file`.
fn assert_found(journal: &Path, file: &Path, what: &str) {
    let replayed = run(&["replay", text(journal)]);
    assert_damaged(&replayed, file, what);
    let quiet = run(&["replay", "--quiet", text(journal)]);
    assert_damaged(&quiet, file, what);
    assert_eq!(quiet.out, "");
    let mcap = journal.with_extension("mcap");
    assert_damaged(&run(&["export", text(journal), "--mcap", text(&mcap)]), file, what);
    assert!(!mcap.exists(), "half a recording looks like a whole one");
}

#[test]
fn damage_within_a_journal_is_an_error_of_its_own() {
    let dir = tempfile::tempdir().unwrap();
    let journal = dir.path().join("journal");
    record(&journal, "1");
    let good = fs::read(&journal).unwrap();
    let frames = frames(&good);
    let (middle, next) = (frames[frames.len() / 2].clone(), frames[frames.len() / 2 + 1].clone());
    let (before, after) = (&good[..middle.start], &good[next.end..]);
    let (a, b) = (&good[middle.clone()], &good[next.clone()]);
    let mut flipped = good.clone();
    flipped[middle.end - 1] ^= 0x10;
    let mut long = good.clone();
    long[middle.start + 2] ^= 0x80;
    let changed = "its check sum does not match";
    let order = "removed, repeated or put in another order";
    for (bytes, at, what) in [
        (flipped, middle.start, changed),
        (long, middle.start, changed),
        ([before, b, after].concat(), middle.start, order),
        ([before, a, a, b, after].concat(), middle.end, order),
        ([before, b, a, after].concat(), middle.start, order),
    ] {
        fs::write(&journal, bytes).unwrap();
        assert_found(&journal, &journal, &format!("damaged at byte {at}: "));
        assert_found(&journal, &journal, what);
        let replayed = run(&["replay", text(&journal)]);
        assert!(replayed.out.contains("identical states up to the damage"), "{replayed:?}");
    }
    // The part before the damage is shown.
    let viewed = view(&journal);
    assert_damaged(&viewed, &journal, order);
    assert!(viewed.out.contains("http://"), "{viewed:?}");
    // With a damaged head no part can be shown.
    let mut head = good.clone();
    head[40] ^= 1;
    fs::write(&journal, head).unwrap();
    assert_found(&journal, &journal, changed);
    assert_damaged(&run(&["view", text(&journal)]), &journal, changed);
}

#[test]
fn damaged_missing_and_foreign_parts_are_errors() {
    let dir = tempfile::tempdir().unwrap();
    let [one, two, file] = ["one", "two", "file"].map(|name| dir.path().join(name));
    record(&one, "1");
    record(&two, "2");
    let other = split(&two, &two);
    let part = |of: &Path, id| agent_part(of, ModuleId(id), Incarnation(0));
    let tampered = |what: &str, tamper: &dyn Fn(&Path) -> PathBuf| {
        let parts = split(&one, &file);
        let named = tamper(&parts);
        assert_found(&file, &named, what);
        // Such a run cannot be resumed either.
        let resumed = run(&["resume", text(&file), "--json", "-"]);
        assert_damaged(&resumed, &named, what);
        assert_eq!(resumed.out, "");
        fs::remove_dir_all(parts).unwrap();
    };
    tampered("is missing or empty", &|parts| {
        fs::remove_file(part(parts, 7)).unwrap();
        part(parts, 7)
    });
    tampered("is missing or empty", &|parts| {
        fs::write(part(parts, 7), b"").unwrap();
        part(parts, 7)
    });
    tampered("this is a part of run ", &|parts| {
        fs::copy(part(&other, 7), part(parts, 7)).unwrap();
        part(parts, 7)
    });
    tampered("this is a part of run ", &|parts| {
        let new = agent_part(parts, ModuleId(7), Incarnation(1));
        let head = Head::Part { run: RunId([1; 16]), id: ModuleId(7), incarnation: Incarnation(1) };
        drop(Writer::create(&new, &head).unwrap());
        new
    });
    tampered("this is the part of module 7 in incarnation 0", &|parts| {
        fs::copy(part(parts, 7), part(parts, 8)).unwrap();
        part(parts, 8)
    });
    tampered("this is no part of a journal", &|parts| {
        fs::write(part(parts, 7), b"something else").unwrap();
        part(parts, 7)
    });
    for path in [|parts: &Path| agent_part(parts, ModuleId(7), Incarnation(0)), controller_part] {
        tampered("its check sum does not match", &|parts| {
            let path = path(parts);
            let mut bytes = fs::read(&path).unwrap();
            let middle = bytes.len() / 2;
            bytes[middle] ^= 4;
            fs::write(&path, bytes).unwrap();
            path
        });
    }
}

/// What killed writers leave is read up to the end of the journal, with a note.
#[test]
fn torn_ends_are_notes() {
    let dir = tempfile::tempdir().unwrap();
    let [journal, file] = ["journal", "file"].map(|name| dir.path().join(name));
    record(&journal, "1");
    let parts = split(&journal, &file);
    let whole = run(&["replay", text(&file)]);
    assert_eq!(whole.code, Some(0), "{whole:?}");
    assert!(whole.out.contains("the run ended built"), "{whole:?}");
    // Killed during its start: the controller does not know of it.
    fs::write(agent_part(&parts, ModuleId(7), Incarnation(1)), b"MMJOU").unwrap();
    let part = agent_part(&parts, ModuleId(7), Incarnation(0));
    let cut = |path: &Path| {
        let bytes = fs::read(path).unwrap();
        fs::write(path, &bytes[..frames(&bytes).last().unwrap().end - 5]).unwrap();
    };
    cut(&part);
    let torn = run(&["replay", text(&file)]);
    assert_eq!(torn.code, Some(0), "{torn:?}");
    assert!(
        torn.out.contains("7.0: cut off after") && torn.out.contains("7.1: nothing was written"),
        "{torn:?}"
    );
    cut(&journal);
    let torn = run(&["replay", text(&journal)]);
    assert_eq!(torn.code, Some(0), "{torn:?}");
    assert!(
        torn.out.contains("cut off after") && torn.out.contains("up to the end of the journal"),
        "{torn:?}"
    );
}

/// The same scenario and seed give the same bytes; other seeds and other runs of processes another identity.
#[test]
fn identities_follow_from_scenario_and_seed() {
    let dir = tempfile::tempdir().unwrap();
    let [one, again, two] = ["one", "again", "two"].map(|name| dir.path().join(name));
    for (journal, seed) in [(&one, "1"), (&again, "1"), (&two, "2")] {
        record(journal, seed);
    }
    assert!(fs::read(&one).unwrap() == fs::read(&again).unwrap(), "the same run is written the same");
    let id = |path: &Path| match Reader::open(path).unwrap().head() {
        Head::Run(head) => head.run,
        Head::Part { .. } => panic!("the head of a run"),
    };
    assert_ne!(id(&one), id(&two));
    assert_ne!(id(&one), RunId::default());
}

/// Recorded inputs of the director are handed to it again: this one takes none, and says so.
#[test]
fn inputs_are_handed_to_the_director() {
    let dir = tempfile::tempdir().unwrap();
    let journal = dir.path().join("journal");
    record(&journal, "1");
    let mut reader = Reader::open(&journal).unwrap();
    let head = reader.head().clone();
    let mut records: Vec<Record> = reader.by_ref().map(Result::unwrap).collect();
    let i = records.iter().position(|r| r.event == Event::Wake).unwrap();
    let event = Event::Input { kind: "clock".into(), bytes: vec![1, 2] };
    records.insert(i, Record { event, ..records[i].clone() });
    let mut writer = Writer::create(&journal, &head).unwrap();
    records.iter().for_each(|r| writer.put(r));
    drop(writer);
    let ran = run(&["replay", text(&journal)]);
    assert_eq!(ran.code, Some(8), "{ran:?}");
    assert!(ran.out.contains("takes no input of kind `clock`"), "{ran:?}");
}
