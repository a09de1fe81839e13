//! The answer as JSON.

use super::decision::{Decision, Withheld};
use super::futures::{Point, Reseeded, Sought, Tally};
use super::search::{Decided, SearchResult};
use super::start::{Cause, Start};
use super::subject::Subject;
use metamorph_processes::family::told;
use metamorph_report::statistics::Rate;
use metamorph_report::two_samples::{Difference, newcombe};
use metamorph_scenario::Plan;
use metamorph_sim_bridge::director::rescue::Rescue;
use schemars::JsonSchema;
use serde::Serialize;

/// The version of the layout of [`Answer`].
pub const SCHEMA: u32 = 1;

/// When and by what the end of a run was decided.
#[derive(Debug, Serialize, JsonSchema)]
pub struct Answer {
    /// The version of this layout.
    pub schema: u32,
    /// The scenario.
    pub scenario: String,
    /// The seed of the run.
    pub seed: u64,
    /// The command that repeats the run.
    pub repeat: String,
    /// The outcome of the run.
    pub outcome: String,
    /// The end that is explained: the outcome, or a standstill and what ended it.
    pub end: String,
    /// The reason of the standstill, or what was observed, in words.
    pub what: String,
    /// Since when, in seconds of scenario time.
    pub since_s: f64,
    /// The end that futures are counted for: `built`, or the invariant that breaks.
    pub sought: String,
    /// The help of the controller in futures; `null` if it is that of the run.
    pub rescue: Option<String>,
    /// The share of such futures along the run.
    pub curve: Vec<PointReport>,
    /// When it was decided: `instant`, `stretch`, `start`, `open` (not yet when the end began), or `unknown`.
    pub decided: &'static str,
    /// The past before the change; of an instant, the one before its event. `null` without an interval.
    pub before: Option<PointReport>,
    /// The past after the change. `null` without an interval.
    pub after: Option<PointReport>,
    /// The change of the share between both. `null` without an interval.
    pub change: Option<ChangeReport>,
    /// The event of an instant, in words.
    pub event: Option<String>,
    /// The inputs without which the run would have ended otherwise, the one with the largest effect first; `null` if that was not asked.
    pub decisions: Option<Vec<DecisionReport>>,
    /// Number of inputs that were withheld.
    pub withheld: u64,
    /// The part of the start that decides, if the start does.
    pub start: Option<StartReport>,
    /// True if the budget ended before the search did.
    pub is_cut_short: bool,
}

/// A past and its futures.
#[derive(Debug, Serialize, JsonSchema)]
pub struct PointReport {
    /// Events before it.
    pub events: u64,
    /// The scenario time in seconds.
    pub at_s: f64,
    /// Futures that end as is looked for.
    pub yes: u64,
    /// All futures.
    pub of: u64,
    /// Their share with its interval.
    pub share: Rate,
    /// The options that repeat the first future that does; `null` if none does.
    pub repeat_yes: Option<String>,
    /// The options that repeat the first future that does not; `null` if all do.
    pub repeat_no: Option<String>,
}

/// An input without which the run would have ended otherwise.
#[derive(Debug, Serialize, JsonSchema)]
pub struct DecisionReport {
    /// The module that took it.
    pub module: u32,
    /// Its incarnation.
    pub incarnation: u16,
    /// The scenario time in seconds.
    pub at_s: f64,
    /// The change that withholds it: a message that is lost, or a process that sleeps.
    pub change: String,
    /// The input and what the agent did, in words.
    pub input: String,
    /// The run without it, at the instant, and its futures.
    pub after: PointReport,
    /// The probability of a difference as large by chance, adjusted for the number of inputs (Fisher 1922, Holm 1979).
    pub p: f64,
}

