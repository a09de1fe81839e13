//! The JSON schemas agree with the program: scenarios that the reader accepts are valid, unknown keys are
//! not, and neither can be changed without the other. Reports and summaries of real runs are valid.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_tests::command::{names_default, run, scenario, scenarios};
use metamorph_tests::json_schema::Schema;
use metamorph_world_controller::family::families;
use metamorph_world_controller::family::read_text;
use metamorph_world_controller::scenario::error::ScenarioError;
use metamorph_world_controller::scenario::plan_summary::overview;
use metamorph_world_controller::scenario::schema::schema;
use metamorph_world_controller::scenario::settings::Setting;
use metamorph_world_controller::scenario::{LinkKind, Overrides};
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

/// Every table that cubes can have.
const CUBES: &str = r#"
version = 1
name = "cubes"
description = "every table"
seed = 3
[swarm]
family = "cube"
start = { union = [{ box = { min = [0, 0, 0], max = [5, 5, 0] } }, { cells = [[0, 0, 1], [1, 0, 1]] }] }
move_time = "1s"
failed_connections = "1%"
[[goal]]
name = "one"
shape = { difference = [{ sphere = { center = [2, 2, 0], radius = 2.5 } }, { disc = { center = [2, 2, 2], radius = 1, axis = "z" } }] }
seed = [2, 2, 0]
growth = "scaffold"
[[goal]]
shape = { intersection = [{ cylinder = { base = [2, 2, 0], radius = 2, height = 1, axis = "z" } }, { box = { min = [0, 0, 0], max = [4, 4, 4] } }] }
growth = "solid"
[[goal]]
shape = { file = { path = "deploy/shapes/arch.stl", pitch = 10, up = "z", at = [3, 2, -2], thin = "refuse", voids = "keep" } }
growth = "solid"
[protocol]
connectivity = "forest"
dead = "hold"
co_owners = true
[link]
delay = "10ms..100ms"
loss = "5%"
duplicate = 0.01
reorder = "1/50"
corrupt = 0
[link.burst]
enter = "1%"
leave = "10%"
loss = "90%"
delay = "50ms..200ms"
[[link.between]]
modules = [3, [4, 5]]
one_way = true
from = "1s"
until = "20s"
delay = "50ms..200ms"
burst = { enter = "1%", leave = "10%" }
loss = "5%"
duplicate = "1%"
reorder = "1%"
corrupt = "1%"
[link.controller]
delay = "20ms..50ms"
loss = "5%"
[link.between_hosts]
hosts = [20, 18]
delay = { quantiles = [["50%", "2ms"], ["100%", "80ms"]] }
burst = { enter = "1%", leave = "10%" }
loss = "1%"
duplicate = "1%"
reorder = "1%"
corrupt = "1%"
skew = ["0s", "-8ms"]
[[link.between_hosts.pair]]
hosts = ["h1", "h2"]
delay = "20ms..30ms"
loss = "2%"
duplicate = "2%"
reorder = "2%"
corrupt = "2%"
[[change]]
after = 5
reseed = { links = 17 }
[[change]]
after = 6
rescue = "off"
[[change]]
after = 7
lose = "7.0.213"
[[change]]
after = 8
sleep = { module = 7, for = "1s" }
[controller]
rescue = "calls"
[process]
time_scale = 20
[[command]]
at = "1s"
operator = 2
do = ["kill 5", "stick 4"]
[[fault]]
kill = 3
at = "2s"
[[fault]]
pause = [2, 4]
from = "1s"
until = "3s"
[[fault]]
restart = 5
at = "4s"
memory = false
[[fault]]
stick = 7
at = "1s"
until = "9s"
[[fault]]
crash = { fraction = "5%", between = "0s..60s" }
[[fault]]
crash = { count = 1, between = "0s..60s" }
[[fault]]
partition = { modules = [1, 2, 3], from = "5s", until = "10s" }
[[fault]]
kill_host = "h2"
at = "20s"
[[fault]]
pause_host = "h2"
from = "10s"
until = "15s"
[[fault]]
cut = ["h1", "h2"]
from = "1s"
until = "3s"
[stop]
timeout = "1000s"
stall = "300s"
livelock = "900s"
[[file]]
name = "a.toml"
text = "version = 1"
"#;

