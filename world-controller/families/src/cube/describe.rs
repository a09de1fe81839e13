//! The description of a swarm of cubes, for `metamorph check`.

use super::Cubes;
use metamorph_protocol::cube::params::Connectivity;
use metamorph_protocol::goal::Growth;
use metamorph_protocol::lattice::Cell;
use metamorph_scenario::Plan;
use metamorph_text::escape::Shown;
use metamorph_text::format::{count, many};
use std::fmt::Write;

/// Writes the description.
pub fn describe(out: &mut String, plan: &Plan, Cubes { cells, setup }: &Cubes) -> std::fmt::Result {
    let (min, max) = corners(cells);
    writeln!(
        out,
        "  swarm     {}, numbered 0 to {}, from {min} to {max}",
        many(cells.len() as u64, "module"),
        count(cells.len() as u64 - 1)
    )?;
    let params = &setup.params;
    writeln!(out, "  moves     {} each, {} fail", params.move_time, plan.failure)?;
    for (stage, goal) in plan.stages.iter().zip(&setup.goals) {
        let growth = match goal.growth() {
            Growth::Scaffold => "scaffold",
            Growth::Solid => "solid",
        };
        let share = goal.len() * 100 / cells.len();
        writeln!(
            out,
            "  goal      {}: {} ({share}% of the modules), {growth}, grows from {}",
            stage.name.shown(),
            many(goal.len() as u64, "cell"),
            goal.seed()
        )?;
    }
    let connectivity = match params.connectivity {
        Connectivity::Forest => "forest",
        Connectivity::Cycles => "cycles",
        Connectivity::Gradient => "gradient (as published; not safe when messages are late)",
    };
    let co_owners = if params.co_owners { "asked" } else { "not asked" };
    writeln!(out, "  protocol  connectivity {connectivity}; co-owners {co_owners}")
}

fn corners(cells: &[Cell]) -> (Cell, Cell) {
    let fold = |f: fn(i16, i16) -> i16| {
        let first = cells.first().copied().unwrap_or_default();
        cells.iter().fold(first, |a, c| Cell::new(f(a.x, c.x), f(a.y, c.y), f(a.z, c.z)))
    };
    (fold(i16::min), fold(i16::max))
}
