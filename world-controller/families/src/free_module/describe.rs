//! The description of a structure of free modules, for `metamorph check`.

use super::FreeModules;
use super::scenario::{BODY, COLLISIONS, CONNECTORS, OBJECTIVES};
use crate::connection::describe as describe_connection;
use metamorph_scenario::Plan;
use metamorph_text::escape::Shown;
use metamorph_text::format::{count, many};
use std::fmt::Write;

/// Returns the name of a value in scenarios.
fn name<T: PartialEq>(names: &[(&'static str, T)], value: &T) -> &'static str {
    names.iter().find(|(_, known)| known == value).map_or("", |(name, _)| name)
}

/// Writes the description.
pub fn describe(out: &mut String, plan: &Plan, swarm: &FreeModules) -> std::fmt::Result {
    let FreeModules { from, to, start, planner, connection, setup } = swarm;
    let modules = many(start.len() as u64, "free module");
    writeln!(out, "  swarm     {modules}, numbered 0 to {}, body {BODY}", start.len() - 1)?;
    writeln!(out, "  start     {}", from.shown())?;
    writeln!(
        out,
        "  moves     {} for a step of a joint, {} to connect; {} of connections fail",
        setup.turn_time, setup.connect_time, plan.failure
    )?;
    if let Some(model) = connection {
        writeln!(out, "  connect   {}", describe_connection(model))?;
    }
    let goal = plan.stages.first().map_or(String::new(), |stage| stage.name.shown());
    writeln!(out, "  goal      {goal}: {}", to.shown())?;
    writeln!(
        out,
        "  protocol  planned: fewest {}, collision {}, connectors {}; a plan has {} MiB and {} expansions",
        name(&OBJECTIVES, &planner.objective),
        name(&COLLISIONS, &planner.collision),
        name(&CONNECTORS, &planner.connectors),
        planner.limits.memory >> 20,
        count(planner.limits.work),
    )
}
