//! The scenario in which cubes build a drawn structure.

use metamorph_protocol::goal::Growth;
use metamorph_scenario::family::DrawnStructure;
use metamorph_shapes::preview::{Written, scenario as written, start};

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
