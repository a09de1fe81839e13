//! Holder, receiver or controller is killed at one of the four steps of a hand-over between processes: the cube stays held, it is
//! placed or the report says why not, and the journal replays bit for bit.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]
#![allow(clippy::print_stdout, reason = "shown only on failure or with --nocapture")]

use metamorph_module_agent::journal_file::Reader;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::record::{Event, Record};
use metamorph_tests::chaos::{agent_of, root_of, signal_to, wait_until};
use metamorph_tests::command::{command, report, run, run_processes, scenario};
use metamorph_tests::statistics::seeds_or;
use metamorph_world_controller::family::metamodule::report::{ElementsReport, MetamoduleReport};
use metamorph_world_controller::record::journal::parts_of;
use metamorph_world_controller::report::schema::Report;
use rustix::process::Signal;
use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::{Child, Stdio};

/// Kinds of actions in journals.
const GRIP: u8 = 19;
const LET_GO: u8 = 20;

/// Who is killed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Victim {
    Holder,
    Receiver,
    Controller,
}

/// The steps of a hand-over: the holder waits and another one comes, the receiver grips, the holder lets go, the receiver goes on.
const STEPS: [u8; 4] = [1, 2, 3, 4];
const VICTIMS: [Victim; 3] = [Victim::Holder, Victim::Receiver, Victim::Controller];

/// How far a hand-over is, from the actions that bodies began.
#[derive(Default)]
struct Progress {
    step: u8,
    holder: Option<ModuleId>,
    receiver: Option<ModuleId>,
}

fn progress(controller: &Path) -> Progress {
    let mut seen = Progress::default();
    let Ok(records) = Reader::open(controller) else { return seen };
    for record in records.map_while(Result::ok) {
        let Record { event: Event::Act { id, action, begun: true, .. }, .. } = record else { continue };
        match (seen.step, action.kind) {
            (0, GRIP) => (seen.step, seen.holder) = (1, Some(id)),
            (1, GRIP) if seen.holder != Some(id) => (seen.step, seen.receiver) = (2, Some(id)),
            // It was put down, and picked up by another one.
            (1, LET_GO) => seen = Progress::default(),
            (2, LET_GO) if seen.holder == Some(id) => seen.step = 3,
            (3, _) if seen.receiver == Some(id) => seen.step = 4,
            _ => {}
        }
        // The first action of another one after the holder has the cube: it is on its way.
        if seen.step == 1 && seen.receiver.is_none() && seen.holder != Some(id) {
            seen.receiver = Some(id);
        }
    }
    seen
}

/// A run that ends with its test.
struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        if self.0.try_wait().is_ok_and(|ended| ended.is_none()) {
            signal_to(self.0.id() as i32, Signal::TERM);
            let _ = self.0.wait();
        }
    }
}

/// Kills the victim at a step; returns false if the run was over before.
fn kill(running: &mut Running, journal: &Path, victim: Victim, step: u8) -> bool {
    let controller = parts_of(journal).join("controller");
    let (pid, mut is_over) = (running.0.id() as i32, false);
    let mut seen = Progress::default();
    wait_until("the hand-over to get so far", || {
        is_over = running.0.try_wait().unwrap().is_some();
        seen = progress(&controller);
        is_over || (seen.step >= step && (seen.receiver.is_some() || victim == Victim::Holder))
    });
    let module = match victim {
        Victim::Controller => None,
        Victim::Holder => seen.holder,
        Victim::Receiver => seen.receiver,
    };
    match module {
        _ if is_over => return false,
        None => signal_to(pid, Signal::KILL),
        Some(id) => {
            let agent = root_of(pid).and_then(|root| agent_of(&root, id.0, 0));
            let Some(agent) = agent else { return false };
            signal_to(agent.pid, Signal::KILL);
        }
    }
    true
}

fn elements(report: &Report) -> ElementsReport {
    let part = &report.family_parts["metamodules"];
    serde_json::from_value::<MetamoduleReport>(part.clone()).unwrap().elements.unwrap()
}

/// Runs a hand-over with one kill; returns the outcome.
fn case(victim: Victim, step: u8, seed: u64) -> String {
    let about = format!("{victim:?} at step {step}, seed {seed}");
    let directory = tempfile::tempdir().unwrap();
    let journal = directory.path().join("journal");
    let (file, path) = (journal.display().to_string(), scenario("hand-over.toml").display().to_string());
    let (out, seed) = (directory.path().join("report.json"), seed.to_string());
    let shown = out.display().to_string();
    let args = [
        "run",
        &path,
        "--quiet",
        "--journal",
        &file,
        "--seed",
        &seed,
        "--time-scale",
        "20",
        "--json",
        &shown,
    ];
    let child = command(&args).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let mut running = Running(child);
    let is_killed = kill(&mut running, &journal, victim, step);
    let text = match (victim, is_killed) {
        (Victim::Controller, true) => {
            running.0.wait().unwrap();
            run_processes(&["resume", &file, "--json", "-"]).out
        }
        _ => {
            wait_until("the run to end", || running.0.try_wait().unwrap().is_some());
            fs::read_to_string(&out).unwrap_or_default()
        }
    };
    let report = report(&text);
    let held = elements(&report);
    assert_eq!(report.invariants.broken, 0, "{about}: {:?}", report.invariants);
    assert_eq!(held.placed + held.pinned.len() as u64 + held.on_the_way, 1, "{about}: {held:?}");
    let reason = report.unbuilt.as_ref().map(|u| u.reason.clone()).unwrap_or_default();
    match report.outcome.as_str() {
        "built" => assert_eq!(held.placed, 1, "{about}: {held:?}"),
        _ => {
            let named = ["element-pinned", "element-blocked", "seed-blocked", "material-exhausted"];
            assert!(named.contains(&reason.as_str()), "{about}: {reason}: {}", report.reason);
        }
    }
    assert!(is_killed || report.outcome == "built", "{about}: it was over before");
    let replayed = run(&["replay", &file]);
    assert_eq!(replayed.code, Some(0), "{about}: {replayed:?}");
    let killed = if is_killed { "" } else { ", over before" };
    format!("{about}: {} {reason}, {} hand-overs{killed}", report.outcome, held.hand_overs)
}

#[test]
fn a_cube_stays_held_although_one_of_a_hand_over_is_killed() {
    for (victim, step) in [(Victim::Holder, 2), (Victim::Receiver, 3), (Victim::Controller, 3)] {
        println!("{}", case(victim, step, 1));
    }
}

/// All victims at all steps, fifty times each: about an hour. Cases that are done already, by a file in the target
/// directory, are left out.
#[test]
#[ignore = "takes about an hour; it goes on where it was interrupted"]
fn a_cube_stays_held_at_every_kill() {
    let done = Path::new(env!("CARGO_TARGET_TMPDIR")).join("hand-over-kills.txt");
    let before = fs::read_to_string(&done).unwrap_or_default();
    let mut file = fs::OpenOptions::new().create(true).append(true).open(&done).unwrap();
    for seed in seeds_or(0..50) {
        for (victim, step) in VICTIMS.iter().flat_map(|v| STEPS.map(|s| (*v, s))) {
            let about = format!("{victim:?} at step {step}, seed {seed}:");
            if !before.contains(&about) {
                writeln!(file, "{}", case(victim, step, seed)).unwrap();
            }
        }
    }
}
