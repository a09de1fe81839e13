//! Two reports, field by field.

use super::{Comparison, DiffError, SCHEMA};
use metamorph_module_agent::regular_file;
use metamorph_report::schema::{Report, SCHEMA as REPORT};
use metamorph_text::escape::Shown;
use metamorph_text::format::many;
use metamorph_text::paint::Paint;
use metamorph_text::table::Table;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// Bytes of a report at most.
const LONGEST: u64 = 256 << 20;
/// Largest number of differences listed; the rest is counted.
const SHOWN_MAX: usize = 60;
/// Fields about the machine and the moment of the run, in which equal runs differ.
const OF_THE_MACHINE: [&str; 4] = ["time.wall", "time.setup", "repeat", "logs"];

fn read(path: &Path) -> Result<Value, DiffError> {
    let wrong = |reason: String| DiffError::Report { path: path.to_owned(), reason };
    let bytes =
        regular_file::read(path, LONGEST).map_err(|error| wrong(format!("cannot read it: {error}")))?;
    let value: Value =
        serde_json::from_slice(&bytes).map_err(|error| wrong(format!("this is not JSON: {error}")))?;
    match value.get("schema").and_then(Value::as_u64) {
        Some(found) if found == u64::from(REPORT) => {}
        Some(found) => {
            return Err(wrong(format!("the report has schema {found}; this program reads {REPORT}")));
        }
        None => return Err(wrong("this is not a report".to_owned())),
    }
    serde_json::from_value::<Report>(value.clone())
        .map_err(|error| wrong(format!("this is not a report: {error}")))?;
    Ok(value)
}

/// Lists the fields of a value by their paths.
fn flatten(value: &Value, path: &str, fields: &mut BTreeMap<String, Value>) {
    let below = |key: &str| if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
    match value {
        Value::Object(object) if !object.is_empty() => {
            object.iter().for_each(|(key, value)| flatten(value, &below(key), fields));
        }
        Value::Array(list) if !list.is_empty() => {
            list.iter().enumerate().for_each(|(i, value)| flatten(value, &below(&i.to_string()), fields));
        }
        other => drop(fields.insert(path.to_owned(), other.clone())),
    }
}

/// Returns the fields in which two values differ.
fn differences(a: &Value, b: &Value) -> Vec<(String, Value, Value)> {
    let (mut of_a, mut of_b) = (BTreeMap::new(), BTreeMap::new());
    flatten(a, "", &mut of_a);
    flatten(b, "", &mut of_b);
    let mut keys: Vec<&String> = of_a.keys().chain(of_b.keys()).collect();
    keys.sort();
    keys.dedup();
    let get =
        |fields: &BTreeMap<String, Value>, key: &String| fields.get(key).cloned().unwrap_or(Value::Null);
    keys.into_iter()
        .map(|key| (key.clone(), get(&of_a, key), get(&of_b, key)))
        .filter(|(key, a, b)| a != b && !OF_THE_MACHINE.iter().any(|prefix| key.starts_with(prefix)))
        .collect()
}

fn shown(value: &Value) -> String {
    match value {
        Value::Null => "–".to_owned(),
        Value::String(text) => text.shown(),
        other => other.to_string().shown(),
    }
}

/// Compares two reports.
pub fn compare(a: &Path, b: &Path, paint: Paint) -> Result<Comparison, DiffError> {
    let (first, second) = (read(a)?, read(b)?);
    let hash = |report: &Value| report.get("trace_hash").and_then(Value::as_str).map(str::to_owned);
    let same = hash(&first).is_some() && hash(&first) == hash(&second);
    let differences = differences(&first, &second);
    let mut table = Table::new(&["field"]);
    table.head(&["A", "B", "B − A"]);
    for (field, a, b) in differences.iter().take(SHOWN_MAX) {
        let by = match (a.as_f64(), b.as_f64()) {
            (Some(a), Some(b)) => format!("{:+}", ((b - a) * 1e6).round() / 1e6),
            _ => String::new(),
        };
        table.whole_row(&[field.shown()], vec![shown(a), shown(b), by]);
    }
    let mut text = format!("A  {}\nB  {}\n", a.shown(), b.shown());
    if same {
        text.push_str("the same run: the trace hashes are equal\n");
    }
    if !differences.is_empty() {
        text.push_str(&format!("\n{}", table.text(paint)));
    } else if !same {
        text.push_str("no field differs\n");
    }
    if differences.len() > SHOWN_MAX {
        let more = many((differences.len() - SHOWN_MAX) as u64, "field");
        text.push_str(&format!("  … and {more}; --json lists all\n"));
    }
    let list: Vec<Value> =
        differences.iter().map(|(field, a, b)| json!({ "field": field, "a": a, "b": b })).collect();
    let json = json!({ "schema": SCHEMA, "kind": "reports", "same_run": same, "differences": list });
    Ok(Comparison { text, json, plot: None })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_are_compared_by_their_paths() {
        let a =
            json!({ "moves": 3, "time": { "wall_s": 1.0, "virtual_s": 2.0 }, "faults": [1, 2], "x": null });
        let b = json!({ "moves": 5, "time": { "wall_s": 9.0, "virtual_s": 2.0 }, "faults": [1], "x": [] });
        let found = differences(&a, &b);
        let fields: Vec<&str> = found.iter().map(|(field, ..)| field.as_str()).collect();
        assert_eq!(fields, ["faults.1", "moves", "x"]);
        assert_eq!((&found[1].1, &found[1].2), (&json!(3), &json!(5)));
        assert!(differences(&a, &a).is_empty());
    }
}
