//! The engine on cases with a known answer: falling, standing, sliding, turning joints, and the same bits each time.
#![allow(clippy::print_stdout, reason = "shown only on failure or with --nocapture")]

use crate::engine::Bodies;
use crate::{Down, FRICTION, NO_LOAD, Physics, PhysicsError, TICK, TORQUE};
use metamorph_protocol::free_module::named;
use metamorph_protocol::free_module::structure::{Joint, Structure};
use metamorph_protocol::ids::ModuleId;
use siphasher::sip::SipHasher13;
use std::hash::Hasher;

fn quad(friction: f32) -> Bodies {
    let structure = named::structure("quad5-sym").unwrap();
    Bodies::new(&structure, &[[0.0; 3]; 5], Down::DEFAULT, friction).unwrap()
}

fn run(bodies: &mut Bodies, seconds: f64) {
    (0..(seconds / TICK.as_secs_f64()) as usize).for_each(|_| bodies.step());
}

/// Returns the horizontal distance of the centre of mass from a point.
fn drift(bodies: &Bodies, from: [f32; 3]) -> f32 {
    let now = bodies.centre_of_mass();
    (now[0] - from[0]).hypot(now[1] - from[1])
}

#[test]
fn structures_lie_on_the_floor() {
    let down = ["+x", "-x", "+y", "-y", "+z", "-z"];
    for (name, modules) in [("quad5-sym", 5), ("quad5-unsym", 5), ("tripod4", 4), ("quad9", 9)] {
        let structure = named::structure(name).unwrap();
        for text in down {
            let bodies =
                Bodies::new(&structure, &vec![[0.0; 3]; modules], text.parse().unwrap(), FRICTION).unwrap();
            let heights = (0..modules as u32).flat_map(|m| (0..4).map(move |h| (ModuleId(m), h)));
            let heights: Vec<f32> = heights.map(|(m, h)| bodies.pose(m, h).position[2]).collect();
            let lowest = heights.iter().copied().fold(f32::MAX, f32::min);
            assert!((0.054..0.064).contains(&lowest), "{name}, {text} down: {lowest} m");
        }
    }
    // Flat named structures lie with all modules at one height.
    let bodies = quad(FRICTION);
    assert!((0..5).all(|m| (bodies.pose(ModuleId(m), 0).position[2] - 0.055).abs() < 1e-4));
}

/// A structure with its motors on neither creeps nor sags.
#[test]
fn a_structure_at_rest_stays_where_it_is() {
    let mut bodies = quad(FRICTION);
    let start = bodies.centre_of_mass();
    run(&mut bodies, 10.0);
    let worst = (0..15).map(|j| bodies.angle(Joint(j)).abs()).fold(0.0, f32::max);
    assert!(drift(&bodies, start) < 0.001, "drifts {} m", drift(&bodies, start));
    assert!(worst < 0.002, "a joint is off by {worst} rad");
    assert!(bodies.kinetic_energy() < 1e-5 && bodies.overlap() == 0.0);
    assert!((bodies.centre_of_mass()[2] - start[2]).abs() < 1e-4);
    assert!((0..5).all(|m| bodies.touches_floor(ModuleId(m))));
}

/// A module lifted off the floor falls by g t²/2 and comes to rest on it, without rebound and without sinking in.
#[test]
fn a_module_falls_and_comes_to_rest() {
    let structure = Structure::new(1, &[]).unwrap();
    let mut bodies = Bodies::new(&structure, &[[0.0; 3]], Down::DEFAULT, FRICTION).unwrap();
    let floor = bodies.centre_of_mass()[2];
    bodies.lift(0.5);
    run(&mut bodies, 0.25);
    let fallen = floor + 0.5 - bodies.centre_of_mass()[2];
    // A step of semi-implicit Euler is ahead by g t dt / 2.
    let expected = 0.5 * 9.81 * 0.25 * (0.25 + 0.01);
    assert!((fallen - expected).abs() < 0.002, "fell {fallen} m, not {expected} m");
    assert!(!bodies.touches_floor(ModuleId(0)));
    // The engine keeps the speeds of a tick's beginning.
    let speed: f32 = 9.81 * (0.25 - 0.01);
    let (energy, expected) = (bodies.kinetic_energy(), 0.5 * 1.4 * speed * speed);
    assert!((energy / expected - 1.0).abs() < 0.01, "{energy} J, not {expected} J");
    run(&mut bodies, 3.0);
    assert!((bodies.centre_of_mass()[2] - floor).abs() < 0.002, "rests at {:?}", bodies.centre_of_mass());
    assert!(bodies.kinetic_energy() < 1e-5 && bodies.touches_floor(ModuleId(0)));
}

