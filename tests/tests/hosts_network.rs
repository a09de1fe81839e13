//! A swarm on three machines, played by network namespaces, whose cables are pulled.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_module_agent::journal_file::Reader;
use metamorph_tests::chaos::wait_until;
use metamorph_tests::command::{report, run, scenario};
use metamorph_tests::network::{Machines, SshSite};
use metamorph_tests::required::{Check, skip};
use metamorph_world_controller::record::journal::{Event, parts_of};
use std::fs;
use std::time::Duration;

/// Real time for which h2 is cut off: longer than zenoh's thread once waited for the end of a dead connection (10 s).
const CUT: Duration = Duration::from_secs(15);

/// While h2 is silent, h1 and h3 hear each other: their link never has a silence of 5 s, and neither counts as dead.
#[test]
fn a_silent_machine_silences_nobody_else() {
    let machines = match Machines::start("silent = \"5s\"\nfence = \"30s\"\nclock_error = \"20ms\"\n") {
        Ok(machines) => machines,
        Err(why) => return skip(Check::Namespaces, &why),
    };
    let [hosts, journal, out] = ["hosts.toml", "run.journal", "report.json"].map(|name| machines.text(name));
    let swarm = scenario("swarm.toml").display().to_string();
    let args = ["-v", "run", &swarm, "--hosts", &hosts, "--journal", &journal, "--json", &out, "--quiet"];
    let log = fs::File::create(machines.path("h1.log")).unwrap();
    let mut ran = machines.network.command(1, &args).stderr(log).spawn().unwrap();
    let controller = parts_of(journal.as_ref()).join("controller");
    wait_until("the run to begin", || {
        let records = Reader::open(&controller).into_iter().flatten();
        records.map_while(Result::ok).any(|record| matches!(record.event, Event::Act { .. }))
    });
    machines.network.cut(2, true);
    std::thread::park_timeout(CUT);
    machines.network.cut(2, false);
    let mut status = None;
    wait_until("the run to end", || {
        status = ran.try_wait().unwrap();
        status.is_some()
    });
    let said = [1, 2, 3].map(|host| machines.log(host));
    assert_eq!(status.unwrap().code(), Some(0), "{said:?}");
    assert!(said[0].contains("h2 is silent") && !said[0].contains("h3 is silent"), "{}", said[0]);
    assert!(!said[2].contains("the link to h1 is Silent"), "{}", said[2]);
    let report = report(&fs::read_to_string(&out).unwrap());
    let hosts = report.hosts.unwrap().hosts;
    assert!(hosts.iter().all(|host| host.lost_s.is_none()), "{hosts:?}");
    assert_eq!((report.outcome.as_str(), report.invariants.broken), ("built", 0), "{:?}", report.notes);
    let replayed = run(&["replay", &journal, "--quiet"]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
}

/// From empty machines to a swarm that is built: keys, program and daemons by one command over ssh, twice, and their end.
#[test]
fn a_cluster_of_empty_machines_is_started_over_ssh() {
    let site = match SshSite::start() {
        Ok(site) => site,
        Err(why) => return skip(Check::Namespaces, &why),
    };
    let hosts = site.text("hosts.toml");
    let cluster = |action: &str| site.run(&["cluster", action, &hosts]);
    let ran = site.run(&["cluster", "up", &hosts, "--metrics", "9100"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    for part in
        ["h2: a new certificate", "program copied, keys copied, daemon started", "serves no run, room for"]
    {
        assert!(ran.out.contains(part), "`{part}` is missing: {ran:?}");
    }
    // What is there is left alone.
    let again = cluster("up");
    assert!(again.code == Some(0) && again.out.matches(": it runs").count() == 2, "{again:?}");
    let out = site.text("report.json");
    let swarm = scenario("swarm.toml").display().to_string();
    let ran = site.run(&["run", &swarm, "--hosts", &hosts, "--json", &out, "--quiet"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    assert_eq!(report(&fs::read_to_string(&out).unwrap()).outcome, "built");
    let logs = cluster("logs").out;
    assert!(logs.contains("is over: it is finished") && logs.matches(":9100/metrics").count() == 2, "{logs}");
    let ended = cluster("down");
    assert!(ended.code == Some(0) && ended.out == "h2: ended\nh3: ended\n", "{ended:?}");
    assert_eq!(cluster("status").code, Some(1));
}
