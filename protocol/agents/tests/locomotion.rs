//! Body and limbs, networks and labels against the test vectors, table 7.2 and drawn structures.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_agents::free_module::limbs::partition;
use metamorph_agents::free_module::network::{Lags, Morphology, NetworkKind, NoOscillators};
use metamorph_agents::free_module::oscillator::{Angle, Dynamics, Oscillator, Phase};
use metamorph_agents::free_module::structure::{Connection, Joint, Structure, StructureError};
use metamorph_agents::free_module::{named, symmetry};
use metamorph_core::ids::ModuleId;
use metamorph_core::rng::Rng;
use metamorph_roombots::connector::Connector;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::collections::BTreeSet;

fn vectors() -> Value {
    serde_json::from_str(include_str!("data/locomotion-test-vectors.json")).unwrap()
}

fn read<T: DeserializeOwned>(value: &Value) -> T {
    serde_json::from_value(value.clone()).unwrap()
}

fn structures() -> Vec<(Value, Structure)> {
    let all: Vec<Value> = read(&vectors()["structures"]);
    let structure = |v: &Value| {
        let connections: Vec<Connection> = read(&v["connections"]);
        Structure::new(read(&v["modules"]), &connections).unwrap()
    };
    all.into_iter().map(|v| (v.clone(), structure(&v))).collect()
}

fn parameters(morphology: &Morphology, kind: NetworkKind, lags: Lags) -> usize {
    morphology.network(kind).unwrap().parameters(lags)
}

#[test]
fn body_and_limbs_are_those_of_the_vectors() {
    for (expected, structure) in structures() {
        let found = partition(&structure);
        let body = &expected["body"];
        if body["none"] == json!(true) {
            assert!(!found.has_body() && found.limbs.is_empty(), "{}", expected["name"]);
            continue;
        }
        let found = serde_json::to_value(found).unwrap();
        for part in ["biconnected", "cyclic", "selected", "linear", "limbs", "links"] {
            assert_eq!(found[part], body[part], "{part} of {}", expected["name"]);
        }
    }
}

#[test]
fn articulations_and_networks_are_those_of_the_vectors() {
    for (expected, structure) in structures() {
        let name = &expected["name"];
        let morphology = Morphology::of(&structure);
        let fo = morphology.network(NetworkKind::Fo).unwrap();
        let blf = morphology.network(NetworkKind::Blf).unwrap();
        if let Some(counts) = expected.get("fo") {
            let found = (fo.oscillators.len(), fo.couplings.len(), fo.parameters(Lags::Thesis));
            let counts = ["oscillators", "couplings", "parameters"].map(|k| read::<usize>(&counts[k]));
            assert_eq!(found, (counts[0], counts[1], counts[2]), "{name}");
            assert_eq!(blf, fo, "{name} has no body, so its reduced network is the full one");
            continue;
        }
        let roles: Vec<Value> = read(&expected["roles"]);
        assert_eq!(roles.len(), morphology.limbs.len(), "{name}");
        for (role, limb) in roles.iter().zip(&morphology.limbs) {
            let found = serde_json::to_value(limb).unwrap();
            assert_eq!(found["modules"], role["limb"], "{name}");
            for part in ["hip", "knee", "ankle", "pod", "labels"] {
                assert_eq!(found[part], role[part], "{part} of limb {} of {name}", role["limb"]);
            }
        }
        let value = |v: Value| v;
        assert_eq!(value(json!(morphology.spines)), expected["spines"], "{name}");
        assert_eq!(value(json!(morphology.hips())), expected["hips"], "{name}");
        assert_eq!(value(json!(blf.oscillators)), expected["oscillators"], "{name}");
        assert_eq!(value(json!(blf.couplings)), expected["couplings"], "{name}");
        let firsts = |group: &Vec<usize>| group.iter().map(|i| morphology.limbs[*i].modules[0]).collect();
        let symmetric: Vec<Vec<ModuleId>> = morphology.symmetric.iter().map(firsts).collect();
        assert_eq!(value(json!(symmetric)), expected["symmetric_limbs_by_first_module"], "{name}");
        let of = |kind| parameters(&morphology, kind, Lags::Thesis);
        for (kind, key) in NetworkKind::ALL.into_iter().zip(["FO", "BLF", "BLF_SYM", "SYM"]) {
            assert_eq!(of(kind), read::<usize>(&expected["parameters"][key]), "{kind} of {name}");
        }
        let as_printed = 2 * blf.oscillators.len() + 2 * blf.couplings.len();
        assert_eq!(as_printed, read::<usize>(&expected["parameters"]["eq_7_4_as_printed"]), "{name}");
        assert_eq!(named::structure(&read::<String>(name)).unwrap(), structure, "{name}");
    }
}

