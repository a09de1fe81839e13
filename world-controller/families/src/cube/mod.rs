//! Sliding cubes (thesis 4.1.2).

mod bounds;
mod describe;
mod drawn;
mod generate;
pub mod generated;
mod judge;
mod look;
mod run;
mod scenario;
mod schema;
mod words;

use crate::generated::{Dice, GeneratedSwarm};
use crate::{ExploredFamily, FamilyParts};
pub use look::motion;
use metamorph_protocol::cube::params::{Connectivity, Setup};
use metamorph_protocol::defects::Defect;
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::lattice::{Cell, Face};
use metamorph_scenario::Plan;
use metamorph_scenario::diagnostics::Diagnostics;
use metamorph_scenario::error::ScenarioError;
use metamorph_scenario::family::{
    DrawnStructure, FamilySchema, RawSwarm, ScenarioFamily, Sections, Swarm, SwarmPlan, Words,
};
use metamorph_scenario::table::Section;
pub use run::move_report;
use scenario::RawCubes;
use std::fmt;
use std::sync::Arc;

/// The name of the family.
pub const NAME: &str = "cube";

/// The family of cubes.
pub struct CubeFamily;

impl ScenarioFamily for CubeFamily {
    fn name(&self) -> &'static str {
        NAME
    }
    fn read(
        &self,
        swarm: Section<'_, '_>,
        others: &Sections<'_, '_>,
        diagnostics: &mut Diagnostics,
    ) -> Box<dyn RawSwarm> {
        Box::new(RawCubes::read(swarm, others, diagnostics))
    }
    fn schema(&self) -> FamilySchema {
        schema::schema()
    }
    fn scenario_of(&self, drawing: &DrawnStructure<'_>) -> Option<Result<String, String>> {
        Some(drawn::scenario(drawing))
    }
}

impl ExploredFamily for CubeFamily {
    fn generate(&self, dice: &mut Dice) -> Box<dyn GeneratedSwarm> {
        Box::new(dice.cubes())
    }
    fn smallest(&self) -> Box<dyn GeneratedSwarm> {
        Box::new(generate::smallest())
    }
    fn patience(&self, fails: bool, delay: u64) -> Option<(u64, u64)> {
        generate::patience(fails, delay)
    }
    fn shrinking(&self) -> u64 {
        3_000
    }
}

impl FamilyParts for CubeFamily {
    type Swarm = Cubes;

    fn places(&self, swarm: &Cubes) -> Vec<Cell> {
        swarm.cells.to_vec()
    }
}

/// A swarm of cubes.
#[derive(Clone, Debug)]
pub struct Cubes {
    /// The start cells; a module's number is its index.
    pub cells: Arc<[Cell]>,
    /// Constant parameters that all agents share.
    pub setup: Arc<Setup>,
    /// Of each goal the number of cells of the drawn shape that its growth leaves out.
    pub omitted: Arc<[usize]>,
}

impl SwarmPlan for Cubes {
    fn family(&self) -> &'static str {
        NAME
    }
    fn modules(&self) -> usize {
        self.cells.len()
    }
    fn protocol(&self) -> String {
        name_of(self.setup.params.connectivity).to_owned()
    }
    fn with_seed(&self, _: u64) -> Result<Option<Swarm>, ScenarioError> {
        Ok(None)
    }
    fn defect(&self) -> Option<Defect> {
        self.setup.params.defect
    }
    fn with_defect(&self, defect: Option<Defect>) -> Swarm {
        let mut swarm = self.clone();
        Arc::make_mut(&mut swarm.setup).params.defect = defect;
        Swarm::new(swarm)
    }
    fn omitted(&self, goal: usize) -> usize {
        self.omitted.get(goal).copied().unwrap_or(0)
    }
    fn has_rescue(&self) -> bool {
        true
    }
    fn steering(&self) -> &'static [&'static str] {
        &["goto", "hold", "release"]
    }
    fn contacts(&self) -> Option<Vec<(ModuleId, ModuleId)>> {
        // Invariant: the cells are in ascending order, and there are fewer than 2^32.
        let at = |cell: Cell| self.cells.binary_search(&cell).ok().map(|i| ModuleId(i as u32));
        let beside = |cell: Cell| Face::ALL.into_iter().filter_map(move |face| at(cell.step(face)));
        let all = (0u32..).map(ModuleId).zip(self.cells.iter());
        Some(
            all.flat_map(|(id, cell)| beside(*cell).filter(move |b| id < *b).map(move |b| (id, b))).collect(),
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
    module: "module",
    modules: "modules",
    cell: "goal cell",
    part: "cell",
    cells: "cells",
    filled: "filled",
    collisions: Some(["negotiation", "the body"]),
    idle: "has a path",
    time_step: "move time",
    action: "move",
};

/// Returns the name used in scenarios.
pub const fn name_of(connectivity: Connectivity) -> &'static str {
    match connectivity {
        Connectivity::Forest => "forest",
        Connectivity::Cycles => "cycles",
        Connectivity::Gradient => "gradient",
    }
}
