//! Reads one TOML table key by key: typed values with their places, and errors for unknown keys. Absent: what
//! the keys mean.

use super::diagnostics::{At, Diagnostics, Place};
use super::error::ScenarioError;
use super::family::SectionKind;
use metamorph_core::lattice::Cell;
use metamorph_core::ratio::Ratio;
use metamorph_core::time::{Span, SpanError};
use std::collections::BTreeSet;
use toml::Spanned;
use toml::de::{DeArray, DeTable, DeValue};

/// A TOML value with its place.
pub type Node<'i> = Spanned<DeValue<'i>>;

/// A table being read.
pub struct Section<'d, 'i> {
    table: &'d DeTable<'i>,
    name: String,
    place: Place,
    asked: Vec<&'static str>,
    /// The section, if its keys differ between families.
    kind: Option<SectionKind>,
}

impl<'d, 'i> Section<'d, 'i> {
    /// Starts reading a table; `name` names it in messages.
    pub fn new(table: &'d DeTable<'i>, name: &str, place: impl Into<Place>) -> Section<'d, 'i> {
        Section { table, name: name.to_owned(), place: place.into(), asked: Vec::new(), kind: None }
    }

    /// Starts reading a value that must be a table.
    pub fn of(
        node: &'d Node<'i>,
        name: &str,
        example: &'static str,
        diagnostics: &mut Diagnostics,
    ) -> Option<Section<'d, 'i>> {
        match node.get_ref() {
            DeValue::Table(table) => Some(Section::new(table, name, node.span())),
            other => {
                diagnostics.add(node.span(), wrong("a table", other, example));
                None
            }
        }
    }

    /// Sets the section, so that keys of other families are reported as such.
    pub fn differs_between_families(&mut self, kind: SectionKind) {
        self.kind = Some(kind);
    }

    /// Returns the place of the table.
    pub fn place(&self) -> &Place {
        &self.place
    }

    /// Returns the value of a key with its place.
    pub fn node(&mut self, key: &'static str) -> Option<&'d Node<'i>> {
        self.asked.push(key);
        self.table.get(key)
    }

