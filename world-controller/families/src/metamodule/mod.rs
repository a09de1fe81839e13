//! Metamodules of two Roombots modules each, which walk over a floor of connectors (thesis 4.1.3).

mod asking;
pub mod assembly;
mod bounds;
mod describe;
mod drawn;
mod elements;
mod error;
mod faults;
mod field;
mod generate;
pub mod generated;
mod judge;
mod look;
pub mod motion_database;
pub mod report;
mod run;
mod scenario;
mod schema;
mod words;

pub use scenario::seed_text;

use crate::generated::{Dice, GeneratedSwarm};
use crate::{ExploredFamily, FamilyParts};
use error::MetamoduleError;
use metamorph_protocol::agent::Agent;
use metamorph_protocol::defects::Defect;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::metamodule::Metamodule;
use metamorph_protocol::metamodule::params::{Floor, Setup, Strategy};
use metamorph_protocol::metamodule::pose::Pose;
use metamorph_protocol::metamodule::start::draw_start;
use metamorph_protocol::roombots::connection::ConnectionModel;
use metamorph_protocol::time::Time;
use metamorph_scenario::Plan;
use metamorph_scenario::diagnostics::Diagnostics;
use metamorph_scenario::error::ScenarioError;
use metamorph_scenario::family::{
    DrawnStructure, FamilySchema, RawSwarm, ReportPart, ScenarioFamily, Sections, Swarm, SwarmPlan, Words,
    WorldFaultKind,
};
use metamorph_scenario::table::Section;
use metamorph_sim_bridge::director::faults::{Target, WorldFault};
use metamorph_sim_bridge::director::operator::Level;
use metamorph_sim_bridge::director::steering::Steering;
use metamorph_sim_bridge::metamodule::director::refused_at;
use metamorph_sim_bridge::metamodule::faults::{COMMANDS, DROP, GOAL_DROPPED, GOAL_SET, GOAL_TURNED, TUNED};
use scenario::RawMetamodules;
use std::fmt;
use std::sync::Arc;

/// The name of the family.
pub const NAME: &str = "metamodule";

/// The family of metamodules.
pub struct MetamoduleFamily;

impl ScenarioFamily for MetamoduleFamily {
    fn name(&self) -> &'static str {
        NAME
    }
    fn read(
        &self,
        swarm: Section<'_, '_>,
        others: &Sections<'_, '_>,
        diagnostics: &mut Diagnostics,
    ) -> Box<dyn RawSwarm> {
        Box::new(RawMetamodules::read(swarm, others, diagnostics))
    }
    fn schema(&self) -> FamilySchema {
        schema::schema()
    }
    fn report_part(&self) -> Option<ReportPart> {
        Some((report::KEY, report::schema))
    }
    fn scenario_of(&self, drawing: &DrawnStructure<'_>) -> Option<Result<String, String>> {
        Some(drawn::scenario(drawing))
    }
    fn world_faults(&self) -> &'static [WorldFaultKind] {
        faults::WORLD_FAULTS
    }
    fn is_operated(&self) -> bool {
        true
    }
    fn world_commands(&self) -> &'static [&'static WorldFault] {
        &COMMANDS
    }
}

impl ExploredFamily for MetamoduleFamily {
    fn generate(&self, dice: &mut Dice) -> Box<dyn GeneratedSwarm> {
        Box::new(dice.metamodules())
    }
    fn has_elements(&self) -> bool {
        true
    }
    fn generate_with_elements(&self, dice: &mut Dice) -> Box<dyn GeneratedSwarm> {
        Box::new(dice.metamodules_with_element())
    }
    fn has_connections(&self) -> bool {
        true
    }
    fn smallest(&self) -> Box<dyn GeneratedSwarm> {
        Box::new(generate::smallest())
    }
    fn patience(&self, _: bool, delay: u64) -> Option<(u64, u64)> {
        generate::patience(delay)
    }
    fn shrinking(&self) -> u64 {
        // Runs take much longer than those of other families.
        300
    }
}

impl FamilyParts for MetamoduleFamily {
    type Swarm = Metamodules;

    fn places(&self, swarm: &Metamodules) -> Vec<Pose> {
        swarm.poses.clone()
    }
}

