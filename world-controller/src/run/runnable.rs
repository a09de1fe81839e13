//! What drivers and reports need of each family of units: how its world and director are set up, and
//! what the two know when a run is over. Adding a family means implementing [`Runnable`].
//!
//! Absent: driving (`simulated`, `processes`) and the layout of reports (`report`).

use crate::report::run_result::{Question, RunResult};
use crate::report::schema::{LevelReport, MetamoduleReport, MoveReport, StageReport};
use crate::scenario::{Cubes, Metamodules, Plan};
use metamorph_module_agent::Family;
use metamorph_protocol::agent::Agent;
use metamorph_protocol::time::{Span, Time};
use metamorph_sim_bridge::cube::audit::audit_every;
use metamorph_sim_bridge::cube::director::{Director, Progress, Stage};
use metamorph_sim_bridge::cube::world::CubeWorld;
use metamorph_sim_bridge::director::port::Direct;
use metamorph_sim_bridge::kernel::sim::Audited;
use metamorph_sim_bridge::metamodule::director::{MetamoduleDirector, MetamodulePlan};
use metamorph_sim_bridge::metamodule::world::MetamoduleWorld;
use metamorph_sim_bridge::world::World;
use metamorph_sim_bridge::world::invariants::Violation;
use std::sync::Arc;

/// The setup that the agents of a family share.
pub type SetupOf<R> = <<<R as Runnable>::World as World>::Agent as Agent>::Setup;

/// A swarm that can be run.
pub trait Runnable {
    /// Its world.
    type World: Audited;
    /// Its director.
    type Director: Direct<Self::World>;
    /// Its family.
    const FAMILY: Family;

    /// What all agents share.
    fn setup(&self) -> &Arc<SetupOf<Self>>;
    /// The world at the start.
    fn world(&self, plan: &Plan) -> Self::World;
    /// The director at the start.
    fn director(&self, plan: &Plan) -> Self::Director;
    /// The shortest time in which something can be seen to happen: a move, or a step of a joint.
    fn beat(&self) -> Span;
    /// How often everything is audited in a simulation.
    fn audit_every(&self) -> Span;
    /// How far a run has come.
    fn progress(director: &Self::Director) -> Progress;
    /// What there is to report.
    fn account(&self, plan: &Plan, director: &Self::Director, world: &Self::World) -> RunResult;
    /// Checks the world once more after a run of processes. Returns all that was found broken in the
    /// run, and how often something was checked.
    fn last_check(world: &mut Self::World, now: Time) -> (Vec<Violation>, u64);
}

impl Runnable for Cubes {
    type World = CubeWorld;
    type Director = Director;
    const FAMILY: Family = Family::Cube;

    fn setup(&self) -> &Arc<SetupOf<Cubes>> {
        &self.setup
    }
    fn world(&self, plan: &Plan) -> CubeWorld {
        CubeWorld::new(&self.cells, self.beat(), plan.seed)
    }
    fn director(&self, plan: &Plan) -> Director {
        let (setup, schedule) = (Arc::clone(&self.setup), plan.schedule.clone());
        Director::new(setup, self.cells.len(), schedule, plan.stop, plan.failure)
    }
    fn beat(&self) -> Span {
        self.setup.params.move_time
    }
    fn audit_every(&self) -> Span {
        audit_every(self.beat())
    }
    fn progress(director: &Director) -> Progress {
        director.progress()
    }
    fn account(&self, plan: &Plan, director: &Director, world: &CubeWorld) -> RunResult {
        let (crashed, restarted) = director.crashed_and_restarted();
        let motions = world.motions();
        RunResult {
            ended: director.outcome(),
            progress: director.progress(),
            crashed,
            restarted,
            stall: director.stall().cloned(),
            plight: director.stall().map(|_| Question::Cubes(director.plight(world))),
            struck: director.struck().to_vec(),
            prevented: director.prevented(),
            stages: plan.stages.iter().zip(director.stages()).map(|(p, s)| stage(&p.name, s)).collect(),
            bodies: MoveReport {
                started: motions.started,
                completed: motions.completed,
                failed: motions.failed,
                refused_taken: motions.blocked,
                refused_late: motions.late,
                refused_stale: motions.stale,
                refused_impossible: 0,
            },
            metamodules: None,
        }
    }
    fn last_check(world: &mut CubeWorld, now: Time) -> (Vec<Violation>, u64) {
        world.check_connected(now);
        let motions = world.motions();
        // Of a move that begins: its supports, those of others, connection. Of one that ends: space and
        // support. And the whole body now.
        let checks = motions.started * 3 + (motions.completed + motions.failed) * 2 + 1;
        (world.take_violations(), checks)
    }
}

