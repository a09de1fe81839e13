//! Metrics of runs and daemons: the text, the server, and the files that name metrics.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_protocol::counters::{Class, Tally};
use metamorph_protocol::host_link::{ClockInterval, State};
use metamorph_protocol::ids::HostId;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::director::progress::Progress;
use metamorph_tests::chaos::{signal_to, wait_until};
use metamorph_tests::command::{report, root, run};
use metamorph_tests::open_metrics::{Read, read};
use metamorph_tests::view::View;
use metamorph_world_controller::family::read_text;
use metamorph_world_controller::metrics::catalogue::{ALL, COMMON_LABELS};
use metamorph_world_controller::metrics::open_metrics::CONTENT_TYPE;
use metamorph_world_controller::metrics::{Metrics, Peer};
use metamorph_world_controller::scenario::Overrides;
use rustix::process::Signal;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::net::TcpListener;

/// A name in which every character has to be escaped, or is not of ASCII.
const HARD: &str = "a \"b\" \\ é";

/// Asserts that a text has only metrics of the catalogue, described as there.
fn checked(text: &str) -> BTreeMap<String, Read> {
    let metrics = read(text).unwrap_or_else(|error| panic!("{error}\n{text}"));
    for (name, found) in &metrics {
        let metric = ALL.iter().find(|metric| metric.name == name).expect("the catalogue has it");
        let unit = metric.unit.unwrap_or_default();
        assert_eq!((&*found.kind, &*found.unit, &*found.help), (metric.kind.name(), unit, metric.meaning));
        let mut known: BTreeSet<&str> = metric.labels.iter().chain(&COMMON_LABELS).copied().collect();
        known.insert(metric.name);
        for (_, labels, _) in &found.samples {
            assert!(labels.keys().all(|label| known.contains(&**label)), "{labels:?}");
            assert!(COMMON_LABELS.iter().all(|label| labels.contains_key(*label)), "{labels:?}");
        }
    }
    metrics
}

/// Scrapes, and returns what is served.
fn scraped(view: &View) -> BTreeMap<String, Read> {
    let (head, body) = view.content("");
    assert!(head.starts_with("HTTP/1.1 200 "), "{head}");
    assert!(head.to_lowercase().contains(&format!("content-type: {CONTENT_TYPE}\r\n")), "{head}");
    checked(&String::from_utf8(body).unwrap())
}

/// Returns the state of the run.
fn state(metrics: &BTreeMap<String, Read>) -> &str {
    let states = &metrics["metamorph_run_state"].samples;
    let holding: Vec<_> = states.iter().filter(|(.., value)| value == "1").collect();
    assert_eq!((states.len(), holding.len()), (4, 1));
    &holding[0].1["metamorph_run_state"]
}

fn number(metrics: &BTreeMap<String, Read>, name: &str) -> f64 {
    metrics.get(name).map_or(0.0, |metric| metric.value(&[]).parse().unwrap())
}

fn run_label(metrics: &BTreeMap<String, Read>) -> String {
    metrics["metamorph_run"].samples[0].1["run"].clone()
}

