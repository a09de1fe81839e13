//! Statistics of hosts and cables that fail: each fault is repeated, and breaks no invariant, loses no message from the
//! counts, and leaves nothing behind. Runs on demand: each takes about twenty seconds.
//!
//! `cargo test -p metamorph-tests ipc_hosts_faults:: -- --ignored --nocapture` goes on where it was stopped: each run
//! appends a line to `target/tmp/hosts-faults.txt`. Delete the file to begin anew. `METAMORPH_SEEDS=0..25` before it makes
//! the first 25 runs of each fault, so that several such commands can share the work.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_module_agent::journal_file::Reader;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::record::{Record, Who};
use metamorph_protocol::time::{Span, Time};
use metamorph_tests::chaos::{root_of, signal_to, wait_until};
use metamorph_tests::command::{command, report, run, scenario};
use metamorph_tests::daemons::{Daemons, left_by};
use metamorph_tests::statistics::seeds_or;
use metamorph_world_controller::record::journal::{Event, Journal, parts_of};
use rustix::process::Signal;
use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::ops::Range;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::Duration;

/// The runs of each fault, unless others are asked for.
const RUNS: Range<u64> = 0..50;
/// Between `silent` (1 s) and `fence` (2 s) of the hosts file: no host counts as dead.
const SHORT: Duration = Duration::from_millis(1_300);
/// Longer than the fence.
const LONG: Duration = Duration::from_millis(3_500);
/// Longer than the default fence of 10 s, with which these runs are made.
const PARTITION: Duration = Duration::from_secs(30);

/// A fault of h2, of the cable to it, or of the controller's host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    Killed,
    AskedToEnd,
    Frozen(Duration),
    Cut { to: bool, from: bool, lasts: Duration },
    ControllerLost,
}

const FAULTS: [(&str, Fault); 14] = [
    ("killed", Fault::Killed),
    ("asked-to-end", Fault::AskedToEnd),
    ("frozen-short", Fault::Frozen(SHORT)),
    ("frozen-long", Fault::Frozen(LONG)),
    ("cut-short", Fault::Cut { to: true, from: true, lasts: SHORT }),
    ("cut-long", Fault::Cut { to: true, from: true, lasts: LONG }),
    ("cut-to-short", Fault::Cut { to: true, from: false, lasts: SHORT }),
    ("cut-to-long", Fault::Cut { to: true, from: false, lasts: LONG }),
    ("cut-from-short", Fault::Cut { to: false, from: true, lasts: SHORT }),
    ("cut-from-long", Fault::Cut { to: false, from: true, lasts: LONG }),
    ("controller-lost", Fault::ControllerLost),
    ("partition", Fault::Cut { to: true, from: true, lasts: PARTITION }),
    ("partition-to", Fault::Cut { to: true, from: false, lasts: PARTITION }),
    ("partition-from", Fault::Cut { to: false, from: true, lasts: PARTITION }),
];

impl Fault {
    /// Starts daemons with the times for this fault; returns them and when the run has to end.
    fn daemons(self) -> (Daemons, &'static str) {
        match self {
            Fault::Cut { lasts: PARTITION, .. } => (Daemons::with(""), "stop.timeout=90s"),
            _ => (Daemons::start(), "stop.timeout=40s"),
        }
    }

    fn strike(self, daemons: &Daemons, controller: &Child) {
        match self {
            Fault::Killed => daemons.signal(0, Signal::KILL),
            Fault::AskedToEnd => daemons.signal(0, Signal::TERM),
            Fault::Frozen(lasts) => {
                daemons.signal(0, Signal::STOP);
                std::thread::park_timeout(lasts);
                daemons.signal(0, Signal::CONT);
            }
            Fault::Cut { to, from, lasts } => {
                daemons.cable(0).hold(to, from);
                std::thread::park_timeout(lasts);
                daemons.cable(0).hold(false, false);
            }
            Fault::ControllerLost => signal_to(controller.id() as i32, Signal::KILL),
        }
    }

    /// True if the agents of h2 outlive it.
    fn spares_h2(self) -> bool {
        matches!(self, Fault::Frozen(SHORT) | Fault::Cut { lasts: SHORT, .. })
    }
}