/// Every table of free modules.
const FREE_MODULES: &str = r#"
version = 1
[swarm]
family = "free-module"
start = "line:2"
types = "1"
[[goal]]
shape = "ell:2"
[protocol]
weight = 2
"#;

/// Every table of elements.
const ELEMENTS: &str = r#"
version = 1
[swarm]
family = "metamodule"
count = 5
floor = { min = [0, 0], max = [15, 12] }
[[swarm.element]]
shape = "plate3x3"
at = { cell = [4, 5, 0] }
to = { cell = [8, 5, 4] }
[[goal]]
levels = [[
    { foot = [8, 5], directions = ["up", "up", "up"] },
    { foot = [10, 5], directions = ["up", "up", "up"] },
    { foot = [10, 7], directions = ["up", "up", "up"] },
    { foot = [8, 7], directions = ["up", "up", "up"] },
]]
[protocol]
strategy = "planned"
[[fault]]
drop = 0
at = "30s"
"#;

/// Every table that metamodules can have besides.
const METAMODULES: &str = r#"
version = 1
[swarm]
family = "metamodule"
kind = "PER"
count = 4
start = [{ at = [1, 2], class = 3 }, { at = [8, 2] }, { at = [9, 9], class = 1 }, { at = [3, 9] }]
floor = { min = [-1, 0], max = [12, 11] }
turn_time = "1s"
communication_range = 10
failed_connections = "5%"
[[goal]]
name = "one"
levels = [[{ foot = [5, 5], directions = ["up", "up", "east"] }], [{ foot = [7, 7], directions = ["up", "up", "west"] }]]
order = "crosswise"
[[goal]]
at = "60s"
shape = { box = [3, 3] }
[protocol]
strategy = "slope"
precedence = { within = 4, by = "id" }
settled_repel = false
repulsion = { strength = 500, decay = 100, range = 3 }
seed_authority = "neighbours"
relocate = true
[operator]
kind = "scripted"
look = "1s"
notice = "1s..2s"
think = "2s"
act = "1s"
choice = "nearest"
level = "full"
window = "30s"
lease = "60s"
[[fault]]
obstacle = [4, 4, 0]
at = "1s"
until = "99s"
"#;

fn overrides(setting: &str) -> Overrides {
    let setting = Setting { option: "--set", text: setting.to_owned() };
    Overrides { link: LinkKind::Sim, settings: vec![setting], ..Overrides::default() }
}

/// Returns the root of the workspace, to which relative paths of these texts refer.
fn origin() -> String {
    metamorph_tests::command::root().join("scenario.toml").display().to_string()
}

/// Returns the errors of the reader for a text with a value put into it.
fn errors_of(text: &str, setting: &str) -> Vec<ScenarioError> {
    let read = read_text(&origin(), text, &overrides(setting));
    read.err().map_or_else(Vec::new, |diagnostics| {
        diagnostics.list().iter().map(|p| p.scenario_error.clone()).collect()
    })
}

/// The schema says that it holds for JSON: every shipped scenario runs from JSON as from TOML, and errors point into the JSON.
#[test]
fn scenarios_are_read_from_json() {
    let read = |path: &Path, text: &str| read_text(&path.display().to_string(), text, &overrides("seed=3"));
    for path in scenarios() {
        let text = fs::read_to_string(&path).unwrap();
        let json = format!(" \n{:#}\n", document(&text, None));
        let plans = [text.as_str(), &json].map(|text| read(&path, text).unwrap_or_else(|e| panic!("{e}")));
        let [toml, json] = plans.map(|plan| overview(&plan));
        assert_eq!(toml, json, "{}", path.display());
    }
    for (text, place, part) in [
        ("{\"version\": 1,\n \"swarm\": {\"start\": 5}}", ":2:21", "start"),
        ("{\"version\": 1,\n \"name\": null}", ":2:10", "this is not JSON"),
        ("{\"version\": 1,\n \"name\": \"a:b\", \"nam\": 1}", ":2:17", "unknown key `nam`"),
        ("{\"version\": 1", "a.json:1", "this is not JSON"),
    ] {
        let said = read(Path::new("a.json"), text).unwrap_err().to_string();
        assert!(said.contains(place) && said.contains(part), "{text}: {said}");
    }
}

