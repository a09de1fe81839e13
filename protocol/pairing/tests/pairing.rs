//! Pairing, reasons, repairs and splits against vectors, all small structures, brute force and random structures.

#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_core::lattice::{Cell, Face};
use metamorph_core::rng::Rng;
use metamorph_core::shape::components;
use metamorph_pairing::generated::{Kind, structure};
use metamorph_pairing::pins::{Pin, WithoutPins};
use metamorph_pairing::repair::{Allowed, Change, Cheapest, Choice};
use metamorph_pairing::split::{Footing, NoSplit, Split};
use metamorph_pairing::thesis::Nodes;
use metamorph_pairing::{MAX_CELLS, Pairing, PairingError};
use petgraph::algo::maximum_matching;
use petgraph::graph::UnGraph;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::time::Instant;

fn vectors() -> Value {
    serde_json::from_str(include_str!("data/interfaces-test-vectors.json")).unwrap()
}
fn cell(value: &Value) -> Cell {
    serde_json::from_value(value.clone()).unwrap()
}
fn cells(value: &Value) -> Vec<Cell> {
    value.as_array().unwrap().iter().map(cell).collect()
}
fn sorted(mut cells: Vec<Cell>) -> Vec<Cell> {
    cells.sort_unstable();
    cells
}

/// All fixed structures of up to `most` cells, by their number of cells from 1 on: each is a smaller one with one more
/// cell, moved so that its least coordinates are 0.
fn all_structures(flat: bool, most: usize) -> Vec<BTreeSet<Vec<Cell>>> {
    let faces = if flat { &Face::ALL[..4] } else { &Face::ALL[..] };
    let mut all = vec![BTreeSet::from([vec![Cell::default()]])];
    while all.len() < most {
        let mut larger = BTreeSet::new();
        for small in all.last().unwrap() {
            for near in small.iter().flat_map(|c| faces.iter().map(|f| c.step(*f))) {
                if small.binary_search(&near).is_err() {
                    let least =
                        |along: fn(&Cell) -> i16| small.iter().map(along).min().unwrap().min(along(&near));
                    let by = -Cell::new(least(|c| c.x), least(|c| c.y), least(|c| c.z));
                    larger.insert(sorted(small.iter().chain([&near]).map(|c| *c + by).collect()));
                }
            }
        }
        all.push(larger);
    }
    all
}

/// Checks what holds for every structure: pairs, certificates and repairs.
fn check(cells: &[Cell], context: &str) -> Pairing {
    let pairing = Pairing::of(cells).unwrap();
    let pairs = pairing.pairs();
    let covered: BTreeSet<Cell> = pairs.iter().flatten().copied().collect();
    assert!(pairs.iter().all(|[a, b]| a.face_to(*b).is_some()), "{context}: a pair shares no face");
    assert_eq!(covered.len(), 2 * pairs.len(), "{context}: a cell is in two pairs");
    assert_eq!(covered.len() + pairing.unpaired(), cells.len(), "{context}");
    let missing: usize = pairing.reasons().iter().map(|r| r.missing()).sum();
    assert_eq!(missing, pairing.unpaired(), "{context}: the certificates do not explain it");
    let set: BTreeSet<Cell> = cells.iter().copied().collect();
    for reason in pairing.reasons() {
        let touched: BTreeSet<Cell> =
            reason.cells.iter().flat_map(|c| c.neighbours()).filter(|n| set.contains(n)).collect();
        assert_eq!(
            touched,
            reason.neighbours.iter().copied().collect(),
            "{context}: neighbours are left out"
        );
        assert!(reason.cells.len() > touched.len(), "{context}");
    }
    for allowed in [Allowed::Add, Allowed::Remove, Allowed::Any] {
        check_repairs(&pairing, allowed, context);
    }
    pairing
}

