//! Hosts that are lost, and whose modules start elsewhere: simulated by a scenario, and with daemons that are killed.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_module_agent::journal_file::Reader;
use metamorph_protocol::record::Outside;
use metamorph_tests::chaos::wait_until;
use metamorph_tests::command::{on, refused, report, run, run_processes, scenario, surprises};
use metamorph_tests::daemons::Daemons;
use metamorph_world_controller::record::journal::{Event, parts_of};
use metamorph_world_controller::report::schema::Report;
use rustix::process::Signal;
use std::path::Path;

/// Modules of h2 in the scenario `swarm` on three hosts.
const OF_H2: std::ops::Range<u32> = 14..28;
const ELSEWHERE: [&str; 4] = ["--set", "link.between_hosts.lost=elsewhere", "--rescue", "off"];

/// Why a host is lost whose daemon answers again before it counts as lost.
const STARTED_AGAIN: &str = "its daemon was started again, which ended its agents";

/// Module 41 is killed by the scenario `swarm` itself.
const LIVING: u64 = 41;

/// Returns the faults of this kind in a report that hosts bring about, with their times and modules.
fn faults(report: &Report, kind: &str) -> Vec<(f64, Option<u32>)> {
    let of_hosts = report.faults.iter().filter(|f| f.fault == kind && f.module != Some(LIVING as u32));
    of_hosts.map(|f| (f.at_s, f.module)).collect()
}

/// Returns the starts of these modules, one a millisecond from `at` on.
fn started(at: f64, modules: std::ops::Range<u32>) -> Vec<(f64, Option<u32>)> {
    let number = |(i, id): (u32, u32)| ((f64::from(i) + at * 1_000.0) / 1_000.0, Some(id));
    (0..).zip(modules).map(number).collect()
}

/// The scenario `swarm` on three hosts, one of which goes down at 6 s.
fn swarm(more: &str) -> String {
    let text = std::fs::read_to_string(scenario("swarm.toml")).unwrap();
    format!("{text}\n[link.between_hosts]\nhosts = 3\nlost = \"elsewhere\"\n{more}")
}

