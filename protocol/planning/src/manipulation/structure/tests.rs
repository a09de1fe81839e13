//! The table: four upright metamodules that hold a plate, and structures that cannot be built.

use super::assembly::{Failure, StructureAnswer, plan_as_thesis, plan_structure};
use super::isolation::{CELL, Isolation, thesis_order};
use super::removal::Taking;
use super::*;
use crate::plan::and_or::{Disassembly, Removals, disassemble};
use metamorph_roombots::lattice_pose::{LatticePose, LatticeRotation};
use metamorph_roombots::posture::Posture;
use std::sync::LazyLock;

static DATABASE: LazyLock<Arc<Database>> = LazyLock::new(|| Arc::new(Database::build()));

const FEET: [(i16, i16); 4] = [(8, 5), (10, 5), (10, 7), (8, 7)];

fn upright(foot: (i16, i16)) -> Seat {
    [0, 1, 2, 3].map(|z| Cell::new(foot.0, foot.1, z))
}

fn plate(x: i16, y: i16, z: i16) -> Vec<Cell> {
    let cells = (0..3).flat_map(|i| (0..3).map(move |j| Cell::new(x + i, y + j, z)));
    cells.collect()
}

/// A table whose plate has this mass, in grams.
fn table(grams: u32) -> Structure {
    let site = Site {
        database: DATABASE.clone(),
        kind: Kind::Srs,
        floor: Terrain::rectangle((0, 0), (15, 12)),
        limits: LoadLimits::NOMINAL,
    };
    let part =
        Part { shape: "plate3x3".parse().unwrap(), grams, start: plate(4, 5, 0), goal: plate(8, 5, 4) };
    Structure::new(site, FEET.map(upright).to_vec(), vec![part], Grips::OfSeats).unwrap()
}

fn bodies(structure: &Structure, feet: &[(i16, i16)]) -> Vec<Body> {
    let table = DATABASE.table(Kind::Srs);
    let posture = table.find(Posture::zero(Kind::Srs)).unwrap();
    let foot =
        |(x, y): &(i16, i16)| LatticePose { rotation: LatticeRotation::IDENTITY, half: [2 * x, 2 * y, 0] };
    feet.iter().map(|f| Body { foothold: structure.foothold(foot(f)).unwrap(), posture }).collect()
}

fn items(seats: &[usize], plate: bool) -> Items {
    let all = seats.iter().fold(Items::default(), |s, seat| s.with(Items::one(*seat)));
    if plate { all.with(Items::one(4)) } else { all }
}

#[test]
fn a_table_stands_while_a_leg_holds_its_plate() {
    let structure = table(500);
    assert_eq!(structure.whole(), items(&[0, 1, 2, 3], true));
    assert!((0..4).all(|seat| structure.is_bond(0, seat)));
    assert_eq!(structure.stable(structure.whole()), Ok(()));
    assert_eq!(structure.stable(items(&[2], true)), Ok(()));
    assert_eq!(structure.stable(items(&[0, 1], false)), Ok(()));
    assert_eq!(structure.stable(items(&[], true)), Err(Reason::NotHeld(0)));
}

#[test]
fn a_table_is_taken_apart_leg_by_leg_and_the_plate_with_the_last_one() {
    let structure = table(500);
    let mut taking = Taking::new(&structure);
    let Disassembly::Sequence(found) = disassemble(&mut taking, structure.whole(), 1000) else {
        panic!("it comes apart")
    };
    let bundles: Vec<usize> = found.iter().map(|r| r.bundle.len()).collect();
    assert_eq!(bundles, [1, 1, 1, 2], "{found:?}");
    assert!(found[3].bundle.has(4));
    // A leg turns the plate away over the heads of the others, too; no further metamodule can take it from four legs.
    assert!(taking.remove(structure.whole(), items(&[0], true)).is_ok());
    let refusal = taking.remove(structure.whole(), items(&[], true)).unwrap_err();
    assert_eq!(refusal.reason, Reason::NoCarrier);
}

#[test]
fn a_table_is_planned_from_where_its_metamodules_stand() {
    let structure = table(500);
    let at = bodies(&structure, &[(1, 1), (14, 2), (2, 10), (13, 10), (6, 1)]);
    let StructureAnswer::Plan(plan) = plan_structure(&structure, &at) else { panic!("there is a plan") };
    assert_eq!(plan.bundles.len(), 4);
    assert!(plan.bundles[0].items.has(4) && plan.bundles[0].items.len() == 2);
    assert!(plan.bundles.iter().all(|b| b.peak.within(LoadLimits::NOMINAL)));
    let before = |(i, b): (usize, &assembly::PlacedBundle)| b.after.iter().all(|j| *j < i);
    assert!(plan.bundles.iter().enumerate().all(before), "{plan:?}");
    let connections: u32 = plan.bundles.iter().map(|b| b.connections()).sum();
    assert!((8..60).contains(&connections) && plan.lower == 8, "{connections} {}", plan.lower);
    // Too few metamodules.
    assert_eq!(plan_structure(&structure, &at[..3]), StructureAnswer::Infeasible(Failure::TooFew));
}

#[test]
fn the_order_of_the_thesis_leaves_the_plate_over() {
    let structure = table(500);
    let isolation = Isolation::new(&structure);
    let mean = |items| (isolation.rank(items).isolation * 100 + CELL as u64 / 2) / CELL as u64;
    assert_eq!((mean(items(&[1], false)), mean(items(&[1], true))), (3227, 3559));
    let order = thesis_order(&structure);
    assert_eq!(order.taken.len(), 4);
    assert!(order.taken.iter().all(|chain| chain.items.len() == 1));
    assert_eq!(order.left_over, [0]);
    let at = bodies(&structure, &[(1, 1), (14, 2), (2, 10), (13, 10)]);
    let answer = plan_as_thesis(&structure, &at);
    assert_eq!(answer, StructureAnswer::Infeasible(Failure::LeftOver(vec![0])));
}

#[test]
fn a_plate_that_is_too_heavy_is_refused_with_the_reason() {
    let heavy = table(15_000);
    let at = bodies(&heavy, &[(1, 1), (14, 2), (2, 10), (13, 10)]);
    let answer = plan_structure(&heavy, &at);
    assert_eq!(answer, StructureAnswer::Infeasible(Failure::Unstable(Reason::TooHeavy(0))));
}
