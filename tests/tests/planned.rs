//! Plans of the world-controller for all metamodules: they can be carried out, are ordered right, and build the
//! thesis's box and chair whatever breaks.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_protocol::agent::{Agent, Birth, Input, Output, OutputOf};
use metamorph_protocol::defects::Defect;
use metamorph_protocol::ids::{Incarnation, ModuleId};
use metamorph_protocol::lattice::Cell;
use metamorph_protocol::metamodule::Metamodule;
use metamorph_protocol::metamodule::blueprint::{SeedOrder, SeedSet, Task};
use metamorph_protocol::metamodule::message::{Instruction, MoveEnd, Order};
use metamorph_protocol::metamodule::params::{Setup, Strategy};
use metamorph_protocol::metamodule::planning::centralized::{CentralPlan, Shortage, bound, plan};
use metamorph_protocol::metamodule::planning::cooperative::{Move, Standstill, WORK};
use metamorph_protocol::metamodule::planning::paths::Ground;
use metamorph_protocol::metamodule::pose::Pose;
use metamorph_protocol::roombots::Kind;
use metamorph_protocol::time::Time;
use metamorph_tests::cases::{Case, Variation, check_all};
use metamorph_tests::metamodules::{Assembly, Goal};
use std::sync::Arc;

fn standstill(goal: Goal, kind: Kind, order: SeedOrder, seed: u64) -> Standstill {
    let of = Assembly::new(goal, kind, Strategy::Planned, order, seed);
    let (task, filled) = (Task::default(), SeedSet::default());
    Standstill { setup: of.setup, task, filled, free: of.start, fixed: Vec::new() }
}

/// Makes the moves of a plan in an order that its dependencies allow, the latest of those that are due first, and
/// returns the poses at the end. Each motion must be free of all other bodies.
fn carried_out(at: &Standstill, of: &CentralPlan) -> Vec<Pose> {
    let setup: &Setup = &at.setup;
    let mut poses = at.free.clone();
    let mut done = vec![false; of.moves.len()];
    while let Some(i) =
        (0..done.len()).rev().find(|i| !done[*i] && of.moves[*i].after.iter().all(|before| done[*before]))
    {
        let made = &of.moves[i];
        assert_eq!(poses[made.body], made.from, "move {i} begins where its body is");
        let others = poses.iter().enumerate().filter(|(body, _)| *body != made.body);
        let taken: Vec<Cell> = others.flat_map(|(_, pose)| setup.motions.cells(*pose)).collect();
        let ground = Ground { motions: &setup.motions, floor: setup.floor, taken: &taken };
        let path = setup.motions.graph().path(made.from.posture, made.posture, ground.taken_at(made.from));
        assert!(path.is_some(), "move {i} has a free way");
        let end = Pose { posture: made.posture, ..made.from };
        poses[made.body] = if made.lands { ground.landed(made.from, made.posture).unwrap() } else { end };
        done[i] = true;
    }
    assert!(done.iter().all(|d| *d), "no move waits for itself");
    poses
}

#[test]
fn plans_build_in_every_order_that_they_allow() {
    let (mut moves, mut bounds) = (0, 0);
    for (goal, kind, order) in [Goal::Box, Goal::Chair].into_iter().flat_map(|goal| {
        let kinds = Kind::METAMODULES.into_iter();
        kinds.flat_map(move |kind| SeedOrder::ALL.map(|order| (goal, kind, order)))
    }) {
        for seed in 0..4 {
            let at = standstill(goal, kind, order, seed);
            let found = plan(&at, WORK);
            assert_eq!(found.shortage, None, "{goal:?} {kind} {order:?} seed {seed}");
            let ends = carried_out(&at, &found);
            let cells: Vec<[Cell; 4]> = ends.iter().map(|pose| at.setup.motions.cells(*pose)).collect();
            assert!(at.setup.seeds(at.task).all(|(_, seed)| cells.contains(&seed.cells())));
            let bound = bound(&at) as usize;
            assert!(found.landings() >= bound, "{goal:?} {kind} {order:?} seed {seed}");
            (moves, bounds) = (moves + found.landings(), bounds + bound);
        }
    }
    assert!(moves * 20 <= bounds * 21, "{moves} moves, at least {bounds}");
}

#[test]
fn the_same_question_has_the_same_plan() {
    let found = || plan(&standstill(Goal::Chair, Kind::Per, SeedOrder::AtOnce, 7), WORK);
    assert_eq!(found(), found());
}

