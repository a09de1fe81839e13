//! `[link] delay` with quantiles, and `[link.burst]`.

use super::definitions::{Definitions, of, said, table};
use super::diagnostics::{At, Diagnostics, Place};
use super::error::{LONGEST, ScenarioError};
use super::table::{Delay, Node, Read, Section, elements, wrong};
use metamorph_core::link::{Burst, MOST_QUANTILES, Quantiles, QuantilesError};
use metamorph_core::ratio::Ratio;
use metamorph_core::time::Span;
use serde_json::json;
use std::sync::Arc;
use toml::de::DeValue;

/// An example of a delay with quantiles.
const QUANTILES: &str =
    "delay = { quantiles = [[\"50%\", \"2ms\"], [\"99%\", \"20ms\"], [\"100%\", \"80ms\"]] }";
/// An example of bursts.
const BURST: &str = "[link.burst]\n    enter = \"1%\"\n    leave = \"10%\"\n    loss = \"90%\"";

/// The delay of a link: uniform between two times, or with quantiles.
#[derive(Clone, Debug)]
pub struct LinkDelay {
    /// The shortest and the longest delay.
    pub range: Delay,
    /// The distribution, if it is not uniform.
    pub quantiles: Option<Arc<Quantiles>>,
}

impl Read for LinkDelay {
    fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<LinkDelay> {
        if !matches!(node.get_ref(), DeValue::Table(_)) {
            return Delay::read(node, diagnostics).map(|range| LinkDelay { range, quantiles: None });
        }
        let mut section = Section::of(node, "`delay`", QUANTILES, diagnostics)?;
        let Some(written) = section.node("quantiles") else {
            section.missing("quantiles", QUANTILES, diagnostics);
            return None;
        };
        section.finish(diagnostics);
        let pairs: Vec<Option<(Ratio, Span)>> = elements(written, QUANTILES, diagnostics)?
            .iter()
            .map(|pair| read_pair(pair, diagnostics))
            .collect();
        let pairs: Vec<(Ratio, Span)> = pairs.into_iter().collect::<Option<_>>()?;
        match Quantiles::new(&pairs) {
            Ok(quantiles) => {
                let range = Delay(quantiles.shortest(), quantiles.longest());
                Some(LinkDelay { range, quantiles: Some(Arc::new(quantiles)) })
            }
            Err(error) => {
                // A quantile out of order has a place of its own.
                let found = elements(written, QUANTILES, diagnostics)?;
                let place = match error {
                    QuantilesError::Order(i) => found.get(i).map(Node::span),
                    QuantilesError::Count(_) | QuantilesError::Open => None,
                };
                let place: Place = place.unwrap_or(written.span()).into();
                diagnostics.add(place, ScenarioError::Quantiles(error));
                None
            }
        }
    }
}

fn read_pair(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<(Ratio, Span)> {
    let pair: Vec<&Node<'_>> = elements(node, QUANTILES, diagnostics)?.iter().collect();
    match pair[..] {
        [share, delay] => Some((Ratio::read(share, diagnostics)?, Span::read(delay, diagnostics)?)),
        _ => {
            diagnostics.add(node.span(), wrong("a share and a time", node.get_ref(), QUANTILES));
            None
        }
    }
}

/// Reads `[link.burst]`.
pub fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Arc<Burst>> {
    let mut section = Section::of(node, "[link.burst]", BURST, diagnostics)?;
    let enter: Option<At<Ratio>> = section.need("enter", BURST, diagnostics);
    let leave: Option<At<Ratio>> = section.need("leave", BURST, diagnostics);
    let (loss, delay): (Option<At<Ratio>>, Option<At<Delay>>) =
        (section.get("loss", diagnostics), section.get("delay", diagnostics));
    section.finish(diagnostics);
    if let Some(At { value: Delay(_, longest), place }) = delay.as_ref().filter(|d| d.value.1 > LONGEST) {
        let (got, low, high) = (longest.to_string(), Span::ZERO.to_string(), LONGEST.to_string());
        diagnostics.add(place.clone(), ScenarioError::Range { what: "the delay", got, low, high });
    }
    if let Some(At { place, .. }) = leave.as_ref().filter(|leave| leave.value == Ratio::ZERO) {
        let (got, low, high) = ("0%".to_owned(), "more than 0%".to_owned(), "100%".to_owned());
        diagnostics.add(place.clone(), ScenarioError::Range { what: "`leave`", got, low, high });
    }
    Some(Arc::new(Burst {
        enter: enter?.value,
        leave: leave?.value,
        loss: loss.map_or(Ratio::ZERO, |loss| loss.value),
        delay: delay.map(|delay| (delay.value.0, delay.value.1)),
    }))
}

/// Returns the definitions of both, for the JSON schema.
pub fn schema() -> Definitions {
    let pair = json!({ "type": "array", "prefixItems": [of("probability"), of("time")], "minItems": 2, "maxItems": 2 });
    let quantiles = json!({
        "quantiles": said(
            "Shares of the messages, each with the time that they take at most: growing, the last 100%, linear between; 0s at 0%, \
             unless that is given.",
            json!({ "type": "array", "items": pair, "minItems": 1, "maxItems": MOST_QUANTILES }),
        ),
    });
    let keys = json!({
        "enter": said("The probability that a message begins a burst.", of("probability")),
        "leave": said("The probability that a message ends it, above zero.", of("probability")),
        "loss": said("The probability that a message within it is lost. If left out, none is.", of("probability")),
        "delay": said("The delay within it. If left out, the usual one.", of("delay")),
    });
    let quantiles = table("A distribution of delays, such as a measured one.", &["quantiles"], quantiles);
    vec![
        ("quantiles", quantiles),
        ("link-delay", json!({ "anyOf": [of("delay"), of("quantiles")] })),
        (
            "burst",
            table("Spells in which a link is worse, in each direction apart.", &["enter", "leave"], keys),
        ),
    ]
}
