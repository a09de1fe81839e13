//! The report as text: outcome first, then numbers, then how to repeat the run.

use super::Words;
use super::schema::{ClassCounts, EXTERNAL, FaultReport, ProofReport, Report, Standstill};
use metamorph_core::time::Time;
use metamorph_kernel::director::progress::Progress;
use metamorph_scenario::Plan;
use metamorph_text::escape::Shown;
use metamorph_text::format::{bytes, count, duration, many, seconds, whole_percent};
use metamorph_text::paint::Paint;
use metamorph_text::progress::Status;
use metamorph_text::table::Table;
use std::fmt::Write;

/// Mean relative speed of the clock from which it is not reported as slowed.
const UNSLOWED: f64 = 0.99;
/// Largest number of faults and violations listed; JSON has them all.
const SHOWN_MAX: usize = 12;

/// Formats the report as text.
pub fn human(report: &Report, words: &Words, paint: Paint) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_all(&mut out, report, words, paint);
    out
}

fn write_all(out: &mut String, r: &Report, words: &Words, paint: Paint) -> std::fmt::Result {
    let outcome = r.outcome.to_uppercase();
    let outcome = if r.outcome == "built" { paint.good(&outcome) } else { paint.bad(&outcome) };
    writeln!(out, "{outcome}  {}", r.scenario.shown())?;
    writeln!(out, "  {}", r.reason)?;
    writeln!(out)?;
    let g = &r.goal;
    let share = whole_percent(g.filled, g.cells);
    writeln!(
        out,
        "  goal        {} of {} {} ({share})",
        count(g.filled),
        many(g.cells, words.part),
        words.filled
    )?;
    if let [only] = &r.stages[..]
        && let Some(share) = only.share_of_shape()
    {
        writeln!(out, "              {share}")?;
    }
    if r.stages.len() > 1 {
        for s in &r.stages {
            let built = s.built_s.map_or("not built".to_owned(), |t| format!("built at {}", seconds(t)));
            let of = format!("{} of {}", count(s.filled), count(s.cells));
            let share = s.share_of_shape().map_or(String::new(), |share| format!("; {share}"));
            writeln!(out, "              {}: {of}, {built}{share}", s.name.shown())?;
        }
    }
    let a = &r.agents;
    let kind = if r.link == "ipc" { "processes" } else { "agents" };
    writeln!(
        out,
        "  {kind:<11} {} launched, {} alive, {} crashed, {} restarted",
        count(a.launched),
        count(a.alive),
        count(a.crashed),
        count(a.restarted)
    )?;
    if words.collisions.is_some() {
        write_moves(out, r)?;
    }
    write_standstills(out, r)?;
    write_collisions_and_time(out, r, words)?;
    write_invariants(out, r, paint)?;
    writeln!(out)?;
    write_messages(out, r, paint)?;
    if let Some(unbuilt) = &r.unbuilt {
        write_unbuilt(out, unbuilt, words, paint)?;
    }
    write_faults(out, r, paint)?;
    if let Some(operator) = &r.operator {
        writeln!(out, "  operator    {}", operator.text())?;
    }
    for note in &r.notes {
        writeln!(out, "  note: {note}")?;
    }
    if let Some(logs) = &r.logs {
        writeln!(out, "  logs        of run {}: {}", logs.run, logs.places().join("; "))?;
    }
    write_identity(out, r)
}

/// Writes how many standstills there were, and what ended them.
fn write_standstills(out: &mut String, r: &Report) -> std::fmt::Result {
    let Some(standstills) = r.standstills.as_ref().filter(|standstills| standstills.count > 0) else {
        return Ok(());
    };
    let words = [
        ("itself", "ended by themselves"),
        ("call", "by calls of the controller"),
        ("plan", "by a plan of the controller"),
        ("relocation", "by moving the goal"),
        ("operator", "by an operator"),
        ("nothing", "until the run ended"),
    ];
    let ended = |(name, how): (&str, &str)| {
        let n = standstills.ended.get(name).copied().filter(|n| *n > 0)?;
        Some(format!("{} {how}", count(n)))
    };
    let ended: Vec<String> = words.into_iter().filter_map(ended).collect();
    let rescue =
        if standstills.rescue == "none" { String::new() } else { format!("; rescue {}", standstills.rescue) };
    writeln!(out, "  standstills {}: {}{rescue}", count(standstills.count), ended.join(", "))
}

