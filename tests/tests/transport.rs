//! `metamorph plan SCENARIO`: structures of metamodules and elements are planned, or it is said why not.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{Ran, refused, run, scenario};
use serde_json::Value;
use std::fs;

fn planned(options: &[&str]) -> Ran {
    run(&[&["plan", "table", "--json", "-"], options].concat())
}

fn answer(ran: &Ran) -> Value {
    serde_json::from_str(&ran.out).unwrap_or_else(|error| panic!("{error}: {ran:?}"))
}

fn items(bundle: &Value) -> Vec<String> {
    bundle["items"].as_array().unwrap().iter().map(|i| i.as_str().unwrap().to_owned()).collect()
}

/// The first bundle is a leg with the plate, three legs follow, and no torque exceeds its limit.
#[test]
fn the_table_is_planned_for_all_kinds() {
    for kind in ["PAR", "SRS", "PER", "SRZ"] {
        let ran = planned(&["--set", &format!("swarm.kind={kind}")]);
        assert_eq!(ran.code, Some(0), "{kind}: {ran:?}");
        let answer = answer(&ran);
        assert_eq!(answer["kind"], kind);
        let bundles = answer["bundles"].as_array().unwrap();
        let sizes: Vec<usize> = bundles.iter().map(|b| items(b).len()).collect();
        assert_eq!(sizes, [2, 1, 1, 1], "{kind}: {answer}");
        assert_eq!(items(&bundles[0])[1], "top", "{kind}");
        let totals = &answer["totals"];
        let torque = |key: &str| totals[key].as_f64().unwrap();
        assert!((0.1..=4.9).contains(&torque("peak_outer_nm")), "{kind}: {totals}");
        assert!((0.1..=3.6).contains(&torque("peak_middle_nm")), "{kind}: {totals}");
        assert!(totals["connections"].as_u64() >= totals["connections_lower"].as_u64(), "{kind}: {totals}");
    }
}

#[test]
fn the_order_of_the_thesis_leaves_the_plate_over() {
    let ran = run(&["plan", "table", "--planner", "thesis"]);
    assert_eq!(ran.code, Some(3), "{ran:?}");
    let (leg, both) = (ran.out.find("32.27").unwrap(), ran.out.find("35.59").unwrap());
    assert!(leg < both, "{ran:?}");
    assert!(ran.out.contains("top left over"), "{ran:?}");
}

#[test]
fn a_cube_in_the_air_is_planned_with_a_hand_over() {
    let ran = run(&["plan", "hand-over", "--json", "-"]);
    assert_eq!(ran.code, Some(0), "{ran:?}");
    let answer = answer(&ran);
    assert_eq!(items(&answer["bundles"][0]), ["seed (9, 6)", "cube"]);
    assert!(answer["totals"]["hand_overs"].as_u64() > Some(0), "{answer}");
}

#[test]
fn what_cannot_be_planned_has_a_reason() {
    let ran = planned(&["--set", "swarm.element.0.mass=15"]);
    assert_eq!(ran.code, Some(3), "{ran:?}");
    let failure = &answer(&ran)["failure"];
    assert_eq!(failure["reason"], "unstable", "{failure}");
    assert!(failure["text"].as_str().unwrap().contains("too-heavy: top"), "{failure}");
}

#[test]
fn wrong_questions_are_refused() {
    let box_text = fs::read_to_string(scenario("box.toml")).unwrap();
    refused(&box_text, &["plan", "{}"], &["has no elements", "fix:", "table"]);
    for (options, part) in [
        (&["table", "--planner", "ara"][..], "is for free modules"),
        (&["table", "--from", "line:4"], "cannot be used with"),
        (&["table", "--set", "swarm.count=3"], "1 too few"),
        (&["--from", "line:4", "--to", "loop:3x3", "--planner", "thesis"], "is for scenarios with elements"),
        (&["--from", "line:4", "--to", "loop:3x3", "--set", "seed=1"], "SCENARIO"),
    ] {
        let ran = run(&[&["plan"], options].concat());
        assert_eq!(ran.code, Some(2), "{options:?}: {ran:?}");
        assert!(ran.err.contains(part), "`{part}` is missing in {}", ran.err);
    }
}
