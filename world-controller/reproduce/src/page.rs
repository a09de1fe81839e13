//! A reproduction as one self-contained HTML file, in the style of a sweep's report.

use super::assumptions::NOT_OFFERED;
use super::claims::probability;
use super::compare::{Claim, Compared, Comparison, Reproduction};
use super::readings::{built, columns, command as assumption_command, described};
use super::text::{dead, label, printed, verdict};
use maud::{Markup, html};
use metamorph_report::document::{document, figure};
use metamorph_report::plots::{Row, bars, intervals};
use metamorph_report::statistics::Rate;
use metamorph_report::statistics::rate;
use metamorph_text::format::count;
use metamorph_text::format::percent;

/// Returns the page.
pub fn page(all: &Reproduction) -> String {
    let missing = all.runs_planned - all.runs;
    let title = "Metamodules: the thesis and Metamorph";
    let body = html! {
        h1 { (title) }
        p.lead {
            "The experiment of thesis 4.1.3, re-implemented by the nearest reading of its text, with four kinds of metamodules, the three published strategies and "
            "our own, and three orders of seeds, each with " (count(all.seeds)) " random starts."
        }
        dl.facts {
            div { dt { "runs" } dd { (count(all.runs)) } }
            div {
                dt { "violations of invariants" }
                dd.bad[all.violations > 0] { (count(all.violations)) }
            }
            div { dt { "metamorph" } dd { (all.version) } }
        }
        @if missing > 0 { p.warning { "It was interrupted: " (count(missing)) " runs are missing here." } }
        h2 { "Repeat it" }
        pre.command { (command(all)) }
        p.note { "Every run is simulated and the same on every machine." }
        @for experiment in &all.experiments { (section(experiment)) }
        (readings(all))
        (assumptions(all))
        @if !all.unexplained.is_empty() {
            h2 { "What the nearest reading leaves unexplained" }
            (list(&all.unexplained))
        }
        h2 { "What the thesis does not say, and what is taken here" }
        (list(&all.unknown))
    };
    document(title, body)
}

/// Returns the command that gives the same results.
fn command(all: &Reproduction) -> String {
    let names: Vec<&str> = all.experiments.iter().map(|e| e.name.as_str()).collect();
    format!("metamorph reproduce {} --seeds {}", names.join(" "), all.seeds)
}

fn section(experiment: &Comparison) -> Markup {
    html! {
        h2 { (experiment.title) }
        @if experiment.sums.is_empty() {
            @for (goal, rows) in moves(experiment) {
                (figure(
                    bars(&rows, &format!("moves that the {goal} needs")),
                    html! { "Mean moves of the runs that built the " (goal) "." },
                ))
            }
        } @else {
            (figure(
                intervals(&not_built(experiment), "share of runs that were not built, with intervals"),
                html! { "Share of our runs that were not built, with its 95 % interval (Wilson), all orders together." },
            ))
            (table(experiment))
            (sums(experiment))
        }
        (claims(&experiment.claims))
        (list(&experiment.unknown))
    }
}

fn not_built(experiment: &Comparison) -> Vec<Row<Option<Rate>>> {
    let mut before = "";
    let row = |cell| {
        let Compared { kind, ours, .. }: &Compared = cell;
        let begins = std::mem::replace(&mut before, kind) != kind;
        Row { label: label(cell), begins, value: ours.not_built }
    };
    experiment.cells.iter().map(row).collect()
}

/// Returns the bars of each goal.
fn moves(experiment: &Comparison) -> Vec<(&str, Vec<Row<Option<f64>>>)> {
    let mut goals: Vec<(&str, Vec<Row<Option<f64>>>)> = Vec::new();
    let mut before = "";
    for cell in &experiment.cells {
        if goals.last().is_none_or(|(goal, _)| *goal != cell.goal) {
            goals.push((&cell.goal, Vec::new()));
        }
        let begins = std::mem::replace(&mut before, &cell.kind) != cell.kind;
        if let Some((_, rows)) = goals.last_mut() {
            rows.push(Row { label: label(cell), begins, value: cell.ours.moves });
        }
    }
    goals
}