#[test]
fn a_simulated_loss_is_a_restart_after_the_fence() {
    let text = swarm("fence = \"4s\"\n[[fault]]\nkill_host = \"h2\"\nat = \"6s\"\n");
    let directory = tempfile::tempdir().unwrap();
    let journal = directory.path().join("lost.mmj").display().to_string();
    let args = ["run", "{}", "--link", "sim", "--json", "-", "--rescue", "off", "--journal", &journal];
    let ran = on(&text, &args);
    let report = report(&ran.out);
    assert_eq!((report.outcome.as_str(), report.invariants.broken), ("built", 0), "{ran:?}");
    let killed = OF_H2.map(|id| (6.0, Some(id))).collect::<Vec<_>>();
    assert_eq!((faults(&report, "down"), faults(&report, "lost")), (vec![(6.0, None)], vec![(10.0, None)]));
    assert_eq!((faults(&report, "kill"), faults(&report, "restart")), (killed, started(10.0, OF_H2)));
    assert_eq!((report.agents.crashed, report.agents.alive), (15, LIVING));
    let h2 = &report.hosts.as_ref().unwrap().hosts[1];
    assert_eq!(h2.lost_s, Some(10.0));
    // Nothing crosses to h2 any more, so what its modules send crosses between the other two.
    let crossed = &report.hosts.as_ref().unwrap().crossed;
    let sent =
        |from: &str, to: &str| crossed.iter().find(|c| c.from == from && c.to == to).map(|c| c.all.sent);
    assert!(sent("h1", "h3") > Some(0), "{crossed:?}");
    let replayed = run(&["replay", &journal, "--quiet"]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
}

/// A module that had crashed before stays dead, and a host that is back within its fence keeps its modules.
#[test]
fn a_host_that_comes_back_in_time_restarts_those_it_had() {
    let text = swarm(
        "fence = \"9s\"\n[[fault]]\nkill_host = \"h2\"\nat = \"6s\"\nuntil = \"8s\"\n[[fault]]\nkill = 20\nat = \"5s\"\n",
    );
    let ran = on(&text, &["run", "{}", "--link", "sim", "--json", "-"]);
    let report = report(&ran.out);
    let mut again = started(8.0, OF_H2);
    again.retain(|(_, id)| *id != Some(20));
    assert_eq!((faults(&report, "restart"), faults(&report, "back")), (again, vec![(8.0, None)]), "{ran:?}");
    assert_eq!((faults(&report, "lost"), report.agents.alive), (vec![], LIVING - 1));
}

#[test]
fn outages_that_cannot_be_are_refused() {
    let down = |host: &str, more: &str| format!("[[fault]]\nkill_host = \"{host}\"\nat = \"6s\"\n{more}");
    let all = ["h1", "h2", "h3"].map(|host| down(host, "")).concat();
    let check = ["check", "{}", "--link", "sim"];
    refused(&swarm(&all), &check, &["all hosts are down at 6s", "come back before"]);
    refused(&swarm(&(down("h2", "") + &down("h2", ""))), &check, &["h2 is down already at 6s"]);
    let crash = swarm(&down("h2", "until = \"9s\"\n")).replace("lost = \"elsewhere\"\n", "");
    refused(&crash, &check, &["`until` counts only if", "lost = \"elsewhere\""]);
    let fence = swarm("fence = \"4s\"\n").replace("\"elsewhere\"", "\"crash\"");
    refused(&fence, &check, &["`fence` counts only if"]);
}

/// Processes on hosts that the scenario takes down start elsewhere, as they do in the simulation.
#[test]
fn processes_of_a_host_that_the_scenario_takes_down_start_elsewhere() {
    let text = swarm("fence = \"4s\"\n[[fault]]\nkill_host = \"h2\"\nat = \"6s\"\n");
    let directory = tempfile::tempdir().unwrap();
    let (file, journal) = (directory.path().join("lost.toml"), directory.path().join("lost.mmj"));
    std::fs::write(&file, text).unwrap();
    let (file, journal) = (file.display().to_string(), journal.display().to_string());
    let ran = run_processes(&["run", &file, "--json", "-", "--quiet", "--journal", &journal]);
    let report = report(&ran.out);
    assert_eq!((report.outcome.as_str(), report.invariants.broken), ("built", 0), "{ran:?}");
    assert_eq!((faults(&report, "restart").len(), report.agents.alive), (14, LIVING), "{ran:?}");
    assert_eq!(surprises(&report), [""; 0]);
    let replayed = run(&["replay", &journal, "--quiet"]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
}

/// Waits until the controller of the run with this journal has recorded an event, or until the run `is_over`.
fn await_record(what: &str, journal: &str, is_over: &dyn Fn() -> bool, is_it: impl Fn(&Event) -> bool) {
    let controller = parts_of(Path::new(journal)).join("controller");
    wait_until(what, || {
        let records = Reader::open(&controller).into_iter().flatten();
        is_over() || records.map_while(Result::ok).any(|record| is_it(&record.event))
    });
}

/// A daemon is killed, and another started in its place. Modules of a second host that is lost start there, too.
#[test]
fn a_daemon_that_is_started_again_takes_modules() {
    let mut daemons = Daemons::start();
    let (hosts, journal) = (daemons.path("hosts.toml"), daemons.path("run.journal"));
    let swarm = scenario("swarm.toml").display().to_string();
    let args = ["run", &swarm, "--hosts", &hosts, "--journal", &journal, "--json", "-", "--quiet"];
    let args = [&args[..], &ELSEWHERE, &["--seed", "3", "--time-scale", "3"]].concat();
    let ran = std::thread::scope(|scope| {
        let ran = scope.spawn(|| run_processes(&args));
        let is_over = || ran.is_finished();
        await_record("the run to begin", &journal, &is_over, |event| matches!(event, Event::Act { .. }));
        daemons.replace(0);
        let is_back = |event: &Event| match event {
            Event::External { what: Outside::HostLost { why, .. }, .. } => why == STARTED_AGAIN,
            Event::External { what: Outside::HostBack { .. }, .. } => true,
            _ => false,
        };
        await_record("h2 to come back", &journal, &is_over, is_back);
        daemons.signal(1, Signal::KILL);
        ran.join().unwrap()
    });
    let report = report(&ran.out);
    assert_eq!((report.outcome.as_str(), report.invariants.broken), ("built", 0), "{ran:?}");
    assert_eq!(surprises(&report), [""; 0]);
    // If the new daemon answers before the end of the old one is seen, the modules of h2 stay there, and h3 has 14 when it is lost.
    // Otherwise h3 has 21, and h2 none.
    let is_early = report.hosts.as_ref().unwrap().hosts[1].lost_why.as_deref() == Some(STARTED_AGAIN);
    let (back, of_h3) = if is_early { (0, 14) } else { (1, 21) };
    assert_eq!((faults(&report, "lost").len(), faults(&report, "back").len()), (2, back), "{ran:?}");
    assert_eq!(report.agents.alive, LIVING);
    assert_eq!(faults(&report, "restart").len(), 14 + of_h3 - 1, "{ran:?}");
    let crossed = &report.hosts.as_ref().unwrap().crossed;
    let back = crossed.iter().find(|c| (c.from.as_str(), c.to.as_str()) == ("h1", "h2")).unwrap();
    assert!(back.body_messages > 100, "{crossed:?}");
    let replayed = run(&["replay", &journal, "--quiet"]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
}

/// A daemon is killed: its modules start on the two other hosts, and the swarm is built without help.
#[test]
fn modules_of_a_killed_daemon_start_elsewhere() {
    let daemons = Daemons::start();
    let (hosts, journal) = (daemons.path("hosts.toml"), daemons.path("run.journal"));
    let swarm = scenario("swarm.toml").display().to_string();
    let args = ["run", &swarm, "--hosts", &hosts, "--journal", &journal, "--json", "-", "--quiet"];
    let args = [&args[..], &ELSEWHERE, &["--seed", "3", "--time-scale", "5"]].concat();
    let ran = std::thread::scope(|scope| {
        let ran = scope.spawn(|| run_processes(&args));
        let is_over = || ran.is_finished();
        await_record("the run to begin", &journal, &is_over, |event| matches!(event, Event::Act { .. }));
        daemons.signal(0, Signal::KILL);
        ran.join().unwrap()
    });
    let report = report(&ran.out);
    assert_eq!((report.outcome.as_str(), report.invariants.broken), ("built", 0), "{ran:?}");
    assert_eq!(surprises(&report), [""; 0]);
    let lost = &report.hosts.as_ref().unwrap().hosts[1];
    assert!(lost.lost_s.is_some() && report.agents.alive == LIVING, "{ran:?}");
    let restarted: Vec<Option<u32>> = faults(&report, "restart").iter().map(|(_, id)| *id).collect();
    assert_eq!(restarted, OF_H2.map(Some).collect::<Vec<_>>());
    let replayed = run(&["replay", &journal, "--quiet"]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
}
