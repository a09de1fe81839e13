//! Generated pages are current, and all links lead somewhere.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

#[cfg(feature = "book")]
mod book;

use metamorph_site::{crates, formats, generated, invariants, links, root};
use metamorph_world_controller::cli::reference::{Described, schema};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

fn markdown_below(directory: &Path, found: &mut BTreeSet<PathBuf>) {
    for entry in fs::read_dir(root().join(directory)).unwrap() {
        let path = directory.join(entry.unwrap().file_name());
        if root().join(&path).is_dir() {
            markdown_below(&path, found);
        } else if path.extension().is_some_and(|end| end == "md") {
            found.insert(path);
        }
    }
}

#[test]
fn generated_pages_are_current() {
    for (path, text) in generated().unwrap() {
        let kept = fs::read_to_string(root().join(&path)).unwrap_or_default();
        let differs = text.lines().zip(kept.lines()).find(|(new, old)| new != old);
        assert!(
            kept == text,
            "{} is old, (new, old) line: {differs:?}; run `cargo run -p metamorph-site -- generate`",
            path.display()
        );
    }
}

/// Returns the lines of all sources that a test selects, with their files, without comments.
fn lines_of_sources(is_wanted: impl Fn(&str) -> bool) -> Vec<String> {
    let mut found = Vec::new();
    for one in crates::all(&root()).unwrap() {
        for (path, text) in crates::sources(&root(), &one, "src").unwrap() {
            let lines = text.lines().map(str::trim).filter(|line| !line.starts_with("//") && is_wanted(line));
            found.extend(lines.map(|line| format!("{}: {line}", path.display())));
        }
    }
    found
}

#[test]
fn every_version_of_a_format_is_listed() {
    let declared = lines_of_sources(|line| {
        let name = line.trim_start_matches("pub ").trim_start_matches("pub(crate) ");
        ["const VERSION: u", "const SCHEMA: u"].iter().any(|begin| name.starts_with(begin))
    });
    assert_eq!(
        declared.len(),
        formats::all().len(),
        "deploy/site/src/formats.rs does not list the formats of these constants: {declared:#?}"
    );
}

/// Invariants are found by the form of their declaration, so there must be no other form.
#[test]
fn every_invariant_is_listed_checked_and_tested() {
    let all = invariants::all(&root()).unwrap();
    let mut made = lines_of_sources(|line| {
        (line.contains("Invariant::new(\"") || line.contains("Invariant { name: \""))
            && !line.contains("OF_PROTOCOL")
    });
    // Of protocols that are no part of the program.
    made.retain(|line| !line.starts_with("deploy/tutorial/"));
    assert_eq!(made.len(), all.len(), "an invariant is not a `pub const` of one line: {made:#?}");
    let names: BTreeSet<&str> = all.iter().map(|one| one.name.as_str()).collect();
    assert_eq!(names.len(), all.len(), "two invariants have one name");
    for one in &all {
        assert!(!one.checked_in.is_empty(), "{} is not checked", one.name);
        assert!(one.is_tested, "{} has no test in which it fires", one.name);
    }
}

/// Every page in docs/ is on the site, once, and every picture of the gallery is drawn by the script.
#[test]
fn the_list_has_every_page() {
    let listed = links::pages(&root()).unwrap();
    let once: BTreeSet<PathBuf> = listed.iter().cloned().collect();
    assert_eq!(listed.len(), once.len(), "a page is listed twice: {listed:?}");
    let mut pages = BTreeSet::new();
    markdown_below(Path::new("docs"), &mut pages);
    pages.remove(Path::new("docs/SUMMARY.md"));
    let listed: BTreeSet<PathBuf> = once.into_iter().filter(|page| page.starts_with("docs")).collect();
    assert_eq!(listed, pages, "docs/SUMMARY.md does not list the pages of docs/");
}

