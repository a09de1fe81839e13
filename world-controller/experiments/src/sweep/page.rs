//! A summary as one self-contained HTML file: what was run and how to repeat it, rates, tables, plots, and
//! the scenario. The file loads nothing, and `maud` escapes everything that comes from outside.

use super::summary::{Combination, Summary};
use maud::{Markup, html};
use metamorph_report::document::{document, figure};
use metamorph_report::plots::{Row, boxes, intervals};
use metamorph_report::statistics::rate;
use metamorph_report::statistics::{Rate, Spread};
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_text::format::count;
use metamorph_text::format::number;
use std::collections::BTreeSet;

/// Largest number of combinations plotted; the tables have them all.
const PLOTTED_MAX: usize = 200;

/// The inputs of a page besides the summary.
pub struct Context<'a> {
    /// The scenario's name, or its file.
    pub title: &'a str,
    /// The scenario's description.
    pub description: Option<&'a str>,
    /// The text of the scenario.
    pub scenario: &'a str,
    /// The command that gives the same results.
    pub command: &'a str,
}

/// Returns the page of a sweep.
pub fn page(summary: &Summary, context: &Context<'_>) -> String {
    let missing = summary.runs_planned - summary.runs;
    let title = format!("Sweep: {}", context.title);
    let body = html! {
        h1 { (title) }
        @if let Some(text) = context.description { p.lead { (text.trim()) } }
        dl.facts {
            div { dt { "runs" } dd { (count(summary.runs)) } }
            div { dt { "combinations" } dd { (count(summary.combinations.len() as u64)) } }
            div { dt { "seeds" } dd { (summary.seeds) } }
            div { dt { "built" } dd { (count(total(summary, Outcome::Built))) } }
            div {
                dt { "violations of invariants" }
                dd.bad[summary.violations > 0] { (count(summary.violations)) }
            }
            div { dt { "metamorph" } dd { (summary.version) } }
        }
        @if missing > 0 {
            p.warning {
                "The sweep was interrupted: " (count(missing)) " of " (count(summary.runs_planned))
                " runs are missing here."
            }
        }
        @if summary.violations > 0 {
            p.warning { "Invariants broke. " code { "runs.csv" } " names the runs." }
        }
        h2 { "Repeat it" }
        pre.command { (context.command) }
        p.note {
            "Every run is simulated and the same on every machine; the last column of "
            code { "runs.csv" } " is a hash of all its events. The scenario is at the end of this page."
        }
        h2 { "How often the goal was built" }
        (figure(
            intervals(&rows(summary, |c| c.built_rate), "share of runs that were built, with intervals"),
            html! { "Share of runs that were built, with its 95 % interval (Wilson)." (legend(summary)) },
        ))
        (ends(summary))
        (reasons(summary))
        h2 { "What it took" }
        p.note {
            "Runs that were built only. Boxes hold the middle half of the runs, with a stroke at the median "
            "and a dot at the mean; thick lines reach from 5 % to 95 %, thin ones to the extremes. To the "
            "right: median (mean)."
        }
        @for (name, what, of) in METRICS {
            (figure(boxes(&rows(summary, of), &format!("spread of {name}")), html! { (what) (legend(summary)) }))
        }
        (numbers(summary))
        h2 { "Scenario" }
        pre { (context.scenario) }
    };
    document(&title, body)
}

/// A compared quantity: its name, its description, and its value.
type Metric = (&'static str, &'static str, fn(&Combination) -> Option<Spread>);
const METRICS: [Metric; 4] = [
    ("moves", "Moves completed.", |c| c.moves),
    ("messages", "Messages sent between modules.", |c| c.messages),
    ("collisions", "Attempts to use one cell twice: prevented, refused and suffered.", |c| c.collisions),
    ("makespan", "Seconds of scenario time until the last goal cell was filled.", |c| c.makespan_s),
];

fn total(summary: &Summary, outcome: Outcome) -> u64 {
    summary.combinations.iter().map(|c| c.ended(outcome)).sum()
}

/// Returns a row for each combination, at most as many as are plotted.
pub(super) fn rows<T>(summary: &Summary, of: impl Fn(&Combination) -> T) -> Vec<Row<T>> {
    let shown = &summary.combinations[..summary.combinations.len().min(PLOTTED_MAX)];
    let mut before = None;
    let row = |c: &Combination| {
        let label = if c.values.is_empty() { "all runs".to_owned() } else { c.values.join(" · ") };
        // With one varied key, all rows are one group.
        let group = c.values.first().filter(|_| c.values.len() > 1).cloned();
        Row { label, begins: std::mem::replace(&mut before, group.clone()) != group, value: of(c) }
    };
    shown.iter().map(row).collect()
}

