//! The results of an exploration: counts, failures by kind, coverage points never reached.

use super::Ran;
use super::verdict::{Failure, Kind, Verdict};
use metamorph_processes::family::{Family, all};
use metamorph_protocol::coverage::CoveragePoint;
use metamorph_scenario::quote;
use metamorph_sim_bridge::director::proof::RuleSet;
use metamorph_text::format::{count, many};
use metamorph_text::paint::Paint;
use metamorph_text::program;
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::PathBuf;

/// The version of the layout of [`Summary`].
pub const SCHEMA: u32 = 6;
/// Largest number of seeds listed per group of similar runs.
const SEEDS_LISTED_MAX: usize = 20;

/// Failures of one kind.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failures {
    /// Number of runs.
    pub count: u64,
    /// The numbers of the first of them.
    pub first: Vec<u64>,
    /// The observation in the first.
    pub what: String,
}

/// The runs that any robot with the same modules could have built, and those of them that were.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct Could {
    /// Runs that were built.
    pub built: u64,
    /// Runs that were built, or for which a search found a plan of any robot.
    pub of: u64,
    /// Runs for which a search found neither a plan nor a proof that there is none.
    pub undecided: u64,
}

/// Runs not built because of a rule of the protocol.
#[derive(Clone, Debug, Serialize)]
pub struct Rule {
    /// The name of the rule.
    pub rule: RuleSet,
    /// Its description.
    pub text: &'static str,
    /// Number of runs.
    pub runs: u64,
}

/// Runs that stood still for one reason, undecided by any search.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Undecided {
    /// The reason as text.
    pub text: String,
    /// Number of runs.
    pub runs: u64,
    /// The seeds of the first of them.
    pub seeds: Vec<u64>,
}

/// Counts over runs.
#[derive(Clone, Debug, Default)]
pub struct Tallies {
    /// Number of runs.
    pub runs: u64,
    events: u64,
    moves: u64,
    messages: u64,
    could: Could,
    outcomes: BTreeMap<&'static str, u64>,
    infeasible: BTreeMap<RuleSet, u64>,
    unrescued: u64,
    standstills: u64,
    rescued: u64,
    undecided: BTreeMap<String, Undecided>,
    failures: BTreeMap<(Kind, String), Failures>,
    marks: BTreeMap<CoveragePoint, u64>,
}

impl Tallies {
    /// Counts a run. Returns its failure if it is the first of its kind.
    pub fn add<'a>(&mut self, number: u64, ran: &'a Ran) -> Option<&'a Failure> {
        self.runs += 1;
        self.events += ran.events;
        self.moves += ran.moves;
        self.messages += ran.messages;
        self.standstills += ran.standstills;
        self.rescued += ran.rescued;
        *self.outcomes.entry(ran.outcome.map_or("panic", |o| o.name())).or_default() += 1;
        for mark in CoveragePoint::ALL.iter().filter(|m| ran.marks.has(**m)) {
            *self.marks.entry(*mark).or_default() += 1;
        }
        self.could.of += u64::from(ran.could == Some(true));
        self.could.undecided += u64::from(ran.could.is_none());
        match &ran.verdict {
            Verdict::Built => self.could.built += 1,
            Verdict::Infeasible(within) => *self.infeasible.entry(*within).or_default() += 1,
            Verdict::Unrescued => self.unrescued += 1,
            Verdict::Excused(reason) => self.note_undecided(reason, ran.reason, number),
            Verdict::Failed(failure) => {
                let first = Failures { count: 0, first: Vec::new(), what: failure.what.clone() };
                let key = (failure.kind.clone(), ran.protocol.clone());
                let failures = self.failures.entry(key).or_insert(first);
                failures.count += 1;
                note(&mut failures.first, number);
                let is_first = failures.count == 1;
                if let Kind::Undecided(reason) = &failure.kind {
                    self.note_undecided(reason, ran.reason, number);
                }
                return is_first.then_some(failure);
            }
        }
        None
    }
    fn note_undecided(&mut self, reason: &str, text: Option<&str>, number: u64) {
        let undecided = self.undecided.entry(reason.to_owned()).or_default();
        undecided.text = text.unwrap_or(reason).to_owned();
        undecided.runs += 1;
        note(&mut undecided.seeds, number);
    }
    /// Returns the number of failed runs.
    pub fn failed(&self) -> u64 {
        self.failures.values().map(|f| f.count).sum()
    }
    /// Returns the failures by kind and protocol.
    pub fn failures(&self) -> &BTreeMap<(Kind, String), Failures> {
        &self.failures
    }
}

