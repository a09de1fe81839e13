//! Metamodules as processes build the thesis's box and chair, as `metamorph run` does.
#![allow(clippy::print_stdout, reason = "shown only on failure or with --nocapture")]

use metamorph_tests::chaos::signal_to;
use metamorph_tests::command::{Ran, command, scenario, surprises};
use metamorph_tests::statistics::{critical_distance, kolmogorov_smirnov, mean};
use metamorph_world_controller::report::schema::Report;
use rustix::process::Signal;
use std::process::Stdio;
use std::sync::mpsc;
use std::time::Duration;

/// The longest run. One that takes longer is asked to end, so that it removes its files.
const WATCHDOG: Duration = Duration::from_secs(240);

/// Runs a scenario that ships with the program, and returns its report after the common checks.
fn run(name: &str, link: &str, options: &[&str]) -> Report {
    let path = scenario(name).display().to_string();
    let fixed = ["run", path.as_str(), "--link", link, "--json", "-"];
    let mut command = command(&[&fixed, options].concat());
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts");
    let pid = child.id() as i32;
    let (sender, ended) = mpsc::channel();
    std::thread::spawn(move || sender.send(child.wait_with_output()));
    let Ok(output) = ended.recv_timeout(WATCHDOG) else {
        signal_to(pid, Signal::TERM);
        panic!("{name} {options:?} was not over in time");
    };
    let ran = Ran::from(output.expect("a child can be waited for"));
    let report: Report = serde_json::from_str(&ran.out).unwrap_or_else(|e| panic!("{e}: {ran:?}"));
    println!("{}", ran.err);
    assert_eq!((report.family.as_str(), report.link.as_str()), ("metamodule", link));
    assert_eq!((report.invariants.broken, report.collisions.suffered), (0, 0), "{:?}", report.invariants);
    assert_eq!(surprises(&report), [""; 0]);
    for (class, counts) in &report.messages.by_class {
        assert!(counts.in_flight >= counts.uncounted && counts.uncounted >= 0, "{class} {counts:?}");
    }
    report
}

/// Runs it as processes, fifty times as fast as real ones: in two to four seconds.
fn as_processes(name: &str, options: &[&str]) -> Report {
    run(name, "ipc", &[&["--time-scale", "50"], options].concat())
}

#[test]
fn a_box_of_four_processes() {
    let report = as_processes("box.toml", &["--seed", "3"]);
    assert_eq!((report.outcome.as_str(), report.goal.filled), ("built", 4), "{}", report.reason);
    assert_eq!((report.agents.launched, report.agents.alive), (4, 4));
    assert!(report.moves > 0 && report.messages.all.delivered > 0);
}

/// With all faults of the scenario: a kill, failed connections, lost messages. With this seed the fourth
/// connection is the first that fails, and a metamodule dies long before the chair can be done.
#[test]
fn a_chair_of_six_processes_while_things_break() {
    let report = as_processes("chair-hardware.toml", &["--seed", "18"]);
    let agents = (report.agents.launched, report.agents.alive, report.agents.crashed);
    assert_eq!((report.outcome.as_str(), report.goal.filled), ("built", 6), "{}", report.reason);
    assert_eq!(agents, (7, 6, 1));
    assert!(report.move_details.failed > 0 && report.messages.all.lost > 0);
    assert_eq!((report.faults.len(), report.faults[0].fault.as_str()), (1, "kill"));
}

#[test]
fn chairs_of_six_processes() {
    for seed in ["4", "5"] {
        let report = as_processes("chair.toml", &["--seed", seed]);
        let came_to = (report.outcome.as_str(), report.goal.filled, report.agents.crashed);
        assert_eq!(came_to, ("built", 6, 0), "seed {seed}: {}", report.reason);
    }
}

/// The controller plans, and plans anew when a metamodule dies and when a connection fails for long.
#[test]
fn a_planned_chair_of_processes_while_things_break() {
    let planned = ["--seed", "18", "--set", "protocol.strategy=planned"];
    let report = as_processes("chair-hardware.toml", &planned);
    assert_eq!((report.outcome.as_str(), report.goal.filled), ("built", 6), "{}", report.reason);
    assert_eq!((report.agents.launched, report.agents.crashed), (7, 1));
    let plan = &report.family_parts["metamodules"]["plan"];
    assert!(plan["plans"].as_u64() > Some(1) && plan["orders"].as_u64() > Some(0), "{plan}");
}

/// Processes detect among themselves that they are at a standstill; greedy ones with a chair are, in half of
/// the runs. By their precedence some of them wait for others only, not for a lock.
#[test]
fn processes_find_their_deadlock() {
    let greedy = ["--set", "protocol.strategy=greedy", "--set", "protocol.detector=true"];
    let found = (1..=8).map(|seed| seed.to_string()).find_map(|seed| {
        let report = as_processes("chair.toml", &[&greedy[..], &["--seed", &seed]].concat());
        let standstill = report.unbuilt.filter(|_| report.outcome == "deadlock")?;
        standstill.detected.map(|found| (found, standstill.waiting))
    });
    let (found, waiting) = found.expect("no deadlock was found in eight runs");
    assert!(found.at_s <= 500.0 && waiting.iter().any(|w| w.module == found.by), "{found:?} {waiting:?}");
}

/// Compares the simulator with processes: from the same starts, over links with the same delays, both build,
/// with as many moves. Processes do not repeat a run event by event, so the distributions are compared.
///
/// At fifty times real speed a millisecond that a process is late counts as 50 ms of scenario time, which is
/// within the 10 to 100 ms of the links' delays; at ten times that speed the scheduler would decide which
/// goes first, and slower runs would only take longer.
fn compare(name: &str, seeds: std::ops::RangeInclusive<u64>) {
    let (mut real, mut simulated) = (Vec::new(), Vec::new());
    for seed in seeds {
        let number = seed.to_string();
        let options = ["--seed", number.as_str(), "--delay", "10ms..100ms"];
        let (r, s) = (as_processes(name, &options), run(name, "sim", &options));
        let repeat = (&r.repeat, &s.repeat);
        assert_eq!(r.outcome, s.outcome, "{name}, seed {seed}: {} / {}: {repeat:?}", r.reason, s.reason);
        real.push(r.moves);
        simulated.push(s.moves);
    }
    let distance = kolmogorov_smirnov(&real, &simulated);
    let most = critical_distance(real.len(), simulated.len());
    println!(
        "{name}, {} seeds: {:.2} moves by processes, {:.2} simulated; KS distance {distance:.3}, 1% level {most:.3}",
        real.len(),
        mean(&real),
        mean(&simulated)
    );
    assert!(distance <= most, "{name}: {distance} is more than {most}: {real:?} {simulated:?}");
}

/// `cargo test -p metamorph-tests boxes_of_processes_and_simulated -- --ignored --nocapture`
#[test]
#[ignore = "minutes: fifty runs of processes"]
fn boxes_of_processes_and_simulated_are_alike() {
    compare("box.toml", 1..=50);
}

/// `cargo test -p metamorph-tests chairs_of_processes_and_simulated -- --ignored --nocapture`
#[test]
#[ignore = "minutes: fifty runs of processes"]
fn chairs_of_processes_and_simulated_are_alike() {
    compare("chair.toml", 1..=50);
}
