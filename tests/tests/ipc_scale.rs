//! Swarms of processes that are large for the limits of the system: the controller works with fewer
//! descriptors than connections to all agents would need, and reports when even those are too few.

use metamorph_tests::command::{Ran, metamorph, root, scenario};
use serde_json::Value;
use std::process::{Command, Stdio};

/// Runs a scenario of 100 modules as processes with at most this many descriptors.
fn line_to_box(descriptors: u32) -> Ran {
    let mut shell = Command::new("sh");
    shell.args(["-c", &format!("ulimit -n {descriptors}; exec \"$0\" \"$@\"")]).arg(metamorph());
    shell.arg("run").arg(scenario("line-to-box.toml")).args(["--quiet", "--json", "-"]);
    let output = shell.stdin(Stdio::null()).current_dir(root()).output();
    output.expect("a shell can be started").into()
}

#[test]
fn connections_to_agents_are_closed_and_opened_again() {
    // Enough for 64 connections to 100 agents.
    let ran = line_to_box(1_200);
    assert_eq!((ran.code, ran.err.as_str()), (Some(0), ""));
    let report: Value = serde_json::from_str(&ran.out).expect("a report");
    assert_eq!(
        (report["outcome"].as_str(), report["agents"]["launched"].as_u64()),
        (Some("built"), Some(100))
    );
    assert_eq!(report["agents"]["crashed"].as_u64(), Some(0), "{}", report["agents"]);
}

#[test]
fn too_few_descriptors_are_refused() {
    let ran = line_to_box(900);
    assert_eq!((ran.code, ran.out.as_str()), (Some(1), ""));
    assert!(ran.err.contains("needs 1196 open files") && ran.err.contains("ulimit -Hn"), "{}", ran.err);
}