/// The results of an exploration as written to JSON.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// The version of this layout.
    pub schema: u32,
    /// The version of the program.
    pub version: String,
    /// The seed of the first run; later runs have consecutive seeds.
    pub seed: u64,
    /// The family explored; null for all.
    pub family: Option<&'static str>,
    /// Number of runs.
    pub runs: u64,
    /// Messages delivered to agents, plus messages between agents, bodies and the controller.
    pub events: u64,
    /// Moves completed.
    pub moves: u64,
    /// Messages sent.
    pub messages: u64,
    /// Number of runs by outcome.
    pub outcomes: BTreeMap<&'static str, u64>,
    /// How many runs any robot could have built, and how many were.
    pub could: Could,
    /// Failed runs: an invariant was violated, a plan existed within the rules, or an undecided standstill
    /// had no excuse.
    pub failed: u64,
    /// Buildable runs that were not built because the protocol keeps a rule; a search proved that no plan
    /// exists within it.
    pub rules: Vec<Rule>,
    /// Runs that were not built although a plan was left, and in which the controller was not allowed to carry one out
    /// (`rescue`). No failures.
    pub unrescued: u64,
    /// Standstills in the course of all runs.
    pub standstills: u64,
    /// Standstills that the controller resolved.
    pub rescued: u64,
    /// Runs that no protocol could have built, as a search proved.
    pub impossible: u64,
    /// Runs for which no search decided whether they were buildable, by the reason of the standstill.
    pub undecided: BTreeMap<String, Undecided>,
    /// The first failure of each kind.
    pub found: Vec<Found>,
    /// Number of runs that reached each coverage point.
    pub marks: BTreeMap<&'static str, u64>,
    /// Coverage points never reached.
    pub never: Vec<&'static str>,
}

/// A kind of failure.
#[derive(Clone, Debug, Serialize)]
pub struct Found {
    /// The kind.
    #[serde(flatten)]
    pub kind: Kind,
    /// The protocol that failed, with its family.
    pub protocol: String,
    /// The seed of the first such run.
    pub seed: u64,
    /// The seeds of the first such runs, including that one.
    pub seeds: Vec<u64>,
    /// Number of runs.
    pub runs: u64,
    /// The observation.
    pub what: String,
    /// The command that repeats the first.
    pub repeat: String,
    /// The shrunk scenario that fails the same way; null if there is none.
    pub scenario: Option<String>,
    /// Its file, relative to the working directory.
    #[serde(skip)]
    pub here: Option<PathBuf>,
    /// Modules of the shrunk scenario.
    pub agents: usize,
    /// Faults of the shrunk scenario.
    pub faults: usize,
    /// Runs needed for shrinking.
    pub shrinking: u64,
}

impl Summary {
    /// Creates the summary from counts and failures.
    pub fn new(seed: u64, family: Option<&dyn Family>, mut tallies: Tallies, found: Vec<Found>) -> Summary {
        for undecided in tallies.undecided.values_mut() {
            undecided.seeds = seeds(seed, &undecided.seeds);
        }
        let failed = tallies.failed();
        let impossible = tallies.infeasible.remove(&RuleSet::Anything).unwrap_or(0);
        let rules = tallies.infeasible.iter();
        let rules = rules.map(|(rule, runs)| Rule { rule: *rule, text: kept(*rule), runs: *runs }).collect();
        // Coverage points of families that were not explored cannot be reached.
        let others = all().iter().filter(|other| family.is_some_and(|family| family.name() != other.name()));
        let others: Vec<String> = others.map(|other| format!("{}:", other.name())).collect();
        let explored = |m: &CoveragePoint| !others.iter().any(|other| m.name().starts_with(other.as_str()));
        let never = CoveragePoint::ALL.iter().filter(|m| explored(m) && !tallies.marks.contains_key(m));
        Summary {
            schema: SCHEMA,
            version: metamorph_text::version::version().to_owned(),
            seed,
            family: family.map(|family| family.name()),
            runs: tallies.runs,
            events: tallies.events,
            moves: tallies.moves,
            messages: tallies.messages,
            could: tallies.could,
            failed,
            rules,
            unrescued: tallies.unrescued,
            standstills: tallies.standstills,
            rescued: tallies.rescued,
            impossible,
            undecided: tallies.undecided,
            outcomes: tallies.outcomes,
            found,
            never: never.map(|m| m.name()).collect(),
            marks: tallies.marks.into_iter().map(|(m, n)| (m.name(), n)).collect(),
        }
    }
}

