//! Packs a scenario: its text, and behind it as `[[file]]` every file that it names and does not have yet.

use super::error::MAX_BYTES;
use super::json::is_json;
use super::packed_files::is_packed;
use super::{Plan, family::Families, read_text};
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use metamorph_text::escape::{Shown, is_control};
use metamorph_text::format::bytes;
use serde_json::json;
use std::collections::BTreeMap;
use std::io;
use thiserror::Error;

/// Columns of a line of Base64.
const COLUMNS: usize = 76;

/// The reason why a scenario cannot be packed.
#[derive(Debug, Error)]
pub enum PackError {
    /// A file cannot be read.
    #[error("{}: the file cannot be packed: {error}\n  fix: make it readable, or name another file in the scenario", .name.shown())]
    Read {
        /// Its name in the scenario.
        name: String,
        /// The cause.
        error: io::Error,
    },
    /// The packed scenario is too large to be read.
    #[error(
        "{} makes the packed scenario larger than {} MiB: it has {}\n  fix: make the file smaller, or copy it beside the scenario on each machine",
        .name.shown(), MAX_BYTES >> 20, bytes(*.length)
    )]
    TooLarge {
        /// The name of the largest file in the scenario.
        name: String,
        /// Its length in bytes.
        length: u64,
    },
    /// The scenario has the key `file` in a form to which nothing can be added.
    #[error(
        "the scenario has some of its files, and the others cannot be added: {0}\n  fix: write those that it has as [[file]] at the end, or leave them out"
    )]
    Mixed(String),
}

/// Returns the text of a scenario together with all files that it names. It makes the same runs as the scenario.
///
/// # Errors
/// A file cannot be packed.
pub fn packed(families: Families, plan: &Plan) -> Result<String, PackError> {
    let mut files: BTreeMap<&str, Vec<u8>> = BTreeMap::new();
    for (name, path) in plan.names.iter().zip(&plan.files).filter(|(_, path)| !is_packed(path)) {
        let read = families.sources.read(path, MAX_BYTES);
        files.insert(name, read.map_err(|error| PackError::Read { name: name.clone(), error })?);
    }
    if files.is_empty() {
        return Ok(plan.text.to_string());
    }
    let text = if is_json(&plan.text) { in_json(&plan.text, &files) } else { in_toml(&plan.text, &files) };
    if text.len() as u64 > MAX_BYTES {
        let largest = files.iter().max_by_key(|(_, content)| content.len());
        let (name, length) = largest.map_or(("", 0), |(name, content)| (*name, content.len() as u64));
        return Err(PackError::TooLarge { name: name.to_owned(), length });
    }
    // The options of the plan are not part of the text.
    let again = read_text(families, &plan.origin, &text, &plan.overrides);
    let again = again.map_err(|diagnostics| PackError::Mixed(diagnostics.to_string()))?;
    match again.names.iter().zip(&again.files).find(|(_, path)| !is_packed(path)) {
        Some((name, _)) => Err(PackError::Mixed(format!("{} is not among them", name.shown()))),
        None => Ok(text),
    }
}

/// Returns the content as text, if a scenario can hold it as it is.
fn as_text(content: &[u8]) -> Option<&str> {
    let is_plain = |c: char| matches!(c, '\n' | '\t') || !is_control(c);
    std::str::from_utf8(content).ok().filter(|text| text.chars().all(is_plain))
}

fn in_toml(text: &str, files: &BTreeMap<&str, Vec<u8>>) -> String {
    let mut packed = text.to_owned();
    if !packed.ends_with('\n') {
        packed.push('\n');
    }
    for (name, content) in files {
        // The escapes of JSON are escapes of TOML as well.
        packed += &format!("\n[[file]]\nname = {}\n", json!(name));
        let text = as_text(content).filter(|text| !text.contains("'''") && !text.ends_with('\''));
        match text {
            // A line end behind the opening quotes does not count.
            Some(text) => packed += &format!("text = '''\n{text}'''\n"),
            None => {
                let encoded = STANDARD.encode(content);
                let lines: Vec<&str> = encoded
                    .as_bytes()
                    .chunks(COLUMNS)
                    .filter_map(|line| std::str::from_utf8(line).ok())
                    .collect();
                packed += &format!("base64 = '''\n{}'''\n", lines.join("\n"));
            }
        }
    }
    packed
}

fn in_json(text: &str, files: &BTreeMap<&str, Vec<u8>>) -> String {
    let one = |(name, content): (&&str, &Vec<u8>)| match as_text(content) {
        Some(text) => json!({ "name": name, "text": text }),
        None => json!({ "name": name, "base64": STANDARD.encode(content) }),
    };
    let all = json!(files.iter().map(one).collect::<Vec<_>>());
    let object = text.trim_end();
    let object = object.strip_suffix('}').unwrap_or(object).trim_end();
    format!("{object},\n  \"file\": {all:#}\n}}\n")
}