fn check_repairs(pairing: &Pairing, allowed: Allowed, context: &str) {
    let repairs = pairing.repairs(allowed);
    let alone = pairing.cells().count() == 1 && allowed == Allowed::Remove;
    assert_eq!(repairs.is_empty(), pairing.unpaired() == 0 || alone, "{context}: {allowed:?}");
    let mut sets = BTreeSet::new();
    for repair in repairs {
        let changes: BTreeSet<(bool, Cell)> =
            repair.changes.iter().map(|c| (c.removes(), c.cell())).collect();
        let most = pairing.unpaired() + if repair.choice == Choice::Symmetric { 2 } else { 0 };
        assert_eq!(changes.len(), repair.changes.len(), "{context}: a cell is changed twice");
        assert!((pairing.unpaired()..=most).contains(&changes.len()), "{context}: {repair:?}");
        let forbidden = |c: &Change| match allowed {
            Allowed::Add => c.removes(),
            Allowed::Remove => !c.removes(),
            Allowed::Any => false,
        };
        assert!(!repair.changes.iter().any(forbidden), "{context}: {allowed:?}: {repair:?}");
        let repaired = Pairing::of(&repair.apply(pairing.cells()));
        assert_eq!(repaired.map(|p| p.unpaired()), Ok(0), "{context}: {repair:?}");
        assert!(sets.insert(changes), "{context}: a repair is offered twice");
    }
}

#[test]
fn named_structures_are_as_in_the_vectors() {
    let vectors = vectors();
    for vector in vectors["named"].as_array().unwrap().iter().chain(vectors["small"].as_array().unwrap()) {
        let name = vector["name"].as_str().unwrap();
        let pairing = check(&cells(&vector["cells"]), name);
        let number = |key: &str| vector[key].as_u64().unwrap() as usize;
        assert_eq!(pairing.pairs().len(), number("modules"), "{name}");
        assert_eq!(pairing.unpaired(), number("unpaired"), "{name}");
        assert_eq!(
            (pairing.colours().even, pairing.colours().odd),
            (number("even"), number("odd")),
            "{name}"
        );
        assert_eq!(sorted(pairing.free()), sorted(cells(&vector["free"])), "{name}");
        for (key, footing) in [("four_chains", Footing::Free), ("four_chains_with_a_foot", Footing::Floor)] {
            let split = matches!(pairing.split(footing), Split::Yes(_));
            assert!(vector[key].as_bool().is_none_or(|expected| expected == split), "{name}: {key}");
        }
    }
}

#[test]
fn larger_structures_are_as_in_the_vectors() {
    for (i, vector) in vectors()["structures"].as_array().unwrap().iter().enumerate() {
        let pairing = check(&cells(&vector["cells"]), &format!("structures[{i}]"));
        assert_eq!(pairing.unpaired() as u64, vector["unpaired"].as_u64().unwrap(), "structures[{i}]");
        assert_eq!(pairing.pairs().len() as u64, vector["modules"].as_u64().unwrap(), "structures[{i}]");
        assert_eq!(sorted(pairing.free()), sorted(cells(&vector["free"])), "structures[{i}]");
    }
}

#[test]
fn least_costs_are_those_of_the_vectors() {
    for (i, vector) in vectors()["costs"].as_array().unwrap().iter().enumerate() {
        let pairing = Pairing::of(&cells(&vector["cells"])).unwrap();
        let priced: Vec<(Change, u32)> = vector["costs"]
            .as_array()
            .unwrap()
            .iter()
            .map(|entry| {
                let change = match entry[0].as_str().unwrap() {
                    "add" => Change::Add(cell(&entry[1])),
                    _ => Change::Remove(cell(&entry[1])),
                };
                (change, entry[2].as_u64().unwrap() as u32)
            })
            .collect();
        let (cost, changes) = pairing.least_cost(&priced).unwrap();
        assert_eq!(
            u64::from(cost),
            vector["least_cost_connectivity_ignored"].as_u64().unwrap(),
            "costs[{i}]"
        );
        assert_eq!(changes.len() as u64, vector["changes"].as_u64().unwrap(), "costs[{i}]");
    }
}

