//! Measures the thesis's experiment over many seeds and prints a table:
//! `cargo run --release -p metamorph-tests --example metamodule_rates -- [SEEDS] [box|chair|all] [STRATEGY]`.
#![allow(
    clippy::print_stdout,
    clippy::disallowed_methods,
    reason = "a program for the terminal that measures"
)]

use metamorph_protocol::metamodule::blueprint::SeedOrder;
use metamorph_protocol::metamodule::params::Strategy;
use metamorph_protocol::roombots::Kind;
use metamorph_sim_bridge::outcome::Outcome;
use metamorph_tests::metamodules::{Assembly, Goal};

fn main() {
    let seeds: u64 = std::env::args().nth(1).and_then(|n| n.parse().ok()).unwrap_or(100);
    let only = std::env::args().nth(2).filter(|s| s != "all");
    let which = std::env::args().nth(3);
    println!(
        "goal  order      strategy kind  built dead live time unsafe | of built: moves turns collisions messages"
    );
    for (goal, order) in [
        (Goal::Box, SeedOrder::Circular),
        (Goal::Box, SeedOrder::Crosswise),
        (Goal::Box, SeedOrder::AtOnce),
        (Goal::Chair, SeedOrder::Circular),
        (Goal::Chair, SeedOrder::Crosswise),
        (Goal::Chair, SeedOrder::AtOnce),
    ] {
        if only.as_ref().is_some_and(|name| *name != format!("{goal:?}").to_lowercase()) {
            continue;
        }
        for strategy in Strategy::ALL {
            if which.as_ref().is_some_and(|name| name != strategy.name()) {
                continue;
            }
            for kind in Kind::METAMODULES {
                let (mut ends, mut unsafe_runs, mut sums) = ([0u64; 4], 0u64, [0u64; 4]);
                let since = std::time::Instant::now();
                for seed in 0..seeds {
                    let ran = Assembly::new(goal, kind, strategy, order, seed).run();
                    unsafe_runs += u64::from(ran.broken > 0);
                    match ran.outcome.map(|(_, o)| o) {
                        Some(Outcome::Built) => {
                            ends[0] += 1;
                            let ours =
                                [ran.deeds.moves, ran.deeds.turns, ran.collisions(), ran.tally.total().sent];
                            sums.iter_mut().zip(ours).for_each(|(s, v)| *s += v);
                        }
                        Some(Outcome::Deadlock) => ends[1] += 1,
                        Some(Outcome::Livelock) => ends[2] += 1,
                        _ => ends[3] += 1,
                    }
                    if strategy == Strategy::Negotiated && !ran.built() {
                        let stall = ran.stall.as_ref();
                        println!(
                            "  seed {seed}: {:?} {:?}",
                            stall.map(|s| s.reason),
                            stall.map(|s| &s.unfilled)
                        );
                    }
                }
                let mean = sums.map(|s| s as f64 / ends[0].max(1) as f64);
                println!(
                    "{:5} {:10} {:8} {:4} {:6} {:4} {:4} {:4} {:6} | {:5.1} {:5.1} {:5.2} {:6.0} | {:6.2} ms",
                    format!("{goal:?}").to_lowercase(),
                    order.name(),
                    strategy.name(),
                    kind,
                    ends[0],
                    ends[1],
                    ends[2],
                    ends[3],
                    unsafe_runs,
                    mean[0],
                    mean[1],
                    mean[2],
                    mean[3],
                    since.elapsed().as_secs_f64() * 1e3 / seeds as f64
                );
            }
        }
    }
}
