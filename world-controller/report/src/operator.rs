//! The section of the report on the cost of an operator.

use metamorph_core::time::{Span, Time};
use metamorph_kernel::director::operator::Operator;
use metamorph_kernel::director::team::Measures;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// The operator of a run, and the measures of the team (thesis E.2). Times are scenario times.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct OperatorReport {
    /// `scripted`.
    pub kind: String,
    /// What was commanded: `full`, the goal only; `shared`, modules too; `safe`, `teleoperation`, modules only.
    pub level: String,
    /// A swarm without progress for this long counts as stuck (s).
    pub window_s: f64,
    /// Commands given.
    pub commands: u64,
    /// Those of them that a rule refused.
    pub refused: u64,
    /// Cases in which no command would have helped.
    pub helpless: u64,
    /// Requests of the swarm (`[protocol] ask`).
    #[serde(default)]
    pub requests: u64,
    /// Those that ended after the operator had commanded something: answered in time.
    #[serde(default)]
    pub answered: u64,
    /// Mixed initiative: requests, as a share of requests and of commands that nothing had asked for; null if there was
    /// neither.
    #[serde(default)]
    pub mixed_initiative: Option<f64>,
    /// Commands in a minute.
    pub commands_per_minute: f64,
    /// Mean time until a standstill was noticed (s); null if there was none.
    pub notice_s: Option<f64>,
    /// Agreement of what the operator believed to be stuck with what was (Jaccard), as a mean over time.
    pub awareness: Option<f64>,
    /// With the swarm as the unit.
    pub swarm: TeamReport,
    /// With every module as a unit.
    pub modules: TeamReport,
}

/// The measures of one kind of unit. Null where nothing was to be measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
pub struct TeamReport {
    /// Interactions, with gaps of up to 5 s closed.
    pub interactions: u64,
    /// Mean interaction time IT (s).
    pub interaction_s: Option<f64>,
    /// Mean recovery time RT after an interaction (s).
    pub recovery_s: Option<f64>,
    /// Interactions without recovery before the next one, or the end.
    pub failed: u64,
    /// Neglect times.
    pub neglected: u64,
    /// Those that ended by a loss of performance.
    pub neglected_complete: u64,
    /// Median neglect tolerance NT (s, by Kaplan and Meier); null if less than half ended.
    pub neglect_median_s: Option<f64>,
    /// Mean neglect tolerance, restricted to the longest (s).
    pub neglect_mean_s: Option<f64>,
    /// Mean wait WT for the operator (s).
    pub wait_s: Option<f64>,
    /// Robot attention demand RAD.
    pub attention_demand: Option<f64>,
    /// Coordination demand CD.
    pub coordination_demand: Option<f64>,
    /// Predicted fan-out FO.
    pub fan_out: Option<u64>,
    /// Predicted fan-out, if waits count.
    pub fan_out_waiting: Option<u64>,
    /// Share of the run that interactions cover.
    pub intervention_share: f64,
}

impl OperatorReport {
    /// Returns the report of an operator at the end of a run.
    pub fn of(operator: &Operator, end: Time) -> OperatorReport {
        let (counts, habits) = (operator.counts(), operator.habits());
        let minutes = end.as_secs_f64() / 60.0;
        let share = |part: u64, of: u64| (of > 0).then(|| part as f64 / of as f64);
        OperatorReport {
            kind: "scripted".to_owned(),
            level: habits.level.name().to_owned(),
            window_s: habits.window.as_secs_f64(),
            commands: counts.commands,
            refused: counts.refused,
            helpless: counts.helpless,
            requests: counts.requests,
            answered: counts.answered,
            mixed_initiative: share(counts.requests, counts.requests + counts.unasked),
            commands_per_minute: if minutes > 0.0 { counts.commands as f64 / minutes } else { 0.0 },
            notice_s: share(counts.notice_delay.0, counts.noticed).map(|ns| ns / 1e9),
            awareness: share(counts.aware, counts.compared),
            swarm: TeamReport::of(&operator.log(end).measures()),
            modules: TeamReport::of(&operator.log_of_parts(end).measures()),
        }
    }

    /// Returns the lines of the report for people: a label each, and the text.
    pub fn text(&self) -> String {
        let unit = |team: &TeamReport| {
            let or_none = |value: Option<f64>| value.map_or("none".to_owned(), |v| format!("{v:.1} s"));
            format!(
                "IT {}, NT median {}, mean {}, WT {}, FO {}",
                or_none(team.interaction_s),
                or_none(team.neglect_median_s),
                or_none(team.neglect_mean_s),
                or_none(team.wait_s),
                team.fan_out.map_or("unbounded".to_owned(), |fan_out| fan_out.to_string()),
            )
        };
        format!(
            "{} ({}): {} in {}, {} refused; {}",
            self.kind,
            self.level,
            metamorph_text::format::many(self.commands, "command"),
            metamorph_text::format::many(self.swarm.interactions, "interaction"),
            self.refused,
            unit(&self.swarm)
        )
    }
}

impl TeamReport {
    /// Returns measures in nanoseconds in the units of reports.
    pub fn of(measures: &Measures) -> TeamReport {
        let seconds = |ns: f64| ns / 1e9;
        let recovery = measures.recovery.iter().sum::<u64>() as f64 / measures.recovery.len().max(1) as f64;
        TeamReport {
            interactions: measures.interactions,
            interaction_s: measures.interaction_mean.map(seconds),
            recovery_s: (!measures.recovery.is_empty()).then(|| seconds(recovery)),
            failed: measures.failed,
            neglected: measures.neglect.len() as u64,
            neglected_complete: measures.neglect.iter().filter(|(_, is_complete)| *is_complete).count()
                as u64,
            neglect_median_s: measures.neglect_median.map(|ns| Span(ns).as_secs_f64()),
            neglect_mean_s: measures.neglect_mean.map(seconds),
            wait_s: measures.wait_mean.map(seconds),
            attention_demand: measures.attention_demand,
            coordination_demand: measures.coordination_demand,
            fan_out: measures.fan_out,
            fan_out_waiting: measures.fan_out_waiting,
            intervention_share: measures.intervention_share,
        }
    }
}
