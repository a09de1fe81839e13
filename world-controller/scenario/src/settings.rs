//! Values that the command line puts into a scenario: `--set link.loss=5%` and the variations of a sweep.
//! They are inserted before the document is read, so that they are checked like lines of the file; errors are
//! reported with the option.

use super::diagnostics::Diagnostics;
use super::error::ScenarioError;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::fmt;
use std::ops::Range;
use thiserror::Error;
use toml::Spanned;
use toml::de::{DeArray, DeTable, DeValue};

/// Largest number of parts of a key.
const MAX_PARTS: usize = 32;

/// One value for one key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Setting {
    /// The option it was given with, for errors. Deserialized values count as typed.
    #[serde(skip, default = "set")]
    pub option: &'static str,
    /// `KEY=VALUE`. A key consists of names joined by dots; elements of a list are numbered from 0. A value
    /// is TOML, or unquoted text.
    pub text: String,
}

fn set() -> &'static str {
    "--set"
}

impl Setting {
    fn parts(&self) -> Result<(&str, &str), ScenarioError> {
        let parts = self.text.split_once('=').map(|(key, value)| (key.trim(), value.trim()));
        parts.ok_or_else(|| ScenarioError::Form(self.text.clone(), "KEY=VALUE"))
    }
}

impl fmt::Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", self.option, self.text)
    }
}

/// Why a key is invalid.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum KeyError {
    /// A part is empty, as in `link..loss`.
    #[error("the key `{0}` has an empty part")]
    EmptyPart(String),
    /// Nested more deeply than any scenario.
    #[error("the key has {0} parts; {MAX_PARTS} is the maximum")]
    TooDeep(usize),
    /// A list has no such element.
    #[error("`{list}` has no element {element}; it has {len}, numbered from 0")]
    NoElement {
        /// The list.
        list: String,
        /// The element.
        element: String,
        /// The length of the list.
        len: usize,
    },
    /// The parent of the key is neither a table nor a list.
    #[error("`{0}` is neither a table nor a list, so nothing can be set in it")]
    NoTable(String),
}

impl KeyError {
    /// Returns what to do about it.
    pub fn fix(&self) -> String {
        match self {
            KeyError::EmptyPart(_) => "join the names of tables and keys by dots, such as `link.loss`".into(),
            KeyError::TooDeep(_) => "set a table further up as a whole".into(),
            KeyError::NoElement { list, len: 0, .. } => format!("add a [[{list}]] to the scenario first"),
            KeyError::NoElement { list, len, .. } => {
                format!(
                    "write `{list}.0`{}",
                    if *len > 1 { format!(" to `{list}.{}`", len - 1) } else { String::new() }
                )
            }
            KeyError::NoTable(key) => format!("set `{key}` as a whole"),
        }
    }
}

/// Inserts all settings into the document. As their places they get offsets past the end of the text, which
/// diagnostics show as the options.
pub fn apply<'i>(
    document: &mut DeTable<'i>,
    settings: &'i [Setting],
    text: &str,
    diagnostics: &mut Diagnostics,
) {
    for (i, setting) in settings.iter().enumerate() {
        let at = text.len() + 1 + i;
        let place = diagnostics.option_at(at, setting.to_string());
        let Some((key, text)) = diagnostics.note(&place, setting.parts()) else { continue };
        let Some(value) = diagnostics.note(&place, value(text)) else { continue };
        diagnostics.note(&place, put(document, key, moved(value, &(at..at))));
    }
}

/// Parses a value as TOML. Other text is taken as a string, so that shells need no nested quotes, unless it
/// begins like a list, a table or a quoted string.
fn value(text: &str) -> Result<DeValue<'_>, ScenarioError> {
    match DeValue::parse(text) {
        Ok(value) => Ok(value.into_inner()),
        Err(error) if text.starts_with(['[', '{', '"', '\'']) => {
            Err(ScenarioError::Syntax(error.message().to_owned()))
        }
        Err(_) => Ok(DeValue::String(Cow::Borrowed(text))),
    }
}

/// Assigns a place to a value and everything in it.
fn moved<'i>(value: DeValue<'i>, at: &Range<usize>) -> Spanned<DeValue<'i>> {
    let value = match value {
        DeValue::Array(array) => {
            DeValue::Array(array.into_iter().map(|element| moved(element.into_inner(), at)).collect())
        }
        DeValue::Table(table) => DeValue::Table(
            table
                .into_iter()
                .map(|(key, value)| {
                    (Spanned::new(at.clone(), key.into_inner()), moved(value.into_inner(), at))
                })
                .collect(),
        ),
        plain => plain,
    };
    Spanned::new(at.clone(), value)
}

fn put<'i>(table: &mut DeTable<'i>, key: &'i str, value: Spanned<DeValue<'i>>) -> Result<(), KeyError> {
    let parts = key.split('.').count();
    if parts > MAX_PARTS {
        return Err(KeyError::TooDeep(parts));
    }
    let (part, rest) = split(key, key)?;
    put_in_table(table, key, part, rest, value)
}

fn split<'k>(whole: &str, key: &'k str) -> Result<(&'k str, Option<&'k str>), KeyError> {
    let (part, rest) = key.split_once('.').map_or((key, None), |(part, rest)| (part, Some(rest)));
    if part.is_empty() { Err(KeyError::EmptyPart(whole.to_owned())) } else { Ok((part, rest)) }
}