/// A swarm of metamodules.
#[derive(Clone, Debug)]
pub struct Metamodules {
    /// The area in which the start places are drawn from the seed of the run; `None` if they are listed.
    pub drawn: Option<Floor>,
    /// The start poses; a metamodule's number is its index.
    pub poses: Vec<Pose>,
    /// Random starts rejected because a metamodule was enclosed.
    pub redrawn: u32,
    /// Constant parameters that all agents share.
    pub setup: Arc<Setup>,
    /// The model of connections; `None` if every connector is where it should be.
    pub connection: Option<ConnectionModel>,
    /// Times at which goals are replaced, with the new goal, sorted by time.
    pub changes: Arc<[(Time, u8)]>,
    /// True if a goal that cannot be built in place is moved.
    pub relocate: bool,
    /// True if metamodules decide for themselves where a plan leaves seeds unfilled (`planned` only).
    pub hands_over: bool,
}

impl Metamodules {
    /// Checks that each metamodule has a port for each one within its communication range.
    fn check_ports(&self) -> Result<(), MetamoduleError> {
        let range = self.setup.params.communication_range;
        for (metamodule, pose) in (0u32..).map(ModuleId).zip(&self.poses) {
            let others = self.poses.iter().filter(|p| pose.is_within(range, **p)).count() - 1;
            if others > Metamodule::PORTS {
                return Err(MetamoduleError::Crowded { metamodule, others });
            }
        }
        Ok(())
    }
}

impl SwarmPlan for Metamodules {
    fn family(&self) -> &'static str {
        NAME
    }
    fn modules(&self) -> usize {
        self.poses.len()
    }
    fn protocol(&self) -> String {
        self.setup.params.strategy.name().to_owned()
    }
    fn with_seed(&self, seed: u64) -> Result<Option<Swarm>, ScenarioError> {
        let Some(area) = self.drawn else { return Ok(None) };
        let start = draw_start(&self.setup, area, self.poses.len(), seed).map_err(MetamoduleError::from)?;
        let drawn = Metamodules { poses: start.poses, redrawn: start.redrawn, ..self.clone() };
        drawn.check_ports()?;
        Ok(Some(Swarm::new(drawn)))
    }
    fn defect(&self) -> Option<Defect> {
        self.setup.params.defect
    }
    fn with_defect(&self, defect: Option<Defect>) -> Swarm {
        let mut swarm = self.clone();
        Arc::make_mut(&mut swarm.setup).params.defect = defect;
        Swarm::new(swarm)
    }
    fn no_target(&self, target: &Target) -> Option<ScenarioError> {
        let elements = self.setup.elements.all().len();
        let Target::Element(element) = *target else { return None };
        (usize::from(element) >= elements)
            .then(|| MetamoduleError::NoSuchElement { element, elements }.into())
    }
    fn steering(&self) -> &'static [&'static str] {
        match self.setup.params.strategy {
            Strategy::Planned => &[],
            _ => &Steering::VERBS,
        }
    }
    fn refused_at(&self, level: Level, verb: &str) -> Option<String> {
        refused_at(level, verb)
    }
    fn heeds(&self, kind: &WorldFault) -> bool {
        let strategy = self.setup.params.strategy;
        let has_elements = !self.setup.elements.all().is_empty();
        match *kind {
            DROP => has_elements,
            GOAL_SET => strategy != Strategy::Planned,
            GOAL_DROPPED => !has_elements && strategy != Strategy::Planned,
            GOAL_TURNED => !has_elements,
            TUNED => strategy.is_published(),
            _ => true,
        }
    }
    fn contacts(&self) -> Option<Vec<(ModuleId, ModuleId)>> {
        let range = self.setup.params.communication_range;
        let all = || (0u32..).map(ModuleId).zip(self.poses.iter());
        let pairs = all().flat_map(|a| all().filter(move |b| a.0 < b.0).map(move |b| (a, b)));
        Some(
            pairs.filter(|((_, a), (_, b))| a.is_within(range, **b)).map(|((a, _), (b, _))| (a, b)).collect(),
        )
    }
    fn describe(&self, plan: &Plan, out: &mut String) -> fmt::Result {
        describe::describe(out, plan, self)
    }
    fn words(&self) -> &'static Words {
        &WORDS
    }
}

const WORDS: Words = Words {
    module: "metamodule",
    modules: "metamodules",
    cell: "seed",
    part: "seed",
    cells: "seeds",
    filled: "filled",
    collisions: Some(["locks", "the interlock"]),
    idle: "is free",
    time_step: "step time",
    action: "action",
};
