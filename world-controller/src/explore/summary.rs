//! What an exploration came to: counts, failures by kind, rare paths that never ran.

use super::Ran;
use super::verdict::{Failure, Kind, Verdict};
use crate::report::count;
use crate::scenario::quote;
use crate::terminal::Paint;
use metamorph_module_agent::Family;
use metamorph_protocol::marks::Mark;
use metamorph_sim_bridge::feasible::Within;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;

/// The version of the layout of [`Summary`].
pub const SCHEMA: u32 = 3;
/// Of runs that are alike, so many seeds are named.
const NAMED: usize = 20;

/// Failures of one kind.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failures {
    /// How many runs.
    pub count: u64,
    /// The numbers of the first ones.
    pub first: Vec<u64>,
    /// What was seen in the first.
    pub what: String,
}

/// Runs that were excused for one reason.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Excused {
    /// How many runs.
    pub runs: u64,
    /// The seeds of the first ones.
    pub seeds: Vec<u64>,
}

/// Counts over runs.
#[derive(Clone, Debug, Default)]
pub struct Tallies {
    /// How many runs.
    pub runs: u64,
    events: u64,
    moves: u64,
    messages: u64,
    outcomes: BTreeMap<&'static str, u64>,
    infeasible: BTreeMap<Within, u64>,
    excused: BTreeMap<String, Excused>,
    failures: BTreeMap<(Kind, String), Failures>,
    marks: BTreeMap<Mark, u64>,
}

impl Tallies {
    /// Counts a run. Gives its failure if it is the first of its kind.
    pub fn add<'a>(&mut self, number: u64, ran: &'a Ran) -> Option<&'a Failure> {
        self.runs += 1;
        self.events += ran.events;
        self.moves += ran.moves;
        self.messages += ran.messages;
        *self.outcomes.entry(ran.outcome.map_or("panic", |o| o.name())).or_default() += 1;
        for mark in Mark::ALL.iter().filter(|m| ran.marks.has(**m)) {
            *self.marks.entry(*mark).or_default() += 1;
        }
        match &ran.verdict {
            Verdict::Built => {}
            Verdict::Infeasible(within) => *self.infeasible.entry(*within).or_default() += 1,
            Verdict::Excused(why) => {
                let excused = self.excused.entry(why.clone()).or_default();
                excused.runs += 1;
                note(&mut excused.seeds, number);
            }
            Verdict::Failed(failure) => {
                let first = Failures { count: 0, first: Vec::new(), what: failure.what.clone() };
                let key = (failure.kind.clone(), ran.protocol.clone());
                let failures = self.failures.entry(key).or_insert(first);
                failures.count += 1;
                note(&mut failures.first, number);
                return (failures.count == 1).then_some(failure);
            }
        }
        None
    }
    /// Runs that failed.
    pub fn failed(&self) -> u64 {
        self.failures.values().map(|f| f.count).sum()
    }
    /// Failures by kind and protocol.
    pub fn failures(&self) -> &BTreeMap<(Kind, String), Failures> {
        &self.failures
    }
}

/// What an exploration came to, as it is written to JSON.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// The version of this layout.
    pub schema: u32,
    /// The version of the program.
    pub version: String,
    /// The seed of the first run; the next has the next.
    pub seed: u64,
    /// The family explored; null for both.
    pub family: Option<&'static str>,
    /// Runs.
    pub runs: u64,
    /// Messages handed to agents, and what bodies and agents told each other.
    pub events: u64,
    /// Moves completed.
    pub moves: u64,
    /// Messages sent.
    pub messages: u64,
    /// How runs ended.
    pub outcomes: BTreeMap<&'static str, u64>,
    /// Runs in which nothing more could be built, proved by an exhaustive search, by what was searched:
    /// the widest rules within which nothing could be done.
    pub infeasible: BTreeMap<Within, u64>,
    /// Runs that could not build any more, by reason; no failures, but not proved by a search either.
    pub excused: BTreeMap<String, Excused>,
    /// Runs that failed.
    pub failed: u64,
    /// The first failure of each kind.
    pub found: Vec<Found>,
    /// In how many runs each rare path ran.
    pub marks: BTreeMap<&'static str, u64>,
    /// Rare paths that never ran.
    pub never: Vec<&'static str>,
}

/// A kind of failure.
#[derive(Clone, Debug, Serialize)]
pub struct Found {
    /// In what way.
    #[serde(flatten)]
    pub kind: Kind,
    /// The family that failed, and the protocol in it.
    pub protocol: String,
    /// The seed of the first run that failed so.
    pub seed: u64,
    /// The seeds of the first ones, that one among them.
    pub seeds: Vec<u64>,
    /// In how many runs.
    pub runs: u64,
    /// What was seen.
    pub what: String,
    /// The command that repeats the first.
    pub repeat: String,
    /// The small scenario that fails the same way; null if none was made.
    pub scenario: Option<String>,
    /// Its file, seen from here.
    #[serde(skip)]
    pub here: Option<PathBuf>,
    /// Modules in it.
    pub agents: usize,
    /// Faults in it.
    pub faults: usize,
    /// Runs that making it small took.
    pub shrinking: u64,
}

