//! The JSON schema of scenarios (draft 2020-12), for editors and for programs that write scenarios.
//!
//! It lists the keys of each table and the kinds of their values. Consistency between values (a seed in its
//! goal, the module that a fault names) is checked by the reader only. A test compares the keys and names
//! that the reader knows at every place with these, so neither can change alone.
//!
//! An optional key has a `default`, which is the value that the reader uses, or its description says what
//! happens without it.

use super::changes;
use super::commands;
use super::controller_link;
use super::definitions::{
    Definitions, any, names, natural, of, one_of, one_of_its_keys, or, said, seldom, table, text,
};
use super::error::{MAX_FILES, MAX_GOALS, VERSION};
use super::family::{Families, FamilySchema, ScenarioFamily, fault_keys};
use super::faults;
use super::hosts;
use super::link_between;
use super::link_burst;
use super::operator;
use super::plan::TIME_SCALE;
use super::raw::SEED;
use super::rescue;
use super::shapes::{AXES, PARTS, THIN, UPS, VOIDS};
use super::table::default_of;
use metamorph_core::lattice::Cell;
use serde_json::{Map, Value, json};

/// Returns a key with the section of a scenario that has it by the schema, such as `link.loss`.
pub fn with_section(schema: &Value, key: &str, family: &str) -> Option<String> {
    let shared = ["link", "stop", "process", "controller", "operator"].map(|name| (name, name.to_owned()));
    let own =
        [("swarm", "Swarm"), ("protocol", "Protocol")].map(|(name, part)| (name, format!("{family}{part}")));
    let has =
        |(_, definition): &&(&str, String)| schema["$defs"][definition]["properties"].get(key).is_some();
    shared.iter().chain(&own).find(has).map(|(section, _)| format!("{section}.{key}"))
}

/// Returns the schema of scenarios that may name these families.
pub fn schema(families: Families) -> Value {
    let own = |family: &dyn ScenarioFamily| {
        let part = |part: &str| of(&definition(family, part));
        json!({ "properties": {
            "swarm": part("Swarm"),
            "goal": { "type": "array", "minItems": 1, "maxItems": MAX_GOALS, "items": part("Goal") },
            "protocol": part("Protocol"),
            "fault": { "type": "array", "items": part("Fault") },
        } })
    };
    let named = |family: &dyn ScenarioFamily| {
        json!({ "type": "object", "required": ["swarm"], "properties": { "swarm": {
            "type": "object", "required": ["family"],
            "properties": { "family": { "const": family.name() } },
        } } })
    };
    let mut schema = json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A scenario of Metamorph",
        "type": "object",
        "additionalProperties": false,
        "required": ["version", "swarm", "goal"],
        "properties": {
            "version": said("The version of this format.", json!({ "const": VERSION })),
            "name": said("The name of the scenario. Default: the name of its file.", text()),
            "description": said("A description; may be left out.", text()),
            "seed": said("The seed of the run's randomness.", or(SEED, natural())),
            "swarm": said("The modules and where they start.", json!({ "type": "object" })),
            "goal": said("The goals, one after the other.", json!({ "type": "array" })),
            "protocol": said("How modules decide.", or(json!({}), json!({ "type": "object" }))),
            "link": said("Delays and impairments of messages.", or(json!({}), of("link"))),
            "process": said("Settings for runs of processes.", or(json!({}), of("process"))),
            "fault": said("The faults.", or(json!([]), json!({ "type": "array" }))),
            "command": said(
                "Commands of operators to the run.",
                or(json!([]), json!({ "type": "array", "items": of("command") })),
            ),
            "change": said(
                "Changes of a simulated run at its events: other random numbers from there on.",
                or(json!([]), json!({ "type": "array", "items": of("change") })),
            ),
            "operator": said("A scripted operator, or how much modules decide for themselves; if left out, no operator.", of("operator")),
            "controller": said("What the controller does besides measuring.", or(json!({}), of("controller"))),
            "stop": said("When a run ends that has not built its goals.", or(json!({}), of("stop"))),
            "file": said(
                "The files that the scenario names, as part of it; those that are left out are read from their paths. \
                 `metamorph sweep --pack` writes them.",
                or(json!([]), json!({ "type": "array", "maxItems": MAX_FILES, "items": of("packed-file") })),
            ),
        },
        "$defs": definitions(families),
    });
    // The first family is the default.
    let default = own(families.all[0]);
    let choice = families.all[1..].iter().fold(
        default,
        |others, family| json!({ "if": named(*family), "then": own(*family), "else": others }),
    );
    for (key, value) in choice.as_object().into_iter().flatten().filter(|_| families.all.len() > 1) {
        schema[key] = value.clone();
    }
    schema
}