/// The counts of all small structures; of the largest in each dimension, repairs are left to other tests.
#[test]
fn counts_of_all_small_structures_are_the_known_ones() {
    let vectors = vectors();
    for (key, flat) in [("fixed polyominoes", true), ("fixed polycubes", false)] {
        let known = vectors["counts"][key].as_object().unwrap();
        let most = known.keys().map(|k| k.parse().unwrap()).max().unwrap();
        for (cells, structures) in (1..).zip(all_structures(flat, most)) {
            let Some(known) = known.get(&cells.to_string()) else { continue };
            let (mut unpaired, mut balanced): (BTreeMap<String, u64>, u64) = Default::default();
            let (mut split, mut standing) = (0, 0);
            for structure in &structures {
                let pairing = Pairing::of(structure).unwrap();
                *unpaired.entry(pairing.unpaired().to_string()).or_default() += 1;
                balanced += u64::from(pairing.colours().even == pairing.colours().odd);
                split += u64::from(matches!(pairing.split(Footing::Free), Split::Yes(_)));
                standing += u64::from(matches!(pairing.split(Footing::Floor), Split::Yes(_)));
            }
            let counted = [
                ("all", serde_json::json!(structures.len())),
                ("unpaired", serde_json::json!(unpaired)),
                ("balanced", serde_json::json!(balanced)),
                ("four_chains", serde_json::json!(split)),
                ("four_chains_with_a_foot", serde_json::json!(standing)),
            ];
            for (what, ours) in counted.iter().filter(|(what, _)| known.get(*what).is_some()) {
                assert_eq!(ours, &known[*what], "{key} of {cells} cells: {what}");
            }
        }
    }
}

/// No single change lowers the number left over by more than one, so that fewer than d never suffice.
#[test]
fn fewer_changes_never_suffice() {
    let all =
        all_structures(true, 6).into_iter().flatten().chain(all_structures(false, 5).into_iter().flatten());
    for cells in all {
        let pairing = check(&cells, &format!("{cells:?}"));
        if pairing.unpaired() < 2 {
            continue;
        }
        let set: BTreeSet<Cell> = cells.iter().copied().collect();
        let near: BTreeSet<Cell> = cells.iter().flat_map(|c| c.neighbours()).collect();
        for a in &near {
            let mut changed = set.clone();
            if !changed.remove(a) {
                changed.insert(*a);
            }
            let changed: Vec<Cell> = changed.into_iter().collect();
            if let Ok(pairing_after) = Pairing::of(&changed) {
                assert!(pairing_after.unpaired() + 1 >= pairing.unpaired(), "{cells:?}: {a}");
            }
        }
    }
}

/// The cheapest of all sets of one or two changes of the offered kinds.
#[test]
fn repairs_called_cheapest_are_the_cheapest_by_brute_force() {
    let mut rng = Rng::named(26, "cheapest", 0);
    let mut compared = 0;
    for round in 0..300 {
        let cells = structure(Kind::Eden, round % 2 == 0, 3 + rng.below(8) as usize, &mut rng);
        let pairing = Pairing::of(&cells).unwrap();
        if !(1..=2).contains(&pairing.unpaired()) {
            continue;
        }
        let set: BTreeSet<Cell> = cells.iter().copied().collect();
        let near: BTreeSet<Cell> = cells.iter().flat_map(|c| c.neighbours()).collect();
        let changes: Vec<(Change, u32)> = near
            .iter()
            .map(|c| {
                let change = if set.contains(c) { Change::Remove(*c) } else { Change::Add(*c) };
                (change, rng.below(50) as u32)
            })
            .collect();
        let works = |chosen: &[Change]| {
            let mut changed = set.clone();
            for change in chosen {
                match change {
                    Change::Add(c) => changed.insert(*c),
                    Change::Remove(c) => changed.remove(c),
                };
            }
            // Connectivity is ignored: each part must pair up.
            let parts = components(&changed.into_iter().collect::<Vec<_>>());
            parts.iter().all(|part| Pairing::of(part).unwrap().unpaired() == 0)
        };
        let mut least = None;
        for (i, (a, cost)) in changes.iter().enumerate() {
            match pairing.unpaired() {
                1 if works(&[*a]) => least = least.min(Some(*cost)).or(Some(*cost)),
                2 => {
                    for (b, other) in &changes[i + 1..] {
                        if least.is_none_or(|l| cost + other < l) && works(&[*a, *b]) {
                            least = Some(cost + other);
                        }
                    }
                }
                _ => {}
            }
        }
        let ours = pairing.least_cost(&changes).unwrap().0;
        assert_eq!(Some(ours), least, "round {round}: {cells:?}");
        compared += 1;
    }
    assert!(compared > 20, "{compared}");
}

