//! Forward kinematics of the Roombots: test vectors of an independent model, the tie between the
//! continuous and the integer model, and the symmetries.

use metamorph_core::rng::Rng;
use metamorph_roombots::chain::{Chain, Pose, forward, mirror, random_angles};
use metamorph_roombots::connector::{Site, connector_pose};
use metamorph_roombots::grid::{GridState, fewest_moves, landings};
use metamorph_roombots::posture::Posture;
use metamorph_roombots::{Kind, KinematicsError};
use nalgebra::{Matrix3, Vector3};
use proptest::prelude::*;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};

#[derive(Deserialize)]
struct Vectors {
    fk: Vec<FkVector>,
    landings: BTreeMap<String, Vec<LandingVector>>,
    connectors_single: ConnectorVectors,
}
#[derive(Deserialize)]
struct FkVector {
    #[serde(rename = "type")]
    kind: String,
    q_rad: Vec<f64>,
    pose_cells: [[f64; 4]; 4],
}
#[derive(Deserialize)]
struct LandingVector {
    state: GridState,
    q_deg: Vec<Vec<i16>>,
}
#[derive(Deserialize)]
struct ConnectorVectors {
    q_rad: Vec<f64>,
    poses: BTreeMap<String, [[f64; 3]; 2]>,
}

fn vectors() -> Vectors {
    serde_json::from_str(include_str!("data/roombots-test-vectors.json"))
        .expect("the test vectors are part of the project")
}

#[test]
fn forward_kinematics_matches_the_vectors() {
    let all = vectors().fk;
    assert_eq!(all.len(), 25);
    for v in all {
        let head = forward(v.kind.parse().unwrap(), &v.q_rad).unwrap();
        let m = v.pose_cells;
        let expected = Pose {
            rotation: Matrix3::from_fn(|r, c| m[r][c]),
            origin: Vector3::new(m[0][3], m[1][3], m[2][3]),
        };
        // The vectors have nine decimals.
        assert!((head.rotation - expected.rotation).amax() < 1e-8, "{} {:?}", v.kind, v.q_rad);
        assert!((head.origin - expected.origin).amax() < 1e-8, "{} {:?}", v.kind, v.q_rad);
    }
}

#[test]
fn connectors_match_the_vectors() {
    let v = vectors().connectors_single;
    assert_eq!(v.poses.len(), 10);
    for (name, [origin, normal]) in v.poses {
        let pose = connector_pose(Kind::Single, &v.q_rad, name.parse().unwrap()).unwrap();
        assert!((pose.origin - Vector3::from(origin)).amax() < 1e-8, "{name}");
        // Outward normal in the vectors, +z into the module here.
        assert!((pose.rotation.column(2) + Vector3::from(normal)).amax() < 1e-8, "{name}");
    }
}

#[test]
fn landings_match_the_vectors() {
    let all = vectors().landings;
    assert_eq!(all.len(), 5);
    for (name, expected) in all {
        let kind: Kind = name.parse().unwrap();
        let found = landings(kind);
        assert_eq!(found.len(), expected.len(), "{kind}");
        for v in expected {
            let mine: BTreeSet<Vec<i16>> = found[&v.state].iter().map(|p| p.degrees()).collect();
            assert_eq!(mine, v.q_deg.into_iter().collect(), "{kind} {}", v.state);
        }
    }
}

/// The landings of a single module are the atomic motor primitives of thesis table 6.1.
#[test]
fn single_module_landings_are_table_6_1() {
    let found: Vec<(GridState, Vec<Vec<i16>>)> = landings(Kind::Single)
        .into_iter()
        .map(|(s, p)| (s, p.into_iter().map(Posture::degrees).collect()))
        .collect();
    let expected = [
        (GridState::new(0, 1, 2), vec![-120, 90, -120]), // τ (0,1), ρ = π
        (GridState::new(0, 1, 3), vec![-120, 180, 120]), // τ (0,1), ρ = −π/2
        (GridState::new(1, 0, 1), vec![120, 180, -120]), // τ (1,0), ρ = +π/2
        (GridState::new(1, 0, 2), vec![120, -90, 120]),  // τ (1,0), ρ = −π
    ];
    assert_eq!(found, expected.map(|(s, q)| (s, vec![q])));
}

/// How many atomic primitives it takes to each neighbour cell with any final class.
#[test]
fn primitives_per_neighbour_cell() {
    let moves = fewest_moves(Kind::Single, 1);
    let to = |x, y| (0..4).filter_map(|c| moves.get(&GridState::new(x, y, c))).min().copied().unwrap();
    assert_eq!([to(1, 0), to(0, 1)], [1, 1]);
    assert_eq!([to(1, 1), to(1, -1), to(-1, 1)], [2, 2, 2]);
    assert_eq!([to(-1, 0), to(0, -1)], [3, 3]);
    assert_eq!(to(-1, -1), 4);
}

#[test]
fn landing_states_and_positions() {
    for (kind, states, positions, postures) in [
        (Kind::Single, 4, 2, 4),
        (Kind::Par, 20, 8, 64),
        (Kind::Srs, 36, 12, 80),
        (Kind::Per, 34, 12, 96),
        (Kind::Srz, 36, 12, 80),
    ] {
        let all = landings(kind);
        let cells: BTreeSet<_> = all.keys().map(|s| (s.x, s.y)).collect();
        assert_eq!((all.len(), cells.len()), (states, positions), "{kind}");
        assert_eq!(all.values().map(Vec::len).sum::<usize>(), postures, "{kind}");
        // Closed under inversion; the reversed posture makes the landing back.
        for (state, makers) in &all {
            assert_eq!(state.then(state.inverse()), GridState::default());
            for p in makers {
                assert!(all[&state.inverse()].contains(&p.reversed()), "{kind} {state}");
            }
        }
        let mirrored: BTreeSet<_> = all.keys().map(|s| s.mirrored()).collect();
        assert_eq!(mirrored, landings(kind.mirrored()).into_keys().collect(), "{kind}");
    }
}

