//! Carry tables, hand-overs and moves against test vectors that were computed by another program.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_core::lattice::{Cell, Face};
use metamorph_planning::manipulation::carry::CarryTable;
use metamorph_planning::manipulation::contact::ElementSweeper;
use metamorph_planning::manipulation::element::Element;
use metamorph_planning::manipulation::handover::HandoverTable;
use metamorph_planning::manipulation::load::{LoadLimits, LoadTable, standing_peak};
use metamorph_planning::manipulation::torque_walk::{Estimate, MoveGraph};
use metamorph_roombots::database::Database;
use metamorph_roombots::grid::GridState;
use metamorph_roombots::{Kind, torque};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::sync::LazyLock;

static DATABASE: LazyLock<Database> = LazyLock::new(Database::build);

static VECTORS: LazyLock<Value> = LazyLock::new(|| {
    serde_json::from_str(include_str!("data/manipulation-test-vectors.json")).expect("the vectors are JSON")
});

/// The masses of the vectors, in grams.
const MASSES: [(&str, u32); 5] = [("0.25", 250), ("0.5", 500), ("0.75", 750), ("1.0", 1000), ("1.4", 1400)];

fn element(name: &str) -> Element {
    name.parse().unwrap()
}

fn kind(value: &Value) -> Kind {
    value.as_str().unwrap().parse().unwrap()
}

/// Returns the sizes of the main set without limits and within the nominal torques for each mass.
fn sizes(carry: &CarryTable) -> [usize; 6] {
    let loads = LoadTable::new(DATABASE.table(carry.kind()), carry, Face::Down);
    let within = |grams: u32| {
        carry.connected(|_| true, |step| loads.peak(step, grams).within(LoadLimits::NOMINAL))[0].len()
    };
    let [a, b, c, d, e] = MASSES.map(|(_, grams)| within(grams));
    [carry.main_set().len(), a, b, c, d, e]
}

#[test]
fn carry_tables_are_those_of_the_vectors() {
    for row in VECTORS["carry"].as_array().unwrap() {
        let name = row["element"].as_str().unwrap();
        let tables = CarryTable::all(&DATABASE, kind(&row["kind"]), &element(name));
        let best = CarryTable::best(&tables).unwrap();
        let [main, within @ ..] = sizes(best);
        let by_mass: serde_json::Map<String, Value> =
            MASSES.iter().zip(within).map(|((mass, _), n)| ((*mass).to_owned(), json!(n))).collect();
        let found = json!({
            "element": name, "kind": row["kind"], "grips": tables.len(), "valid": best.valid(),
            "main": main, "main_within_torque": by_mass,
        });
        assert_eq!(found, *row);
    }
}

/// The other cells of the published table: PER, and the elements without vectors.
#[test]
fn carry_tables_without_vectors() {
    for (name, kind, valid, expected) in [
        ("cube", Kind::Per, 920, [792, 792, 768, 724, 656, 588]),
        ("cube", Kind::Srz, 956, [854, 854, 830, 782, 704, 634]),
        ("bar2", Kind::Per, 880, [736, 736, 712, 664, 604, 520]),
        ("bar3", Kind::Per, 864, [712, 712, 688, 584, 552, 480]),
        ("L3", Kind::Par, 880, [829, 829, 795, 746, 672, 598]),
        ("L3", Kind::Srs, 838, [754, 754, 719, 675, 613, 552]),
        ("L3", Kind::Per, 796, [684, 684, 650, 612, 557, 505]),
        ("plate2x2", Kind::Srs, 838, [743, 743, 709, 663, 622, 543]),
    ] {
        let tables = CarryTable::all(&DATABASE, kind, &element(name));
        let best = CarryTable::best(&tables).unwrap();
        assert_eq!((best.valid(), sizes(best)), (valid, expected), "{name} {kind}");
    }
}

fn cube(kind: Kind, sweeper: &mut ElementSweeper) -> CarryTable {
    CarryTable::new(&DATABASE, kind, &element("cube").grips()[0], sweeper)
}

#[test]
fn steps_and_places_of_a_cube() {
    let mut sweeper = ElementSweeper::new();
    for kind in [Kind::Par, Kind::Srs] {
        let carry = cube(kind, &mut sweeper);
        assert_eq!(carry.steps().len(), VECTORS["carry_cube_strict_steps"][kind.name()]);
        let at: Vec<Cell> = carry.main_set().into_iter().map(|p| carry.held(p).unwrap()[0]).collect();
        let heights: Vec<usize> = (0..5).map(|z| at.iter().filter(|c| c.z == z).count()).collect();
        assert_eq!(json!(heights), VECTORS["gripped_height_cube"][kind.name()]);
        assert_eq!(at.iter().collect::<BTreeSet<_>>().len(), VECTORS["cells_of_cube"]);
    }
    assert_eq!(cube(Kind::Per, &mut sweeper).steps().len(), 2240);
    // Depths into the floor are far apart, so that verdicts do not depend on the number of samples.
    let depths = sweeper.depths_into_floor();
    assert!(depths.iter().all(|mm| *mm < 0.01 || *mm > 8.0), "{depths:?}");
}

