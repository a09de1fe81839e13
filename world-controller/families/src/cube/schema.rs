//! The parts of the JSON schema of scenarios that only cubes have.

use super::scenario::{CO_OWNERS, CONNECTIVITY, DEAD, GROWTH};
use metamorph_scenario::definitions::{NUMBERED, of, one_of, or, said, seldom, table, text};
use metamorph_scenario::family::FamilySchema;
use metamorph_scenario::plan::BEAT;
use metamorph_scenario::shapes::KINDS;
use serde_json::json;

/// Returns the schema of the cubes' sections.
pub fn schema() -> FamilySchema {
    FamilySchema {
        swarm: table(
            "Cubes that slide over each other.",
            &["start"],
            json!({
                "family": said("The kind of modules.", or(super::NAME, json!({ "const": super::NAME }))),
                "start": said("The cells of the modules at the start; modules are numbered from 0.", of("shape")),
                "move_time": said("How long a move takes.", or(BEAT.to_string(), of("time"))),
                "failed_connections": seldom("How often a move or a connection fails."),
            }),
        ),
        goal: table(
            "A shape to be grown from a seed.",
            &["shape"],
            json!({
                "name": said(NUMBERED, text()),
                "shape": said("The cells to be filled.", of("shape")),
                "seed": said(
                    "The growth seed: the cell where growth begins. If left out, the occupied cell of the goal nearest to \
                     its centre; of a scaffold, one from which it fills most of the shape.",
                    of("cell"),
                ),
                "growth": said(
                    "solid fills every cell of the shape; scaffold fills corners and edges, about half of the cells, and leaves \
                     tunnels in between.",
                    one_of(&GROWTH),
                ),
            }),
        ),
        protocol: table(
            "How cubes decide.",
            &[],
            json!({
                "connectivity": said(
                    "How a module makes sure that nothing falls apart when it leaves: forest asks a tree of all modules, cycles looks for \
                     a way around, gradient is the published rule, which is unsafe when delays of messages differ.",
                    one_of(&CONNECTIVITY),
                ),
                "dead": said("What modules do beside a dead one: hold it.", or(DEAD[0].0, json!({ "const": DEAD[0].0 }))),
                "co_owners": said("Whether all neighbours of a cell are asked for it, or one.", or(CO_OWNERS, json!({ "type": "boolean" }))),
            }),
        ),
        shapes: &KINDS,
        definitions: Vec::new(),
    }
}
