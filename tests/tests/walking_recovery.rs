//! How many structures walk on after a failure, over many seeds: how fast, after how many gaits.
//!
//! A long test is resumed by the seeds that are still to come: each prints a line as soon as it is done.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]
#![allow(clippy::print_stdout, reason = "shown only on failure or with --nocapture")]

use metamorph_protocol::free_module::gait::WalkSetup;
use metamorph_protocol::free_module::named;
use metamorph_protocol::free_module::network::NetworkKind;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::director::faults::{Fault, Schedule};
use metamorph_sim_bridge::director::progress::Stop;
use metamorph_sim_bridge::free_module::physics::{Down, FRICTION};
use metamorph_sim_bridge::free_module::physics_world::PhysicsWorld;
use metamorph_sim_bridge::free_module::rapier::Bodies;
use metamorph_sim_bridge::free_module::walking::director::{ENOUGH, Situation, WalkDirector, WalkingRun};
use metamorph_sim_bridge::free_module::walking::goal::Goal;
use metamorph_sim_bridge::kernel::sim::{Sim, SimConfig};
use metamorph_tests::command::root;
use metamorph_tests::statistics::seeds_or;
use metamorph_world_controller::gait::ask_tell::Method;
use metamorph_world_controller::gait::document::{GaitFile, read};
use metamorph_world_controller::gait::elites;
use metamorph_world_controller::gait::space::Space;
use metamorph_world_controller::gait::tuner::{Choice, Known, OnlineTuner};
use std::collections::BTreeSet;
use std::fs;
use std::ops::Range;
use std::sync::Arc;

/// When the module dies.
const DEATH: Span = Span::secs(30);
/// The time of a gait: a period to go over to it, and two that count.
const TRIAL: Span = Span::secs(15);
/// The seeds of the long tests, unless others are asked for.
const SEEDS: Range<u64> = 0..100;

/// The quadruped of the scenario with its gait, and nothing known about failures but the elites of that gait's study.
fn choice(network: NetworkKind, method: Method, trials: u32, seed: u64) -> Arc<Choice> {
    let structure = named::structure("quad5-sym").unwrap();
    let text = fs::read_to_string(root().join("deploy/gaits/quad5.json")).unwrap();
    let file: GaitFile = serde_json::from_str(&text).unwrap();
    let best = file.best.as_ref().unwrap();
    let gait = read(&best.joints, 3 * structure.bound()).unwrap();
    let known = vec![Known { dead: BTreeSet::new(), gait, speed_mm_s: best.fitness_mm_s }];
    let elites = elites::of_file(&file, &Space::of(&structure, network).unwrap());
    Arc::new(Choice { structure, network, known, elites, method: Some(method), trials, seed })
}

/// Kills a module of the walking quadruped, and returns what was done before and after, until a gait has a share of the
/// speed before or none is left to try.
fn recover(dead: u32, choice: Arc<Choice>, enough: f64) -> [Situation; 2] {
    let (structure, seed, trials) = (choice.structure.clone(), choice.seed, choice.trials);
    let bodies = Bodies::new(&structure, &[[0.0; 3]; 5], Down::DEFAULT, FRICTION).unwrap();
    let timeout = Time::ZERO + DEATH + Span::secs(20) + (TRIAL + Span::secs(1)) * u64::from(trials);
    let stop = Stop {
        timeout,
        stall: timeout.since(Time::ZERO),
        livelock: timeout.since(Time::ZERO),
        planned_until: Time::ZERO,
    };
    let course = WalkingRun {
        // Not to be reached.
        goal: Goal::anywhere(Span::secs(1), 1e6),
        tuner: Box::new(OnlineTuner::new(Arc::clone(&choice))),
        trial: TRIAL,
        schedule: Schedule::new(vec![(Time::ZERO + DEATH, Fault::Kill(ModuleId(dead)))]),
        stop,
    };
    let config = SimConfig {
        setup: Arc::new(WalkSetup::new(choice.network)),
        link: LinkModel::default(),
        seed,
        audit_every: Span::secs(1),
        ignore_sessions: false,
    };
    let director = WalkDirector::new(structure.bound(), course);
    let mut run = Sim::new(config, PhysicsWorld::new(structure, bodies), director);
    let mut now = Time::ZERO;
    while now < timeout {
        now += Span::secs(1);
        run.run_until(now);
        let all = run.director().situations();
        let Some(after) = all.iter().find(|s| !s.dead.is_empty()) else { continue };
        if after.kept.is_some() || after.best_mm_s >= all[0].first_mm_s.map(|speed| enough * speed) {
            break;
        }
    }
    assert!(!run.world().is_broken(), "seed {seed}: bodies went astray");
    let all = run.director().situations();
    let after = all.iter().find(|s| !s.dead.is_empty()).unwrap();
    assert_eq!(after.dead, [ModuleId(dead)]);
    [all[0].clone(), after.clone()]
}

