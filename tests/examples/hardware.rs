//! The hardware-like profile over many seeds: 5 % of connections fail, 1 % of messages are lost, one
//! metamodule crashes at a random time, one is spare.
//! `cargo run --release -p metamorph-tests --example hardware -- [FROM] [TO] [box|chair]`.
#![allow(clippy::print_stdout, reason = "a program for the terminal")]
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::metamodule::blueprint::SeedOrder;
use metamorph_protocol::metamodule::params::Strategy;
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::stream::Stream;
use metamorph_protocol::time::Time;
use metamorph_sim_bridge::faults::Fault;
use metamorph_tests::metamodules::{Assembly, Goal};
use std::collections::BTreeMap;
fn main() {
    let arg = |i: usize| std::env::args().nth(i);
    let from: u64 = arg(1).and_then(|s| s.parse().ok()).unwrap_or(0);
    let to: u64 = arg(2).and_then(|s| s.parse().ok()).unwrap_or(1000);
    let goal = if arg(3).as_deref() == Some("box") { Goal::Box } else { Goal::Chair };
    let mut ends: BTreeMap<String, u64> = BTreeMap::new();
    let mut broken = 0;
    let since = std::time::Instant::now();
    for seed in from..to {
        let kind = Kind::METAMODULES[(seed % 4) as usize];
        let order = SeedOrder::ALL[(seed / 4 % 3) as usize];
        let a = Assembly::new(goal, kind, Strategy::Negotiated, order, seed).spares(1).relocating();
        let mut s = Stream::named(seed, "crash", 0);
        let who = ModuleId(s.below(a.start.len() as u64) as u32);
        let when = Time(s.below(150_000) * 1_000_000);
        let ran = a.failed_connections("5%").loss("1%").fault(when, Fault::Kill(who)).run();
        broken += ran.broken;
        if ran.broken > 0 {
            println!("seed {seed} {:?}", ran.violations.first());
        }
        let end = match &ran.stall {
            None => "built".to_owned(),
            Some(st) => format!("{:?} {:?}", ran.outcome.map(|o| o.1), st.reason),
        };
        if !ran.built() {
            println!(
                "seed {seed} {kind} {}: {end} filled {} kill {who} at {when} {:?}",
                order.name(),
                ran.filled,
                ran.stall.map(|s| s.unfilled)
            );
        }
        *ends.entry(end).or_default() += 1;
    }
    println!("{ends:?} broken {broken} {:.2} ms", since.elapsed().as_secs_f64() * 1e3 / (to - from) as f64);
}
