//! The parts that definitions of the JSON schema of scenarios are made of. The schema itself is in `schema`.

use super::table::default_of;
use metamorph_core::ratio::Ratio;
use serde_json::{Value, json};

/// Describes the default name of a goal.
pub const NUMBERED: &str = "If left out, `goal 1` and so on.";

/// Definitions by name.
pub type Definitions = Vec<(&'static str, Value)>;

/// Returns a reference to a definition.
pub fn of(definition: &str) -> Value {
    json!({ "$ref": format!("#/$defs/{definition}") })
}

/// Adds a description to a schema.
pub fn said(description: &str, mut schema: Value) -> Value {
    schema["description"] = json!(description);
    schema
}

/// Marks a schema as that of a key's former name.
pub fn former(key: &str, mut schema: Value) -> Value {
    schema["deprecated"] = json!(true);
    said(&format!("The former name of `{key}`."), schema)
}

/// Adds a default to a schema.
pub fn or(default: impl Into<Value>, mut schema: Value) -> Value {
    schema["default"] = default.into();
    schema
}

/// Returns the schema of a name from a table, with the default of its type.
pub fn one_of<T: Default + PartialEq>(names: &[(&'static str, T)]) -> Value {
    let all: Vec<&str> = names.iter().map(|(name, _)| *name).collect();
    or(default_of(names), json!({ "enum": all }))
}

/// Returns the schema of a probability that defaults to zero.
pub fn seldom(description: &str) -> Value {
    said(description, or(Ratio::ZERO.to_string(), of("probability")))
}

/// Returns the schema of the optional end of a fault.
pub fn for_good() -> Value {
    said("When it is repaired. Default: never.", of("time"))
}

/// Returns the schema of any text.
pub fn text() -> Value {
    json!({ "type": "string" })
}

/// Returns the schema of a whole number that is not negative.
pub fn natural() -> Value {
    json!({ "type": "integer", "minimum": 0 })
}

/// Returns the schema of one of these names.
pub fn names(names: &[&str]) -> Value {
    json!({ "enum": names })
}

/// Returns the schema of one of these definitions.
pub fn any(definitions: &[&str]) -> Value {
    json!({ "oneOf": definitions.iter().map(|name| of(name)).collect::<Vec<_>>() })
}

/// Returns the schema of a table with these keys and no others.
pub fn table(description: &str, required: &[&str], properties: Value) -> Value {
    json!({
        "description": description,
        "type": "object",
        "additionalProperties": false,
        "required": required,
        "properties": properties,
    })
}

/// Restricts a table to exactly one of its keys.
pub fn one_of_its_keys(mut table: Value) -> Value {
    table["minProperties"] = json!(1);
    table["maxProperties"] = json!(1);
    table
}

/// Returns the schema of a fault: its kind and target, required times, and more optional keys.
pub fn fault(description: &str, verb: &str, times: &[&str], more: Value) -> Value {
    let targets = said("A module, or a list of them.", of("modules"));
    let mut schema = table(description, &[&[verb], times].concat(), json!({ (verb): targets }));
    for time in times {
        let when = match *time {
            "at" => "When it happens.",
            "from" => "When it begins.",
            _ => "When it ends.",
        };
        schema["properties"][*time] = said(when, of("time"));
    }
    if let Value::Object(more) = more {
        for (key, value) in more {
            schema["properties"][key] = value;
        }
    }
    schema
}
