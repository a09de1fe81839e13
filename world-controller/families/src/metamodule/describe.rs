//! The description of a swarm of metamodules, for `metamorph check`.

use super::Metamodules;
use crate::connection::describe as describe_connection;
use metamorph_protocol::metamodule::params::{
    Ask, Params, Precedence, PrecedenceBy, Repulsion, SeedAuthority,
};
use metamorph_protocol::time::Time;
use metamorph_scenario::Plan;
use metamorph_text::escape::Shown;
use metamorph_text::format::many;
use std::fmt::Write;

/// Largest number of start places listed; the rest is counted.
const SHOWN_MAX: usize = 20;

/// Writes the description.
pub fn describe(out: &mut String, plan: &Plan, swarm: &Metamodules) -> std::fmt::Result {
    let (setup, all) = (&swarm.setup, swarm.poses.len());
    let (floor, params) = (setup.floor, &setup.params);
    let places = if swarm.drawn.is_some() { "drawn" } else { "listed" };
    writeln!(
        out,
        "  swarm     {} of kind {}, numbered 0 to {}, on a floor from {:?} to {:?}",
        many(all as u64, "metamodule"),
        setup.kind(),
        all - 1,
        floor.min,
        floor.max
    )?;
    let feet: Vec<String> = swarm.poses.iter().take(SHOWN_MAX).map(|p| format!("{:?}", p.foot())).collect();
    let dots = if all > SHOWN_MAX { ", …" } else { "" };
    let redrawn = match swarm.redrawn {
        0 => String::new(),
        1 => " (one draw rejected: a metamodule was enclosed)".to_owned(),
        n => format!(" ({n} draws rejected: a metamodule was enclosed)"),
    };
    writeln!(out, "  start     {places}: {}{dots}{redrawn}", feet.join(", "))?;
    writeln!(
        out,
        "  moves     {} for a step of a joint, {} to connect; {} of connections fail; communication range {} connectors",
        params.turn_time, params.connect_time, plan.failure, params.communication_range
    )?;
    if let Some(model) = &swarm.connection {
        writeln!(out, "  connect   {}", describe_connection(model))?;
    }
    let begins = std::iter::once(Time::ZERO).chain(swarm.changes.iter().map(|(at, _)| *at));
    for ((stage, goal), at) in plan.stages.iter().zip(&setup.goals).zip(begins) {
        let levels: Vec<String> = goal.levels().iter().map(u8::to_string).collect();
        let from = if at == Time::ZERO { String::new() } else { format!(", from {at} on") };
        writeln!(
            out,
            "  goal      {}: {}, level by level {}{from}",
            stage.name.shown(),
            many(goal.seeds().len() as u64, "seed"),
            levels.join(" + ")
        )?;
    }
    let seed_authority = match params.seed_authority {
        SeedAuthority::Controller => "the controller",
        SeedAuthority::Neighbours => "neighbours",
    };
    let relocates = if swarm.relocate { "; a goal that cannot be built in place is moved" } else { "" };
    let detects = if params.detector.is_some() { "; the swarm finds deadlocks by itself" } else { "" };
    writeln!(
        out,
        "  protocol  strategy {}{}; {seed_authority} tells which seeds are open{relocates}{detects}",
        params.strategy.name(),
        field(params),
    )
}

/// Describes the force field of the published strategies, and what others ask the operator.
fn field(params: &Params) -> String {
    if !params.strategy.is_published() {
        return match params.ask {
            Ask::Never => String::new(),
            Ask::Stuck => format!("; asks the operator when nothing moves, for {}", params.answer_within),
            Ask::Always => {
                format!("; asks the operator before it plans for all, for {}", params.answer_within)
            }
        };
    }
    let first = match params.precedence {
        None => "no precedence".to_owned(),
        Some(Precedence { within, by: PrecedenceBy::SeedDistance }) => {
            format!("the metamodule nearer to a seed goes first within {within} connectors")
        }
        Some(Precedence { within, by: PrecedenceBy::Id }) => {
            format!("the smaller number goes first within {within} connectors")
        }
    };
    let Repulsion { strength, decay, range } = params.repulsion;
    let settled = if params.settled_repel { "also settled ones" } else { "not settled ones" };
    match strength {
        0 => format!("; {first}; no repulsion"),
        _ => format!(
            "; {first}; repulsion within {range} cells by {strength}/1000, {decay}/1000 of it lost at the edge, {settled}"
        ),
    }
}
