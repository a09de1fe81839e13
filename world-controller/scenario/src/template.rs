//! A scenario to begin with: the values of another scenario, and every other key with its default or an example,
//! commented out. Keys, defaults and meanings are those of the schema.
//!
//! A line that begins with `# ` is text; `#` before anything else is a key to be uncommented.

use super::family::{Families, ScenarioFamily};
use super::schema::schema;
use metamorph_text::format::many;
use serde_json::{Map, Value as Json, json};
use std::fmt::Write;
use toml::{Table, Value};

/// Columns of comments at most.
const WIDTH: usize = 100;

/// Examples of values that have no default, by key or else by the name of their definition.
const EXAMPLES: [(&str, &str); 24] = [
    ("from", "\"10s\""),
    ("until", "\"20s\""),
    ("timeout", "\"1000s\""),
    ("count", "10"),
    ("hosts", "2"),
    ("kill_host", "\"h2\""),
    ("pause_host", "\"h2\""),
    ("cut", "[\"h1\", \"h2\"]"),
    ("crash", "{ count = 1, between = \"0s..60s\" }"),
    ("time", "\"10s\""),
    ("window", "\"0s..60s\""),
    ("delay", "\"10ms..100ms\""),
    ("probability", "\"5%\""),
    ("cell", "[0, 0, 0]"),
    ("connector", "[0, 0]"),
    ("modules", "0"),
    ("types", "\"000\""),
    ("joints_deg", "[[0, 0, 0], [0, 0, 0], [0, 0, 0], [0, 0, 0]]"),
    ("radius", "3"),
    ("precedence", "{ within = 4, by = \"seed-distance\" }"),
    ("settled_repel", "true"),
    ("repulsion", "{ strength = 1, decay = 1, range = 1 }"),
    ("levels", "[[{ foot = [0, 0], directions = [\"up\", \"up\", \"up\"] }]]"),
    ("shape", "{ box = { min = [0, 0, 0], max = [4, 4, 0] } }"),
];

/// The properties of one family's scenarios, and what they refer to.
struct Reference {
    definitions: Map<String, Json>,
    properties: Map<String, Json>,
}

/// Returns a scenario with the values of `base`, which is one of this family. `minimal` leaves out the other keys.
pub fn template(
    families: Families,
    family: &dyn ScenarioFamily,
    base: &Table,
    name: &str,
    minimal: bool,
) -> String {
    let reference = Reference::of(families, family);
    let mut out = Writer { reference: &reference, text: String::new(), minimal };
    if !minimal {
        out.comment(&format!(
            "A scenario of Metamorph. Lines that begin with # and a key are defaults or examples: remove the # to set \
             them. `metamorph check {name}.toml` says what would run."
        ));
    }
    let mut top = base.clone();
    top.insert("name".to_owned(), Value::String(name.to_owned()));
    if let Some(description) = top.get_mut("description") {
        *description = Value::String("Say here what this scenario is about.".to_owned());
    }
    for wanted in ["version", "name", "description", "seed"] {
        out.keys(&reference.properties, &top, |key| key == wanted);
    }
    for section in ["swarm", "goal", "protocol", "link", "controller", "process", "stop"] {
        out.section(section, base.get(section));
    }
    out.faults(base.get("fault"));
    out.text
}

impl Reference {
    fn of(families: Families, family: &dyn ScenarioFamily) -> Reference {
        let whole = schema(families);
        let map = |value: &Json| value.as_object().cloned().unwrap_or_default();
        let mut properties = map(&whole["properties"]);
        for (section, part) in
            [("swarm", "Swarm"), ("goal", "Goal"), ("protocol", "Protocol"), ("fault", "Fault")]
        {
            properties
                .insert(section.to_owned(), json!({ "$ref": format!("#/$defs/{}{part}", family.name()) }));
        }
        Reference { definitions: map(&whole["$defs"]), properties }
    }

