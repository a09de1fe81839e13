//! Runs a swarm of metamodules and collects its results.

use super::Metamodules;
use super::judge::MetamoduleQuestion;
use super::report::{
    self, BlockedReport, ElementsReport, LevelReport, MetamoduleReport, PinnedReport, PlanReport,
};
use crate::connection::ConnectionReport;
use crate::runnable::{Runnable, stage};
use metamorph_protocol::metamodule::blueprint::Task;
use metamorph_protocol::metamodule::params::Setup;
use metamorph_protocol::metamodule::planning::transport::Scenes;
use metamorph_protocol::time::{Span, Time};
use metamorph_report::operator::OperatorReport;
use metamorph_report::run_result::RunResult;
use metamorph_report::schema::MoveReport;
use metamorph_scenario::Plan;
use metamorph_sim_bridge::director::progress::Progress;
use metamorph_sim_bridge::kernel::sim::Sim;
use metamorph_sim_bridge::metamodule::director::{MetamoduleDirector, MetamodulePlan};
use metamorph_sim_bridge::metamodule::world::MetamoduleWorld;
use metamorph_sim_bridge::world::World;
use metamorph_sim_bridge::world::invariants::Violation;
use std::sync::{Arc, LazyLock};

/// The graphs for transports of all runs of this program: those of a sweep have the same floor and elements.
static SCENES: LazyLock<Scenes> = LazyLock::new(Scenes::default);

/// Returns the report of the elements; `None` if there are none.
fn elements_report(
    setup: &Setup,
    director: &MetamoduleDirector,
    world: &MetamoduleWorld,
) -> Option<ElementsReport> {
    let (all, action_counts, goal) = (setup.elements.all(), world.action_counts(), director.task().goal);
    let placed = all.iter().enumerate().filter(|(e, of)| world.element(*e) == of.goal(goal)).count();
    let pinned: Vec<PinnedReport> = director
        .pinned(world)
        .into_iter()
        .map(|(e, by)| PinnedReport { element: all[e].name.clone(), by: by.0 })
        .collect();
    let blocked = director.monitor().stall().and_then(|_| director.blocked(world)).into_iter();
    (!all.is_empty()).then(|| ElementsReport {
        blocked: blocked
            .map(|(e, by)| BlockedReport {
                element: all[e].name.clone(),
                by: by.iter().map(|id| id.0).collect(),
            })
            .collect(),
        placed: placed as u64,
        on_the_way: (all.len() - placed - pinned.len()) as u64,
        pinned,
        hand_overs: action_counts.hand_overs,
        grips: action_counts.grips,
        carries: action_counts.carries,
        drops_prevented: action_counts.drops_prevented,
        overloads_prevented: action_counts.overloads_prevented,
        drops: action_counts.drops,
        drops_on_bodies: action_counts.drops_on_bodies,
        drops_recovered: action_counts.recovered,
        under_way_at_most: action_counts.under_way_at_most,
        transports_at_most: director.plan_counts().map_or(0, |counts| counts.transports_at_most),
    })
}

impl Runnable for Metamodules {
    type World = MetamoduleWorld;
    type Director = MetamoduleDirector;