impl Summary {
    /// From counts and what was found.
    pub fn new(seed: u64, family: Option<Family>, mut tallies: Tallies, found: Vec<Found>) -> Summary {
        for excused in tallies.excused.values_mut() {
            excused.seeds = seeds(seed, &excused.seeds);
        }
        let failed = tallies.failed();
        let prefix = match family {
            None => "",
            Some(Family::Cube) => "metamodule:",
            Some(Family::Metamodule) => "cube:",
        };
        // Paths of a family that was not explored could not run.
        let explored = |m: &Mark| prefix.is_empty() || !m.name().starts_with(prefix);
        let never = Mark::ALL.iter().filter(|m| explored(m) && !tallies.marks.contains_key(m));
        Summary {
            schema: SCHEMA,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            seed,
            family: family.map(Family::name),
            runs: tallies.runs,
            events: tallies.events,
            moves: tallies.moves,
            messages: tallies.messages,
            outcomes: tallies.outcomes,
            infeasible: tallies.infeasible,
            excused: tallies.excused,
            failed,
            found,
            never: never.map(|m| m.name()).collect(),
            marks: tallies.marks.into_iter().map(|(m, n)| (m.name(), n)).collect(),
        }
    }
}

/// For people.
pub fn text(summary: &Summary, paint: Paint) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_text(&mut out, summary, paint);
    out
}

fn write_text(out: &mut String, summary: &Summary, paint: Paint) -> std::fmt::Result {
    let failed = format!("{} failed", count(summary.failed));
    let failed = if summary.failed == 0 { paint.good(&failed) } else { paint.bad(&failed) };
    writeln!(out, "{} runs from seed {}: {failed}", count(summary.runs), summary.seed)?;
    let list = |of: Vec<(&str, &u64)>| {
        of.into_iter().map(|(name, n)| format!("{} {name}", count(*n))).collect::<Vec<_>>().join(", ")
    };
    writeln!(out, "  {}", list(summary.outcomes.iter().map(|(k, n)| (*k, n)).collect()))?;
    if !summary.infeasible.is_empty() {
        let proved = list(summary.infeasible.iter().map(|(within, n)| (within.text(), n)).collect());
        writeln!(out, "  nothing more could be built, proved by search: {proved}")?;
    }
    if !summary.excused.is_empty() {
        let excused = list(summary.excused.iter().map(|(k, e)| (k.as_str(), &e.runs)).collect());
        writeln!(out, "  could not be built any more, not proved: {excused}")?;
        let seeds = summary.excused.values().flat_map(|e| &e.seeds).take(NAMED);
        writeln!(out, "    seeds {}", spaced(seeds))?;
    }
    let (events, moves, messages) = (count(summary.events), count(summary.moves), count(summary.messages));
    writeln!(out, "  {events} events, {moves} moves, {messages} messages")?;
    for found in &summary.found {
        let Found { kind, protocol, seeds, runs, what, repeat, agents, faults, .. } = found;
        writeln!(out, "\n{} ({protocol}) in {} run{}", paint.bad(&kind.to_string()), count(*runs), s(*runs))?;
        writeln!(out, "  {what}\n  first in  {repeat}")?;
        if *runs > 1 {
            writeln!(out, "  seeds {}{}", spaced(seeds), if *runs > NAMED as u64 { " ..." } else { "" })?;
        }
        if let Some(file) = &found.here {
            writeln!(
                out,
                "  made small: {agents} modules, {faults} fault{} ({} runs)",
                s(*faults as u64),
                count(found.shrinking)
            )?;
            writeln!(out, "  metamorph run {} --link sim", quote(file.to_string_lossy().into_owned()))?;
        }
    }
    writeln!(
        out,
        "\nrare paths: {} of {} ran",
        summary.marks.len(),
        summary.marks.len() + summary.never.len()
    )?;
    for never in &summary.never {
        writeln!(out, "  {} {never}", paint.strong("never ran:"))?;
    }
    Ok(())
}

/// Notes one of the first.
fn note(numbers: &mut Vec<u64>, number: u64) {
    if numbers.len() < NAMED {
        numbers.push(number);
    }
}

/// The seeds of runs by their numbers.
pub fn seeds(from: u64, numbers: &[u64]) -> Vec<u64> {
    numbers.iter().map(|n| from.wrapping_add(*n)).collect()
}

fn spaced<'a>(seeds: impl IntoIterator<Item = &'a u64>) -> String {
    seeds.into_iter().map(u64::to_string).collect::<Vec<_>>().join(" ")
}

fn s(n: u64) -> &'static str {
    if n == 1 { "" } else { "s" }
}
