//! The scenario in which cubes build a drawn structure.

use crate::scenario::family::DrawnStructure;
use crate::scenario::mesh_import::preview::{Written, scenario as written, start};
use metamorph_protocol::goal::Growth;

/// Scenario seconds per second on the process link: a person watches it.
const TIME_SCALE: u32 = 2;

/// Returns the text of the scenario, or why there is none.
pub fn scenario(drawing: &DrawnStructure<'_>) -> Result<String, String> {
    let start = start(drawing.cells);
    if start.is_empty() {
        return Err("there is no room for modules beside it".to_owned());
    }
    let (name, goal) = (drawing.name, drawing.cells);
    let text = written(&Written { origin: "studio`", name, start: &start, goal, growth: Growth::Solid });
    Ok(format!("{text}\n[process]\ntime_scale = {TIME_SCALE}\n"))
}
