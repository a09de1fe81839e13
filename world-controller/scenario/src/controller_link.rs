//! `[link.controller]`: how orders and reports travel between the controller and the agents.

use super::LinkKind;
use super::definitions::{Definitions, of, said, table};
use super::diagnostics::{At, Diagnostics, Place};
use super::error::{LONGEST, ScenarioError};
use super::table::{Delay, Node, Section};
use metamorph_core::link::ControllerLink;
use metamorph_core::ratio::Ratio;
use metamorph_core::time::Span;
use serde_json::json;

/// `[link.controller]` as written.
#[derive(Clone, Debug)]
pub struct RawController {
    place: Place,
    delay: Option<At<Delay>>,
    loss: Option<At<Ratio>>,
}

impl RawController {
    /// Reads the table.
    pub fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<RawController> {
        let mut section = Section::of(node, "[link.controller]", "delay = \"20ms..50ms\"", diagnostics)?;
        let (delay, loss) = (section.get("delay", diagnostics), section.get("loss", diagnostics));
        section.finish(diagnostics);
        Some(RawController { place: node.span().into(), delay, loss })
    }

    /// Returns the link.
    pub fn compile(&self, kind: LinkKind, diagnostics: &mut Diagnostics) -> ControllerLink {
        if kind == LinkKind::Ipc {
            let what = "a link of its own for orders and reports of processes".to_owned();
            let instead = "simulate it with `--link sim`, or remove [link.controller]";
            diagnostics.add(self.place.clone(), ScenarioError::NotYet { what, instead });
        }
        let Delay(delay_min, delay_max) =
            self.delay.as_ref().map_or(Delay(Span::ZERO, Span::ZERO), |d| d.value);
        if let Some(At { place, .. }) = self.delay.as_ref().filter(|_| delay_max > LONGEST) {
            let (got, low, high) = (delay_max.to_string(), Span::ZERO.to_string(), LONGEST.to_string());
            diagnostics.add(place.clone(), ScenarioError::Range { what: "the delay", got, low, high });
        }
        ControllerLink { delay_min, delay_max, loss: self.loss.as_ref().map_or(Ratio::ZERO, |l| l.value) }
    }
}

/// Returns the definition of the table, for the JSON schema.
pub fn schema() -> Definitions {
    let keys = json!({
        "delay": said("If left out, none.", of("delay")),
        "loss": said(
            "The probability that one sending is lost; it is sent again. If left out, none is lost.",
            of("probability"),
        ),
    });
    vec![("controller-link", table("The link of orders and reports on the simulated link.", &[], keys))]
}
