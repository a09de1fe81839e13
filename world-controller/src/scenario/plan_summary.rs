//! What a plan would do, for `metamorph check`.

use crate::console::escape::Shown;
use crate::console::format::{count, many};
use crate::scenario::{Cubes, LinkKind, Metamodules, Plan, Swarm};
use metamorph_protocol::cube::params::Connectivity;
use metamorph_protocol::goal::Growth;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::params::{Params, Precedence, PrecedenceBy, Repulsion, Strategy, Teller};
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::time::Time;
use std::fmt::Write;

/// Faults listed; the rest is counted.
const SHOWN: usize = 20;

/// The plan in words and numbers.
pub fn overview(plan: &Plan) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_all(&mut out, plan);
    out
}

fn write_all(out: &mut String, plan: &Plan) -> std::fmt::Result {
    writeln!(out, "{}", plan.title().shown())?;
    if let Some(description) = &plan.description {
        writeln!(out, "  {}", description.trim().shown())?;
    }
    writeln!(out)?;
    match &plan.swarm {
        Swarm::Cubes(cubes) => write_cubes(out, plan, cubes)?,
        Swarm::Metamodules(metamodules) => write_metamodules(out, plan, metamodules)?,
    }
    write_link(out, plan)?;
    let stop = &plan.stop;
    writeln!(
        out,
        "  ends      at {} at the latest; standing still {} is a deadlock, nothing new filled for {} a livelock",
        stop.timeout, stop.stall, stop.livelock
    )?;
    if plan.is_beyond {
        writeln!(
            out,
            "            so much is lost that standing still may be waiting; for a surer verdict set stall in [stop]"
        )?;
    }
    write_faults(out, plan)?;
    writeln!(out)?;
    writeln!(out, "  run it with {}", plan.repeat_here())
}

fn write_cubes(out: &mut String, plan: &Plan, Cubes { cells, setup }: &Cubes) -> std::fmt::Result {
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

fn write_metamodules(out: &mut String, plan: &Plan, swarm: &Metamodules) -> std::fmt::Result {
    let (setup, all) = (&swarm.setup, swarm.poses.len());
    let (floor, params) = (setup.floor, &setup.params);
    let places = if swarm.drawn { "drawn" } else { "listed" };
    writeln!(
        out,
        "  swarm     {} of kind {}, numbered 0 to {}, on a floor from {:?} to {:?}",
        many(all as u64, "metamodule"),
        setup.kind(),
        all - 1,
        floor.min,
        floor.max
    )?;
    let feet: Vec<String> = swarm.poses.iter().take(SHOWN).map(|p| format!("{:?}", p.foot())).collect();
    let dots = if all > SHOWN { ", …" } else { "" };
    let redrawn = match swarm.redrawn {
        0 => String::new(),
        1 => " (one draw before had a metamodule that was shut in)".to_owned(),
        n => format!(" ({n} draws before had a metamodule that was shut in)"),
    };
    writeln!(out, "  start     {places}: {}{dots}{redrawn}", feet.join(", "))?;
    writeln!(
        out,
        "  moves     {} for a step of a joint, {} to connect; {} of connections fail; heard {} connectors away",
        params.turn_time, params.connect_time, plan.failure, params.hearing
    )?;
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
    let teller = match params.teller {
        Teller::Controller => "the controller",
        Teller::Neighbours => "neighbours",
    };
    let relocates = if swarm.relocate { "; a goal that cannot be built where it is is moved" } else { "" };
    let detects = if params.detector.is_some() { "; the swarm finds deadlocks by itself" } else { "" };
    writeln!(
        out,
        "  protocol  strategy {}{}; {teller} tells which seeds are open{relocates}{detects}",
        params.strategy.name(),
        field(params),
    )
}

/// What varies the force field of the published strategies.
fn field(params: &Params) -> String {
    if params.strategy == Strategy::Negotiated {
        return String::new();
    }
    let first = match params.precedence {
        None => "no precedence".to_owned(),
        Some(Precedence { within, by: PrecedenceBy::SeedDistance }) => {
            format!("the one nearer to a seed goes first within {within} connectors")
        }
        Some(Precedence { within, by: PrecedenceBy::Id }) => {
            format!("the smaller number goes first within {within} connectors")
        }
    };
    let Repulsion { strength, decay, range } = params.repulsion;
    let settled = if params.settled_repel { "settled ones too" } else { "settled ones not" };
    match strength {
        0 => format!("; {first}; nobody pushes"),
        _ => format!(
            "; {first}; neighbours within {range} cells push by {strength}/1000, {decay}/1000 of it lost at the edge, {settled}"
        ),
    }
}

fn write_link(out: &mut String, plan: &Plan) -> std::fmt::Result {
    let link = &plan.link;
    match plan.overrides.link {
        LinkKind::Ipc => write!(
            out,
            "  link      ipc, {}, {} scenario seconds per second",
            many(plan.swarm.len() as u64, "process"),
            plan.time_scale
        )?,
        LinkKind::Sim => write!(out, "  link      sim, seed {}", plan.seed)?,
    }
    match (link.delay_min, link.delay_max) {
        (min, max) if max.0 == 0 && min.0 == 0 => write!(out, "; no added delay")?,
        (min, max) if min == max => write!(out, "; delay {min}")?,
        (min, max) => write!(out, "; delay {min} to {max}")?,
    }
    let rates: [(&str, Ratio); 4] = [
        ("loss", link.loss),
        ("duplication", link.duplicate),
        ("reorder", link.reorder),
        ("corruption", link.corrupt),
    ];
    for (name, rate) in rates.iter().filter(|(_, rate)| !rate.is_zero()) {
        write!(out, "; {name} {rate}")?;
    }
    if let Some(until) = link.harmless_from {
        write!(out, "; until {until}")?;
    }
    writeln!(out)?;
    for cut in &link.partitions {
        let side = many(cut.side.len() as u64, "module");
        writeln!(out, "            {side} cut off from {} to {}", cut.from, cut.until)?;
    }
    Ok(())
}

fn write_faults(out: &mut String, plan: &Plan) -> std::fmt::Result {
    let mut name = "faults";
    for (at, fault) in plan.schedule.iter().take(SHOWN) {
        writeln!(out, "  {name:<8}  at {} {fault}", at_ms(*at))?;
        name = "";
    }
    match plan.schedule.len().saturating_sub(SHOWN) {
        0 if plan.schedule.is_empty() => writeln!(out, "  faults    none"),
        0 => Ok(()),
        more => writeln!(out, "            … and {} more", count(more as u64)),
    }
}

/// Drawn times have nanoseconds that nobody wants to read.
fn at_ms(at: Time) -> Time {
    Time(at.0 / 1_000_000 * 1_000_000)
}

fn corners(cells: &[Cell]) -> (Cell, Cell) {
    let fold = |f: fn(i16, i16) -> i16| {
        let first = cells.first().copied().unwrap_or_default();
        cells.iter().fold(first, |a, c| Cell::new(f(a.x, c.x), f(a.y, c.y), f(a.z, c.z)))
    };
    (fold(i16::min), fold(i16::max))
}