fn put_in_table<'i>(
    table: &mut DeTable<'i>,
    whole: &'i str,
    part: &'i str,
    rest: Option<&'i str>,
    value: Spanned<DeValue<'i>>,
) -> Result<(), KeyError> {
    let at = value.span();
    let name = || Spanned::new(at.clone(), Cow::Borrowed(part));
    let Some(rest) = rest else {
        table.insert(name(), value);
        return Ok(());
    };
    let node =
        table.entry(name()).or_insert_with(|| Spanned::new(at.clone(), DeValue::Table(DeTable::new())));
    put_in_node(node, whole, rest, value)
}

fn put_in_node<'i>(
    node: &mut Spanned<DeValue<'i>>,
    whole: &'i str,
    key: &'i str,
    value: Spanned<DeValue<'i>>,
) -> Result<(), KeyError> {
    let (part, rest) = split(whole, key)?;
    // Invariant: `key` is a tail of `whole` that begins after a dot.
    let so_far = &whole[..whole.len() - key.len() - 1];
    match node.get_mut() {
        DeValue::Table(table) => put_in_table(table, whole, part, rest, value),
        DeValue::Array(array) => {
            let len = array.len();
            let element = element(array, part).ok_or_else(|| KeyError::NoElement {
                list: so_far.to_owned(),
                element: part.to_owned(),
                len,
            })?;
            match rest {
                Some(rest) => put_in_node(element, whole, rest, value),
                None => {
                    *element = value;
                    Ok(())
                }
            }
        }
        _ => Err(KeyError::NoTable(so_far.to_owned())),
    }
}

fn element<'a, 'i>(array: &'a mut DeArray<'i>, part: &str) -> Option<&'a mut Spanned<DeValue<'i>>> {
    array.get_mut(part.parse::<usize>().ok()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = "version = 1\n[[goal]]\nseed = [1, 2, 3]\n[link]\nloss = \"1%\"\n";

    /// Returns a document with these settings, and its problems.
    fn with(settings: &[&str]) -> (toml::Table, String) {
        let settings: Vec<Setting> =
            settings.iter().map(|text| Setting { option: "--set", text: (*text).into() }).collect();
        let mut diagnostics = Diagnostics::new(crate::family::Families::NONE, "a.toml", TEXT);
        let mut document = DeTable::parse(TEXT).unwrap();
        apply(document.get_mut(), &settings, TEXT, &mut diagnostics);
        let table = toml::Table::try_from(plain(document.get_ref())).unwrap();
        (table, diagnostics.to_string())
    }

    fn plain(table: &DeTable<'_>) -> toml::Table {
        fn value(v: &DeValue<'_>) -> toml::Value {
            match v {
                DeValue::String(s) => toml::Value::String(s.to_string()),
                DeValue::Integer(n) => toml::Value::Integer(n.as_str().parse().unwrap()),
                DeValue::Float(n) => toml::Value::Float(n.as_str().parse().unwrap()),
                DeValue::Boolean(b) => toml::Value::Boolean(*b),
                DeValue::Datetime(d) => toml::Value::Datetime(*d),
                DeValue::Array(a) => toml::Value::Array(a.iter().map(|v| value(v.get_ref())).collect()),
                DeValue::Table(t) => toml::Value::Table(plain(t)),
            }
        }
        table.iter().map(|(k, v)| (k.get_ref().to_string(), value(v.get_ref()))).collect()
    }

    #[test]
    fn values_replace_and_join() {
        let (table, diagnostics) = with(&[
            "link.loss=5%",
            "link.duplicate=0.25",
            "stop.timeout = 10s",
            "goal.0.seed.1=-7",
            "goal.0.shape={ cells = [[0, 0, 0]] }",
            "seed=9",
            "name=\"5\"",
        ]);
        assert_eq!(diagnostics, "");
        let expected: toml::Table = toml::from_str(
            "version = 1\nseed = 9\nname = \"5\"\ngoal = [{ seed = [1, -7, 3], shape = { cells = [[0, 0, 0]] } }]\n\
             link = { loss = \"5%\", duplicate = 0.25 }\nstop = { timeout = \"10s\" }\n",
        )
        .unwrap();
        assert_eq!(table, expected);
    }

    #[test]
    fn what_leads_nowhere_is_named_with_its_option() {
        let deep = format!("{}=1", ["a"; 40].join("."));
        let cases: &[(&str, &[&str])] = &[
            (
                "goal.1.seed=1",
                &["--set goal.1.seed=1: `goal` has no element 1; it has 1", "fix: write `goal.0`"],
            ),
            ("goal.first.seed=1", &["`goal` has no element first", "fix: "]),
            ("goal.0.seed.3=1", &["`goal.0.seed` has no element 3", "to `goal.0.seed.2`"]),
            ("version.x=1", &["`version` is neither a table nor a list", "fix: set `version` as a whole"]),
            ("link..loss=1", &["`link..loss` has an empty part", "fix: "]),
            ("=1", &["an empty part", "fix: "]),
            (
                "link.loss",
                &["--set link.loss: `link.loss` is not of the form KEY=VALUE", "for example `link.loss=5%`"],
            ),
            (&deep, &["has 40 parts", "fix: "]),
            ("name=[1, 2", &["--set name=[1, 2: this is not TOML", "fix: "]),
        ];
        for (setting, parts) in cases {
            let (table, diagnostics) = with(&[setting]);
            for part in *parts {
                assert!(diagnostics.contains(part), "`{part}` is missing in: {diagnostics}");
            }
            assert_eq!(table["version"].as_integer(), Some(1));
        }
    }
}
