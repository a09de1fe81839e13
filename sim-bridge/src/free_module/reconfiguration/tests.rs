//! Tests of world, agents and director together, and of the checks of the world.

use super::director::{FreeModuleDirector, ReconfigurationCounts, ReconfigurationRun};
use super::invariants::*;
use super::reasons::NO_PLAN;
use super::world::FreeModuleWorld;
use metamorph_kernel::director::faults::{Fault, Schedule};
use metamorph_kernel::director::outcome::{Outcome, Stall};
use metamorph_kernel::director::port::DirectorPort;
use metamorph_kernel::director::progress::Stop;
use metamorph_kernel::kernel::sim::{Sim, SimConfig};
use metamorph_kernel::world::World;
use metamorph_kernel::world::invariants::{Invariant, ONE_MODULE_PER_CELL};
use metamorph_protocol::assembly::action::Connectors;
use metamorph_protocol::assembly::checker::Physics;
use metamorph_protocol::assembly::collision::Model;
use metamorph_protocol::assembly::named;
use metamorph_protocol::assembly::space::{Goal, Objective};
use metamorph_protocol::defects::Defect;
use metamorph_protocol::free_module::reconfiguration::LatticeSetup;
use metamorph_protocol::free_module::reconfiguration::message::{
    LatticeAction, LatticeBodyAction, LatticePercept, LatticeRefusal, LatticeStatus, StepName,
};
use metamorph_protocol::free_module::reconfiguration::place::LatticePlace;
use metamorph_protocol::free_module::reconfiguration::planning::Planner;
use metamorph_protocol::ids::{ModuleId, Revision};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::link::LinkModel;
use metamorph_protocol::plan::Limits;
use metamorph_protocol::ratio::Ratio;
use metamorph_protocol::runtime::Sensed;
use metamorph_protocol::time::{Span, Time};
use std::sync::Arc;

const TURN: Span = Span::secs(1);

fn at(seconds: u64) -> Time {
    Time::ZERO + Span::secs(seconds)
}

/// A run to be simulated.
struct Run {
    types: &'static [u8],
    goal: &'static str,
    faults: Vec<(Time, Fault)>,
    failure: Ratio,
    loss: Ratio,
    defect: Option<Defect>,
    seed: u64,
}

/// Result of a run.
struct Ran {
    outcome: Option<Outcome>,
    stall: Option<Stall>,
    plan: ReconfigurationCounts,
    broken: Vec<Invariant>,
    trace: u64,
    crashed: u64,
}

impl Run {
    fn new(seed: u64) -> Run {
        Run {
            types: &[0, 0],
            goal: "loop:2x3",
            faults: Vec::new(),
            failure: Ratio::ZERO,
            loss: Ratio::ZERO,
            defect: None,
            seed,
        }
    }
    fn start(&self) -> Vec<LatticePlace> {
        named::line(self.types).unwrap().modules().iter().map(LatticePlace::of).collect()
    }
    fn course(&self) -> ReconfigurationRun {
        let planner = Planner {
            goal: Goal::Shape(named::shape(self.goal).unwrap()),
            collision: Model::Strict,
            connectors: Connectors::All,
            objective: Objective::Actions,
            weight: 100,
            limits: Limits { memory: 64 << 20, work: 2_000 },
        };
        let stop = Stop {
            timeout: at(10_000),
            stall: TURN * 300,
            livelock: TURN * 3_000,
            planned_until: Time::ZERO,
        };
        let schedule = Schedule::new(self.faults.clone());
        ReconfigurationRun { planner, schedule, stop, failure: self.failure }
    }
    fn simulate(self) -> Ran {
        let setup = LatticeSetup { defect: self.defect, ..LatticeSetup::scaled(TURN, TURN / 10) };
        let setup = Arc::new(setup);
        let physics = Physics { collision: Model::Strict, active: false, standing: None };
        let start = self.start();
        let course = self.course();
        let director = FreeModuleDirector::new(Arc::clone(&setup), start.len(), course);
        let world = FreeModuleWorld::new(Arc::clone(&setup), physics, &start, self.seed);
        let (delay_min, delay_max) = (TURN / 100, TURN / 10);
        let link = LinkModel { delay_min, delay_max, loss: self.loss, ..LinkModel::default() };
        let config =
            SimConfig { setup, link, seed: self.seed, audit_every: TURN * 20, ignore_sessions: false };
        let mut sim = Sim::new(config, world, director);
        while !sim.run_until(sim.now() + TURN * 1_000) {}
        let (violations, _) = sim.violations();
        violations.iter().for_each(|v| eprintln!("{v}"));
        Ran {
            outcome: sim.director().monitor().outcome().map(|(_, outcome)| outcome),
            stall: sim.director().monitor().stall().cloned(),
            plan: sim.director().plan_counts(),
            broken: violations.iter().map(|v| v.invariant).collect(),
            trace: sim.trace().value(),
            crashed: sim.director().monitor().crashed_and_restarted().0,
        }
    }
}

