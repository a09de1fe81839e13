//! Invariants of every run, one named check each.
//!
//! The checks are functions of plain values, so that each can be shown to fire on a constructed violation;
//! worlds and audits call them on the real values. Sources: protocol specification, invariants I1 to I8;
//! thesis 4.1.2 for connectivity.

use metamorph_core::counters::Class;
use metamorph_core::counters::Tally;
use metamorph_core::ids::Session;
use metamorph_core::time::{Span, Time};
use std::fmt;

/// A condition that must always hold. Each family declares its own besides those here.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Invariant {
    /// The name used in reports.
    pub name: &'static str,
    /// True if a violation is a collision of bodies.
    pub is_collision: bool,
}

impl Invariant {
    /// Creates an invariant that is not about collisions.
    pub const fn new(name: &'static str) -> Invariant {
        Invariant { name, is_collision: false }
    }
}

impl fmt::Display for Invariant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

/// No two bodies are in one cell.
pub const ONE_MODULE_PER_CELL: Invariant = Invariant { name: "one-module-per-cell", is_collision: true };
/// An action ends before the grants it rests on.
pub const MOVE_WITHIN_LEASE: Invariant = Invariant::new("move-within-lease");
/// A message is only accepted in the contact session that exists.
pub const SESSION_CURRENT: Invariant = Invariant::new("session-current");
/// Every message sent has met exactly one fate, or is under way.
pub const MESSAGES_BALANCE: Invariant = Invariant::new("messages-balance");
/// Time advances: the inputs that modules are handed at one instant come to an end.
pub const TIME_PASSES: Invariant = Invariant::new("time-passes");

/// One violation of an invariant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Violation {
    /// The invariant.
    pub invariant: Invariant,
    /// The time.
    pub at: Time,
    /// The observation.
    pub what: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} at {}: {}", self.invariant, self.at, self.what)
    }
}

/// Checks [`MOVE_WITHIN_LEASE`]: `granted_until` is the end of the grant of the landing, if it granted.
pub fn move_within_lease(now: Time, move_time: Span, granted_until: Option<Time>) -> Result<(), String> {
    match granted_until {
        Some(until) if now + move_time <= until => Ok(()),
        Some(until) => Err(format!("the move ends at {}, the grant at {until}", now + move_time)),
        None => Err("the landing has granted nothing".into()),
    }
}

/// Checks [`SESSION_CURRENT`] for a message accepted in a session.
pub fn session_current(taken_in: Session, real: Option<Session>) -> Result<(), String> {
    if real == Some(taken_in) {
        Ok(())
    } else {
        Err(format!("a message of session {taken_in} was taken while {real:?} holds"))
    }
}

/// The largest number of inputs per module, on average, at one instant.
const MOST_AT_ONCE: u64 = 1_000;

/// Checks [`TIME_PASSES`] for `inputs` handed to `modules` at one instant. Where messages take no time, two
/// modules that answer each other would go on for ever.
pub fn time_passes(inputs: u64, modules: usize) -> Result<(), String> {
    if inputs <= MOST_AT_ONCE * modules as u64 {
        return Ok(());
    }
    Err(format!(
        "{modules} modules had {inputs} inputs at one instant; their exchange takes no time and has no end"
    ))
}

/// A count for each class of messages.
pub type PerClass = [u64; Class::ALL.len()];

/// Checks [`MESSAGES_BALANCE`]: every message sent has met exactly one fate, or is under way.
pub fn messages_balance(tally: &Tally, under_way: &PerClass) -> Result<(), String> {
    let left = |class| tally[class].in_flight();
    match Class::ALL.into_iter().find(|class| left(*class) != under_way[class.index()] as i64) {
        None => Ok(()),
        Some(class) => Err(format!(
            "{} {class} messages are unaccounted for, {} are under way",
            left(class),
            under_way[class.index()]
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn move_within_lease_fires() {
        assert!(move_within_lease(Time(5), Span(5), Some(Time(10))).is_ok());
        assert!(move_within_lease(Time(6), Span(5), Some(Time(10))).is_err());
        assert!(move_within_lease(Time(6), Span(5), None).is_err());
    }

    #[test]
    fn session_current_fires() {
        assert!(session_current(Session(1), Some(Session(1))).is_ok());
        assert!(session_current(Session(1), Some(Session(2))).is_err());
        assert!(session_current(Session(1), None).is_err());
    }

    #[test]
    fn time_passes_fires() {
        assert!(time_passes(3_000, 3).is_ok());
        assert!(time_passes(3_001, 3).is_err());
    }

    #[test]
    fn messages_balance_fires() {
        let mut tally = Tally::default();
        tally[Class::Seed].sent = 3;
        tally[Class::Gradient].delivered = 2;
        // The sum over all classes is balanced, the classes are not.
        let under_way = |seed, gradient| {
            let mut of = [0; Class::ALL.len()];
            (of[Class::Seed.index()], of[Class::Gradient.index()]) = (seed, gradient);
            of
        };
        assert!(messages_balance(&tally, &under_way(1, 0)).is_err());
        tally[Class::Gradient].sent = 2;
        assert!(messages_balance(&tally, &under_way(3, 0)).is_ok());
        assert!(messages_balance(&tally, &under_way(2, 0)).is_err());
        assert!(messages_balance(&tally, &under_way(2, 1)).is_err());
    }
}
