//! `body = "physics"`: a structure off the grid that walks by oscillators, with rigid bodies.

mod describe;
mod error;
mod look;
pub mod report;
mod run;
mod scenario;
pub mod schema;
mod words;

use super::{FreeModuleFamily, NAME};
use crate::generated::{Dice, GeneratedSwarm};
use crate::{ExploredFamily, FamilyParts};
use metamorph_free_modules::gait::tuner::Choice;
use metamorph_protocol::defects::Defect;
use metamorph_protocol::free_module::gait::WalkSetup;
use metamorph_protocol::free_module::gait::body::BodyPlace;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::time::Span;
use metamorph_scenario::Plan;
use metamorph_scenario::diagnostics::Diagnostics;
use metamorph_scenario::error::ScenarioError;
use metamorph_scenario::family::{FamilySchema, RawSwarm, ScenarioFamily, Sections, Swarm, SwarmPlan, Words};
use metamorph_scenario::table::Section;
use metamorph_sim_bridge::free_module::physics::{Down, PhysicsError};
use metamorph_sim_bridge::free_module::physics_world::PhysicsWorld;
use metamorph_sim_bridge::free_module::rapier::Bodies;
use metamorph_sim_bridge::free_module::walking::goal::Goal;
use metamorph_sim_bridge::world::World;
pub use scenario::RawWalk;
use std::fmt;
use std::sync::Arc;

/// The value of `body`.
pub const BODY: &str = "physics";
/// The only strategy.
pub const STRATEGY: &str = "oscillators";
/// The keys of `[swarm]` that only this body has.
pub const SWARM_KEYS: [&str; 3] = ["down", "friction", "ground"];
/// The keys of `[[goal]]` that only this body has.
pub const GOAL_KEYS: [&str; 1] = ["walk"];
/// The keys of `[protocol]` that only this body has.
pub const PROTOCOL_KEYS: [&str; 5] = ["network", "gaits", "relearn", "trials", "trial"];
/// The name of the agents, which are others than those on the lattice.
pub const AGENT: &str = "walking-module";

/// Free modules with rigid bodies: the part of the family that has other agents.
pub struct WalkingFamily;

impl ScenarioFamily for WalkingFamily {
    fn name(&self) -> &'static str {
        NAME
    }
    fn read(
        &self,
        swarm: Section<'_, '_>,
        others: &Sections<'_, '_>,
        diagnostics: &mut Diagnostics,
    ) -> Box<dyn RawSwarm> {
        FreeModuleFamily.read(swarm, others, diagnostics)
    }
    fn schema(&self) -> FamilySchema {
        FreeModuleFamily.schema()
    }
}

impl ExploredFamily for WalkingFamily {
    fn generate(&self, dice: &mut Dice) -> Box<dyn GeneratedSwarm> {
        FreeModuleFamily.generate(dice)
    }
    fn smallest(&self) -> Box<dyn GeneratedSwarm> {
        FreeModuleFamily.smallest()
    }
    fn patience(&self, fails: bool, delay: u64) -> Option<(u64, u64)> {
        FreeModuleFamily.patience(fails, delay)
    }
    fn shrinking(&self) -> u64 {
        FreeModuleFamily.shrinking()
    }
}

impl FamilyParts for WalkingFamily {
    type Swarm = Walk;

    fn places(&self, swarm: &Walk) -> Vec<BodyPlace> {
        let world = swarm.bodies().expect("invariant: bodies were made when the scenario was read");
        (0..world.len() as u32).map(|id| world.place(ModuleId(id))).collect()
    }
}

/// A structure that walks.
#[derive(Clone, Debug)]
pub struct Walk {
    /// The structure as written.
    pub start: String,
    /// The joint angles at the start in degrees.
    pub joints_deg: Vec<[f64; 3]>,
    /// Which way is down at the start.
    pub down: Down,
    /// Friction of all surfaces.
    pub friction: f32,
    /// The angle in degrees by which the ground rises towards +x.
    pub slope_deg: f64,
    /// Structure, network, known gaits and learner.
    pub choice: Arc<Choice>,
    /// How long a gait is tried.
    pub trial: Span,
    /// Goal of the walk.
    pub goal: Goal,
    /// Constant parameters that all agents share.
    pub setup: Arc<WalkSetup>,
}

impl Walk {
    /// Returns the bodies at the start.
    ///
    /// # Errors
    /// Refuses a structure that cannot have bodies.
    pub fn bodies(&self) -> Result<PhysicsWorld<Bodies>, PhysicsError> {
        let structure = &self.choice.structure;
        let mut bodies = Bodies::new(structure, &self.joints_deg, self.down, self.friction)?;
        // On level ground nothing is computed, so that its runs are those without this option.
        if self.slope_deg > 0.0 {
            bodies.tilt(self.slope_deg.to_radians() as f32);
        }
        Ok(PhysicsWorld::new(structure.clone(), bodies).telling_poses())
    }
}

impl SwarmPlan for Walk {
    fn family(&self) -> &'static str {
        NAME
    }
    fn agent(&self) -> &'static str {
        AGENT
    }
    fn modules(&self) -> usize {
        self.choice.structure.bound()
    }
    fn protocol(&self) -> String {
        STRATEGY.to_owned()
    }
    fn with_seed(&self, seed: u64) -> Result<Option<Swarm>, ScenarioError> {
        let choice = Arc::new(Choice { seed, ..(*self.choice).clone() });
        Ok(Some(Swarm::new(Walk { choice, ..self.clone() })))
    }
    fn defect(&self) -> Option<Defect> {
        None
    }
    fn with_defect(&self, _: Option<Defect>) -> Swarm {
        Swarm::new(self.clone())
    }
    fn contacts(&self) -> Option<Vec<(ModuleId, ModuleId)>> {
        Some(self.choice.structure.connections().iter().map(|c| (c.a, c.b)).collect())
    }
    fn describe(&self, _: &Plan, out: &mut String) -> fmt::Result {
        describe::describe(out, self)
    }
    fn words(&self) -> &'static Words {
        &WORDS
    }
}

const WORDS: Words = Words {
    module: "module",
    modules: "modules",
    cell: "second of the walk",
    part: "second",
    cells: "seconds of the walk",
    filled: "filled",
    collisions: Some(["agents", "bodies"]),
    idle: "is free",
    time_step: "second",
    action: "gait",
};
