//! The report of a run as one self-contained HTML file: outcome, numbers, plots over time, the scenario, and
//! how to repeat the run. The file loads nothing, and `maud` escapes everything that comes from outside.

use super::Words;
use super::hosts::HostsReport;
use super::human::{commanded, proved};
use super::over_time::{Layer, Mark, areas};
use super::schema::{LatencyReport, Report, StageReport, Standstill, StandstillsReport, Waiting};
use crate::document::{document, figure};
use crate::message_timeline::Bin;
use maud::{Markup, PreEscaped, html};
use metamorph_core::counters::Class;
use metamorph_core::time::Span;
use metamorph_scenario::Plan;
use metamorph_text::format::{bytes, count, duration, many, seconds, whole_percent};
use std::collections::{BTreeMap, BTreeSet};

/// Largest number of rows of a list that are shown; JSON has them all.
const SHOWN_MAX: usize = 200;

/// Chains of waiting modules shown at most.
const CHAINS: usize = 12;

/// Returns the page of a run. `bins` are bins of `width` with their counts; `picture` is the swarm at the end, as SVG.
pub fn page(report: &Report, plan: &Plan, width: Span, bins: &[Bin], picture: Option<&str>) -> String {
    let words = plan.swarm.words();
    let good = report.outcome == "built";
    let body = html! {
        h1 { (report.scenario) }
        @if let Some(text) = &plan.description { p.lead { (text.trim()) } }
        dl.facts {
            div { dt { "outcome" } dd.bad[!good] { (report.outcome) } }
            div { dt { (words.cells) " " (words.filled) } dd { (count(report.goal.filled)) " of " (count(report.goal.cells)) } }
            @for share in report.stages.iter().filter_map(StageReport::share_of_shape) { div { dt { "shape" } dd { (share) } } }
            div { dt { (words.modules) " alive" } dd { (count(report.agents.alive)) " of " (count(report.agents.launched)) } }
            @if words.collisions.is_some() { div { dt { "moves" } dd { (count(report.moves)) } } }
            div { dt { "messages" } dd { (count(report.messages.total)) } }
            div { dt { "scenario time" } dd { (seconds(report.time.virtual_s)) } }
            div { dt { "invariants broken" } dd.bad[report.invariants.broken > 0] { (count(report.invariants.broken)) } }
            div { dt { "metamorph" } dd { (report.version) } }
        }
        p class=(if good { "note" } else { "warning" }) { (report.reason) "." }
        @if let Some(picture) = picture { figure.structure { (PreEscaped(picture)) figcaption { "The swarm at the end of the run." } } }
        @if let Some(unbuilt) = &report.unbuilt { (standstill(unbuilt, words)) }
        @if let Some(all) = report.standstills.as_ref().filter(|all| all.count > 0) { (standstills(all, words)) }
        h2 { "Repeat it" }
        pre.command { (report.repeat) }
        p.note {
            @match &report.trace_hash {
                Some(hash) => { "The run was simulated and is the same on every machine; a hash of all its events is " code { (hash) }
                    @if let Some(state) = &report.state_hash { ", one of the states of all agents and bodies " code { (state) } }
                    "." }
                None => { "Processes ran in real time, so a repeated run is like this one, but not the same event by event." }
            }
            " The scenario is at the end of this page."
        }
        h2 { "What happened over time" }
        (over_time(report, words, width.as_secs_f64(), bins))
        (messages(report))
        (numbers(report, words))
        (hosts(report))
        (faults(report))
        h2 { "Scenario" }
        pre { (plan.text) }
        p.note {
            "Run on " (report.machine.os) ", " (report.machine.arch) ", " (report.machine.cores) " cores, "
            (report.machine.build) " build: " (seconds(report.time.wall_s)) " real time, "
            (seconds(report.time.setup_s)) " to set up."
        }
    };
    document(&format!("Run: {}", report.scenario), body)
}