#[test]
fn labels_are_those_of_the_vectors() {
    let all: Vec<Value> = read(&vectors()["labels"]);
    assert!(all.len() > 5);
    for v in all {
        let (at, to) = (read(&v["source"]), read(&v["target"]));
        let c = Connection { a: ModuleId(0), at, b: ModuleId(1), to, rotation: read(&v["rotation"]) };
        assert_eq!(symmetry::label(&c), read::<u64>(&v["label"]), "{v}");
    }
}

/// One lag per oscillator but one, in every connected network (section 4: 20, 14 and 23).
#[test]
fn lags_of_a_tree_leave_out_what_follows() {
    let counts = |name: &str| {
        let morphology = Morphology::of(&named::structure(name).unwrap());
        [NetworkKind::Blf, NetworkKind::BlfSym].map(|kind| parameters(&morphology, kind, Lags::Tree))
    };
    assert_eq!(counts("quad5-sym"), [20, 14]);
    assert_eq!(counts("struct10"), [23, 23]);
}

/// Modules whose joints do not move keep their place, and have no oscillator.
#[test]
fn a_passive_body_moves_its_hips_into_the_limbs() {
    let mut quad = named::structure("quad5-sym").unwrap();
    let whole = partition(&quad);
    quad.set_passive(ModuleId(0));
    let morphology = Morphology::of(&quad);
    assert_eq!(morphology.partition, whole);
    let blf = morphology.network(NetworkKind::Blf).unwrap();
    assert_eq!(blf.oscillators, [3, 6, 9, 12].map(Joint));
    assert_eq!((morphology.spines.as_slice(), blf.couplings.len()), (&[][..], 6));
    assert_eq!(blf.parameters(Lags::Thesis), 14);
    assert_eq!(parameters(&morphology, NetworkKind::BlfSym, Lags::Thesis), 8);
    (1..5).for_each(|m| quad.set_passive(ModuleId(m)));
    assert_eq!(Morphology::of(&quad).network(NetworkKind::Blf), Err(NoOscillators));
}

#[test]
fn a_passive_limb_loses_its_knee_only() {
    let mut quad = named::structure("quad5-sym").unwrap();
    quad.set_passive(ModuleId(2));
    let blf = Morphology::of(&quad).network(NetworkKind::Blf).unwrap();
    assert_eq!(blf.oscillators, [0, 1, 2, 3, 9, 12].map(Joint));
    // Of a limb behind a ring, the hip moves to the first joint beyond that turns.
    let mut ring = named::structure("struct10").unwrap();
    ring.set_passive(ModuleId(4));
    let morphology = Morphology::of(&ring);
    assert_eq!(morphology.limbs[0].hip, Some(Joint(15)));
    assert_eq!(morphology.limbs[0].knee, None);
}

