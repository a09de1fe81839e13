//! The answer in words.

use super::answer::{Answer, DecisionReport, PointReport, StartReport, StrategyReport};
use super::start::Cause;
use metamorph_report::statistics::Rate;
use metamorph_text::format::{count, many, percent, seconds};
use metamorph_text::paint::Paint;
use std::fmt::Write;

/// Returns a paragraph about the answer, and the commands that repeat what it speaks of.
pub fn text(answer: &Answer, paint: Paint) -> String {
    let mut text = format!(
        "{}, seed {}: {} since {}: {}\n",
        answer.scenario,
        answer.seed,
        paint.strong(&answer.end),
        seconds(answer.since_s),
        answer.what
    );
    text += &decided(answer);
    for point in &answer.curve {
        let Rate { rate, low, high } = point.share;
        let bar = "#".repeat((rate * 40.0).round() as usize);
        let _ = writeln!(
            text,
            "{:>10}  {:>10} events  {:>6} ({} to {})  {bar}",
            seconds(point.at_s),
            count(point.events),
            percent(rate),
            percent(low),
            percent(high)
        );
    }
    for (point, when) in [(&answer.before, "before"), (&answer.after, "after")] {
        let Some(point) = point else { continue };
        for (options, end) in [(&point.repeat_yes, ""), (&point.repeat_no, "not ")] {
            if let Some(options) = options {
                let what = if answer.sought == "built" { "built" } else { "broken" };
                let _ = writeln!(text, "a future from {when}, {end}{what}: {} {options}", answer.repeat);
            }
        }
    }
    if answer.is_cut_short {
        text += "note: the search was cut short; with more time (--budget) the answer is more exact\n";
    } else if answer.curve.iter().any(|point| point.of < answer.curve[0].of) {
        text += "note: the search ended before all points had as many futures as the first\n";
    }
    text
}

fn share(rate: Rate) -> String {
    format!("{} ({} to {})", percent(rate.rate), percent(rate.low), percent(rate.high))
}

/// Returns the sentence that says when the end was decided.
fn decided(answer: &Answer) -> String {
    let ends =
        if answer.sought == "built" { "were built".to_owned() } else { format!("broke {}", answer.sought) };
    let shares = |before: &PointReport, after: &PointReport| {
        format!(
            "{} of {} futures {ends} before, {} of {} after",
            share(before.share),
            count(before.of),
            share(after.share),
            count(after.of)
        )
    };
    match (answer.decided, &answer.before, &answer.after) {
        ("instant", Some(before), Some(after)) => {
            let sentence = format!(
                "decided at {}, by event {}: {}\n",
                seconds(after.at_s),
                count(after.events),
                shares(before, after)
            );
            sentence + answer.event.as_deref().unwrap_or_default() + &decisions(answer)
        }
        ("stretch", Some(before), Some(after)) => {
            let shares = shares(before, after);
            let (from, until) = (seconds(before.at_s), seconds(after.at_s));
            let stretch = match answer.is_cut_short {
                true => format!("decided between {from} and {until}: {shares}\n"),
                false => {
                    format!("decided step by step between {from} and {until}, by no single event: {shares}\n")
                }
            };
            stretch + &decisions(answer)
        }
        ("start", ..) => at_start(answer, &ends),
        ("open", ..) => {
            let last = answer.curve.last().map(|point| share(point.share)).unwrap_or_default();
            format!("not decided when it began: {last} of the futures from there {ends}\n")
        }
        _ => "not answered: too few futures were carried out\n".to_owned(),
    }
}

/// Returns the sentences about the inputs that decided.
fn decisions(answer: &Answer) -> String {
    let Some(decisions) = &answer.decisions else { return String::new() };
    let ends = if answer.sought == "built" { "built" } else { "broken" };
    let mut text = match (decisions.len(), answer.withheld) {
        (_, 0) => String::new(),
        (0, all) => format!("no input alone decided: {} were withheld, one at a time\n", count(all)),
        (_, all) => format!("of {} withheld one at a time, these decided:\n", many(all, "input")),
    };
    for DecisionReport { change, input, after, .. } in decisions {
        let _ = writeln!(
            text,
            "without this, {} of {} futures are {ends} (--change {change})",
            share(after.share),
            count(after.of)
        );
        input.lines().for_each(|line| text.push_str(&format!("    {line}\n")));
    }
    text
}

fn at_start(answer: &Answer, ends: &str) -> String {
    let first = answer.curve.first().map(|point| share(point.share)).unwrap_or_default();
    let mut sentence = format!("decided at the start: {first} of all futures {ends}\n");
    let Some(StartReport { cause, all, strategies }) = &answer.start else { return sentence };
    sentence += match cause {
        Cause::Impossible => {
            "  impossible: a search proved that no robot with these modules could have built the goal\n"
        }
        Cause::Chance => "  chance: with other random numbers also of agents and joints it ends otherwise\n",
        Cause::Strategy => "  strategy: under another one it ends otherwise\n",
        Cause::Placement => {
            "  placement: with these modules and faults, it ends like this under every strategy\n"
        }
    };
    let _ = writeln!(sentence, "    other random numbers of everything: {}", share(*all));
    for StrategyReport { setting, share: rate } in strategies {
        let _ = writeln!(sentence, "    {setting}: {}", share(*rate));
    }
    sentence
}
