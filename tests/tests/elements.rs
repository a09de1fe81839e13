//! Passive elements in swarms: scenarios with elements are built or say why not, the elements never fall, and runs can be
//! replayed.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{Ran, refused, report, run, run_processes, scenario};
use metamorph_world_controller::family::metamodule::report::{ElementsReport, MetamoduleReport};
use metamorph_world_controller::report::schema::Report;
use std::fs;

fn table() -> String {
    scenario("table.toml").display().to_string()
}

fn simulated(options: &[&str]) -> Ran {
    run(&[&["run", &table(), "--link", "sim", "--json", "-"], options].concat())
}

fn elements(report: &Report) -> ElementsReport {
    let part = &report.family_parts["metamodules"];
    serde_json::from_value::<MetamoduleReport>(part.clone()).unwrap().elements.unwrap()
}

/// The goal is built, or the run ends at a standstill, and the report names a dead metamodule that holds the plate. Nothing
/// falls.
fn is_built_or_pinned(ran: &Ran, about: &str) -> bool {
    let report = report(&ran.out);
    let elements = elements(&report);
    assert_eq!(report.invariants.broken, 0, "{about}: {ran:?}");
    match ran.code {
        Some(0) => {
            assert_eq!((elements.placed, elements.on_the_way), (1, 0), "{about}");
            assert!(elements.grips >= 4 && elements.pinned.is_empty(), "{about}: {elements:?}");
            true
        }
        Some(3) => {
            // A dead body in a seed, or where the plate has to pass, stays there too. What blocks is named.
            let reason = report.unbuilt.as_ref().map(|u| u.reason.as_str()).unwrap_or_default();
            let named = ["element-pinned", "element-blocked", "seed-blocked", "material-exhausted"];
            assert!(named.contains(&reason), "{about}: {reason}: {ran:?}");
            // What blocks is named as well where another reason comes first.
            assert!(reason != "element-blocked" || !elements.blocked.is_empty(), "{about}: {elements:?}");
            let is_pinned = ran.out.contains("element-pinned");
            assert_eq!(elements.pinned.len(), usize::from(is_pinned), "{about}: {ran:?}");
            assert_eq!(elements.placed + elements.on_the_way + elements.pinned.len() as u64, 1, "{about}");
            false
        }
        _ => panic!("{about}: {ran:?}"),
    }
}

#[test]
fn a_table_is_built_with_its_plate() {
    let ran = simulated(&[]);
    assert!(is_built_or_pinned(&ran, "without faults"));
    let elements = elements(&report(&ran.out));
    assert!(elements.carries > 2, "{elements:?}");
    assert_eq!((elements.hand_overs, elements.drops_prevented, elements.overloads_prevented), (0, 0, 0));
}

#[test]
fn a_table_is_built_over_bad_links_and_with_grips_that_fail() {
    for options in [&["--loss", "20%"][..], &["--set", "swarm.failed_connections=20%"]] {
        assert!(is_built_or_pinned(&simulated(options), &format!("{options:?}")));
    }
}

/// Whichever metamodule dies, and whenever: the plate is placed by the others, or the dead one holds it. Of all pairs each
/// metamodule and each time has two.
#[test]
fn the_plate_never_falls_when_metamodules_die() {
    let (mut built, mut pinned) = (0, 0);
    for (i, at) in [20, 35, 50, 70, 120].into_iter().enumerate() {
        for id in (0..5).filter(|id| (i + 2 * id) % 5 < 2) {
            let kill = format!("{id}@{at}s");
            match is_built_or_pinned(&simulated(&["--kill", &kill]), &kill) {
                true => built += 1,
                false => pinned += 1,
            }
        }
    }
    assert!(built > 0 && pinned > 0, "{built} built, {pinned} pinned");
}

