//! How long the Roombots model takes: building and reading the motion database, and solving inverse
//! kinematics with the complete solver beside damped least squares.
//!
//! `cargo bench -p metamorph-roombots --bench roombots` prints medians and, for the solvers, what
//! they achieve. `ROOMBOTS_TARGETS` sets the number of targets per kind (default 2000).

#![allow(clippy::disallowed_methods, clippy::print_stdout, reason = "a benchmark reads the clock and prints")]

use metamorph_core::rng::Rng;
use metamorph_roombots::Kind;
use metamorph_roombots::chain::{Chain, joint_distance, random_angles};
use metamorph_roombots::database::Database;
use metamorph_roombots::inverse::levenberg_marquardt::{Options, solve_from_random_starts};
use metamorph_roombots::inverse::solve;
use std::hint::black_box;
use std::time::{Duration, Instant};

fn timed<T>(work: impl FnOnce() -> T) -> (Duration, T) {
    let start = Instant::now();
    let result = black_box(work());
    (start.elapsed(), result)
}

fn median(mut times: Vec<Duration>) -> Duration {
    times.sort();
    times[times.len() / 2]
}

fn main() {
    // `cargo test --benches` only wants to see it start.
    if std::env::args().any(|a| a == "--test") {
        return;
    }
    let (_, database) = timed(Database::build);
    let bytes = database.to_bytes();
    let build = median((0..5).map(|_| timed(Database::build).0).collect());
    let read = median((0..11).map(|_| timed(|| Database::from_bytes(&bytes)).0).collect());
    let same = Database::build().to_bytes() == bytes;
    println!(
        "motion database, all kinds: build {build:.1?}, read {read:.1?}, {} bytes, identical {same}",
        bytes.len()
    );

    let count: u32 = std::env::var("ROOMBOTS_TARGETS").ok().and_then(|t| t.parse().ok()).unwrap_or(2000);
    println!("inverse kinematics, {count} random targets per kind, times are medians per target");
    for kind in Kind::ALL {
        complete(kind, count);
    }
    for kind in Kind::METAMODULES {
        for starts in [1, 2, 5, 10] {
            damped(kind, count, starts);
        }
    }
}

fn targets(kind: Kind, count: u32) -> Vec<Vec<f64>> {
    let mut rng = Rng::named(1, "bench", kind as u64);
    (0..count).map(|_| random_angles(kind, &mut rng)).collect()
}

fn complete(kind: Kind, count: u32) {
    let chain = Chain::of(kind);
    let (mut times, mut solved, mut generating, mut worst) = (Vec::new(), 0, 0, 0f64);
    let (mut fewest, mut most, mut sum) = (usize::MAX, 0, 0);
    for q in targets(kind, count) {
        let target = chain.head(&q);
        let (time, solutions) = timed(|| solve(kind, &target).unwrap_or_default());
        times.push(time);
        solved += u32::from(!solutions.is_empty());
        generating += u32::from(solutions.iter().any(|s| joint_distance(&s.q, &q) < 1e-5));
        worst = solutions.iter().map(|s| s.residual).fold(worst, f64::max);
        (fewest, most) = (fewest.min(solutions.len()), most.max(solutions.len()));
        sum += solutions.len();
    }
    println!(
        "  {kind:6} complete            {:>9.1?}  solved {solved}/{count}  generating posture {generating}/{count}  \
         solutions {fewest}..{most}, mean {:.1}  largest residual {worst:.0e}",
        median(times),
        sum as f64 / f64::from(count)
    );
}

fn damped(kind: Kind, count: u32, starts: u32) {
    let chain = Chain::of(kind);
    let mut rng = Rng::named(2, "bench damped", kind as u64);
    let (mut times, mut solved) = (Vec::new(), 0);
    for q in targets(kind, count) {
        let target = chain.head(&q);
        let (time, outcome) =
            timed(|| solve_from_random_starts(&chain, &target, starts, &mut rng, &Options::default()));
        times.push(time);
        solved += u32::from(outcome.reached);
    }
    println!("  {kind:6} damped, {starts:2} start(s) {:>9.1?}  solved {solved}/{count}", median(times));
}