#[test]
fn the_text_is_read_back_with_all_that_was_noted() {
    let metrics = Metrics::default();
    let idle = checked(&metrics.text());
    assert_eq!((state(&idle), idle.len()), ("idle", 2));

    let text = fs::read_to_string(root().join("deploy/scenarios/swarm.toml")).unwrap();
    let named = format!("name = '{HARD}'\n");
    let text: String =
        text.lines().filter(|line| !line.starts_with("name")).map(|l| l.to_owned() + "\n").collect();
    metrics.describe(&read_text("s.toml", &(named + &text), &Overrides::default()).unwrap());
    metrics.begin("one\ntwo \\ \"three\"", HostId(1), None);
    assert_eq!(state(&checked(&metrics.text())), "starting");

    let mut tally = Tally::default();
    tally[Class::Seed].sent = 7;
    tally[Class::Seed].lost = 2;
    tally[Class::Gait].bytes = u64::MAX;
    let progress = Progress {
        stage: 1,
        goal: 9,
        filled: 4,
        alive: 3,
        moves: 5,
        standstills: 2,
        restarts: 1,
        ..Progress::default()
    };
    metrics.note_simulated(true, || (Time::ZERO + Span::millis(1_250), tally, progress));
    let clock = Some(ClockInterval { low: -3, high: 7_000_000_000 });
    let peers = [
        (HostId(0), Peer { state: State::Up, clock }),
        (HostId(2), Peer { state: State::Down, clock: None }),
    ];
    metrics.note_links(|| (BTreeMap::from(peers), 2));
    let noted = checked(&metrics.text());
    assert_eq!(noted.len(), ALL.len() - 1, "all but the speed of a clock");
    assert_eq!(run_label(&noted), "one\ntwo \\ \"three\"");
    assert_eq!(noted["metamorph_run"].value(&[("scenario", HARD), ("link", "ipc"), ("host", "h2")]), "1");
    assert_eq!(state(&noted), "running");
    for (name, value) in [
        ("metamorph_scenario_time_seconds", "1.250000000"),
        ("metamorph_agents_alive", "3"),
        ("metamorph_host_agents_alive", "2"),
        ("metamorph_moves", "5"),
        ("metamorph_standstills", "2"),
        ("metamorph_restarts", "1"),
        ("metamorph_goal", "2"),
        ("metamorph_goal_cells", "9"),
        ("metamorph_goal_cells_filled", "4"),
    ] {
        assert_eq!(noted[name].value(&[]), value, "{name}");
    }
    let messages = &noted["metamorph_messages"];
    assert_eq!(messages.samples.len(), Class::ALL.len() * 7);
    assert_eq!(messages.value(&[("class", "seed"), ("fate", "lost")]), "2");
    assert_eq!(messages.sum(("fate", "sent")), 7);
    assert_eq!(noted["metamorph_sent_bytes"].value(&[("class", "gait")]), u64::MAX.to_string());
    let up = [("peer", "h1"), ("metamorph_link_state", "up")];
    assert_eq!(noted["metamorph_link_state"].value(&up), "1");
    let widths = &noted["metamorph_clock_interval_seconds"];
    assert_eq!((widths.samples.len(), widths.value(&[("peer", "h1")])), (1, "7.000000003"));

    metrics.end(Some(progress));
    assert_eq!(state(&checked(&metrics.text())), "ended");
}

#[test]
fn a_run_of_processes_and_its_daemon_are_scraped() {
    let directory = tempfile::tempdir().unwrap();
    let path = |name: &str| directory.path().join(name).display().to_string();
    let (socket, json) = (path("h2.sock"), path("run.json"));
    let daemon = View::start(&["host", "--listen", &socket, "--metrics", "0"]);
    assert_eq!(state(&scraped(&daemon)), "idle");
    for (request, status) in [("GET / ", 404), ("POST /metrics ", 405), ("GET /metrics/x ", 404)] {
        let request = format!("{request}HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n");
        assert_eq!(daemon.raw(&request).0, status, "{request}");
    }
    let hosts = format!(
        "version = 1\n[[host]]\nname = \"h1\"\naddress = \"local\"\n[[host]]\nname = \"h2\"\naddress = \"unix:{socket}\"\n"
    );
    fs::write(path("hosts.toml"), hosts).unwrap();
    let mut controller =
        View::start(&["run", "swarm", "--hosts", &path("hosts.toml"), "--metrics", ":0", "--json", &json]);
    let (mut here, mut there) = (scraped(&controller), scraped(&daemon));
    wait_until("all to be served while the run lasts", || {
        (here, there) = (scraped(&controller), scraped(&daemon));
        [&here, &there].iter().all(|metrics| {
            state(metrics) == "running"
                && metrics.contains_key("metamorph_link_state")
                && metrics["metamorph_messages"].sum(("fate", "delivered")) > 0
                && number(metrics, "metamorph_scenario_time_seconds") > 0.0
        }) && number(&here, "metamorph_moves") > 0.0
    });
    let name = run_label(&here);
    assert_eq!((name.starts_with("mm"), run_label(&there)), (true, name.clone()));
    assert_eq!(number(&here, "metamorph_modules"), 42.0);
    // One of them is killed in the course of the run.
    assert!(number(&here, "metamorph_agents_alive") >= 41.0);
    for metrics in [&here, &there] {
        assert!((20.0..=21.0).contains(&number(metrics, "metamorph_host_agents_alive")));
    }
    for (metrics, peer) in [(&here, "h2"), (&there, "h1")] {
        let up = [("peer", peer), ("metamorph_link_state", "up")];
        assert_eq!(metrics["metamorph_link_state"].value(&up), "1");
    }
    assert!(controller.process.wait().unwrap().success());
    wait_until("the daemon to end its share", || state(&scraped(&daemon)) == "ended");
    let after = scraped(&daemon);
    assert!(
        after["metamorph_messages"].sum(("fate", "sent"))
            >= there["metamorph_messages"].sum(("fate", "sent"))
    );
    let logs = report(&fs::read_to_string(&json).unwrap()).logs.unwrap();
    assert_eq!(logs.run, name);
    assert!(logs.hosts[1].place.contains(&socket), "{logs:?}");
    signal_to(daemon.process.id() as i32, Signal::TERM);
}

