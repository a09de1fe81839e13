//! Growth under faults on the simulated link: no invariant breaks; and the remaining modules build the goal,
//! or the report names the reason why they cannot.

use metamorph_protocol::cube::params::Params;
use metamorph_protocol::goal::Growth;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::rng::Rng;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::cube::reasons::PINNED;
use metamorph_sim_bridge::director::faults::Fault;
use metamorph_sim_bridge::director::reason::Reason;
use metamorph_tests::growth::{Experiment, ball};
use std::sync::atomic::{AtomicUsize, Ordering};

fn likely(text: &str) -> Ratio {
    text.parse().expect("a probability")
}

type Variation = (&'static str, fn(Experiment) -> Experiment);

const PUBLISHED: [Variation; 5] = [
    ("no fault", |e| e),
    ("5% loss", |e| e.loss("5%")),
    ("10% loss", |e| e.loss("10%")),
    ("5% crashes", |e| e.crashes(5)),
    ("5% crashes, 10% loss", |e| e.crashes(5).loss("10%")),
];

const FURTHER: [Variation; 7] = [
    ("every module stopped once", |e| e.pauses(Span::secs(60))),
    ("stopped, 5% loss, 10% restarts", |e| e.pauses(Span::secs(30)).loss("5%").restarts(10)),
    ("30% restarts", |e| e.restarts(30)),
    ("doubled and reordered", |mut e| {
        (e.link.duplicate, e.link.reorder) = (likely("20%"), likely("20%"));
        e
    }),
    ("corrupted", |mut e| {
        e.link.corrupt = likely("5%");
        e
    }),
    ("late messages", |mut e| {
        e.link.delay_max = Span::secs(2);
        e.setup.params = Params::scaled(Span::secs(1), Span::secs(2), e.setup.params.range);
        e
    }),
    ("5% failed connections", |mut e| {
        e.failure = likely("5%");
        e
    }),
];

/// Dead and stuck modules in the way of the field and of each other: no invariant breaks, but some runs come
/// to a standstill although an omniscient planner would find a plan.
const HARSH: [Variation; 1] = [("5% stuck joints, 5% crashes, 10% loss", |mut e| {
    let mut rng = Rng::named(e.seed, "stuck", 0);
    let count = e.start.len() as u64;
    for _ in 0..count / 20 {
        e.faults.push((Time(1), Fault::Stick(ModuleId(rng.below(count) as u32))));
    }
    e.crashes(5).loss("10%")
})];

/// Runs the variations for the seeds, on all cores, and prints the goals that were not built. Fails on any
/// broken invariant and, if they must be built, on any standstill that is the protocol's fault.
fn check(side: i16, seeds: std::ops::RangeInclusive<u64>, variations: &[Variation], must_build: bool) {
    let excused = |reason: Reason| reason.is_infeasible() || reason == PINNED;
    let jobs: Vec<(u64, &Variation)> =
        variations.iter().flat_map(|v| seeds.clone().map(move |s| (s, v))).collect();
    let next = AtomicUsize::new(0);
    let work = || {
        let mut bad = Vec::new();
        while let Some((seed, (name, vary))) = jobs.get(next.fetch_add(1, Ordering::Relaxed)) {
            let experiment = vary(Experiment::slab_to_sphere(side, *seed));
            // Only a permanent loss is an excuse.
            let harmed =
                experiment.faults.iter().any(|(_, f)| !matches!(f, Fault::Pause(_) | Fault::Resume(_)));
            let ran = experiment.run();
            let fine = ran.built() || harmed && ran.stall.as_ref().is_some_and(|s| excused(s.reason));
            if !ran.built() {
                #[allow(clippy::print_stdout, reason = "shown only on failure or with --nocapture")]
                {
                    println!("{side}x{side}, {name}, seed {seed}: {:?}, {:?}", ran.outcome, ran.stall);
                }
            }
            if ran.broken != 0 || (must_build && !fine) {
                bad.push(format!("{name}, seed {seed}: {:?} {:?}", ran.violations.first(), ran.stall));
            }
        }
        bad
    };
    let bad: Vec<String> = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..2).map(|_| scope.spawn(work)).collect();
        workers.into_iter().flat_map(|w| w.join().expect("a worker panicked")).collect()
    });
    assert!(
        bad.is_empty(),
        "repeat with Experiment::slab_to_sphere({side}, SEED) and the variation named:\n{}",
        bad.join("\n")
    );
}

#[test]
fn a_hundred_modules_build_under_all_faults() {
    check(10, 1..=6, &PUBLISHED, true);
    check(10, 1..=4, &FURTHER, true);
    check(10, 1..=4, &HARSH, false);
}

#[test]
fn four_hundred_modules_build_under_all_faults() {
    check(20, 1..=2, &PUBLISHED, true);
}

/// The published size of the experiment. Takes minutes:
/// `cargo test --release -p metamorph-tests sim_growth:: -- --ignored --nocapture`
#[test]
#[ignore = "takes minutes in a release build"]
fn a_hundred_seeds_of_four_hundred_modules() {
    check(20, 1..=100, &PUBLISHED, true);
    check(20, 1..=20, &FURTHER, true);
    check(20, 1..=20, &HARSH, false);
}

#[test]
fn solid_goals_are_built() {
    for seed in 1..=3 {
        let mut experiment = Experiment::slab_to_sphere(12, seed);
        experiment.setup.goals = vec![ball(12, Growth::Solid)];
        let ran = experiment.run();
        assert!(ran.built() && ran.broken == 0, "seed {seed}: {ran:?}");
    }
}

/// Slab to disc to sphere (thesis 4.1.2): one goal after the other.
#[test]
fn goals_are_built_one_after_the_other() {
    use metamorph_protocol::goal::Goal;
    use metamorph_protocol::lattice::Cell;
    use metamorph_protocol::shape::{Radius, Shape};
    for seed in 1..=3 {
        let mut experiment = Experiment::slab_to_sphere(12, seed).loss("2%");
        let center = Cell::new(6, 6, 0);
        let disc = Shape::Disc { center, radius: Radius::cells(7), axis: Default::default() };
        let disc = Goal::compile(&disc.cells().unwrap(), center, Growth::Scaffold).unwrap();
        experiment.setup.goals.insert(0, disc);
        let ran = experiment.run();
        assert!(
            ran.built() && ran.broken == 0,
            "seed {seed}: {:?} {:?}",
            ran.outcome,
            ran.violations.first()
        );
        assert_eq!(ran.stages.len(), 2);
        assert!(ran.stages.iter().all(|s| s.filled == s.cells && s.built.is_some()));
    }
}

#[test]
fn connecting_cycles_build_too() {
    for (seed, loss) in [(1, "0%"), (2, "5%"), (3, "10%")] {
        let mut experiment = Experiment::slab_to_sphere(10, seed).loss(loss);
        let cycles = metamorph_protocol::cube::params::Connectivity::Cycles;
        experiment.setup.params = experiment.setup.params.keeping(cycles);
        let ran = experiment.run();
        assert!(
            ran.built() && ran.broken == 0,
            "seed {seed}: {:?} {:?}",
            ran.outcome,
            ran.violations.first()
        );
    }
}
