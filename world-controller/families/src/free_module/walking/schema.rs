//! The keys of scenarios that only walking structures have.

use super::scenario::{
    DEFAULT_TRIAL, DEFAULT_TRIALS, FASTEST_TURN, FRICTION, LEARNERS, LONGEST_TRIAL, MOST_TRIALS, NETWORKS,
    SHORTEST_TRIAL, STEEPEST,
};
use metamorph_scenario::definitions::{names, of, said, table, text};
use serde_json::{Value, json};

/// Returns the keys of `[swarm]`.
pub fn swarm() -> [(&'static str, Value); 3] {
    [
        (
            "down",
            said(
                "With body physics: the direction of module 0's foot frame that points down at the start. Default: -y.",
                names(&["+x", "-x", "+y", "-y", "+z", "-z"]),
            ),
        ),
        (
            "friction",
            said(
                &format!("With body physics: the friction of all surfaces. Default: {FRICTION}."),
                json!({ "type": "number", "minimum": 0, "maximum": 10 }),
            ),
        ),
        (
            "ground",
            table(
                "With body physics: the ground. Default: level.",
                &[],
                json!({
                    "slope": said(
                        &format!("The angle by which it rises towards +x, such as 10deg, {STEEPEST}deg at most. Default: 0deg."),
                        text(),
                    ),
                }),
            ),
        ),
    ]
}

/// Returns the key of `[[goal]]`.
pub fn walk() -> Value {
    table(
        "With body physics, where it is not left out: to walk.",
        &["for", "speed_at_least"],
        json!({
            "for": said("The time for which the speed is held without a break.", of("time")),
            "speed_at_least": said("The least distance in 10 s by that time, such as 15mm/s.", text()),
            "heading": said(
                "The direction in which the distance counts, such as 45deg, from +x towards +y. Default: any.",
                text(),
            ),
            "turn": said(
                &format!("How fast the structure turns meanwhile, such as 5deg/s, counter-clockwise seen from above; {FASTEST_TURN}deg/s at most. The speed counts as the share of the turn that was reached. Default: any."),
                text(),
            ),
        }),
    )
}

/// Returns the keys of `[protocol]`.
pub fn protocol() -> [(&'static str, Value); 5] {
    let learners: Vec<&str> = LEARNERS.iter().map(|(name, _)| *name).collect();
    let networks: Vec<&str> = NETWORKS.iter().map(|kind| kind.name()).collect();
    [
        (
            "network",
            said("With body physics: the network of oscillators. Default: blf-sym.", names(&networks)),
        ),
        (
            "gaits",
            said(
                "With body physics, where it is not left out: gait files of `metamorph learn`; one of the whole structure, and others for dead modules.",
                json!({ "type": "array", "items": { "type": "string" }, "minItems": 1 }),
            ),
        ),
        (
            "relearn",
            said(
                &format!(
                    "With body physics: how gaits are learnt after a failure. Default: {}.",
                    LEARNERS[0].0
                ),
                names(&learners),
            ),
        ),
        (
            "trials",
            said(
                &format!(
                    "With body physics: gaits tried after a failure at most. Default: {DEFAULT_TRIALS}."
                ),
                json!({ "type": "integer", "minimum": 1, "maximum": MOST_TRIALS }),
            ),
        ),
        (
            "trial",
            said(
                &format!(
                    "With body physics: the time of a trial, of which the last two thirds count; from {SHORTEST_TRIAL} to {LONGEST_TRIAL}. Default: {DEFAULT_TRIAL}."
                ),
                of("time"),
            ),
        ),
    ]
}