fn table(experiment: &Comparison) -> Markup {
    let orders: Vec<&str> = experiment
        .cells
        .first()
        .map_or(Vec::new(), |c| c.by_order.iter().map(|(order, _)| order.as_str()).collect());
    let tenths = |value: Option<f64>| value.map_or("–".to_owned(), |v| format!("{v:.1}"));
    html! {
        div.wide { table {
            caption {
                "Published: collisions of each experiment, * for a deadlock; then deadlocks, and mean collisions of "
                "those without. Here: runs that were not built, of all orders and, to the right, of each; means of the runs that were built."
            }
            thead {
                tr {
                    th.key rowspan="2" scope="col" { "kind" }
                    th.key rowspan="2" scope="col" { "strategy" }
                    th.first colspan="3" scope="colgroup" { "published" }
                    th.first colspan=(5 + orders.len()) scope="colgroup" { "here" }
                }
                tr {
                    th.first scope="col" { "experiments" } th scope="col" { "DL" } th scope="col" { "CL each" }
                    th.first scope="col" { "not built" } th scope="col" { "95 % interval" }
                    th scope="col" { "collisions" } th scope="col" { "moves" } th scope="col" { "built" }
                    @for order in &orders { th scope="col" { (order) } }
                }
            }
            tbody { @for cell in &experiment.cells { tr {
                @let (not_built, interval) = rate(cell.ours.not_built);
                th.key scope="row" { (cell.kind) }
                th.key scope="row" { (cell.strategy) }
                @if cell.published.is_empty() {
                    td.first { "–" } td { "–" } td { "–" }
                } @else {
                    td.first { (printed(&cell.published)) } td { (dead(&cell.published)) }
                    td { (tenths(cell.published_collisions)) }
                }
                td.first { (not_built) } td { (interval) }
                td { (tenths(cell.ours.collisions)) } td { (tenths(cell.ours.moves)) } td { (count(cell.ours.built)) }
                @for (_, ours) in &cell.by_order {
                    td { (ours.not_built.map_or("–".to_owned(), |r| percent(r.rate))) }
                }
            } } }
        } }
    }
}

/// Returns deadlocks in one row, collisions in the other, a column for each kind and strategy.
fn sums(experiment: &Comparison) -> Markup {
    let mut names: Vec<&str> = Vec::new();
    for (_, name) in experiment.sums.iter().filter_map(|s| s.what.split_once(" of ")) {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    let sum = |what: &str, of: &str| experiment.sums.iter().find(|s| s.what == format!("{what} of {of}"));
    html! {
        div.wide { table {
            caption { "The sums that the thesis prints; where its cells add up to something else, that is behind it" }
            thead { tr { th.key { "" } @for name in &names { th scope="col" { (name) } } } }
            tbody { @for what in ["DL", "CL"] { tr {
                th.key scope="row" { (what) }
                @for name in &names {
                    @match sum(what, name) {
                        Some(s) if s.agrees() => td { (s.printed) },
                        Some(s) => td.bad { (s.printed) ", really " (s.cells) },
                        None => td { "" },
                    }
                }
            } } }
        } }
    }
}

/// Returns the readings beside the tables.
fn readings(all: &Reproduction) -> Markup {
    let cells = all.fits.first().map_or(&[][..], |f| &f.cells);
    html! {
        h2 { "Built: the thesis, and readings of its text" }
        div.wide { table {
            thead { tr {
                th.key { "goal" } th.key { "strategy" } th { "thesis" } th { "95 % interval" }
                @for fit in &all.fits { th.first { (fit.reading) } th { "95 % interval" } th { "p" } }
            } }
            tbody { @for (i, cell) in cells.iter().enumerate() { tr {
                @let (_, interval) = rate(cell.published);
                th.key scope="row" { (cell.goal) }
                th.key scope="row" { (cell.strategy) }
                td { (cell.published_built) " of " (cell.published_runs) } td { (interval) }
                @for cell in all.fits.iter().filter_map(|f| f.cells.get(i)) {
                    @let (share, interval) = rate(cell.ours);
                    td.first { (share) } td { (interval) }
                    td { (cell.p.map_or("–".to_owned(), probability)) }
                }
            } } }
        } }
        (list(&all.fits.iter().map(described).collect::<Vec<_>>()))
    }
}

/// Returns the effect of each assumption.
fn assumptions(all: &Reproduction) -> Markup {
    let columns = columns(all);
    html! {
        @if !all.assumptions.is_empty() {
            h2 { "Built: what each assumption does, varied alone from the text's reading" }
            div.wide { table {
                thead { tr {
                    th.key { "assumption" } th.key { "with --vary" }
                    @for (goal, strategy) in &columns { th { (goal) " " (strategy) } }
                } }
                tbody { @for assumption in &all.assumptions { tr {
                    td.key.text { (assumption.what) }
                    td.key.text { (assumption.vary.join(" or ")) }
                    @for column in &columns { td { (built(assumption, column)) } }
                } } }
            } }
            pre.command { (assumption_command(all.seeds)) " KEY=VALUE" }
            p.note { "Not offered, because they would need code that the program does not have: " (NOT_OFFERED) "." }
        }
    }
}

fn claims(claims: &[Claim]) -> Markup {
    html! {
        @if !claims.is_empty() {
            div.wide { table {
                thead { tr {
                    th.key { "The thesis says" } th.key { "its tables" } th.key { "" } th { "experiments that show it" }
                    th.key { "Found here" }
                } }
                tbody { @for claim in claims { tr {
                    td.key.text { (claim.says) }
                    td.key.bad[claim.by_tables == Some(false)] {
                        (claim.by_tables.map_or("–", |shown| if shown { "show it" } else { "do not" }))
                    }
                    td.key.bad[claim.holds == Some(false)] { (verdict(claim)) }
                    td { (claim.chance.map_or("–".to_owned(), percent)) }
                    td.key.text { (claim.found) }
                } } }
            } }
        }
    }
}

fn list(items: &[String]) -> Markup {
    html! { ul.note { @for item in items { li { (item) } } } }
}
