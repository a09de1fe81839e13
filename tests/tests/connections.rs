//! Connections that fail for a reason: a connector that is too far from its target does not close, and reports, journals and
//! the page say so.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{Ran, refused, report, run, run_processes, scenario};
use metamorph_world_controller::report::schema::Report;
use serde_json::Value;

const FREE: &str =
    "version = 1\n[swarm]\nfamily = \"free-module\"\nstart = \"line:4\"\n[[goal]]\nshape = \"loop:3x3\"\n";
const METAMODULES: &str =
    "version = 1\n[swarm]\nfamily = \"metamodule\"\n[[goal]]\nshape = { box = [5, 5] }\n";
const CUBES: &str = "version = 1\n[swarm]\nstart = { box = { min = [0, 0, 0], max = [2, 2, 0] } }\n[[goal]]\n\
                     shape = { box = { min = [0, 0, 0], max = [2, 2, 0] } }\n";

/// Returns the attempts to close a connector, those too far from their target, and those not caught.
fn connecting(report: &Report, family: &str) -> [u64; 3] {
    let part: &Value = &report.family_parts[family]["connecting"];
    ["attempts", "misaligned", "missed"].map(|key| part[key].as_u64().unwrap())
}

/// Every failed action of a run without stuck joints is one of these two, and the journal tells which.
fn is_told(ran: &Ran, journal: &str) {
    let all = report(&ran.out);
    assert_eq!((ran.code, all.invariants.broken), (Some(0), 0), "{ran:?}");
    let [attempts, misaligned, missed] = connecting(&all, "metamodules");
    assert!(attempts > 10 && misaligned > 0, "{attempts} {misaligned} {missed}");
    let histories = (0..7).map(|agent: u32| run(&["replay", journal, "--agent", &agent.to_string()]));
    let told: usize = histories
        .inspect(|ran| assert_eq!(ran.code, Some(0), "{ran:?}"))
        .map(|ran| ran.out.matches("its connector is too far from its target").count())
        .sum();
    // An attempt may be under way when the run ends, or when its module dies.
    let told = told as u64;
    assert!(told <= misaligned && misaligned - told <= 2, "{told} of {misaligned} are told");
}

#[test]
fn a_chair_is_built_on_joints_that_yield() {
    let dir = tempfile::tempdir().unwrap();
    let journal = dir.path().join("journal").display().to_string();
    let file = scenario("soft-joints.toml").display().to_string();
    let ran = run(&["run", &file, "--link", "sim", "--json", "-", "--journal", &journal]);
    is_told(&ran, &journal);
    let all = report(&ran.out);
    let [_, misaligned, missed] = connecting(&all, "metamodules");
    let (failed, begun) = (all.move_details.failed, misaligned + missed);
    assert!(failed <= begun && begun - failed <= 2, "{failed} actions have failed, {begun} attempts");
}

#[test]
fn processes_hear_why_a_connector_has_not_closed() {
    let dir = tempfile::tempdir().unwrap();
    let journal = dir.path().join("journal").display().to_string();
    let file = scenario("soft-joints.toml").display().to_string();
    let args = ["run", &file, "--time-scale", "50", "--json", "-", "--journal", &journal];
    is_told(&run_processes(&args), &journal);
}

/// Joints that yield too far close no connector, so that the swarm builds nothing.
#[test]
fn a_swarm_on_soft_joints_stands_still() {
    let file = scenario("soft-joints.toml").display().to_string();
    let soft = ["swarm.connection.compliance_deg_per_nm=5", "protocol.relocate=false"];
    let ran = run(&["run", &file, "--link", "sim", "--json", "-", "--set", soft[0], "--set", soft[1]]);
    let all = report(&ran.out);
    let [attempts, misaligned, _] = connecting(&all, "metamodules");
    assert_eq!((ran.code, all.invariants.broken), (Some(3), 0), "{ran:?}");
    assert!(attempts > 0 && attempts - misaligned <= 1 && all.moves == 0, "{ran:?}");
}

#[test]
fn free_modules_try_again() {
    let file = scenario("line-to-loop.toml").display().to_string();
    let noise = "swarm.connection.shift_noise_mm=6";
    let ran = run(&["run", &file, "--link", "sim", "--json", "-", "--set", noise]);
    let all = report(&ran.out);
    assert_eq!((ran.code, all.invariants.broken), (Some(0), 0), "{ran:?}");
    let [_, misaligned, _] = connecting(&all, "free_modules");
    assert!(misaligned > 0, "{ran:?}");
}

#[test]
fn values_without_sense_are_refused_at_their_place() {
    let with = |base: &str, keys: &str| base.replace("[[goal]]", &format!("{keys}\n[[goal]]"));
    let cases = [
        (with(METAMODULES, "connection = { shift_mm = -1 }"), "shift_mm"),
        (with(METAMODULES, "connection = { shift = 1 }"), "shift_mm"),
        (with(METAMODULES, "connection = 4"), "compliance_deg_per_nm = 0.8"),
        (with(FREE, "connection = { compliance_deg_per_nm = 0.1 }"), "shift_noise_mm"),
        (with(&FREE.replace("start", "body = \"physics\"\nstart"), "connection = {}"), "connection"),
        (with(CUBES, "connection = {}"), "connection"),
    ];
    for (text, part) in cases {
        refused(&text, &["check", "{}"], &[part]);
    }
}