/// Writes the collisions and the times of the run.
fn write_collisions_and_time(out: &mut String, r: &Report, words: &Words) -> std::fmt::Result {
    let (c, t) = (&r.collisions, &r.time);
    if let Some([negotiation, body]) = words.collisions {
        writeln!(
            out,
            "  collisions  {} attempted, {} prevented by {negotiation}, {} by {body}, {} suffered",
            count(c.attempted),
            count(c.prevented),
            count(c.refused),
            count(c.suffered)
        )?;
    }
    let steps = words.collisions.map(|_| many(t.move_times.round() as u64, words.time_step));
    writeln!(
        out,
        "  time        {} in the scenario{}, {} real, {} to set up",
        seconds(t.virtual_s),
        steps.map_or(String::new(), |steps| format!(" ({steps})")),
        seconds(t.wall_s),
        seconds(t.setup_s)
    )?;
    if let Some(slowed) = t.slowed.as_ref().filter(|s| s.factor < UNSLOWED) {
        writeln!(
            out,
            "  slowed      to {:.0}% of its speed on average, {:.0}% at the lowest, because the machine was busy",
            slowed.factor * 100.0,
            slowed.lowest * 100.0
        )?;
    }
    Ok(())
}

fn write_invariants(out: &mut String, r: &Report, paint: Paint) -> std::fmt::Result {
    let broken = if r.invariants.broken == 0 {
        "0 broken".to_owned()
    } else {
        paint.bad(&format!("{} broken", count(r.invariants.broken)))
    };
    writeln!(out, "  invariants  {}, {broken}", many(r.invariants.checked, "check"))?;
    for v in r.invariants.violated.iter().take(SHOWN_MAX) {
        writeln!(out, "              {} at {}: {}", v.invariant, seconds(v.at_s), v.what)?;
    }
    Ok(())
}

/// Writes how to repeat the run, and the hashes by which two runs are compared.
fn write_identity(out: &mut String, r: &Report) -> std::fmt::Result {
    writeln!(out)?;
    writeln!(out, "  repeat with {}", r.repeat)?;
    if let Some(hash) = &r.trace_hash {
        writeln!(out, "  trace hash  {hash}")?;
    }
    match (&r.state_hash, &r.world_hash) {
        (Some(hash), _) => writeln!(out, "  state hash  {hash}")?,
        (None, Some(hash)) => writeln!(out, "  world hash  {hash}")?,
        (None, None) => {}
    }
    Ok(())
}

fn write_faults(out: &mut String, r: &Report, paint: Paint) -> std::fmt::Result {
    if r.faults.is_empty() && r.faults_planned == 0 {
        return Ok(());
    }
    let external = r.faults.iter().filter(|f| f.by == EXTERNAL).count() as u64;
    let commands = r.faults.iter().filter(|f| commanded(f).is_some()).count() as u64;
    let also = |n: u64, what: &str| if n > 0 { format!(", {} {what}", count(n)) } else { String::new() };
    writeln!(out)?;
    writeln!(
        out,
        "  {} ({} of {} planned struck{}{})",
        paint.strong("faults"),
        count(r.faults.len() as u64 - external - commands),
        count(r.faults_planned),
        also(commands, "by command"),
        also(external, "from outside"),
    )?;
    for f in r.faults.iter().take(SHOWN_MAX) {
        let whom = f.module.map(|m| m.to_string()).unwrap_or_default();
        let by = commanded(f).map(|by| format!(" ({by})")).unwrap_or_default();
        writeln!(out, "    {:>9}  {:<9}{:>6}  {}{by}", seconds(f.at_s), f.fault, whom, f.effect)?;
    }
    more(out, r.faults.len())?;
    Ok(())
}

/// Returns the operator whose command a fault was.
pub fn commanded(fault: &FaultReport) -> Option<&str> {
    Some(fault.by.as_str()).filter(|by| by.starts_with("operator"))
}

fn write_moves(out: &mut String, r: &Report) -> std::fmt::Result {
    let per_module = r.moves as f64 / r.agents.launched.max(1) as f64;
    let (moves, d) = (count(r.moves), &r.move_details);
    if r.family_text.moves.is_empty() {
        let (begun, failed) = (count(d.started), count(d.failed));
        let helped = |n: u64, how: &str| if n == 0 { String::new() } else { format!(", {} {how}", count(n)) };
        let (called, led) =
            (helped(d.called, "called by the controller"), helped(d.led, "led by the controller"));
        writeln!(
            out,
            "  moves       {moves} completed ({per_module:.1} a module) of {begun} begun, {failed} failed{called}{led}"
        )?;
    }
    for (label, text) in &r.family_text.moves {
        writeln!(out, "  {label:<11} {text}")?;
    }
    Ok(())
}