/// METAMORPH_STRUCTURES sets the number of random structures; the default is for every test run.
fn structures() -> u64 {
    std::env::var("METAMORPH_STRUCTURES").ok().and_then(|n| n.parse().ok()).unwrap_or(400)
}

#[test]
fn random_structures_are_repaired_whatever_their_order() {
    for seed in 0..structures() {
        let mut rng = Rng::named(seed, "pairing", 0);
        let kind = if seed % 3 == 0 { Kind::Tree } else { Kind::Eden };
        let most = if seed % 20 == 0 { 200 } else { 40 };
        let cells = structure(kind, seed % 2 == 0, 4 + rng.below(most) as usize, &mut rng);
        let context = format!(
            "seed {seed}: METAMORPH_STRUCTURES={} cargo test -p metamorph-pairing --test pairing",
            seed + 1
        );
        let pairing = check(&cells, &context);
        let mut shuffled = cells.clone();
        for i in (1..shuffled.len()).rev() {
            shuffled.swap(i, rng.below(i as u64 + 1) as usize);
        }
        let again = Pairing::of(&shuffled).unwrap();
        assert_eq!(again.pairs(), pairing.pairs(), "{context}");
        assert_eq!(again.reasons(), pairing.reasons(), "{context}");
        assert_eq!(again.repairs(Allowed::Any), pairing.repairs(Allowed::Any), "{context}");
        assert_eq!(again.split(Footing::Free), pairing.split(Footing::Free), "{context}");
        kept_modules_stay(&pairing, &context);
        let ended = (
            pairing.repairs_while(Allowed::Any, &|| false).next(),
            pairing.split_while(Footing::Free, &|| false),
        );
        let is_refuted = matches!(pairing.split(Footing::Free), Split::No(_));
        assert!(ended.0.is_none() && (is_refuted || ended.1 == Split::Undecided), "{context}: {ended:?}");
        let nodes = Nodes::of(&pairing);
        assert_eq!(
            nodes.most_pairs(),
            pairing.pairs().len(),
            "{context}: another algorithm finds another number"
        );
        assert!(nodes.published_pairs(&mut rng) <= pairing.pairs().len(), "{context}");
        assert!(nodes.lowest_degree_pairs(&mut rng) <= pairing.pairs().len(), "{context}");
    }
}

/// Where the exact search decides, the quick one agrees.
#[test]
fn splits_are_valid_and_found_where_the_exact_search_finds_one() {
    let (mut found, mut refuted) = (0, 0);
    for seed in 0..structures() {
        let mut rng = Rng::named(seed, "split", 0);
        let kind = if seed % 3 == 0 { Kind::Tree } else { Kind::Eden };
        let cells = structure(kind, seed % 2 == 0, 8 + 4 * rng.below(5) as usize, &mut rng);
        let pairing = Pairing::of(&cells).unwrap();
        for footing in [Footing::Free, Footing::Floor] {
            match (pairing.split(footing), pairing.exact_split(footing)) {
                (Split::Yes(chains), Split::Yes(exact)) => {
                    check_split(&cells, &chains, footing, seed);
                    check_split(&cells, &exact, footing, seed);
                    found += 1;
                }
                (Split::No(_), Split::No(_)) => refuted += 1,
                (quick, exact) => panic!("seed {seed}: {footing:?}: {quick:?}, but exactly {exact:?}"),
            }
        }
    }
    assert!(found > 20 && refuted > 20, "{found} {refuted}");
}