fn built(ran: &Ran, about: &str) {
    assert_eq!(ran.outcome, Some(Outcome::Built), "{about}: {:?}", ran.stall);
    assert_eq!(ran.broken, [], "{about}");
}

#[test]
fn a_line_becomes_a_loop_by_the_fewest_actions() {
    let four = || Run { types: &[0, 0, 0], goal: "loop:3x3", ..Run::new(1) };
    let ran = four().simulate();
    built(&ran, "line to loop");
    let plan = ran.plan;
    assert_eq!((plan.plans, plan.confirmed, plan.actions, plan.bound), (1, 6, 6, 6));
    // An attachment is ordered to both sides.
    assert!(plan.orders > plan.actions && plan.failed == 0, "{plan:?}");
    let again = four().simulate();
    assert_eq!((again.trace, again.plan), (ran.trace, plan));
}

#[test]
fn lost_messages_and_failed_connections_are_repeated() {
    for seed in 1..=10 {
        let (failure, loss) = (Ratio::new(30, 100).unwrap(), Ratio::new(20, 100).unwrap());
        let ran = Run { failure, loss, ..Run::new(seed) }.simulate();
        built(&ran, &format!("seed {seed}"));
    }
}

/// Each module dies at each second of the plan and is restarted.
#[test]
fn a_module_that_dies_and_comes_back_does_no_harm() {
    for module in (0..3).map(ModuleId) {
        for second in 0..8 {
            let faults = vec![(at(second), Fault::Kill(module)), (at(second + 3), Fault::Restart(module))];
            let ran = Run { faults, ..Run::new(second) }.simulate();
            built(&ran, &format!("{module} at {second} s"));
            assert!(ran.crashed == 1 || ran.plan.plans == 1);
        }
    }
}

/// No plan is made around a module while its process starts again, however slow the machine is; around a dead one it is.
#[test]
fn a_restart_that_takes_long_is_waited_for() {
    let setup = Arc::new(LatticeSetup::scaled(TURN, TURN / 10));
    let (restart, kill) = (Fault::Restart(ModuleId(0)), Fault::Kill(ModuleId(0)));
    // A fault can be due before the first start of its module is reported.
    for (fault, after_start, is_awaited) in
        [(restart, true, true), (restart, false, true), (kill, true, false)]
    {
        let run = Run { faults: vec![(at(0), fault)], ..Run::new(1) };
        let mut world = world(run.types);
        let mut director = FreeModuleDirector::new(Arc::clone(&setup), run.start().len(), run.course());
        if after_start {
            (0..3).for_each(|id| director.started(at(0), ModuleId(id)));
            director.wake(at(0), &mut world);
        } else {
            director.wake(at(0), &mut world);
            (0..3).for_each(|id| director.started(at(0), ModuleId(id)));
        }
        director.died(at(0), ModuleId(0));
        director.wake(at(0), &mut world);
        director.wake(Time::ZERO + setup.patience * 3, &mut world);
        assert_eq!(director.plan_counts().work == 0, is_awaited, "{fault}, {after_start}");
    }
}

/// A turn moves several modules, whose reports come one after another: nothing is planned before the last.
#[test]
fn a_report_that_does_not_fit_the_others_is_waited_for() {
    let setup = Arc::new(LatticeSetup::scaled(TURN, TURN / 10));
    let run = Run::new(1);
    let (mut world, places) = (world(run.types), run.start());
    let mut director = FreeModuleDirector::new(setup, places.len(), run.course());
    (0..3).for_each(|id| director.started(at(0), ModuleId(id)));
    director.wake(at(0), &mut world);
    let report = |director: &mut FreeModuleDirector, id: usize, place: LatticePlace| {
        let status =
            LatticeStatus { epoch: 1, place, busy: false, last: None, prevented: 0, waits_for: None };
        director.report(at(0), ModuleId(id as u32), status);
    };
    (0..3).for_each(|id| report(&mut director, id, places[id]));
    for stale in [
        LatticePlace { cell: places[2].cell + Cell::new(0, 0, 4), ..places[2] },
        LatticePlace { ..places[1] },
    ] {
        report(&mut director, 2, stale);
        director.wake(at(1), &mut world);
        assert_eq!(director.plan_counts().plans, 0, "{stale:?}");
    }
    report(&mut director, 2, places[2]);
    director.wake(at(1), &mut world);
    assert_eq!(director.plan_counts().plans, 1);
}

