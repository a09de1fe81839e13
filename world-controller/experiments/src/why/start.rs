//! The part of the start in the end of a run: whether any random numbers, any other strategy or any robot would have helped.

use super::futures::{Futures, Oracle, Question, Reseeded, Tally};
use super::subject::Subject;
use metamorph_processes::family::{families, read_text};
use metamorph_protocol::time::Time;
use metamorph_scenario::schema::schema;
use metamorph_scenario::settings::Setting;
use metamorph_scenario::{Overrides, Plan};
use serde::Serialize;

/// Number of futures of the start under each alternative.
const FUTURES: u64 = 100;
/// Keys of `[protocol]` that choose how modules decide.
const STRATEGIES: [&str; 2] = ["strategy", "connectivity"];

/// The part of a start that decides.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Cause {
    /// No robot with these modules could have built the goal, as a search proved.
    Impossible,
    /// Chance: with other random numbers of all that draws, not of links only, futures end otherwise.
    Chance,
    /// The strategy: under another one futures end otherwise.
    Strategy,
    /// The placement: it ends like this under every strategy.
    Placement,
}

/// Futures of a start under one strategy.
pub struct Alternative {
    /// The strategy, as a setting.
    pub setting: String,
    /// Its futures.
    pub tally: Tally,
}

/// The part that decides, and the futures that say so.
pub struct Start {
    /// The part that decides.
    pub cause: Cause,
    /// Futures with other random numbers of everything.
    pub all: Tally,
    /// Futures under other strategies.
    pub alternatives: Vec<Alternative>,
}

/// Asks which part of a start decides; `first` are the futures of the start. Returns `None` if that was stopped.
pub fn ask(subject: &Subject, first: &Tally, question: &Question<'_>) -> Option<Start> {
    let at_start = |plan: &Plan, reseeded| {
        let mut futures = Futures::new(plan, Time::ZERO, question, reseeded);
        let start = futures.point(0);
        futures.count(&start, 1..FUTURES + 1)
    };
    let all = at_start(&subject.plan, Reseeded::All)?;
    let mut alternatives = Vec::new();
    for (setting, plan) in others(&subject.plan) {
        alternatives.push(Alternative { setting, tally: at_start(&plan, Reseeded::Links)? });
    }
    let direction = subject.direction();
    let ends_otherwise =
        |tally: &Tally| !direction.is_decided(tally) && direction.change(tally, first).low > 0.0;
    let cause = match () {
        () if subject.could == Some(false) && all.yes == 0 => Cause::Impossible,
        () if ends_otherwise(&all) => Cause::Chance,
        () if alternatives.iter().any(|other| ends_otherwise(&other.tally)) => Cause::Strategy,
        () => Cause::Placement,
    };
    Some(Start { cause, all, alternatives })
}

/// Returns the plans with other strategies that are valid, each with its setting.
fn others(plan: &Plan) -> Vec<(String, Plan)> {
    let schema = schema(families());
    let protocol = &schema["$defs"][format!("{}Protocol", plan.swarm.family())]["properties"];
    let names = |key: &'static str| {
        let names = protocol[key]["enum"].as_array().cloned().unwrap_or_default();
        names.into_iter().filter_map(move |name| Some(format!("protocol.{key}={}", name.as_str()?)))
    };
    let with = |setting: String| {
        let mut settings = plan.overrides.settings.clone();
        settings.push(Setting { option: "--set", text: setting.clone() });
        let overrides = Overrides { settings, seed: Some(plan.seed), ..plan.overrides.clone() };
        let other = read_text(&plan.origin, &plan.text, &overrides).ok()?;
        (other.swarm.protocol() != plan.swarm.protocol()).then_some((setting, other))
    };
    STRATEGIES.into_iter().flat_map(names).filter_map(with).collect()
}
