//! The director of an election: takes the reports of modules and ends the run when all agree. It
//! gives no orders.

use crate::leader::{Leader, Lowest};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::Time;
use metamorph_protocol::wire::Never;
use metamorph_sim_bridge::director::port::DirectorPort;
use metamorph_sim_bridge::kernel::still_world::StillWorld;

/// The last report of each module, and the result.
#[derive(Clone, Debug)]
pub struct Election {
    heard: Vec<Option<ModuleId>>,
    deadline: Time,
    ended: bool,
    finish: Option<Command<Never>>,
    /// The module that all agreed on, and the time.
    pub leader: Option<(ModuleId, Time)>,
}

impl Election {
    /// Creates an election among `modules` that ends at `deadline` at the latest.
    pub fn new(modules: usize, deadline: Time) -> Election {
        Election { heard: vec![None; modules], deadline, ended: false, finish: None, leader: None }
    }

    fn end(&mut self) {
        if !std::mem::replace(&mut self.ended, true) {
            self.finish = Some(Command::Finish);
        }
    }
}

impl DirectorPort<StillWorld<Leader>> for Election {
    fn report(&mut self, now: Time, id: ModuleId, Lowest(lowest): Lowest) {
        self.heard[id.index()] = Some(lowest);
        // All modules can agree only on the one with the lowest number of all.
        let all = self.heard.iter().all(|heard| *heard == Some(ModuleId(0)));
        if all && !self.ended {
            self.leader = Some((ModuleId(0), now));
            self.end();
        }
    }
    fn died(&mut self, _: Time, _: ModuleId) {}
    fn started(&mut self, _: Time, _: ModuleId) {}
    fn wake(&mut self, now: Time, _: &mut StillWorld<Leader>) {
        if now >= self.deadline {
            self.end();
        }
    }
    fn wake_at(&self) -> Time {
        if self.ended { Time::NEVER } else { self.deadline }
    }
    fn poll(&mut self) -> Option<Command<Never>> {
        self.finish.take()
    }
}