/// A dead metamodule lies where the plate has to pass: the run ends with its name, and the holder has put the plate back.
#[test]
fn what_is_in_the_way_of_the_plate_is_named() {
    let ran = simulated(&["--kill", "4@35s"]);
    if !is_built_or_pinned(&ran, "4@35s") {
        let elements = elements(&report(&ran.out));
        assert!(elements.blocked.iter().all(|b| b.element == "top" && b.by == [4]), "{elements:?}");
        assert!(!elements.blocked.is_empty(), "{ran:?}");
    }
}

/// Grips that fail, lost messages and drawn starts: the cube is held in the air in the end.
#[test]
fn a_cube_is_carried_in_all_of_a_few_runs() {
    let scenario = scenario("carry-cube.toml").display().to_string();
    for seed in ["0", "1"] {
        let options =
            ["--link", "sim", "--seed", seed, "--loss", "5%", "--set", "swarm.failed_connections=5%"];
        let ran = run(&[&["run", &scenario, "--json", "-"], &options[..]].concat());
        assert_eq!(ran.code, Some(0), "{seed}: {ran:?}");
        let report = report(&ran.out);
        assert_eq!((report.invariants.broken, elements(&report).placed), (0, 1), "{seed}: {ran:?}");
    }
}

/// A metamodule that waits for the element in the cells of a seed does not fill the seed without it.
#[test]
fn what_waits_in_a_seed_for_an_element_does_not_fill_it() {
    let scenario = scenario("carry-cube.toml").display().to_string();
    for seed in ["41", "99"] {
        let ran = run(&["run", &scenario, "--json", "-", "--link", "sim", "--seed", seed]);
        assert_eq!(ran.code, Some(0), "{seed}: {ran:?}");
        assert_eq!(elements(&report(&ran.out)).placed, 1, "{seed}: {ran:?}");
    }
}

/// A scenario that ships is built, simulated, and nothing falls but by the faults of it.
fn shipped(name: &str) -> ElementsReport {
    let ran = run(&["run", &scenario(name).display().to_string(), "--link", "sim", "--json", "-"]);
    assert_eq!(ran.code, Some(0), "{name}: {ran:?}");
    let report = report(&ran.out);
    assert_eq!(report.invariants.broken, 0, "{name}: {ran:?}");
    elements(&report)
}

#[test]
fn a_dropped_plate_is_picked_up_again() {
    let elements = shipped("drop.toml");
    assert!(elements.drops > 0 && elements.drops_recovered == elements.drops, "{elements:?}");
    assert_eq!((elements.placed, elements.on_the_way), (1, 0), "{elements:?}");
}

#[test]
fn a_dead_module_is_carried_away_and_put_down() {
    let elements = shipped("carry-dead.toml");
    assert!(elements.placed == 1 && elements.carries > 0, "{elements:?}");
}

#[test]
fn the_parts_of_a_table_become_a_shelf() {
    let elements = shipped("table-to-shelf.toml");
    assert!(elements.placed == 1 && elements.grips >= 6, "{elements:?}");
}