fn standstill(s: &Standstill, words: &Words) -> Markup {
    let list = |ids: &[u32]| ids.iter().map(u32::to_string).collect::<Vec<_>>().join(", ");
    html! {
        p { "Since " (seconds(s.since_s)) " nothing has changed; " (many(s.open.len() as u64, words.cell)) " not " (words.filled) "; " (s.prospect) "." }
        @if !s.wait_cycle.is_empty() {
            p.warning { "These wait for each other in a circle: " (list(&s.wait_cycle)) "." }
        }
        @if let Some(found) = &s.detected {
            p { "The swarm detected this itself: " (words.module) " " (found.by) " counted all others, at " (seconds(found.at_s)) "." }
        }
        @if let Some(proof) = &s.proof {
            p { "Proved by an exhaustive search: " (proved(proof)) "." }
        }
        @for Chain { modules, circle } in chains(&s.waiting).iter().take(CHAINS) {
            p.chain {
                @for (i, id) in modules.iter().enumerate() { @if i > 0 { " → " } span.bad[*circle] { (id) } }
                @if *circle { " and so on: they wait for each other in a circle" }
            }
        }
        @if !s.waiting.is_empty() {
            div.wide { table {
                caption { "Every " (words.module) " here " (words.idle) " and makes no progress" }
                thead { tr { th scope="col" { (words.module) } th.text scope="col" { "why" } th scope="col" { "waits for" } } }
                tbody { @for w in s.waiting.iter().take(SHOWN_MAX) { tr {
                    td { (w.module) } td.text { (w.why) } td { @match w.waits_for { Some(id) => (id), None => "–" } }
                } } }
            } }
        }
    }
}

fn standstills(all: &StandstillsReport, words: &Words) -> Markup {
    html! {
        h2 { "Standstills" }
        div.wide { table {
            caption {
                "Times at which no " (words.module) " moved, or none filled anything: " (count(all.count)) ", of which the controller resolved "
                (count(all.rescued)) @if all.rescue != "none" { " (rescue " (all.rescue) ")" }
            }
            thead { tr {
                th scope="col" { "since" } th scope="col" { "until" } th.key scope="col" { "ended by" }
                th scope="col" { "moves called" } th scope="col" { "moves led" } th scope="col" { (words.cells) " left" } th.text scope="col" { "why" }
            } }
            tbody { @for e in &all.events { tr {
                td { (seconds(e.since_s)) } td { @match e.until_s { Some(t) => (seconds(t)), None => "–" } } td.key { (e.ended_by) }
                td { (count(e.called)) } td { (count(e.led)) } td { (count(e.open.len() as u64)) } td.text { (e.text) }
            } } }
        } }
    }
}

/// Modules each of which waits for the next.
#[derive(Debug, PartialEq, Eq)]
struct Chain {
    modules: Vec<u32>,
    /// True if the last module waits for an earlier one of the chain.
    circle: bool,
}

/// Splits waiting modules into chains: each starts at a module that no other waits for; the rest are cycles.
fn chains(waiting: &[Waiting]) -> Vec<Chain> {
    let on: BTreeMap<u32, u32> = waiting.iter().filter_map(|w| Some((w.module, w.waits_for?))).collect();
    let waited_for: BTreeSet<u32> = on.values().copied().collect();
    let (heads, others): (Vec<u32>, Vec<u32>) = on.keys().partition(|id| !waited_for.contains(id));
    let mut told = BTreeSet::new();
    let mut chains = Vec::new();
    for start in heads.into_iter().chain(others) {
        if told.contains(&start) {
            continue;
        }
        let mut chain = Chain { modules: vec![start], circle: false };
        let mut at = start;
        while let Some(next) = on.get(&at).filter(|_| !chain.circle) {
            told.insert(at);
            chain.circle = chain.modules.contains(next);
            chain.modules.push(*next);
            at = *next;
        }
        chains.push(chain);
    }
    chains
}

fn over_time(report: &Report, words: &Words, width: f64, bins: &[Bin]) -> Markup {
    let end = report.time.virtual_s;
    let marks: Vec<Mark> = report
        .faults
        .iter()
        .take(SHOWN_MAX)
        .map(|f| Mark {
            at: f.at_s,
            text: f.module.map_or(f.fault.clone(), |id| format!("{} {id}", f.fault)),
            mends: matches!(f.fault.as_str(), "resume" | "unstick" | "unblock" | "restart" | "heal"),
        })
        .collect();
    let layer =
        |name, class, of: &dyn Fn(&Bin) -> f64| Layer { name, class, values: bins.iter().map(of).collect() };
    let classes = Class::ALL
        .map(|class| layer(class.name(), class_of(class), &|b| b.totals[class.index()] as f64 / width));
    let marked = if marks.is_empty() { "" } else { " Strokes are faults; more on hovering." };
    html! {
        (figure(
            areas(&[layer("filled", "filled", &|b| b.filled as f64)], width, end, &marks, "goal cells filled over time"),
            html! { "Progress of the goal: " (words.cells) " " (words.filled) ", of the goal that was being built." (marked) },
        ))
        @if words.collisions.is_some() {
            (figure(
                areas(&[layer("moves", "moves", &|b| b.moves as f64 / width)], width, end, &marks, "moves over time"),
                html! { (capitalized(words.action)) "s that ended in each second." },
            ))
        }
        @if bins.iter().any(|b| b.totals.iter().any(|n| *n > 0)) {
            (figure(
                areas(&classes, width, end, &marks, "messages over time"),
                html! { "Messages between " (words.modules) " that arrived in each second, by class." },
            ))
        } @else {
            p.note { "Messages between processes are counted, but not seen one by one." }
        }
    }
}

