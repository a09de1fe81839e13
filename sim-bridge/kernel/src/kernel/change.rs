//! Changes of a simulated run at one of its events: other random numbers from there on, another level of rescue, a message that is
//! lost, a process that sleeps.
//!
//! Scenario, seed and changes together determine a run. A copy of a run that is changed is therefore the run of a scenario with
//! that change, which can be carried out from its start.

use crate::director::rescue::Rescue;
use metamorph_core::ids::{Incarnation, ModuleId};
use metamorph_core::record::MessageName;
use metamorph_core::rng::Rng;
use metamorph_core::time::Span;
use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// One change of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Change {
    /// The number of events of the kernel before it. Many events happen at one instant, so a time would not do.
    pub after: u64,
    /// The kind of change.
    pub kind: ChangeKind,
}

/// The kind of a change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ChangeKind {
    /// Links draw from new streams, which this number selects: those between modules, to other hosts and to the controller. A
    /// message under way keeps the arrival that was drawn when it was sent.
    Links(u64),
    /// Everything that draws as the run proceeds has new streams: links as with the same number in `Links`, and besides them
    /// agents, joints and connections that fail, and a scripted operator. Faults, starts and goals are drawn before a run, and stay.
    All(u64),
    /// The controller helps a swarm that stands still as far as this.
    Rescue(Rescue),
    /// A message does not arrive: one that is under way, or will be sent.
    Lose(MessageName),
    /// The process of a module does not run for so long; what it should handle waits.
    Sleep(ModuleId, Span),
}

impl Change {
    /// Returns the seed of the new streams in the run of the seed `run`; `None` if the change brings none.
    pub fn seed(&self, run: u64) -> Option<u64> {
        let (ChangeKind::Links(number) | ChangeKind::All(number)) = self.kind else { return None };
        let chosen = Rng::named(run, "fork", number).next_u64();
        Some(Rng::named(chosen, "fork event", self.after).next_u64())
    }
}

/// Reads the name of a message, such as `7.0.213`: the sender, its incarnation, and the number among its messages.
pub fn message(text: &str) -> Option<MessageName> {
    let mut numbers = text.splitn(3, '.');
    Some(MessageName {
        from: ModuleId(numbers.next()?.parse().ok()?),
        incarnation: Incarnation(numbers.next()?.parse().ok()?),
        number: numbers.next()?.parse().ok()?,
    })
}

/// The form of a change in options, journals and messages, such as `links=17@48213`.
impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.kind {
            ChangeKind::Links(number) => write!(f, "links={number}"),
            ChangeKind::All(number) => write!(f, "all={number}"),
            ChangeKind::Rescue(level) => write!(f, "rescue={level}"),
            ChangeKind::Lose(MessageName { from, incarnation, number }) => {
                write!(f, "lose={from}.{incarnation}.{number}")
            }
            ChangeKind::Sleep(module, span) => write!(f, "sleep={module}/{span}"),
        }?;
        write!(f, "@{}", self.after)
    }
}

/// A text that is no change.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("`{0}` is no change of a run")]
pub struct NoChange(String);

impl FromStr for Change {
    type Err = NoChange;

    fn from_str(text: &str) -> Result<Change, NoChange> {
        let read = || {
            let (what, after) = text.rsplit_once('@')?;
            let (name, value) = what.split_once('=')?;
            let kind = match name {
                "links" => ChangeKind::Links(value.parse().ok()?),
                "all" => ChangeKind::All(value.parse().ok()?),
                "lose" => ChangeKind::Lose(message(value)?),
                "sleep" => {
                    let (module, span) = value.split_once('/')?;
                    ChangeKind::Sleep(ModuleId(module.parse().ok()?), span.parse().ok()?)
                }
                "rescue" => ChangeKind::Rescue(Rescue::ALL.into_iter().find(|level| level.name() == value)?),
                _ => return None,
            };
            Some(Change { after: after.parse().ok()?, kind })
        };
        read().ok_or_else(|| NoChange(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_change_reads_as_it_is_written() {
        for text in ["links=17@48213", "all=0@0", "rescue=off@9", "lose=7.0.213@5", "sleep=7/1s@5"] {
            assert_eq!(text.parse::<Change>().unwrap().to_string(), text);
        }
        for text in [
            "",
            "links=17",
            "links@17",
            "links=-1@3",
            "rescue=more@3",
            "seed=1@2",
            "all=1@x",
            "lose=7.0@5",
            "lose=7.0.1.2@5",
            "sleep=7@5",
        ] {
            assert_eq!(text.parse::<Change>(), Err(NoChange(text.to_owned())), "{text}");
        }
    }

    #[test]
    fn streams_differ_by_run_number_and_event() {
        let seed = |run, text: &str| text.parse::<Change>().unwrap().seed(run);
        assert_eq!(seed(1, "links=17@5"), seed(1, "all=17@5"));
        let all =
            [seed(1, "links=17@5"), seed(2, "links=17@5"), seed(1, "links=18@5"), seed(1, "links=17@6")];
        for (i, a) in all.iter().enumerate() {
            assert!(a.is_some() && all[i + 1..].iter().all(|b| a != b));
        }
        assert_eq!(seed(1, "rescue=off@5"), None);
    }
}