fn legend(summary: &Summary) -> Markup {
    let all = summary.combinations.len();
    let keys: Vec<&str> = summary.vary.iter().map(|axis| axis.key.as_str()).collect();
    html! {
        @if !keys.is_empty() { " Rows: " (keys.join(" · ")) "." }
        @if all > PLOTTED_MAX { " Only the first " (PLOTTED_MAX) " of " (count(all as u64)) " combinations are drawn." }
    }
}

fn keys(summary: &Summary) -> Markup {
    html! { @for axis in &summary.vary { th.key scope="col" { (axis.key) } } }
}

fn values(c: &Combination) -> Markup {
    html! { @for value in &c.values { th.key scope="row" title=(value) { (value) } } }
}

fn ends(summary: &Summary) -> Markup {
    // Outcomes that did not occur need no column, except the most likely one.
    let happened = |o: &Outcome| *o == Outcome::Deadlock || total(summary, *o) > 0;
    let mut ends = vec![Outcome::Deadlock, Outcome::Livelock, Outcome::Timeout, Outcome::Unsafe];
    ends.retain(happened);
    html! {
        div.wide { table {
            caption { "How the runs ended" }
            thead { tr {
                (keys(summary))
                th scope="col" { "runs" } th scope="col" { "built" } th scope="col" { "rate" }
                th scope="col" { "95 % interval" }
                @for outcome in &ends { th scope="col" { (outcome) } }
                th scope="col" { "violations" }
            } }
            tbody { @for c in &summary.combinations { tr {
                (values(c))
                @let (rate, interval) = rate(c.built_rate);
                td { (count(c.runs)) } td { (count(c.ended(Outcome::Built))) } td { (rate) } td { (interval) }
                @for outcome in &ends { td { (count(c.ended(*outcome))) } }
                td.bad[c.violations > 0] { (count(c.violations)) }
            } } }
        } }
    }
}

fn reasons(summary: &Summary) -> Markup {
    let all: BTreeSet<&String> = summary.combinations.iter().flat_map(|c| c.reasons.keys()).collect();
    html! {
        @if !all.is_empty() {
            div.wide { table {
                caption { "Why the others were not built: share of all runs" }
                thead { tr { (keys(summary)) @for reason in &all { th scope="col" { (reason) } } } }
                tbody { @for c in &summary.combinations { tr {
                    (values(c))
                    @for reason in &all {
                        td { @if let Some(n) = c.reasons.get(*reason) { (rate(Rate::wilson(*n, c.runs)).0) } }
                    }
                } } }
            } }
        }
    }
}

fn numbers(summary: &Summary) -> Markup {
    html! {
        div.wide { table {
            caption { "Mean, median and 95 % quantile of the runs that were built" }
            thead {
                tr {
                    @for axis in &summary.vary { th.key scope="col" rowspan="2" { (axis.key) } }
                    @for (name, ..) in METRICS { th.first scope="colgroup" colspan="3" { (name) } }
                }
                tr { @for _ in METRICS {
                    th.first scope="col" { "mean" } th scope="col" { "median" } th scope="col" { "95 %" }
                } }
            }
            tbody { @for c in &summary.combinations { tr {
                (values(c))
                @for (_, _, of) in METRICS {
                    @match of(c) {
                        Some(s) => { td.first { (number(s.mean)) } td { (number(s.median)) } td { (number(s.p95)) } }
                        None => { td.first { "–" } td { "–" } td { "–" } }
                    }
                }
            } } }
        } }
    }
}

#[cfg(test)]
mod tests {
    use super::super::summary::Tallies;
    use super::super::testing::row;
    use super::*;
    use metamorph_scenario::grid::{Axis, Grid, Seeds};

    #[test]
    fn text_from_outside_is_escaped_and_nothing_is_loaded() {
        let evil = "<script src=\"https://evil.example\">&'";
        let axis = Axis { key: evil.into(), values: vec![evil.into(), "x".into()] };
        let grid = Grid::new(Seeds { from: 0, until: 1 }, vec![axis]).unwrap();
        let mut tallies = Tallies::new(&grid);
        tallies.add(0, &row(0));
        tallies.add(1, &super::super::row::Row { outcome: Outcome::Deadlock, reason: evil.into(), ..row(0) });
        let context = Context { title: evil, description: Some(evil), scenario: evil, command: evil };
        let text = page(&tallies.summary(evil, &grid), &context);
        assert!(!text.contains("<script") && text.matches("&lt;script").count() >= 10, "{text}");
        for loaded in ["src=", "href=", "url(", "@import"] {
            let escaped = text.replace("src=&quot;", "");
            assert!(!escaped.contains(loaded), "{loaded}");
        }
        assert!(text.contains("Invariants broke") && !text.contains("interrupted"));
    }
}