fn capitalized(word: &str) -> String {
    let mut letters = word.chars();
    letters.next().map_or(String::new(), |first| first.to_uppercase().chain(letters).collect())
}

/// Returns the class in the style sheet.
fn class_of(class: Class) -> &'static str {
    match class {
        Class::Gradient => "c-gradient",
        Class::Seed => "c-seed",
        Class::Connectivity => "c-connectivity",
        Class::Negotiation => "c-negotiation",
        Class::World => "c-world",
        Class::Liveness => "c-liveness",
        Class::Gait => "c-gait",
    }
}

fn messages(report: &Report) -> Markup {
    let m = &report.messages;
    let rows = m.by_class.iter().filter(|(_, c)| c.sent > 0).map(|(name, c)| (name.as_str(), c));
    html! {
        div.wide { table {
            caption { "Messages by class" }
            thead { tr {
                th.key scope="col" { "class" }
                @for name in ["sent", "delivered", "lost", "duplicated", "overflowed", "expired", "refused", "bytes"] {
                    th scope="col" { (name) }
                }
            } }
            tbody { @for (name, c) in rows.chain([("all", &m.all)]) { tr {
                th.key scope="row" { (name) }
                @for n in [c.sent, c.delivered, c.lost, c.duplicated, c.overflowed, c.expired, c.refused] { td { (count(n)) } }
                td { (bytes(c.bytes)) }
            } } }
        } }
        @if let Some(latency) = &m.latency { (latencies(latency)) }
    }
}

fn latencies(latency: &LatencyReport) -> Markup {
    let rows = latency.by_class.iter().map(|(name, q)| (name.as_str(), q)).chain([("all", &latency.all)]);
    let rows = rows.chain(latency.channel.as_ref().map(|q| ("of it between processes", q)));
    html! {
        div.wide { table {
            caption { "Time from sending to the input of the receiver, to a sixteenth" }
            thead { tr {
                th.key scope="col" { "class" }
                @for name in ["measured", "least", "50 %", "90 %", "99 %", "99.9 %", "greatest"] { th scope="col" { (name) } }
            } }
            tbody { @for (name, q) in rows { tr {
                th.key scope="row" { (name) }
                td { (count(q.count)) }
                @for s in [q.least_s, q.p50_s, q.p90_s, q.p99_s, q.p999_s, q.greatest_s] { td { (duration(s)) } }
            } } }
        } }
    }
}

