//! The JSON schema of scenarios (draft 2020-12), for editors and for programs that write scenarios.
//!
//! It says which keys there are, where, and of which kind their values are. What belongs together (a
//! seed in its goal, a module that a fault names) is checked by the reader alone, which is also the one
//! whose complaints people read. A test asks the reader for the keys and names that it knows at every
//! place and compares them with these; so neither can change alone.
//!
//! A key that can be left out has a `default`, which is the value that the reader uses then, or its description
//! says what happens if it is left out.

use super::cube::{CO_OWNERS, CONNECTIVITY, DEAD, GROWTH};
use super::field::{MAX_RANGE, MAX_THOUSANDTHS};
use super::flaw::{MAX_FLOOR, MAX_GOALS, MAX_HEARING, MAX_METAMODULES, VERSION};
use super::metamodule::{CLASS, FACES, FLOOR, KIND, TELLERS};
use super::plan::{BEAT, NEVER, TIME_SCALE};
use super::raw::SEED;
use super::shapes::{AXES, PARTS, THIN, UPS, VOIDS};
use super::table::default_of;
use metamorph_module_agent::Family;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::blueprint::SeedOrder;
use metamorph_protocol::metamodule::params::{HEARING, LEAST_HEARING, PrecedenceBy, Strategy};
use metamorph_protocol::roombots::Kind;
use serde_json::{Map, Value, json};

/// The schema.
pub fn schema() -> Value {
    let own = |swarm: &str, goal: &str, protocol: &str, fault: &str| {
        json!({ "properties": {
            "swarm": of(swarm),
            "goal": { "type": "array", "minItems": 1, "maxItems": MAX_GOALS, "items": of(goal) },
            "protocol": of(protocol),
            "fault": { "type": "array", "items": of(fault) },
        } })
    };
    let metamodules = json!({ "type": "object", "required": ["swarm"], "properties": { "swarm": {
        "type": "object", "required": ["family"],
        "properties": { "family": { "const": Family::Metamodule.name() } },
    } } });
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A scenario of Metamorph",
        "type": "object",
        "additionalProperties": false,
        "required": ["version", "swarm", "goal"],
        "properties": {
            "version": said("The version of this format.", json!({ "const": VERSION })),
            "name": said("What it is called; if left out, its file is named instead.", text()),
            "description": said("What it shows; may be left out.", text()),
            "seed": said("The seed of all chance in a run.", or(SEED, natural())),
            "swarm": said("Who is there, and where.", json!({ "type": "object" })),
            "goal": said("What is to be built, one after the other.", json!({ "type": "array" })),
            "protocol": said("How modules decide.", or(json!({}), json!({ "type": "object" }))),
            "link": or(json!({}), of("link")),
            "process": or(json!({}), of("process")),
            "fault": said("What is broken when.", or(json!([]), json!({ "type": "array" }))),
            "stop": or(json!({}), of("stop")),
        },
        "if": metamodules,
        "then": own("metamoduleSwarm", "metamoduleGoal", "metamoduleProtocol", "metamoduleFault"),
        "else": own("cubeSwarm", "cubeGoal", "cubeProtocol", "cubeFault"),
        "$defs": definitions(),
    })
}

fn definitions() -> Value {
    let mut all = Map::new();
    for (name, value) in
        values().into_iter().chain(shared()).chain(shapes()).chain(cubes()).chain(metamodules())
    {
        all.insert(name.to_owned(), value);
    }
    Value::Object(all)
}

/// What bounds are that follow from the swarm.
const BOUND: &str = "if left out, it follows from the size of the swarm, and `metamorph check` shows it.";
/// What goals are called.
const NUMBERED: &str = "If left out, `goal 1` and so on.";

