//! Costs of a swarm of processes. Not a test: it only prints.
//!
//! `cargo test --release -p metamorph-tests ipc_measure:: -- --ignored --nocapture`

#![allow(clippy::print_stdout, reason = "printing is its purpose")]
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_module_agent::clock::monotonic;
use metamorph_protocol::ids::{ModuleId, Port};
use metamorph_protocol::rng::Rng;
use metamorph_tests::chaos::{Controller, wait_until};
use metamorph_tests::probe::{ProbeSetup, ProbeWorld};
use metamorph_tests::script::Script;
use metamorph_tests::view::View;
use metamorph_world_controller::swarm::{SwarmOptions, run_swarm};
use serde_json::{Value, json};
use std::time::Duration;

const AGENT: &str = env!("CARGO_BIN_EXE_probe-agent");
const CONTROLLER: &str = env!("CARGO_BIN_EXE_probe-controller");

/// Returns the run time of all threads of a process in nanoseconds. Clock ticks would not do: a wake-up of
/// some microseconds once a second falls between them.
fn ran(pid: i32) -> u64 {
    let threads = std::fs::read_dir(format!("/proc/{pid}/task")).into_iter().flatten().flatten();
    let time = |thread: std::fs::DirEntry| -> Option<u64> {
        let text = std::fs::read_to_string(thread.path().join("schedstat")).ok()?;
        text.split_ascii_whitespace().next()?.parse().ok()
    };
    threads.filter_map(time).sum()
}

fn measure(count: u32) {
    let begun = monotonic();
    let controller = Controller::start(CONTROLLER, count, 0, &[AGENT]);
    let ready = monotonic();
    let agents = controller.agents();
    let all = || agents.iter().map(|a| ran(a.pid)).sum::<u64>();
    let (own, before) = (ran(controller.pid()), all());
    // An idle swarm announces no event, so this waits by the clock.
    std::thread::park_timeout(Duration::from_secs(10));
    let (own, idle) = (ran(controller.pid()) - own, all() - before);
    let stopping = monotonic();
    let came_to = controller.finish();
    let seconds = |ns: u64| ns as f64 / 1e9;
    println!(
        "{count} agents: up in {:.2} s, talked to by neighbours after {:.2} s, idle for 10 s at {:.2} % \
         of a core (agents) and {:.2} % (controller), stopped and removed in {:.2} s",
        came_to["setup_ms"] as f64 / 1e3,
        seconds(ready - begun),
        seconds(idle) / 10.0 * 100.0,
        seconds(own) / 10.0 * 100.0,
        seconds(monotonic() - stopping),
    );
}

#[test]
#[ignore = "prints figures of this machine"]
fn two_hundred_agents() {
    measure(200);
}

#[test]
#[ignore = "prints figures of this machine"]
fn a_thousand_agents() {
    measure(1_000);
}

/// Orders, reports and messages: the duration of one round over all of them.
#[test]
#[ignore = "prints figures of this machine"]
fn rounds_between_two_agents() {
    const ROUNDS: u32 = 2_000;
    let mut script = Script::new(2);
    for round in 0..ROUNDS {
        script = script.send(0, 1, round, 1).until("the next message", move |log| {
            log.0.len() > round as usize && log.got(ModuleId(1), Port(0)).last() == Some(&round)
        });
    }
    let options = SwarmOptions::new(AGENT.into());
    let outcome = run_swarm(&options, &ProbeSetup::default(), &mut ProbeWorld::line(2), &mut script).unwrap();
    let micros = outcome.wall.as_secs_f64() * 1e6 / f64::from(ROUNDS);
    println!("controller, agent, neighbour, controller: {micros:.0} microseconds");
}

/// A thousand cubes. With the module of the goal's first cell dead none of the others hears of the goal, so they are idle.
const THOUSAND: &str = "version = 1\n[swarm]\nstart = { box = { min = [0, 0, 0], max = [39, 24, 0] } }\nmove_time = \"1s\"\n\
    [[goal]]\nseed = [0, 0, 0]\nshape = { box = { min = [0, 0, 0], max = [9, 9, 8] } }\n[process]\ntime_scale = 1\n";
const IDLE: &str = "[[fault]]\nkill = 0\nat = \"0s\"\n[[fault]]\nkill = 1\nat = \"3000s\"\n";