/// Returns the name of the definition of a family's part.
fn definition(family: &dyn ScenarioFamily, part: &str) -> String {
    format!("{}{part}", family.name())
}

fn definitions(families: Families) -> Value {
    let mut all = Map::new();
    for (name, value) in values()
        .into_iter()
        .chain(shared())
        .chain(faults::schema())
        .chain(commands::schema())
        .chain(hosts::schema())
        .chain(controller_link::schema())
        .chain(link_between::schema())
        .chain(link_burst::schema())
        .chain(rescue::schema())
        .chain(operator::schema())
        .chain(changes::schema())
        .chain(shapes())
    {
        all.insert(name.to_owned(), value);
    }
    for family in families.all {
        let FamilySchema { swarm, goal, protocol, definitions, .. } = family.schema();
        let parts =
            [("Swarm", swarm), ("Goal", goal), ("Protocol", protocol), ("Fault", any(&fault_keys(*family)))];
        all.extend(parts.map(|(part, value)| (definition(*family, part), value)));
        let own = family.world_faults().iter().map(|kind| (kind.key, (kind.schema)()));
        all.extend(definitions.into_iter().chain(own).map(|(name, value)| (name.to_owned(), value)));
    }
    Value::Object(all)
}

/// Describes a bound with a default that depends on the swarm.
const BOUND: &str = "the default depends on the size of the swarm; `metamorph check` shows it.";

/// Returns the definitions of single values.
fn values() -> Definitions {
    let coordinate = json!({ "type": "integer", "minimum": -Cell::LIMIT, "maximum": Cell::LIMIT });
    let coordinates = |n: u8| json!({ "type": "array", "items": coordinate, "minItems": n, "maxItems": n });
    let modules = json!({ "anyOf": [natural(), { "type": "array", "items": natural() }] });
    vec![
        ("time", said("A length of time, such as 200ms, 1.5s or 2min.", text())),
        ("window", said("Two times, such as 0s..60s.", json!({ "type": "string", "pattern": "\\.\\." }))),
        ("delay", said("One time or two, such as 10ms..100ms.", text())),
        ("probability", said("Such as 5%, 0.05 or 1/20.", json!({ "type": ["string", "number"] }))),
        ("cell", said("The coordinates of a cell; z points up.", coordinates(3))),
        ("connector", said("The coordinates of a connector of the floor.", coordinates(2))),
        ("modules", said("The number of a module, from 0, or several.", modules)),
        ("radius", said("In cells.", json!({ "type": "number", "minimum": 0, "maximum": Cell::LIMIT }))),
        ("axis", names(&AXES.map(|(name, _)| name))),
    ]
}

/// Returns the definitions shared by all families.
fn shared() -> Definitions {
    vec![
        (
            "packed-file",
            table(
                "A file that is part of the scenario.",
                &["name"],
                json!({
                    "name": said("Its name, as the scenario writes it where it names the file.", text()),
                    "text": said("Its content; left out if it is not text.", text()),
                    "base64": said("Its content in Base64; left out if it is text.", text()),
                }),
            ),
        ),
        (
            "link",
            table(
                "Delays and impairments of messages.",
                &[],
                json!({
                    "delay": said(
                        "If left out, from a hundredth to a tenth of a move or of a step of a joint on the simulated \
                         link; of processes, only the real one.",
                        of("link-delay"),
                    ),
                    "loss": seldom("How often a message is lost."),
                    "duplicate": seldom("How often a message arrives twice."),
                    "reorder": seldom("How often a message is overtaken by later ones."),
                    "corrupt": seldom("How often a message is damaged; the receiver drops it."),
                    "until": said("When all of these but the delay end. Default: never.", of("time")),
                    "burst": said("If left out, the link is never worse than usual.", of("burst")),
                    "between": said(
                        "Links of their own between some modules.",
                        or(json!([]), json!({ "type": "array", "items": of("between") })),
                    ),
                    "controller": said("If left out, orders and reports take no time.", of("controller-link")),
                    "between_hosts": said("If left out, all modules are on one host.", of("between_hosts")),
                }),
            ),
        ),
        (
            "process",
            table(
                "Settings for runs of processes.",
                &[],
                json!({ "time_scale": said(
                    "Scenario seconds per real second.",
                    or(TIME_SCALE, json!({ "type": "number", "exclusiveMinimum": 0 })),
                ) }),
            ),
        ),
        (
            "stop",
            table(
                "When a run ends.",
                &[],
                json!({
                    "timeout": said(&format!("The latest end; {BOUND}"), of("time")),
                    "stall": said(&format!("Standing still for longer is a deadlock; {BOUND}"), of("time")),
                    "livelock": said(
                        &format!("Moving for longer without filling anything is a livelock; {BOUND}"),
                        of("time"),
                    ),
                }),
            ),
        ),
    ]
}