/// Every key says what it means: `new`, editors and the reference show it.
#[test]
fn every_key_of_a_scenario_is_described() {
    let schema = serde_json::to_value(schema(families())).unwrap();
    let (root, tables) = ("scenario".to_owned(), schema["$defs"].as_object().unwrap().iter());
    let mut silent = Vec::new();
    for (name, table) in tables.chain([(&root, &schema)]) {
        for (key, value) in table["properties"].as_object().into_iter().flatten() {
            if value["description"].as_str().is_none_or(str::is_empty) {
                silent.push(format!("{name}.{key}"));
            }
        }
    }
    assert!(silent.is_empty(), "no description: {silent:?}");
}

/// Converts TOML to the same values in JSON, with a value put into it.
fn document(text: &str, setting: Option<(&str, Value)>) -> Value {
    let mut document: Value = toml::from_str(text).unwrap();
    if let Some((key, value)) = setting {
        let (table, last) = key.rsplit_once('.').unwrap_or(("", key));
        let pointer = if table.is_empty() { String::new() } else { format!("/{}", table.replace('.', "/")) };
        document.pointer_mut(&pointer).unwrap_or_else(|| panic!("{key}"))[last] = value;
    }
    document
}

fn validator() -> Schema {
    Schema::new(&schema(families()))
}

/// Returns each table of the texts, the definition in the schema that describes it, and keys that the reader
/// lists there because they would make another kind of table of it.
fn tables() -> Vec<(&'static str, &'static str, &'static str, Vec<&'static str>)> {
    let shared = ["kill", "pause", "restart", "stick", "crash", "partition"];
    let verbs = [&shared[..], &["kill_host", "pause_host", "cut", "obstacle", "drop", "controller"]].concat();
    let fault = |verb: &str| verbs.iter().copied().filter(|other| *other != verb).collect();
    vec![
        (CUBES, "", "", vec![]),
        (CUBES, "link.", "link", vec![]),
        (CUBES, "link.burst.", "burst", vec![]),
        (CUBES, "link.between.0.", "between", vec![]),
        (CUBES, "link.between_hosts.delay.", "quantiles", vec![]),
        (CUBES, "link.controller.", "controller-link", vec![]),
        (CUBES, "link.between_hosts.", "between_hosts", vec![]),
        (CUBES, "link.between_hosts.pair.0.", "host-pair", vec![]),
        (CUBES, "change.0.", "change", vec![]),
        (CUBES, "change.0.reseed.", "reseed", vec![]),
        (CUBES, "change.3.sleep.", "sleep", vec![]),
        (CUBES, "controller.", "controller", vec![]),
        (CUBES, "process.", "process", vec![]),
        (CUBES, "stop.", "stop", vec![]),
        (CUBES, "file.0.", "packed-file", vec![]),
        (CUBES, "swarm.", "cubeSwarm", vec![]),
        (CUBES, "goal.0.", "cubeGoal", vec![]),
        (CUBES, "protocol.", "cubeProtocol", vec![]),
        (CUBES, "command.0.", "command", vec![]),
        (CUBES, "fault.0.", "kill", fault("kill")),
        (CUBES, "fault.1.", "pause", fault("pause")),
        (CUBES, "fault.2.", "restart", fault("restart")),
        (CUBES, "fault.3.", "stick", fault("stick")),
        (CUBES, "fault.4.", "crash", fault("crash")),
        (CUBES, "fault.4.crash.", "crashes", vec![]),
        (CUBES, "fault.6.", "partition", fault("partition")),
        (CUBES, "fault.6.partition.", "sides", vec![]),
        (CUBES, "fault.7.", "kill_host", fault("kill_host")),
        (CUBES, "fault.8.", "pause_host", fault("pause_host")),
        (CUBES, "fault.9.", "cut", fault("cut")),
        (CUBES, "swarm.start.", "shape", vec![]),
        (CUBES, "swarm.start.union.0.box.", "box", vec![]),
        (CUBES, "goal.0.shape.difference.0.sphere.", "sphere", vec![]),
        (CUBES, "goal.0.shape.difference.1.disc.", "disc", vec![]),
        (CUBES, "goal.1.shape.intersection.0.cylinder.", "cylinder", vec![]),
        (CUBES, "goal.2.shape.file.", "file", vec![]),
        (METAMODULES, "swarm.", "metamoduleSwarm", vec![]),
        (METAMODULES, "swarm.floor.", "floor", vec![]),
        (METAMODULES, "swarm.start.0.", "place", vec![]),
        (METAMODULES, "goal.0.", "metamoduleGoal", vec![]),
        (METAMODULES, "goal.0.levels.0.0.", "seed", vec![]),
        (METAMODULES, "goal.1.shape.", "library", vec![]),
        (METAMODULES, "protocol.", "metamoduleProtocol", vec![]),
        (METAMODULES, "protocol.precedence.", "precedence", vec![]),
        (METAMODULES, "protocol.repulsion.", "repulsion", vec![]),
        (METAMODULES, "operator.", "operator", vec![]),
        (METAMODULES, "fault.0.", "obstacle", fault("obstacle")),
        (ELEMENTS, "swarm.element.0.", "element", vec![]),
        (ELEMENTS, "swarm.element.0.at.", "lying", vec![]),
        (ELEMENTS, "fault.0.", "drop", fault("drop")),
        (FREE_MODULES, "swarm.", "free-moduleSwarm", vec![]),
        (FREE_MODULES, "goal.0.", "free-moduleGoal", vec![]),
        (FREE_MODULES, "protocol.", "free-moduleProtocol", vec![]),
    ]
}