    /// Returns `former` if the table has that key but not `key`, and `key` otherwise.
    pub fn key_or_former(&self, key: &'static str, former: &'static str) -> &'static str {
        if self.table.get(key).is_none() && self.table.get(former).is_some() { former } else { key }
    }

    /// Returns a typed value of a key, if it is present and valid.
    pub fn get<T: Read>(&mut self, key: &'static str, diagnostics: &mut Diagnostics) -> Option<At<T>> {
        let node = self.node(key)?;
        T::read(node, diagnostics).map(|value| At::new(value, node.span()))
    }

    /// Like [`Section::get`], but reports a missing key.
    pub fn need<T: Read>(
        &mut self,
        key: &'static str,
        example: &'static str,
        diagnostics: &mut Diagnostics,
    ) -> Option<At<T>> {
        if self.table.get(key).is_none() {
            self.missing(key, example, diagnostics);
        }
        self.get(key, diagnostics)
    }

    /// Reports a missing key.
    pub fn missing(&self, key: &'static str, example: &'static str, diagnostics: &mut Diagnostics) {
        diagnostics
            .add(self.place.clone(), ScenarioError::Missing { key, section: self.name.clone(), example });
    }

    /// Reads one of several names.
    pub fn choice<T: Copy>(
        &mut self,
        key: &'static str,
        what: &'static str,
        names: &[(&'static str, T)],
        diagnostics: &mut Diagnostics,
    ) -> Option<T> {
        self.choice_at(key, what, names, diagnostics).map(|chosen| chosen.value)
    }

    /// Like [`Section::choice`], with the place of the value.
    pub fn choice_at<T: Copy>(
        &mut self,
        key: &'static str,
        what: &'static str,
        names: &[(&'static str, T)],
        diagnostics: &mut Diagnostics,
    ) -> Option<At<T>> {
        let At { value: got, place } = self.get::<String>(key, diagnostics)?;
        let found = names.iter().find(|(name, _)| *name == got).map(|(_, value)| *value);
        if found.is_none() {
            let known = names.iter().map(|(name, _)| *name).collect();
            diagnostics.add(place.clone(), ScenarioError::Name { what, got, known });
        }
        found.map(|value| At { value, place })
    }

    /// Returns those of `keys` that the table has.
    pub fn present(&self, keys: &[&'static str]) -> Vec<&'static str> {
        keys.iter().copied().filter(|k| self.table.get(*k).is_some()).collect()
    }

    /// Reports every key that was not read. Returns true if one of them is for another family.
    pub fn finish(self, diagnostics: &mut Diagnostics) -> bool {
        self.finish_with(diagnostics, |_| None)
    }

    /// Like [`Section::finish`]; `elsewhere` returns where a key belongs that is unknown here.
    pub fn finish_with(
        self,
        diagnostics: &mut Diagnostics,
        elsewhere: impl Fn(&str) -> Option<String>,
    ) -> bool {
        let mut is_foreign = false;
        let known: BTreeSet<&str> = self.asked.iter().copied().collect();
        for (key, _) in self.table.iter().filter(|(key, _)| !known.contains(key.get_ref().as_ref())) {
            let mut names = self.asked.clone();
            names.dedup();
            let key_text: String = key.get_ref().chars().take(80).collect();
            let section = self.name.clone();
            let scenario_error = match self.kind.and_then(|kind| diagnostics.owner_of(kind, &key_text)) {
                Some(theirs) => {
                    is_foreign = true;
                    ScenarioError::Foreign { key: key_text, section, theirs, ours: diagnostics.family() }
                }
                None => {
                    let elsewhere = elsewhere(&key_text);
                    ScenarioError::UnknownKey { key: key_text, section, known: names, elsewhere }
                }
            };
            diagnostics.add(key.span(), scenario_error);
        }
        is_foreign
    }
}

/// Returns the name that equals leaving the key out.
pub fn default_of<T: Default + PartialEq>(names: &[(&'static str, T)]) -> &'static str {
    let default = names.iter().find(|(_, value)| *value == T::default());
    default.expect("invariant: a table of names has the default, as a test of the schema asks of each").0
}

/// Returns the elements of a value that must be an array.
pub fn elements<'d, 'i>(
    node: &'d Node<'i>,
    example: &'static str,
    diagnostics: &mut Diagnostics,
) -> Option<&'d DeArray<'i>> {
    match node.get_ref() {
        DeValue::Array(array) => Some(array),
        other => {
            diagnostics.add(node.span(), wrong("a list", other, example));
            None
        }
    }
}

/// Returns the error for a value of the wrong kind.
pub fn wrong(expected: &'static str, found: &DeValue<'_>, example: &'static str) -> ScenarioError {
    let found = match found {
        DeValue::String(_) => "text",
        DeValue::Integer(_) => "a whole number",
        DeValue::Float(_) => "a number",
        DeValue::Boolean(_) => "true or false",
        DeValue::Datetime(_) => "a date",
        DeValue::Array(_) => "a list",
        DeValue::Table(_) => "a table",
    };
    ScenarioError::Kind { expected, found, example }
}

/// A type that can be written in a scenario.
pub trait Read: Sized {
    /// Reads a value, or reports what is wrong with it.
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Self>;
}

/// Returns a whole number as an `i64`, or its text if it does not fit; `None` for a value of another kind.
fn integer(node: &Node<'_>) -> Option<Result<i64, String>> {
    let DeValue::Integer(n) = node.get_ref() else { return None };
    Some(i64::from_str_radix(n.as_str(), n.radix()).map_err(|_| n.to_string()))
}

fn whole(
    node: &Node<'_>,
    what: &'static str,
    range: std::ops::RangeInclusive<i64>,
    example: &'static str,
    diagnostics: &mut Diagnostics,
) -> Option<i64> {
    let read = integer(node);
    match read {
        None => diagnostics.add(node.span(), wrong("a whole number", node.get_ref(), example)),
        Some(Ok(n)) if range.contains(&n) => return Some(n),
        Some(n) => diagnostics.add(
            node.span(),
            ScenarioError::Range {
                what,
                got: n.map_or_else(|text| text, |n| n.to_string()),
                low: range.start().to_string(),
                high: range.end().to_string(),
            },
        ),
    }
    None
}

impl Read for String {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<String> {
        match node.get_ref() {
            DeValue::String(text) => Some(text.clone().into_owned()),
            other => {
                diagnostics.add(node.span(), wrong("text in quotes", other, "\"like this\""));
                None
            }
        }
    }
}

impl Read for bool {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<bool> {
        match node.get_ref() {
            DeValue::Boolean(value) => Some(*value),
            other => {
                diagnostics.add(node.span(), wrong("true or false", other, "true"));
                None
            }
        }
    }
}

impl Read for i64 {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<i64> {
        whole(node, "the number", i64::MIN..=i64::MAX, "1", diagnostics)
    }
}

impl Read for u64 {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<u64> {
        whole(node, "the number", 0..=i64::MAX, "1", diagnostics).map(i64::unsigned_abs)
    }
}

impl Read for f64 {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<f64> {
        let text = match node.get_ref() {
            DeValue::Integer(n) if n.radix() == 10 => n.as_str(),
            DeValue::Float(n) => n.as_str(),
            other => {
                diagnostics.add(node.span(), wrong("a number", other, "2.5"));
                return None;
            }
        };
        match text.parse::<f64>() {
            Ok(n) if n.is_finite() => Some(n),
            _ => {
                let (low, high) = (f64::MIN.to_string(), f64::MAX.to_string());
                diagnostics.add(
                    node.span(),
                    ScenarioError::Range { what: "the number", got: text.into(), low, high },
                );
                None
            }
        }
    }
}

/// Parses a time from text of any length.
pub fn span(text: &str) -> Result<Span, SpanError> {
    // No sensible time is longer.
    if text.len() > 32 {
        return Err(SpanError::TooLong(text.chars().take(32).chain(['…']).collect()));
    }
    text.parse()
}

/// Parses two times `a..b`.
pub fn span_range(text: &str) -> Result<(Span, Span), ScenarioError> {
    let (from, until) = text.split_once("..").ok_or_else(|| ScenarioError::Form(text.into(), "T..T"))?;
    Ok((span(from)?, span(until)?))
}

/// Parses one time or two.
pub fn delay(text: &str) -> Result<(Span, Span), ScenarioError> {
    if text.contains("..") {
        let (min, max) = span_range(text)?;
        return if min > max { Err(ScenarioError::Order { from: min, until: max }) } else { Ok((min, max)) };
    }
    Ok((span(text)?, span(text)?))
}

fn time_text<'d>(
    node: &'d Node<'_>,
    example: &'static str,
    diagnostics: &mut Diagnostics,
) -> Option<&'d str> {
    match node.get_ref() {
        DeValue::String(text) => Some(text),
        // A number without a unit is the most likely mistake: report the unit.
        DeValue::Integer(n) => {
            let n = n.as_str();
            let error =
                if n.starts_with('-') { SpanError::Negative(n.into()) } else { SpanError::Unit(n.into()) };
            diagnostics.add(node.span(), error);
            None
        }
        DeValue::Float(n) => {
            let n = n.as_str();
            let error =
                if n.starts_with('-') { SpanError::Negative(n.into()) } else { SpanError::Unit(n.into()) };
            diagnostics.add(node.span(), error);
            None
        }
        other => {
            diagnostics.add(node.span(), wrong("a time", other, example));
            None
        }
    }
}

impl Read for Span {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Span> {
        let text = time_text(node, "\"1.5s\"", diagnostics)?;
        diagnostics.note(&node.span().into(), span(text))
    }
}

/// Two times, the first not later than the second: `10ms..100ms`, or one time for both.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Delay(pub Span, pub Span);

impl Read for Delay {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Delay> {
        let text = time_text(node, "\"10ms..100ms\"", diagnostics)?;
        diagnostics.note(&node.span().into(), delay(text)).map(|(min, max)| Delay(min, max))
    }
}

/// An interval: `0s..60s`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Window(pub Span, pub Span);

impl Read for Window {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Window> {
        let text = time_text(node, "\"0s..60s\"", diagnostics)?;
        diagnostics.note(&node.span().into(), span_range(text)).map(|(from, until)| Window(from, until))
    }
}

impl Read for Ratio {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Ratio> {
        // The digits as written are exact; a float would round them.
        let text = match node.get_ref() {
            DeValue::String(text) => text.as_ref(),
            DeValue::Integer(n) if n.radix() == 10 => n.as_str(),
            DeValue::Float(n) => n.as_str(),
            other => {
                diagnostics.add(node.span(), wrong("a probability", other, "\"5%\""));
                return None;
            }
        };
        diagnostics.note(&node.span().into(), text.parse())
    }
}

fn coordinates<const N: usize>(
    node: &Node<'_>,
    expected: &'static str,
    example: &'static str,
    diagnostics: &mut Diagnostics,
) -> Option<[i16; N]> {
    let DeValue::Array(array) = node.get_ref() else {
        diagnostics.add(node.span(), wrong(expected, node.get_ref(), example));
        return None;
    };
    if array.len() != N {
        diagnostics
            .add(node.span(), ScenarioError::Kind { expected, found: "a list of another length", example });
        return None;
    }
    let limit = i64::from(Cell::LIMIT);
    let mut coordinates = [0; N];
    for (axis, element) in coordinates.iter_mut().zip(array.iter()) {
        *axis = whole(element, "the coordinate", -limit..=limit, example, diagnostics)? as i16;
    }
    Some(coordinates)
}

impl Read for Cell {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Cell> {
        coordinates(node, "the three coordinates of a cell", "[0, 0, 0]", diagnostics).map(Cell::from)
    }
}

/// A connector of the floor, by the two coordinates of its cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Connector(pub i16, pub i16);

impl Read for Connector {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Connector> {
        let [x, y] = coordinates(node, "the two coordinates of a connector", "[0, 0]", diagnostics)?;
        Some(Connector(x, y))
    }
}