/// Describes the rule of the protocol within which no plan exists.
const fn kept(rule: RuleSet) -> &'static str {
    match rule {
        RuleSet::Held => "a module does not release what may hang on it, because that could fall off",
        RuleSet::Carried => "walkers carry no other module",
        RuleSet::Grown => "what is built is not taken down again",
        RuleSet::Anything => "nothing is ruled out",
    }
}

/// Formats the summary for people.
pub fn text(summary: &Summary, paint: Paint) -> String {
    let mut out = String::new();
    // Writing to a string cannot fail.
    let _ = write_text(&mut out, summary, paint);
    out
}

/// Writes what could be built, what was, and why the rest was not.
fn write_shares(out: &mut String, summary: &Summary) -> std::fmt::Result {
    let Could { built, of, undecided } = summary.could;
    let undecided = if undecided == 0 { String::new() } else { format!(" ({} undecided)", count(undecided)) };
    let (built, of) = (count(built), count(of));
    writeln!(out, "  built {built} of {of} that any robot could have built{undecided}")?;
    let line = |out: &mut String, n: u64, text: &str| writeln!(out, "    {:>9}  {text}", count(n));
    if !summary.rules.is_empty() {
        let excused = count(summary.rules.iter().map(|rule| rule.runs).sum());
        writeln!(
            out,
            "  {excused} not built because a rule of the protocol excludes every plan, proved by search:"
        )?;
        for rule in &summary.rules {
            line(out, rule.runs, rule.text)?;
        }
    }
    if summary.unrescued > 0 {
        let runs = count(summary.unrescued);
        writeln!(
            out,
            "  {runs} stood still with a plan left that the controller was not allowed to carry out (rescue)"
        )?;
    }
    if summary.standstills > 0 {
        let (all, rescued) = (many(summary.standstills, "standstill"), count(summary.rescued));
        writeln!(out, "  {all} in all runs, of which the controller resolved {rescued}")?;
    }
    if summary.impossible > 0 {
        writeln!(out, "  {} that no robot could build, proved", count(summary.impossible))?;
    }
    if !summary.undecided.is_empty() {
        let undecided = count(summary.undecided.values().map(|u| u.runs).sum());
        writeln!(out, "  {undecided} undecided: no search decided whether a plan existed:")?;
        for undecided in summary.undecided.values() {
            line(out, undecided.runs, &undecided.text)?;
        }
        let seeds = summary.undecided.values().flat_map(|u| &u.seeds).take(SEEDS_LISTED_MAX);
        writeln!(out, "    seeds {}", spaced(seeds))?;
    }
    Ok(())
}

