//! The order in which the parts of a scenario's goals can be assembled.

use super::{Answer, RobotError};
use clap::Args;
use metamorph_families::metamodule::Metamodules;
use metamorph_processes::family::families;
use metamorph_protocol::metamodule::planning::assembly_order::{AssemblyOrder, Blocked, assembly_order};
use metamorph_scenario::{Overrides, read_file};
use serde_json::{Value, json};
use std::fmt::Write;
use std::path::PathBuf;

#[derive(Args, Clone, Debug)]
pub struct OrderArgs {
    /// A scenario of metamodules
    scenario: PathBuf,
}

/// Finds the assembly order of every goal. A goal without one is a failure.
pub fn order(args: &OrderArgs) -> Result<Answer, RobotError> {
    let plan = read_file(families(), &args.scenario, &Overrides::default())
        .map_err(|diagnostics| RobotError::Usage(diagnostics.to_string()))?;
    let Some(swarm) = plan.swarm.of::<Metamodules>() else {
        return Err(RobotError::Usage(
            "this scenario has no metamodules; only their goals have parts".into(),
        ));
    };
    let (mut text, mut all, mut impossible) = (String::new(), Vec::new(), Vec::new());
    for (goal, stage) in swarm.setup.goals.iter().zip(&plan.stages) {
        let name = &stage.name;
        let found = assembly_order(&swarm.setup.motions, goal);
        let _ = write_goal(&mut text, name, &found);
        if !found.blocked.is_empty() {
            impossible.push(name.clone());
        }
        all.push(goal_json(name, &found));
    }
    let mut answer = Answer::new(text, json!({ "goals": all }));
    if !impossible.is_empty() {
        answer.failure = Some(RobotError::NoOrder(impossible.join(", ")));
    }
    Ok(answer)
}

fn seeds(list: &[u8]) -> String {
    let numbers: Vec<String> = list.iter().map(|seed| (seed + 1).to_string()).collect();
    match list {
        [_] => format!("seed {}", numbers[0]),
        _ => format!("seeds {}", numbers.join(", ")),
    }
}

fn write_goal(text: &mut String, name: &str, found: &AssemblyOrder) -> std::fmt::Result {
    let parts: usize = found.steps.iter().map(Vec::len).sum();
    match found.blocked.len() {
        0 => writeln!(text, "{name}: {parts} parts can be assembled in {} steps", found.steps.len())?,
        n => writeln!(text, "{name}: no order; {n} of {} parts block each other", n + parts)?,
    }
    for part in &found.blocked {
        match &part.by[..] {
            [] => writeln!(text, "        seed {} cannot be reached even alone", part.seed + 1)?,
            by => writeln!(text, "        seed {} is blocked by {}", part.seed + 1, seeds(by))?,
        }
    }
    for (number, step) in found.steps.iter().enumerate() {
        let after = if found.blocked.is_empty() { "" } else { " after those" };
        writeln!(text, "  {:4}  {}{after}", number + 1, seeds(step))?;
    }
    Ok(())
}

/// Seeds are numbered from 1, as in other texts and files.
fn goal_json(name: &str, found: &AssemblyOrder) -> Value {
    let numbers = |list: &[u8]| list.iter().map(|seed| seed + 1).collect::<Vec<u8>>();
    let blocked = |part: &Blocked| json!({ "seed": part.seed + 1, "by": numbers(&part.by) });
    json!({
        "goal": name,
        "steps": found.steps.iter().map(|step| numbers(step)).collect::<Vec<_>>(),
        "blocked": found.blocked.iter().map(blocked).collect::<Vec<_>>(),
    })
}
