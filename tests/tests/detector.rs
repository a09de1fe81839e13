//! Metamodules detect a standstill among themselves: never while one can go on, and always when none can, on
//! all links.
#![allow(clippy::print_stdout, reason = "rates are shown with --nocapture")]

use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::metamodule::blueprint::SeedOrder;
use metamorph_protocol::metamodule::params::Strategy;
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::time::Time;
use metamorph_sim_bridge::director::faults::Fault;
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_tests::metamodules::{Assembled, Assembly, Goal};

type Vary = fn(Assembly) -> Assembly;

const LINKS: [(&str, Vary); 4] = [
    ("plain", |a| a),
    ("told by neighbours", Assembly::decentralised),
    ("5% lost, 5% doubled, some late", |a| {
        let mut a = a.loss("5%");
        a.link.duplicate = "5%".parse().expect("invariant: tests name probabilities");
        a.link.reorder = "5%".parse().expect("invariant: tests name probabilities");
        a
    }),
    ("one spare, one crash, failed connections", |a| {
        a.spares(1).failed_connections("5%").fault(Time(20_000_000_000), Fault::Kill(ModuleId(1)))
    }),
];

/// Totals of many runs.
#[derive(Default)]
struct Sum {
    runs: u32,
    built: u32,
    stood_still: u32,
    found: u32,
    turns: u64,
}

/// Runs to the end, regardless of what the metamodules detect, and compares.
fn agree(kinds: &[Kind], seeds: std::ops::Range<u64>) {
    for (name, vary) in LINKS {
        for strategy in Strategy::PUBLISHED {
            let mut sum = Sum::default();
            for (goal, kind) in Goal::ALL.into_iter().flat_map(|g| kinds.iter().map(move |k| (g, *k))) {
                for seed in seeds.clone() {
                    let run = || vary(Assembly::new(goal, kind, strategy, SeedOrder::Circular, seed));
                    judge(
                        &mut sum,
                        &run().detecting().run(),
                        &format!("{name}, {strategy:?}, {goal:?}, {kind:?}, seed {seed}"),
                    );
                }
            }
            let Sum { runs, built, stood_still, found, turns } = sum;
            // Lost messages may delay the detection beyond the bound.
            assert!(
                found == stood_still || (name != "plain" && found > 0),
                "{name}, {strategy:?}: {found} of {stood_still}"
            );
            let after = turns / u64::from(found.max(1));
            println!(
                "{name}, {strategy:?}: {runs} runs, {built} built with 0 alarms, {found} of {stood_still} standstills found, after {after} turns on average"
            );
        }
    }
}

fn judge(sum: &mut Sum, ran: &Assembled, name: &str) {
    let (end, outcome) = ran.outcome.expect("every run ends");
    sum.runs += 1;
    assert_eq!(ran.broken, 0, "{name}");
    match outcome {
        Outcome::Built => {
            assert_eq!(ran.alarms, 0, "{name}: a metamodule could go on");
            sum.built += 1;
        }
        Outcome::Deadlock => {
            sum.stood_still += 1;
            let since = ran.stall.as_ref().expect("a standstill is explained").since;
            if let Some((at, _)) = ran.detected {
                assert!(since <= at && at <= end, "{name}: a metamodule went on after {at}");
                sum.found += 1;
                sum.turns += at.since(since).0 / 1_000_000_000;
            }
            assert!(ran.alarms == 0 || ran.detected.is_some(), "{name}: an alarm was taken back");
        }
        other => assert_eq!(ran.alarms, 0, "{name}: {other}"),
    }
}

#[test]
fn agrees_with_the_ground_truth() {
    agree(&[Kind::Srs], 0..4);
}

#[test]
#[ignore = "minutes"]
fn agrees_with_the_ground_truth_over_many_seeds() {
    agree(&Kind::METAMODULES, 0..50);
}

/// The run ends with the alarm, and the report says what each metamodule waits for.
#[test]
fn a_deadlock_ends_with_the_alarm() {
    let run = |seed| Assembly::new(Goal::Chair, Kind::Srs, Strategy::Greedy, SeedOrder::Circular, seed);
    let stands_still = |seed: &u64| matches!(run(*seed).run().outcome, Some((_, Outcome::Deadlock)));
    let seed = (0..20).find(stands_still).expect("greedy deadlocks often");
    let mut heeding = run(seed).detecting();
    heeding.follow = true;
    let ran = heeding.run();
    let (end, outcome) = ran.outcome.expect("every run ends");
    assert_eq!(outcome, Outcome::Deadlock);
    let stall = ran.stall.expect("a standstill is explained");
    assert!(stall.detected.is_some_and(|(at, _)| at <= end));
    assert!(!stall.waiting.is_empty() && !stall.open.is_empty());
}
