//! A JSON schema as a page: a table of keys for the document and for each definition.

use crate::links::anchor;
use serde_json::Value;

/// Returns the page of a document.
pub fn page(name: &str, about: &str, schema: &Value) -> String {
    let mut page = format!(
        "# {}\n\n{about}. `metamorph schema {name}` prints the JSON schema that this page is made from.\n",
        capitalised(&format!("{name} keys")),
    );
    table(&mut page, schema);
    let definitions = schema["$defs"].as_object().into_iter().flatten();
    for (name, definition) in definitions {
        page.push_str(&format!("\n## {name}\n"));
        if let Some(text) = definition["description"].as_str() {
            page.push_str(&format!("\n{}\n", paragraph(text)));
        }
        match definition.get("properties") {
            Some(_) => table(&mut page, definition),
            None => page.push_str(&format!("\n{}.\n", capitalised(&kind(definition)))),
        }
    }
    page
}

fn capitalised(text: &str) -> String {
    let mut chars = text.chars();
    chars.next().map_or_else(String::new, |first| first.to_uppercase().chain(chars).collect())
}

fn paragraph(text: &str) -> String {
    text.replace("\n\n", "\u{0}").replace('\n', " ").replace('\u{0}', "\n\n")
}

/// Writes the table of an object's keys, with those of objects inside it.
fn table(page: &mut String, object: &Value) {
    let mut rows = Vec::new();
    keys("", object, object, &mut rows);
    if rows.is_empty() {
        return;
    }
    page.push_str("\n| key | value | default | meaning |\n|---|---|---|---|\n");
    rows.iter().for_each(|row| page.push_str(row));
}

fn keys(path: &str, object: &Value, root: &Value, rows: &mut Vec<String>) {
    for (key, value) in object["properties"].as_object().into_iter().flatten() {
        let name = format!("{path}{key}");
        let mut kinds: Vec<String> = if path.is_empty() { by_family(root, key) } else { Vec::new() };
        if kinds.is_empty() {
            kinds.push(kind(value));
        }
        kinds.dedup();
        let needed = object["required"].as_array().is_some_and(|keys| keys.iter().any(|other| other == key));
        let default = match value.get("default") {
            Some(default) => format!("`{default}`"),
            None if needed => "required".to_owned(),
            None => String::new(),
        };
        let mut meaning = paragraph(value["description"].as_str().unwrap_or_default()).replace("\n\n", " ");
        if value["deprecated"] == true {
            meaning = format!("Deprecated. {meaning}");
        }
        rows.push(format!("| `{name}` | {} | {default} | {} |\n", kinds.join(", or "), escaped(&meaning)));
        for (suffix, inner) in inline_objects(value) {
            keys(&format!("{name}{suffix}."), inner, root, rows);
        }
    }
}

/// Returns the kinds of a key of the document that depend on the family.
fn by_family(schema: &Value, key: &str) -> Vec<String> {
    let branches = ["else", "then"].iter().filter_map(|branch| schema.get(branch));
    let kinds = branches.flat_map(|branch| {
        let own = branch["properties"].get(key).map(kind);
        own.into_iter().chain(by_family(branch, key)).collect::<Vec<_>>()
    });
    kinds.collect()
}

/// Returns the objects that are written inside a value, with what their keys' path has in addition.
fn inline_objects(value: &Value) -> Vec<(&'static str, &Value)> {
    if value.get("properties").is_some() {
        return vec![("", value)];
    }
    let mut found = Vec::new();
    for choice in ["anyOf", "oneOf"] {
        found.extend(value[choice].as_array().into_iter().flatten().flat_map(inline_objects));
    }
    if let Some(items) = value.get("items") {
        found.extend(inline_objects(items).into_iter().map(|(_, object)| ("[]", object)));
    }
    found
}

fn escaped(text: &str) -> String {
    text.replace('|', "\\|")
}

/// Describes the kind of a value.
fn kind(value: &Value) -> String {
    if let Some(name) = value["$ref"].as_str().and_then(|path| path.rsplit('/').next()) {
        return format!("[{name}](#{})", anchor(name));
    }
    if let Some(only) = value.get("const") {
        return format!("`{only}`");
    }
    if let Some(names) = value["enum"].as_array() {
        return names.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    }
    for choice in ["anyOf", "oneOf"] {
        if let Some(kinds) = value[choice].as_array().filter(|kinds| kinds[0].get("required").is_none()) {
            return kinds.iter().map(kind).collect::<Vec<_>>().join(", or ");
        }
    }
    match &value["type"] {
        Value::String(name) => simple(name, value),
        Value::Array(names) => {
            let names = names.iter().filter_map(Value::as_str).map(|name| simple(name, value));
            names.collect::<Vec<_>>().join(" or ")
        }
        _ => "any value".to_owned(),
    }
}

fn simple(name: &str, value: &Value) -> String {
    match name {
        "array" => {
            let of = value.get("items").map_or_else(String::new, |items| format!(" of {}", kind(items)));
            match value["minItems"].as_u64().filter(|n| value["maxItems"].as_u64() == Some(*n)) {
                Some(n) => format!("list of {n}{}", of.replacen(" of", ":", 1)),
                None => format!("list{of}"),
            }
        }
        "object" => match value.get("additionalProperties").filter(|other| other.is_object()) {
            Some(other) => format!("table of {}", kind(other)),
            None => "table".to_owned(),
        },
        "integer" => format!("whole number{}", range(value)),
        "number" => format!("number{}", range(value)),
        "string" => "text".to_owned(),
        "boolean" => "`true`, `false`".to_owned(),
        other => other.to_owned(),
    }
}

fn range(value: &Value) -> String {
    match (value["minimum"].as_i64(), value["maximum"].as_i64()) {
        (Some(least), Some(most)) => format!(", {least} to {most}"),
        (Some(0), None) | (None, None) => String::new(),
        (Some(least), None) => format!(", at least {least}"),
        (None, Some(most)) => format!(", at most {most}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn kinds_are_described() {
        for (value, expected) in [
            (json!({ "$ref": "#/$defs/cubeGoal" }), "[cubeGoal](#cubegoal)"),
            (
                json!({ "type": "array", "items": { "type": "integer" }, "minItems": 3, "maxItems": 3 }),
                "list of 3: whole number",
            ),
            (json!({ "type": ["string", "null"] }), "text or null"),
            (json!({ "enum": ["a", "b"] }), "`\"a\"`, `\"b\"`"),
            (
                json!({ "anyOf": [{ "type": "integer", "minimum": 1 }, { "type": "null" }] }),
                "whole number, at least 1, or null",
            ),
        ] {
            assert_eq!(kind(&value), expected, "{value}");
        }
    }

    #[test]
    fn keys_of_objects_inside_objects_and_of_families_are_listed() {
        let schema = json!({
            "properties": { "a": { "anyOf": [{ "type": "object", "properties": { "b": { "type": "string", "description": "x|y" } } }] },
                            "goal": { "type": "array", "default": [] } },
            "required": ["a"],
            "else": { "properties": { "goal": { "$ref": "#/$defs/one" } } },
            "then": { "properties": { "goal": { "$ref": "#/$defs/two" } } },
            "$defs": { "one": { "type": "string", "description": "Text." } },
        });
        let page = page("scenario", "A scenario", &schema);
        for line in [
            "| `a` | table | required |  |",
            "| `a.b` | text |  | x\\|y |",
            "| `goal` | [one](#one), or [two](#two) | `[]` |  |",
            "## one\n\nText.\n\nText.\n",
        ] {
            assert!(page.contains(line), "{line}: {page}");
        }
    }
}