/// The interval in which a share lies with 95 % probability (Wilson).
fn interval(good: usize, all: usize) -> [f64; 2] {
    let (z, n) = (1.96_f64, all as f64);
    let p = good as f64 / n;
    let (middle, scale) = (p + z * z / (2.0 * n), 1.0 + z * z / n);
    let half = z * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt();
    [(middle - half) / scale, (middle + half) / scale]
}

/// What many runs came to.
#[derive(Default)]
struct Tally {
    good: usize,
    all: usize,
}

impl Tally {
    fn text(&self) -> String {
        let [low, high] = interval(self.good, self.all).map(|p| 100.0 * p);
        let share = 100.0 * self.good as f64 / self.all as f64;
        format!("{} of {} ({share:.0} %, 95 % interval {low:.0} to {high:.0} %)", self.good, self.all)
    }
    fn share(&self) -> f64 {
        self.good as f64 / self.all as f64
    }

    /// Recovers with many seeds, and counts those that reached a share of the speed.
    fn recover(&mut self, dead: u32, trials: u32, of: (NetworkKind, Method), seeds: Range<u64>, enough: f64) {
        let (network, method) = of;
        for seed in seeds {
            let [before, after] = recover(dead, choice(network, method, trials, seed), enough);
            let speed = |speed: Option<f64>| speed.unwrap_or(0.0);
            let (whole, first, best) =
                (speed(before.first_mm_s), speed(after.first_mm_s), speed(after.best_mm_s));
            let share = best / whole;
            self.all += 1;
            self.good += usize::from(share >= enough);
            println!(
                "module {dead} dead, {method}, seed {seed}: {whole:.1} mm/s before, {first:.1} with the former gait, \
                 {best:.1} ({:.0} %) with the best of {} gaits",
                100.0 * share,
                after.tried
            );
        }
    }
}

/// A leg and the body die; one seed each.
#[test]
fn a_leg_and_the_body_are_done_without() {
    for (dead, method, enough) in [(2, Method::Cma, ENOUGH), (0, Method::Bayes, 0.1)] {
        let mut tally = Tally::default();
        tally.recover(dead, 40, (NetworkKind::BlfSym, method), 1..2, enough);
        assert_eq!(tally.good, 1, "module {dead}");
    }
}

#[test]
fn intervals_are_those_of_a_table() {
    let [low, high] = interval(8, 10);
    assert!((low - 0.490).abs() < 1e-3 && (high - 0.943).abs() < 1e-3, "{low} {high}");
}

/// `METAMORPH_SEEDS=0..100 cargo test --release -p metamorph-tests legs_are_done_without -- --ignored --nocapture`
#[test]
#[ignore = "an hour: four hundred runs, and as many of random search"]
fn legs_are_done_without() {
    let of = |method| {
        let mut tally = Tally::default();
        (1..5).for_each(|leg| tally.recover(leg, 20, (NetworkKind::BlfSym, method), seeds_or(SEEDS), ENOUGH));
        println!("{method}: {} reach 80 % within 20 gaits", tally.text());
        tally
    };
    let all = [Method::Cma, Method::Repertoire, Method::Random].map(of);
    assert!(all[0].share() >= 0.95);
}

/// `METAMORPH_SEEDS=0..100 cargo test --release -p metamorph-tests the_body_is_done_without -- --ignored --nocapture`
#[test]
#[ignore = "an hour: a hundred runs of each learner"]
fn the_body_is_done_without() {
    let of = |method| {
        let mut tally = Tally::default();
        tally.recover(0, 40, (NetworkKind::BlfSym, method), seeds_or(SEEDS), 0.3);
        println!("{method}: {} reach 30 % within 40 gaits", tally.text());
        tally
    };
    let all = [Method::Bayes, Method::Cma, Method::Random].map(of);
    assert!(all[0].share() >= 0.8);
}