/// Returns the definitions of shapes that are sets of cells.
fn shapes() -> Definitions {
    let parts = json!({ "type": "array", "items": of("shape") });
    vec![
        (
            "shape",
            one_of_its_keys(table(
                "A set of cells; one of these.",
                &[],
                json!({
                    "box": said("A block.", of("box")),
                    "sphere": said("A ball.", of("sphere")),
                    "disc": said("A disc of one layer.", of("disc")),
                    "cylinder": said("A stack of discs.", of("cylinder")),
                    "cells": said("Each named once.", json!({ "type": "array", "items": of("cell") })),
                    "file": said("What a file of a drawing or of CAD becomes.", of("file")),
                    "union": said("The cells of any of them.", parts.clone()),
                    "difference": said("The first without the others.", parts.clone()),
                    "intersection": said("The cells that are in all of them.", parts),
                }),
            )),
        ),
        (
            "box",
            table(
                "Both corners belong to it.",
                &["min", "max"],
                json!({
                    "min": said("The corner with the smallest coordinates.", of("cell")),
                    "max": said("The corner with the largest coordinates.", of("cell")),
                }),
            ),
        ),
        (
            "sphere",
            table(
                "A ball.",
                &["center", "radius"],
                json!({ "center": said("The cell in the middle.", of("cell")), "radius": said("From the middle, in cells; a cell belongs to it if its middle does.", of("radius")) }),
            ),
        ),
        (
            "disc",
            table(
                "One cell thick, at right angles to its axis.",
                &["center", "radius"],
                json!({ "center": said("The cell in the middle.", of("cell")), "radius": said("From the middle, in cells; a cell belongs to it if its middle does.", of("radius")), "axis": said("The direction of its axis.", or(default_of(&AXES), of("axis"))) }),
            ),
        ),
        (
            "cylinder",
            table(
                "A stack of discs.",
                &["base", "radius", "height"],
                json!({
                    "base": said("The cell in the middle of the first disc.", of("cell")),
                    "radius": said("From the middle, in cells; a cell belongs to it if its middle does.", of("radius")),
                    "height": said("The number of discs.", natural()),
                    "axis": said("The direction of its axis.", or(default_of(&AXES), of("axis"))),
                }),
            ),
        ),
        (
            "file",
            table(
                "A solid (.stl, .obj), a scene of MagicaVoxel (.vox), a configuration of VisibleSim (.xml) or a drawing (.toml).",
                &["path"],
                json!({
                    "path": said("Relative to the scenario.", text()),
                    "pitch": said(
                        "The edge of a cell in the units of the file. A solid needs it; of a configuration it is left out.",
                        json!({ "type": "number" }),
                    ),
                    "up": said("The axis of a solid that points up.", one_of(&UPS)),
                    "at": said(
                        "Of a solid, the cell of the middle of its lowest layer; of a configuration, its origin.",
                        or(json!(<[i16; 3]>::from(Cell::default())), of("cell")),
                    ),
                    "part": said("Of a configuration.", one_of(&PARTS)),
                    "thin": said("What to do with parts thinner than a cell.", one_of(&THIN)),
                    "voids": said("What to do with inner voids.", one_of(&VOIDS)),
                }),
            ),
        ),
    ]
}