/// A cell that goes away takes its module and at most as many others as one path of exchange changes; what has a partner
/// stays a maximum.
fn kept_modules_stay(pairing: &Pairing, context: &str) {
    let (kept, over) = pairing.keeping(&pairing.pairs());
    assert_eq!((kept, over.len()), (pairing.pairs(), pairing.unpaired()), "{context}: nothing has changed");
    let Some(last) = pairing.cells().last() else { return };
    let fewer: Vec<Cell> = pairing.cells().filter(|c| *c != last).collect();
    if let Ok(smaller) = Pairing::of(&fewer) {
        let (kept, over) = smaller.keeping(&pairing.pairs());
        let covered: BTreeSet<Cell> = kept.iter().flatten().copied().collect();
        assert_eq!(
            (covered.len(), over.len()),
            (fewer.len() - smaller.unpaired(), smaller.unpaired()),
            "{context}"
        );
        assert!(kept.iter().all(|[a, b]| a.face_to(*b).is_some()), "{context}: a pair shares no face");
    }
}

fn check_split(cells: &[Cell], chains: &[[Cell; 4]], footing: Footing, seed: u64) {
    let covered: BTreeSet<Cell> = chains.iter().flatten().copied().collect();
    assert_eq!(covered, cells.iter().copied().collect(), "seed {seed}");
    assert_eq!(4 * chains.len(), cells.len(), "seed {seed}");
    let floor = cells.iter().map(|c| c.z).min().unwrap();
    for chain in chains {
        assert!(chain.windows(2).all(|two| two[0].face_to(two[1]).is_some()), "seed {seed}: {chain:?}");
        assert!(footing == Footing::Free || chain[0].z == floor, "seed {seed}: {chain:?}");
    }
}

#[test]
fn structures_that_do_not_split_say_why() {
    let of =
        |cells: &[[i16; 3]]| Pairing::of(&cells.iter().map(|c| Cell::from(*c)).collect::<Vec<_>>()).unwrap();
    assert_eq!(of(&[[0, 0, 0], [1, 0, 0]]).split(Footing::Free), Split::No(NoSplit::Count(2)));
    let t = of(&[[0, 0, 0], [1, 0, 0], [2, 0, 0], [1, 1, 0]]);
    assert_eq!(t.split(Footing::Free), Split::No(NoSplit::Unpaired(2)));
    let tower: Vec<[i16; 3]> = (0..8).map(|z| [0, 0, z]).collect();
    assert!(matches!(of(&tower).split(Footing::Free), Split::Yes(chains) if chains.len() == 2));
    assert_eq!(of(&tower).split(Footing::Floor), Split::No(NoSplit::TooHigh(Cell::new(0, 0, 4))));
    let gate = [[0, 0, 0], [0, 0, 1], [0, 0, 2], [0, 0, 3], [1, 0, 3], [2, 0, 3], [3, 0, 3], [4, 0, 3]];
    let few = NoSplit::TooFewFeet { feet: 1, chains: 2 };
    assert_eq!(of(&gate).split(Footing::Floor), Split::No(few));
}

