//! The parts of the JSON schema of scenarios that only free modules have.

use super::scenario::{
    BODY, COLLISIONS, CONNECTORS, LEAST_MEMORY, MAX_MEMORY, MAX_WEIGHT, MAX_WORK, MEMORY, OBJECTIVES,
    STRATEGY, WEIGHT, WORK,
};
use super::walking;
use metamorph_protocol::free_module::named;
use metamorph_scenario::definitions::{NUMBERED, names, of, or, said, seldom, table, text};
use metamorph_scenario::family::FamilySchema;
use metamorph_scenario::plan::BEAT;
use serde_json::{Value, json};

/// The shapes that can be named.
const SHAPES: &str =
    "line:N, loop:WxH, ell:N, zigzag:N, quadruped:4, quadruped:6, tree:NxSEED, or a structure file";

/// Returns the schema of the sections of free modules.
pub fn schema() -> FamilySchema {
    let goal = table(
        "The structure to become, or to walk; there is one goal.",
        &[],
        json!({
            "name": said(NUMBERED, text()),
            "shape": said(
                &format!("{SHAPES}. With joint values it is one configuration, without them any of the shape. Not left out with body lattice."),
                text(),
            ),
            "walk": walking::schema::walk(),
        }),
    );
    FamilySchema { swarm: swarm(), goal, protocol: protocol(), shapes: &[], definitions: Vec::new() }
}

fn swarm() -> Value {
    let angles = json!({ "type": "array", "minItems": 3, "maxItems": 3, "items": { "type": "number" } });
    let mut swarm = table(
        "Single Roombots modules that form one structure: at most 16 on the lattice, and 256 that walk.",
        &["family", "start"],
        json!({
            "family": said("The kind of modules.", json!({ "const": super::NAME })),
            "body": said("The model of bodies: on the lattice, or rigid bodies that walk.", or(BODY, names(&[BODY, walking::BODY]))),
            "start": said(&format!("{SHAPES}. With body physics: {}, or a structure file.", named::NAMES.join(", ")), text()),
            "types": said(
                "Of a line: the quarter turns of its connections, a digit from 0 to 3 each. Default: all 0.",
                json!({ "type": "string", "pattern": "^[0-3]*$" }),
            ),
            "joints_deg": said(
                "Joint values q1, q2, q3 of every module in degrees. Default: all 0, or those of the file.",
                json!({ "type": "array", "items": angles }),
            ),
            "turn_time": said("The duration of a step of a joint, and of a connection.", or(BEAT.to_string(), of("time"))),
            "connection": crate::connection::schema(),
            "failed_connections": seldom("How often a move or a connection fails."),
        }),
    );
    add(&mut swarm, walking::schema::swarm());
    swarm
}

/// Adds the keys of structures that walk.
fn add<const N: usize>(table: &mut Value, keys: [(&str, Value); N]) {
    for (key, schema) in keys {
        table["properties"][key] = schema;
    }
}

fn protocol() -> Value {
    let choice = |all: Vec<&'static str>| or(all[0], names(&all));
    let mut protocol = table(
        "How plans are made, or gaits are chosen.",
        &[],
        json!({
            "strategy": said(
                "The controller plans all steps; oscillators: agents walk by their oscillators. Default: that of the body.",
                names(&[STRATEGY, walking::STRATEGY]),
            ),
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
    );
    add(&mut protocol, walking::schema::protocol());
    protocol
}