#[test]
fn a_pause_of_a_module_is_waited_for() {
    for second in 0..6 {
        let id = ModuleId(1);
        let faults = vec![(at(second), Fault::Pause(id)), (at(second + 200), Fault::Resume(id))];
        built(&Run { faults, ..Run::new(second) }.simulate(), &format!("at {second} s"));
    }
}

/// With a stuck joint another plan is made, or there is a proof that there is none.
#[test]
fn a_stuck_joint_is_planned_around() {
    let (mut around, mut proved) = (0, 0);
    for module in (0..3).map(ModuleId) {
        let ran = Run { faults: vec![(at(0), Fault::Stick(module))], ..Run::new(1) }.simulate();
        assert_eq!(ran.broken, []);
        match ran.outcome {
            Some(Outcome::Built) => around += 1,
            _ => proved += 1,
        }
    }
    assert!(around > 0 && around + proved == 3);
}

/// A joint that turns again ends the standstill.
#[test]
fn a_joint_that_turns_again_is_used() {
    let stick = |id| (at(0), Fault::Stick(ModuleId(id)));
    let free = |id| (at(400), Fault::Unstick(ModuleId(id)));
    let faults = (0..3).map(stick).chain((0..3).map(free)).collect();
    let ran = Run { faults, ..Run::new(1) }.simulate();
    built(&ran, "all stuck");
    assert!(ran.plan.failed > 0);
}

/// Where all modules but one are dead permanently, it is proved that there is no plan.
#[test]
fn without_a_plan_the_run_ends_with_the_proof() {
    let faults = (1..3).map(|id| (at(0), Fault::Kill(ModuleId(id)))).collect();
    let ran = Run { faults, ..Run::new(1) }.simulate();
    assert_eq!(ran.outcome, Some(Outcome::Deadlock));
    let stall = ran.stall.unwrap();
    assert_eq!((stall.reason, stall.proof.is_some()), (NO_PLAN, true));
}

/// Defects of agents are found by a named check, and a run without them passes.
#[test]
fn defects_of_agents_are_found() {
    let with = |defect| Run { defect, ..Run::new(1) }.simulate().broken;
    assert_eq!(with(None), []);
    assert!(with(Some(Defect::AskNone)).contains(&BRANCH_LOCKED));
}

/// A world at the start of a run, its agents left out.
fn world(types: &'static [u8]) -> FreeModuleWorld {
    let start = Run { types, ..Run::new(1) }.start();
    let setup = Arc::new(LatticeSetup::scaled(TURN, TURN / 10));
    let physics = Physics { collision: Model::Strict, active: false, standing: None };
    FreeModuleWorld::new(setup, physics, &start, 1)
}

fn act(world: &mut FreeModuleWorld, module: u32, index: u16, body_action: LatticeBodyAction) {
    let step = StepName { epoch: 1, index, attempt: 0 };
    let id = ModuleId(module);
    let revision = world.revision(id);
    world.act(Time::ZERO, id, revision, &LatticeAction { step, body_action, not_after: Time::NEVER });
}

fn percepts(world: &mut FreeModuleWorld) -> Vec<(u32, LatticePercept)> {
    world.advance(at(1_000));
    let percept = |(id, sensed)| if let Sensed::Percept(p) = sensed { Some((id, p)) } else { None };
    std::iter::from_fn(|| world.poll()).filter_map(percept).map(|(id, p): (ModuleId, _)| (id.0, p)).collect()
}

fn fired(world: &mut FreeModuleWorld) -> Vec<Invariant> {
    let mut all: Vec<_> = world.take_violations().into_iter().map(|v| v.invariant).collect();
    all.dedup();
    all
}

const BEND: LatticeBodyAction = LatticeBodyAction::Turn { joint: 1, positive: true };

