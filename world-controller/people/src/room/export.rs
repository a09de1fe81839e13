//! A room as a scenario: metamodules come from the store and build one piece after the other.

use super::model::{Area, Block, Room};
use super::reach::Stage;
use metamorph_families::metamodule::seed_text;
use metamorph_protocol::metamodule::blueprint::MAX_SEEDS;
use metamorph_protocol::metamodule::params::LEAST_COMMUNICATION_RANGE;
use metamorph_protocol::roombots::Kind;
use std::fmt::Write;
use thiserror::Error;

/// Largest number of obstacles of a scenario: one fault each.
const MAX_OBSTACLES: usize = 1_000;

/// Why a room is no scenario.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ExportError {
    /// Nothing to build.
    #[error("the room has no piece\n  fix: add a [[piece]]")]
    Empty,
    /// More seeds than a goal can have.
    #[error("the pieces need {0} metamodules; a goal has at most {MAX_SEEDS}\n  fix: take pieces out")]
    TooMany(usize),
    /// Nowhere to start.
    #[error("the room has no store\n  fix: write `store = {{ min = [0, 0], max = [20, 12] }}` in [room]")]
    NoStore,
    /// Too many cells that are kept out.
    #[error(
        "the keep-out boxes have {0} cells, of which at most {MAX_OBSTACLES} can be obstacles\n  fix: make them thinner or lower"
    )]
    TooManyObstacles(usize),
}

/// Returns the text of the scenario in which the stages are built in this order. `origin` names the room file.
///
/// # Errors
/// If the room has no piece or no store, or too many seeds or obstacles.
pub fn scenario(room: &Room, stages: &[Stage], kind: Kind, origin: &str) -> Result<String, ExportError> {
    let seeds: usize = stages.iter().flat_map(|stage| &stage.levels).map(Vec::len).sum();
    let store = room.store.ok_or(ExportError::NoStore)?;
    match seeds {
        0 => return Err(ExportError::Empty),
        1..=MAX_SEEDS => {}
        more => return Err(ExportError::TooMany(more)),
    }
    let obstacles: usize = room.keep_out.iter().map(Block::volume).sum();
    if obstacles > MAX_OBSTACLES {
        return Err(ExportError::TooManyObstacles(obstacles));
    }
    let origin: String = origin.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    let mut out = format!("# Written by `metamorph room --write` from {origin}.\nversion = 1\n");
    if let Some(name) = &room.name {
        let _ = writeln!(out, "name = {}", toml::Value::String(name.clone()));
    }
    let (Area { min, max }, (w, d)) = (store, room.size);
    let _ = write!(
        out,
        "\n[swarm]\nfamily = \"metamodule\"\nkind = \"{}\"\ncount = {}\nstart = {{ min = [{}, {}], max = [{}, {}] }}\n\
         floor = {{ min = [0, 0], max = [{}, {}] }}\ncommunication_range = {LEAST_COMMUNICATION_RANGE}\n\n\
         [[goal]]\norder = \"at-once\"                          # of each level; levels in this order\nlevels = [\n",
        kind.name(),
        seeds + room.spare,
        min.0,
        min.1,
        max.0,
        max.1,
        w - 1,
        d - 1,
    );
    for stage in stages {
        let _ = writeln!(out, "    # {}", comment(&room.pieces[stage.piece].name));
        for level in &stage.levels {
            let _ = writeln!(out, "    [");
            for seed in level {
                let _ = writeln!(out, "        {},", seed_text(seed));
            }
            let _ = writeln!(out, "    ],");
        }
    }
    let _ = writeln!(out, "]");
    for cell in room.keep_out.iter().flat_map(Block::cells) {
        let _ = write!(out, "\n[[fault]]\nobstacle = [{}, {}, {}]\nat = \"0s\"\n", cell.x, cell.y, cell.z);
    }
    // So many ways through one room are quick to plan together, and slow to negotiate one by one.
    out += "\n[protocol]\nstrategy = \"planned\"                       # or negotiated: without a plan of the controller\n";
    let _ = write!(out, "\n[stop]\ntimeout = \"{}s\"\n", 2_000 * (seeds + room.spare));
    Ok(out)
}

/// A name without what would end a comment.
fn comment(name: &str) -> String {
    name.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
}