#[test]
fn all_links_lead_somewhere() {
    let mut pages = BTreeSet::from(
        ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md"].map(PathBuf::from),
    );
    for directory in ["docs", "deploy"] {
        markdown_below(Path::new(directory), &mut pages);
    }
    pages.retain(|page| !page.components().any(|part| part.as_os_str().to_string_lossy().starts_with('.')));
    let dead: Vec<String> = pages
        .iter()
        .flat_map(|page| links::dead(&root(), page, &fs::read_to_string(root().join(page)).unwrap()))
        .collect();
    assert!(pages.len() > 25 && dead.is_empty(), "{dead:#?}");
}

/// Collects the properties of a schema by their keys.
fn properties<'a>(schema: &'a Value, found: &mut BTreeMap<&'a str, Vec<&'a Value>>) {
    for (name, value) in schema.as_object().into_iter().flatten() {
        let keys = value.as_object().filter(|_| name == "properties");
        keys.into_iter().flatten().for_each(|(key, value)| found.entry(key).or_default().push(value));
        properties(value, found);
    }
    schema.as_array().into_iter().flatten().for_each(|value| properties(value, found));
}

/// Returns the default that the comment behind a value states, if it is a value.
fn stated<'a>(value: &'a str, comment: &'a str) -> Option<&'a str> {
    if comment.contains("off by default") {
        return Some("false");
    }
    let is_literal = |word: &&str| word.starts_with(['"', '0', '1', '2', '3', '4', '5', '6', '7', '8', '9']);
    if let Some((before, _)) = comment.split_once(" by default") {
        return before
            .split_whitespace()
            .last()
            .filter(|word| is_literal(word) || ["true", "false"].contains(word));
    }
    let (_, after) = comment.split_once("default")?;
    let after = after.trim_start_matches([':', ' ']).trim_start_matches("is ");
    match after.split([',', ';', ' ']).next().filter(is_literal) {
        Some(literal) => Some(literal),
        None => comment.contains("the default").then_some(value),
    }
}

/// The examples of scenarios in documents say the defaults that the reader uses.
#[test]
fn stated_defaults_are_those_of_the_schema() {
    let schema: Value = serde_json::from_str(&schema(Described::Scenario)).unwrap();
    let mut keys = BTreeMap::new();
    properties(&schema, &mut keys);
    // Blocks with other tables are no scenarios.
    let is_scenario = |block: &&str| {
        let tables =
            block.lines().filter_map(|line| line.strip_prefix('[')).map(|line| line.trim_start_matches('['));
        tables
            .filter_map(|line| line.split(['.', ']']).next())
            .all(|table| !schema["properties"][table].is_null())
    };
    let mut checked = Vec::new();
    for page in links::pages(&root()).unwrap() {
        let text = fs::read_to_string(root().join(&page)).unwrap();
        let blocks = text.split("```toml\n").skip(1).filter_map(|rest| rest.split("```").next());
        for line in blocks.filter(is_scenario).flat_map(str::lines) {
            let line = line.trim_start_matches("# ");
            let Some((key, (value, comment))) =
                line.split_once(" = ").and_then(|(key, rest)| Some((key, rest.split_once(" #")?)))
            else {
                continue;
            };
            let (Some(schemas), Some(stated)) = (keys.get(key), stated(value.trim(), comment)) else {
                continue;
            };
            // Times are written without quotation marks in comments.
            let stated = toml::from_str::<Value>(&format!("x = {stated}"))
                .map_or_else(|_| Value::from(stated), |table| table["x"].clone());
            let text = stated.as_str().map_or_else(|| stated.to_string(), str::to_owned);
            let is_default = |schema: &&Value| match &schema["default"] {
                Value::Null => {
                    let meaning = schema["description"].as_str().unwrap_or_default();
                    [format!("Default: {text}"), format!("`{text}`, the default")]
                        .iter()
                        .any(|said| meaning.contains(said))
                }
                default => *default == stated,
            };
            assert!(schemas.iter().any(is_default), "{}: `{line}`: {schemas:#?}", page.display());
            checked.push(key.to_owned());
        }
    }
    assert!(checked.len() > 5, "{checked:?}");
}