/// A ring with a limb, and behind a neck a fork: the neck is part of one body, not a limb between two.
#[test]
fn a_neck_between_ring_and_fork_is_a_link() {
    use Connector::{C0X, C0Y, C3X, C3Y};
    let joins = [(0, C3X, 1), (1, C3X, 2), (2, C3X, 3), (3, C3X, 0), (0, C0Y, 4), (2, C0Y, 5), (5, C3X, 6)];
    let fork = [(6, C3X, 7), (6, C3Y, 8)];
    let connection = |(a, at, b)| Connection { a: ModuleId(a), at, b: ModuleId(b), to: C0X, rotation: 0 };
    let connections: Vec<Connection> = joins.into_iter().chain(fork).map(connection).collect();
    let found = serde_json::to_value(partition(&Structure::new(9, &connections).unwrap())).unwrap();
    assert_eq!(found["cyclic"], json!([0, 1, 2, 3]));
    assert_eq!((&found["selected"], &found["links"]), (&json!([6]), &json!([[5]])));
    assert_eq!((&found["linear"], &found["limbs"]), (&json!([5, 6]), &json!([[4], [7], [8]])));
}

/// Numbers of modules that were released stay free.
#[test]
fn a_released_limb_is_gone() {
    let quad = named::structure("quad5-sym").unwrap();
    let without = |gone: u32| {
        let gone = ModuleId(gone);
        let members = quad.modules().filter(|m| *m != gone).map(|m| (m, true)).collect();
        let touches = |c: &&Connection| c.a != gone && c.b != gone;
        let rest: Vec<Connection> = quad.connections().iter().filter(touches).copied().collect();
        Structure::of(&members, &rest)
    };
    let tripod = Morphology::of(&without(3).unwrap());
    assert_eq!(tripod.network(NetworkKind::Blf).unwrap().oscillators, [0, 1, 2, 3, 6, 12].map(Joint));
    let (module, first) = (ModuleId(2), ModuleId(1));
    assert_eq!(without(0), Err(StructureError::Disconnected { module, first }));
}

/// Draws a connected structure: a tree, and up to three further connections.
fn drawn(seed: u64) -> Structure {
    let mut rng = Rng::named(seed, "structures", 0);
    let modules = 12 + rng.below(21) as u32;
    let mut free: Vec<Vec<Connector>> = vec![Connector::ALL.to_vec(); modules as usize];
    let mut connections = Vec::new();
    let mut take = |a: u32, b: u32, rng: &mut Rng| {
        let mut end = |m: u32| {
            let left = &mut free[m as usize];
            let at = rng.below(left.len() as u64) as usize;
            left.swap_remove(at)
        };
        let (at, to) = (end(a), end(b));
        connections.push(Connection { a: ModuleId(a), at, b: ModuleId(b), to, rotation: rng.below(4) as u8 });
    };
    for b in 1..modules {
        // Chains are as likely as bushes, and no module has more neighbours than connectors.
        let a = if rng.below(2) == 0 { b - 1 } else { rng.below(u64::from(b)) as u32 };
        let a = if b > 8 { a.max(b - 8) } else { a };
        take(a, b, &mut rng);
    }
    for _ in 0..rng.below(4) {
        let a = rng.below(u64::from(modules) - 1) as u32;
        take(a, a + 1, &mut rng);
    }
    Structure::new(modules as usize, &connections).unwrap()
}

/// Returns the structure with its modules renumbered.
fn relabelled(structure: &Structure, to: &[u32]) -> Structure {
    let new = |m: ModuleId| ModuleId(to[m.index()]);
    let moved: Vec<_> =
        structure.connections().iter().map(|c| Connection { a: new(c.a), b: new(c.b), ..*c }).collect();
    Structure::new(structure.bound(), &moved).unwrap()
}

/// Returns true if there is one shortest path between any two of these modules.
fn paths_are_unique(structure: &Structure, modules: &[ModuleId]) -> bool {
    let graph = structure.graph();
    let unique = |a: &ModuleId, b: &ModuleId| {
        let (from, to) = (graph.search(a.index()), graph.search(b.index()));
        let length = from.distance(b.index());
        let on_a_path = |n: &usize| from.distance(*n).zip(to.distance(*n)).map(|(x, y)| x + y) == length;
        graph.nodes().filter(on_a_path).count() == length.map_or(0, |l| l + 1)
    };
    modules.iter().all(|a| modules.iter().all(|b| unique(a, b)))
}