/// The table of classes per offset of the metamodules; the mirror images follow from the test above.
#[test]
fn classes_per_offset() {
    let per_kind = |expected: [&[u8]; 4], x: i16, y: i16| {
        for (kind, classes) in Kind::METAMODULES.into_iter().zip(expected) {
            let all = landings(kind);
            let found: Vec<u8> = (0..4).filter(|c| all.contains_key(&GridState::new(x, y, *c))).collect();
            assert_eq!(found, classes, "{kind} ({x}, {y})");
        }
    };
    per_kind([&[1, 2]; 4], 3, 0);
    per_kind([&[2, 3]; 4], 0, 3);
    per_kind([&[1, 2, 3]; 4], 2, 1);
    per_kind([&[1, 2, 3]; 4], 1, 2);
    per_kind([&[0, 1, 2], &[0, 1, 2], &[0, 1], &[0, 1, 2]], 2, -1);
    per_kind([&[0, 2, 3], &[0, 2, 3], &[0, 3], &[0, 2, 3]], -1, 2);
    per_kind([&[0, 1]; 4], 1, -2);
    per_kind([&[0, 3]; 4], -2, 1);
    for (x, y) in [(1, 0), (-1, 0), (0, 1), (0, -1)] {
        per_kind([&[], &[0, 1, 2, 3], &[0, 1, 2, 3], &[0, 1, 2, 3]], x, y);
    }
}

/// On the open grid every state within three cells takes at most four moves.
#[test]
fn every_state_of_the_open_grid_is_reached() {
    for kind in Kind::METAMODULES {
        let moves = fewest_moves(kind, 3);
        assert_eq!(moves.len(), 7 * 7 * 4, "{kind}");
        assert!(moves.values().all(|m| *m <= 4), "{kind}");
    }
}

#[test]
fn integers_and_exponentials_agree() {
    for kind in Kind::ALL {
        let chain = Chain::of(kind);
        let mut heads = BTreeSet::new();
        let mut whole = BTreeSet::new();
        for posture in Posture::all(kind) {
            let placement = posture.placement();
            let error = chain.head(&posture.radians()).error_to(&placement.head.into());
            assert!(error.norm() < 1e-12, "{kind} {:?}: {error}", posture.degrees());
            heads.insert(placement.head);
            whole.insert((placement.cells, placement.head));
        }
        assert_eq!(whole.len(), if kind == Kind::Single { 36 } else { 756 }, "{kind}");
        let above = Posture::all(kind).filter(|p| p.placement().above_floor()).count();
        assert_eq!(above, if kind == Kind::Single { 36 } else { 1056 }, "{kind}");
    }
}

#[test]
fn bad_questions_are_refused() {
    let error = forward(Kind::Par, &[0.0, 0.0, f64::INFINITY, 0.0, 0.0, 0.0]).unwrap_err();
    assert_eq!(error, KinematicsError::NotFinite { joint: 3, value: f64::INFINITY });
    assert!(error.to_string().contains("joint 3"));
    let error = forward(Kind::Single, &[0.0; 6]).unwrap_err();
    assert_eq!(error.to_string(), "single has 3 joints, but 6 angles were given");
    let error = "SRX".parse::<Kind>().unwrap_err();
    assert!(error.to_string().contains("PAR, SRS, PER, SRZ"), "{error}");
    let site: Site = "2:C0X".parse().unwrap();
    assert!(connector_pose(Kind::Single, &[0.0; 3], site).is_err());
}

fn any_kind() -> impl Strategy<Value = Kind> {
    prop::sample::select(Kind::ALL.to_vec())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(300))]

    /// Seen from the head, a robot is the same robot with its joints in reverse order.
    #[test]
    fn reversal(kind in any_kind(), seed in any::<u64>()) {
        let q = random_angles(kind, &mut Rng::named(seed, "reversal", 0));
        let back: Vec<f64> = q.iter().rev().copied().collect();
        let round = forward(kind, &q).unwrap().compose(&forward(kind, &back).unwrap());
        prop_assert!(round.error_to(&Pose::identity()).norm() < 1e-11);
    }

    /// The mirror x↔y with negated angles maps PAR and PER onto themselves and SRS onto SRZ.
    #[test]
    fn mirror_image(kind in any_kind(), seed in any::<u64>()) {
        let q = random_angles(kind, &mut Rng::named(seed, "mirror", 0));
        let negated: Vec<f64> = q.iter().map(|a| -a).collect();
        let head = forward(kind, &q).unwrap();
        let image = forward(kind.mirrored(), &negated).unwrap();
        let m = mirror();
        prop_assert!((m * head.rotation * m - image.rotation).amax() < 1e-12);
        prop_assert!((m * head.origin - image.origin).amax() < 1e-12);
    }

    /// The columns of the Jacobian are the derivatives of the head.
    #[test]
    fn jacobian(kind in any_kind(), seed in any::<u64>()) {
        let mut q = random_angles(kind, &mut Rng::named(seed, "jacobian", 0));
        let chain = Chain::of(kind);
        let (head, columns) = chain.head_and_jacobian(&q);
        for (i, column) in columns.iter().enumerate() {
            let kept = q[i];
            q[i] += 1e-6;
            let difference = head.error_to(&chain.head(&q)) / 1e-6;
            prop_assert!((difference - column).amax() < 1e-4);
            q[i] = kept;
        }
    }
}
