//! Costs of a swarm of processes. Not a test: it only prints.
//!
//! `cargo test --release --test ipc_measure -- --ignored --nocapture`

#![allow(clippy::print_stdout, reason = "printing is its purpose")]

use metamorph_module_agent::clock::monotonic;
use metamorph_protocol::ids::{ModuleId, Port};
use metamorph_tests::chaos::Controller;
use metamorph_tests::probe::{ProbeSetup, ProbeWorld};
use metamorph_tests::script::Script;
use metamorph_world_controller::swarm::{SwarmOptions, run_swarm};
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