/// Joints follow a target at no more than their speed without load, and hold it against the weight of limbs.
#[test]
fn joints_reach_their_targets_no_faster_than_without_load() {
    let mut bodies = quad(FRICTION);
    run(&mut bodies, 0.5);
    let (knee, target) = (Joint::new(ModuleId(1), 1), 1.0);
    bodies.set_target(knee, target);
    let mut fastest: f32 = 0.0;
    for _ in 0..300 {
        let before = bodies.angle(knee);
        bodies.step();
        fastest = fastest.max((bodies.angle(knee) - before).abs() / 0.01);
    }
    assert!(fastest > 0.5 * NO_LOAD[1] && fastest < 1.02 * NO_LOAD[1], "{fastest} rad/s");
    assert!((bodies.angle(knee) - target).abs() < 0.01, "{} rad", bodies.angle(knee));
    let others = (0..15).map(Joint).filter(|j| *j != knee);
    assert!(others.into_iter().all(|j| bodies.angle(j).abs() < 0.02));
}

fn swing(bodies: &mut Bodies, seconds: u32) -> Vec<u64> {
    let mut hashes = Vec::new();
    for tick in 0..100 * seconds {
        for joint in [0_u16, 1, 2, 4, 7, 10, 13] {
            // A triangle wave: no sine of the standard library.
            let phase = (tick + 50 * u32::from(joint)) % 500;
            let wave = (phase as f32 - 250.0).abs() / 250.0;
            bodies.set_target(Joint(joint), wave - 0.5);
        }
        bodies.step();
        let mut hasher = SipHasher13::new();
        bodies.digest(&mut hasher);
        hashes.push(hasher.finish());
    }
    hashes
}

/// The hash of a run is the same in every build and on every machine; debug and release builds test it.
#[test]
fn the_same_commands_give_the_same_bits() {
    let hashes = swing(&mut quad(FRICTION), 5);
    assert_eq!(hashes, swing(&mut quad(FRICTION), 5));
    assert_ne!(hashes[499], swing(&mut quad(0.6), 5)[499]);
    assert_eq!(hashes[499], GOLDEN_HASH, "another engine, or other settings: {}", hashes[499]);
}

/// The hash of the state of `swing` at the time 5 s.
const GOLDEN_HASH: u64 = 2_585_486_517_952_079_514;

/// The floor pushes upwards only, from where hulls are, however long they have rolled. With a wrong normal a joint at rest
/// was turned at 16 rad/s within a tick.
#[test]
fn the_floor_pushes_upwards() {
    let mut bodies = quad(FRICTION);
    for tick in 0..3000_u32 {
        for joint in 0..15_u16 {
            let phase = (tick + 70 * u32::from(joint)) % 400;
            bodies.set_target(Joint(joint), ((phase as f32 - 200.0).abs() / 100.0 - 1.0) * 1.5);
        }
        // Contacts are those of the beginning of a step.
        let heights: Vec<f32> = (0..20).map(|hemisphere| bodies.lowest(hemisphere)).collect();
        bodies.step();
        for (hemisphere, normal, height) in bodies.floor_contacts() {
            assert_eq!(normal, [0.0, 0.0, 1.0], "tick {tick}, hemisphere {hemisphere}");
            let lowest = heights[hemisphere];
            assert!(height > lowest - 1e-4, "tick {tick}, hemisphere {hemisphere}: {height} m, {lowest} m");
        }
    }
}

/// In free flight no force moves the centre of mass sideways. The engine conserves momentum to a centimetre only, since it
/// leaves out Coriolis terms in some steps; on the floor friction is a hundred times stronger.
#[test]
fn in_flight_the_centre_of_mass_falls_straight_down() {
    let mut bodies = quad(FRICTION);
    bodies.lift(200.0);
    let start = bodies.centre_of_mass();
    swing(&mut bodies, 5);
    assert!(drift(&bodies, start) < 0.02, "{} m", drift(&bodies, start));
}

/// A ring stays closed and keeps its posture while the limbs swing. Forces in it have more than one way, so there is no work.
#[test]
fn a_ring_of_modules_stays_closed() {
    let ring = named::structure("struct10").unwrap();
    let mut joints = [[0.0; 3]; 10];
    joints[..4].fill([-120.0, 90.0, 0.0]);
    let mut bodies = Bodies::new(&ring, &joints, Down::DEFAULT, FRICTION).unwrap();
    let ring: Vec<Joint> = (0..12).map(Joint).collect();
    let before: Vec<f32> = ring.iter().map(|joint| bodies.angle(*joint)).collect();
    let (mut gap, mut off): (f32, f32) = (0.0, 0.0);
    for tick in 0..500_u32 {
        let angle = 0.5 * ((tick % 400) as f32 - 200.0).abs() / 100.0 - 0.5;
        (4..10).for_each(|m| bodies.set_target(Joint::new(ModuleId(m), 1), angle));
        bodies.step();
        gap = gap.max(bodies.gap());
        let turned = ring.iter().zip(&before).map(|(joint, angle)| (bodies.angle(*joint) - angle).abs());
        off = turned.fold(off, f32::max);
    }
    println!("{:.2} mm apart, joints of the ring within {off:.3} rad", 1000.0 * gap);
    assert!(gap < 0.002 && off < 0.1, "{gap} m, {off} rad");
    assert_eq!(bodies.work(), None);
}

