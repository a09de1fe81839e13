//! Inverse kinematics: all solutions of random and of lattice targets, and what is out of reach.

use metamorph_core::rng::Rng;
use metamorph_roombots::chain::{Chain, Pose, forward, joint_distance, random_angles};
use metamorph_roombots::inverse::levenberg_marquardt::{self, Options};
use metamorph_roombots::inverse::{InverseError, solve};
use metamorph_roombots::posture::Posture;
use metamorph_roombots::{Kind, KinematicsError};
use nalgebra::{Matrix3, Vector3};

/// Targets that postures with random angles make. Returns how often the generating posture was
/// among the solutions.
fn random_targets(kind: Kind, count: usize) -> usize {
    let chain = Chain::of(kind);
    let mut rng = Rng::named(20_261, "inverse", kind as u64);
    let mut generating = 0;
    for _ in 0..count {
        let q = random_angles(kind, &mut rng);
        let target = chain.head(&q);
        let solutions = solve(kind, &target).unwrap_or_else(|e| panic!("{kind} {q:?}: {e}"));
        for s in &solutions {
            let residual = chain.head(&s.q).error_to(&target).norm();
            assert!(residual < 1e-8, "{kind} {q:?}: {residual}");
        }
        generating += usize::from(solutions.iter().any(|s| joint_distance(&s.q, &q) < 1e-5));
    }
    generating
}

#[test]
fn random_targets_are_solved() {
    for kind in Kind::ALL {
        let generating = random_targets(kind, 150);
        assert!(generating >= 149, "{kind}: {generating} of 150");
    }
}

/// `cargo test --release -p metamorph-roombots --test inverse -- --ignored --nocapture`
#[test]
#[ignore = "10,000 targets per kind: seconds in release, a minute without optimisation"]
fn ten_thousand_targets_per_kind() {
    for kind in Kind::ALL {
        let generating = random_targets(kind, 10_000);
        println!("{kind}: 10000 of 10000 solved, generating posture found {generating} times");
        assert!(generating >= 9_950, "{kind}: {generating} of 10000");
    }
}

/// Lattice targets are the singular ones: every lattice posture comes back.
#[test]
fn lattice_targets_are_solved() {
    for kind in Kind::ALL {
        let chain = Chain::of(kind);
        for posture in Posture::all(kind).step_by(if kind == Kind::Single { 1 } else { 23 }) {
            let target: Pose = posture.placement().head.into();
            let solutions = solve(kind, &target).unwrap();
            let q = posture.radians();
            assert!(
                solutions.iter().any(|s| joint_distance(&s.q, &q) < 1e-9),
                "{kind} {:?}",
                posture.degrees()
            );
            assert!(solutions.iter().all(|s| chain.head(&s.q).error_to(&target).norm() < 1e-8));
        }
    }
}

/// Beside a singular posture targets are badly conditioned, but still solved.
#[test]
fn targets_near_the_lattice_are_solved() {
    let mut rng = Rng::named(6, "near the lattice", 0);
    for kind in Kind::METAMODULES {
        let chain = Chain::of(kind);
        for size in [1e-6, 1e-4, 1e-2] {
            let (mut tried, mut generating) = (0, 0);
            for posture in Posture::all(kind).step_by(19) {
                let shift = random_angles(kind, &mut rng);
                let q: Vec<f64> = posture.radians().iter().zip(&shift).map(|(a, s)| a + size * s).collect();
                let target = chain.head(&q);
                let solutions = solve(kind, &target).unwrap_or_else(|e| panic!("{kind} {q:?}: {e}"));
                assert!(solutions.iter().all(|s| chain.head(&s.q).error_to(&target).norm() < 1e-8));
                tried += 1;
                generating += u32::from(solutions.iter().any(|s| joint_distance(&s.q, &q) < 1e-5));
            }
            assert!(generating * 10 >= tried * 9, "{kind} {size}: {generating} of {tried}");
        }
    }
}

#[test]
fn damped_least_squares_reaches_most_targets() {
    // With ten starts at least 99 of 100; a single start reaches about three of four.
    for kind in Kind::METAMODULES {
        let chain = Chain::of(kind);
        let mut rng = Rng::named(5, "damped", kind as u64);
        let (mut one, mut ten) = (0, 0);
        for _ in 0..100 {
            let target = chain.head(&random_angles(kind, &mut rng));
            let options = Options::default();
            let mut starts = rng.clone();
            let first =
                levenberg_marquardt::solve_from_random_starts(&chain, &target, 1, &mut starts, &options);
            let all = levenberg_marquardt::solve_from_random_starts(&chain, &target, 10, &mut rng, &options);
            one += u32::from(first.reached);
            ten += u32::from(all.reached);
            if all.reached {
                assert!(chain.head(&all.q).error_to(&target).norm() < 1e-8);
            }
        }
        assert!((50..=98).contains(&one) && ten >= 97, "{kind}: {one}, {ten}");
    }
}

/// The damped solver takes chains of any length, such as two metamodules joined (12 joints).
#[test]
fn damped_least_squares_takes_any_chain() {
    let chain = Chain::of_modules([0, 2, 1, 2]);
    assert_eq!(chain.joints.len(), 12);
    let mut rng = Rng::named(9, "twelve", 0);
    let start: Vec<f64> = (0..12).map(|i| f64::from(i) / 5.0).collect();
    let goal: Vec<f64> = start.iter().map(|a| a + 0.3).collect();
    let target = chain.head(&goal);
    let outcome =
        levenberg_marquardt::solve_from_random_starts(&chain, &target, 5, &mut rng, &Options::default());
    assert!(outcome.reached, "{outcome:?}");
}

#[test]
fn out_of_reach_is_said() {
    let up = |z: f64| Pose { rotation: Matrix3::identity(), origin: Vector3::new(0.0, 0.0, z) };
    for kind in Kind::ALL {
        let error = solve(kind, &up(9.0)).unwrap_err();
        assert!(matches!(error, InverseError::TooFar { .. }), "{error}");
        // The last cube on the first: near, but no chain closes that tightly.
        let error = solve(kind, &up(0.0)).unwrap_err();
        assert_eq!(error, InverseError::Unreachable { kind });
        assert!(error.to_string().contains("out of reach"), "{error}");
        let outcome = levenberg_marquardt::solve(&Chain::of(kind), &up(9.0), &[0.1], &Options::default());
        assert!(!outcome.reached && outcome.residual > 1.0);
    }
}

#[test]
fn bad_poses_are_refused() {
    let mut pose = forward(Kind::Per, &[0.1; 6]).unwrap();
    pose.rotation[(0, 0)] += 0.1;
    let error = solve(Kind::Per, &pose).unwrap_err();
    assert!(matches!(error, InverseError::Question(KinematicsError::NotARotation { .. })), "{error}");
    pose.origin.x = f64::NAN;
    assert_eq!(solve(Kind::Per, &pose).unwrap_err(), KinematicsError::PoseNotFinite.into());
    // A mirror is orthonormal but turns nothing.
    let mirror = Pose { rotation: -Matrix3::identity(), origin: Vector3::zeros() };
    assert!(solve(Kind::Per, &mirror).is_err());
}
