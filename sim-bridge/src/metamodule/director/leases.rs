//! Commands to single metamodules: what each is commanded and until when, and which are to stay until they are commanded.

use super::members::{Members, Orders};
use metamorph_kernel::director::operator::Level;
use metamorph_kernel::director::steering::Steering as Wish;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::metamodule::blueprint::SeedSet;
use metamorph_protocol::metamodule::message::Order;
use metamorph_protocol::metamodule::steering::Steering;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::{Span, Time};
use std::collections::{BTreeMap, BTreeSet};

/// A command to a metamodule, and its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Commanded {
    steering: Steering,
    until: Time,
}

/// The last command to each metamodule.
#[derive(Clone)]
pub(super) struct Leases {
    /// How much metamodules decide for themselves.
    pub level: Level,
    /// True if metamodules stay where they are unless they are commanded to move.
    holds_idle: bool,
    commanded: BTreeMap<ModuleId, Commanded>,
    /// Metamodules that have been ordered to stay, since they are commanded nothing.
    held: BTreeSet<ModuleId>,
    /// Metamodules that an operator has released from that.
    released: BTreeSet<ModuleId>,
}

impl Leases {
    /// Creates the state before any command. Under `planned` the controller moves metamodules, so none is ordered to stay.
    pub fn new(level: Level, is_planned: bool) -> Leases {
        Leases {
            level,
            holds_idle: level.holds_idle() && !is_planned,
            commanded: BTreeMap::new(),
            held: BTreeSet::new(),
            released: BTreeSet::new(),
        }
    }

    /// Returns the command that a metamodule obeys at this time.
    pub fn holding(&self, now: Time, id: ModuleId) -> Option<Commanded> {
        self.commanded.get(&id).copied().filter(|c| c.steering != Steering::Release && now < c.until)
    }
    /// Returns the end of the last lease.
    pub fn end(&self) -> Time {
        self.commanded.values().map(|commanded| commanded.until).max().unwrap_or(Time::ZERO)
    }

    /// Hands a command that no rule refuses to the metamodule.
    pub fn steer(&mut self, now: Time, id: ModuleId, wish: Wish, orders: &mut Orders) {
        let (steering, lease) = match wish {
            Wish::GoTo(to, lease) => (Steering::GoTo((to.x, to.y)), lease),
            Wish::Take(seed, lease) => (Steering::Take(seed), lease),
            Wish::Hold(lease) => (Steering::Hold, lease),
            Wish::Release => (Steering::Release, Span::ZERO),
            Wish::Swap(other) => {
                // Invariant: no rule refuses it, so both have been commanded something.
                if let (Some(own), Some(others)) = (self.holding(now, id), self.holding(now, other)) {
                    self.command(id, others, orders);
                    self.command(other, own, orders);
                }
                return;
            }
        };
        self.command(id, Commanded { steering, until: now + lease }, orders);
    }
    fn command(&mut self, id: ModuleId, commanded: Commanded, orders: &mut Orders) {
        self.commanded.insert(id, commanded);
        self.held.remove(&id);
        if commanded.steering == Steering::Release {
            self.released.insert(id);
        } else {
            self.released.remove(&id);
        }
        let Commanded { steering, until } = commanded;
        orders.push_back(Command::Order(id, Order::Steer { steering, until }));
    }

    /// Tells metamodules without a command to stay, if that is their level. One that was to fill a seed that is filled now
    /// counts as one without.
    pub fn hold_idle(&mut self, now: Time, members: &Members, filled: SeedSet, orders: &mut Orders) {
        if !self.holds_idle {
            return;
        }
        let is_in_vain = |c: Commanded| matches!(c.steering, Steering::Take(seed) if filled.has(seed));
        for (id, known) in members.iter() {
            let is_idle = self.holding(now, id).is_none_or(is_in_vain);
            let is_there = known.alive && !self.released.contains(&id);
            if is_there && is_idle && self.held.insert(id) {
                orders.push_back(Command::Order(
                    id,
                    Order::Steer { steering: Steering::Hold, until: Time::NEVER },
                ));
            }
        }
    }
    /// Returns when the next metamodule is to be ordered to stay.
    pub fn next_idle(&self) -> Time {
        let own = |id: &ModuleId| self.holds_idle && !self.held.contains(id) && !self.released.contains(id);
        let ends = self.commanded.iter().filter(|(id, _)| own(id)).map(|(_, commanded)| commanded.until);
        ends.min().unwrap_or(Time::NEVER)
    }
    /// Forgets the command to a metamodule whose process has ended, as the process has.
    pub fn forget(&mut self, id: ModuleId) {
        self.held.remove(&id);
        self.released.remove(&id);
        if self.holds_idle {
            self.commanded.remove(&id);
        }
    }
    /// Forgets who has been ordered to stay: those that filled a seed of the former goal took no command.
    pub fn forget_held(&mut self) {
        self.held.clear();
    }
}
