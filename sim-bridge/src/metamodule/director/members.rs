//! Records of the director about each metamodule: its reports, its death, and the standstill that metamodules detect
//! themselves.

use crate::metamodule::world::MetamoduleWorld;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::metamodule::message::{Order, Status};
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::Time;
use std::collections::{BTreeSet, VecDeque};

/// Commands to the driver, in order.
pub(super) type Orders = VecDeque<Command<Order>>;

/// The director's record of a metamodule.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Known {
    pub alive: bool,
    pub status: Option<Status>,
    /// When it last moved, or came to its place.
    pub progress: Time,
}

/// All metamodules of the swarm, as reported.
#[derive(Clone)]
pub(super) struct Members {
    known: Vec<Known>,
    dead: BTreeSet<ModuleId>,
    /// Dead metamodules whose death has not been announced yet.
    unannounced: BTreeSet<ModuleId>,
    detected: Option<(Time, ModuleId)>,
    alarms: u32,
    /// True if the run ends when metamodules have detected a standstill.
    ends_when_detected: bool,
}

impl Members {
    pub fn new(count: usize, ends_when_detected: bool) -> Members {
        Members {
            known: vec![Known::default(); count],
            dead: BTreeSet::new(),
            unannounced: BTreeSet::new(),
            detected: None,
            alarms: 0,
            ends_when_detected,
        }
    }

    pub fn known(&self) -> &[Known] {
        &self.known
    }
    pub fn get(&self, id: ModuleId) -> Option<&Known> {
        self.known.get(id.index())
    }
    pub fn ids(&self) -> impl Iterator<Item = ModuleId> + use<> {
        (0..self.known.len() as u32).map(ModuleId)
    }
    pub fn iter(&self) -> impl Iterator<Item = (ModuleId, &Known)> {
        self.ids().zip(&self.known)
    }
    pub fn statuses(&self) -> impl Iterator<Item = Status> {
        self.known.iter().filter_map(|known| known.status)
    }
    pub fn dead(&self) -> &BTreeSet<ModuleId> {
        &self.dead
    }
    /// Returns when the swarm itself detected the present standstill, and which metamodule did.
    pub fn detected(&self) -> Option<(Time, ModuleId)> {
        self.detected
    }
    /// Returns true if metamodules have detected a standstill that ends the run.
    pub fn is_end_detected(&self) -> bool {
        self.ends_when_detected && self.detected.is_some()
    }
    /// Returns how often a metamodule has reported a standstill.
    pub fn alarms(&self) -> u32 {
        self.alarms
    }
    /// Returns true if all deaths have been announced.
    pub fn are_deaths_announced(&self) -> bool {
        self.unannounced.is_empty()
    }
    /// Describes the state of a metamodule at the moment of a fault.
    pub fn describe(&self, id: ModuleId, world: &MetamoduleWorld) -> String {
        let known = self.known[id.index()];
        let doing = match known.status {
            _ if !known.alive => "dead",
            Some(s) if s.settled.is_some() => "settled",
            _ => "free",
        };
        let acting = if world.is_acting(id) { ", acting" } else { "" };
        format!("it was {doing} at {}{acting}", world.pose(id).state)
    }

    /// Takes a report. Returns true if the metamodule fills another seed than before, or none any more.
    pub fn report(&mut self, now: Time, id: ModuleId, report: Status) -> bool {
        let known = &mut self.known[id.index()];
        let place = |status: Status| (status.pose, status.settled);
        if known.status.is_none_or(|before| place(before) != place(report)) {
            known.progress = now;
        }
        let before = known.status.replace(report);
        self.alarms += u32::from(report.deadlocked && !before.is_some_and(|s| s.deadlocked));
        match (report.deadlocked, self.detected) {
            (true, None) => self.detected = Some((now, id)),
            (false, Some((_, by))) if by == id => self.detected = None,
            _ => {}
        }
        before.and_then(|s| s.settled) != report.settled
    }
    pub fn died(&mut self, id: ModuleId) {
        self.known[id.index()].alive = false;
        self.detected = self.detected.filter(|(_, by)| *by != id);
        self.dead.insert(id);
        self.unannounced.insert(id);
    }
    /// Notes that a process has started. Returns the last report of the incarnation before, and whether that one has died.
    pub fn started(&mut self, now: Time, id: ModuleId) -> (Option<Status>, bool) {
        let known = Known { alive: true, status: None, progress: now };
        let before = std::mem::replace(&mut self.known[id.index()], known);
        let was_dead = self.dead.remove(&id);
        // A metamodule that has lost its memory has to be told the deaths again; repeating them to the others is harmless.
        self.unannounced = self.dead.clone();
        (before.status, was_dead)
    }
    /// Lets the deaths of these be announced, once more if they have been.
    pub fn announce_again(&mut self, ids: impl Iterator<Item = ModuleId>) {
        let Members { dead, unannounced, .. } = self;
        unannounced.extend(ids.filter(|id| dead.contains(id)));
    }

    /// Sends an order to all metamodules.
    pub fn order_all(&self, order: Order, orders: &mut Orders) {
        self.ids().for_each(|id| orders.push_back(Command::Order(id, order)));
    }
    /// Tells all metamodules the cells of the dead whose bodies have come to rest. Returns true if there were any.
    pub fn announce_deaths(&mut self, world: &MetamoduleWorld, orders: &mut Orders) -> bool {
        let at_rest: Vec<ModuleId> =
            self.unannounced.iter().copied().filter(|id| !world.is_acting(*id)).collect();
        for dead in &at_rest {
            self.unannounced.remove(dead);
            self.order_all(Order::Dead { id: *dead, pose: world.pose(*dead) }, orders);
        }
        !at_rest.is_empty()
    }
}