/// Cubes that are far from each other are carried at the same time.
#[test]
fn several_transports_are_under_way_at_a_time() {
    let mut text = fs::read_to_string(scenario("carry-cube.toml")).unwrap();
    text = text.replace("max = [12, 9]", "max = [30, 24]").replace("count = 3", "count = 8");
    for (i, (x, y)) in [(15, 15), (25, 4)].into_iter().enumerate() {
        let lies = format!("at = {{ cell = [{x}, {y}, 0] }}\nto = {{ cell = [{}, {y}, 0] }}", x + 4);
        let element = format!("[[swarm.element]]\nname = \"cube {i}\"\nshape = \"cube\"\n{lies}\n\n[[goal]]");
        text = text.replacen("[[goal]]", &element, 1);
    }
    let ran = metamorph_tests::command::on(&text, &["run", "{}", "--link", "sim", "--json", "-"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let elements = elements(&report(&ran.out));
    assert!(elements.placed == 3 && elements.under_way_at_most >= 2, "{elements:?}");
    assert_eq!(elements.transports_at_most, 3, "{elements:?}");
}

/// In a large swarm only some metamodules are looked at for a transport. One that stands at the goal, far from the element, is
/// among them if there is no plan without.
#[test]
fn a_metamodule_far_from_an_element_makes_room_at_its_goal() {
    let at = [(1, 3), (1, 9), (5, 1), (5, 11), (9, 3), (9, 9), (19, 6)];
    let start: String = at.iter().map(|(x, y)| format!("{{ at = [{x}, {y}] }}, ")).collect();
    let mut text = fs::read_to_string(scenario("carry-cube.toml")).unwrap();
    for (from, to) in [
        ("max = [12, 9]", "max = [26, 14]"),
        ("count = 3\n", ""),
        ("start = \"random\"", &format!("start = [{start}]")),
        ("at = { cell = [2, 3, 0] }", "at = { cell = [5, 6, 0] }"),
        ("to = { cell = [8, 5, 4] }", "to = { cell = [19, 6, 0] }"),
        ("foot = [8, 5]", "foot = [26, 14]"),
    ] {
        assert!(text.contains(from), "{from}");
        text = text.replace(from, to);
    }
    let ran = metamorph_tests::command::on(&text, &["run", "{}", "--link", "sim", "--json", "-"]);
    assert_eq!((ran.code, elements(&report(&ran.out)).placed), (Some(0), 1), "{ran:?}");
}

#[test]
fn a_run_with_elements_is_replayed_bit_for_bit() {
    let directory = tempfile::tempdir().unwrap();
    let journal = directory.path().join("table").display().to_string();
    let ran = simulated(&["--journal", &journal]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let replayed = run(&["replay", &journal]);
    assert_eq!(replayed.code, Some(0), "{replayed:?}");
}

#[test]
fn the_plate_never_falls_when_the_process_of_its_holder_dies() {
    let options =
        ["--link", "ipc", "--time-scale", "20", "--json", "-", "--kill", "0@60s", "--restart", "1@30s"];
    let ran = run_processes(&[&["run", &table()], &options[..]].concat());
    is_built_or_pinned(&ran, "processes");
}

#[test]
fn bad_elements_are_refused_with_place_reason_and_fix() {
    let text = fs::read_to_string(scenario("table.toml")).unwrap();
    let with = |old: &str, new: &str| {
        assert!(text.contains(old), "{old}");
        text.replace(old, new)
    };
    let (at, to) = ("at = { cell = [4, 5, 0] }", "to = { cell = [8, 5, 4] }");
    for (text, parts) in [
        (with("plate3x3", "plate"), &["`plate` is not an element", "plate3x3"][..]),
        (with("\"plate3x3\"", "[[0, 0, 0], [2, 0, 0]]"), &["not connected to the first one by faces"]),
        (with("mass = 0.5", "mass = 0"), &["the mass in kilograms"]),
        (with(at, "at = { cell = [4, 5, 1] }"), &["does not rest on the floor"]),
        (with(at, "at = { cell = [4, 5, 0], turn = \"z-up x-up\" }"), &["`z-up x-up` is not a rotation"]),
        (with(at, "at = { cell = [4, 5, 0], turn = \"z-north x-down\" }"), &["is below the floor", "top"]),
        (with(to, "to = { cell = [8, 6, 4] }"), &["the colour (x + y + z) mod 2"]),
        (with(to, "to = { cell = [8, 5, 2] }"), &["where a seed or another element is"]),
        (with(to, "to = { cell = [1, 2, 4] }"), &["no head faces one of its ports"]),
        (
            with("strategy = \"planned\"", "strategy = \"negotiated\""),
            &["do not carry elements under `negotiated`"],
        ),
        (with("count = 5", "count = 5\ncommunication_range = 9"), &["hear each other", "at least 12"]),
        (with("shape = \"plate3x3\"\n", ""), &["shape", "[[swarm.element]]"]),
        (format!("{text}\n[[fault]]\ndrop = 1\nat = \"9s\"\n"), &["no element 1; the swarm has 1"]),
    ] {
        refused(&text, &["check", "{}"], parts);
    }
}
