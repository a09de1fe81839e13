//! Runs a structure of free modules and collects its results.

use super::FreeModules;
use super::report::{self, FreeModuleReport, FreePlanReport};
use super::scenario::BODY;
use crate::connection::ConnectionReport;
use crate::runnable::{Runnable, stage};
use metamorph_protocol::assembly::action::Connectors;
use metamorph_protocol::assembly::checker::Physics;
use metamorph_protocol::free_module::reconfiguration::LatticeSetup;
use metamorph_protocol::time::{Span, Time};
use metamorph_report::run_result::RunResult;
use metamorph_report::schema::MoveReport;
use metamorph_scenario::Plan;
use metamorph_sim_bridge::director::progress::Progress;
use metamorph_sim_bridge::free_module::reconfiguration::director::{FreeModuleDirector, ReconfigurationRun};
use metamorph_sim_bridge::free_module::reconfiguration::world::FreeModuleWorld;
use metamorph_sim_bridge::kernel::sim::Sim;
use metamorph_sim_bridge::world::World;
use metamorph_sim_bridge::world::invariants::Violation;
use std::sync::Arc;

impl Runnable for FreeModules {
    type World = FreeModuleWorld;
    type Director = FreeModuleDirector;

    fn setup(&self) -> &Arc<LatticeSetup> {
        &self.setup
    }
    fn world(&self, plan: &Plan) -> FreeModuleWorld {
        let active = self.planner.connectors == Connectors::Active;
        let physics = Physics { collision: self.planner.collision, active, standing: None };
        FreeModuleWorld::new(Arc::clone(&self.setup), physics, &self.places(), plan.seed)
            .with_connections(self.connection)
    }
    fn director(&self, plan: &Plan) -> FreeModuleDirector {
        let course = ReconfigurationRun {
            planner: self.planner.clone(),
            schedule: plan.schedule.clone(),
            stop: plan.stop,
            failure: plan.failure,
        };
        FreeModuleDirector::new(Arc::clone(&self.setup), self.start.len(), course)
    }
    fn fork(
        sim: &Sim<FreeModuleWorld, FreeModuleDirector>,
    ) -> Option<Sim<FreeModuleWorld, FreeModuleDirector>> {
        sim.fork()
    }
    fn time_step(&self) -> Span {
        self.setup.turn_time
    }
    fn audit_every(&self) -> Span {
        self.time_step() * 20
    }
    fn progress(director: &FreeModuleDirector) -> Progress {
        director.progress()
    }
    fn account(&self, plan: &Plan, director: &FreeModuleDirector, world: &FreeModuleWorld) -> RunResult {
        let (counts, p) = (world.counts(), director.plan_counts());
        let bodies = MoveReport {
            started: counts.started,
            completed: counts.turns + counts.sides,
            failed: counts.failed,
            refused_taken: counts.blocked,
            refused_late: counts.late,
            refused_stale: counts.stale,
            refused_impossible: counts.impossible,
            called: 0,
            led: counts.attached,
        };
        let report = FreeModuleReport {
            body: BODY.to_owned(),
            turns: counts.turns,
            attachments: counts.attached,
            detachments: counts.detached,
            plan: FreePlanReport {
                plans: p.plans,
                actions: p.actions,
                cost: p.cost,
                bound: p.bound,
                hash: format!("{:016x}", p.hash),
                orders: p.orders,
                repeated: p.repeated,
                confirmed: p.confirmed,
                failed: p.failed,
                late: p.late,
                work: p.work,
            },
            connecting: world.connection_counts().as_ref().map(ConnectionReport::of),
        };
        RunResult {
            prevented: director.prevented(),
            stages: plan.stages.iter().map(|plan| stage(&plan.name, &director.stage())).collect(),
            moves: counts.attached,
            family_part: Some(report::part(&report, &bodies)),
            bodies,
            ..RunResult::of(director.monitor(), director.progress())
        }
    }
    fn last_check(world: &mut FreeModuleWorld, now: Time) -> (Vec<Violation>, u64) {
        world.check_all(now);
        let counts = world.counts();
        // All bodies at the end of each action and once at the end, and each turn at its beginning.
        let ended = counts.turns + counts.sides + counts.failed;
        let checks = (ended + 1) * world.len() as u64 + counts.started;
        (world.take_violations(), checks)
    }
}