/// On a slope that is less steep than friction holds, a structure rests; on a steeper one it slides down.
#[test]
fn a_slope_pulls_downhill() {
    for (degrees, slides) in [(10.0_f32, false), (50.0, true)] {
        let mut bodies = quad(FRICTION);
        bodies.tilt(degrees.to_radians());
        let start = bodies.centre_of_mass();
        run(&mut bodies, 2.0);
        let moved = bodies.centre_of_mass()[0] - start[0];
        assert!(if slides { moved < -0.3 } else { moved.abs() < 0.005 }, "{degrees} degrees: {moved} m");
    }
}

/// Without weight and floor nothing else works on bodies: what motors give is what bodies gain.
#[test]
fn motors_give_what_bodies_gain() {
    let mut bodies = quad(FRICTION);
    bodies.lift(1.0);
    bodies.weightless();
    let (mut most, mut energy): (f64, f64) = (0.0, 0.0);
    for tick in 0..300_u32 {
        for joint in 0..15_u16 {
            let phase = (tick + 70 * u32::from(joint)) % 400;
            bodies.set_target(Joint(joint), ((phase as f32 - 200.0).abs() / 100.0 - 1.0) * 0.8);
        }
        bodies.step();
        let gained = f64::from(bodies.kinetic_energy());
        energy = energy.max(gained);
        most = most.max((bodies.motors().net_joules() - gained).abs());
    }
    let given = bodies.work().unwrap();
    println!("{given:.3} J given, {energy:.3} J at most, off by {most:.3} J at most");
    assert!(given > 0.1 && most < 0.2 * given, "{given} J, off by {most} J");
}

/// On the floor, too: if a contact were left out, motors would seem to be many times as strong as they are. The engine leaves out
/// Coriolis terms, and in some ticks of impacts more is missing than a motor has.
#[test]
fn motors_are_as_strong_as_they_are() {
    let mut bodies = quad(FRICTION);
    let mut torques: Vec<f32> = Vec::new();
    for tick in 0..800_u32 {
        for joint in 0..15_u16 {
            let phase = (tick + 70 * u32::from(joint)) % 400;
            // From rest to the full swing within 2 s.
            let grown = 0.004 * tick.min(200) as f32;
            bodies.set_target(Joint(joint), ((phase as f32 - 200.0).abs() / 100.0 - 1.0) * grown);
        }
        bodies.step();
        torques.push(bodies.motors().largest_impulse() / TICK.as_secs_f64() as f32);
    }
    torques.sort_by(f32::total_cmp);
    let [middle, high, most] = [400, 760, 799].map(|i| torques[i]);
    println!("{middle:.2}, {high:.2}, {most:.2} Nm, {:.1} J", bodies.work().unwrap());
    assert!(middle > 0.2 && high < 1.1 * TORQUE[0], "{middle}, {high}, {most} Nm");
}

/// Limbs that bend towards each other meet, and the depth of the overlap is known.
#[test]
fn limbs_that_meet_are_seen() {
    let mut bodies = quad(FRICTION);
    let mut deepest: f32 = 0.0;
    for tick in 0..1000 {
        let angle = tick.min(300) as f32 / 300.0 * 2.6;
        (1..5).for_each(|m| bodies.set_target(Joint::new(ModuleId(m), 1), angle));
        (1..5).for_each(|m| bodies.set_target(Joint::new(ModuleId(m), 0), angle));
        bodies.step();
        deepest = deepest.max(bodies.overlap());
    }
    assert!(deepest > 0.0 && deepest < 0.02, "{deepest} m");
}

#[test]
fn what_cannot_be_placed_is_refused() {
    let ring = named::structure("struct10").unwrap();
    let mut joints = [[0.0; 3]; 10];
    let refused = |joints: &[[f64; 3]], friction| Bodies::new(&ring, joints, Down::DEFAULT, friction).err();
    assert!(matches!(refused(&joints, 0.8), Some(PhysicsError::Geometry(_))));
    joints[..4].fill([-120.0, 90.0, 0.0]);
    assert_eq!(refused(&joints, 0.8), None);
    for friction in [-0.1, f32::NAN, f32::INFINITY] {
        assert!(matches!(refused(&joints, friction), Some(PhysicsError::Friction(_))));
    }
}