#[test]
fn sets_that_are_no_structure_are_refused() {
    assert_eq!(Pairing::of(&[]).unwrap_err(), PairingError::Empty);
    let apart = [Cell::new(0, 0, 0), Cell::new(2, 0, 0)];
    let disconnected = PairingError::Disconnected { parts: 2, from: apart[0], to: apart[1] };
    assert_eq!(Pairing::of(&apart).unwrap_err(), disconnected);
    let far = Cell::new(Cell::LIMIT + 1, 0, 0);
    assert_eq!(Pairing::of(&[far]).unwrap_err(), PairingError::OutOfRange(far));
    let many: Vec<Cell> = (0..=MAX_CELLS).map(|i| Cell::new((i % 500) as i16, (i / 500) as i16, 0)).collect();
    assert_eq!(Pairing::of(&many).unwrap_err(), PairingError::TooMany(MAX_CELLS + 1));
    let single = Pairing::of(&[Cell::default()]).unwrap();
    assert_eq!(single.repairs(Allowed::Remove), []);
    assert_eq!(single.repairs(Allowed::Any)[0].changes.len(), 1);
}

/// A path through the whole structure must not be followed by recursion: this one has 60,000 cells.
#[test]
fn a_long_snake_is_paired() {
    let mut snake = Vec::new();
    for row in 0..200_i16 {
        snake.extend((0..299).map(|x| Cell::new(x, 2 * row, 0)));
        snake.push(Cell::new(if row % 2 == 0 { 298 } else { 0 }, 2 * row + 1, 0));
    }
    let pairing = Pairing::of(&snake).unwrap();
    assert_eq!(pairing.unpaired(), 0);
    // Without an end it has one cell too many, and every second cell is a possible one.
    snake.pop();
    let pairing = Pairing::of(&snake).unwrap();
    assert_eq!((pairing.unpaired(), pairing.reasons().len()), (1, 1));
    assert_eq!(pairing.repairs(Allowed::Add)[0].cheapest, Cheapest::Proven);
}

/// Draws pins: some edges that have no cell in common.
fn drawn_pins(cells: &[Cell], rng: &mut Rng) -> Vec<Pin> {
    let mut left: BTreeSet<Cell> = cells.iter().copied().collect();
    let mut pins = Vec::new();
    for cell in cells {
        let face = Face::ALL[rng.below(6) as usize];
        let other = cell.step(face);
        if rng.below(3) == 0 && left.contains(cell) && left.contains(&other) {
            left.remove(cell);
            left.remove(&other);
            pins.push([*cell, other]);
        }
    }
    pins
}

/// Counts the cells that every pairing with these pins leaves over, by another algorithm.
fn left_over_with(cells: &[Cell], pins: &[Pin]) -> usize {
    let pinned: BTreeSet<Cell> = pins.iter().flatten().copied().collect();
    let free: Vec<Cell> = cells.iter().copied().filter(|cell| !pinned.contains(cell)).collect();
    let mut graph: UnGraph<(), (), u32> = UnGraph::default();
    let nodes: BTreeMap<Cell, _> = free.iter().map(|cell| (*cell, graph.add_node(()))).collect();
    for (cell, node) in &nodes {
        for other in cell.neighbours().iter().filter(|other| *other > cell).filter_map(|o| nodes.get(o)) {
            graph.add_edge(*node, *other, ());
        }
    }
    free.len() - 2 * maximum_matching(&graph).len()
}

/// Whether two cells are partners in one of these pairs.
fn has(pairs: &[[Cell; 2]], [a, b]: Pin) -> bool {
    pairs.contains(&[a, b]) || pairs.contains(&[b, a])
}

