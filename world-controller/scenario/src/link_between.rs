//! `[[link.between]]`: links of their own between some modules.

use super::definitions::{Definitions, of, said, table};
use super::diagnostics::{At, Diagnostics};
use super::error::ScenarioError;
use super::hosts::rates;
use super::raw::RawLink;
use super::table::{Node, Read, Section, elements, wrong};
use metamorph_core::ids::ModuleId;
use metamorph_core::link::{Between, End, LinkModel};
use metamorph_core::time::{Span, Time};
use serde_json::json;
use toml::de::DeValue;

/// Largest number of links of their own.
const MAX_BETWEEN: usize = 256;
const MODULES: &str = "modules = [3, 4]";

/// An end as written: a module, some, or any.
#[derive(Clone, Debug)]
struct RawEnd(Vec<At<u64>>);

impl Read for RawEnd {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<RawEnd> {
        let module = |node: &Node<'_>, diagnostics: &mut Diagnostics| {
            Some(At { value: u64::read(node, diagnostics)?, place: node.span().into() })
        };
        match node.get_ref() {
            DeValue::String(text) if text == "any" => Some(RawEnd(Vec::new())),
            DeValue::Integer(_) => Some(RawEnd(vec![module(node, diagnostics)?])),
            DeValue::Array(all) if !all.is_empty() => {
                let all = all.iter().map(|node| module(node, diagnostics));
                Some(RawEnd(all.collect::<Option<_>>()?))
            }
            found => {
                diagnostics.add(node.span(), wrong("a module, a list of modules or \"any\"", found, MODULES));
                None
            }
        }
    }
}

/// A link of its own, as written.
#[derive(Clone, Debug)]
pub struct RawBetween {
    ends: [RawEnd; 2],
    one_way: bool,
    from: Time,
    until: Time,
    /// Its delay and probabilities.
    pub rates: RawLink,
}

/// Reads all of them.
pub fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Vec<RawBetween> {
    let Some(all) = elements(node, "[[link.between]]", diagnostics) else { return Vec::new() };
    if all.len() > MAX_BETWEEN {
        let (got, low, high) = (all.len().to_string(), "0".to_owned(), MAX_BETWEEN.to_string());
        diagnostics.add(
            node.span(),
            ScenarioError::Range { what: "the number of [[link.between]]", got, low, high },
        );
        return Vec::new();
    }
    all.iter().filter_map(|node| read_one(node, diagnostics)).collect()
}

fn read_one(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<RawBetween> {
    let mut section = Section::of(node, "[[link.between]]", MODULES, diagnostics)?;
    let ends = match section.node("modules") {
        Some(modules) => read_ends(modules, diagnostics),
        None => {
            section.missing("modules", MODULES, diagnostics);
            None
        }
    };
    let one_way = section.get::<bool>("one_way", diagnostics).is_some_and(|at| at.value);
    let from: Option<At<Span>> = section.get("from", diagnostics);
    let until: Option<At<Span>> = section.get("until", diagnostics);
    let rates = RawLink::read_rates(&mut section, diagnostics);
    section.finish(diagnostics);
    let from = from.map_or(Time::ZERO, |at| Time::ZERO + at.value);
    let end = until.as_ref().map_or(Time::NEVER, |at| Time::ZERO + at.value);
    if let Some(At { place, .. }) = until.filter(|_| end <= from) {
        let (got, low, high) = (end.to_string(), format!("later than {from}"), Time::NEVER.to_string());
        diagnostics.add(place, ScenarioError::Range { what: "`until`", got, low, high });
    }
    Some(RawBetween { ends: ends?, one_way, from, until: end, rates })
}

fn read_ends(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<[RawEnd; 2]> {
    match node.get_ref() {
        DeValue::String(_) => {
            let any = RawEnd::read(node, diagnostics)?;
            Some([any.clone(), any])
        }
        DeValue::Array(ends) if ends.len() == 2 => {
            let [a, b] = [0, 1].map(|i| ends.get(i).and_then(|end| RawEnd::read(end, diagnostics)));
            Some([a?, b?])
        }
        found => {
            diagnostics.add(node.span(), wrong("two ends or \"any\"", found, MODULES));
            None
        }
    }
}

impl RawBetween {
    /// Returns the link of a swarm with so many modules. Rates that are not written are those of `link`, which has no partitions,
    /// hosts or links of their own yet.
    pub fn compile(&self, link: &LinkModel, modules: usize, diagnostics: &mut Diagnostics) -> Between {
        let mut end = |raw: &RawEnd| {
            let mut ids: Vec<ModuleId> = Vec::new();
            for At { value, place } in &raw.0 {
                match u32::try_from(*value).ok().filter(|id| (*id as usize) < modules) {
                    Some(id) => ids.push(ModuleId(id)),
                    None => diagnostics.add(
                        place.clone(),
                        ScenarioError::NoSuchModule { module: *value, last: modules.saturating_sub(1) },
                    ),
                }
            }
            ids.sort_unstable();
            ids.dedup();
            End(ids)
        };
        Between {
            ends: [end(&self.ends[0]), end(&self.ends[1])],
            one_way: self.one_way,
            from: self.from,
            until: self.until,
            link: self.rates.over(link),
        }
    }

    /// Returns true if it never ceases to hold.
    pub fn lasts(&self) -> bool {
        self.until == Time::NEVER
    }
}

/// Returns the definition, for the JSON schema.
pub fn schema() -> Definitions {
    let module = json!({ "type": "integer", "minimum": 0 });
    let end =
        json!({ "anyOf": [module, { "type": "array", "items": module, "minItems": 1 }, { "const": "any" }] });
    let ends = json!({ "anyOf": [{ "type": "array", "items": end, "minItems": 2, "maxItems": 2 }, { "const": "any" }] });
    let own = json!({
        "modules": said("Both ends: each a module, a list of modules, or \"any\"; \"any\" alone means all.", ends),
        "one_way": said("Whether only messages from the first end to the second are meant. Default: both ways.", json!({ "type": "boolean" })),
        "from": said("When it begins to hold. If left out, at the start.", of("time")),
        "until": said("When it ceases to hold. If left out, never.", of("time")),
    });
    let about = "A link of its own between some modules. The first that fits a message has it.";
    vec![("between", table(about, &["modules"], rates(own, "in [link]")))]
}
