//! A reproduction as text for the terminal.

use super::compare::{Claim, Compared, Comparison, Ours, Reproduction};
use super::published::Cell;
use super::readings::write_readings;
use metamorph_report::statistics::Rate;
use metamorph_report::statistics::rate;
use metamorph_text::format::percent;
use metamorph_text::format::{count, many};
use metamorph_text::paint::Paint;
use metamorph_text::table::Table;
use std::fmt::Write;

/// Columns of the longest bar.
const BAR: f64 = 40.0;
/// Columns of a line at most.
const WIDTH: usize = 100;

/// Formats everything requested.
pub fn text(all: &Reproduction, paint: Paint) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_all(&mut out, all, paint);
    out
}

fn write_all(out: &mut String, all: &Reproduction, paint: Paint) -> std::fmt::Result {
    writeln!(out, "The thesis's experiment, re-implemented: the nearest reading of its text\n")?;
    for experiment in &all.experiments {
        writeln!(out, "{}\n", paint.strong(&experiment.title))?;
        if experiment.sums.is_empty() {
            write_bars(out, experiment)?;
        } else {
            write_table(out, experiment, paint)?;
            write_sums(out, experiment, paint)?;
        }
        write_claims(out, &experiment.claims, paint)?;
        write_list(out, &experiment.unknown)?;
        writeln!(out)?;
    }
    write_readings(out, all, paint)?;
    writeln!(out, "{}", paint.strong("What the thesis does not say, and what is taken here"))?;
    write_list(out, &all.unknown)?;
    if all.violations > 0 {
        writeln!(out, "{}", paint.bad(&format!("\n{} of invariants", many(all.violations, "violation"))))?;
    }
    Ok(())
}

/// Writes two columns of keys, then the thesis's numbers, then ours.
fn write_table(out: &mut String, experiment: &Comparison, paint: Paint) -> std::fmt::Result {
    let mut table = Table::new(&["", "", "thesis"]);
    table.head(&["DL", "CL each", "not built here", "95 % interval", "circular", "crosswise", "at-once"]);
    table.head(&["collisions", "moves", "built"]);
    let mut before = "";
    for cell in &experiment.cells {
        let kind = if cell.kind == before { String::new() } else { cell.kind.clone() };
        before = &cell.kind;
        let (not_built, interval) = rate(cell.ours.not_built);
        let mut numbers = vec![
            cell.published_deadlocks.map_or(String::new(), |_| dead(&cell.published)),
            cell.published_collisions.map_or(String::new(), |c| format!("{c:.1}")),
            not_built,
            interval,
        ];
        numbers.extend(cell.by_order.iter().map(|(_, ours)| share(ours.not_built)));
        numbers.extend([cell.ours.collisions, cell.ours.moves].map(tenths));
        numbers.push(count(cell.ours.built));
        table.row(&[kind, cell.strategy.clone(), printed(&cell.published)], numbers);
    }
    out.push_str(&table.text(paint));
    writeln!(out)?;
    let each = experiment.cells.iter().map(|c| c.published.len()).max().unwrap_or(0);
    write_list(
        out,
        &[
            format!(
                "thesis: collisions of {each} experiments, * for a deadlock; CL each: mean of those without"
            ),
            format!("{each} runs of a cell are too few to compare; tests of their sums are below"),
            "collisions and moves are means of the runs that were built".to_owned(),
        ],
    )
}

/// Formats the experiments as printed.
pub fn printed(cells: &[Cell]) -> String {
    cells.iter().map(|c| c.text()).collect::<Vec<_>>().join(" ")
}

/// Formats the number of deadlocks.
pub fn dead(cells: &[Cell]) -> String {
    format!("{} of {}", super::published::deadlocks(cells), cells.len())
}

fn share(rate: Option<Rate>) -> String {
    rate.map_or("–".to_owned(), |r| percent(r.rate))
}