impl DecisionReport {
    fn of(
        plan: &Plan,
        Withheld { input, change, after, p }: &Withheld,
        rescue: Option<Rescue>,
    ) -> DecisionReport {
        let (module, incarnation) = input.who;
        DecisionReport {
            module: module.0,
            incarnation: incarnation.0,
            at_s: input.at().as_secs_f64(),
            change: change.to_string(),
            input: told(plan, std::slice::from_ref(&input.record)),
            after: PointReport::of(after, rescue),
            p: *p,
        }
    }
}

/// A change of a share with its interval (Newcombe 1998, method 10).
#[derive(Debug, Serialize, JsonSchema)]
pub struct ChangeReport {
    /// The estimate.
    pub by: f64,
    /// The lower end of the interval.
    pub low: f64,
    /// The upper end of the interval.
    pub high: f64,
}

/// The part of a start that decides.
#[derive(Debug, Serialize, JsonSchema)]
pub struct StartReport {
    /// `impossible`, `chance`, `strategy` or `placement`.
    #[schemars(with = "String")]
    pub cause: Cause,
    /// The share with other random numbers of everything that draws.
    pub all: Rate,
    /// The share under each other strategy.
    pub strategies: Vec<StrategyReport>,
}

/// The futures of a start under one strategy.
#[derive(Debug, Serialize, JsonSchema)]
pub struct StrategyReport {
    /// The setting.
    pub setting: String,
    /// The share.
    pub share: Rate,
}

impl PointReport {
    fn of(point: &Point, rescue: Option<Rescue>) -> PointReport {
        let Tally { yes, of, first_yes, first_no } = point.tally;
        let options = |number: u64| {
            let changes = point.changes(rescue, Reseeded::Links, number);
            changes.iter().map(|change| format!("--change {change}")).collect::<Vec<_>>().join(" ")
        };
        PointReport {
            events: point.events,
            at_s: point.at.as_secs_f64(),
            yes,
            of,
            share: point.tally.rate(),
            repeat_yes: first_yes.map(options),
            repeat_no: first_no.map(options),
        }
    }
}

impl Answer {
    /// Puts an answer together.
    pub fn new(
        subject: &Subject,
        found: &SearchResult,
        start: Option<Start>,
        event: Option<String>,
        decision: Option<Decision>,
        rescue: Option<Rescue>,
    ) -> Answer {
        let ends = found.decided.ends();
        let point = |at: &Point| PointReport::of(at, rescue);
        let change = ends.and_then(|(a, b)| newcombe(a.tally.pair(), b.tally.pair()));
        Answer {
            schema: SCHEMA,
            scenario: subject.plan.title(),
            seed: subject.plan.seed,
            repeat: subject.plan.repeat_with(),
            outcome: subject.report.outcome.clone(),
            end: subject.end.clone(),
            what: subject.what.clone(),
            since_s: subject.since.as_secs_f64(),
            sought: match &subject.sought {
                Sought::Built => "built".to_owned(),
                Sought::Broken(invariant) => invariant.clone(),
            },
            rescue: rescue.map(|level| level.name().to_owned()),
            curve: found.curve.iter().map(point).collect(),
            decided: match found.decided {
                Decided::Instant(..) => "instant",
                Decided::Stretch(..) => "stretch",
                Decided::AtStart => "start",
                Decided::NotYet => "open",
                Decided::Unknown => "unknown",
            },
            before: ends.map(|(a, _)| point(a)),
            after: ends.map(|(_, b)| point(b)),
            change: change.map(|Difference { by, low, high }| ChangeReport { by, low, high }),
            withheld: decision.as_ref().map_or(0, |decision| decision.withheld as u64),
            decisions: decision.map(|decision| {
                decision.named.iter().map(|one| DecisionReport::of(&subject.plan, one, rescue)).collect()
            }),
            event,
            start: start.map(|start| StartReport {
                cause: start.cause,
                all: start.all.rate(),
                strategies: (start.alternatives.into_iter())
                    .map(|other| StrategyReport { setting: other.setting, share: other.tally.rate() })
                    .collect(),
            }),
            is_cut_short: found.is_cut_short,
        }
    }
}
