//! The scenario in which metamodules build a drawn structure: each of its chains is a seed.

use crate::scenario::family::DrawnStructure;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::blueprint::MAX_SEEDS;

/// Connectors of the floor around the structure, on each side.
const MARGIN: i16 = 5;
/// Scenario seconds per second on the process link: a person waits for it.
const TIME_SCALE: u32 = 20;
/// The names of directions, by number of the face.
const DIRECTIONS: [&str; 6] = ["east", "west", "north", "south", "up", "down"];

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
        let steps = chain.windows(2).filter_map(|pair| pair[0].face_to(pair[1]));
        let steps: Vec<String> = steps.map(|face| format!("\"{}\"", DIRECTIONS[face.index()])).collect();
        let foot = [chain[0].x - low.x + MARGIN, chain[0].y - low.y + MARGIN];
        format!("    {{ foot = {foot:?}, directions = [{}] }},\n", steps.join(", "))
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
