//! The scenario in which metamodules build a drawn structure: each of its chains is a seed.

use super::scenario::seed_text;
use metamorph_protocol::lattice::{Cell, Face};
use metamorph_protocol::metamodule::blueprint::{MAX_SEEDS, Seed};
use metamorph_scenario::family::DrawnStructure;

/// Number of connectors of the floor around the structure, on each side.
const MARGIN: i16 = 5;
/// Scenario seconds per second on the process link: a person waits for it.
const TIME_SCALE: u32 = 20;

/// Returns the text of the scenario, or why there is none.
pub fn scenario(drawing: &DrawnStructure<'_>) -> Result<String, String> {
    let chains = drawing.standing;
    if chains.is_empty() {
        let why = drawing.why_not_standing.unwrap_or("it has not been split into chains");
        return Err(format!("no chains of four cells with a foot on the floor cover it: {why}"));
    }
    if chains.len() > MAX_SEEDS {
        return Err(format!("it takes {} metamodules, and a goal has {MAX_SEEDS} at most", chains.len()));
    }
    let (x, y) = (drawing.cells.iter().map(|c| c.x), drawing.cells.iter().map(|c| c.y));
    let low = Cell::new(x.clone().min().unwrap_or(0), y.clone().min().unwrap_or(0), 0);
    let extent = |high: Option<i16>, low: i16| high.unwrap_or(low).saturating_sub(low);
    let side = [extent(x.max(), low.x), extent(y.max(), low.y)].map(|side| side + 2 * MARGIN);
    let seed = |chain: &[Cell; 4]| {
        // Invariant: cells of a chain follow on each other.
        let step = |i: usize| chain[i].face_to(chain[i + 1]).unwrap_or(Face::Up);
        let foot = (chain[0].x - low.x + MARGIN, chain[0].y - low.y + MARGIN);
        format!("    {},\n", seed_text(&Seed { foot, directions: [step(0), step(1), step(2)] }))
    };
    let name = toml::Value::String(drawing.name.to_owned());
    Ok(format!(
        "# Written by `metamorph studio`.\nversion = 1\nname = {name}\n\n[swarm]\nfamily = \"{}\"\nstart = \"random\"\n\
         floor = {{ min = [0, 0], max = {side:?} }}\n\n[[goal]]\nname = {name}\nlevels = [[\n{}]]\n\n\
         [process]\ntime_scale = {TIME_SCALE}\n\n[stop]\ntimeout = \"40000s\"\n",
        super::NAME,
        chains.iter().map(seed).collect::<String>(),
    ))
}