#[test]
fn every_shipped_scenario_is_valid() {
    let validator = validator();
    for path in scenarios() {
        let document = document(&fs::read_to_string(&path).unwrap(), None);
        validator.accepts(&document, &path.display().to_string());
    }
}

#[test]
fn the_reader_and_the_schema_know_the_same_keys() {
    let (schema, validator) = (schema(families()), validator());
    for text in [CUBES, METAMODULES, ELEMENTS, FREE_MODULES] {
        assert!(errors_of(text, "version=1").is_empty(), "{:?}", errors_of(text, "version=1"));
        validator.accepts(&document(text, None), text);
    }
    let mut described = BTreeSet::new();
    for (text, table, definition, others) in tables() {
        described.insert(definition);
        let key = format!("{table}zzz");
        let errors_of = errors_of(text, &format!("{key}=1"));
        let known = errors_of.iter().find_map(|scenario_error| match scenario_error {
            ScenarioError::UnknownKey { key, known, .. } if key == "zzz" => Some(known),
            _ => None,
        });
        let known: BTreeSet<&str> = known
            .unwrap_or_else(|| panic!("the reader takes {key}: {errors_of:?}"))
            .iter()
            .copied()
            .filter(|known| !others.contains(known))
            .collect();
        let place = if definition.is_empty() { &schema } else { &schema["$defs"][definition] };
        let properties = place["properties"].as_object().unwrap().iter();
        let properties: BTreeSet<&str> =
            properties.filter(|(_, p)| p.get("deprecated").is_none()).map(|(key, _)| key.as_str()).collect();
        assert_eq!(known, properties, "keys of `{table}`: the reader's, and the schema's");
        validator.refuses(&document(text, Some((&key, Value::from(1)))), &key);
    }
    let tables = schema["$defs"].as_object().unwrap().iter();
    let tables = tables.filter(|(_, d)| d.get("properties").is_some()).map(|(name, _)| name.as_str());
    assert_eq!(tables.chain([""]).collect::<BTreeSet<_>>(), described, "a table that is not compared");
}

