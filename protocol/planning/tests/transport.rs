//! Transports of a cube by two metamodules: plans, proofs, and an independent check of every plan.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_core::lattice::Cell;
use metamorph_core::ratio::Ratio;
use metamorph_planning::manipulation::colour::colour;
use metamorph_planning::manipulation::element::{cell_at, moved};
use metamorph_planning::manipulation::load::LoadLimits;
use metamorph_planning::manipulation::scene::Scene;
use metamorph_planning::manipulation::terrain::Terrain;
use metamorph_planning::manipulation::transport::{
    Answer, ManipulationPlan, Task, TransportReason, plan, plan_any_colour,
};
use metamorph_planning::manipulation::verification::BodyAction;
use metamorph_planning::manipulation::walking::{Body, Motion, WalkingGround};
use metamorph_planning::manipulation::worlds::TransportWorld;
use metamorph_roombots::Kind;
use metamorph_roombots::database::Database;
use metamorph_roombots::sweep::FloorContact;
use std::collections::BTreeSet;
use std::sync::Arc;

/// Carries a plan out on cells alone: every posture of every action, with everything else where it is.
fn check(scene: &Scene, ground: &WalkingGround<'_>, task: &Task, plan: &ManipulationPlan) {
    let table = scene.table();
    let (mut bodies, mut cube, mut holder) = (task.bodies.clone(), task.start[0], None);
    let mut put_down = 0;
    let head = |body: &Body| {
        let head = table.postures()[usize::from(body.posture)].posture.placement().head;
        scene.pose(body.foothold).compose(head)
    };
    // The cell in front of the head plate.
    let front = |body: &Body| cell_at(moved(head(body), [0, 0, -1]));
    for action in &plan.actions {
        let body = &mut bodies[action.mover];
        match action.body_action {
            BodyAction::Move(Motion::Turn { to, degrees }) => {
                let ends = BTreeSet::from([body.posture, to]);
                let step = table.steps().iter().find(|s| BTreeSet::from([s.from, s.to]) == ends).unwrap();
                assert_eq!(step.floor, FloorContact::Free);
                assert_eq!(degrees, if step.joint % 3 == 1 { 90 } else { 120 });
                body.posture = to;
            }
            BodyAction::Move(Motion::Land(to)) => {
                assert_eq!(head(body), scene.pose(to.foothold), "the head is on the connector");
                assert!(ground.exists(to.foothold), "the connector exists");
                assert_ne!(holder, Some(action.mover), "the head is free");
                let seen = |b: &Body| scene.body(b.foothold, b.posture);
                let (before, mut after) = (seen(body), seen(&to));
                after.reverse();
                assert_eq!(before, after, "landing moves nothing");
                *body = to;
            }
            BodyAction::Grip { .. } => {
                assert_eq!(front(body), cube);
                // The one that held it releases it in the next action.
                holder = Some(action.mover);
            }
            BodyAction::LetGo if holder == Some(action.mover) => {
                assert!(task.puts_down || task.rests, "the element stays held");
                assert_eq!(cube.z, 0, "it rests on the floor");
                (holder, put_down) = (None, put_down + 1);
            }
            BodyAction::LetGo => {}
        }
        if let (Some(mover), BodyAction::Move(_)) = (holder, action.body_action) {
            cube = front(&bodies[mover]);
        }
        let mut cells: Vec<Cell> = bodies.iter().flat_map(|b| scene.body(b.foothold, b.posture)).collect();
        cells.push(cube);
        assert!(cells.iter().all(|c| !scene.terrain().is_blocked(*c)), "{cells:?}");
        assert_eq!(cells.iter().collect::<BTreeSet<_>>().len(), cells.len(), "{cells:?}");
        assert_eq!(colour(cube), colour(task.start[0]));
    }
    assert_eq!(vec![cube], task.goal);
    let grips =
        plan.actions.iter().filter(|a| matches!(a.body_action, BodyAction::Grip { .. })).count() as u32;
    assert_eq!(plan.hand_overs + 1 + put_down - u32::from(task.rests), grips);
    assert_eq!(holder.is_none(), task.rests);
    assert!(plan.lower <= plan.relaxed && plan.hand_overs < plan.connections());
}

#[test]
fn every_task_ends_in_a_plan_that_holds_or_a_proof() {
    let (database, cube) = (Arc::new(Database::build()), "cube".parse().unwrap());
    let scene = Scene::new(database, Kind::Srs, &cube, 250, LoadLimits::NOMINAL, Terrain::experiment());
    let (mut planned, mut hand_overs, mut reasons) = (0, 0, BTreeSet::new());
    for (tenths, seeds) in [(8, 0..2), (4, 0..2), (2, 0..2)] {
        for seed in seeds {
            let world = TransportWorld::draw(&scene, Ratio::new(tenths, 10).unwrap(), seed);
            let ground = WalkingGround::new(&scene, |c| world.exists(c));
            let task = world.task(500);
            match plan(&ground, &task) {
                Answer::Plan(plan) => {
                    check(&scene, &ground, &task, &plan);
                    (planned, hand_overs) = (planned + 1, hand_overs + plan.hand_overs);
                }
                Answer::Infeasible(reason) => _ = reasons.insert(reason),
                undecided @ Answer::Undecided { .. } => panic!("{tenths} {seed}: {undecided:?}"),
            }
        }
    }
    assert!(planned >= 4 && hand_overs >= 2, "{planned} plans, {hand_overs} hand-overs");
    assert!(
        reasons.contains(&TransportReason::NoPlace) && reasons.contains(&TransportReason::NoWalk),
        "{reasons:?}"
    );

    let world = TransportWorld::draw(&scene, Ratio::new(8, 10).unwrap(), 0);
    let ground = WalkingGround::new(&scene, |c| world.exists(c));
    let other = |change: &dyn Fn(&mut Task)| {
        let mut task = world.task(500);
        change(&mut task);
        plan(&ground, &task)
    };
    let beside = |task: &mut Task| task.goal[0].x += 1;
    assert_eq!(other(&beside), Answer::Infeasible(TransportReason::Colour));
    // A negative control: without the check of colours the search proves the same, and does not give up.
    let mut task = world.task(500);
    beside(&mut task);
    for puts_down in [false, true] {
        let answer = plan_any_colour(&ground, &Task { puts_down, ..task.clone() });
        assert!(matches!(answer, Answer::Infeasible(_)), "{answer:?}");
    }
    let high = |task: &mut Task| task.start[0].z += 40;
    assert_eq!(other(&high), Answer::Infeasible(TransportReason::NoGrip));
    // One metamodule cannot hand over, and cannot bring the cube to the other end of the floor.
    let alone = |task: &mut Task| {
        task.bodies.truncate(1);
        task.goal = vec![Cell::new(19, 12 - (1 + colour(task.start[0])) as i16 % 2, 0)];
    };
    assert_eq!(other(&alone), Answer::Infeasible(TransportReason::NoWalk));
    // If it may put the cube down on the way, it can; also if the cube lies there in the end.
    for rests in [false, true] {
        let mut task = world.task(500);
        alone(&mut task);
        (task.puts_down, task.rests) = (true, rests);
        let Answer::Plan(found) = plan(&ground, &task) else { panic!("rests: {rests}") };
        check(&scene, &ground, &task, &found);
        assert_eq!(found.hand_overs, 0);
    }
}