#[test]
fn pins_are_kept_by_pairs_repairs_and_splits() {
    let (mut unpaired, mut repaired, mut split, mut refuted, mut costly) = (0, 0, 0, 0, 0);
    for seed in 0..structures() {
        let mut rng = Rng::named(seed, "pins", 0);
        let kind = if seed % 3 == 0 { Kind::Tree } else { Kind::Eden };
        let cells = structure(kind, seed % 2 == 0, 4 + rng.below(24) as usize, &mut rng);
        let pins = drawn_pins(&cells, &mut rng);
        let pairing = Pairing::pinned(&cells, &pins).unwrap();
        let context = format!("seed {seed}: {cells:?}, pins {pins:?}");
        assert_eq!(pairing.unpaired(), left_over_with(&cells, &pins), "{context}");
        assert!(pins.iter().all(|pin| has(&pairing.pairs(), *pin)), "{context}");
        let (kept, _) = pairing.keeping(&Pairing::of(&cells).unwrap().pairs());
        assert!(pins.iter().all(|pin| has(&kept, *pin)), "{context}");
        assert_eq!(2 * kept.len() + pairing.unpaired(), cells.len(), "{context}");
        let turned: Vec<Pin> = pins.iter().rev().map(|[a, b]| [*b, *a]).collect();
        let again = Pairing::pinned(&cells, &turned).unwrap();
        assert_eq!((again.pairs(), again.pins()), (pairing.pairs(), pairing.pins()), "{context}");
        unpaired += usize::from(pairing.unpaired() > 0);

        check_reasons_with(&pairing, &pins, &context);
        costly += check_costly(&cells, &pairing, &context);
        for allowed in [Allowed::Add, Allowed::Remove, Allowed::Any] {
            for repair in pairing.repairs(allowed) {
                // Refused if a pinned cell were removed.
                let applied = Pairing::pinned(&repair.apply(pairing.cells()), &pins);
                assert_eq!(applied.map(|p| p.unpaired()), Ok(0), "{context}: {repair:?}");
                repaired += 1;
            }
        }
        for footing in [Footing::Free, Footing::Floor] {
            match (pairing.split(footing), pairing.exact_split(footing)) {
                (Split::Yes(quick), Split::Yes(exact)) => {
                    for chains in [quick, exact] {
                        check_split(&cells, &chains, footing, seed);
                        let modules = chains.iter().flat_map(|[a, b, c, d]| [[*a, *b], [*c, *d]]);
                        let modules: Vec<[Cell; 2]> = modules.collect();
                        assert!(pins.iter().all(|pin| has(&modules, *pin)), "{context}: {chains:?}");
                    }
                    split += 1;
                }
                (Split::No(_), Split::No(_)) => refuted += 1,
                (quick, exact) => panic!("{context}: {footing:?}: {quick:?}, but exactly {exact:?}"),
            }
        }
    }
    let counts = [unpaired, repaired, split, refuted, costly];
    assert!(counts.iter().all(|n| *n > 10), "{counts:?}");
}

/// Every cell beside those of a reason is one of their possible partners, or a named pin keeps it.
fn check_reasons_with(pairing: &Pairing, pins: &[Pin], context: &str) {
    let pinned: BTreeSet<Cell> = pins.iter().flatten().copied().collect();
    let set: BTreeSet<Cell> = pairing.cells().collect();
    let missing: usize = pairing.reasons().iter().map(|r| r.missing()).sum();
    assert_eq!(missing, pairing.unpaired(), "{context}: the certificates do not explain it");
    for reason in pairing.reasons() {
        let touched: BTreeSet<Cell> =
            reason.cells.iter().flat_map(|c| c.neighbours()).filter(|n| set.contains(n)).collect();
        let (kept, free): (BTreeSet<Cell>, BTreeSet<Cell>) =
            touched.into_iter().partition(|cell| pinned.contains(cell));
        assert_eq!(free, reason.neighbours.iter().copied().collect(), "{context}");
        let named: BTreeSet<Cell> = reason.pins.iter().flatten().copied().collect();
        assert!(kept.is_subset(&named) && reason.pins.iter().all(|pin| has(pins, *pin)), "{context}");
        assert!(reason.pins.iter().all(|pin| pin.iter().any(|cell| kept.contains(cell))), "{context}");
    }
}