/// Keys that were renamed are read under their former names, and refused beside the new ones.
#[test]
fn former_keys_are_read() {
    let validator = validator();
    for (key, former) in [("communication_range", "hearing"), ("seed_authority", "teller")] {
        let text = METAMODULES.replace(key, former);
        assert!(text != METAMODULES && errors_of(&text, "version=1").is_empty(), "{former}");
        validator.accepts(&document(&text, None), former);
        let line = METAMODULES.lines().find(|line| line.starts_with(key)).unwrap();
        let both = METAMODULES.replace(line, &format!("{line}\n{}", line.replace(key, former)));
        let unknown = |e: &ScenarioError| matches!(e, ScenarioError::UnknownKey { key, .. } if key == former);
        assert!(errors_of(&both, "version=1").iter().any(unknown), "{former}");
    }
}

#[test]
fn the_reader_and_the_schema_know_the_same_names() {
    let (schema, validator) = (schema(families()), validator());
    let names = [
        (CUBES, "swarm.family", None),
        (CUBES, "goal.0.growth", Some("cubeGoal/properties/growth")),
        (CUBES, "protocol.connectivity", Some("cubeProtocol/properties/connectivity")),
        (CUBES, "goal.0.shape.difference.1.disc.axis", Some("axis")),
        (CUBES, "goal.2.shape.file.up", Some("file/properties/up")),
        (CUBES, "goal.2.shape.file.part", Some("file/properties/part")),
        (CUBES, "goal.2.shape.file.thin", Some("file/properties/thin")),
        (CUBES, "goal.2.shape.file.voids", Some("file/properties/voids")),
        (METAMODULES, "swarm.kind", Some("metamoduleSwarm/properties/kind")),
        (METAMODULES, "goal.0.order", Some("metamoduleGoal/properties/order")),
        (METAMODULES, "goal.0.levels.0.0.directions.0", Some("seed/properties/directions/items")),
        (METAMODULES, "protocol.strategy", Some("metamoduleProtocol/properties/strategy")),
        (METAMODULES, "protocol.seed_authority", Some("metamoduleProtocol/properties/seed_authority")),
        (METAMODULES, "protocol.precedence.by", Some("precedence/properties/by")),
        (FREE_MODULES, "swarm.body", Some("free-moduleSwarm/properties/body")),
        (FREE_MODULES, "protocol.strategy", Some("free-moduleProtocol/properties/strategy")),
        (FREE_MODULES, "protocol.collision", Some("free-moduleProtocol/properties/collision")),
        (FREE_MODULES, "protocol.connectors", Some("free-moduleProtocol/properties/connectors")),
        (FREE_MODULES, "protocol.objective", Some("free-moduleProtocol/properties/objective")),
    ];
    for (text, key, place) in names {
        let errors_of = errors_of(text, &format!("{key}=zzz"));
        let known = errors_of.iter().find_map(|scenario_error| match scenario_error {
            ScenarioError::Name { got, known, .. } if got == "zzz" => Some(known.iter().copied().collect()),
            _ => None,
        });
        let known: BTreeSet<&str> = known.unwrap_or_else(|| panic!("the reader takes {key}: {errors_of:?}"));
        let in_schema: BTreeSet<&str> = match place {
            // Each family has a section of its own.
            None => ["cubeSwarm", "metamoduleSwarm", "free-moduleSwarm"]
                .iter()
                .map(|d| schema["$defs"][d]["properties"]["family"]["const"].as_str().unwrap())
                .collect(),
            Some(place) => {
                let names = schema.pointer(&format!("/$defs/{place}/enum")).unwrap();
                names.as_array().unwrap().iter().map(|name| name.as_str().unwrap()).collect()
            }
        };
        assert_eq!(known, in_schema, "names for {key}: the reader's, and the schema's");
        if !key.ends_with(".0") {
            validator.refuses(&document(text, Some((key, Value::from("zzz")))), key);
        }
    }
}