/// Checks that no agent took an input after the controller had counted it as dead, in scenario time, which all processes of a
/// machine read from one clock. Returns the least time between its last input and that, and the time between the last input
/// of any of them and the death of the last.
fn fenced_before(journal: &Path) -> Result<Option<(Span, Span)>, String> {
    let (mut stepped, mut died) = (BTreeMap::new(), BTreeMap::new());
    for record in Journal::open(journal).map_err(|e| e.to_string())? {
        let Record { at, who, event } = record.map_err(|e| e.to_string())?;
        match (who, event) {
            (Who::Agent(id, _), Event::Step(_)) => _ = stepped.insert(id, at),
            (Who::Controller, Event::Died { id }) => _ = died.insert(id, at),
            _ => {}
        }
    }
    let of = |(id, death): (&ModuleId, &Time)| Some((*id, *stepped.get(id)?, *death));
    let deaths: Vec<(ModuleId, Time, Time)> = died.iter().filter_map(of).collect();
    if let Some((id, last, death)) = deaths.iter().find(|(_, last, death)| last > death) {
        return Err(format!("module {id} took an input at {last} and had counted as dead since {death}"));
    }
    let least = deaths.iter().map(|(_, last, death)| death.since(*last)).min();
    let (last, death) = (deaths.iter().map(|d| d.1).max(), deaths.iter().map(|d| d.2).max());
    Ok(least.zip(death.zip(last)).map(|(least, (death, last))| (least, death.since(last))))
}

/// Runs the scenario `swarm` with one fault, and returns what went wrong.
fn strike(fault: Fault, seed: u64) -> Result<String, String> {
    let (daemons, timeout) = fault.daemons();
    let identities = [daemons.identity(0), daemons.identity(1)];
    let (hosts, journal, out) =
        (daemons.path("hosts.toml"), daemons.path("run.journal"), daemons.path("report.json"));
    let (swarm, drawn) = (scenario("swarm.toml").display().to_string(), seed.to_string());
    let args = ["run", &swarm, "--hosts", &hosts, "--journal", &journal, "--json", &out, "--quiet"];
    let args = [&args[..], &["--set", timeout, "--seed", &drawn, "--patience", "1s"]].concat();
    let mut child = command(&args).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
    let controller = parts_of(Path::new(&journal)).join("controller");
    wait_until("the run to begin", || {
        let records = Reader::open(&controller).into_iter().flatten();
        records.map_while(Result::ok).any(|record| matches!(record.event, Event::Act { .. }))
    });
    // At another point of each run.
    std::thread::park_timeout(Duration::from_millis(seed * 37 % 1_900));
    fault.strike(&daemons, &child);
    let mut status = None;
    wait_until("the run to end", || {
        status = child.try_wait().unwrap();
        status.is_some()
    });
    let mut said = "lost".to_owned();
    if fault != Fault::ControllerLost {
        let report = report(&fs::read_to_string(&out).map_err(|e| format!("no report: {e}"))?);
        let lost = report.faults.iter().filter(|fault| fault.fault == "lost").count();
        said = format!("{} with {} of 42 alive", report.outcome, report.agents.alive);
        if report.invariants.broken > 0 {
            return Err(format!("{said}: {:?}", report.invariants));
        }
        if report.notes.iter().any(|note| note.contains("messages are missing")) {
            return Err(format!("{said}: {:?}", report.notes));
        }
        if (lost == 0) != fault.spares_h2() {
            return Err(format!("{said}: {lost} hosts were lost"));
        }
        let replayed = run(&["replay", &journal, "--quiet"]);
        if replayed.code != Some(0) {
            return Err(format!("{said}: the journal does not replay: {replayed:?}"));
        }
        match fenced_before(Path::new(&journal)) {
            Err(why) => return Err(format!("{said}: {why}")),
            Ok(Some((least, all))) => said += &format!(", fenced {least} before, all dead after {all}"),
            Ok(None) => {}
        }
    }
    // The daemons that live end their shares by themselves.
    for i in (0..2).filter(|i| !matches!(fault, Fault::Killed | Fault::AskedToEnd) || *i == 1) {
        wait_until("the shares to end", || root_of(daemons.pid(i)).is_none());
    }
    drop(daemons);
    match identities.into_iter().flat_map(left_by).next() {
        Some(file) => Err(format!("{said}: {} is left", file.display())),
        None => Ok(said),
    }
}

#[test]
#[ignore = "statistics: hours of runs"]
fn faults_of_hosts_and_cables_break_nothing() {
    let directory = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let path = directory.join("hosts-faults.txt");
    let mut bad = Vec::new();
    for number in seeds_or(RUNS) {
        for (name, fault) in FAULTS {
            let done = fs::read_to_string(&path).unwrap_or_default();
            let start = format!("{name} {number}: ");
            let line = match done.lines().find(|line| line.starts_with(&start)) {
                Some(line) => line.to_owned(),
                None => {
                    let line = match strike(fault, number + 1) {
                        Ok(said) => format!("{start}ok, {said}"),
                        Err(why) => format!("{start}BAD, {why}"),
                    };
                    let mut file = fs::File::options().create(true).append(true).open(&path).unwrap();
                    writeln!(file, "{line}").unwrap();
                    line
                }
            };
            if line.contains(": BAD") {
                bad.push(line);
            }
        }
    }
    assert!(bad.is_empty(), "{bad:#?}");
}