#[test]
fn a_simulated_run_is_served_as_well() {
    let run = View::start(&["run", "swarm", "--link", "sim", "--view", "--metrics", "0"]);
    wait_until("the run to end", || state(&scraped(&run)) == "ended");
    let ended = scraped(&run);
    assert!(number(&ended, "metamorph_moves") > 0.0);
    assert_eq!(number(&ended, "metamorph_goal_cells"), number(&ended, "metamorph_goal_cells_filled"));
    assert!(ended["metamorph_messages"].sum(("fate", "delivered")) > 0);
    assert_eq!(ended["metamorph_run"].value(&[("link", "sim"), ("scenario", "swarm")]), "1");
}

#[test]
fn an_address_that_cannot_be_used_is_an_error_before_the_run() {
    let taken = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let directory = tempfile::tempdir().unwrap();
    let socket = directory.path().join("h2.sock").display().to_string();
    let resumed = directory.path().join("none.journal").display().to_string();
    for command in [&["run", "swarm", "--link", "sim"][..], &["run", "swarm"], &["host", "--listen", &socket]]
    {
        let ran = run(&[command, &["--metrics", &port]].concat());
        assert_eq!((ran.code, ran.out.as_str()), (Some(2), ""), "{ran:?}");
        assert!(ran.err.contains(&format!("--metrics 127.0.0.1:{port}: ")), "{ran:?}");
        assert!(ran.err.contains("\n  fix: name another port"), "{ran:?}");
        let ran = run(&[command, &["--metrics", "10.0.0.1"]].concat());
        assert_eq!(ran.code, Some(2), "{ran:?}");
        assert!(ran.err.contains("--metrics") && ran.err.contains("fix: write a port"), "{ran:?}");
    }
    assert!(!std::path::Path::new(&socket).exists());
    for refused in
        [&["host", "--status", &socket][..], &["replay", &resumed], &["sweep", "swarm", "--seeds", "0..1"]]
    {
        let ran = run(&[refused, &["--metrics", "0"]].concat());
        assert_eq!(ran.code, Some(2), "{ran:?}");
        assert!(ran.err.contains("--metrics"), "{ran:?}");
    }
}

#[test]
fn the_dashboard_names_only_metrics_that_exist() {
    let text = fs::read_to_string(root().join("deploy/metrics/dashboard.json")).unwrap();
    let dashboard: serde_json::Value = serde_json::from_str(&text).unwrap();
    let mut texts = Vec::new();
    let mut left = vec![&dashboard];
    while let Some(value) = left.pop() {
        match value {
            serde_json::Value::String(text) => texts.push(text.as_str()),
            serde_json::Value::Array(values) => left.extend(values),
            serde_json::Value::Object(values) => left.extend(values.values()),
            _ => {}
        }
    }
    let words = texts.iter().flat_map(|text| text.split(|c: char| !c.is_ascii_alphanumeric() && c != '_'));
    let named: BTreeSet<&str> = words.filter(|word| word.starts_with("metamorph_")).collect();
    // Sets of states have a label of their own name.
    let known: BTreeSet<String> = ALL.iter().map(|metric| metric.sample()).collect();
    let unknown: Vec<_> = named.iter().filter(|name| !known.contains(**name)).collect();
    assert!(unknown.is_empty(), "{unknown:?}");
    let unshown: Vec<_> = known.iter().filter(|name| !named.contains(name.as_str())).collect();
    assert!(unshown.is_empty(), "the dashboard shows all, but not {unshown:?}");
}