/// Each table with defaults: its place in a smallest scenario, and its definition in the schema.
const SMALLEST: [(&str, &str, &str); 23] = [
    (SMALLEST_OF_CUBES, "", ""),
    (SMALLEST_OF_CUBES, "link", "link"),
    (SMALLEST_OF_CUBES, "controller", "controller"),
    (SMALLEST_OF_CUBES, "process", "process"),
    (SMALLEST_OF_CUBES, "swarm", "cubeSwarm"),
    (SMALLEST_OF_CUBES, "goal.0", "cubeGoal"),
    (SMALLEST_OF_CUBES, "protocol", "cubeProtocol"),
    (SHAPES, "goal.0.shape.union.0.disc", "disc"),
    (SHAPES, "goal.0.shape.union.1.cylinder", "cylinder"),
    (SHAPES, "goal.0.shape.union.2.file", "file"),
    (SMALLEST_OF_CUBES, "fault.0", "restart"),
    (SMALLEST_OF_CUBES, "command.0", "command"),
    (SMALLEST_OF_METAMODULES, "", ""),
    (SMALLEST_OF_METAMODULES, "swarm", "metamoduleSwarm"),
    (SMALLEST_OF_METAMODULES, "goal.0", "metamoduleGoal"),
    (SMALLEST_OF_METAMODULES, "protocol", "metamoduleProtocol"),
    (LISTED, "swarm.start.0", "place"),
    (OPERATED, "operator", "operator"),
    (ELEMENTS, "swarm.element.0", "element"),
    (ELEMENTS, "swarm.element.0.at", "lying"),
    (SMALLEST_OF_FREE_MODULES, "swarm", "free-moduleSwarm"),
    (SMALLEST_OF_FREE_MODULES, "goal.0", "free-moduleGoal"),
    (SMALLEST_OF_FREE_MODULES, "protocol", "free-moduleProtocol"),
];

const SMALLEST_OF_FREE_MODULES: &str = r#"
version = 1
[swarm]
family = "free-module"
start = "line:2"
[[goal]]
shape = "ell:2"
"#;

/// A scenario without any optional key.
const SMALLEST_OF_CUBES: &str = r#"
version = 1
[swarm]
start = { box = { min = [-6, -6, 0], max = [6, 6, 0] } }
[[goal]]
shape = { box = { min = [0, 0, 0], max = [4, 4, 2] } }
[[fault]]
restart = 0
at = "1s"
[[command]]
at = "1s"
do = ["kill 0"]
"#;

const SHAPES: &str = r#"
version = 1
[swarm]
start = { box = { min = [-6, -6, 0], max = [6, 6, 0] } }
[[goal]]
shape = { union = [{ disc = { center = [0, 0, 0], radius = 4 } }, { cylinder = { base = [0, 0, 0], radius = 1, height = 1 } }, { file = { path = "deploy/shapes/arch.stl", pitch = 10 } }] }
growth = "solid"
"#;

const SMALLEST_OF_METAMODULES: &str = r#"
version = 1
[swarm]
family = "metamodule"
[[goal]]
shape = { box = [3, 3] }
"#;

const LISTED: &str = r#"
version = 1
[swarm]
family = "metamodule"
start = [{ at = [0, 0] }, { at = [9, 0] }, { at = [0, 9] }, { at = [9, 9] }]
[[goal]]
shape = { box = [3, 3] }
"#;

const OPERATED: &str = r#"
version = 1
[swarm]
family = "metamodule"
[[goal]]
shape = { box = [3, 3] }
[operator]
kind = "scripted"
"#;

/// Returns the plan without the text and the options that it comes from.
fn plan(text: &str, setting: &str) -> String {
    let mut plan =
        read_text(&origin(), text, &overrides(setting)).unwrap_or_else(|p| panic!("{setting}: {p}"));
    plan.overrides = Overrides::default();
    format!("{plan:?}")
}

