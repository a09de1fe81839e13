//! The faults that only metamodules have, in a scenario.

use crate::scenario::diagnostics::Diagnostics;
use crate::scenario::error::ScenarioError;
use crate::scenario::family::WorldFaultKind;
use crate::scenario::schema::{fault, for_good, of};
use crate::scenario::table::{Node, Read};
use metamorph_protocol::lattice::Cell;
use metamorph_sim_bridge::director::faults::Target;
use metamorph_sim_bridge::metamodule::faults::{OBSTACLE, OBSTACLE_GONE};
use serde_json::{Value, json};

/// The kinds of fault of the world of metamodules.
pub const WORLD_FAULTS: &[WorldFaultKind] = &[OBSTACLE_KIND];

/// A foreign object in a cell.
const OBSTACLE_KIND: WorldFaultKind = WorldFaultKind {
    key: "obstacle",
    begin: &OBSTACLE,
    end: &OBSTACLE_GONE,
    target: obstacle,
    schema: obstacle_schema,
};

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
    let more = json!({ "obstacle": of("cell"), "until": for_good() });
    fault("A foreign object enters a cell.", OBSTACLE_KIND.key, &["at"], more)
}
