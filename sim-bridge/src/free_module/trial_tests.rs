//! Trials: agents drive bodies, the same each time, and the measures are those of the bodies.

use super::physics::{Down, FRICTION, Physics};
use super::trial::{Run, TrialSetup};
use metamorph_protocol::free_module::gait::message::Parameters;
use metamorph_protocol::free_module::named;
use metamorph_protocol::free_module::network::{Morphology, NetworkKind};
use metamorph_protocol::free_module::oscillator::{Angle, Phase};
use metamorph_protocol::free_module::structure::Joint;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::time::{Span, Time};
use std::collections::BTreeMap;

fn setup(seconds: u64) -> TrialSetup {
    TrialSetup {
        structure: named::structure("quad5-sym").unwrap(),
        joints_deg: vec![[0.0; 3]; 5],
        down: Down::DEFAULT,
        network: NetworkKind::BlfSym,
        dead: Vec::new(),
        time: Span::secs(seconds),
        heading_deg: None,
        upright: false,
        seed: 1,
    }
}

/// Returns a gait with equal amplitudes, and phases that differ by a quarter turn from joint to joint.
fn gait(setup: &TrialSetup, amplitude: i32) -> BTreeMap<Joint, Parameters> {
    let mut structure = setup.structure.clone();
    setup.dead.iter().for_each(|m| structure.set_passive(*m));
    let network = Morphology::of(&structure).network(setup.network).unwrap();
    let parameters = |(i, joint): (usize, &Joint)| {
        let phase = Phase((i as u32) << 30);
        (*joint, Parameters { amplitude: Angle::milliradians(amplitude), offset: Angle::default(), phase })
    };
    network.oscillators.iter().enumerate().map(parameters).collect()
}

#[test]
fn the_same_gait_gives_the_same_trial() {
    let setup = setup(5);
    let gait = gait(&setup, 500);
    let first = setup.trial(gait.clone(), FRICTION).unwrap();
    assert_eq!(first, setup.trial(gait.clone(), FRICTION).unwrap());
    assert_ne!(first.state, setup.trial(gait, 0.6).unwrap().state);
    assert!(!first.broken && first.distance_mm > 5.0, "{first:?}");
}

#[test]
fn without_a_gait_nothing_moves() {
    let setup = setup(5);
    let still = setup.trial(BTreeMap::new(), FRICTION).unwrap();
    assert!(still.distance_mm < 1.0 && !still.collided && !still.broken, "{still:?}");
    assert!(still.seconds == 5.0 && still.duty.iter().all(|d| *d > 0.99), "{still:?}");
}

fn angles(run: &Run) -> Vec<f32> {
    (0..15).map(|j| run.world().physics().angle(Joint(j))).collect()
}

/// Joints follow the oscillators, and those without one stay at 0.
#[test]
fn bodies_follow_the_oscillators() {
    let setup = setup(10);
    let gait = gait(&setup, 400);
    let mut run = setup.run(gait.clone(), FRICTION).unwrap();
    run.run_until(setup.start() + Span::secs(8));
    let (mut sum, mut count) = (0.0, 0.0);
    for tick in 0..100 {
        run.run_until(setup.start() + Span::secs(8) + Span::millis(20) * tick);
        let found = angles(&run);
        for joint in (0..15).map(Joint) {
            let agents = run.agents();
            let agent = agents.get(joint.module()).unwrap();
            let wanted = agent.oscillators().unwrap()[usize::from(joint.within())].angle();
            let wanted = wanted.0 as f32 / Angle::RADIAN.0 as f32;
            assert!(gait.contains_key(&joint) || wanted == 0.0);
            if gait.contains_key(&joint) {
                (sum, count) = (sum + (found[joint.index()] - wanted).abs(), count + 1.0);
            }
        }
    }
    // A servo of gain 10 /s lags behind 0.4 rad at 0.2 Hz by up to 0.05 rad, and more where its torque is at the limit.
    let mean = sum / count;
    assert!((0.01..0.1).contains(&mean), "{mean} rad");
    assert_eq!(run.violations().1, 0, "{:?}", run.violations().0);
}

/// The joints of a module that dies stay where they are, and the others go over to the network without them.
#[test]
fn a_dead_module_holds_its_joints() {
    let mut setup = setup(10);
    setup.dead = vec![ModuleId(0)];
    let mut run = setup.run(gait(&setup, 400), FRICTION).unwrap();
    let (mut of_dead, mut of_living): (f32, f32) = (0.0, 0.0);
    for second in 0..15 {
        run.run_until(Time::ZERO + Span::secs(second));
        let angles = angles(&run).into_iter().map(f32::abs);
        let (dead, living): (Vec<_>, Vec<_>) = angles.enumerate().partition(|(j, _)| *j < 3);
        of_dead = dead.into_iter().map(|(_, a)| a).fold(of_dead, f32::max);
        of_living = living.into_iter().map(|(_, a)| a).fold(of_living, f32::max);
    }
    assert!(of_dead < 0.05 && of_living > 0.3, "{of_dead} rad, {of_living} rad");
    let agents = run.agents();
    let network = &agents.get(ModuleId(1)).unwrap().network().oscillators;
    assert_eq!(*network, [1, 2, 3, 4].map(|m| Joint::new(ModuleId(m), 0)));
}

/// Trials end at the first self-collision.
#[test]
fn a_self_collision_ends_a_trial() {
    let mut setup = setup(20);
    setup.network = NetworkKind::Fo;
    let gait = gait(&setup, 3000);
    let outcome = setup.trial(gait, FRICTION).unwrap();
    assert!(outcome.collided && outcome.seconds < 20.0, "{outcome:?}");
}

/// The distance in a direction is that part of the displacement, and backwards it is negative.
#[test]
fn a_heading_counts_its_part_of_the_distance() {
    let mut setup = setup(5);
    let gait = gait(&setup, 500);
    let mut distance = |heading_deg| {
        setup.heading_deg = heading_deg;
        setup.trial(gait.clone(), FRICTION).unwrap().distance_mm
    };
    let (any, east, north, west) =
        (distance(None), distance(Some(0.0)), distance(Some(90.0)), distance(Some(180.0)));
    assert!((east + west).abs() < 1e-6 && any > 1.0, "{east} {west}");
    assert!((east * east + north * north - any * any).abs() < 1e-3, "{east} {north} {any}");
}

/// Where falls end trials, a gait that rolls over ends there.
#[test]
fn a_fall_ends_a_trial_if_asked() {
    let mut setup = setup(15);
    setup.network = NetworkKind::Fo;
    let gaits = (4..14).map(|n| gait(&setup, 200 * n));
    let rolls = gaits.map(|gait| (setup.trial(gait.clone(), FRICTION).unwrap(), gait));
    let (rolls, gait) = rolls.into_iter().find(|(rolls, _)| rolls.falls > 0).expect("one of them rolls over");
    assert!(!rolls.fallen, "{rolls:?}");
    setup.upright = true;
    let ends = setup.trial(gait, FRICTION).unwrap();
    assert!(ends.fallen && ends.falls == 1 && ends.seconds <= rolls.seconds, "{ends:?}");
}