/// A key that can be left out has a default or says what happens then.
#[test]
fn the_schema_states_every_default() {
    let schema = schema(families());
    let (mut stated, mut compared) = (BTreeSet::new(), BTreeSet::new());
    let tables = schema["$defs"].as_object().unwrap().iter().map(|(name, table)| (name.as_str(), table));
    for (name, table) in tables.chain([("", &schema)]) {
        let is_choice = table["maxProperties"] == 1;
        let Some(properties) = table["properties"].as_object().filter(|_| !is_choice) else { continue };
        let required: Vec<&str> =
            table["required"].as_array().unwrap().iter().map(|key| key.as_str().unwrap()).collect();
        for (key, property) in properties.iter().filter(|(key, _)| !required.contains(&key.as_str())) {
            let described = property["description"].as_str().unwrap_or_default();
            let default = property.get("default");
            let says_it = default.is_some() || names_default(described);
            assert!(says_it, "`{key}` in `{name}`: {property}");
            stated.extend(default.map(|_| (name, key.as_str())));
        }
    }
    // With the stated default a plan is the same as without the key.
    for (text, place, definition) in SMALLEST {
        let table = if definition.is_empty() { &schema } else { &schema["$defs"][definition] };
        for (key, property) in table["properties"].as_object().unwrap() {
            let Some(default) = property.get("default") else { continue };
            compared.insert((definition, key.as_str()));
            let path = if place.is_empty() { key.clone() } else { format!("{place}.{key}") };
            // Empty tables are replaced by those of the text, and the file of the text has no parts.
            let is_empty =
                default.as_object().is_some_and(serde_json::Map::is_empty) || default == &json!([]);
            if !is_empty && key != "part" {
                let value = toml::Value::try_from(default).unwrap();
                assert_eq!(
                    plan(text, &format!("{path}={value}")),
                    plan(text, "version=1"),
                    "{path} = {value}"
                );
            }
        }
    }
    assert_eq!(stated, compared, "defaults that are stated, and those that are compared");
}

/// The comparison above would find another default.
#[test]
fn another_value_is_another_plan() {
    for (text, other) in [
        (SMALLEST_OF_METAMODULES, "protocol.strategy=greedy"),
        (SMALLEST_OF_METAMODULES, "goal.0.order=circular"),
        (SMALLEST_OF_METAMODULES, "protocol.relocate=true"),
        (SMALLEST_OF_METAMODULES, "swarm.floor={ min = [0, 0], max = [11, 12] }"),
        (SMALLEST_OF_CUBES, "protocol.co_owners=false"),
        (SMALLEST_OF_CUBES, "link.loss=1%"),
        (SMALLEST_OF_CUBES, "seed=2"),
        (LISTED, "swarm.start.0.class=1"),
    ] {
        assert_ne!(plan(text, other), plan(text, "version=1"), "{other}");
    }
}

/// Checks a document against the schema that a command prints.
fn check(of: &str, document: &str) {
    let printed = run(&["schema", of]);
    assert_eq!(printed.code, Some(0), "{printed:?}");
    let schema: Value = serde_json::from_str(&printed.out).unwrap();
    let document: Value = serde_json::from_str(document).unwrap();
    let schema = Schema::new(&schema);
    schema.accepts(&document, of);
    // A document without one of its fields is not valid, so the schema is not trivial.
    for key in document.as_object().unwrap().keys() {
        let mut less = document.clone();
        less.as_object_mut().unwrap().remove(key);
        schema.refuses(&less, &format!("a {of} without {key}"));
    }
}

#[test]
fn reports_and_summaries_are_valid() {
    for args in [&["arch.toml", "--kill", "3@1s"][..], &["box.toml"]] {
        let path = scenario(args[0]);
        let ran =
            run(&[&["run", path.to_str().unwrap(), "--link", "sim", "--quiet", "--json", "-"], &args[1..]]
                .concat());
        check("report", &ran.out);
    }
    let directory = tempfile::tempdir().unwrap();
    let out = directory.path().join("out");
    let path = scenario("arch.toml");
    let vary = ["--vary", "link.loss=0%,5%", "--quiet", "--out", out.to_str().unwrap()];
    let ran = run(&[&["sweep", path.to_str().unwrap(), "--seeds", "0..3"], &vary[..]].concat());
    assert_eq!(ran.code, Some(0), "{ran:?}");
    check("summary", &fs::read_to_string(out.join("summary.json")).unwrap());
}
