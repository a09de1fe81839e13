//! How many structures walk on after a failure, over many seeds: how fast, after how many gaits.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]
#![allow(clippy::print_stdout, reason = "shown only on failure or with --nocapture")]

use metamorph_tests::command::{report, run, scenario};
use serde_json::Value;

/// The number of seeds of the long tests, unless `METAMORPH_SEEDS` names another.
const SEEDS: u64 = 100;

fn seeds() -> u64 {
    std::env::var("METAMORPH_SEEDS").ok().and_then(|text| text.parse().ok()).unwrap_or(SEEDS)
}

/// How a structure walked on.
#[derive(Debug)]
struct Recovery {
    /// The speed before in mm/s.
    before: f64,
    /// The speed of the gait walked before.
    first: f64,
    /// The speed of the best gait.
    best: f64,
    /// Gaits tried.
    tried: u64,
}

impl Recovery {
    fn share(&self) -> f64 {
        self.best / self.before
    }
}

/// Kills a module after 30 s, and lets the others try gaits: known ones only of the whole structure.
fn recover(dead: u64, trials: u64, learner: &str, seed: u64) -> Recovery {
    let path = scenario("quadruped.toml").display().to_string();
    let (seed, kill) = (seed.to_string(), format!("{dead}@30s"));
    // No speed is enough for the goal, so that all gaits are tried.
    let timeout = format!("stop.timeout={}s", 45 + 16 * trials);
    let (trials, learner) = (format!("protocol.trials={trials}"), format!("protocol.relearn={learner}"));
    let mut args =
        vec!["run", path.as_str(), "--link", "sim", "--seed", &seed, "--kill", &kill, "--json", "-"];
    let gaits = "protocol.gaits=[\"../gaits/quad5.json\"]";
    for set in [gaits, "goal.0.walk.speed_at_least=1000mm/s", &trials, &learner, &timeout] {
        args.extend(["--set", set]);
    }
    let ran = run(&args);
    let report = report(&ran.out);
    assert_eq!(report.invariants.broken, 0, "seed {seed}: {:?}", report.invariants);
    let all = report.family_parts["free_modules"]["situations"].as_array().unwrap().clone();
    let of = |situation: &Value, key: &str| situation[key].as_f64().unwrap_or(0.0);
    // After the death there may be more than one: a gait that was kept may become slow.
    let after: Vec<&Value> = all.iter().filter(|s| !s["dead"].as_array().unwrap().is_empty()).collect();
    Recovery {
        before: of(&all[0], "first_mm_s"),
        first: of(after[0], "first_mm_s"),
        best: of(after[0], "best_mm_s"),
        tried: after[0]["tried"].as_u64().unwrap(),
    }
}

/// Recovers with many seeds, prints what came of it, and returns the share of runs that reached a share of the speed.
fn recovered(dead: u64, trials: u64, learner: &str, seeds: std::ops::Range<u64>, enough: f64) -> f64 {
    let runs: Vec<Recovery> = seeds.clone().map(|seed| recover(dead, trials, learner, seed)).collect();
    let good = runs.iter().filter(|r| r.share() >= enough).count();
    let mean = |of: fn(&Recovery) -> f64| runs.iter().map(of).sum::<f64>() / runs.len() as f64;
    println!(
        "module {dead} dead, {learner}, seeds {seeds:?}: {good} of {} reach {:.0} % within {trials} gaits; on average \
         {:.1} mm/s before, {:.1} with the former gait, {:.1} with the best of {:.1}",
        runs.len(),
        100.0 * enough,
        mean(|r| r.before),
        mean(|r| r.first),
        mean(|r| r.best),
        mean(|r| r.tried as f64),
    );
    good as f64 / runs.len() as f64
}

/// A leg and the body die; one seed each.
#[test]
fn a_leg_and_the_body_are_done_without() {
    assert!(recovered(2, 20, "cma", 1..2, 0.8) == 1.0);
    assert!(recovered(0, 20, "cma", 1..2, 0.1) == 1.0);
}

/// `METAMORPH_SEEDS=100 cargo test --release -p metamorph-tests --test walking_recovery -- --ignored --nocapture legs`
#[test]
#[ignore = "an hour: four hundred runs, and as many of random search"]
fn legs_are_done_without() {
    let share = |learner| (1..5).map(|leg| recovered(leg, 20, learner, 0..seeds(), 0.8)).sum::<f64>() / 4.0;
    let (learnt, random) = (share("cma"), share("random"));
    println!("{:.1} % recover; with random search {:.1} %", 100.0 * learnt, 100.0 * random);
    assert!(learnt >= 0.95, "{learnt}");
}

/// `METAMORPH_SEEDS=100 cargo test --release -p metamorph-tests --test walking_recovery -- --ignored --nocapture the_body`
#[test]
#[ignore = "an hour: a hundred runs, and as many of random search"]
fn the_body_is_done_without() {
    let share = |learner| recovered(0, 40, learner, 0..seeds(), 0.3);
    let (learnt, random) = (share("cma"), share("random"));
    println!("{:.1} % recover; with random search {:.1} %", 100.0 * learnt, 100.0 * random);
    assert!(learnt >= 0.8, "{learnt}");
}
