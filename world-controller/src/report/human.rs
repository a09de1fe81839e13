//! The report as a person reads it: outcome first, then numbers, then how to repeat it.

use super::Words;
use super::schema::{ClassCounts, ProofReport, Report, Standstill};
use crate::gauge::Status;
use crate::scenario::Plan;
use crate::shown::Shown;
use crate::terminal::Paint;
use metamorph_protocol::time::Time;
use metamorph_sim_bridge::director::Progress;
use std::fmt::Write;

/// The mean speed of the clock, as a share of the scenario's, from which on nothing is said of it.
const UNSLOWED: f64 = 0.99;
/// Faults and violations shown; JSON has them all.
const SHOWN: usize = 12;

/// The report as text, coloured if `paint` is.
pub fn human(report: &Report, paint: Paint) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_all(&mut out, report, paint);
    out
}

fn write_all(out: &mut String, r: &Report, paint: Paint) -> std::fmt::Result {
    let outcome = r.outcome.to_uppercase();
    let outcome = if r.outcome == "built" { paint.good(&outcome) } else { paint.bad(&outcome) };
    writeln!(out, "{outcome}  {}", r.scenario.shown())?;
    writeln!(out, "  {}", r.reason)?;
    writeln!(out)?;
    let g = &r.goal;
    let words = Words::of(r.family.parse().unwrap_or_default());
    let share = percent(g.filled, g.cells);
    writeln!(out, "  goal        {} of {} {} filled ({share})", g.filled, g.cells, words.cells)?;
    if r.stages.len() > 1 {
        for s in &r.stages {
            let built = s.built_s.map_or("not built".to_owned(), |t| format!("built at {}", seconds(t)));
            writeln!(out, "              {}: {} of {}, {built}", s.name.shown(), s.filled, s.cells)?;
        }
    }
    let a = &r.agents;
    let kind = if r.link == "ipc" { "processes" } else { "agents" };
    writeln!(
        out,
        "  {kind:<11} {} launched, {} alive, {} crashed, {} restarted",
        a.launched, a.alive, a.crashed, a.restarted
    )?;
    write_moves(out, r)?;
    let (c, t) = (&r.collisions, &r.time);
    writeln!(
        out,
        "  collisions  {} attempted, {} prevented by {}, {} by {}, {} suffered",
        count(c.attempted),
        count(c.prevented),
        words.negotiation,
        count(c.refused),
        words.body,
        c.suffered
    )?;
    writeln!(
        out,
        "  time        {} in the scenario ({:.0} {}), {} real, {} to set up",
        seconds(t.virtual_s),
        t.move_times,
        words.beats,
        seconds(t.wall_s),
        seconds(t.setup_s)
    )?;
    if let Some(slowed) = t.slowed.as_ref().filter(|s| s.factor < UNSLOWED) {
        writeln!(
            out,
            "  slowed      to {:.0}% of its speed in the mean, {:.0}% at the least, because the machine was busy",
            slowed.factor * 100.0,
            slowed.lowest * 100.0
        )?;
    }
    let broken = if r.invariants.broken == 0 {
        "0 broken".to_owned()
    } else {
        paint.bad(&format!("{} broken", count(r.invariants.broken)))
    };
    writeln!(out, "  invariants  {} checks, {broken}", count(r.invariants.checked))?;
    for v in r.invariants.violated.iter().take(SHOWN) {
        writeln!(out, "              {} at {}: {}", v.invariant, seconds(v.at_s), v.what)?;
    }
    writeln!(out)?;
    write_messages(out, r, paint)?;
    if let Some(unbuilt) = &r.unbuilt {
        write_unbuilt(out, unbuilt, &words, paint)?;
    }
    if !r.faults.is_empty() || r.faults_planned > 0 {
        writeln!(out)?;
        writeln!(
            out,
            "  {} ({} of {} planned struck)",
            paint.strong("faults"),
            r.faults.len(),
            r.faults_planned
        )?;
        for f in r.faults.iter().take(SHOWN) {
            let whom = f.module.map(|m| m.to_string()).unwrap_or_default();
            writeln!(out, "    {:>9}  {:<8}{:>6}  {}", seconds(f.at_s), f.fault, whom, f.effect)?;
        }
        more(out, r.faults.len())?;
    }
    for note in &r.notes {
        writeln!(out, "  note: {note}")?;
    }
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

fn write_moves(out: &mut String, r: &Report) -> std::fmt::Result {
    let per_module = r.moves as f64 / r.agents.launched.max(1) as f64;
    let (moves, failed) = (count(r.moves), count(r.move_details.failed));
    let Some(m) = &r.metamodules else {
        return writeln!(out, "  moves       {moves} completed ({per_module:.1} a module), {failed} failed");
    };
    writeln!(
        out,
        "  moves       {moves} connections ({per_module:.1} a metamodule of kind {}), {} steps of joints, {failed} failed",
        m.kind,
        count(m.turns)
    )?;
    let levels: Vec<String> = m.levels.iter().map(|l| format!("{} of {}", l.filled, l.seeds)).collect();
    let moved = match m.shift {
        [0, 0] => String::new(),
        [x, y] => format!("; moved by ({x}, {y}) to where it could be built"),
    };
    writeln!(out, "  levels      {} seeds, from the ground up{moved}", levels.join(", "))?;
    if r.goal.filled > 0 {
        writeln!(out, "  last seed   filled at {}", seconds(m.last_fill_s))?;
    }
    Ok(())
}

fn write_messages(out: &mut String, r: &Report, paint: Paint) -> std::fmt::Result {
    let header = format!(
        "  {:<13}{:>12}{:>12}{:>10}{:>8}{:>10}{:>10}{:>9}{:>11}",
        "messages", "sent", "delivered", "lost", "dup", "overflow", "expired", "refused", "bytes"
    );
    writeln!(out, "{}", paint.strong(&header))?;
    let mut line = |name: &str, c: &ClassCounts| {
        writeln!(
            out,
            "  {name:<13}{:>12}{:>12}{:>10}{:>8}{:>10}{:>10}{:>9}{:>11}",
            count(c.sent),
            count(c.delivered),
            count(c.lost),
            count(c.duplicated),
            count(c.overflowed),
            count(c.expired),
            count(c.refused),
            bytes(c.bytes)
        )
    };
    for (class, counts) in r.messages.by_class.iter().filter(|(_, c)| c.sent > 0) {
        line(class, counts)?;
    }
    line("all", &r.messages.all)?;
    let per_module = r.messages.total as f64 / r.agents.launched.max(1) as f64;
    writeln!(
        out,
        "  {per_module:.0} a module, {} in flight at the end; apart from these {} to and from bodies",
        count(r.messages.all.in_flight.unsigned_abs()),
        count(r.body_messages)
    )
}

fn write_unbuilt(out: &mut String, s: &Standstill, words: &Words, paint: Paint) -> std::fmt::Result {
    let cells: Vec<String> = s.unfilled.iter().take(5).map(|c| format!("{c:?}")).collect();
    let dots = if s.unfilled.len() > 5 { ", …" } else { "" };
    writeln!(out)?;
    writeln!(out, "  {} since {}: {}", paint.strong("unbuilt"), seconds(s.since_s), s.text)?;
    let what = if s.unfilled.len() == 1 { words.cell } else { words.cells };
    writeln!(out, "    {} {what}: {}{dots}", s.unfilled.len(), cells.join(", "))?;
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

/// What a proof says, in words.
pub fn proved(proof: &ProofReport) -> String {
    let here = format!(
        "no moves fill another seed ({} arrangements were looked at, all there are)",
        count(proof.arrangements)
    );
    match proof.places {
        None => here,
        Some(0) => format!("{here}, and no other place is clear of what stays"),
        Some(n) => {
            format!("{here}, and the goal cannot be built at any of the {} places that are clear", count(n))
        }
    }
}

fn more(out: &mut String, all: usize) -> std::fmt::Result {
    match all.saturating_sub(SHOWN) {
        0 => Ok(()),
        n => writeln!(out, "    … and {n} more; --json has them all"),
    }
}

/// One line that says how far a run has come.
pub fn progress(plan: &Plan, now: Time, p: &Progress) -> Status {
    Status {
        now_s: now.as_secs_f64(),
        stage: (p.stage + 1, p.stages),
        filled: p.filled as u64,
        goal: p.goal as u64,
        parts: Words::of(plan.swarm.family()).cells,
        alive: p.alive as u64,
        moves: p.moves,
        messages: p.messages,
        speed: 1.0,
    }
}

pub fn percent(part: u64, whole: u64) -> String {
    format!("{}%", part * 100 / whole.max(1))
}

/// Thousands apart, so that long numbers can be read.
pub fn count(n: u64) -> String {
    let digits = n.to_string();
    let mut out = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}

pub fn bytes(n: u64) -> String {
    match n {
        0..10_000 => format!("{n} B"),
        10_000..10_000_000 => format!("{} kB", count(n / 1_000)),
        _ => format!("{} MB", count(n / 1_000_000)),
    }
}

/// A length of time as short as it can be said.
pub fn seconds(s: f64) -> String {
    if s < 0.000_5 {
        "0 s".to_owned()
    } else if s < 1.0 {
        format!("{:.0} ms", s * 1_000.0)
    } else {
        format!("{s:.1} s")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_readable() {
        assert_eq!(count(0), "0");
        assert_eq!(count(999), "999");
        assert_eq!(count(1_234_567), "1,234,567");
        assert_eq!(bytes(123_456_789), "123 MB");
        assert_eq!(seconds(0.012), "12 ms");
        assert_eq!(percent(1, 3), "33%");
    }
}