#[test]
fn a_turn_carries_all_modules_behind_the_joint() {
    let mut world = world(&[0, 0]);
    let before: Vec<LatticePlace> = (0..3).map(|id| world.place(ModuleId(id))).collect();
    act(&mut world, 1, 0, BEND);
    let told = percepts(&mut world);
    assert_eq!(fired(&mut world), []);
    let after: Vec<LatticePlace> = (0..3).map(|id| world.place(ModuleId(id))).collect();
    let moved: Vec<usize> = (0..3)
        .filter(|i| (before[*i].cell, before[*i].rotation) != (after[*i].cell, after[*i].rotation))
        .collect();
    assert_eq!(moved.len(), 1, "one side of the middle module: {before:?} {after:?}");
    assert_ne!(before[1].posture, after[1].posture);
    let carried: Vec<u32> =
        told.iter().filter(|(_, p)| matches!(p, LatticePercept::Carried(_))).map(|(id, _)| *id).collect();
    assert_eq!(carried, [moved[0] as u32]);
    let settled = LatticePercept::Settled { place: after[moved[0]], moved: true };
    assert!(told.contains(&(moved[0] as u32, settled)), "{told:?}");
}

/// The interlock: the only connection does not open, and a connector that faces nothing does not close.
#[test]
fn bodies_refuse_what_is_not_possible() {
    let mut world = world(&[0]);
    let closed = world.place(ModuleId(0)).closed.trailing_zeros() as u8;
    for body_action in [
        LatticeBodyAction::Detach(closed),
        LatticeBodyAction::Attach(closed),
        LatticeBodyAction::Attach(4),
        LatticeBodyAction::Detach(4),
    ] {
        act(&mut world, 0, 0, body_action);
        assert_eq!(
            percepts(&mut world),
            [(0, LatticePercept::Refused(LatticeRefusal::Impossible))],
            "{body_action:?}"
        );
    }
    act(&mut world, 0, 1, BEND);
    act(&mut world, 0, 2, BEND);
    act(&mut world, 1, 3, BEND);
    let refused =
        percepts(&mut world).into_iter().filter(|(_, p)| *p == LatticePercept::Refused(LatticeRefusal::Busy));
    assert!(refused.count() >= 1);
    assert_eq!(fired(&mut world), []);
}

#[test]
fn one_connected_body_fires() {
    let mut world = world(&[0, 0]);
    world.check_all(Time::ZERO);
    assert_eq!(fired(&mut world), []);
    // Both sides of a bridge are open.
    world.let_go_of_everything(ModuleId(0));
    world.check_all(Time::ZERO);
    assert!(fired(&mut world).contains(&ONE_CONNECTED_BODY));
}

#[test]
fn connection_sides_agree_fires_in_the_world() {
    let mut world = world(&[0, 0]);
    world.open_without_telling(ModuleId(0));
    world.check_all(Time::ZERO);
    assert!(fired(&mut world).contains(&CONNECTION_SIDES_AGREE));
}

#[test]
fn one_module_per_cell_fires_in_the_world() {
    let mut world = world(&[0, 0]);
    world.put_on_top(ModuleId(2), ModuleId(0));
    world.check_all(Time::ZERO);
    assert!(fired(&mut world).contains(&ONE_MODULE_PER_CELL));
}

/// Two turns begin at once, one of them on the moving side of the other.
#[test]
fn no_turn_while_pending_fires_in_the_world() {
    let mut world = world(&[0, 0]);
    let of = |world: &mut FreeModuleWorld, first, second| {
        act(world, first, 0, BEND);
        act(world, second, 1, LatticeBodyAction::Turn { joint: 0, positive: true });
        percepts(world);
        fired(world)
    };
    let (outer, inner) = if world.is_behind(ModuleId(1), ModuleId(0)) { (1, 0) } else { (1, 2) };
    assert_eq!(of(&mut world, inner, inner), []);
    world.make_pending(ModuleId(inner));
    act(&mut world, outer, 2, BEND);
    assert!(fired(&mut world).contains(&NO_TURN_WHILE_PENDING));
}

#[test]
fn once_per_epoch_and_confirmed_in_order_fire_in_the_world() {
    let mut world = world(&[0]);
    act(&mut world, 0, 7, BEND);
    percepts(&mut world);
    world.confirm(Time::ZERO, 1, 7, &[ModuleId(0)], &[]);
    assert_eq!(fired(&mut world), []);
    act(&mut world, 0, 7, BEND);
    percepts(&mut world);
    assert_eq!(fired(&mut world), [ONCE_PER_EPOCH]);
    world.confirm(Time::ZERO, 1, 8, &[ModuleId(0)], &[]);
    assert_eq!(fired(&mut world), [CONFIRMED_IN_ORDER]);
    act(&mut world, 0, 9, BEND);
    percepts(&mut world);
    world.confirm(Time::ZERO, 1, 9, &[ModuleId(0)], &[3]);
    assert_eq!(fired(&mut world), [CONFIRMED_IN_ORDER]);
    assert_eq!(world.revision(ModuleId(0)), Revision(1));
}
