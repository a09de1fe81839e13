//! Judges a run: it must always be safe, and it must build the goal unless the remaining modules cannot.

use metamorph_report::run_result::{Question, RunResult};
use metamorph_report::schema::Report;
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_sim_bridge::director::proof::{Found, RuleSet};
use metamorph_sim_bridge::director::reason::{Excuse, Proves, SELF_BLOCKED};
use metamorph_sim_bridge::director::rescue::Rescue;
use serde::Serialize;
use std::fmt;

/// The verdict on a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// The goal was built.
    Built,
    /// The goal was not built, and an exhaustive search proved that no more of it could be.
    Infeasible(RuleSet),
    /// The goal was not built for a reason that excuses the protocol, although no search proved it
    /// impossible.
    Excused(String),
    /// The goal was not built although a plan was left, and the controller was not allowed to carry one out.
    Unrescued,
    /// The run failed.
    Failed(Failure),
}

/// The kind of a failure. Runs of the same kind fail the same way.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case", tag = "failure", content = "name")]
pub enum Kind {
    /// The program panicked.
    Panic,
    /// This invariant was violated first.
    Unsafe(String),
    /// The goal was not built although a plan was left, or although nothing was broken. Holds the reason of
    /// the standstill, or the outcome if the report has no standstill.
    Stuck(String),
    /// A standstill for which no search decided whether a plan was left. Holds its reason.
    Undecided(String),
}

impl Kind {
    /// Returns true for a safety failure, false for a liveness failure.
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
    /// The kind of failure.
    pub kind: Kind,
    /// The observation.
    pub what: String,
}

/// Returns the verdict, and whether any robot with these modules could have built the goal; `None` if neither the reason
/// nor a search decided that. If none could, a run that was infeasible within narrower rules, or excused, becomes
/// infeasible under [`RuleSet::Anything`].
pub fn could_be_built(verdict: Verdict, ran: &RunResult) -> (Verdict, Option<bool>) {
    let could = match verdict {
        Verdict::Built => Some(true),
        Verdict::Infeasible(RuleSet::Anything) => Some(false),
        _ => proved(ran.stall.as_ref().map(|stall| stall.reason.proves), ran.snapshot.as_deref()),
    };
    match (verdict, could) {
        (Verdict::Infeasible(_) | Verdict::Excused(_), Some(false)) => {
            (Verdict::Infeasible(RuleSet::Anything), could)
        }
        (verdict, could) => (verdict, could),
    }
}

/// Returns whether any robot could have built the goal, by what the reason of a standstill proves, or else by a search.
/// Counting decides it only where there is no search, which knows more of what can move.
fn proved(proves: Option<Proves>, question: Option<&dyn Question>) -> Option<bool> {
    match (proves, question) {
        (Some(Proves::Incomplete), _) | (Some(Proves::Counted), None) => Some(false),
        (_, question) => question.and_then(Question::could_be_built),
    }
}

/// Judges a run by its report, and by a search for what could still be built.
pub fn judge(report: &Report, ran: &RunResult) -> Verdict {
    let (reason, question) = (ran.stall.as_ref().map(|stall| stall.reason), ran.snapshot.as_deref());
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
    // A standstill that the controller may not resolve shows the local protocol itself. A swarm in which nothing is broken gets
    // no help at any level.
    let level = report.standstills.as_ref().map_or("", |standstills| standstills.rescue.as_str());
    let is_alone = !whole && [Rescue::Off, Rescue::Calls].iter().any(|alone| alone.name() == level);
    let (kind, way) = match searched {
        Err(Found::Way(_)) if is_alone => return Verdict::Unrescued,
        Err(Found::Way(moves)) => (Kind::Stuck(reason), format!(", with a plan of {moves} moves")),
        _ if whole => (Kind::Stuck(reason), ", with nothing broken".into()),
        Ok(within) => match question.filter(|_| within >= RuleSet::Grown).and_then(Question::plan_before) {
            None => return Verdict::Infeasible(within),
            Some(moves) => {
                let way = format!(", with a plan of {moves} moves where the last fault left the modules");
                (Kind::Stuck(SELF_BLOCKED.name.to_owned()), way)
            }
        },
        _ if excused || is_alone => return Verdict::Excused(reason),
        _ => (Kind::Undecided(reason), String::new()),
    };
    let what = format!(
        "{} at {} s, since {} s{way}: {}; {} unfilled, waiting: {}",
        report.outcome,
        report.time.virtual_s,
        stall.since_s,
        stall.text,
        stall.open.len(),
        stall.waiting.iter().map(|w| w.module.to_string()).collect::<Vec<_>>().join(" ")
    );
    Verdict::Failed(Failure { kind, what })
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_report::prospect::Prospect;

    /// A search with this result.
    struct Searched(Option<bool>);

    impl Question for Searched {
        fn prospect(&self) -> Prospect {
            Prospect::UNDECIDED
        }
        fn judge(&self, _: bool) -> Result<RuleSet, Found> {
            Err(Found::Undecided)
        }
        fn could_be_built(&self) -> Option<bool> {
            self.0
        }
    }

    #[test]
    fn what_a_reason_proves_needs_no_search() {
        let (yes, no) = (Some(true), Some(false));
        for (proves, searched, could) in [
            (Proves::Incomplete, None, no),
            (Proves::Incomplete, Some(None), no),
            (Proves::Counted, None, no),
            (Proves::Counted, Some(None), None),
            (Proves::Counted, Some(yes), yes),
            (Proves::Nothing, None, None),
            (Proves::Nothing, Some(yes), yes),
            (Proves::NotHere, Some(no), no),
        ] {
            let question = searched.map(Searched);
            let question = question.as_ref().map(|q| q as &dyn Question);
            assert_eq!(proved(Some(proves), question), could, "{proves:?} {searched:?}");
        }
    }
}
