//! The counts of reachable connectors (thesis table 2.2) per set of assumptions, and static torque.

use metamorph_roombots::Kind;
use metamorph_roombots::grid::GridState;
use metamorph_roombots::posture::Posture;
use metamorph_roombots::reach::{
    Assumptions, PUBLISHED, incomplete_search, positions, reachable, reachable_each,
};
use metamorph_roombots::torque::{Limits, Load, Torque, overloaded, torques};
use nalgebra::Vector3;
use std::collections::BTreeSet;

#[test]
fn counts_per_set_of_assumptions() {
    let sets = Assumptions::ALL;
    // Lattice; any angles; above the floor; exact bodies; spheres 5 and 1 per rib; high middle.
    let expected = [
        (Kind::Single, [(4, 2); 7]),
        (Kind::Par, [(20, 8), (29, 13), (28, 12), (28, 12), (28, 12), (28, 12), (18, 10)]),
        (Kind::Srs, [(36, 12), (58, 21), (56, 20), (55, 20), (55, 20), (56, 20), (45, 18)]),
        (Kind::Per, [(34, 12), (54, 20), (53, 19), (53, 19), (53, 19), (53, 19), (47, 17)]),
        (Kind::Srz, [(36, 12), (58, 21), (56, 20), (55, 20), (55, 20), (56, 20), (45, 18)]),
    ];
    let mut exact = Vec::new();
    for (kind, counts) in expected {
        let found = reachable_each(kind, &sets);
        let mine: Vec<_> = found.iter().map(|s| (s.len(), positions(s))).collect();
        assert_eq!(mine, counts, "{kind}");
        // States that the lattice reaches are reached by continuous angles, too.
        assert!(found[0].is_subset(&found[3]), "{kind}");
        exact.push(found[3].clone());
    }
    let mirror = |s: &BTreeSet<GridState>| s.iter().map(|x| x.mirrored()).collect::<BTreeSet<_>>();
    assert_eq!(mirror(&exact[2]), exact[4], "SRS is the mirror image of SRZ");
    assert!(exact[1].is_subset(&exact[3]), "PAR is inside PER, against the remark in thesis 2.2.4");
    // The published table breaks the mirror symmetry, so no complete method gives it.
    assert_ne!(PUBLISHED[2], PUBLISHED[4]);
    assert_eq!(PUBLISHED[0] as usize, positions(&exact[0]));
}

/// A few random starts miss states; with four of them the published numbers are near.
#[test]
fn random_starts_miss_states() {
    for (kind, published) in Kind::METAMODULES.into_iter().zip(&PUBLISHED[1..]) {
        let complete = reachable(kind, Assumptions::AnyAngles);
        let runs: Vec<BTreeSet<GridState>> = (0..3).map(|seed| incomplete_search(kind, 4, seed)).collect();
        assert!(runs.iter().all(|r| r.is_subset(&complete) && r.len() < complete.len()), "{kind}");
        let mean = runs.iter().map(BTreeSet::len).sum::<usize>() as f64 / 3.0;
        assert!((mean - f64::from(*published)).abs() < 8.0, "{kind}: {mean}");
        assert_eq!(runs[1], incomplete_search(kind, 4, 1), "seeded");
    }
}

fn row(torques: &[Torque], of: impl Fn(&Torque) -> f64) -> Vec<f64> {
    torques.iter().map(|t| (of(t) * 100.0).round() / 100.0 + 0.0).collect()
}

fn degrees(d: [f64; 6]) -> [f64; 6] {
    d.map(f64::to_radians)
}

