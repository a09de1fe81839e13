//! Elections as a family of modules: with this folder, `metamorph` has scenarios, reports, the page, replay
//! and exploration of them.

mod director;
mod look;
mod scenario;

use crate::leader::{Leader, Setup};
use director::ElectionDirector;
use metamorph_protocol::defects::Defect;
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::director::progress::Progress;
use metamorph_sim_bridge::director::standstills::Standstills;
use metamorph_sim_bridge::kernel::still_world::StillWorld;
use metamorph_sim_bridge::world::World;
use metamorph_sim_bridge::world::invariants::Violation;
use metamorph_world_controller::family::generated::{Dice, GeneratedSwarm, Smaller};
use metamorph_world_controller::family::{ExploredFamily, FamilyParts};
use metamorph_world_controller::report::run_result::RunResult;
use metamorph_world_controller::report::schema::MoveReport;
use metamorph_world_controller::run::runnable::{Runnable, stage};
use metamorph_world_controller::scenario::Plan;
use metamorph_world_controller::scenario::error::ScenarioError;
use metamorph_world_controller::scenario::family::{Swarm, SwarmPlan, Words};
use std::fmt::{self, Write};
use std::sync::Arc;

/// The name of the family.
pub const NAME: &str = "election";

/// The family.
pub struct ElectionFamily;

/// A square plate of modules that elect a leader.
#[derive(Clone, Debug)]
pub struct Plate {
    side: u16,
    setup: Arc<Setup>,
}

impl Plate {
    fn still_world(&self) -> StillWorld<Leader> {
        StillWorld::new([self.side, self.side, 1])
    }
}

impl SwarmPlan for Plate {
    fn family(&self) -> &'static str {
        NAME
    }
    fn modules(&self) -> usize {
        usize::from(self.side) * usize::from(self.side)
    }
    fn protocol(&self) -> String {
        "lowest".to_owned()
    }
    fn with_seed(&self, _: u64) -> Result<Option<Swarm>, ScenarioError> {
        Ok(None)
    }
    fn defect(&self) -> Option<Defect> {
        None
    }
    fn with_defect(&self, _: Option<Defect>) -> Swarm {
        Swarm::new(self.clone())
    }
    fn describe(&self, _: &Plan, out: &mut String) -> fmt::Result {
        writeln!(out, "  swarm     {0} × {0} modules that elect a leader", self.side)
    }
    fn words(&self) -> &'static Words {
        &Words {
            module: "module",
            modules: "modules",
            cell: "vote",
            part: "vote",
            cells: "votes",
            negotiation: "nothing",
            body: "nothing",
            idle: "votes",
            time_step: "repeat",
            action: "move",
        }
    }
}

impl Runnable for Plate {
    type World = StillWorld<Leader>;
    type Director = ElectionDirector;

    fn setup(&self) -> &Arc<Setup> {
        &self.setup
    }
    fn world(&self, _: &Plan) -> StillWorld<Leader> {
        self.still_world()
    }
    fn director(&self, plan: &Plan) -> ElectionDirector {
        ElectionDirector::new(self.modules(), plan.schedule.clone(), plan.stop)
    }
    fn time_step(&self) -> Span {
        self.setup.repeat
    }
    fn audit_every(&self) -> Span {
        self.setup.repeat * 10
    }
    fn progress(director: &ElectionDirector) -> Progress {
        director.progress()
    }
    fn account(&self, plan: &Plan, director: &ElectionDirector, _: &StillWorld<Leader>) -> RunResult {
        let (crashed, restarted) = director.crashed_and_restarted();
        RunResult {
            ended: director.ended(),
            progress: director.progress(),
            crashed,
            restarted,
            stall: director.stall().cloned(),
            standstills: Standstills::default(),
            snapshot: None,
            struck: metamorph_sim_bridge::director::port::DirectorPort::struck(director).to_vec(),
            prevented: 0,
            stages: plan.stages.iter().map(|plan| stage(&plan.name, &director.stage())).collect(),
            bodies: MoveReport::default(),
            moves: 0,
            operator: None,
            family_part: None,
        }
    }
    fn last_check(_: &mut StillWorld<Leader>, _: Time) -> (Vec<Violation>, u64) {
        (Vec::new(), 0)
    }
}

impl ExploredFamily for ElectionFamily {
    fn generate(&self, dice: &mut Dice) -> Box<dyn GeneratedSwarm> {
        Box::new(PlateDraft { side: dice.within(1, 6) as u16 })
    }
    fn smallest(&self) -> Box<dyn GeneratedSwarm> {
        Box::new(PlateDraft { side: 1 })
    }
    fn patience(&self, _: bool, _: u64) -> Option<(u64, u64)> {
        None
    }
    fn shrinking(&self) -> u64 {
        1_000
    }
}

impl FamilyParts for ElectionFamily {
    type Swarm = Plate;

    fn places(&self, swarm: &Plate) -> Vec<Cell> {
        let world = swarm.still_world();
        (0..world.len() as u32).map(|id| world.place(metamorph_protocol::ids::ModuleId(id))).collect()
    }
}

/// A drawn plate.
#[derive(Clone, Debug)]
struct PlateDraft {
    side: u16,
}

impl GeneratedSwarm for PlateDraft {
    fn modules(&self) -> usize {
        usize::from(self.side) * usize::from(self.side)
    }
    fn goal_cells(&self) -> usize {
        self.modules()
    }
    fn summary(&self) -> String {
        format!("{0} × {0} modules", self.side)
    }
    fn write(&self, f: &mut fmt::Formatter<'_>, _: u8) -> fmt::Result {
        writeln!(f, "family = \"{NAME}\"\nside = {}\n\n[[goal]]\nname = \"a leader\"", self.side)
    }
    fn settle(&mut self, _: &Swarm) -> bool {
        false
    }
    fn smaller(&self) -> Vec<Smaller> {
        let swarm = PlateDraft { side: self.side - 1 };
        let gone = swarm.modules()..self.modules();
        if self.side < 2 {
            Vec::new()
        } else {
            vec![Smaller { swarm: Box::new(swarm), gone, replaced: false }]
        }
    }
    fn obstacle(&self, _: &mut Dice) -> Option<Cell> {
        None
    }
}
