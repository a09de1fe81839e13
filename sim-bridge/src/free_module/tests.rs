//! Phase lock of the agents on the simulated link.

use super::director::GaitDirector;
use super::structure_world::StructureWorld;
use metamorph_kernel::kernel::sim::{Sim, SimConfig};
use metamorph_protocol::counters::Class;
use metamorph_protocol::free_module::gait::message::Parameters;
use metamorph_protocol::free_module::gait::{StartPhases, WalkSetup};
use metamorph_protocol::free_module::named;
use metamorph_protocol::free_module::network::{Morphology, Network, NetworkKind};
use metamorph_protocol::free_module::oscillator::{Angle, Phase};
use metamorph_protocol::free_module::structure::Joint;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::rng::Rng;
use metamorph_protocol::time::{Span, Time};
use std::collections::BTreeMap;
use std::sync::Arc;

type Run = Sim<StructureWorld, GaitDirector>;

/// The start of all gaits: agents know their structure by then.
const START: Span = Span::secs(3);

fn at(seconds: u64) -> Time {
    Time::ZERO + START + Span::secs(seconds)
}

struct Case {
    structure: &'static str,
    setup: WalkSetup,
    loss: &'static str,
    delay: Span,
    kill: Option<(u64, u32)>,
}

impl Case {
    /// The case of the acceptance: amplitudes of 0.5 rad, random start phases, half of the messages lost.
    fn lossy(structure: &'static str) -> Case {
        let setup = WalkSetup { start: StartPhases::Random, ..WalkSetup::new(NetworkKind::BlfSym) };
        Case { structure, setup, loss: "50%", delay: Span::millis(200), kill: None }
    }

    fn run(&self, seed: u64) -> Run {
        let structure = named::structure(self.structure).unwrap();
        let mut rng = Rng::named(seed, "gait", 0);
        let mut parameters = || Parameters {
            amplitude: Angle::milliradians(500),
            offset: Angle::default(),
            phase: Phase(rng.next_u64() as u32),
        };
        let joints: BTreeMap<Joint, Parameters> =
            (0..3 * structure.bound() as u16).map(|j| (Joint(j), parameters())).collect();
        let link = LinkModel {
            delay_min: Span::millis(1),
            delay_max: self.delay,
            loss: self.loss.parse().unwrap(),
            ..LinkModel::default()
        };
        let config = SimConfig {
            setup: Arc::new(self.setup.clone()),
            link,
            seed,
            audit_every: Span::secs(1),
            ignore_sessions: false,
        };
        let mut director = GaitDirector::new(Time::ZERO + START, joints);
        if let Some((when, module)) = self.kill {
            director = director.kill(at(when), ModuleId(module));
        }
        Sim::new(config, StructureWorld::new(structure), director)
    }
}

/// Returns the largest phase error of all couplings between living modules in degrees; `None` if an oscillator is missing.
fn worst(sim: &Run, network: &Network) -> Option<f64> {
    let agents = sim.agents();
    let mut worst: f64 = 0.0;
    for (a, b) in &network.couplings {
        let (Some(first), Some(second)) = (agents.get(a.module()), agents.get(b.module())) else {
            continue;
        };
        let (a, b) = (first.phase(*a, sim.now())?, second.phase(*b, sim.now())?);
        worst = worst.max(f64::from(a.phase.ahead_of(b.phase)).abs() / 2f64.powi(32) * 360.0);
    }
    Some(worst)
}

fn network(case: &Case) -> Network {
    Morphology::of(&named::structure(case.structure).unwrap()).network(case.setup.network).unwrap()
}

/// Runs a case, and returns whether all couplings were within 3 degrees after 12 s, and the largest error from 20 to 30 s.
fn locks(case: &Case, seed: u64) -> (bool, f64) {
    let mut sim = case.run(seed);
    let network = network(case);
    sim.run_until(at(12));
    let locked = worst(&sim, &network).is_some_and(|e| e <= 3.0);
    let mut later: f64 = 0.0;
    for second in 20..=30 {
        sim.run_until(at(second));
        later = later.max(worst(&sim, &network).unwrap_or(180.0));
    }
    assert_eq!(sim.violations().1, 0, "seed {seed}");
    (locked, later)
}

/// Oscillators lock although half of the messages are lost and the others are late by up to 200 ms.
#[test]
fn phases_lock_under_loss_and_delay() {
    let case = Case::lossy("quad5-sym");
    for seed in 0..100 {
        let (locked, later) = locks(&case, seed);
        assert!(locked && later <= 0.5, "seed {seed}: locked {locked}, then {later} degrees");
    }
}

