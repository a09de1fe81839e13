//! `[operator]`: the operator of a run, scripted or a person, and how much modules decide for themselves.

use super::definitions::{Definitions, names, of, or, said, table};
use super::diagnostics::{At, Diagnostics, Place};
use super::error::{LONGEST, ScenarioError};
use super::table::{Delay, Node, Section};
use metamorph_core::time::Span;
use metamorph_kernel::director::operator::{Choice, Habits, Level};
use metamorph_kernel::director::steering::LONGEST_LEASE;
use serde_json::json;

/// The kinds of operators, and whether one is scripted. People come by the page, so that a scenario has only their level.
const KINDS: [(&str, bool); 2] = [("scripted", true), ("person", false)];

/// `[operator]` as written.
#[derive(Clone, Debug)]
pub struct RawOperator {
    /// Its place.
    pub place: Place,
    is_scripted: bool,
    look: Option<At<Span>>,
    notice: Option<At<Delay>>,
    think: Option<At<Delay>>,
    act: Option<At<Delay>>,
    choice: Choice,
    level: Level,
    window: Option<At<Span>>,
    lease: Option<At<Span>>,
}

/// A checked `[operator]`. What depends on the family is open.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct OperatorPlan {
    is_scripted: bool,
    habits: Habits,
    window: Option<Span>,
    lease: Option<Span>,
}

impl RawOperator {
    /// Reads the table.
    pub fn read(node: &Node<'_>, diagnostics: &mut Diagnostics) -> Option<RawOperator> {
        let mut section = Section::of(node, "[operator]", "kind = \"scripted\"", diagnostics)?;
        let kind = section.choice("kind", "kind of operator", &KINDS, diagnostics);
        let raw = RawOperator {
            place: node.span().into(),
            is_scripted: kind.unwrap_or(true),
            look: section.get("look", diagnostics),
            notice: section.get("notice", diagnostics),
            think: section.get("think", diagnostics),
            act: section.get("act", diagnostics),
            choice: section.choice("choice", "choice", &Choice::ALL, diagnostics).unwrap_or_default(),
            level: section.choice("level", "level", &Level::ALL, diagnostics).unwrap_or_default(),
            window: section.get("window", diagnostics),
            lease: section.get("lease", diagnostics),
        };
        section.finish(diagnostics);
        Some(raw)
    }

    /// Checks the values.
    pub fn compile(&self, diagnostics: &mut Diagnostics) -> OperatorPlan {
        let spans = [("look", &self.look), ("window", &self.window), ("lease", &self.lease)];
        let delays = [("notice", &self.notice), ("think", &self.think), ("act", &self.act)];
        let given = spans.iter().filter_map(|(key, at)| Some((key, &at.as_ref()?.place)));
        let given = given.chain(delays.iter().filter_map(|(key, at)| Some((key, &at.as_ref()?.place))));
        for (key, place) in given.filter(|_| !self.is_scripted) {
            let (what, instead) = (format!("`{key}` of a person"), "remove it; a person has only a `level`");
            diagnostics.add(place.clone(), ScenarioError::NotYet { what, instead });
        }
        let mut check = |place: &Place, what, value: Span, low: Span, high: Span| {
            if !(low..=high).contains(&value) {
                let (got, low, high) = (value.to_string(), low.to_string(), high.to_string());
                diagnostics.add(place.clone(), ScenarioError::Range { what, got, low, high });
            }
        };
        let least = Span::millis(1);
        for (what, value) in [("look", &self.look), ("window", &self.window)] {
            value.iter().for_each(|at| check(&at.place, what, at.value, least, LONGEST));
        }
        for (what, value) in [("notice", &self.notice), ("think", &self.think), ("act", &self.act)] {
            value.iter().for_each(|at| check(&at.place, what, at.value.1, Span::ZERO, LONGEST));
        }
        self.lease.iter().for_each(|at| check(&at.place, "lease", at.value, least, LONGEST_LEASE));
        let usual = Habits::usual(Span::ZERO);
        let range =
            |delay: &Option<At<Delay>>, usual| delay.as_ref().map_or(usual, |d| (d.value.0, d.value.1));
        let habits = Habits {
            look: self.look.as_ref().map_or(usual.look, |look| look.value),
            notice: range(&self.notice, usual.notice),
            think: range(&self.think, usual.think),
            act: range(&self.act, usual.act),
            choice: self.choice,
            level: self.level,
            ..usual
        };
        let span = |span: &Option<At<Span>>| span.as_ref().map(|at| at.value);
        OperatorPlan {
            is_scripted: self.is_scripted,
            habits,
            window: span(&self.window),
            lease: span(&self.lease),
        }
    }
}

impl OperatorPlan {
    /// Returns how much modules decide for themselves.
    pub fn level(&self) -> Level {
        self.habits.level
    }
    /// Returns the habits of the scripted operator of a swarm in which `window` is the usual time of three moves; `None` if
    /// the operator is a person.
    pub fn habits(&self, window: Span) -> Option<Habits> {
        if !self.is_scripted {
            return None;
        }
        let window = self.window.unwrap_or(window);
        let lease = self.lease.unwrap_or(window * 2).min(LONGEST_LEASE);
        Some(Habits { window, lease, ..self.habits })
    }
}

/// Returns the definition of the table, for the JSON schema.
pub fn schema() -> Definitions {
    let choices = names(&Choice::ALL.map(|(name, _)| name));
    let levels = names(&Level::ALL.map(|(name, _)| name));
    let keys = json!({
        "kind": said("A script, or a person at the page.", or("scripted", names(&KINDS.map(|(name, _)| name)))),
        "look": said("The time between two looks.", or("1s", of("time"))),
        "notice": said("The time between seeing and noticing.", or("0.5s..2s", of("delay"))),
        "think": said("The time to think about one case.", or("1s..4s", of("delay"))),
        "act": said("The time to give one command.", or("0.5s..1.5s", of("delay"))),
        "choice": said("Which of several stuck metamodules is helped first.", or("longest-stuck", choices)),
        "level": said(
            "How much metamodules decide for themselves: all but the goal (`full`), what they are not commanded (`shared`), only what they are released to (`safe`), or nothing (`teleoperation`).",
            or("shared", levels),
        ),
        "window": said(
            "A swarm without progress for this long is stuck. Default: three times the patience of metamodules.",
            of("time"),
        ),
        "lease": said("How long commands hold. Default: twice the window, at most 600s.", of("time")),
    });
    vec![(
        "operator",
        table(
            "A scripted operator, who helps a swarm that is stuck, or the level of a person's commands.",
            &[],
            keys,
        ),
    )]
}
