//! The phase of a metamodule: idle, asking for a lock, or moving.

use super::message::{Action, BodyAction, Percept, Refusal};
use super::plan::{Aim, Plan};
use super::pose::{Load, Pose};
use super::view::View;
use metamorph_core::coverage::{CoveragePoint, hit};
use metamorph_core::defects::Defect;
use metamorph_core::digest::Portable;
use metamorph_core::ids::{Port, PortSet};
use metamorph_core::time::{Span, Time};
use std::hash::Hash;

/// Number of failures in a row after which an action is given up for now.
const TRIES: u8 = 5;

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) enum Phase {
    /// It looks for something to do at this time, or earlier if it hears something new.
    Idle { look_at: Time },
    /// It waits for answers to its request.
    Asking(Attempt),
    /// It moves, under a lock.
    Moving(Motion),
}

impl Phase {
    /// Feeds the phase into a hash, without when to look or ask again; see `digest`.
    pub fn digest(&self, hasher: &mut Portable<'_>) {
        match self {
            Phase::Idle { look_at: _ } => 0u8.hash(hasher),
            Phase::Asking(Attempt { plan, pending, asked, again: _ }) => {
                (1u8, plan, pending, asked).hash(hasher);
            }
            Phase::Moving(Motion { plan, next, tries, until }) => {
                (2u8, plan, next, tries, until).hash(hasher);
            }
        }
    }
    /// Whether it does nothing until it hears something new.
    pub fn is_waiting(&self) -> bool {
        matches!(self, Phase::Idle { look_at: Time::NEVER })
    }
}

/// A lock that has been asked for.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Attempt {
    pub plan: Plan,
    /// Ports that have not answered.
    pub pending: PortSet,
    pub asked: Time,
    /// When the request is repeated, or the motion begins if all have answered.
    pub again: Time,
}

impl Attempt {
    /// Notes that the neighbour on a port has granted the lock, or need not grant it. Returns true if no answer is
    /// pending any more.
    pub fn granted_by(&mut self, port: Port) -> bool {
        self.pending.remove(port);
        self.pending.is_empty()
    }
}

/// A motion under way.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Motion {
    pub plan: Plan,
    /// The number of the next step.
    next: usize,
    /// The number of times in a row that the next action has failed.
    tries: u8,
    /// When the lease of the lock ends.
    pub until: Time,
}

/// Next stage of a motion.
pub(super) enum Next {
    Act(Action),
    /// The body has taken the shape of its seed.
    Settled,
    /// The body has taken another shape on the spot.
    Shifted,
    /// The lock would end during the next action.
    LockRunsOut,
}

/// How a motion continues after an action has ended well.
pub(super) enum Progress {
    /// A joint has turned.
    Turned,
    /// The free end has gripped; the other one is to detach.
    Gripped,
    /// The other end has detached, and the move is complete.
    Moved,
}

/// How a motion continues after an action that was not carried out.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Setback {
    Retry,
    GiveUp,
    /// It is given up because a joint does not turn.
    Stuck,
}

impl Motion {
    /// Creates a motion whose lock was asked for at `asked`; the lease runs from that time on.
    pub fn new(plan: Plan, asked: Time, lease: Span) -> Motion {
        Motion { plan, next: 0, tries: 0, until: asked + lease }
    }

    /// The next action of the body, or how the motion has ended.
    pub fn next(&self, v: View<'_>) -> Next {
        let params = v.params();
        let (body_action, takes) = match (self.plan.steps.get(self.next), self.plan.aim) {
            (Some(step), _) => (BodyAction::Turn(*step), params.turn_time),
            (None, Aim::Settle(_)) => return Next::Settled,
            (None, Aim::Shift) => return Next::Shifted,
            (None, Aim::Handle(Load::NONE)) => (BodyAction::LetGo, params.connect_time),
            (None, Aim::Handle(load)) => (BodyAction::Grip(load), params.connect_time),
            (None, Aim::Land) if v.own.pose.both => (BodyAction::Detach, params.connect_time),
            (None, Aim::Land) => (BodyAction::Attach, params.connect_time),
        };
        let not_after = self.until - takes - params.clock_margin();
        let is_late = v.now > not_after;
        if is_late {
            hit(CoveragePoint::MetaLockRanOut);
        }
        if v.has(Defect::OutstayLease) {
            return Next::Act(Action { body_action, not_after: Time::NEVER });
        }
        if is_late { Next::LockRunsOut } else { Next::Act(Action { body_action, not_after }) }
    }

    /// Notes that an action has ended well, with the body at `pose`.
    pub fn on_done(&mut self, pose: Pose) -> Progress {
        self.tries = 0;
        if self.next < self.plan.steps.len() {
            self.next += 1;
            Progress::Turned
        } else if pose.both {
            Progress::Gripped
        } else {
            Progress::Moved
        }
    }

    /// Notes that an action was not carried out.
    pub fn on_failure(&mut self, percept: Percept) -> Setback {
        self.tries += 1;
        let has_begun = self.next > 0;
        let again = match percept {
            // A posture has an error of its own each time, so that another try may hit.
            Percept::Failed | Percept::Misaligned => self.tries < TRIES,
            // A neighbour that came into range on the way is too far away to be met; at the start it must be
            // asked.
            Percept::Refused(Refusal::Stale) => has_begun && self.tries < TRIES,
            Percept::Refused(_) | Percept::Done(_) => false,
        };
        if percept == Percept::Refused(Refusal::Stale) {
            hit(if has_begun { CoveragePoint::MetaStaleOnTheWay } else { CoveragePoint::MetaStaleAtStart });
        }
        if again {
            return Setback::Retry;
        }
        let is_stuck = percept == Percept::Failed && self.next < self.plan.steps.len();
        hit(if is_stuck { CoveragePoint::MetaStuck } else { CoveragePoint::MetaActionGivenUp });
        if is_stuck { Setback::Stuck } else { Setback::GiveUp }
    }
}