#[test]
fn a_shortage_has_its_reason() {
    let mut few = standstill(Goal::Chair, Kind::Srs, SeedOrder::Crosswise, 3);
    few.free.truncate(4);
    let found = plan(&few, WORK);
    assert_eq!(found.shortage, Some(Shortage::Bodies));
    assert_eq!(found.moves.iter().filter(|m| m.fills.is_some()).count(), 4);

    // The first seed has something in it for good.
    let mut blocked = standstill(Goal::Box, Kind::Srs, SeedOrder::Circular, 3);
    blocked.fixed.push(blocked.setup.seed(blocked.task, 0).unwrap().cells()[2]);
    let found = plan(&blocked, WORK);
    assert!(found.moves.is_empty());
    assert!(matches!(found.shortage, Some(Shortage::NoWay(_) | Shortage::Undecided)), "{found:?}");

    // The last one has: the others are filled.
    let mut blocked = standstill(Goal::Box, Kind::Srs, SeedOrder::Circular, 3);
    let (last, seed) = blocked.setup.seeds(blocked.task).last().unwrap();
    blocked.fixed.push(seed.cells()[2]);
    let found = plan(&blocked, WORK);
    assert_eq!(found.moves.iter().filter(|m| m.fills.is_some()).count(), usize::from(last));
    assert_eq!(found.shortage, Some(Shortage::Undecided));
}

/// What a plan says is not trusted: a move that does not begin where the body is fits nothing.
#[test]
fn a_plan_that_does_not_fit_is_refused() {
    let at = standstill(Goal::Box, Kind::Srs, SeedOrder::Circular, 5);
    let found = plan(&at, WORK);
    let path: Vec<Move> = found
        .moves
        .iter()
        .take_while(|m| m.body == found.moves[0].body)
        .map(|m| Move { body: m.body, from: m.from, posture: m.posture, lands: m.lands })
        .collect();
    assert!(at.after(&path).is_some());
    assert!(at.after(&path[..path.len() - 1]).is_none());
}

/// Returns what a metamodule does that is told to stay by a later plan and then to move by an earlier one.
fn after_an_old_plan(defect: Option<Defect>) -> Vec<OutputOf<Metamodule>> {
    let mut of = Assembly::new(Goal::Box, Kind::Srs, Strategy::Planned, SeedOrder::Circular, 5);
    let at = Standstill {
        setup: of.setup.clone(),
        task: Task::default(),
        filled: SeedSet::default(),
        free: of.start.clone(),
        fixed: Vec::new(),
    };
    let first = &plan(&at, WORK).moves[0];
    Arc::make_mut(&mut of.setup).params.defect = defect;
    let id = ModuleId(first.body as u32);
    let birth =
        Birth { id, incarnation: Incarnation::default(), place: first.from, seed: 1, born: Time::ZERO };
    let mut agent = Metamodule::new(&of.setup, birth, Time::ZERO);
    let end = MoveEnd::of(first.lands, first.fills.is_some());
    let forwards = Instruction::Move { mover: id, from: first.from, posture: first.posture, end };
    for (number, instruction) in [(5, Instruction::Stay), (4, forwards)] {
        agent.handle(Time::ZERO, Input::Order(Order::Instruct { number, instruction }));
        agent.handle(Time::ZERO, Input::Wake);
    }
    let outputs = std::iter::from_fn(|| agent.poll());
    outputs.filter(|output| matches!(output, Output::Act(_))).collect()
}

/// Orders of a plan that has been replaced are not followed, however late they come.
#[test]
fn an_old_plan_is_not_followed() {
    assert_eq!(after_an_old_plan(None), []);
    assert_eq!(after_an_old_plan(Some(Defect::FollowOldPlans)).len(), 1, "the defect is found");
}

fn variations(names: &[&str], seeds: u64) -> impl Iterator<Item = Case> + Send {
    let variations: Vec<&'static Variation> = names.iter().map(|n| Variation::named(n).unwrap()).collect();
    variations.into_iter().flat_map(move |v| Case::all(Strategy::Planned, v, 0..seeds))
}

#[test]
fn planned_builds() {
    let came = check_all(variations(&["plain", "decentralised"], 12));
    for sum in came.sums.values() {
        assert_eq!((sum.runs, sum.built, sum.broken), (96, 96, 0));
    }
}

#[test]
fn planned_builds_whatever_breaks() {
    let names =
        ["loss", "failed-connections", "restart", "long-pause", "passing-obstacles", "change", "crash"];
    check_all(variations(&names, 2));
}

#[test]
fn planned_builds_with_stuck_joints_and_moved_goals() {
    check_all(variations(&["relocation", "stuck-joint", "everything"], 2));
}

/// A run goes the same way each time, planning included.
#[test]
fn planned_runs_repeat() {
    let run = || {
        let of = Assembly::new(Goal::Chair, Kind::Srs, Strategy::Planned, SeedOrder::AtOnce, 3);
        let ran = of.loss("5%").failed_connections("5%").run();
        (ran.outcome, ran.trace, ran.digest)
    };
    assert_eq!(run(), run());
}
