//! How the director of metamodules carries out faults and commands, and the rules that refuse commands.

use super::MetamoduleDirector;
use crate::director::faults::{Fault, Target};
use crate::director::steering::Steering as Commanded;
use crate::metamodule::faults::{DROP, GOAL_MOVED, OBSTACLE, OBSTACLE_GONE};
use crate::metamodule::relocation::Shift;
use crate::metamodule::world::MetamoduleWorld;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::blueprint::Task;
use metamorph_protocol::metamodule::message::Order;
use metamorph_protocol::metamodule::params::Strategy;
use metamorph_protocol::metamodule::steering::Steering;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::{Span, Time};

impl MetamoduleDirector {
    /// Describes the state of a metamodule at the moment of a fault.
    pub(super) fn found(&self, id: ModuleId, world: &MetamoduleWorld) -> String {
        let known = self.known[id.index()];
        let doing = match known.status {
            _ if !known.alive => "dead",
            Some(s) if s.settled.is_some() => "settled",
            _ => "free",
        };
        let acting = if world.is_acting(id) { ", acting" } else { "" };
        format!("it was {doing} at {}{acting}", world.pose(id).state)
    }

    pub(super) fn inject(&mut self, now: Time, fault: Fault, world: &mut MetamoduleWorld) {
        // A fault or its end may resolve a standstill.
        self.last_deed = now;
        let Some(id) = fault.module() else { return self.strike_cell(now, fault, world) };
        let (alive, mut effect, rule) =
            (self.known[id.index()].alive, self.found(id, world), self.rule(&fault));
        if let Err(rule) = &rule {
            effect = format!("{effect}; refused: {rule}");
        }
        self.faults.inject(now, fault, alive, effect, &mut self.commands);
        match fault {
            Fault::Stick(_) => world.set_stuck(id, true),
            Fault::Unstick(_) => world.set_stuck(id, false),
            Fault::Steer(_, steering) if rule.is_ok() => self.steer(now, id, steering),
            _ => {}
        }
    }

    fn strike_cell(&mut self, now: Time, fault: Fault, world: &mut MetamoduleWorld) {
        if let Fault::World(&GOAL_MOVED, Target::Shift(x, y)) = fault {
            return self.move_goal(now, fault, (x, y));
        }
        let (cell, there, done) = match fault {
            Fault::World(&DROP, Target::Element(element)) => {
                let effect = self.drop_element(usize::from(element), world);
                return self.faults.inject(now, fault, false, effect, &mut self.commands);
            }
            Fault::World(&OBSTACLE, Target::Cell(cell)) => (cell, true, world.block(cell)),
            Fault::World(&OBSTACLE_GONE, Target::Cell(cell)) => (cell, false, world.unblock(cell)),
            _ => {
                let effect = "metamodules have no such fault".to_owned();
                return self.faults.inject(now, fault, false, effect, &mut self.commands);
            }
        };
        let effect = match (there, done) {
            (true, true) => "the cell was free",
            (true, false) => "a metamodule is in the cell, so nothing came into it",
            (false, true) => "the obstacle is gone",
            (false, false) => "there was no obstacle",
        };
        self.faults.inject(now, fault, false, format!("{cell}: {effect}"), &mut self.commands);
        if done {
            self.obstacles = world.obstacles().iter().copied().chain(world.resting()).collect();
            self.order_all(Order::Obstacle { cell, there });
            self.disturb();
            self.relocate(now, world);
        }
    }

    /// Hands a command that no rule refuses to the metamodule.
    fn steer(&mut self, now: Time, id: ModuleId, commanded: Commanded) {
        let (steering, lease) = match commanded {
            Commanded::GoTo(to, lease) => (Steering::GoTo((to.x, to.y)), lease),
            Commanded::Take(seed, lease) => (Steering::Take(seed), lease),
            Commanded::Hold(lease) => (Steering::Hold, lease),
            Commanded::Release => (Steering::Release, Span::ZERO),
        };
        let until = now + lease;
        self.leases.insert(id, until);
        self.commands.push_back(Command::Order(id, Order::Steer { steering, until }));
    }

    fn move_goal(&mut self, now: Time, fault: Fault, by: Shift) {
        let rule = self.rule(&fault);
        let effect = match &rule {
            Ok(()) => format!("the goal was shifted by {:?} before", self.task.shift),
            Err(rule) => format!("refused: {rule}"),
        };
        self.faults.inject(now, fault, false, effect, &mut self.commands);
        if rule.is_ok() {
            let (x, y) = self.task.shift;
            self.move_to(now, (x.saturating_add(by.0), y.saturating_add(by.1)));
        }
    }

    /// Returns the rule that refuses a command, and what to do instead.
    ///
    /// # Errors
    /// If there is one.
    pub(super) fn rule(&self, fault: &Fault) -> Result<(), String> {
        match *fault {
            Fault::Steer(id, steering) => self.rule_of_steering(id, steering),
            Fault::World(&GOAL_MOVED, Target::Shift(x, y)) => self.rule_of_goal((x, y)),
            _ => Ok(()),
        }
    }

    fn rule_of_steering(&self, id: ModuleId, steering: Commanded) -> Result<(), String> {
        let refused = |rule: &str, why: String| Err(format!("{rule}: {why}"));
        if self.setup.params.strategy == Strategy::Planned {
            let why = "under `planned` the controller moves all metamodules; use another strategy".to_owned();
            return refused("central-plan", why);
        }
        // An unknown module is refused by its number.
        let Some(known) = self.known.get(id.index()) else { return Ok(()) };
        if !known.alive {
            return refused("dead", format!("the process of metamodule {id} is dead; restart it first"));
        }
        if let Some(seed) = known.status.and_then(|status| status.settled) {
            let why = format!("metamodule {id} fills seed {seed} and stays there until the goal changes");
            return refused("settled", why);
        }
        match steering {
            Commanded::GoTo(Cell { x, y, z }, _) if z != 0 || !self.setup.floor.has(x, y) => {
                refused("floor", format!("there is no connector at [{x}, {y}, {z}]; choose one of the floor"))
            }
            Commanded::Take(seed, _) if !self.setup.goal(self.task).all().has(seed) => {
                let seeds = self.setup.goal(self.task).seeds().len();
                refused(
                    "goal",
                    format!("the goal has no seed {seed}; they are numbered from 0 to {}", seeds - 1),
                )
            }
            Commanded::Take(seed, _) if self.filled.has(seed) => {
                refused("filled", format!("seed {seed} is filled; take another one"))
            }
            _ => Ok(()),
        }
    }

    fn rule_of_goal(&self, by: Shift) -> Result<(), String> {
        let (x, y) = self.task.shift;
        let task = Task { shift: (x.saturating_add(by.0), y.saturating_add(by.1)), ..self.task };
        let floor = self.setup.floor;
        let is_on = |cell: Cell| floor.has(cell.x, cell.y);
        if self.setup.seeds(task).any(|(_, seed)| !seed.cells().into_iter().all(is_on)) {
            return Err(format!("floor: the goal would leave the floor at {:?}; move it less", task.shift));
        }
        Ok(())
    }
}
