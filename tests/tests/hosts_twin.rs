//! The simulated twin of a swarm on several hosts: with the same drawn loss between hosts, a run of processes and a simulated
//! one lose the same share of the messages that cross, class by class. Statistics, so runs on demand:
//!
//! `cargo test -p metamorph-tests hosts_twin:: -- --ignored --nocapture`
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]
#![allow(clippy::print_stdout, reason = "the figures are the result")]

use metamorph_tests::command::{report, run, run_processes, scenario};
use metamorph_world_controller::report::schema::Report;
use std::collections::BTreeMap;

/// Runs on each link.
const RUNS: u64 = 3;
/// The quantile of the normal distribution for an interval of 99 %, for six classes at once (Bonferroni).
const Z: f64 = 3.15;
/// Fewer messages of a class say nothing.
const LEAST: f64 = 200.0;

/// Of each class the messages that crossed and those that were lost, both as counted by the link that loses them.
type Fates = BTreeMap<String, (f64, f64)>;

/// Adds the fates of a run. Processes draw losses before a message reaches the link between hosts, the simulator on it.
fn add(fates: &mut Fates, report: &Report, is_simulated: bool) {
    for crossed in &report.hosts.as_ref().unwrap().crossed {
        for (class, counts) in &crossed.by_class {
            let (sent, lost) = fates.entry(class.clone()).or_default();
            *sent += counts.sent as f64;
            *lost += if is_simulated { counts.lost as f64 } else { 0.0 };
        }
    }
    if !is_simulated {
        for (class, counts) in &report.messages.by_class {
            let (sent, lost) = fates.entry(class.clone()).or_default();
            *sent += counts.lost as f64;
            *lost += counts.lost as f64;
        }
    }
}

fn fates(link: &str) -> Fates {
    let file = scenario("swarm.toml").display().to_string();
    let mut fates = Fates::new();
    for seed in 1..=RUNS {
        let seed = seed.to_string();
        let args = ["run", &file, "--hosts", "3", "--set", "link.between_hosts.loss=5%", "--json", "-"];
        let args = [&args[..], &["--quiet", "--seed", &seed, "--link", link]].concat();
        let ran = if link == "sim" { run(&args) } else { run_processes(&args) };
        let report = report(&ran.out);
        assert_eq!(report.invariants.broken, 0, "{ran:?}");
        add(&mut fates, &report, link == "sim");
    }
    fates
}

#[test]
#[ignore = "statistics: minutes of runs"]
fn processes_and_simulator_lose_the_same_share_of_what_crosses() {
    let (real, simulated) = (fates("ipc"), fates("sim"));
    let mut compared = 0;
    for (class, (sent, lost)) in &real {
        let Some((twin_sent, twin_lost)) = simulated.get(class) else { continue };
        if sent.min(*twin_sent) < LEAST {
            continue;
        }
        let (share, twin) = (lost / sent, twin_lost / twin_sent);
        let pooled = (lost + twin_lost) / (sent + twin_sent);
        let z = (share - twin) / (pooled * (1.0 - pooled) * (1.0 / sent + 1.0 / twin_sent)).sqrt();
        println!(
            "{class}: {lost} of {sent} ({:.2} %), simulated {twin_lost} of {twin_sent} ({:.2} %), z = {z:.2}",
            share * 100.0,
            twin * 100.0
        );
        assert!(z.abs() < Z, "{class}: z = {z}");
        compared += 1;
    }
    assert!(compared >= 3, "too few messages crossed: {real:?}");
}
