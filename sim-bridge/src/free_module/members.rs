//! Which modules of a walking structure live, as the controller knows and tells it.

use metamorph_protocol::free_module::gait::message::WalkOrder;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::runtime::Command;
use std::collections::{BTreeMap, VecDeque};

/// Modules whose processes have started.
#[derive(Clone, Debug, Default)]
pub struct Members {
    alive: BTreeMap<ModuleId, Incarnation>,
    dead: BTreeMap<ModuleId, Incarnation>,
}

impl Members {
    /// Returns the living modules, in order.
    pub fn alive(&self) -> impl Iterator<Item = ModuleId> {
        self.alive.keys().copied()
    }
    /// Returns true if the process of a module lives.
    pub fn is_alive(&self, module: ModuleId) -> bool {
        self.alive.contains_key(&module)
    }
    /// Returns the dead modules, in order.
    pub fn dead(&self) -> impl Iterator<Item = ModuleId> {
        self.dead.keys().copied()
    }

    /// Notes that a process has ended, and tells all living modules.
    pub fn died(&mut self, module: ModuleId, commands: &mut VecDeque<Command<WalkOrder>>) {
        let Some(incarnation) = self.alive.remove(&module) else { return };
        self.dead.insert(module, incarnation);
        let order = WalkOrder::Dead { module, incarnation };
        commands.extend(self.alive.keys().map(|id| Command::Order(*id, order)));
    }
    /// Notes that a process has started, and tells it which modules are dead.
    pub fn started(&mut self, id: ModuleId, commands: &mut VecDeque<Command<WalkOrder>>) {
        let incarnation = self.dead.remove(&id).map_or(Incarnation(0), |dead| Incarnation(dead.0 + 1));
        self.alive.insert(id, incarnation);
        let dead = self.dead.iter().map(|(module, incarnation)| (*module, *incarnation));
        let orders = dead.map(|(module, incarnation)| WalkOrder::Dead { module, incarnation });
        commands.extend(orders.map(|order| Command::Order(id, order)));
    }
}