/// A column of the table of messages: its heading, and what it counts.
type Column = (&'static str, fn(&ClassCounts) -> u64);

/// Writes the messages of each class. Columns of nothing but zeros are left out, but for those of messages lost.
fn write_messages(out: &mut String, r: &Report, paint: Paint) -> std::fmt::Result {
    let of_classes = r.messages.by_class.iter().filter(|(_, c)| c.sent > 0);
    let rows: Vec<(&str, &ClassCounts)> = of_classes
        .map(|(class, counts)| (class.as_str(), counts))
        .chain([("all", &r.messages.all)])
        .collect();
    let columns: [Column; 7] = [
        ("sent", |c| c.sent),
        ("delivered", |c| c.delivered),
        ("lost", |c| c.lost),
        ("duplicated", |c| c.duplicated),
        ("overflowed", |c| c.overflowed),
        ("expired", |c| c.expired),
        ("refused", |c| c.refused),
    ];
    let is_shown = |i: usize, of: fn(&ClassCounts) -> u64| i < 3 || of(&r.messages.all) > 0;
    let columns: Vec<_> = columns.into_iter().enumerate().filter(|(i, (_, of))| is_shown(*i, *of)).collect();
    let mut table = Table::new(&["messages"]);
    table.head(&columns.iter().map(|(_, (name, _))| *name).chain(["bytes"]).collect::<Vec<_>>());
    for (name, counts) in rows {
        let numbers = columns.iter().map(|(_, (_, of))| count(of(counts)));
        table.row(&[name.to_owned()], numbers.chain([bytes(counts.bytes)]).collect());
    }
    write!(out, "{}", table.text(paint))?;
    let per_module = r.messages.total as f64 / r.agents.launched.max(1) as f64;
    writeln!(
        out,
        "  {} a module, {} in flight at the end; besides, {} to and from bodies",
        count(per_module.round() as u64),
        count(r.messages.all.in_flight.unsigned_abs()),
        count(r.body_messages)
    )?;
    // A link that takes no time has nothing to say.
    if let Some(latency) = r.messages.latency.as_ref().map(|l| l.all).filter(|all| all.greatest_s > 0.0) {
        let [half, most, all] = [latency.p50_s, latency.p99_s, latency.greatest_s].map(duration);
        writeln!(out, "  latency: half within {half}, 99% within {most}, all within {all}")?;
    }
    r.hosts.as_ref().map_or(Ok(()), |hosts| hosts.write(out, r.messages.total))
}

fn write_unbuilt(out: &mut String, s: &Standstill, words: &Words, paint: Paint) -> std::fmt::Result {
    let open = s.open.iter().take(5).map(String::as_str).collect::<Vec<_>>().join(", ");
    let dots = if s.open.len() > 5 { ", …" } else { "" };
    writeln!(out)?;
    writeln!(out, "  {} since {}: {}", paint.strong("unbuilt"), seconds(s.since_s), s.text)?;
    let unfilled = many(s.open.len() as u64, words.cell);
    writeln!(out, "    {unfilled}: {open}{dots}")?;
    writeln!(out, "    {}", s.prospect)?;
    if !s.wait_cycle.is_empty() {
        let ids: Vec<String> = s.wait_cycle.iter().take(10).map(u32::to_string).collect();
        writeln!(out, "    wait for each other: {}", ids.join(", "))?;
    }
    if let Some(found) = &s.detected {
        let at = seconds(found.at_s);
        writeln!(out, "    {} {} counted all others and found this out at {at}", words.module, found.by)?;
    }
    if let Some(proof) = &s.proof {
        writeln!(out, "    proved: {}", proved(proof))?;
    }
    for w in s.waiting.iter().take(5) {
        match w.waits_for {
            Some(on) => {
                writeln!(out, "    {} {} {}, {}: {on}", words.module, w.module, words.idle, w.why)?;
            }
            None => writeln!(out, "    {} {} {}, {}", words.module, w.module, words.idle, w.why)?,
        }
    }
    Ok(())
}

/// Describes a proof.
pub fn proved(proof: &ProofReport) -> String {
    let here = format!(
        "no moves fill another seed ({} arrangements examined, all that are reachable)",
        count(proof.arrangements)
    );
    match proof.places {
        None => here,
        Some(0) => format!("{here}, and no other place is free of obstacles"),
        Some(n) => {
            format!("{here}, and the goal cannot be built at any of the {} places that are free", count(n))
        }
    }
}

fn more(out: &mut String, all: usize) -> std::fmt::Result {
    match all.saturating_sub(SHOWN_MAX) {
        0 => Ok(()),
        n => writeln!(out, "    … and {} more; --json has them all", count(n as u64)),
    }
}

/// Returns the status line of a run's progress.
pub fn progress(plan: &Plan, now: Time, p: &Progress) -> Status {
    Status {
        now_s: now.as_secs_f64(),
        stage: (p.stage + 1, p.stages),
        filled: p.filled as u64,
        goal: p.goal as u64,
        parts: plan.swarm.words().cells,
        alive: p.alive as u64,
        moves: p.moves,
        messages: p.messages,
        speed: 1.0,
    }
}
