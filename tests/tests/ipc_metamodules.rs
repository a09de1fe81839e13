//! The real thing: metamodules as processes run the thesis's box and chair, as `metamorph run` does.

use metamorph_tests::chaos::signal_to;
use metamorph_tests::command::{Ran, command, scenario};
use metamorph_world_controller::report::schema::Report;
use rustix::process::Signal;
use std::process::Stdio;
use std::sync::mpsc;
use std::time::Duration;

/// No run takes longer. One that does is asked to end, so that it removes what it has made.
const WATCHDOG: Duration = Duration::from_secs(240);

/// Runs a scenario that ships with the program as processes, fifty times as fast as real ones.
fn as_processes(name: &str, options: &[&str]) -> Report {
    let path = scenario(name).display().to_string();
    let fixed = ["run", path.as_str(), "--link", "ipc", "--time-scale", "50", "--json", "-"];
    let mut command = command(&[&fixed, options].concat());
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts");
    let pid = child.id() as i32;
    let (sender, ended) = mpsc::channel();
    std::thread::spawn(move || sender.send(child.wait_with_output()));
    let Ok(output) = ended.recv_timeout(WATCHDOG) else {
        signal_to(pid, Signal::TERM);
        panic!("{name} was not over in time");
    };
    let ran = Ran::from(output.expect("a child can be waited for"));
    let report: Report = serde_json::from_str(&ran.out).unwrap_or_else(|e| panic!("{e}: {ran:?}"));
    #[allow(clippy::print_stdout, reason = "shown only when the test fails or is asked to")]
    {
        println!("{}", ran.err);
    }
    assert_eq!((report.family.as_str(), report.link.as_str()), ("metamodule", "ipc"));
    assert_eq!((report.invariants.broken, report.collisions.suffered), (0, 0), "{:?}", report.invariants);
    assert_eq!(report.notes, [""; 0]);
    for (class, counts) in &report.messages.by_class {
        assert!(counts.in_flight >= 0, "{class} {counts:?}");
    }
    report
}

#[test]
fn a_box_of_four_processes() {
    let report = as_processes("box.toml", &["--seed", "3"]);
    assert_eq!((report.outcome.as_str(), report.goal.filled), ("built", 4), "{}", report.reason);
    assert_eq!((report.agents.launched, report.agents.alive), (4, 4));
    assert!(report.moves > 0 && report.messages.all.delivered > 0);
}

/// With all that the scenario breaks: a kill, failed connections, lost messages. With this seed the
/// fourth connection is the first that fails, and somebody dies long before the chair can be done.
#[test]
fn a_chair_of_six_processes_while_things_break() {
    let report = as_processes("chair-hardware.toml", &["--seed", "18"]);
    let agents = (report.agents.launched, report.agents.alive, report.agents.crashed);
    assert_eq!((report.outcome.as_str(), report.goal.filled), ("built", 6), "{}", report.reason);
    assert_eq!(agents, (7, 6, 1));
    assert!(report.move_details.failed > 0 && report.messages.all.lost > 0);
    assert_eq!((report.faults.len(), report.faults[0].fault.as_str()), (1, "kill"));
}