impl Runnable for Metamodules {
    type World = MetamoduleWorld;
    type Director = MetamoduleDirector;
    const FAMILY: Family = Family::Metamodule;

    fn setup(&self) -> &Arc<SetupOf<Metamodules>> {
        &self.setup
    }
    fn world(&self, plan: &Plan) -> MetamoduleWorld {
        MetamoduleWorld::new(Arc::clone(&self.setup), &self.poses, plan.seed)
    }
    fn director(&self, plan: &Plan) -> MetamoduleDirector {
        let plan = MetamodulePlan {
            schedule: plan.schedule.clone(),
            stop: plan.stop,
            failure: plan.failure,
            changes: self.changes.to_vec(),
            relocate: self.relocate,
            heed: true,
        };
        MetamoduleDirector::new(Arc::clone(&self.setup), self.poses.len(), plan)
    }
    fn beat(&self) -> Span {
        self.setup.params.turn_time
    }
    fn audit_every(&self) -> Span {
        // A handful of bodies is cheap to check; every action is checked besides.
        self.beat() * 20
    }
    fn progress(director: &MetamoduleDirector) -> Progress {
        director.progress()
    }
    fn account(&self, plan: &Plan, director: &MetamoduleDirector, world: &MetamoduleWorld) -> RunResult {
        let (crashed, restarted) = director.crashed_and_restarted();
        let (deeds, progress) = (world.deeds(), director.progress());
        let (task, filled) = (director.task(), director.filled());
        let mut seeds = 0u8..;
        let levels = self.setup.goal(task).levels().iter().map(|seeds_of_it| {
            let filled = seeds.by_ref().take(usize::from(*seeds_of_it)).filter(|s| filled.has(*s)).count();
            LevelReport { seeds: u64::from(*seeds_of_it), filled: filled as u64 }
        });
        RunResult {
            ended: director.outcome(),
            progress,
            crashed,
            restarted,
            stall: director.stall().cloned(),
            plight: director.stall().map(|_| Question::Metamodules(director.plight(world))),
            struck: director.struck().to_vec(),
            prevented: director.prevented(),
            stages: plan.stages.iter().zip(director.stages()).map(|(p, s)| stage(&p.name, s)).collect(),
            bodies: MoveReport {
                started: deeds.started,
                completed: deeds.turns + deeds.moves + deeds.released,
                failed: deeds.failed,
                refused_taken: deeds.blocked,
                refused_late: deeds.late,
                refused_stale: deeds.stale,
                refused_impossible: deeds.impossible,
            },
            metamodules: Some(MetamoduleReport {
                kind: self.setup.kind().name().to_owned(),
                strategy: self.setup.params.strategy.name().to_owned(),
                levels: levels.collect(),
                shift: task.shift.into(),
                turns: deeds.turns,
                connections: deeds.moves,
                releases: deeds.released,
                last_fill_s: director.last_fill().as_secs_f64(),
            }),
        }
    }
    fn last_check(world: &mut MetamoduleWorld, now: Time) -> (Vec<Violation>, u64) {
        world.check_all(now);
        let deeds = world.deeds();
        // Space and grips when an action begins and when it ends, and of every body now.
        let ended = deeds.turns + deeds.moves + deeds.released + deeds.failed;
        let checks = (deeds.started + ended + world.len() as u64) * 2;
        (world.take_violations(), checks)
    }
}

fn stage(name: &str, stage: &Stage) -> StageReport {
    StageReport {
        name: name.to_owned(),
        cells: stage.cells as u64,
        filled: stage.filled as u64,
        opened_s: stage.opened.as_secs_f64(),
        built_s: stage.built.map(Time::as_secs_f64),
        known_s: stage.known.map(Time::as_secs_f64),
        detect_lag_s: stage.built.zip(stage.known).map(|(built, known)| known.since(built).as_secs_f64()),
    }
}
