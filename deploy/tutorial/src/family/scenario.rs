//! The parts of a scenario that only elections have.

use super::{ElectionFamily, Plate};
use crate::leader::Setup;
use metamorph_protocol::time::Span;
use metamorph_world_controller::scenario::bounds::Bounds;
use metamorph_world_controller::scenario::definitions::{NUMBERED, natural, of, or, said, table, text};
use metamorph_world_controller::scenario::diagnostics::{At, Diagnostics};
use metamorph_world_controller::scenario::error::ScenarioError;
use metamorph_world_controller::scenario::family::{
    DraftContext, FamilySchema, FamilySpec, Patience, RawSwarm, ScenarioFamily, Sections, Swarm,
};
use metamorph_world_controller::scenario::raw::{goal_sections, protocol_section};
use metamorph_world_controller::scenario::table::Section;
use serde_json::json;
use std::sync::Arc;

/// Modules along a side of the plate, if the scenario does not say.
const SIDE: u64 = 4;
/// The largest number of modules along a side.
const MOST: u64 = 100;
/// The time between two repeats of what a module knows, if the scenario does not say.
const REPEAT: Span = Span::millis(500);

/// The parts as written.
#[derive(Debug)]
struct RawPlate {
    side: Option<At<u64>>,
    repeat: Option<At<Span>>,
    goals: Vec<Option<String>>,
}

impl ScenarioFamily for ElectionFamily {
    fn name(&self) -> &'static str {
        super::NAME
    }
    fn read(
        &self,
        mut swarm: Section<'_, '_>,
        others: &Sections<'_, '_>,
        diagnostics: &mut Diagnostics,
    ) -> Box<dyn RawSwarm> {
        let (side, repeat) = (swarm.get("side", diagnostics), swarm.get("repeat", diagnostics));
        swarm.finish(diagnostics);
        let mut goals = Vec::new();
        for mut section in goal_sections(others.goals, "name = \"a leader\"", diagnostics) {
            goals.push(section.get("name", diagnostics).map(|name| name.value));
            section.finish(diagnostics);
        }
        if let Some(section) = protocol_section(others.protocol, "", diagnostics) {
            section.finish(diagnostics);
        }
        Box::new(RawPlate { side, repeat, goals })
    }
    fn schema(&self) -> FamilySchema {
        let family = json!({ "const": super::NAME });
        let side = json!({ "type": "integer", "minimum": 1, "maximum": MOST });
        FamilySchema {
            swarm: table(
                "A plate of modules that elect a leader.",
                &["family"],
                json!({
                    "family": family,
                    "side": said("Modules along each side.", or(SIDE, side)),
                    "repeat": or(REPEAT.to_string(), of("time")),
                    "failed_connections": said("Nothing connects here.", natural()),
                }),
            ),
            goal: table("A leader.", &[], json!({ "name": said(NUMBERED, text()) })),
            protocol: table("Nothing to choose.", &[], json!({})),
            shapes: &[],
            definitions: Vec::new(),
        }
    }
    fn faults(&self) -> &'static [&'static str] {
        &["kill", "pause", "crash", "partition"]
    }
}

impl RawSwarm for RawPlate {
    fn time_step(&self) -> (&Option<At<Span>>, &'static str) {
        (&self.repeat, "repeat")
    }
    fn draft(&self, context: &DraftContext, diagnostics: &mut Diagnostics) -> Option<FamilySpec> {
        let side = self.side.as_ref().map_or(SIDE, |side| side.value);
        if let Some(At { value, place }) = self.side.as_ref().filter(|side| !(1..=MOST).contains(&side.value))
        {
            let (got, low, high) = (value.to_string(), "1".to_owned(), MOST.to_string());
            diagnostics.add(place.clone(), ScenarioError::Range { what: "side", got, low, high });
            return None;
        }
        let repeat = self.repeat.as_ref().map_or(REPEAT, |repeat| repeat.value);
        // The lowest number goes from corner to corner, repeated until it has come through each contact.
        let messages = 2 * side;
        let lost = repeat * context.passage.repeats(messages, side * side);
        let late = (context.usual_delay + context.passage.late) * messages;
        let name = |(i, name): (usize, &Option<String>)| name.clone().unwrap_or(format!("goal {}", i + 1));
        Some(FamilySpec {
            swarm: Some(Swarm::new(Plate { side: side as u16, setup: Arc::new(Setup { repeat }) })),
            modules: (side * side) as usize,
            start_within: None,
            goals: self.goals.iter().enumerate().map(name).collect(),
            patience: Patience {
                bounds: Bounds {
                    stall: repeat * 4 + late + lost,
                    more_tries: context.passage.more_tries(1, side * side),
                },
                livelock: 4,
                timeout: 4,
            },
        })
    }
}
