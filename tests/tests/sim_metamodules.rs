//! The thesis's experiment on the simulated link: whatever happens, no invariant breaks; the same seed
//! gives the same run; what is built is what was to be built. How often it is built is printed, not
//! promised: the strategies of the thesis deadlock.
#![allow(clippy::print_stdout, reason = "rates are printed for whoever asks with --nocapture")]

use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::metamodule::blueprint::SeedOrder;
use metamorph_protocol::metamodule::params::Strategy;
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::time::Time;
use metamorph_sim_bridge::faults::Fault;
use metamorph_tests::metamodules::{Assembled, Assembly, Goal};

fn check(name: &str, ran: &Assembled) {
    assert_eq!(ran.broken, 0, "{name}: {:?}", ran.violations);
    assert!(ran.outcome.is_some(), "{name}: it must end");

    if !ran.built() {
        assert!(ran.stall.is_some(), "{name}: whoever does not build says why");
    }
}

fn goal_with_every_strategy(goal: Goal, seeds: u64) {
    for strategy in Strategy::ALL {
        for kind in Kind::METAMODULES {
            let mut built = 0;
            for seed in 0..seeds {
                let name = format!("{goal:?} {kind} {} seed {seed}", strategy.name());
                let order = SeedOrder::ALL[(seed % 3) as usize];
                let ran = Assembly::new(goal, kind, strategy, order, seed).run();
                check(&name, &ran);
                built += u64::from(ran.built());
            }
            println!("{goal:?} {} {kind}: {built} of {seeds} built", strategy.name());
        }
    }
}

#[test]
fn a_box_of_four_breaks_no_invariant() {
    goal_with_every_strategy(Goal::Box, 3);
}

#[test]
fn a_chair_of_six_breaks_no_invariant() {
    goal_with_every_strategy(Goal::Chair, 1);
}

/// Somebody builds something: the machinery is not only safe by standing still.
#[test]
fn boxes_get_built() {
    let run = |seed| Assembly::new(Goal::Box, Kind::Per, Strategy::Step, SeedOrder::Circular, seed).run();
    let built: Vec<Assembled> = (0..10).map(run).filter(Assembled::built).collect();
    assert!(!built.is_empty());
    for ran in built {
        assert_eq!(ran.filled, 4);
        assert_eq!(ran.deeds.moves, ran.deeds.released, "every connection was followed by letting go");
    }
}

#[test]
fn the_same_seed_gives_the_same_run() {
    let run = |seed| {
        let ran = Assembly::new(Goal::Box, Kind::Srz, Strategy::Slope, SeedOrder::AtOnce, seed).run();
        (ran.trace, ran.digest, ran.poses)
    };
    assert_eq!(run(5), run(5));
    assert_ne!(run(5).0, run(6).0);
}

type Variation = (&'static str, fn(Assembly) -> Assembly);

#[test]
fn faults_break_no_invariant() {
    let at = |s: u64| Time(s * 1_000_000_000);
    let variations: [Variation; 6] = [
        ("10% loss", |a| a.loss("10%")),
        ("5% failed connections", |a| a.failed_connections("5%")),
        ("decentralised", Assembly::decentralised),
        ("a stuck joint", |a| a.fault(Time(1), Fault::Stick(ModuleId(1)))),
        ("a crash on the way", |a| a.fault(Time(7_500_000_000), Fault::Kill(ModuleId(2)))),
        ("a restart on the way, 5% loss", |a| {
            a.loss("5%").fault(Time(7_500_000_000), Fault::Restart(ModuleId(2)))
        }),
    ];
    for (name, vary) in variations {
        for seed in 0..3 {
            let base = Assembly::new(Goal::Box, Kind::Per, Strategy::Step, SeedOrder::Circular, seed);
            check(&format!("{name}, seed {seed}"), &vary(base).run());
        }
    }
    let paused = Assembly::new(Goal::Box, Kind::Srs, Strategy::Slope, SeedOrder::AtOnce, 1)
        .fault(at(5), Fault::Pause(ModuleId(0)))
        .fault(at(90), Fault::Resume(ModuleId(0)));
    check("a long stop", &paused.run());
}