fn tenths(value: Option<f64>) -> String {
    value.map_or("–".to_owned(), |v| format!("{v:.1}"))
}

fn write_sums(out: &mut String, experiment: &Comparison, paint: Paint) -> std::fmt::Result {
    let wrong: Vec<String> = experiment
        .sums
        .iter()
        .filter(|s| !s.agrees())
        .map(|s| format!("{} is printed as {}, its cells add up to {}", s.what, s.printed, s.cells))
        .collect();
    let all: Vec<String> = experiment.sums.iter().map(|s| format!("{} {}", s.what, s.printed)).collect();
    write_item(out, &format!("sums as printed: {}", all.join(", ")))?;
    for text in wrong {
        write_item(out, &paint.bad(&text))?;
    }
    Ok(())
}

fn write_bars(out: &mut String, experiment: &Comparison) -> std::fmt::Result {
    let longest = experiment.cells.iter().filter_map(|c| c.ours.moves).fold(0.0, f64::max);
    let (mut goal, mut kind) = ("", "");
    writeln!(out, "  Mean moves of the runs that were built")?;
    for cell in &experiment.cells {
        if cell.goal != goal {
            writeln!(out, "\n  {}", cell.goal)?;
        }
        let name = if cell.goal == goal && cell.kind == kind { "" } else { &cell.kind };
        (goal, kind) = (&cell.goal, &cell.kind);
        writeln!(out, "    {name:<4} {:<11} {}", cell.strategy, bar(&cell.ours, longest))?;
    }
    writeln!(out)
}

/// Draws a bar relative to the longest, with its number.
fn bar(ours: &Ours, longest: f64) -> String {
    let Some(moves) = ours.moves else { return "none was built".to_owned() };
    let eighths = (moves / longest.max(1e-9) * BAR * 8.0).round() as usize;
    let part = ["", "▏", "▎", "▍", "▌", "▋", "▊", "▉"][eighths % 8];
    format!("{}{part} {moves:.1}  ({} built)", "█".repeat(eighths / 8), count(ours.built))
}

fn write_claims(out: &mut String, claims: &[Claim], paint: Paint) -> std::fmt::Result {
    for claim in claims {
        let verdict = verdict(claim);
        let verdict = if claim.holds == Some(false) { paint.bad(verdict) } else { verdict.to_owned() };
        let tables = match claim.by_tables {
            Some(false) => paint.bad(" (its own tables do not show it)"),
            Some(true) => " (its tables show it)".to_owned(),
            None => String::new(),
        };
        let chance = claim.chance.map_or(String::new(), |c| {
            format!("; {:.0} % of experiments of its size drawn from our runs show it", c * 100.0)
        });
        write_item(
            out,
            &format!("the thesis says: {}{tables}; {verdict}: {}{chance}", claim.says, claim.found),
        )?;
    }
    Ok(())
}

/// Says whether a claim holds.
pub fn verdict(claim: &Claim) -> &'static str {
    match (claim.holds, claim.chance) {
        (Some(true), _) => "it holds here",
        (Some(false), _) => "it does not hold here",
        (None, Some(_)) => "undecided with as few runs",
        (None, None) => "undecided",
    }
}

/// Writes texts as items of a list.
pub fn write_list(out: &mut String, items: &[String]) -> std::fmt::Result {
    items.iter().try_for_each(|item| write_item(out, item))
}

/// Writes a text as an item of a list, broken into lines.
pub fn write_item(out: &mut String, text: &str) -> std::fmt::Result {
    let mut line = "  -".to_owned();
    for word in text.split(' ') {
        if line.chars().count() + 1 + word.chars().count() > WIDTH {
            writeln!(out, "{line}")?;
            line = "   ".to_owned();
        }
        line.push(' ');
        line.push_str(word);
    }
    writeln!(out, "{line}")
}

/// Returns the label of a cell.
pub fn label(cell: &Compared) -> String {
    format!("{} · {}", cell.kind, cell.strategy)
}
