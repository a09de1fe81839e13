//! Safety checks of the world of free modules. They examine the bodies and a record of pending connections, which the
//! interlock does not read, so that a fault of either shows.

use super::super::invariants::{
    CONFIRMED_IN_ORDER, CONNECTION_SIDES_AGREE, NO_TURN_WHILE_PENDING, ONCE_PER_EPOCH, ONE_CONNECTED_BODY,
    confirmed_in_order, connection_sides_agree, no_turn_while_pending, once_per_epoch,
};
use super::{FreeModuleWorld, Turn, pair};
use metamorph_kernel::world::invariants::{ONE_MODULE_PER_CELL, Violation};
use metamorph_protocol::assembly::checker::Refusal as Reason;
use metamorph_protocol::free_module::reconfiguration::message::StepName;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::roombots::connector::Connector;
use metamorph_protocol::time::Time;
use std::collections::BTreeSet;

impl FreeModuleWorld {
    /// Returns the invariants broken since the last call.
    pub fn take_violations(&mut self) -> Vec<Violation> {
        self.queue.take_violations()
    }

    /// Checks a turn that begins.
    pub(super) fn check_turn(&mut self, now: Time, id: ModuleId, turn: &Turn) {
        let of = |(a, b): &(_, _)| [*a, *b].map(|(module, _): (usize, Connector)| module);
        let mut pending: BTreeSet<usize> = self.pending.iter().flat_map(of).collect();
        pending.extend((0..self.bodies.len()).filter(|m| self.bodies[*m].under_way.is_some()));
        if let Err(what) = no_turn_while_pending(&turn.moving, &pending) {
            self.queue.violate(
                NO_TURN_WHILE_PENDING,
                now,
                format!("joint {} of {id}: {what}", turn.joint + 1),
            );
        }
    }

    /// Notes why a turn that had begun could not be completed.
    pub(super) fn check_turned(&mut self, now: Time, id: ModuleId, reason: &Reason) {
        let invariant = match reason {
            Reason::Parted(_) => ONE_CONNECTED_BODY,
            Reason::NotFacing(..) => CONNECTION_SIDES_AGREE,
            _ => ONE_MODULE_PER_CELL,
        };
        self.queue.violate(invariant, now, format!("the turn of {id}: {reason}"));
    }

    /// Notes that a module has carried out an action of a plan.
    pub(super) fn note_done(&mut self, now: Time, id: ModuleId, step: StepName) {
        let is_first = self.done.insert((step.epoch, step.index, id));
        if let Err(what) = once_per_epoch(is_first) {
            let what = format!("action {} of plan {} by {id}: {what}", step.index, step.epoch);
            self.queue.violate(ONCE_PER_EPOCH, now, what);
        }
    }

    /// Notes that the director takes an action of a plan as carried out by `sides`, after those of `after`.
    pub fn confirm(&mut self, now: Time, epoch: u32, index: usize, sides: &[ModuleId], after: &[usize]) {
        if self.confirmed.0 != epoch {
            self.confirmed = (epoch, BTreeSet::new());
        }
        let is_done = sides.iter().all(|id| self.done.contains(&(epoch, index as u16, *id)));
        let missing = after.iter().copied().find(|before| !self.confirmed.1.contains(before));
        if let Err(what) = confirmed_in_order(is_done, missing) {
            self.queue.violate(CONFIRMED_IN_ORDER, now, format!("action {index} of plan {epoch}: {what}"));
        }
        self.confirmed.1.insert(index);
    }

    /// Forgets pending connections whose sides agree again and do nothing about it.
    pub(super) fn forget_pending(&mut self) {
        let acts = |site: &(usize, Connector)| self.bodies[site.0].under_way.is_some();
        let is_pending = |(a, b): &(_, _)| self.is_closed(*a) != self.is_closed(*b) || acts(a) || acts(b);
        let pending = self.pending.iter().filter(|p| is_pending(p)).copied().collect();
        self.pending = pending;
    }

    /// Checks cells, connections and connectivity of all bodies.
    pub fn check_all(&mut self, now: Time) {
        if let Err(reason) = self.state.apart() {
            self.queue.violate(ONE_MODULE_PER_CELL, now, reason.to_string());
        }
        if let Err(reason) = self.state.whole() {
            self.queue.violate(ONE_CONNECTED_BODY, now, reason.to_string());
        }
        let sites = (0..self.bodies.len()).flat_map(|m| Connector::ALL.map(|c| (m, c)));
        let found: Vec<String> = sites
            .filter_map(|site| {
                let partner = self.state.partner(site);
                let is_pending = partner.is_some_and(|p| self.pending.contains(&pair(site, p)));
                let closed = partner.map(|p| self.is_closed(p));
                let checked = connection_sides_agree(self.is_closed(site), closed, is_pending);
                checked.err().map(|what| format!("{} of module {}: {what}", site.1, site.0))
            })
            .collect();
        found.into_iter().for_each(|what| self.queue.violate(CONNECTION_SIDES_AGREE, now, what));
    }
}