/// The negative control: phases taken as of their arrival do not lock.
#[test]
fn without_time_stamps_phases_do_not_lock() {
    let mut case = Case::lossy("quad5-sym");
    case.setup.time_stamps = false;
    let locked = (0..100).filter(|seed| locks(&case, *seed).0).count();
    assert!(locked < 50, "{locked} of 100");
}

/// Phases of a ring's limbs travel two and three hops.
#[test]
fn phases_lock_over_several_hops() {
    let case = Case::lossy("struct10");
    for seed in 0..10 {
        let mut sim = case.run(seed);
        sim.run_until(at(40));
        let error = worst(&sim, &network(&case)).unwrap();
        assert!(error <= 0.5, "seed {seed}: {error} degrees");
    }
}

/// When a module dies, the others go over to the network without its joints, and stay in lock. If it is the body of a
/// quadruped, through which all messages pass, hips move into the limbs, which continue alone at the same frequency.
#[test]
fn the_living_stay_in_lock_when_a_module_dies() {
    for (name, dead, oscillators) in
        [("struct10", 7, None), ("quad5-sym", 2, Some(6)), ("quad5-sym", 0, Some(4))]
    {
        let lossy = Case::lossy(name);
        let case = Case { kill: Some((60, dead)), loss: "10%", delay: Span::millis(100), ..lossy };
        let mut structure = named::structure(name).unwrap();
        structure.set_passive(ModuleId(dead));
        let replanned = Morphology::of(&structure).network(case.setup.network).unwrap();
        assert!(oscillators.is_none_or(|n| replanned.oscillators.len() == n));
        for seed in 0..5 {
            let mut sim = case.run(seed);
            sim.run_until(at(59));
            let before = worst(&sim, &network(&case)).unwrap();
            sim.run_until(at(90));
            let living = sim.agents().iter().filter(|(_, agent)| agent.network() == &replanned).count();
            assert_eq!(living, structure.bound() - 1, "{name}, {dead} dead, seed {seed}");
            let error = worst(&sim, &replanned).unwrap();
            assert!(
                before <= 0.5 && error <= 0.5,
                "{name}, {dead} dead, seed {seed}: {before}, {error} degrees"
            );
        }
    }
}

fn gait_messages_per_second(predict: bool) -> u64 {
    let mut case = Case::lossy("quad5-sym");
    case.setup.predict = predict;
    (case.loss, case.delay) = ("0", Span::millis(10));
    let mut sim = case.run(1);
    sim.run_until(at(30));
    let before = sim.tally()[Class::Gait].sent;
    sim.run_until(at(40));
    (sim.tally()[Class::Gait].sent - before) / 10
}

/// In lock, receivers extrapolate, and a phase a second is enough.
#[test]
fn prediction_saves_messages() {
    let (with, without) = (gait_messages_per_second(true), gait_messages_per_second(false));
    assert_eq!((with, without), (8, 80));
}

/// Gaits that begin in lock are in lock at once, and all agents use the network of the structure.
#[test]
fn a_gait_begins_in_lock() {
    let mut case = Case::lossy("quad5-sym");
    case.setup.start = StartPhases::Locked;
    (case.loss, case.delay) = ("0", Span::millis(10));
    let mut sim = case.run(1);
    let network = network(&case);
    for second in 0..10 {
        sim.run_until(at(second));
        let error = worst(&sim, &network).unwrap();
        assert!(error < 0.01, "{error} degrees after {second} s");
    }
    for (id, agent) in sim.agents().iter() {
        assert_eq!(agent.network(), &network, "{id}");
        for joint in (0..3).map(|j| Joint::new(id, j)) {
            let angle = agent.oscillators().unwrap()[usize::from(joint.within())].angle();
            let there = network.oscillators.contains(&joint);
            assert!(there || angle == Angle::default(), "{joint} is not locked: {angle:?}");
        }
    }
    // Classes by what they are for: link states spread once, comparisons are repeats, the rest are phases.
    let sent: Vec<_> = sim.tally().iter().filter(|(_, counts)| counts.sent > 0).map(|(c, _)| c).collect();
    assert_eq!(sent, [Class::Connectivity, Class::Liveness, Class::Gait]);
}

#[test]
fn the_same_seed_gives_the_same_run() {
    let hashes = |seed| {
        let mut sim = Case::lossy("struct10").run(seed);
        sim.run_until(at(10));
        (sim.trace().value(), sim.hashes())
    };
    assert_eq!(hashes(7), hashes(7));
    assert_ne!(hashes(7), hashes(8));
}