#[test]
fn torques_of_the_tabulated_postures() {
    let floor = Load::floor();
    let wall = Load { gravity: Vector3::x(), ..Load::floor() };
    // Least favourable class: gravity along the face diagonal that the axes are square to.
    let diagonal = Load { gravity: Vector3::new(1.0, -1.0, 0.0).normalize(), ..Load::floor() };
    let lying = degrees([120.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    let straight = [0.0; 6];
    let l = degrees([0.0, 0.0, 120.0, 0.0, 0.0, 0.0]);
    let flat_l = degrees([120.0, 0.0, 120.0, 0.0, 0.0, 0.0]);
    let i_worst = [4.53, 3.40, 2.27, 0.76, 0.38, 0.0];
    let i_printed = [5.61, 0.0, 2.67, 0.80, 0.0, 0.0];
    let i_exact = [2.62, 0.0, 1.31, 0.44, 0.0, 0.0];
    for (q, load, worst, printed, exact) in [
        (lying, floor, i_worst, i_printed, i_exact),
        (straight, wall, i_worst, i_printed, i_exact),
        (straight, diagonal, i_worst, [6.48, 0.0, 3.08, 0.93, 0.0, 0.0], [3.70, 0.0, 1.85, 0.62, 0.0, 0.0]),
        (
            l,
            floor,
            [2.27, 2.27, 2.27, 0.76, 0.38, 0.0],
            [3.74, 0.0, 2.67, 0.80, 0.0, 0.0],
            [1.31, 0.0, 1.31, 0.44, 0.0, 0.0],
        ),
        (
            flat_l,
            floor,
            [3.20, 2.53, 2.27, 0.76, 0.38, 0.0],
            [1.87, 4.53, 2.67, 0.80, 0.0, 0.0],
            [0.0, 2.27, 1.31, 0.44, 0.0, 0.0],
        ),
    ] {
        let t = torques(Kind::Par, &q, &load).unwrap();
        assert_eq!(row(&t, |t| t.worst), worst);
        assert_eq!(row(&t, |t| t.printed), printed);
        assert_eq!(row(&t, |t| t.exact), exact);
    }
}

#[test]
fn largest_torques_over_all_floor_postures() {
    for (kind, printed_over) in [(Kind::Par, 288), (Kind::Srs, 264), (Kind::Per, 240), (Kind::Srz, 264)] {
        let mut worst = [0f64; 6];
        let mut printed = [0f64; 6];
        let mut exact = [0f64; 6];
        let mut loaded = [0f64; 6];
        let mut over = 0;
        for posture in Posture::all(kind).filter(|p| p.placement().above_floor()) {
            let q = posture.radians();
            let free = torques(kind, &q, &Load::floor()).unwrap();
            let carrying = torques(kind, &q, &Load { payload: 0.5, ..Load::floor() }).unwrap();
            for i in 0..6 {
                worst[i] = worst[i].max(free[i].worst);
                printed[i] = printed[i].max(free[i].printed);
                exact[i] = exact[i].max(free[i].exact);
                loaded[i] = loaded[i].max(carrying[i].exact);
                assert!(free[i].exact <= free[i].reasonable + 1e-9);
                assert!(free[i].reasonable <= free[i].worst + 1e-9);
            }
            over += u32::from(free.iter().enumerate().any(|(i, t)| t.printed > Limits::NOMINAL.of(i)));
            assert_eq!(overloaded(kind, &q, &Load::floor(), &Limits::NOMINAL), Ok(None));
        }
        let round = |v: [f64; 6]| v.map(|x| (x * 100.0).round() / 100.0);
        assert_eq!(round(worst), [4.53, 3.40, 2.27, 0.76, 0.38, 0.0], "{kind}");
        assert_eq!(round(printed), [5.61, 4.53, 2.67, 0.80, 0.0, 0.0], "{kind}");
        assert_eq!(round(exact), [2.62, 2.27, 1.31, 0.44, 0.0, 0.0], "{kind}");
        // 3.61 Nm against 3.6 Nm nominal: the payload limit of about 0.5 kg in thesis 2.2.
        assert_eq!(round(loaded), [3.71, 3.61, 2.09, 0.90, 0.27, 0.16], "{kind}");
        assert_eq!(over, printed_over, "{kind}");
    }
}

/// Straight out of a wall with 0.5 kg in the least favourable class is too much.
#[test]
fn the_payload_on_a_wall_is_too_much() {
    let load = Load { gravity: Vector3::new(1.0, -1.0, 0.0).normalize(), payload: 0.5, ..Load::floor() };
    let t = torques(Kind::Per, &[0.0; 6], &load).unwrap();
    assert!((t[0].exact - 5.24).abs() < 0.005, "{}", t[0].exact);
    assert_eq!(overloaded(Kind::Per, &[0.0; 6], &load, &Limits::NOMINAL), Ok(Some(0)));
}
