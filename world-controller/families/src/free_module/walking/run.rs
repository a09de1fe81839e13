//! Runs a walking structure and collects its results.

use super::Walk;
use super::report::{self, SituationReport, WalkReport};
use crate::runnable::{Runnable, stage};
use metamorph_free_modules::gait::tuner::OnlineTuner;
use metamorph_protocol::free_module::gait::WalkSetup;
use metamorph_protocol::time::{Span, Time};
use metamorph_report::run_result::RunResult;
use metamorph_scenario::Plan;
use metamorph_sim_bridge::director::progress::Progress;
use metamorph_sim_bridge::free_module::physics::{Physics, TICK};
use metamorph_sim_bridge::free_module::physics_world::PhysicsWorld;
use metamorph_sim_bridge::free_module::rapier::{Bodies, ENGINE};
use metamorph_sim_bridge::free_module::walking::director::{Situation, WalkDirector, WalkingRun};
use metamorph_sim_bridge::kernel::audited::Audited;
use metamorph_sim_bridge::world::invariants::Violation;
use std::sync::Arc;

type World = PhysicsWorld<Bodies>;

fn situation(situation: &Situation) -> SituationReport {
    SituationReport {
        since_s: situation.since.as_secs_f64(),
        dead: situation.dead.iter().map(|id| id.0).collect(),
        tried: situation.tried,
        first_mm_s: situation.first_mm_s,
        best_mm_s: situation.best_mm_s,
        kept_s: situation.kept.map(Time::as_secs_f64),
    }
}

/// The least distance in mm of which there is a cost of transport: a cell.
const LEAST: f64 = 110.0;

/// Returns the work of all motors by weight and distance.
fn cost_of_transport(world: &World, distance_mm: f64) -> Option<f64> {
    let physics = world.physics();
    let work = physics.work().filter(|_| distance_mm >= LEAST)?;
    Some(work / (f64::from(physics.weight()) * distance_mm / 1000.0))
}

impl Runnable for Walk {
    type World = World;
    type Director = WalkDirector;

    fn setup(&self) -> &Arc<WalkSetup> {
        &self.setup
    }
    fn world(&self, _: &Plan) -> World {
        self.bodies().expect("invariant: bodies were made when the scenario was read")
    }
    fn director(&self, plan: &Plan) -> WalkDirector {
        let course = WalkingRun {
            goal: self.goal,
            tuner: Box::new(OnlineTuner::new(Arc::clone(&self.choice))),
            trial: self.trial,
            schedule: plan.schedule.clone(),
            stop: plan.stop,
        };
        WalkDirector::new(self.choice.structure.bound(), course)
    }
    fn time_step(&self) -> Span {
        Span::secs(1)
    }
    fn audit_every(&self) -> Span {
        Span::secs(1)
    }
    fn progress(director: &WalkDirector) -> Progress {
        director.progress()
    }
    fn account(&self, plan: &Plan, director: &WalkDirector, world: &World) -> RunResult {
        let (time, distance_mm, path_mm) = director.walked();
        let report = WalkReport {
            body: super::BODY.to_owned(),
            engine: ENGINE.to_owned(),
            walked_s: time.as_secs_f64(),
            distance_mm,
            path_mm,
            speed_mm_s: if time > Span::ZERO { distance_mm / time.as_secs_f64() } else { 0.0 },
            turned_deg: director.turned_deg(),
            cost_of_transport: cost_of_transport(world, distance_mm),
            collided_s: world.collided().map(Time::as_secs_f64),
            falls: world.falls(),
            situations: director.situations().iter().map(situation).collect(),
        };
        RunResult {
            stages: plan.stages.iter().map(|plan| stage(&plan.name, &director.stage())).collect(),
            moves: director.gaits(),
            family_part: Some(report::part(&report)),
            ..RunResult::of(director.monitor(), director.progress())
        }
    }
    fn last_check(world: &mut World, now: Time) -> (Vec<Violation>, u64) {
        // All bodies at every tick.
        (world.take_violations(), now.0 / TICK.0)
    }
}
