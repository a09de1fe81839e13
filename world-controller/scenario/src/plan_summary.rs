//! The description of a plan, for `metamorph check`.

use crate::{LinkKind, Plan, hosts_summary};
use metamorph_core::link::{ControllerLink, LinkModel};
use metamorph_core::time::Time;
use metamorph_kernel::director::faults::{Origin, Scheduled};
use metamorph_kernel::director::rescue::Rescue;
use metamorph_text::escape::Shown;
use metamorph_text::format::{count, many};
use std::fmt::Write;

/// The number of the longest standstills for which a run should have time.
const STANDSTILLS: u64 = 4;
/// Largest number of faults listed; the rest is counted.
const SHOWN_MAX: usize = 20;

/// Describes the plan.
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
    plan.swarm.describe(plan, out)?;
    write_link(out, plan)?;
    let stop = &plan.stop;
    write!(out, "  ends      at {} at the latest; ", stop.timeout)?;
    match plan.swarm.words().collisions {
        Some(_) => {
            let (stall, livelock) = (stop.stall, stop.livelock);
            writeln!(out, "no move for {stall} is a deadlock, nothing new filled for {livelock} a livelock")?;
        }
        None => writeln!(out, "no report for {} is a deadlock", stop.stall)?,
    }
    if stop.timeout.since(Time::ZERO) < stop.stall * STANDSTILLS {
        writeln!(
            out,
            "            that is soon: a swarm that stands still for a while may need longer; raise timeout in [stop], or leave it out"
        )?;
    }
    if plan.is_beyond {
        writeln!(
            out,
            "            messages are lost so often that a standstill may only be a wait; set stall in [stop] to be sure"
        )?;
    }
    writeln!(out, "  rescue    {}", rescue(plan))?;
    write_faults(out, plan)?;
    for note in &plan.notes {
        writeln!(out, "  note      {}", note.shown())?;
    }
    writeln!(out)?;
    writeln!(out, "  run it with {}", plan.repeat_here())
}

/// Describes the help that the controller gives to a swarm that stands still.
fn rescue(plan: &Plan) -> &'static str {
    match plan.rescue {
        _ if !plan.swarm.has_rescue() => {
            "none: the controller does not help modules of this family that stand still"
        }
        Rescue::Off => "off: the controller does not help modules that stand still",
        Rescue::Calls => {
            "calls: if something is broken and modules stand still, the controller calls single ones"
        }
        Rescue::Plans => {
            "plans: if something is broken and modules stand still, the controller calls single ones, then moves them by a plan"
        }
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
    write!(out, "; {}", hosts_summary::rates(link))?;
    if let Some(until) = link.harmless_from {
        write!(out, "; until {until}")?;
    }
    writeln!(out)?;
    for between in link.between.iter().take(SHOWN_MAX) {
        writeln!(out, "            {}", hosts_summary::between(between))?;
    }
    if link.between.len() > SHOWN_MAX {
        writeln!(
            out,
            "            … and {} more links of their own",
            count((link.between.len() - SHOWN_MAX) as u64)
        )?;
    }
    for cut in &link.partitions {
        let side = many(cut.side.len() as u64, "module");
        writeln!(out, "            {side} cut off from {} to {}", cut.from, cut.until)?;
    }
    if let Some(controller) = &link.controller {
        let ControllerLink { delay_min, delay_max, loss } = *controller;
        let rates = LinkModel { delay_min, delay_max, loss, ..LinkModel::default() };
        writeln!(out, "            orders and reports: {}", hosts_summary::rates(&rates))?;
    }
    link.hosts.as_ref().map_or(Ok(()), |hosts| hosts_summary::write(out, plan, hosts))
}

fn write_faults(out: &mut String, plan: &Plan) -> std::fmt::Result {
    let mut name = "faults";
    for Scheduled { at, fault, by } in plan.schedule.iter().take(SHOWN_MAX) {
        let by = if *by == Origin::Scenario { String::new() } else { format!(", {by}") };
        writeln!(out, "  {name:<8}  at {} {fault}{by}", at_ms(*at))?;
        name = "";
    }
    match plan.schedule.len().saturating_sub(SHOWN_MAX) {
        0 if plan.schedule.is_empty() => writeln!(out, "  faults    none"),
        0 => Ok(()),
        more => writeln!(out, "            … and {} more", count(more as u64)),
    }
}

/// Rounds a drawn time down to milliseconds, for display.
fn at_ms(at: Time) -> Time {
    Time(at.0 / 1_000_000 * 1_000_000)
}
