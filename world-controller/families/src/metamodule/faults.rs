//! The faults that only metamodules have, in a scenario.

use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::elements::MAX_ELEMENTS;
use metamorph_scenario::definitions::{fault, for_good, natural, of, said};
use metamorph_scenario::diagnostics::Diagnostics;
use metamorph_scenario::error::ScenarioError;
use metamorph_scenario::family::WorldFaultKind;
use metamorph_scenario::table::{Node, Read};
use metamorph_sim_bridge::director::faults::Target;
use metamorph_sim_bridge::metamodule::faults::{DROP, OBSTACLE, OBSTACLE_GONE};
use serde_json::{Value, json};

/// The kinds of fault of the world of metamodules.
pub const WORLD_FAULTS: &[WorldFaultKind] = &[OBSTACLE_KIND, DROP_KIND];

/// A foreign object in a cell.
const OBSTACLE_KIND: WorldFaultKind = WorldFaultKind {
    key: "obstacle",
    begin: &OBSTACLE,
    end: Some(&OBSTACLE_GONE),
    target: obstacle,
    schema: obstacle_schema,
};

/// An element that falls.
const DROP_KIND: WorldFaultKind =
    WorldFaultKind { key: "drop", begin: &DROP, end: None, target: element, schema: drop_schema };

/// Reads the number of an element.
fn element(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Target> {
    let element = u64::read(node, diagnostics)?;
    if element >= MAX_ELEMENTS as u64 {
        let (got, low, high) = (element.to_string(), "0".to_owned(), (MAX_ELEMENTS - 1).to_string());
        let what = "the number of the element, counted from 0";
        diagnostics.add(node.span(), ScenarioError::Range { what, got, low, high });
    }
    u16::try_from(element).ok().map(Target::Element)
}

fn drop_schema() -> Value {
    let more = json!({ "drop": said("The number of the element.", natural()) });
    fault("All latches on an element open by themselves, and it falls.", DROP_KIND.key, &["at"], more)
}

/// Reads the cell of an obstacle.
fn obstacle(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<Target> {
    let cell = Cell::read(node, diagnostics)?;
    if cell.z < 0 {
        let (got, low, high) = (cell.z.to_string(), "0".to_owned(), Cell::LIMIT.to_string());
        let what = "the height of the obstacle above the floor";
        diagnostics.add(node.span(), ScenarioError::Range { what, got, low, high });
    }
    Some(Target::Cell(cell))
}

fn obstacle_schema() -> Value {
    let more = json!({ "obstacle": said("The cell.", of("cell")), "until": for_good() });
    fault("A foreign object enters a cell.", OBSTACLE_KIND.key, &["at"], more)
}
