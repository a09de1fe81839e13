//! The parts of the JSON schema of scenarios that only free modules have.

use super::scenario::{
    BODY, COLLISIONS, CONNECTORS, LEAST_MEMORY, MAX_MEMORY, MAX_WEIGHT, MAX_WORK, MEMORY, OBJECTIVES,
    STRATEGY, WEIGHT, WORK,
};
use crate::scenario::family::FamilySchema;
use crate::scenario::plan::BEAT;
use crate::scenario::schema::{NUMBERED, names, of, or, said, seldom, table, text};
use serde_json::{Value, json};

/// The shapes that can be named.
const SHAPES: &str =
    "line:N, loop:WxH, ell:N, zigzag:N, quadruped:4, quadruped:6, tree:NxSEED, or a structure file";

/// Returns the schema of the sections of free modules.
pub fn schema() -> FamilySchema {
    let goal = table(
        "The structure to become; there is one goal.",
        &["shape"],
        json!({
            "name": said(NUMBERED, text()),
            "shape": said(
                &format!("{SHAPES}. With joint values it is one configuration, without them any of the shape."),
                text(),
            ),
        }),
    );
    FamilySchema { swarm: swarm(), goal, protocol: protocol(), shapes: &[], definitions: Vec::new() }
}

fn swarm() -> Value {
    let angles = json!({ "type": "array", "minItems": 3, "maxItems": 3, "items": { "type": "number" } });
    table(
        "Single Roombots modules that form one structure, at most 16.",
        &["family", "start"],
        json!({
            "family": { "const": super::NAME },
            "body": said("The model of bodies: on the lattice.", or(BODY, names(&[BODY]))),
            "start": said(&format!("{SHAPES}."), text()),
            "types": said(
                "Of a line: the quarter turns of its connections, a digit from 0 to 3 each. Default: all 0.",
                json!({ "type": "string", "pattern": "^[0-3]*$" }),
            ),
            "joints_deg": said(
                "Joint values q1, q2, q3 of every module in degrees. Default: all 0, or those of the file.",
                json!({ "type": "array", "items": angles }),
            ),
            "turn_time": said("The duration of a step of a joint, and of a connection.", or(BEAT.to_string(), of("time"))),
            "failed_connections": seldom(),
        }),
    )
}

fn protocol() -> Value {
    let choice = |all: Vec<&'static str>| or(all[0], names(&all));
    table(
        "How plans are made.",
        &[],
        json!({
            "strategy": said("The controller plans all steps.", or(STRATEGY, names(&[STRATEGY]))),
            "collision": said("What a turn may touch.", choice(COLLISIONS.map(|(name, _)| name).to_vec())),
            "connectors": said(
                "Which connectors can connect; active: one of the two is C0X or C3X.",
                choice(CONNECTORS.map(|(name, _)| name).to_vec()),
            ),
            "objective": said("What a plan minimizes.", choice(OBJECTIVES.map(|(name, _)| name).to_vec())),
            "weight": said(
                "The factor of the least cost within which a plan is good enough.",
                or(WEIGHT, json!({ "type": "number", "minimum": WEIGHT, "maximum": MAX_WEIGHT })),
            ),
            "work": said(
                "States expanded for one plan at most.",
                or(WORK, json!({ "type": "integer", "minimum": 1, "maximum": MAX_WORK })),
            ),
            "memory_mib": said(
                "Memory for one plan at most, in MiB.",
                or(MEMORY, json!({ "type": "integer", "minimum": LEAST_MEMORY, "maximum": MAX_MEMORY })),
            ),
        }),
    )
}
