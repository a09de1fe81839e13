//! Runs a swarm of cubes and collects its results.

use super::Cubes;
use super::judge::CubeQuestion;
use crate::runnable::{Runnable, stage};
use metamorph_protocol::cube::params::Setup;
use metamorph_protocol::time::{Span, Time};
use metamorph_report::run_result::RunResult;
use metamorph_report::schema::{MoveReport, StageReport};
use metamorph_scenario::Plan;
use metamorph_scenario::family::SwarmPlan;
use metamorph_sim_bridge::cube::audit::audit_every;
use metamorph_sim_bridge::cube::director::Director;
use metamorph_sim_bridge::cube::world::{CubeWorld, MotionCounts};
use metamorph_sim_bridge::director::progress::Progress;
use metamorph_sim_bridge::kernel::sim::Sim;
use metamorph_sim_bridge::world::invariants::Violation;
use std::sync::Arc;

/// Converts the counts of moves to their entry in the report, of a swarm that is not led.
pub fn move_report(motions: &MotionCounts) -> MoveReport {
    MoveReport {
        started: motions.started,
        completed: motions.completed,
        failed: motions.failed,
        refused_taken: motions.blocked,
        refused_late: motions.late,
        refused_stale: motions.stale,
        refused_impossible: 0,
        called: 0,
        led: 0,
    }
}

impl Runnable for Cubes {
    type World = CubeWorld;
    type Director = Director;

    fn setup(&self) -> &Arc<Setup> {
        &self.setup
    }
    fn world(&self, plan: &Plan) -> CubeWorld {
        CubeWorld::new(&self.cells, self.time_step(), plan.seed)
    }
    fn director(&self, plan: &Plan) -> Director {
        let (setup, schedule) = (Arc::clone(&self.setup), plan.schedule.clone());
        Director::new(setup, self.cells.len(), schedule, plan.stop, plan.failure, plan.rescue)
    }
    fn fork(sim: &Sim<CubeWorld, Director>) -> Option<Sim<CubeWorld, Director>> {
        sim.fork()
    }
    fn time_step(&self) -> Span {
        self.setup.params.move_time
    }
    fn audit_every(&self) -> Span {
        audit_every(self.time_step())
    }
    fn progress(director: &Director) -> Progress {
        director.progress()
    }
    fn account(&self, plan: &Plan, director: &Director, world: &CubeWorld) -> RunResult {
        let (motions, help) = (world.motions(), director.help(world));
        RunResult {
            snapshot: director
                .monitor()
                .stall()
                .map(|_| CubeQuestion { now: director.snapshot(world), before: director.before().cloned() })
                .map(|question| Box::new(question) as _),
            prevented: director.prevented(),
            stages: (plan.stages.iter().zip(director.stages()).enumerate())
                .map(|(i, (p, s))| StageReport { omitted: self.omitted(i) as u64, ..stage(&p.name, s) })
                .collect(),
            bodies: MoveReport { called: help.called, led: help.led, ..move_report(&motions) },
            moves: motions.completed,
            ..RunResult::of(director.monitor(), director.progress())
        }
    }
    fn last_check(world: &mut CubeWorld, now: Time) -> (Vec<Violation>, u64) {
        world.check_connected(now);
        let motions = world.motions();
        // Start of a move: its supports, those of other modules, connection. End of a move: space and
        // support. And the whole body once at the end.
        let checks = motions.started * 3 + (motions.completed + motions.failed) * 2 + 1;
        (world.take_violations(), checks)
    }
}
