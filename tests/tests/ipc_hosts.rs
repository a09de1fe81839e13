//! Swarms of real processes on several hosts: daemons on this machine, connected by Unix sockets, that are killed and
//! frozen. Nothing is left behind on any host.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_module_agent::journal_file::Reader;
use metamorph_tests::chaos::{left_of, root_of, wait_until};
use metamorph_tests::command::{report, run, run_processes, scenario, surprises};
use metamorph_tests::daemons::{Daemons, left_by};
use metamorph_world_controller::record::journal::{Event, parts_of};
use metamorph_world_controller::report::schema::Report;
use rustix::process::Signal;
use std::fs;
use std::path::Path;
use std::sync::Mutex;

/// Times of the links between hosts in the test of a host that is not there.
const TIMES: &str = "version = 1\nsilent = \"1s\"\nfence = \"2s\"\n";
/// Modules of h2 in the scenario `swarm` on three hosts.
const OF_H2: std::ops::Range<u32> = 14..28;

/// Two runs at a time would compete for the processors.
static ALONE: Mutex<()> = Mutex::new(());

/// Runs the scenario `swarm` on the hosts, until the swarm is built or this scenario time has passed; `disturb` is called when all
/// agents of h2 are up and the first has acted.
fn run_on(daemons: &Daemons, timeout: &str, disturb: impl FnOnce()) -> Report {
    let (hosts, journal) = (daemons.path("hosts.toml"), daemons.path("run.journal"));
    let swarm = scenario("swarm.toml").display().to_string();
    let args = ["run", &swarm, "--hosts", &hosts, "--journal", &journal, "--json", "-", "--quiet"];
    let timeout = format!("stop.timeout={timeout}");
    let args = [&args[..], &["--set", &timeout, "--seed", "3"]].concat();
    let ran = std::thread::scope(|scope| {
        let ran = scope.spawn(|| run_processes(&args));
        let h2 = daemons.pid(0);
        // A counter file for each agent, and one for the daemon.
        wait_until("the agents of h2 to work", || {
            let agents = root_of(h2).map(|root| fs::read_dir(root.join("ledgers")));
            agents.and_then(Result::ok).is_some_and(|agents| agents.count() > OF_H2.len())
        });
        let controller = parts_of(Path::new(&journal)).join("controller");
        wait_until("the run to begin", || {
            let records = Reader::open(&controller).into_iter().flatten();
            records.map_while(Result::ok).any(|record| matches!(record.event, Event::Act { .. }))
        });
        disturb();
        ran.join().unwrap()
    });
    let replayed = run(&["replay", &journal, "--quiet"]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
    assert!(!ran.out.is_empty(), "{ran:?}");
    report(&ran.out)
}

/// Returns the hosts that were lost, each of which is one fault in the report.
fn lost(report: &Report) -> Vec<&str> {
    let hosts = &report.hosts.as_ref().unwrap().hosts;
    let lost: Vec<&str> = hosts.iter().filter(|h| h.lost_s.is_some()).map(|h| h.name.as_str()).collect();
    let faults: Vec<&str> =
        report.faults.iter().filter(|f| f.by == "external").map(|f| f.effect.as_str()).collect();
    assert_eq!(faults.len(), lost.len(), "{faults:?}");
    for (host, effect) in lost.iter().zip(&faults) {
        assert!(effect.starts_with(&format!("{host} with 14 modules: ")), "{effect}");
    }
    lost
}

#[test]
fn a_swarm_on_three_hosts_is_built_and_its_journal_replays() {
    let _alone = ALONE.lock();
    let directory = tempfile::tempdir().unwrap();
    let journal = directory.path().join("run.journal").display().to_string();
    let swarm = scenario("swarm.toml").display().to_string();
    let ran =
        run_processes(&["run", &swarm, "--hosts", "3", "--journal", &journal, "--json", "-", "--quiet"]);
    assert_eq!((ran.code, ran.err.as_str()), (Some(0), ""), "{ran:?}");
    let report = report(&ran.out);
    assert_eq!((report.outcome.as_str(), report.invariants.broken), ("built", 0));
    assert_eq!(surprises(&report), [""; 0]);
    let hosts = report.hosts.unwrap();
    assert_eq!(hosts.hosts.iter().map(|host| host.modules).collect::<Vec<_>>(), [14, 14, 14]);
    for (from, to) in [("h1", "h2"), ("h2", "h1"), ("h2", "h3"), ("h3", "h2")] {
        let crossed = hosts.crossed.iter().find(|c| (c.from.as_str(), c.to.as_str()) == (from, to)).unwrap();
        assert!(crossed.all.sent > 50, "{from} to {to}: {crossed:?}");
        assert_eq!(crossed.all.lost, 0, "{from} to {to}");
        assert_eq!(crossed.body_messages > 0, from == "h1" || to == "h1", "{from} to {to}");
    }
    let replayed = run(&["replay", &journal, "--quiet"]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
}

/// A daemon of this machine that has died is certain to be dead, so the run does not wait for the fence, which is an hour here.
#[test]
fn a_killed_daemon_takes_its_modules_along_and_the_rest_goes_on() {
    let _alone = ALONE.lock();
    let daemons = Daemons::start();
    let hosts = fs::read_to_string(daemons.path("hosts.toml")).unwrap();
    fs::write(daemons.path("hosts.toml"), hosts.replace("fence = \"2s\"", "fence = \"3600s\"")).unwrap();
    let h2 = daemons.identity(0);
    let report = run_on(&daemons, "30s", || daemons.signal(0, Signal::KILL));
    assert_eq!((report.invariants.broken, surprises(&report)), (0, vec![]));
    assert_eq!((lost(&report), report.agents.alive), (vec!["h2"], 27));
    wait_until("all of h2 to be removed", || left_by(h2).is_empty());
}

#[test]
fn a_frozen_daemon_ends_its_share_when_it_is_continued_and_serves_the_next_run() {
    let _alone = ALONE.lock();
    let daemons = Daemons::start();
    let root = std::cell::RefCell::new(None);
    let report = run_on(&daemons, "30s", || {
        *root.borrow_mut() = root_of(daemons.pid(0));
        daemons.signal(0, Signal::STOP);
    });
    assert_eq!(report.invariants.broken, 0);
    assert_eq!(lost(&report), ["h2"]);
    daemons.signal(0, Signal::CONT);
    let root = root.into_inner().unwrap();
    wait_until("its share to end", || left_of(&root).is_empty());
    let again = run_on(&daemons, "30s", || ());
    assert_eq!((again.outcome.as_str(), surprises(&again)), ("built", vec![]));
    daemons.end();
}

/// The daemon ends its share shortly before the controller counts it as dead, and keeps the counts until they are taken.
#[test]
fn a_host_that_is_cut_off_for_longer_than_the_fence_leaves_its_counts() {
    let _alone = ALONE.lock();
    let daemons = Daemons::start();
    let report = run_on(&daemons, "30s", || daemons.cable(0).hold(true, true));
    daemons.cable(0).hold(false, false);
    assert_eq!((report.invariants.broken, surprises(&report)), (0, vec![]));
    assert_eq!(lost(&report), ["h2"]);
    daemons.end();
}

#[test]
fn a_daemon_that_is_frozen_for_less_than_the_fence_loses_no_module() {
    let _alone = ALONE.lock();
    // Longer than a loaded machine may take to go on with a daemon that is continued.
    let daemons = Daemons::with("silent = \"1s\"\nfence = \"60s\"\n");
    // The daemon is frozen for 26 s of scenario time.
    let report = run_on(&daemons, "600s", || {
        daemons.signal(0, Signal::STOP);
        std::thread::park_timeout(std::time::Duration::from_millis(1_300));
        daemons.signal(0, Signal::CONT);
    });
    assert_eq!((report.outcome.as_str(), report.invariants.broken, report.agents.alive), ("built", 0, 41));
    assert_eq!(surprises(&report), [""; 0]);
    daemons.end();
}

#[test]
fn a_host_that_is_not_there_is_named() {
    let daemons = tempfile::tempdir().unwrap();
    let file = daemons.path().join("hosts.toml");
    let socket = daemons.path().join("h2.sock");
    let host = |name: &str, address: &str| format!("[[host]]\nname = \"{name}\"\naddress = \"{address}\"\n");
    let text = [TIMES, &host("h1", "local"), &host("h2", &format!("unix:{}", socket.display()))].concat();
    fs::write(&file, text).unwrap();
    let swarm = scenario("swarm.toml").display().to_string();
    let ran = run(&["run", &swarm, "--hosts", &file.display().to_string()]);
    assert_eq!((ran.code, ran.out.as_str()), (Some(1), ""), "{ran:?}");
    assert!(
        ran.err.contains("h2 cannot be reached") && ran.err.contains("fix: start `metamorph host"),
        "{ran:?}"
    );
    let refused = run(&["check", &swarm, "--hosts", "50"]);
    assert_eq!(refused.code, Some(2), "{refused:?}");
    assert!(refused.err.contains("the number of hosts is 50"), "{refused:?}");
}
