//! The keys of `[protocol]` that say when metamodules ask the operator: `ask` and `answer_within` (thesis E.3.1).

use super::error::MetamoduleError;
use metamorph_protocol::metamodule::params::{Ask, Params, Strategy};
use metamorph_protocol::time::Span;
use metamorph_scenario::diagnostics::{At, Diagnostics};
use metamorph_scenario::error::{LONGEST, ScenarioError};
use metamorph_scenario::table::Section;

/// The keys as written.
#[derive(Clone, Debug, Default)]
pub struct RawAsking {
    ask: Option<At<Ask>>,
    answer_within: Option<At<Span>>,
}

impl RawAsking {
    /// Reads the keys from `[protocol]`.
    pub fn read(section: &mut Section<'_, '_>, diagnostics: &mut Diagnostics) -> RawAsking {
        RawAsking {
            ask: section.choice_at("ask", "time to ask", &Ask::ALL, diagnostics),
            answer_within: section.get("answer_within", diagnostics),
        }
    }

    /// Applies the keys to the parameters, and refuses them for strategies that do not plan for all together.
    pub fn apply(&self, params: &mut Params, diagnostics: &mut Diagnostics) {
        let places = [
            ("ask", self.ask.as_ref().map(|ask| &ask.place)),
            ("answer_within", self.answer_within.as_ref().map(|span| &span.place)),
        ];
        if params.strategy != Strategy::Negotiated {
            for (key, place) in places.into_iter().filter_map(|(key, place)| Some((key, place?))) {
                diagnostics.add(place.clone(), MetamoduleError::AsksNothing(key, params.strategy.name()));
            }
            return;
        }
        params.ask = self.ask.as_ref().map_or(params.ask, |ask| ask.value);
        if let Some(At { value, place }) = &self.answer_within {
            if !(Span::millis(1)..=LONGEST).contains(value) {
                let (got, low, high) = (value.to_string(), Span::millis(1).to_string(), LONGEST.to_string());
                diagnostics
                    .add(place.clone(), ScenarioError::Range { what: "answer_within", got, low, high });
            }
            params.answer_within = *value;
        }
    }
}
