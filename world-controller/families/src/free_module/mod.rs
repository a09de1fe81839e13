//! Free modules: single Roombots modules that form one structure and rebuild it, one agent each.
//!
//! `body = "lattice"`: modules stay on the lattice, and the controller plans all steps. `body = "physics"`: the structure
//! walks ([`walking`]).

mod bounds;
mod describe;
mod error;
mod generated;
mod look;
pub mod plan_scene;
pub mod report;
mod run;
mod scenario;
mod schema;
pub mod walking;
mod words;

use crate::generated::{Dice, GeneratedSwarm};
use crate::{ExploredFamily, FamilyParts};
use generated::GeneratedFreeModules;
use metamorph_protocol::assembly::configuration::Configuration;
use metamorph_protocol::defects::Defect;
use metamorph_protocol::free_module::reconfiguration::LatticeSetup;
use metamorph_protocol::free_module::reconfiguration::place::LatticePlace;
use metamorph_protocol::free_module::reconfiguration::planning::Planner;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::roombots::connection::ConnectionModel;
use metamorph_scenario::Plan;
use metamorph_scenario::diagnostics::Diagnostics;
use metamorph_scenario::error::ScenarioError;
use metamorph_scenario::family::{
    FamilySchema, RawSwarm, ReportPart, ScenarioFamily, Sections, Swarm, SwarmPlan, Words,
};
use metamorph_scenario::table::Section;
use std::fmt;
use std::sync::Arc;

/// The name of the family.
pub const NAME: &str = "free-module";

/// The family of free modules.
pub struct FreeModuleFamily;

impl ScenarioFamily for FreeModuleFamily {
    fn name(&self) -> &'static str {
        NAME
    }
    fn read(
        &self,
        swarm: Section<'_, '_>,
        others: &Sections<'_, '_>,
        diagnostics: &mut Diagnostics,
    ) -> Box<dyn RawSwarm> {
        scenario::read(swarm, others, diagnostics)
    }
    fn schema(&self) -> FamilySchema {
        schema::schema()
    }
    fn report_part(&self) -> Option<ReportPart> {
        Some((report::KEY, report::schema))
    }
}

impl ExploredFamily for FreeModuleFamily {
    fn generate(&self, dice: &mut Dice) -> Box<dyn GeneratedSwarm> {
        Box::new(GeneratedFreeModules::draw(dice))
    }
    fn has_connections(&self) -> bool {
        true
    }
    fn smallest(&self) -> Box<dyn GeneratedSwarm> {
        Box::new(GeneratedFreeModules::smallest())
    }
    fn patience(&self, _: bool, _: u64) -> Option<(u64, u64)> {
        None
    }
    fn shrinking(&self) -> u64 {
        // Every run makes plans.
        100
    }
    fn is_drawn(&self) -> bool {
        // A run takes much longer than those of other families.
        false
    }
}

impl FamilyParts for FreeModuleFamily {
    type Swarm = FreeModules;

    fn places(&self, swarm: &FreeModules) -> Vec<LatticePlace> {
        swarm.places()
    }
}

/// A structure of free modules and its goal.
#[derive(Clone, Debug)]
pub struct FreeModules {
    /// The start as written.
    pub from: String,
    /// The goal as written.
    pub to: String,
    /// The start.
    pub start: Configuration,
    /// How plans are made, and where they end.
    pub planner: Planner,
    /// The model of connections; `None` if every connector is where it should be.
    pub connection: Option<ConnectionModel>,
    /// Constant parameters that all agents share.
    pub setup: Arc<LatticeSetup>,
}

impl FreeModules {
    /// Returns the places of all modules at the start.
    pub fn places(&self) -> Vec<LatticePlace> {
        self.start.modules().iter().map(LatticePlace::of).collect()
    }
}

impl SwarmPlan for FreeModules {
    fn family(&self) -> &'static str {
        NAME
    }
    fn modules(&self) -> usize {
        self.start.len()
    }
    fn protocol(&self) -> String {
        scenario::STRATEGY.to_owned()
    }
    fn with_seed(&self, _: u64) -> Result<Option<Swarm>, ScenarioError> {
        Ok(None)
    }
    fn defect(&self) -> Option<Defect> {
        self.setup.defect
    }
    fn with_defect(&self, defect: Option<Defect>) -> Swarm {
        let mut swarm = self.clone();
        Arc::make_mut(&mut swarm.setup).defect = defect;
        Swarm::new(swarm)
    }
    fn contacts(&self) -> Option<Vec<(ModuleId, ModuleId)>> {
        let pairs = self.start.connections().into_iter();
        Some(pairs.map(|p| (ModuleId(p.a.0.into()), ModuleId(p.b.0.into()))).collect())
    }
    fn describe(&self, plan: &Plan, out: &mut String) -> fmt::Result {
        describe::describe(out, plan, self)
    }
    fn words(&self) -> &'static Words {
        &WORDS
    }
}

const WORDS: Words = Words {
    module: "module",
    modules: "modules",
    cell: "joined face",
    part: "face",
    cells: "joined faces",
    filled: "filled",
    collisions: Some(["branch locks", "the interlock"]),
    idle: "is free",
    time_step: "step time",
    action: "action",
};