/// A step of a carry table sweeps what the step of the motion database sweeps, the element at both ends, and more.
#[test]
fn sweeps_hold_the_cells_of_both_ends() {
    let database = &*DATABASE;
    for name in ["L3", "plate3x3"] {
        let grip = &element(name).grips()[3];
        let carry = CarryTable::new(database, Kind::Srs, grip, &mut ElementSweeper::new());
        let mut more = 0;
        for step in carry.steps() {
            let known = database.table(Kind::Srs).steps();
            let own = known.iter().find(|s| (s.from, s.to) == (step.from, step.to)).unwrap();
            let mut least: BTreeSet<Cell> = database.resolve(&own.core.union(&own.graze)).collect();
            least.extend([step.from, step.to].iter().flat_map(|p| carry.held(*p).unwrap()));
            let set = carry.set(|c| least.contains(&c));
            assert_eq!(set.len(), least.len(), "every cell has a number");
            let rest = carry.set(|c| least.contains(&c) && !carry.set(|d| d == c).meets(&step.swept));
            assert!(rest.is_empty(), "{name} {step:?}");
            more += step.swept.len() - least.len();
        }
        assert!(more > 0, "{name}: an element never sweeps a cell between its places");
    }
}

#[test]
fn hand_overs_of_a_cube() {
    let carry = cube(Kind::Srs, &mut ElementSweeper::new());
    let found = HandoverTable::new(DATABASE.table(Kind::Srs), &element("cube"), &carry, &carry);
    let counts = (found.examined, found.free(), found.pairs.len(), found.same_floor());
    assert_eq!(counts, (8_624_600, 7_767_024, 3_951, 257));
}

#[test]
fn moves_under_limits_of_torque() {
    let rows = VECTORS["torque_experiment"]["PAR"].as_object().unwrap();
    for (name, row) in rows {
        let (estimate, limits) = name.split_once(' ').unwrap_or((name, "5/2.5"));
        let (outer, middle) = limits.split_once('/').unwrap();
        let limits = torque::Limits { outer: outer.parse().unwrap(), middle: middle.parse().unwrap() };
        let estimate = Estimate::ALL.into_iter().find(|e| e.name() == estimate).unwrap();
        assert_eq!(json_of(Kind::Par, estimate, limits), *row, "{name}");
    }
    let (low, nominal) = (torque::Limits::EXPERIMENT_LOW, torque::Limits::NOMINAL);
    for (estimate, limits, moves, degrees) in [
        (Estimate::None, nominal, 7, 2640),
        (Estimate::Worst, torque::Limits::EXPERIMENT, 9, 5160),
        (Estimate::Worst, low, 17, 6150),
        (Estimate::Printed, nominal, 17, 6150),
        (Estimate::Exact, low, 7, 3360),
    ] {
        let found = json_of(Kind::Srs, estimate, limits);
        assert_eq!((&found["moves"], &found["degrees"]), (&json!(moves), &json!(degrees)), "{estimate:?}");
    }
}

fn json_of(kind: Kind, estimate: Estimate, limits: torque::Limits) -> Value {
    let table = DATABASE.table(kind);
    let moves = MoveGraph::new(table, estimate, limits);
    let walk = moves.walk(table, GridState::new(0, 0, 0), GridState::new(12, 5, 0), (20, 13));
    json!({
        "postures": moves.postures, "steps": moves.steps, "landing_states": moves.landings.len(),
        "moves": walk.map(|w| w.moves), "degrees": walk.map(|w| w.degrees),
    })
}

/// A negative control: limits of torque that hold only for the posture at the end of a step (thesis 5.1.3, step 5) let steps
/// pass with 1.4 kg on which joints exceed them.
#[test]
fn torque_at_the_end_of_a_step_alone_is_not_enough() {
    let (table, cube) =
        (DATABASE.table(Kind::Srs), &CarryTable::all(&DATABASE, Kind::Srs, &element("cube"))[0]);
    let loads = LoadTable::new(table, cube, Face::Down);
    let stands =
        |posture: u16| standing_peak(table, cube, Face::Down, posture, 1400).within(LoadLimits::NOMINAL);
    let passes = |step: usize| loads.peak(step, 1400).within(LoadLimits::NOMINAL);
    let steps = cube.steps().iter().enumerate();
    let exceeding = steps.filter(|(i, s)| stands(s.from) && stands(s.to) && !passes(*i)).count();
    assert!(exceeding > 0);
}
