//! Reports to the world-controller: changes that matter for the outcome at once, others at most once per heartbeat.

use super::Cube;
use super::control::Status;
use super::message::Role;
use metamorph_core::agent::Output;
use metamorph_core::lattice::Face;
use metamorph_core::time::Time;

/// The last report.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Reporter {
    reported: Option<Status>,
    reported_at: Time,
}

impl Reporter {
    pub fn new(now: Time) -> Reporter {
        Reporter { reported: None, reported_at: now }
    }
}

impl Cube {
    /// Sends a report if the status has changed: at once if the change matters for the outcome, otherwise not sooner
    /// than one heartbeat after the last report.
    pub(super) fn tend_report(&mut self, now: Time) {
        let own = &self.own;
        let is_seed = own.role == Role::Final && own.masks.seed;
        let subtree = if is_seed { self.subtree(now) } else { 0 };
        let (custody, confirmed) = self.forest.custody().announced(self.view(now));
        let carries = self.carries_for_call();
        let urgent = self.reporter.reported.is_none_or(|r| {
            (r.epoch, r.role, r.immobile) != (own.epoch, own.role, own.immobile)
                || (r.carries, r.custody, r.confirmed) != (carries, custody, confirmed)
                || (is_seed && r.subtree != subtree)
        });
        let rested = now.since(self.reporter.reported_at) >= own.params().heartbeat;
        if !urgent && !rested {
            return;
        }
        let v = self.view(now);
        let status = Status {
            epoch: own.epoch,
            role: own.role,
            attached: self.forest.is_attached(v),
            immobile: own.immobile,
            pinned: self.forest.is_pinned(v),
            attracted: self.is_attracted(now),
            wants: self.wanted,
            subtree,
            prevented: self.prevented,
            waits_for: self.planner.waits_for,
            carries,
            custody,
            confirmed,
        };
        if self.reporter.reported != Some(status) {
            (self.reporter.reported, self.reporter.reported_at) = (Some(status), now);
            self.out.push(Output::Report(status));
        }
    }

    pub(super) fn is_attracted(&self, now: Time) -> bool {
        let v = self.view(now);
        Face::in_mask(v.sides.support_mask())
            .filter_map(|f| v.support(f))
            .any(|b| b.field.iter().any(|e| e.is_known()))
    }
}