/// Without the costly pins, the others cost nothing; with any one of them, a module is lost again.
fn check_costly(cells: &[Cell], pairing: &Pairing, context: &str) -> usize {
    let WithoutPins { unpaired, costly } = pairing.without_pins();
    let kept: Vec<Pin> = pairing.pins().iter().copied().filter(|pin| !costly.contains(pin)).collect();
    let best = left_over_with(cells, &[]);
    assert_eq!(unpaired, best, "{context}");
    assert_eq!(left_over_with(cells, &kept), best, "{context}: {costly:?}");
    for pin in &costly {
        let with = [&kept[..], &[*pin]].concat();
        assert!(left_over_with(cells, &with) > best, "{context}: {pin:?}");
    }
    assert_eq!(costly.is_empty(), pairing.unpaired() == best, "{context}: {costly:?}");
    assert!(pairing.without_pins_while(&|| false).costly.is_empty(), "{context}");
    costly.len()
}

#[test]
fn a_pin_that_forbids_a_pairing_is_named() {
    let line: Vec<Cell> = (0..6).map(|x| Cell::new(x, 0, 0)).collect();
    let pin = |a: usize, b: usize| [line[a], line[b]];
    // The outer cells of a line of four have no partner if the inner ones are one module.
    let pairing = Pairing::pinned(&line, &[pin(0, 1), pin(4, 3)]).unwrap();
    assert_eq!((pairing.unpaired(), pairing.without_pins().costly), (2, vec![pin(3, 4)]));
    let reasons: Vec<_> = pairing.reasons().into_iter().map(|r| (r.cells, r.neighbours, r.pins)).collect();
    let expected =
        [(vec![line[2]], vec![], vec![pin(0, 1), pin(3, 4)]), (vec![line[5]], vec![], vec![pin(3, 4)])];
    assert_eq!(reasons, expected);
    let harmless = Pairing::pinned(&line, &[pin(0, 1), pin(4, 5), pin(0, 1)]).unwrap();
    assert_eq!((harmless.unpaired(), harmless.without_pins().costly, harmless.pins().len()), (0, vec![], 2));
}

#[test]
fn pins_of_no_module_are_refused() {
    let line: Vec<Cell> = (0..4).map(|x| Cell::new(x, 0, 0)).collect();
    let free = Cell::new(4, 0, 0);
    for (pins, expected) in [
        (vec![[line[3], free]], PairingError::PinWithoutCell { pin: [line[3], free], free }),
        (vec![[line[2], line[0]]], PairingError::PinApart([line[0], line[2]])),
        (vec![[line[1], line[1]]], PairingError::PinApart([line[1], line[1]])),
        (vec![[line[0], line[1]], [line[2], line[1]]], PairingError::PinnedTwice(line[1])),
    ] {
        assert_eq!(Pairing::pinned(&line, &pins).unwrap_err(), expected, "{pins:?}");
    }
}

/// Prints how long pairing, reasons and the first repair of structures of 10,000 cells take. Meant for a release build.
#[test]
#[ignore = "prints figures of this machine"]
#[allow(clippy::disallowed_methods, reason = "it measures")]
fn time_of_ten_thousand_cells() {
    for kind in [Kind::Eden, Kind::Tree] {
        let time = |seed: u64| {
            let cells = structure(kind, false, 10_000, &mut Rng::named(seed, "time", 0));
            let start = Instant::now();
            let pairing = Pairing::of(&cells).unwrap();
            let reasons = pairing.reasons().len();
            let first = pairing.repairs_while(Allowed::Add, &|| true).next();
            assert!(reasons > 0 && first.is_some(), "{kind:?} {seed}");
            start.elapsed().as_secs_f64() * 1000.0
        };
        let mut times: Vec<f64> = (0..200).map(time).collect();
        times.sort_unstable_by(f64::total_cmp);
        println!("{kind:?}: median {:.1} ms, 99 % {:.1} ms, 200 structures", times[100], times[197]);
    }
}
