//! The run that is explained: how it ended, and since when.

use super::error::WhyError;
use super::futures::Sought;
use super::search::Direction;
use crate::explore::verdict::{could_be_built, judge};
use metamorph_families::simulated::to_the_end;
use metamorph_processes::family::begin;
use metamorph_protocol::time::Time;
use metamorph_report::schema::Report;
use metamorph_scenario::Plan;
use metamorph_sim_bridge::director::outcome::Outcome;
use metamorph_sim_bridge::director::standstills::{StandstillEnd, StandstillRecord};

/// A run to be explained.
pub struct Subject {
    /// The plan.
    pub plan: Plan,
    /// The end that futures are asked for.
    pub sought: Sought,
    /// When the standstill began, the invariant broke, or the run ended.
    pub since: Time,
    /// The end, in words: the outcome, or a standstill and what ended it.
    pub end: String,
    /// The reason of the standstill, or what was observed, in words.
    pub what: String,
    /// False if a search proved that no robot could have built the goal; `None` if it decided nothing.
    pub could: Option<bool>,
    /// The report of the run.
    pub report: Report,
}

/// Carries out a run, and finds what is to be explained: its end, or the standstill with this number, from 1.
pub fn examine(plan: &Plan, standstill: Option<usize>, stop: &dyn Fn() -> bool) -> Result<Subject, WhyError> {
    let mut run = begin(plan);
    to_the_end(&mut *run, &mut |_, _| !stop());
    if run.outcome() == Outcome::Aborted && stop() {
        return Err(WhyError::Stopped);
    }
    let (report, result) = run.conclude(true, Vec::new());
    let standstills: Vec<&StandstillRecord> = result.standstills.kept().iter().collect();
    let subject = |sought, since, what, could| Subject {
        end: report.outcome.clone(),
        plan: plan.clone(),
        sought,
        since,
        what,
        could,
        report: report.clone(),
    };
    if let Some(number) = standstill {
        let record = number.checked_sub(1).and_then(|i| standstills.get(i));
        let record = record.ok_or(WhyError::NoStandstill { number, of: standstills.len() })?;
        let ended = match record.end {
            StandstillEnd::Nothing => "which lasted".to_owned(),
            StandstillEnd::Itself => "which ended by itself".to_owned(),
            end => format!("resolved by {}", end.name()),
        };
        let end = format!("standstill {number}, {ended},");
        let explained = subject(Sought::Built, record.stall.since, record.stall.text.to_owned(), None);
        return Ok(Subject { end, ..explained });
    }
    if let Some(first) = run.violations().first() {
        let (name, what) =
            (first.invariant.name.to_owned(), format!("{}: {}", first.invariant.name, first.what));
        // The last point is before the break, else all of its futures have it.
        return Ok(subject(Sought::Broken(name), Time(first.at.0.saturating_sub(1)), what, None));
    }
    let could = could_be_built(judge(&report, &result), &result).1;
    match (run.outcome(), &result.stall) {
        (Outcome::Built, _) => Err(WhyError::Built(standstills.len())),
        (_, Some(stall)) => Ok(subject(Sought::Built, stall.since, stall.text.to_owned(), could)),
        (outcome, None) => Ok(subject(Sought::Built, run.now(), outcome.name().to_owned(), could)),
    }
}

impl Subject {
    /// Returns the direction in which futures change towards the end of the run.
    pub fn direction(&self) -> Direction {
        match self.sought {
            Sought::Built => Direction::Falls,
            Sought::Broken(_) => Direction::Rises,
        }
    }
}