fn write_text(out: &mut String, summary: &Summary, paint: Paint) -> std::fmt::Result {
    let failed = format!("{} failed", count(summary.failed));
    let failed = if summary.failed == 0 { paint.good(&failed) } else { paint.bad(&failed) };
    writeln!(out, "{} from seed {}: {failed}", many(summary.runs, "run"), summary.seed)?;
    let outcomes = summary.outcomes.iter().map(|(name, n)| format!("{} {name}", count(*n)));
    writeln!(out, "  {}", outcomes.collect::<Vec<_>>().join(", "))?;
    write_shares(out, summary)?;
    let (moves, messages) = (many(summary.moves, "move"), many(summary.messages, "message"));
    writeln!(out, "  {}, {moves}, {messages}", many(summary.events, "event"))?;
    for found in &summary.found {
        let Found { kind, protocol, seeds, runs, what, repeat, agents, faults, .. } = found;
        writeln!(out, "\n{} ({protocol}) in {}", paint.bad(&kind.to_string()), many(*runs, "run"))?;
        writeln!(out, "  {what}\n  first in  {repeat}")?;
        if *runs > 1 {
            writeln!(
                out,
                "  seeds {}{}",
                spaced(seeds),
                if *runs > SEEDS_LISTED_MAX as u64 { " ..." } else { "" }
            )?;
        }
        if let Some(file) = &found.here {
            writeln!(
                out,
                "  shrunk to: {}, {} ({})",
                many(*agents as u64, "module"),
                many(*faults as u64, "fault"),
                many(found.shrinking, "run")
            )?;
            let (program, file) = (program::name(), quote(file.to_string_lossy().into_owned()));
            writeln!(out, "  {} run {file} --link sim", quote(program.to_owned()))?;
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

/// Records one of the first runs.
fn note(numbers: &mut Vec<u64>, number: u64) {
    if numbers.len() < SEEDS_LISTED_MAX {
        numbers.push(number);
    }
}

/// Returns the seeds of runs by their numbers.
pub fn seeds(from: u64, numbers: &[u64]) -> Vec<u64> {
    numbers.iter().map(|n| from.wrapping_add(*n)).collect()
}

fn spaced<'a>(seeds: impl IntoIterator<Item = &'a u64>) -> String {
    seeds.into_iter().map(u64::to_string).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_protocol::coverage::CoveragePoints;
    use metamorph_sim_bridge::director::outcome::Outcome;

    fn ran(outcome: Outcome, verdict: Verdict) -> Ran {
        let (protocol, marks) = ("cube, forest".to_owned(), CoveragePoints::default());
        Ran {
            protocol,
            reason: None,
            could: match verdict {
                Verdict::Built | Verdict::Infeasible(RuleSet::Carried) => Some(true),
                Verdict::Infeasible(RuleSet::Anything) => Some(false),
                _ => None,
            },
            verdict,
            outcome: Some(outcome),
            marks,
            standstills: 2,
            rescued: 1,
            events: 1,
            moves: 600,
            messages: 0,
        }
    }

    /// Every run is in one category of the summary, and unbuilt runs have a reason.
    #[test]
    fn every_run_is_accounted_for() {
        let mut tallies = Tallies::default();
        let stuck = |kind: Kind| Verdict::Failed(Failure { kind, what: "seen".into() });
        let verdicts = [
            (Outcome::Built, Verdict::Built),
            (Outcome::Built, Verdict::Built),
            (Outcome::Deadlock, Verdict::Infeasible(RuleSet::Held)),
            (Outcome::Deadlock, Verdict::Infeasible(RuleSet::Carried)),
            (Outcome::Deadlock, Verdict::Infeasible(RuleSet::Carried)),
            (Outcome::Deadlock, Verdict::Infeasible(RuleSet::Anything)),
            (Outcome::Deadlock, Verdict::Unrescued),
            (Outcome::Deadlock, Verdict::Excused("no-lock".into())),
            (Outcome::Deadlock, stuck(Kind::Undecided("blocked".into()))),
            (Outcome::Deadlock, stuck(Kind::Stuck("blocked".into()))),
        ];
        let runs = verdicts.len() as u64;
        for (number, (outcome, verdict)) in (0..).zip(verdicts) {
            tallies.add(number, &ran(outcome, verdict));
        }
        let summary = Summary::new(10, None, tallies, Vec::new());
        let Could { built, of, undecided } = summary.could;
        assert_eq!((summary.runs, summary.failed), (runs, 2));
        assert_eq!((built, of, undecided), (2, 4, 5));
        assert_eq!((summary.impossible, summary.undecided.len()), (1, 2));
        let excused: u64 = summary.rules.iter().map(|r| r.runs).sum();
        let undecided: u64 = summary.undecided.values().map(|u| u.runs).sum();
        // One of the two failures is undecided.
        let unbuilt = excused + summary.unrescued + summary.impossible + undecided + summary.failed;
        assert_eq!(built + unbuilt - 1, runs);
        let text = text(&summary, Paint::PLAIN);
        for part in [
            "10 runs from seed 10: 2 failed",
            "built 2 of 4 that any robot could have built (5 undecided)",
            "3 not built because a rule",
            "2  walkers carry no other module",
            "1 stood still with a plan left",
            "20 standstills in all runs, of which the controller resolved 10",
            "1 that no robot could build",
            "2 undecided:",
            "seeds 18 17",
            "10 events, 6,000 moves, 0 messages",
        ] {
            assert!(text.contains(part), "{part}: {text}");
        }
    }
}
