//! How the director of metamodules carries out faults and commands.

use super::MetamoduleDirector;
use crate::metamodule::faults::{DROP, GOAL_MOVED, GOAL_TURNED, OBSTACLE, OBSTACLE_GONE, TUNED};
use crate::metamodule::world::{Drop, MetamoduleWorld};
use metamorph_kernel::director::faults::{Fault, Target};
use metamorph_protocol::metamodule::blueprint::Task;
use metamorph_protocol::metamodule::message::Order;
use metamorph_protocol::metamodule::params::{Precedence, PrecedenceBy, Repulsion, Strategy};
use metamorph_protocol::metamodule::tuning::Tuning;
use metamorph_protocol::time::Time;
use std::sync::Arc;

impl MetamoduleDirector {
    pub(super) fn inject(&mut self, now: Time, fault: Fault, world: &mut MetamoduleWorld) {
        // A fault or its end may resolve a standstill.
        self.monitor.last_action = now;
        self.goal.disturb();
        let Some(id) = fault.module() else { return self.strike_cell(now, fault, world) };
        let (mut effect, rule) = (self.members.describe(id, world), self.rules().check(now, &fault));
        if let Err(rule) = &rule {
            effect = format!("{effect}; refused: {rule}");
        }
        self.monitor.inject(now, fault, self.members.known()[id.index()].alive, effect);
        match fault {
            Fault::Stick(_) => world.set_stuck(id, true),
            Fault::Unstick(_) => world.set_stuck(id, false),
            Fault::Steer(_, wish) if rule.is_ok() => {
                self.leases.steer(now, id, wish, &mut self.monitor.commands)
            }
            _ => {}
        }
    }

    fn strike_cell(&mut self, now: Time, fault: Fault, world: &mut MetamoduleWorld) {
        if let Some(task) = self.goal.commanded(&fault, &self.setup) {
            return self.change_task(now, fault, task);
        }
        if let Fault::World(&TUNED, Target::Word(word)) = fault {
            return self.tune(now, fault, word);
        }
        let (cell, there, done) = match fault {
            Fault::World(&DROP, Target::Element(element)) => {
                let effect = self.drop_element(usize::from(element), world);
                return self.monitor.inject(now, fault, false, effect);
            }
            Fault::World(&OBSTACLE, Target::Cell(cell)) => (cell, true, world.block(cell)),
            Fault::World(&OBSTACLE_GONE, Target::Cell(cell)) => (cell, false, world.unblock(cell)),
            _ => {
                return self.monitor.inject(now, fault, false, "metamodules have no such fault");
            }
        };
        let effect = match (there, done) {
            (true, true) => "the cell was free",
            (true, false) => "a metamodule is in the cell, so nothing came into it",
            (false, true) => "the obstacle is gone",
            (false, false) => "there was no obstacle",
        };
        self.monitor.inject(now, fault, false, format!("{cell}: {effect}"));
        if done {
            self.elements.look(world);
            self.members.order_all(Order::Obstacle { cell, there }, &mut self.monitor.commands);
            self.disturb();
            self.evade(now, world);
        }
    }

    /// Drops an element and requests a new plan. Describes the effect.
    fn drop_element(&mut self, element: usize, world: &mut MetamoduleWorld) -> String {
        let Some(name) = self.setup.elements.all().get(element).map(|e| e.name.clone()) else {
            return format!("there is no element {element}");
        };
        match world.drop_element(element) {
            Drop::NotHeld => format!("{name}: it was not held"),
            Drop::Fell { from, cells, on } => {
                // The cells of the dead are announced together with the elements that they hold.
                self.members.announce_again(from.into_iter());
                self.elements.announce(world, &self.members, &mut self.monitor.commands);
                self.disturb();
                let on = on.map_or_else(String::new, |id| format!(", on module {id}"));
                format!("{name}: it fell {cells} cells{on}")
            }
        }
    }

    fn change_task(&mut self, now: Time, fault: Fault, task: Task) {
        let rule = self.rules().check(now, &fault);
        let is_taken = rule.is_ok();
        let describe = |()| self.goal.describe(&fault, &self.setup);
        let effect = rule.map_or_else(|rule| format!("refused: {rule}"), describe);
        self.monitor.inject(now, fault, false, effect);
        if is_taken {
            self.relocation.has_moved |= matches!(fault, Fault::World(&GOAL_MOVED | &GOAL_TURNED, _));
            let change = self.goal.change_by(&fault, task);
            self.begin(now, task);
            change.into_iter().for_each(|change| self.goal.note_change(change));
        }
    }

    fn tune(&mut self, now: Time, fault: Fault, word: &str) {
        let tuned = Tuning::of(&self.setup.params).and_then(|before| tuned(before, word));
        let effect = match (self.rules().check(now, &fault), tuned) {
            (Ok(()), Some(tuning)) => {
                self.setup = Arc::new(tuning.apply(&self.setup));
                self.tuned = Some(tuning);
                self.members.order_all(Order::Tune(tuning), &mut self.monitor.commands);
                format!("{word} from now on")
            }
            (Err(rule), _) => format!("refused: {rule}"),
            (Ok(()), None) => format!("refused: there is no `{word}`"),
        };
        self.monitor.inject(now, fault, false, effect);
    }
}

/// Returns parameters of which one has the value that a word such as `strategy=slope` says. `None` if it says none.
fn tuned(before: Tuning, word: &str) -> Option<Tuning> {
    let (key, value) = word.split_once('=')?;
    let strategy = Strategy::PUBLISHED.into_iter().find(|strategy| strategy.name() == value);
    let within = before.precedence.or(Strategy::Greedy.precedence())?.within;
    let by = PrecedenceBy::ALL.into_iter().find(|by| by.name() == value);
    Some(match (key, value) {
        ("strategy", _) => {
            let strategy = strategy?;
            let (repulsion, precedence) = (strategy.repulsion(), strategy.precedence());
            Tuning { strategy, repulsion, precedence, ..before }
        }
        ("repulsion", "off") => Tuning { repulsion: Repulsion { strength: 0, ..before.repulsion }, ..before },
        ("repulsion", _) => Tuning { repulsion: strategy?.repulsion(), ..before },
        ("precedence", "off") => Tuning { precedence: None, ..before },
        ("precedence", _) => Tuning { precedence: Some(Precedence { within, by: by? }), ..before },
        ("settled_repel", _) => Tuning { settled_repel: value.parse().ok()?, ..before },
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metamodule::faults::TUNABLE;

    #[test]
    fn every_word_changes_a_parameter_of_some_strategy() {
        for word in TUNABLE {
            let changes = Strategy::PUBLISHED.into_iter().any(|strategy| {
                let (repulsion, precedence) = (strategy.repulsion(), strategy.precedence());
                [true, false].into_iter().any(|settled_repel| {
                    let before = Tuning { strategy, repulsion, precedence, settled_repel };
                    tuned(before, word).unwrap() != before
                })
            });
            assert!(changes, "{word}");
        }
        let before = Tuning {
            strategy: Strategy::Slope,
            repulsion: Strategy::Slope.repulsion(),
            precedence: None,
            settled_repel: true,
        };
        for word in ["strategy=negotiated", "precedence=3", "settled_repel=off", "patience=3s", "strategy"] {
            assert_eq!(tuned(before, word), None, "{word}");
        }
    }
}