/// Starts a run of a thousand processes, and waits until all have reported.
fn thousand(directory: &std::path::Path, is_idle: bool, options: &[&str]) -> View {
    let file = directory.join("thousand.toml");
    std::fs::write(&file, [THOUSAND, if is_idle { IDLE } else { "" }].concat()).unwrap();
    let file = file.display().to_string();
    let view = View::start(&[&["run", &file, "--link", "ipc", "--view", "--quiet"], options].concat());
    let mut heard = Told { view: &view, next: 0, events: Vec::new() };
    let mut reports = 0;
    wait_until("all processes to report", || {
        reports += heard.more().iter().filter(|event| event[0] == "s").count();
        reports >= 1_000
    });
    view
}

/// The events of a run that the page has been told.
struct Told<'v> {
    view: &'v View,
    next: u64,
    events: Vec<Value>,
}

impl Told<'_> {
    /// Asks for what is new.
    fn more(&mut self) -> &[Value] {
        let (_, content) = self.view.content(&format!("events?from={}&bin=1000000&width=0", self.next));
        let mut answer: Value = serde_json::from_slice(&content).unwrap();
        self.next = answer["next"].as_u64().unwrap();
        let Value::Array(events) = answer["events"].take() else { panic!("no events: {answer}") };
        self.events = events;
        &self.events
    }
}

fn show(what: &str, mut times: Vec<f64>) {
    times.sort_by(f64::total_cmp);
    let at = |share: usize| times[(times.len() - 1) * share / 100];
    println!(
        "{what}: {:.0} ms (half), {:.0} ms (95 %), {:.0} ms (all {})",
        at(50),
        at(95),
        at(100),
        times.len()
    );
}

/// The time from a command until the page has been told its effect, for faults of bodies and deaths of processes.
fn told_after(view: &View, commands: u64) {
    let mut told = Told { view, next: 0, events: Vec::new() };
    while !told.more().is_empty() {}
    let mut rng = Rng::named(1, "pauses between commands", 0);
    let (mut bodies, mut deaths) = (Vec::new(), Vec::new());
    for n in 1..=commands {
        std::thread::park_timeout(Duration::from_millis(50 + rng.below(50)));
        while !told.more().is_empty() {}
        let id = 2 + n;
        let is_death = n % 4 == 0;
        let command = format!("{} {id}", if is_death { "kill" } else { "stick" });
        let is_effect = |event: &Value| match is_death {
            true => event[0] == "l" && event[2] == id && event[3] == "dead",
            false => event[0] == "x" && event[3] == command.as_str(),
        };
        let begun = monotonic();
        let body = json!({ "version": 1, "session": "measure", "n": n, "commands": [command] });
        let (_, answer) = view.post(&body.to_string());
        assert_eq!(answer["result"], "taken", "{answer}");
        while !told.more().iter().any(is_effect) {}
        let times = if is_death { &mut deaths } else { &mut bodies };
        times.push((monotonic() - begun) as f64 / 1e6);
    }
    show("  a body is stuck, and told to the page", bodies);
    show("  a process is dead, and told to the page", deaths);
}

/// `cargo test --release -p metamorph-tests command_to_effect -- --ignored --nocapture`
#[test]
#[ignore = "prints figures of this machine"]
fn command_to_effect() {
    for (what, is_idle) in [("idle", true), ("at work", false)] {
        let directory = tempfile::tempdir().unwrap();
        let view = thousand(directory.path(), is_idle, &["--control"]);
        println!("1,000 processes, {what}; from a command until");
        told_after(&view, 200);
    }
}

/// What it costs that a run can be commanded, while nobody commands.
#[test]
#[ignore = "prints figures of this machine"]
fn control_of_an_idle_swarm() {
    for options in [&[][..], &["--control"]] {
        let directory = tempfile::tempdir().unwrap();
        let view = thousand(directory.path(), true, options);
        let pid = view.process.id() as i32;
        std::thread::park_timeout(Duration::from_secs(5));
        let before = ran(pid);
        // An idle swarm announces no event, so this waits by the clock.
        std::thread::park_timeout(Duration::from_secs(20));
        println!("{options:?}: the controller needs {:.2} % of a core", (ran(pid) - before) as f64 / 2e8);
    }
}