    fn setup(&self) -> &Arc<Setup> {
        &self.setup
    }
    fn world(&self, plan: &Plan) -> MetamoduleWorld {
        MetamoduleWorld::new(Arc::clone(&self.setup), &self.poses, plan.seed)
            .with_connections(self.connection)
    }
    fn director(&self, plan: &Plan) -> MetamoduleDirector {
        let plan = MetamodulePlan {
            schedule: plan.schedule.clone(),
            stop: plan.stop,
            failure: plan.failure,
            changes: self.changes.to_vec(),
            relocate: self.relocate,
            follow: true,
            hands_over: self.hands_over,
            operator: plan
                .operator
                .and_then(|operator| Some((operator.habits(self.setup.params.patience * 3)?, plan.seed))),
            level: plan.operator.map(|operator| operator.level()).unwrap_or_default(),
            round_trip: plan.link.controller.as_ref().map_or(Span::ZERO, |link| link.usual_longest() * 2),
            scenes: SCENES.clone(),
        };
        MetamoduleDirector::new(Arc::clone(&self.setup), self.poses.len(), plan)
    }
    fn fork(
        sim: &Sim<MetamoduleWorld, MetamoduleDirector>,
    ) -> Option<Sim<MetamoduleWorld, MetamoduleDirector>> {
        sim.fork()
    }
    fn time_step(&self) -> Span {
        self.setup.params.turn_time
    }
    fn audit_every(&self) -> Span {
        // A few bodies are cheap to check; every action is checked as well.
        self.time_step() * 20
    }
    fn progress(director: &MetamoduleDirector) -> Progress {
        director.progress()
    }
    fn account(&self, plan: &Plan, director: &MetamoduleDirector, world: &MetamoduleWorld) -> RunResult {
        let (action_counts, progress) = (world.action_counts(), director.progress());
        // A goal that was given up is the one that was not built.
        let task = Task { is_dropped: false, ..director.task() };
        let filled = director.filled();
        let mut seeds = 0u8..;
        let levels = self.setup.goal(task).levels().iter().map(|seeds_of_it| {
            let filled = seeds.by_ref().take(usize::from(*seeds_of_it)).filter(|s| filled.has(*s)).count();
            LevelReport { seeds: u64::from(*seeds_of_it), filled: filled as u64 }
        });
        let bodies = MoveReport {
            started: action_counts.started,
            completed: action_counts.turns
                + action_counts.moves
                + action_counts.released
                + action_counts.grips
                + action_counts.let_go,
            failed: action_counts.failed,
            refused_taken: action_counts.blocked,
            refused_late: action_counts.late,
            refused_stale: action_counts.stale,
            refused_impossible: action_counts.impossible,
            called: 0,
            led: if director.plan_counts().is_some() { action_counts.moves } else { 0 },
        };
        RunResult {
            // The search knows no elements: while one is left, it cannot say what could still be built.
            snapshot: director
                .monitor()
                .stall()
                .filter(|_| !director.has_elements_left(world) && !director.task().is_dropped)
                .map(|_| MetamoduleQuestion {
                    now: director.snapshot(world),
                    before: director.before().cloned(),
                })
                .map(|question| Box::new(question) as _),
            prevented: director.prevented(),
            stages: plan.stages.iter().zip(director.stages()).map(|(p, s)| stage(&p.name, s)).collect(),
            moves: action_counts.moves,
            family_part: Some(report::part(
                &MetamoduleReport {
                    kind: self.setup.kind().name().to_owned(),
                    strategy: self.setup.params.strategy.name().to_owned(),
                    levels: levels.collect(),
                    shift: task.shift.into(),
                    goal_changes: director.goal_changes().iter().map(report::goal_change).collect(),
                    turns: action_counts.turns,
                    connections: action_counts.moves,
                    releases: action_counts.released,
                    last_fill_s: director.monitor().last_gain().as_secs_f64(),
                    plan: director.plan_counts().map(|p| PlanReport {
                        plans: p.plans,
                        moves: p.first_moves,
                        bound: p.bound,
                        orders: p.ordered,
                        late: p.late,
                        handed_over: p.handed_over,
                        work: p.work,
                    }),
                    elements: elements_report(&self.setup, director, world),
                    connecting: world.connection_counts().as_ref().map(ConnectionReport::of),
                },
                &bodies,
                world.len(),
                progress.filled > 0,
            )),
            bodies,
            operator: director.operator().map(|operator| {
                OperatorReport::of(
                    operator,
                    director.monitor().outcome().map_or(operator.seen(), |(at, _)| at),
                )
            }),
            ..RunResult::of(director.monitor(), progress)
        }
    }
    fn last_check(world: &mut MetamoduleWorld, now: Time) -> (Vec<Violation>, u64) {
        world.check_all(now);
        let action_counts = world.action_counts();
        // Space and grips at the start and end of each action, and of every body once at the end.
        let ended = action_counts.turns
            + action_counts.moves
            + action_counts.released
            + action_counts.grips
            + action_counts.let_go
            + action_counts.failed;
        let checks = (action_counts.started + ended + world.len() as u64) * 2;
        (world.take_violations(), checks)
    }
}
