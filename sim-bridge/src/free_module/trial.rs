//! A trial: one gait on a structure of rigid bodies, for a fixed time, driven by the agents on the simulated link.

use super::director::GaitDirector;
use super::physics::{Down, Physics, PhysicsError};
use super::physics_world::PhysicsWorld;
use super::rapier::Bodies;
use super::walking::goal::along;
use metamorph_kernel::kernel::sim::{Sim, SimConfig};
use metamorph_protocol::free_module::gait::WalkSetup;
use metamorph_protocol::free_module::gait::message::Parameters;
use metamorph_protocol::free_module::network::NetworkKind;
use metamorph_protocol::free_module::structure::{Joint, Structure};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::time::{Span, Time};
use std::collections::BTreeMap;
use std::sync::Arc;

/// The time in which bodies come to rest and agents find out the structure.
pub const REST: Span = Span::secs(2);
/// The same if modules are dead: the others wait for their silence.
pub const REST_WITH_DEAD: Span = Span::secs(5);
/// The time at which modules die that are dead in a trial: after their neighbours have heard of their connections.
const DEATH: Span = Span::secs(1);
/// The time between two checks of whether a trial is to be ended.
const LOOK: Span = Span::millis(100);

/// Parameters that all trials of a structure share.
#[derive(Clone, Debug)]
pub struct TrialSetup {
    /// The structure, all of whose modules are active.
    pub structure: Structure,
    /// The joint angles at the start in degrees.
    pub joints_deg: Vec<[f64; 3]>,
    /// Which way is down.
    pub down: Down,
    /// The network of the agents.
    pub network: NetworkKind,
    /// Modules that die before the gait begins.
    pub dead: Vec<ModuleId>,
    /// The time of the gait.
    pub time: Span,
    /// The direction in which the distance counts, in degrees from +x towards +y; `None` for any.
    pub heading_deg: Option<f64>,
    /// True if a fall ends a trial, as a self-collision does.
    pub upright: bool,
    /// The seed of the run.
    pub seed: u64,
}

/// Result of a trial.
#[derive(Clone, Debug, PartialEq)]
pub struct TrialOutcome {
    /// The displacement of the centre of mass in the plane, or in the direction that counts, in mm.
    pub distance_mm: f64,
    /// The time walked in seconds: less than that of the setup if the trial ended early.
    pub seconds: f64,
    /// True if two modules met; the trial ends there.
    pub collided: bool,
    /// True if an invariant was violated; the trial ends there, too.
    pub broken: bool,
    /// How often the body turned upside down.
    pub falls: u32,
    /// True if the trial ended with a fall.
    pub fallen: bool,
    /// The share of time that each module has touched the floor.
    pub duty: Vec<f64>,
    /// The hash of the bodies and agents at the end.
    pub state: u64,
}

/// A simulated run of bodies and agents.
pub type Run = Sim<PhysicsWorld<Bodies>, GaitDirector>;

impl TrialSetup {
    /// Returns when a gait begins.
    pub fn start(&self) -> Time {
        Time::ZERO + if self.dead.is_empty() { REST } else { REST_WITH_DEAD }
    }

    /// Creates a run of a gait: joints without parameters are locked at 0.
    ///
    /// # Errors
    /// Refuses a structure that cannot have bodies.
    pub fn run(&self, gait: BTreeMap<Joint, Parameters>, friction: f32) -> Result<Run, PhysicsError> {
        let bodies = Bodies::new(&self.structure, &self.joints_deg, self.down, friction)?;
        let config = SimConfig {
            setup: Arc::new(WalkSetup::new(self.network)),
            link: LinkModel::default(),
            seed: self.seed,
            audit_every: Span::secs(1),
            ignore_sessions: false,
        };
        let mut director = GaitDirector::new(self.start(), gait);
        for module in &self.dead {
            director = director.kill(Time::ZERO + DEATH, *module);
        }
        Ok(Sim::new(config, PhysicsWorld::new(self.structure.clone(), bodies), director))
    }

    /// Carries out a trial.
    ///
    /// # Errors
    /// As [`TrialSetup::run`].
    pub fn trial(
        &self,
        gait: BTreeMap<Joint, Parameters>,
        friction: f32,
    ) -> Result<TrialOutcome, PhysicsError> {
        let mut run = self.run(gait, friction)?;
        let (start, end) = (self.start(), self.start() + self.time);
        run.run_until(start);
        let from = run.world().physics().centre_of_mass();
        let mut now = start;
        let fallen = |run: &Run| self.upright && run.world().falls() > 0;
        while now < end && run.world().collided().is_none() && !run.world().is_broken() && !fallen(&run) {
            now = (now + LOOK).min(end);
            run.run_until(now);
        }
        let (world, fallen) = (run.world(), fallen(&run));
        let to = world.physics().centre_of_mass();
        let metres = [0, 1].map(|i| f64::from(to[i]) - f64::from(from[i]));
        let distance_mm = 1000.0
            * match self.heading_deg {
                Some(heading) => along(metres, heading),
                None => (metres[0] * metres[0] + metres[1] * metres[1]).sqrt(),
            };
        let broken = world.is_broken();
        Ok(TrialOutcome {
            distance_mm: if broken { 0.0 } else { distance_mm },
            seconds: now.since(start).as_secs_f64(),
            collided: world.collided().is_some(),
            broken,
            falls: world.falls(),
            fallen,
            duty: world.duty(),
            state: run.hashes().states,
        })
    }
}
