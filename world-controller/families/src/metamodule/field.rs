//! The keys of `[protocol]` that vary the force field of the published strategies: `precedence`,
//! `settled_repel` and `repulsion`. A missing key keeps the strategy's value.

use super::error::MetamoduleError;
use metamorph_protocol::metamodule::params::{Params, Precedence, PrecedenceBy, Repulsion};
use metamorph_scenario::diagnostics::{At, Diagnostics};
use metamorph_scenario::error::ScenarioError;
use metamorph_scenario::table::{Node, Read, Section, wrong};
use toml::de::DeValue;

/// Maximum, in thousandths, of the parts of `repulsion`.
pub const MAX_THOUSANDTHS: u64 = 10_000;
/// Maximum range of `repulsion`, in cells.
pub const MAX_RANGE: u64 = 64;
/// An example of `precedence`.
const PRECEDENCE: &str = "precedence = { within = 4, by = \"seed-distance\" }";

/// The keys as written.
#[derive(Clone, Debug, Default)]
pub struct RawField {
    precedence: Option<At<RawPrecedence>>,
    settled_repel: Option<At<bool>>,
    repulsion: Option<At<RawRepulsion>>,
}

#[derive(Clone, Copy, Debug)]
enum RawPrecedence {
    Off,
    On { within: u16, by: PrecedenceBy },
}

#[derive(Clone, Copy, Debug)]
struct RawRepulsion {
    strength: Option<u16>,
    decay: Option<u16>,
    range: Option<u16>,
}

impl RawField {
    /// The names of the keys.
    pub const KEYS: [&'static str; 3] = ["precedence", "settled_repel", "repulsion"];

    /// Reads the keys from `[protocol]`.
    pub fn read(section: &mut Section<'_, '_>, diagnostics: &mut Diagnostics) -> RawField {
        RawField {
            precedence: section.get("precedence", diagnostics),
            settled_repel: section.get("settled_repel", diagnostics),
            repulsion: section.get("repulsion", diagnostics),
        }
    }

    /// Applies the keys to the parameters, and refuses them for a strategy without a force field.
    pub fn apply(&self, params: &mut Params, diagnostics: &mut Diagnostics) {
        let RawField { precedence, settled_repel, repulsion } = self;
        if !params.strategy.is_published() {
            let places = [
                precedence.as_ref().map(|p| &p.place),
                settled_repel.as_ref().map(|s| &s.place),
                repulsion.as_ref().map(|r| &r.place),
            ];
            for (key, place) in RawField::KEYS.into_iter().zip(places) {
                if let Some(place) = place {
                    diagnostics.add(place.clone(), MetamoduleError::NoField(key, params.strategy.name()));
                }
            }
            return;
        }
        if let Some(precedence) = precedence {
            params.precedence = match precedence.value {
                RawPrecedence::Off => None,
                RawPrecedence::On { within, .. } if within > params.communication_range => {
                    let (low, high) = ("1".to_owned(), params.communication_range.to_string());
                    let scenario_error =
                        ScenarioError::Range { what: "within", got: within.to_string(), low, high };
                    return diagnostics.add(precedence.place.clone(), scenario_error);
                }
                RawPrecedence::On { within, by } => Some(Precedence { within, by }),
            };
        }
        if let Some(settled_repel) = settled_repel {
            params.settled_repel = settled_repel.value;
        }
        if let Some(At { value: RawRepulsion { strength, decay, range }, .. }) = repulsion {
            let usual = params.repulsion;
            params.repulsion = Repulsion {
                strength: strength.unwrap_or(usual.strength),
                decay: decay.unwrap_or(usual.decay),
                range: range.unwrap_or(usual.range),
            };
        }
    }
}

impl Read for RawPrecedence {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<RawPrecedence> {
        match node.get_ref() {
            DeValue::String(text) if text == "off" => Some(RawPrecedence::Off),
            DeValue::String(text) => {
                let got = text.clone().into_owned();
                diagnostics
                    .add(node.span(), ScenarioError::Name { what: "precedence", got, known: vec!["off"] });
                None
            }
            DeValue::Table(_) => {
                let mut section = Section::of(node, "precedence", PRECEDENCE, diagnostics)?;
                let within = number(&mut section, "within", 1..=u64::from(u16::MAX), diagnostics);
                let names = PrecedenceBy::ALL.map(|by| (by.name(), by));
                let by = section.choice("by", "precedence", &names, diagnostics);
                for (key, example, is_there) in [
                    ("within", "within = 4", section.node("within").is_some()),
                    ("by", "by = \"seed-distance\"", section.node("by").is_some()),
                ] {
                    if !is_there {
                        section.missing(key, example, diagnostics);
                    }
                }
                section.finish(diagnostics);
                Some(RawPrecedence::On { within: within?, by: by? })
            }
            other => {
                diagnostics.add(node.span(), wrong("\"off\" or a table", other, PRECEDENCE));
                None
            }
        }
    }
}

impl Read for RawRepulsion {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<RawRepulsion> {
        let example = "repulsion = { strength = 1000, decay = 1000, range = 4 }";
        let mut section = Section::of(node, "repulsion", example, diagnostics)?;
        let strength = number(&mut section, "strength", 0..=MAX_THOUSANDTHS, diagnostics);
        let decay = number(&mut section, "decay", 0..=1000, diagnostics);
        let range = number(&mut section, "range", 1..=MAX_RANGE, diagnostics);
        section.finish(diagnostics);
        Some(RawRepulsion { strength, decay, range })
    }
}

fn number(
    section: &mut Section<'_, '_>,
    key: &'static str,
    range: std::ops::RangeInclusive<u64>,
    diagnostics: &mut Diagnostics,
) -> Option<u16> {
    let At { value, place } = section.get::<u64>(key, diagnostics)?;
    match u16::try_from(value).ok().filter(|_| range.contains(&value)) {
        Some(number) => Some(number),
        None => {
            let (low, high) = (range.start().to_string(), range.end().to_string());
            diagnostics.add(place, ScenarioError::Range { what: key, got: value.to_string(), low, high });
            None
        }
    }
}