#[test]
fn drawn_structures_have_every_module_in_one_part() {
    let (mut with_body, mut with_cycle, mut compared) = (0, 0, 0);
    for seed in 0..1_000 {
        let structure = drawn(seed);
        let found = partition(&structure);
        let parts = [&found.cyclic, &found.linear].into_iter().chain(&found.limbs);
        let mut modules: Vec<ModuleId> = parts.flatten().copied().collect();
        modules.sort_unstable();
        if found.has_body() {
            assert_eq!(modules, structure.modules().collect::<Vec<_>>(), "seed {seed}");
        } else {
            assert!(modules.is_empty(), "seed {seed}: {found:?}");
        }
        with_body += u32::from(found.has_body());
        with_cycle += u32::from(!found.cyclic.is_empty());
        let morphology = Morphology::of(&structure);
        for kind in NetworkKind::ALL {
            let network = morphology.network(kind).unwrap();
            let n = network.oscillators.len();
            // A network is connected: one lag per oscillator but one is enough.
            assert_eq!(network.lags(Lags::Tree), n - 1, "seed {seed}, {kind}");
            assert!(network.groups() <= n && network.group.len() == n, "seed {seed}, {kind}");
        }
        if !paths_are_unique(&structure, &found.selected) {
            continue;
        }
        compared += 1;
        let mut rng = Rng::named(seed, "relabel", 0);
        let mut to: Vec<u32> = (0..structure.bound() as u32).collect();
        (1..to.len()).for_each(|i| to.swap(i, rng.below(i as u64 + 1) as usize));
        let again = partition(&relabelled(&structure, &to));
        let set = |part: &[ModuleId]| part.iter().map(|m| ModuleId(to[m.index()])).collect::<BTreeSet<_>>();
        let same = |part: &[ModuleId]| part.iter().copied().collect::<BTreeSet<_>>();
        let sets = |parts: &[Vec<ModuleId>], by: &dyn Fn(&[ModuleId]) -> BTreeSet<ModuleId>| {
            parts.iter().map(|p| by(p)).collect::<BTreeSet<_>>()
        };
        assert_eq!(set(&found.cyclic), same(&again.cyclic), "seed {seed}");
        assert_eq!(set(&found.linear), same(&again.linear), "seed {seed}");
        assert_eq!(sets(&found.limbs, &set), sets(&again.limbs, &same), "seed {seed}");
        assert_eq!(sets(&found.links, &set), sets(&again.links, &same), "seed {seed}");
    }
    // The claims are about something.
    assert!(with_body > 900 && with_cycle > 100 && compared > 800, "{with_body} {with_cycle} {compared}");
}

#[test]
fn lists_that_are_no_structure_are_refused() {
    use Connector::{C0X, C3X};
    let join = |a: u32, b: u32| Connection { a: ModuleId(a), at: C3X, b: ModuleId(b), to: C0X, rotation: 0 };
    let refused = |modules, connections: &[Connection]| Structure::new(modules, connections).unwrap_err();
    assert_eq!(refused(0, &[]), StructureError::Empty);
    assert_eq!(refused(257, &[]), StructureError::TooMany(257));
    assert_eq!(refused(2, &[join(0, 2)]), StructureError::NoModule { connection: 0, module: ModuleId(2) });
    assert_eq!(refused(2, &[join(1, 1)]), StructureError::ToItself { connection: 0, module: ModuleId(1) });
    let turned = Connection { rotation: 4, ..join(0, 1) };
    assert_eq!(refused(2, &[turned]), StructureError::Rotation { connection: 0, rotation: 4 });
    let twice = StructureError::UsedTwice { first: 0, second: 1, module: ModuleId(0), connector: C3X };
    assert_eq!(refused(3, &[join(0, 1), join(0, 2)]), twice);
    let (module, first) = (ModuleId(2), ModuleId(0));
    assert_eq!(refused(3, &[join(0, 1)]), StructureError::Disconnected { module, first });
}

