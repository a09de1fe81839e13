//! The measures of a team against logs that were worked out by another program and by hand.
#![allow(
    clippy::unwrap_used,
    clippy::float_cmp,
    reason = "a panic fails the test; the measures have to be the same"
)]

use metamorph_sim_bridge::director::team::{Interaction, Measures, TeamLog, UnitLog, Wait};
use serde_json::Value;
use std::collections::BTreeMap;

fn vectors() -> Value {
    serde_json::from_str(include_str!("data/team-test-vectors.json")).expect("the vectors are JSON")
}

fn unit(text: &Value) -> u32 {
    text.as_str().unwrap().parse().unwrap()
}

fn log(json: &Value) -> TeamLog {
    let number = |value: &Value| value.as_u64().unwrap();
    let steps = |unit: &Value| {
        let steps = unit["performance"].as_array().unwrap().iter();
        steps.map(|step| (number(&step[0]), step[1].as_f64().unwrap())).collect()
    };
    let units: BTreeMap<u32, UnitLog> = json["units"]
        .as_object()
        .unwrap()
        .iter()
        .map(|(name, u)| (name.parse().unwrap(), UnitLog { performance: steps(u), done: u["done"].as_u64() }))
        .collect();
    let interactions = json["interactions"].as_array().unwrap().iter();
    let waits = json["waits"].as_array().unwrap().iter();
    TeamLog {
        threshold: json["theta"].as_f64().unwrap(),
        window: number(&json["w"]),
        gap: number(&json["gap"]),
        end: number(&json["end"]),
        units,
        interactions: interactions
            .map(|i| Interaction { unit: unit(&i["unit"]), from: number(&i["from"]), to: number(&i["to"]) })
            .collect(),
        waits: waits
            .map(|w| Wait {
                unit: unit(&w["unit"]),
                on: unit(&w["for"]),
                from: number(&w["from"]),
                to: number(&w["to"]),
            })
            .collect(),
    }
}

#[test]
fn every_measure_is_that_of_the_worked_logs() {
    let vectors = vectors();
    let cases = vectors["team"].as_array().unwrap();
    assert!(cases.len() >= 2, "the vectors were not found");
    for case in cases {
        let (name, expected) = (&case["name"], &case["measures"]);
        let found: Measures = log(&case["log"]).measures();
        let neglect: Vec<(u64, bool)> = serde_json::from_value(expected["nt"].clone()).unwrap();
        assert_eq!(found.neglect, neglect, "{name}");
        assert_eq!(found.neglect_median, expected["nt_median"].as_u64(), "{name}");
        assert_eq!(found.neglect_mean, expected["nt_restricted_mean"].as_f64(), "{name}");
        assert_eq!(found.interaction_mean, expected["it_mean"].as_f64(), "{name}");
        assert_eq!(found.wait_mean, expected["wt_mean"].as_f64(), "{name}");
        let recovery: Vec<u64> = serde_json::from_value(expected["recovery"].clone()).unwrap();
        assert_eq!(found.recovery, recovery, "{name}");
        assert_eq!(found.failed, expected["failed_interactions"].as_u64().unwrap(), "{name}");
        assert_eq!(found.occupied, expected["ot"].as_u64().unwrap(), "{name}");
        assert_eq!(found.coordination_demand, expected["cd"].as_f64(), "{name}");
        assert_eq!(found.attention_demand, expected["rad"].as_f64(), "{name}");
        assert_eq!(found.fan_out, expected["fan_out"].as_u64(), "{name}");
        assert_eq!(found.fan_out_waiting, expected["fan_out_waiting"].as_u64(), "{name}");
        assert_eq!(found.intervention_share, expected["intervention_share"].as_f64().unwrap(), "{name}");
    }
}

#[test]
fn a_unit_that_never_needs_anyone_has_no_median() {
    let performance = vec![(0, 1.0)];
    let unit = |done| UnitLog { performance: performance.clone(), done };
    let units = BTreeMap::from([(0, unit(Some(50))), (1, unit(None))]);
    let log = TeamLog { threshold: 0.5, window: 10, gap: 5, end: 100, units, ..TeamLog::default() };
    let found = log.measures();
    assert_eq!(found.neglect, [(50, false), (100, false)]);
    assert_eq!((found.neglect_median, found.neglect_mean), (None, Some(100.0)));
    assert_eq!((found.interaction_mean, found.fan_out), (None, None));
    assert_eq!((found.coordination_demand, found.intervention_share), (Some(0.0), 0.0));
}