fn numbers(report: &Report, words: &Words) -> Markup {
    let (c, d) = (&report.collisions, &report.move_details);
    let actions = |what: &str| format!("{}s {what}", words.action);
    let of_bodies = [
        (actions("begun"), d.started),
        (actions("completed"), d.completed),
        (actions("of modules that the controller called"), d.called),
        (actions("led by a plan of the controller"), d.led),
        (actions("that failed"), d.failed),
        (actions("refused because a cell was taken"), d.refused_taken),
        (actions("refused because they came late"), d.refused_late),
        (actions("refused because contacts had changed"), d.refused_stale),
        ("collisions attempted".into(), c.attempted),
        ("collisions prevented".into(), c.prevented),
        ("collisions suffered".into(), c.suffered),
    ];
    let of_processes = [
        ("processes that died".into(), report.agents.crashed),
        ("processes started again".into(), report.agents.restarted),
        ("invariants checked".into(), report.invariants.checked),
    ];
    let of_bodies = of_bodies.into_iter().filter(|_| words.collisions.is_some());
    let rows = of_bodies.chain(of_processes);
    html! {
        h2 { "Numbers" }
        div.wide { table {
            tbody { @for (name, n) in rows { tr { th.key scope="row" { (name) } td { (count(n)) } } } }
        } }
        @if report.stages.len() > 1 {
            div.wide { table {
                caption { "Goals" }
                thead { tr { th.key scope="col" { "goal" } th scope="col" { (words.cells) } th scope="col" { "filled" } th scope="col" { "begun" } th scope="col" { "built" } } }
                tbody { @for s in &report.stages { tr {
                    th.key scope="row" { (s.name) } td { (count(s.cells)) } td { (count(s.filled)) " (" (whole_percent(s.filled, s.cells)) ")" }
                    td { (seconds(s.opened_s)) } td { @match s.built_s { Some(t) => (seconds(t)), None => "–" } }
                } } }
            } }
        }
        @if !report.family_text.note.is_empty() { p { (report.family_text.note) } }
        @if !report.invariants.violated.is_empty() {
            h2 { "Invariants that broke" }
            ul { @for v in report.invariants.violated.iter().take(SHOWN_MAX) { li.bad { (v.invariant) " at " (seconds(v.at_s)) ": " (v.what) } } }
        }
        @if !report.notes.is_empty() {
            h2 { "Notes" }
            ul { @for note in &report.notes { li { (note) } } }
        }
        @if let Some(logs) = &report.logs {
            h2 { "Logs" }
            p { "Lines of run " (logs.run) ": " (logs.places().join("; ")) }
        }
    }
}

fn hosts(report: &Report) -> Markup {
    html! {
        @if let Some(HostsReport { hosts, crossed }) = &report.hosts {
            h2 { "Hosts" }
            p { @for (i, host) in hosts.iter().enumerate() { @if i > 0 { ", " } (host.name) ": " (many(host.modules, "module")) } }
            div.wide { table {
                caption { "What crossed from one host to another" }
                thead { tr { th.key scope="col" { "from" } th.key scope="col" { "to" } th scope="col" { "messages" } th scope="col" { "lost" } th scope="col" { "bytes" } th scope="col" { "to and from bodies" } } }
                tbody { @for c in crossed.iter().take(SHOWN_MAX) { tr {
                    td.key { (c.from) } td.key { (c.to) } td { (count(c.all.sent)) } td { (count(c.all.lost)) }
                    td { (bytes(c.all.bytes)) } td { (count(c.body_messages)) }
                } } }
            } }
        }
    }
}

fn faults(report: &Report) -> Markup {
    html! {
        @if !report.faults.is_empty() {
            h2 { "Faults" }
            div.wide { table {
                thead { tr { th scope="col" { "at" } th.key scope="col" { "fault" } th.key scope="col" { "what it found" } } }
                tbody { @for f in report.faults.iter().take(SHOWN_MAX) { tr {
                    td { (seconds(f.at_s)) }
                    td.key { (f.fault) @if let Some(id) = f.module { " " (id) } }
                    td.key.text { (f.effect) @if let Some(by) = commanded(f) { " (" (by) ")" } }
                } } }
            } }
            @if report.faults.len() > SHOWN_MAX { p.note { "The first " (SHOWN_MAX) " of " (count(report.faults.len() as u64)) "." } }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn chains_of_waiting_modules_are_followed_to_their_end_or_around() {
        let waits = |pairs: &[(u32, Option<u32>)]| {
            let waiting = |(module, waits_for): &(u32, Option<u32>)| Waiting {
                module: *module,
                waits_for: *waits_for,
                why: String::new(),
            };
            chains(&pairs.iter().map(waiting).collect::<Vec<_>>())
        };
        let chain = |modules: &[u32], circle| Chain { modules: modules.to_vec(), circle };
        assert_eq!(waits(&[(1, None)]), []);
        // Two chains meet and end with 9, which waits for no module.
        let joined = waits(&[(3, Some(4)), (4, Some(9)), (5, Some(4))]);
        assert_eq!(joined, [chain(&[3, 4, 9], false), chain(&[5, 4, 9], false)]);
        assert_eq!(waits(&[(7, Some(8)), (8, Some(7))]), [chain(&[7, 8, 7], true)]);
        // A chain that leads into a cycle includes it; another cycle is a chain of its own.
        let circles = waits(&[(1, Some(2)), (2, Some(3)), (3, Some(2)), (5, Some(6)), (6, Some(5))]);
        assert_eq!(circles, [chain(&[1, 2, 3, 2], true), chain(&[5, 6, 5], true)]);
    }
}
