//! Results beyond a single experiment, as text for the terminal: readings of the thesis beside its tables,
//! the effect of each assumption, what stays unexplained.

use super::assumptions::{self, Assumption, NOT_OFFERED};
use super::claims::probability;
use super::compare::Reproduction;
use super::fit::{Fit, FitCell};
use super::published::STRATEGIES;
use super::text::{write_item, write_list};
use metamorph_report::statistics::{Discrepancy, Rate};
use metamorph_text::format::percent;
use metamorph_text::paint::Paint;
use metamorph_text::table::Table;
use std::fmt::Write;

/// Writes all of it.
pub fn write_readings(out: &mut String, all: &Reproduction, paint: Paint) -> std::fmt::Result {
    writeln!(out, "{}\n", paint.strong("Built: the thesis, and readings of its text"))?;
    let mut table = Table::new(&["", "", "thesis"]);
    table.head(&["95 % interval"]);
    for fit in &all.fits {
        table.head(&[&fit.reading, "95 % interval", "p"]);
    }
    let cells = all.fits.first().map_or(&[][..], |f| &f.cells);
    for (i, cell) in cells.iter().enumerate() {
        let theirs = format!("{} of {}", cell.published_built, cell.published_runs);
        let mut numbers = vec![interval(cell.published)];
        for FitCell { ours, p, .. } in all.fits.iter().filter_map(|f| f.cells.get(i)) {
            numbers.extend([share(*ours), interval(*ours), p.map_or("–".to_owned(), probability)]);
        }
        table.row(&[cell.goal.clone(), cell.strategy.clone(), theirs], numbers);
    }
    let kinds = all.fits.first().map_or(&[][..], |f| &f.kinds);
    for (i, kind) in kinds.iter().enumerate() {
        let theirs = format!("{} of {}", kind.published_built, kind.published_runs);
        let mut numbers = vec![interval(Rate::wilson(kind.published_built, kind.published_runs))];
        for kind in all.fits.iter().filter_map(|f| f.kinds.get(i)) {
            numbers.extend([percent(kind.ours), String::new(), String::new()]);
        }
        table.row(&["all".to_owned(), kind.kind.clone(), theirs], numbers);
    }
    out.push_str(&table.text(paint));
    writeln!(out)?;
    write_item(out, "p: Fisher's exact test of the thesis's runs and ours, all kinds and orders together")?;
    for fit in &all.fits {
        write_item(out, &described(fit))?;
    }
    let tests: Vec<String> = all
        .published_tests
        .iter()
        .map(|t| {
            let [(a, of_a), (b, of_b)] = t.counts;
            format!("{} {a} of {of_a} and {b} of {of_b}, p = {}", t.what, t.p.map_or("–".into(), probability))
        })
        .collect();
    write_item(out, &format!("what the published counts tell apart by themselves: {}", tests.join("; ")))?;
    write_assumptions(out, all, paint)?;
    if !all.redrawn.is_empty() {
        let (shut_in, drawn) = all.redrawn.iter().fold((0, 0), |(s, d), r| (s + r.shut_in, d + r.drawn));
        let each: Vec<String> = all
            .redrawn
            .iter()
            .map(|r| format!("{} {} {}", r.goal, r.kind, percent(r.shut_in as f64 / r.drawn.max(1) as f64)))
            .collect();
        let share = percent(shut_in as f64 / drawn.max(1) as f64);
        write_item(
            out,
            &format!(
                "starts redrawn because a metamodule was enclosed: {shut_in} of {drawn}, {share} ({})",
                each.join(", ")
            ),
        )?;
    }
    if !all.unexplained.is_empty() {
        writeln!(out, "\n{}", paint.strong("What the nearest reading leaves unexplained"))?;
        write_list(out, &all.unexplained)?;
    }
    writeln!(out)
}

/// Describes a reading, and its deviation from the thesis.
pub fn described(fit: &Fit) -> String {
    let over = |name: &str, of: Option<Discrepancy>| match of {
        Some(d) => {
            let x2 = d.x2.map_or("infinite".to_owned(), |x| format!("{x:.1}"));
            format!("; over {name} X² = {x2}, exact p = {}", probability(d.p))
        }
        None => String::new(),
    };
    format!(
        "{}: {}{}{}",
        fit.reading,
        fit.says,
        over(&format!("these {} cells", fit.cells.len()), fit.all_cells),
        over("kinds", fit.all_kinds)
    )
}

fn share(rate: Option<Rate>) -> String {
    rate.map_or("–".to_owned(), |r| percent(r.rate))
}

fn interval(rate: Option<Rate>) -> String {
    rate.map_or("–".to_owned(), |r| format!("{} to {}", percent(r.low), percent(r.high)))
}

/// Returns the strategies and goals that assumptions have numbers for, in the order of the columns.
pub fn columns(all: &Reproduction) -> Vec<(String, String)> {
    let cells = all.fits.first().map_or(&[][..], |f| &f.cells);
    cells.iter().map(|c| (c.goal.clone(), c.strategy.clone())).collect()
}

/// Formats the share of a column that was built with an assumption.
pub fn built(assumption: &Assumption, column: &(String, String)) -> String {
    let found = assumption.built.iter().find(|b| b.goal == column.0 && b.strategy == column.1);
    found.and_then(|b| b.built).map_or("–".to_owned(), |r| percent(r.rate))
}

/// Returns the command that varies an assumption.
pub fn command(seeds: u64) -> String {
    let axes = assumptions::axes(&STRATEGIES);
    let vary: Vec<String> = axes.iter().map(|a| format!("--vary {a}")).collect();
    format!("metamorph sweep GOAL.toml --seeds 0..{} {} --vary", assumptions::seeds(seeds), vary.join(" "))
}

fn write_assumptions(out: &mut String, all: &Reproduction, paint: Paint) -> std::fmt::Result {
    if all.assumptions.is_empty() {
        return Ok(());
    }
    writeln!(
        out,
        "\n{}\n",
        paint.strong("Built: what each assumption does, varied alone from the text's reading")
    )?;
    let mut table = Table::new(&["", "with --vary"]);
    let columns = columns(all);
    table.head(
        &columns
            .iter()
            .map(|(goal, strategy)| format!("{goal} {strategy}"))
            .collect::<Vec<_>>()
            .iter()
            .map(String::as_str)
            .collect::<Vec<_>>(),
    );
    let mut row = |what: &str, vary: &str, of: &dyn Fn(usize, &(String, String)) -> String| {
        let numbers = columns.iter().enumerate().map(|(i, c)| of(i, c)).collect();
        table.whole_row(&[what.to_owned(), vary.to_owned()], numbers);
    };
    let cells = |fit: Option<&Fit>| fit.map_or(Vec::new(), |f| f.cells.clone());
    let text = cells(all.fits.first());
    row("the thesis", "", &|i, _| share(text[i].published));
    row("the text's reading", "", &|i, _| share(text[i].ours));
    for assumption in &all.assumptions {
        row(&assumption.what, &assumption.vary.join(" or "), &|_, c| built(assumption, c));
    }
    out.push_str(&table.text(paint));
    writeln!(out)?;
    write_item(
        out,
        &format!(
            "each row is a sweep of box.toml and chair.toml, which --out DIR leaves there: {} KEY=VALUE of the \
             row (repulsion with slope and step alone; two values: of the box and of the chair). Intervals are in \
             --json.",
            command(all.seeds)
        ),
    )?;
    write_item(
        out,
        &format!("not offered, because they would need code that the program does not have: {NOT_OFFERED}"),
    )
}