/// The hash of a structure is the same whatever the order in which its connections are given.
#[test]
fn a_fingerprint_does_not_depend_on_order() {
    let quad = named::structure("quad5-sym").unwrap();
    let mut turned: Vec<Connection> = quad.connections().iter().map(Connection::reversed).collect();
    turned.reverse();
    let mut again = Structure::new(5, &turned).unwrap();
    assert_eq!(again.fingerprint(), quad.fingerprint());
    // Agents of different builds compare it.
    assert_eq!(quad.fingerprint(), 770_246_114_182_636_884);
    again.set_passive(ModuleId(1));
    assert_ne!(again.fingerprint(), quad.fingerprint());
    assert_ne!(named::structure("quad5-unsym").unwrap().fingerprint(), quad.fingerprint());
}

#[derive(Deserialize)]
struct Trajectory {
    structure: String,
    oscillators: Vec<Joint>,
    couplings: Vec<(Joint, Joint)>,
    lag_rad: Vec<f64>,
    amplitude_rad: Vec<f64>,
    offset_rad: Vec<f64>,
    start_phase_rad: Vec<f64>,
    samples: Vec<Sample>,
}

#[derive(Deserialize)]
struct Sample {
    t: f64,
    angle: Vec<f64>,
    phase_turns: Vec<f64>,
}

fn phase(radians: f64) -> Phase {
    Phase((radians / std::f64::consts::TAU * 2f64.powi(32)).round() as i64 as u32)
}

fn angle(radians: f64) -> Angle {
    Angle((radians * 2f64.powi(20)).round() as i32)
}

/// Steps of 10 ms in fixed point stay within 0.01 rad of the vectors, which are steps of 1 ms of a method of fourth order
/// in floating point; and the bits are the same in every build and on every machine.
#[test]
fn oscillators_follow_the_trajectories_of_the_vectors() {
    let all: Vec<Trajectory> = read(&vectors()["trajectories"]);
    let mut worst: f64 = 0.0;
    let mut bits = Vec::new();
    for of in &all {
        let place = |j: &Joint| of.oscillators.binary_search(j).unwrap();
        let mut states: Vec<Oscillator> = of
            .start_phase_rad
            .iter()
            .map(|p| Oscillator { phase: phase(*p), ..Oscillator::default() })
            .collect();
        for tick in 0..=1_200 {
            for sample in of.samples.iter().filter(|s| (s.t * 100.0).round() as u32 == tick) {
                for (i, state) in states.iter().enumerate() {
                    let found = f64::from(state.angle().0) / 2f64.powi(20);
                    worst = worst.max((found - sample.angle[i]).abs());
                    let turns = f64::from(state.phase.0) / 2f64.powi(32) - sample.phase_turns[i];
                    let turns = turns - turns.round();
                    assert!(turns.abs() < 0.01, "{} at {} s: {turns} turns", of.structure, sample.t);
                }
            }
            let mut pulls = vec![0; states.len()];
            for ((a, b), lag) in of.couplings.iter().zip(&of.lag_rad) {
                let (a, b) = (place(a), place(b));
                for (own, other, lag) in [(a, b, *lag), (b, a, -*lag)] {
                    let other = states[other];
                    pulls[own] +=
                        states[own].pull(&Dynamics::THESIS, other.phase, other.amplitude, phase(lag));
                }
            }
            for (i, state) in states.iter_mut().enumerate() {
                state.step(&Dynamics::THESIS, pulls[i], angle(of.amplitude_rad[i]), angle(of.offset_rad[i]));
            }
        }
        bits.extend(states.iter().map(|s| s.phase.0 ^ s.amplitude.0 as u32 ^ s.offset.0 as u32));
    }
    assert!(all.len() > 1 && worst < 0.01, "{worst}");
    let sum = bits.iter().fold(0_u64, |sum, b| sum.rotate_left(5) ^ u64::from(*b));
    assert_eq!(sum, 13_544_998_847_546_067_537, "worst {worst} rad");
}
