//! What a run came to, judged: safe always; and live, unless what is left cannot build the goal.

use crate::report::run_result::RunResult;
use crate::report::schema::Report;
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_sim_bridge::director::proof::{Found, Within};
use metamorph_sim_bridge::director::reason::{Excuse, Proves};
use serde::Serialize;
use std::fmt;

/// What a run came to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The goal was built.
    Built,
    /// It was not, and an exhaustive search proved that nothing more could have been built.
    Infeasible(Within),
    /// It was not, and by the reason that is named that is no fault of the protocol; no search proved it.
    Excused(String),
    /// Something is wrong.
    Failed(Failure),
}

/// In what way a run failed. Two runs of one kind fail the same way.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case", tag = "failure", content = "name")]
pub enum Kind {
    /// The program panicked.
    Panic,
    /// This invariant broke first.
    Unsafe(String),
    /// There was a way left, and nobody went it: the reason of the standstill.
    Stuck(String),
    /// Nobody went on, and no search has decided whether there was a way: the reason of the standstill.
    Undecided(String),
}

impl Kind {
    /// Whether something happened that must never happen, instead of something not happening.
    pub fn is_unsafe(&self) -> bool {
        matches!(self, Kind::Panic | Kind::Unsafe(_))
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Kind::Panic => f.write_str("panic"),
            Kind::Unsafe(invariant) => write!(f, "unsafe: {invariant}"),
            Kind::Stuck(reason) => write!(f, "stuck: {reason}"),
            Kind::Undecided(reason) => write!(f, "stuck, undecided: {reason}"),
        }
    }
}

/// A failed run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    /// In what way.
    pub kind: Kind,
    /// What was seen.
    pub what: String,
}

/// Judges a run by its report, and by what a search finds that could still be built.
pub fn judge(report: &Report, ran: &RunResult) -> Verdict {
    let (reason, question) = (ran.stall.as_ref().map(|stall| stall.reason), ran.plight.as_deref());
    if let Some(first) = report.invariants.violated.first() {
        let kind = Kind::Unsafe(first.invariant.clone());
        return Verdict::Failed(Failure { kind, what: format!("at {} s: {}", first.at_s, first.what) });
    }
    if report.outcome == Outcome::Built.name() {
        return Verdict::Built;
    }
    let Some(stall) = &report.unbuilt else {
        let kind = Kind::Stuck(report.outcome.clone());
        return Verdict::Failed(Failure { kind, what: report.reason.clone() });
    };
    let dead = report.agents.alive < report.agents.launched;
    let broken = dead || report.faults.iter().any(|f| f.fault == "stick");
    let excused = reason.is_some_and(|reason| match reason.excuse {
        Excuse::Never => false,
        Excuse::IfDead => dead,
        Excuse::IfBroken => broken,
        Excuse::ByDesign | Excuse::Always => true,
    });
    let restarted = report.faults.iter().any(|f| f.fault == "restart");
    let whole = !broken && !restarted && question.is_some_and(|q| q.blames_whole_modules());
    let not_here = reason.is_some_and(|reason| reason.proves == Proves::NotHere);
    let searched = question.map_or(Err(Found::Undecided), |q| q.judge(not_here));
    let reason = stall.reason.clone();
    let (kind, way) = match searched {
        Err(Found::Way(moves)) => (Kind::Stuck(reason), format!(", with a way of {moves} moves")),
        _ if whole => (Kind::Stuck(reason), ", with nothing broken".into()),
        Ok(within) => return Verdict::Infeasible(within),
        _ if excused => return Verdict::Excused(reason),
        _ => (Kind::Undecided(reason), String::new()),
    };
    let what = format!(
        "{} at {} s, since {} s{way}: {}; {} unfilled, waiting: {}",
        report.outcome,
        report.time.virtual_s,
        stall.since_s,
        stall.text,
        stall.unfilled.len(),
        stall.waiting.iter().map(|w| w.module.to_string()).collect::<Vec<_>>().join(" ")
    );
    Verdict::Failed(Failure { kind, what })
}
