//! The director of one gait: gives every agent that starts the parameters of its own oscillators, and tells all agents
//! which modules are dead.

use super::members::Members;
use metamorph_kernel::director::port::DirectorPort;
use metamorph_kernel::world::World;
use metamorph_protocol::free_module::gait::FreeModule;
use metamorph_protocol::free_module::gait::body::WalkStatus;
use metamorph_protocol::free_module::gait::message::{Gait, Parameters, WalkOrder};
use metamorph_protocol::free_module::structure::Joint;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::runtime::Command;
use metamorph_protocol::time::Time;
use std::collections::{BTreeMap, VecDeque};

/// A gait of a whole structure, and when it begins.
pub struct GaitDirector {
    epoch: u16,
    start: Time,
    joints: BTreeMap<Joint, Parameters>,
    /// Crashes to come, in the order of their times.
    kills: VecDeque<(Time, ModuleId)>,
    members: Members,
    commands: VecDeque<Command<WalkOrder>>,
}

impl GaitDirector {
    /// Creates the director of a gait; joints without parameters are locked at 0.
    pub fn new(start: Time, joints: BTreeMap<Joint, Parameters>) -> GaitDirector {
        GaitDirector {
            epoch: 1,
            start,
            joints,
            kills: VecDeque::new(),
            members: Members::default(),
            commands: VecDeque::new(),
        }
    }
    /// Kills the process of a module at a time; times must not go back.
    pub fn kill(mut self, at: Time, module: ModuleId) -> GaitDirector {
        self.kills.push_back((at, module));
        self
    }
}

impl<W: World<Agent = FreeModule>> DirectorPort<W> for GaitDirector {
    fn report(&mut self, _: Time, _: ModuleId, _: WalkStatus) {}
    fn died(&mut self, _: Time, module: ModuleId) {
        self.members.died(module, &mut self.commands);
    }
    fn started(&mut self, _: Time, id: ModuleId) {
        let joints = [0, 1, 2].map(|j| self.joints.get(&Joint::new(id, j)).copied());
        let gait = Gait { epoch: self.epoch, start: self.start, joints };
        self.commands.push_back(Command::Order(id, WalkOrder::Gait(gait)));
        self.members.started(id, &mut self.commands);
    }
    fn wake(&mut self, now: Time, _: &mut W) {
        while let Some((_, module)) = self.kills.front().copied().filter(|(at, _)| *at <= now) {
            self.commands.push_back(Command::Kill(module));
            self.kills.pop_front();
        }
    }
    fn wake_at(&self) -> Time {
        self.kills.front().map_or(Time::NEVER, |(at, _)| *at)
    }
    fn poll(&mut self) -> Option<Command<WalkOrder>> {
        self.commands.pop_front()
    }
}