type Definitions = Vec<(&'static str, Value)>;

/// What is written as one value.
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

/// What both families have.
fn shared() -> Definitions {
    vec![
        (
            "link",
            table(
                "What is done to messages.",
                &[],
                json!({
                    "delay": said(
                        "If left out, from a hundredth to a tenth of a move or of a step of a joint on the simulated \
                         link; of processes, only the real one.",
                        of("delay"),
                    ),
                    "loss": seldom(),
                    "duplicate": seldom(),
                    "reorder": seldom(),
                    "corrupt": seldom(),
                    "until": said("When all that but the delay ends; if left out, it does not.", of("time")),
                }),
            ),
        ),
        (
            "process",
            table(
                "What only runs of processes have.",
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
        ("kill", fault("A process is killed; its body stays.", "kill", &["at"], json!({}))),
        ("pause", fault("A process is stopped for a while.", "pause", &["from", "until"], json!({}))),
        (
            "restart",
            fault(
                "A process is started again without its memory.",
                "restart",
                &["at"],
                json!({ "memory": or(false, json!({ "const": false })) }),
            ),
        ),
        ("stick", fault("A joint sticks.", "stick", &["at"], json!({ "until": for_good() }))),
        (
            "crash",
            fault("Modules drawn at random are killed.", "crash", &[], json!({ "crash": of("crashes") })),
        ),
        (
            "crashes",
            table(
                "How many, and when.",
                &["between"],
                json!({
                    "count": said("If left out, `fraction` says it.", natural()),
                    "fraction": said("Of all modules; if left out, `count` says it.", of("probability")),
                    "between": of("window"),
                }),
            ),
        ),
        ("partition", fault("Modules are cut off.", "partition", &[], json!({ "partition": of("cut") }))),
        (
            "cut",
            table(
                "Who, and when.",
                &["modules", "from", "until"],
                json!({ "modules": of("modules"), "from": of("time"), "until": of("time") }),
            ),
        ),
        (
            "obstacle",
            fault(
                "Something foreign comes into a cell.",
                "obstacle",
                &["at"],
                json!({ "obstacle": of("cell"), "until": for_good() }),
            ),
        ),
    ]
}

/// Shapes of cubes.
fn shapes() -> Definitions {
    let parts = json!({ "type": "array", "items": of("shape") });
    vec![
        (
            "shape",
            one_of_its_keys(table(
                "A set of cells; one of these.",
                &[],
                json!({
                    "box": of("box"),
                    "sphere": of("sphere"),
                    "disc": of("disc"),
                    "cylinder": of("cylinder"),
                    "cells": said("Each named once.", json!({ "type": "array", "items": of("cell") })),
                    "file": of("file"),
                    "union": parts,
                    "difference": said("The first without the others.", parts.clone()),
                    "intersection": parts,
                }),
            )),
        ),
        (
            "box",
            table(
                "Both corners belong to it.",
                &["min", "max"],
                json!({ "min": of("cell"), "max": of("cell") }),
            ),
        ),
        (
            "sphere",
            table("A ball.", &["center", "radius"], json!({ "center": of("cell"), "radius": of("radius") })),
        ),
        (
            "disc",
            table(
                "One cell thick, at right angles to its axis.",
                &["center", "radius"],
                json!({ "center": of("cell"), "radius": of("radius"), "axis": or(default_of(&AXES), of("axis")) }),
            ),
        ),
        (
            "cylinder",
            table(
                "A stack of discs.",
                &["base", "radius", "height"],
                json!({
                    "base": of("cell"),
                    "radius": of("radius"),
                    "height": natural(),
                    "axis": or(default_of(&AXES), of("axis")),
                }),
            ),
        ),
        (
            "file",
            table(
                "A solid (.stl, .obj) or a configuration of VisibleSim (.xml).",
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
                    "thin": said("What becomes of parts thinner than a cell.", one_of(&THIN)),
                    "voids": said("What becomes of inner voids.", one_of(&VOIDS)),
                }),
            ),
        ),
    ]
}

/// What only cubes have.
fn cubes() -> Definitions {
    vec![
        (
            "cubeSwarm",
            table(
                "Cubes that slide over each other.",
                &["start"],
                json!({
                    "family": or(Family::default().name(), json!({ "const": Family::Cube.name() })),
                    "start": of("shape"),
                    "move_time": or(BEAT.to_string(), of("time")),
                    "failed_connections": seldom(),
                }),
            ),
        ),
        (
            "cubeGoal",
            table(
                "A shape to be grown from a seed.",
                &["shape"],
                json!({
                    "name": said(NUMBERED, text()),
                    "shape": of("shape"),
                    "seed": said(
                        "Where growth begins. If left out, the cell of the goal nearest to its middle in which there is \
                         a module by then.",
                        of("cell"),
                    ),
                    "growth": one_of(&GROWTH),
                }),
            ),
        ),
        (
            "cubeProtocol",
            table(
                "How cubes decide.",
                &[],
                json!({
                    "connectivity": one_of(&CONNECTIVITY),
                    "dead": or(DEAD[0].0, json!({ "const": DEAD[0].0 })),
                    "co_owners": or(CO_OWNERS, json!({ "type": "boolean" })),
                }),
            ),
        ),
        ("cubeFault", any(&["kill", "pause", "restart", "stick", "crash", "partition"])),
    ]
}

/// What only metamodules have.
fn metamodules() -> Definitions {
    let start = json!({ "anyOf": [{ "const": "random" }, { "type": "array", "items": of("place") }] });
    let seeds = json!({ "type": "array", "minItems": 1, "items": of("seed") });
    let direction = names(&FACES.map(|(name, _)| name));
    let mut goal = table(
        "Seeds to be filled, level by level.",
        &[],
        json!({
            "name": said(NUMBERED, text()),
            "at": said("When it replaces the one before; left out of the first goal only.", of("time")),
            "shape": said("If left out, there are `levels`.", of("library")),
            "levels": said("If left out, there is a `shape`.", json!({ "type": "array", "items": seeds })),
            "order": said(
                "Of the seeds in a level.",
                or(SeedOrder::default().name(), names(&SeedOrder::ALL.map(SeedOrder::name))),
            ),
        }),
    );
    goal["oneOf"] = json!([{ "required": ["shape"] }, { "required": ["levels"] }]);
    vec![
        (
            "metamoduleSwarm",
            table(
                "Two Roombots modules each, which walk over a floor of connectors.",
                &["family"],
                json!({
                    "family": { "const": Family::Metamodule.name() },
                    "kind": or(KIND.name(), names(&Kind::METAMODULES.map(Kind::name))),
                    "count": said(
                        "If left out, as many as are listed in `start`, or one for each seed of the largest goal.",
                        json!({ "type": "integer", "minimum": 1, "maximum": MAX_METAMODULES }),
                    ),
                    "floor": or(json!({ "min": FLOOR.min, "max": FLOOR.max }), of("floor")),
                    "hearing": said(
                        "How many connectors away metamodules hear each other.",
                        or(HEARING, json!({ "type": "integer", "minimum": LEAST_HEARING, "maximum": MAX_HEARING })),
                    ),
                    "start": said("Drawn from the seed of the run, or a list.", or("random", start)),
                    "turn_time": or(BEAT.to_string(), of("time")),
                    "failed_connections": seldom(),
                }),
            ),
        ),
        (
            "floor",
            table(
                &format!("Both corners belong to it; at most {MAX_FLOOR} connectors along each side."),
                &["min", "max"],
                json!({ "min": of("connector"), "max": of("connector") }),
            ),
        ),
        (
            "place",
            table(
                "Where a metamodule starts, and by how many quarters it is turned.",
                &["at"],
                json!({
                    "at": of("connector"),
                    "class": or(CLASS, json!({ "type": "integer", "minimum": 0, "maximum": 3 })),
                }),
            ),
        ),
        ("metamoduleGoal", goal),
        (
            "library",
            one_of_its_keys(table(
                "A goal of the thesis, by the corner where it stands.",
                &[],
                json!({ "box": of("connector"), "chair": of("connector") }),
            )),
        ),
        (
            "seed",
            table(
                "A connector, and the directions from cell to cell.",
                &["foot", "directions"],
                json!({
                    "foot": of("connector"),
                    "directions": { "type": "array", "minItems": 3, "maxItems": 3, "items": direction },
                }),
            ),
        ),
        (
            "metamoduleProtocol",
            table(
                "How metamodules decide.",
                &[],
                json!({
                    "strategy": or(Strategy::default().name(), names(&Strategy::ALL.map(Strategy::name))),
                    "precedence": said(
                        "Which of two close together goes first, with `greedy`, `slope` and `step`. If it is left out, `greedy` has it within 4 by seed-distance, and the others have none.",
                        json!({ "anyOf": [{ "const": "off" }, of("precedence")] }),
                    ),
                    "settled_repel": said(
                        "Whether settled metamodules push, with `slope` and `step`. If it is left out, they do.",
                        json!({ "type": "boolean" }),
                    ),
                    "repulsion": said("How neighbours push. If it is left out, as the strategy has it.", of("repulsion")),
                    "teller": one_of(&TELLERS),
                    "relocate": said(
                        "Whether a goal that cannot be built where it is is moved.",
                        or(bool::default(), json!({ "type": "boolean" })),
                    ),
                    "detector": said(
                        "Whether the swarm finds out by itself that it stands still.",
                        or(bool::default(), json!({ "type": "boolean" })),
                    ),
                }),
            ),
        ),
        (
            "precedence",
            table(
                "Of two metamodules within this many connectors the one nearer to an open seed, or with the smaller id, goes first.",
                &["within", "by"],
                json!({
                    "within": { "type": "integer", "minimum": 1, "maximum": MAX_HEARING },
                    "by": names(&PrecedenceBy::ALL.map(PrecedenceBy::name)),
                }),
            ),
        ),
        (
            "repulsion",
            table(
                "How neighbours push, in thousandths of the attraction and in cells; what is left out is as the strategy has it.",
                &[],
                json!({
                    "strength": said(
                        "How much, in thousandths of the attraction. If it is left out, as the strategy has it.",
                        json!({ "type": "integer", "minimum": 0, "maximum": MAX_THOUSANDTHS }),
                    ),
                    "decay": said(
                        "How fast it falls with distance. If it is left out, as the strategy has it.",
                        json!({ "type": "integer", "minimum": 0, "maximum": 1000 }),
                    ),
                    "range": said(
                        "How far it reaches, in cells. If it is left out, as the strategy has it.",
                        json!({ "type": "integer", "minimum": 1, "maximum": MAX_RANGE }),
                    ),
                }),
            ),
        ),
        ("metamoduleFault", any(&["kill", "pause", "restart", "stick", "crash", "partition", "obstacle"])),
    ]
}

fn of(definition: &str) -> Value {
    json!({ "$ref": format!("#/$defs/{definition}") })
}

fn said(description: &str, mut schema: Value) -> Value {
    schema["description"] = json!(description);
    schema
}

/// With the value that a key has which is left out.
fn or(default: impl Into<Value>, mut schema: Value) -> Value {
    schema["default"] = default.into();
    schema
}

/// One of the names of a table, whose default is that of its type.
fn one_of<T: Default + PartialEq>(names: &[(&'static str, T)]) -> Value {
    let all: Vec<&str> = names.iter().map(|(name, _)| *name).collect();
    or(default_of(names), json!({ "enum": all }))
}

/// A probability that is nothing unless it is named.
fn seldom() -> Value {
    or(NEVER.to_string(), of("probability"))
}

/// When a fault ends, which it need not.
fn for_good() -> Value {
    said("When it is whole again; if left out, never.", of("time"))
}

fn text() -> Value {
    json!({ "type": "string" })
}

fn natural() -> Value {
    json!({ "type": "integer", "minimum": 0 })
}

fn names(names: &[&str]) -> Value {
    json!({ "enum": names })
}

fn any(definitions: &[&str]) -> Value {
    json!({ "oneOf": definitions.iter().map(|name| of(name)).collect::<Vec<_>>() })
}

/// A table with these keys and no others.
fn table(description: &str, required: &[&str], properties: Value) -> Value {
    json!({
        "description": description,
        "type": "object",
        "additionalProperties": false,
        "required": required,
        "properties": properties,
    })
}

fn one_of_its_keys(mut table: Value) -> Value {
    table["minProperties"] = json!(1);
    table["maxProperties"] = json!(1);
    table
}

/// A fault: whom or what it hits, the times that it needs, and more keys that it may have.
fn fault(description: &str, verb: &str, times: &[&str], more: Value) -> Value {
    let mut schema = table(description, &[&[verb], times].concat(), json!({ (verb): of("modules") }));
    for time in times {
        schema["properties"][*time] = of("time");
    }
    if let Value::Object(more) = more {
        for (key, value) in more {
            schema["properties"][key] = value;
        }
    }
    schema
}
