//! The description of a swarm of cubes, for `metamorph check`.

use super::Cubes;
use metamorph_protocol::cube::params::Connectivity;
use metamorph_protocol::goal::Growth;
use metamorph_protocol::lattice::Cell;
use metamorph_scenario::Plan;
use metamorph_sim_bridge::director::faults::Fault;
use metamorph_text::escape::Shown;
use metamorph_text::format::{count, many};
use std::collections::BTreeSet;
use std::fmt::Write;

/// Writes the description.
pub fn describe(out: &mut String, plan: &Plan, Cubes { cells, setup, omitted }: &Cubes) -> std::fmt::Result {
    let (min, max) = corners(cells);
    writeln!(
        out,
        "  swarm     {}, numbered 0 to {}, from {min} to {max}",
        many(cells.len() as u64, "module"),
        count(cells.len() as u64 - 1)
    )?;
    let params = &setup.params;
    writeln!(out, "  moves     {} each, {} fail", params.move_time, plan.failure)?;
    for ((stage, goal), omitted) in plan.stages.iter().zip(&setup.goals).zip(omitted.iter()) {
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
        if *omitted > 0 {
            let all = count((goal.len() + omitted) as u64);
            writeln!(
                out,
                "            {} of the {all} cells of your shape: a scaffold leaves out about half of a large shape,",
                count(goal.len() as u64)
            )?;
            writeln!(out, "            and parts that are one cell thick; growth = \"solid\" fills all")?;
        }
    }
    write_shortage(out, plan, cells.len())?;
    let connectivity = match params.connectivity {
        Connectivity::Forest => "forest",
        Connectivity::Cycles => "cycles",
        Connectivity::Gradient => "gradient (as published; not safe when delays differ)",
    };
    let co_owners = if params.co_owners { "asked" } else { "not asked" };
    writeln!(out, "  protocol  connectivity {connectivity}; co-owners {co_owners}")
}

/// Warns of goals that have more cells than modules are left after the planned deaths.
fn write_shortage(out: &mut String, plan: &Plan, modules: usize) -> std::fmt::Result {
    let killed = plan.schedule.iter().filter_map(|s| match s.fault {
        Fault::Kill(id) => Some(id),
        _ => None,
    });
    let killed = killed.collect::<BTreeSet<_>>().len();
    let setup = &plan.swarm.own::<Cubes>().setup;
    for (stage, goal) in
        plan.stages.iter().zip(&setup.goals).filter(|(_, goal)| goal.len() > modules - killed)
    {
        writeln!(
            out,
            "  warning   {}: {} for {}; {} to be killed, and a dead module fills a cell only if it dies in the goal, and a neighbour of each one that dies elsewhere may have to stay and hold it",
            stage.name.shown(),
            many(modules as u64, "module"),
            many(goal.len() as u64, "cell"),
            if killed == 1 { "1 is".to_owned() } else { format!("{} are", count(killed as u64)) },
        )?;
    }
    Ok(())
}

fn corners(cells: &[Cell]) -> (Cell, Cell) {
    let fold = |f: fn(i16, i16) -> i16| {
        let first = cells.first().copied().unwrap_or_default();
        cells.iter().fold(first, |a, c| Cell::new(f(a.x, c.x), f(a.y, c.y), f(a.z, c.z)))
    };
    (fold(i16::min), fold(i16::max))
}