    /// Returns the name of what a schema refers to.
    fn name<'a>(&self, schema: &'a Json) -> Option<&'a str> {
        schema["$ref"].as_str()?.strip_prefix("#/$defs/")
    }

    /// Returns what a schema refers to, or itself.
    fn resolved<'a>(&'a self, schema: &'a Json) -> &'a Json {
        self.name(schema).and_then(|name| self.definitions.get(name)).unwrap_or(schema)
    }

    /// Describes a value: what it means, and which are possible.
    fn meaning(&self, schema: &Json) -> String {
        let target = self.resolved(schema);
        let mut said: Vec<String> = Vec::new();
        for description in [&schema["description"], &target["description"]] {
            if let Some(text) = description.as_str().filter(|text| !said.iter().any(|s| s == text)) {
                said.push(text.to_owned());
            }
        }
        if let Some(names) = target["enum"].as_array().filter(|names| names.len() > 1) {
            let names: Vec<&str> = names.iter().filter_map(Json::as_str).collect();
            said.push(format!("One of {}.", names.join(", ")));
        }
        match (target["minimum"].as_i64(), target["maximum"].as_i64()) {
            (Some(low), Some(high)) => said.push(format!("From {low} to {high}.")),
            (Some(low), None) if low > 0 => said.push(format!("At least {low}.")),
            _ => {}
        }
        said.join(" ")
    }

    /// Returns the default of a value, or an example.
    fn value(&self, key: &str, schema: &Json) -> String {
        if let Some(value) = [&schema["default"], &schema["const"]].into_iter().find(|value| !value.is_null())
        {
            return toml_of(value);
        }
        let example = |name: &str| EXAMPLES.iter().find(|(known, _)| *known == name).map(|(_, value)| *value);
        if let Some(value) = example(key).or_else(|| example(self.name(schema)?)) {
            return value.to_owned();
        }
        let target = self.resolved(schema);
        match (&target["const"], &target["enum"][0], target["type"].as_str()) {
            (Json::Null, Json::Null, Some("object")) => self.table(target),
            (Json::Null, Json::Null, Some("string")) => "\"text\"".to_owned(),
            (Json::Null, Json::Null, Some("boolean")) => "true".to_owned(),
            (Json::Null, Json::Null, Some("array")) => "[]".to_owned(),
            (Json::Null, Json::Null, _) => target["minimum"].as_i64().unwrap_or(1).max(1).to_string(),
            (Json::Null, first, _) => toml_of(first),
            (value, ..) => toml_of(value),
        }
    }

    /// Returns a table with the keys that it needs; if it needs exactly one, the first.
    fn table(&self, schema: &Json) -> String {
        let properties = schema["properties"].as_object();
        let required = schema["required"].as_array().map(Vec::as_slice).unwrap_or_default();
        let mut keys: Vec<&str> = required.iter().filter_map(Json::as_str).collect();
        if schema["minProperties"] == json!(1) {
            keys.extend(properties.and_then(|all| all.keys().next()).map(String::as_str));
        }
        let pairs =
            keys.iter().map(|key| format!("{key} = {}", self.value(key, &schema["properties"][*key])));
        let pairs: Vec<String> = pairs.collect();
        if pairs.is_empty() { "{}".to_owned() } else { format!("{{ {} }}", pairs.join(", ")) }
    }
}

fn toml_of(value: &Json) -> String {
    Value::try_from(value).map_or_else(|_| value.to_string(), |value| value.to_string())
}

struct Writer<'a> {
    reference: &'a Reference,
    text: String,
    minimal: bool,
}

impl Writer<'_> {
    fn comment(&mut self, text: &str) {
        let mut line = String::from("#");
        for word in text.split_whitespace() {
            if line.chars().count() + 1 + word.chars().count() > WIDTH {
                self.text.push_str(&line);
                self.text.push('\n');
                line = String::from("#");
            }
            line.push(' ');
            line.push_str(word);
        }
        if line.len() > 1 {
            self.text.push_str(&line);
            self.text.push('\n');
        }
    }

    /// Writes those of these keys with what they mean: those that are set, and the others commented out.
    fn keys(&mut self, properties: &Map<String, Json>, set: &Table, wanted: impl Fn(&str) -> bool) {
        for (key, schema) in properties.iter().filter(|(key, _)| wanted(key)) {
            let value = set.get(key);
            if schema["deprecated"] == json!(true) || (value.is_none() && self.minimal) {
                continue;
            }
            if !self.minimal {
                self.comment(&self.reference.meaning(schema));
            }
            let _ = match value {
                Some(value) => writeln!(self.text, "{key} = {value}"),
                None => writeln!(self.text, "#{key} = {}", self.reference.value(key, schema)),
            };
        }
    }

    fn section(&mut self, section: &str, set: Option<&Value>) {
        let schema = self.reference.resolved(&self.reference.properties[section]).clone();
        let properties = schema["properties"].as_object().cloned().unwrap_or_default();
        let tables: Vec<Table> = match set {
            Some(Value::Array(tables)) => tables.iter().filter_map(Value::as_table).cloned().collect(),
            Some(Value::Table(table)) => vec![table.clone()],
            _ if self.minimal => return,
            _ => vec![Table::new()],
        };
        let head = if section == "goal" { "[[goal]]" } else { &format!("[{section}]") };
        for (i, table) in tables.iter().enumerate() {
            self.text.push('\n');
            if !self.minimal && i == 0 {
                self.comment(schema["description"].as_str().unwrap_or_default());
            }
            let _ = writeln!(self.text, "{head}");
            // Further goals repeat only what they set.
            let minimal = self.minimal;
            self.minimal |= i > 0;
            self.keys(&properties, table, |_| true);
            self.minimal = minimal;
        }
    }

    /// Writes the faults that are set, and one of each other kind commented out.
    fn faults(&mut self, set: Option<&Value>) {
        for fault in set.and_then(Value::as_array).into_iter().flatten().filter_map(Value::as_table) {
            self.text.push_str("\n[[fault]]\n");
            for (key, value) in fault {
                let _ = writeln!(self.text, "{key} = {value}");
            }
        }
        if self.minimal {
            return;
        }
        let kinds = self.reference.resolved(&self.reference.properties["fault"])["oneOf"].clone();
        let kinds = kinds.as_array().cloned().unwrap_or_default();
        self.text.push('\n');
        self.comment(&format!(
            "Faults, as many as you like; there are {}.",
            many(kinds.len() as u64, "kind")
        ));
        for kind in kinds {
            let schema = self.reference.resolved(&kind).clone();
            self.text.push('\n');
            self.comment(schema["description"].as_str().unwrap_or_default());
            self.text.push_str("#[[fault]]\n");
            let properties = schema["properties"].as_object().cloned().unwrap_or_default();
            self.keys(&properties, &Table::new(), |_| true);
        }
    }
}
