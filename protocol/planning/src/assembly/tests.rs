//! Configurations, shapes and bounds against each other, against the checker and against counted figures.

use super::action::{Action, Connectors, Rules};
use super::canonical::Detail;
use super::checker::{PhysicalAction, Physics, Refusal, World, robot};
use super::collision::Model;
use super::configuration::{Configuration, Links, Module};
use super::named::{line, shape};
use super::report2009::Report2009;
use super::shape::Shape;
use super::shape_graph::{Prices, ShapeGraph};
use super::space::{Assembly, Goal, Objective};
use super::tables::{TABLES, add, sub};
use crate::plan::levels::{Counted, Levels};
use crate::plan::search::{Method, Search};
use crate::plan::{Limits, Outcome, Space, Step, actions};
use metamorph_core::defects::PlanningDefect;
use metamorph_core::rng::Rng;
use metamorph_roombots::Kind;
use metamorph_roombots::connector::Connector;
use metamorph_roombots::posture::Posture;

pub(super) const LIMITS: Limits = Limits { memory: 1 << 30, work: u64::MAX };

pub(super) fn rules(model: Model) -> Rules {
    Rules::new(Connectors::All, model)
}

/// Returns a configuration some random actions away from a line.
pub(super) fn drawn(rng: &mut Rng, modules: usize, steps: u64) -> Configuration {
    let types: Vec<u8> = (1..modules).map(|_| rng.below(4) as u8).collect();
    let mut at = line(&types).unwrap();
    let rules = rules(Model::Final);
    for _ in 0..steps {
        let mut next = Vec::new();
        rules.expand(&at, |_, to| next.push(*to));
        at = next[rng.below(next.len() as u64) as usize];
    }
    at
}

pub(super) fn world(c: &Configuration) -> World {
    let t = &**TABLES;
    let robots = c.modules().iter().map(|m| {
        let steps = Posture::from_code(Kind::Single, m.posture.into()).steps().try_into().unwrap();
        robot(m.cell.map(i16::from), t.rotations[usize::from(m.rotation)], &steps)
    });
    let place = |(m, c): (u8, u8)| (usize::from(m), Connector::ALL[usize::from(c)]);
    let held = c.connections().into_iter().map(|p| (place(p.a), place(p.b))).collect();
    World { robots: robots.collect(), held }
}

pub(super) fn physical(action: Action) -> PhysicalAction {
    let place = |(m, c): (u8, u8)| (usize::from(m), Connector::ALL[usize::from(c)]);
    match action {
        Action::Attach(p) => PhysicalAction::Attach(place(p.a), place(p.b)),
        Action::Detach(p) => PhysicalAction::Detach(place(p.a), place(p.b)),
        Action::Turn { module, joint, positive } => {
            PhysicalAction::Turn(module.into(), joint.into(), positive)
        }
    }
}

/// Exactly the actions that the planner generates are possible for the checker, with the same result.
#[test]
fn the_checker_permits_what_the_planner_generates_and_nothing_else() {
    let mut rng = Rng::named(1, "checker", 0);
    for model in [Model::Final, Model::Core, Model::Strict] {
        let physics = Physics { collision: model, active: false, standing: None };
        let rules = rules(model);
        let rounds = if model == Model::Final { 60 } else { 3 };
        for round in 0..rounds {
            let n = 2 + rng.below(3) as usize;
            let at = drawn(&mut rng, n, 12);
            let before = world(&at);
            before.check().unwrap();
            let mut found = Vec::new();
            rules.expand(&at, |action, to| {
                let after = before.act(physical(action), physics).unwrap_or_else(|e| {
                    panic!("{model:?}, round {round}: {action:?} of {at:?}: {e}");
                });
                assert_eq!(after.fingerprint(), world(to).fingerprint(), "{action:?} of {at:?}");
                found.push(physical(action));
            });
            for action in all_physical_actions(&at) {
                let possible = before.act(action, physics).is_ok();
                assert_eq!(
                    possible,
                    found.contains(&action),
                    "{model:?}, round {round}: {action:?} of {at:?}"
                );
            }
        }
    }
}

/// Returns why the checker refuses an action that rules with a defect generate; the first such refusal.
fn refusal(defect: PlanningDefect, model: Model) -> Option<Refusal> {
    let physics = Physics { collision: model, active: false, standing: None };
    let defective = rules(model).with(defect);
    (0..400).find_map(|seed| {
        let mut rng = Rng::named(seed, "defects", 0);
        let at = drawn(&mut rng, 3, 12);
        let (before, mut found) = (world(&at), None);
        defective.expand(&at, |action, _| {
            found = found.take().or_else(|| before.act(physical(action), physics).err());
        });
        found
    })
}

#[test]
fn the_checker_finds_detached_bridges() {
    let refusal = refusal(PlanningDefect::DetachBridges, Model::Final);
    assert!(matches!(refusal, Some(Refusal::Parted(_))), "{refusal:?}");
}

#[test]
fn the_checker_finds_turns_in_loops() {
    let refusal = refusal(PlanningDefect::TurnInLoops, Model::Final);
    assert!(matches!(refusal, Some(Refusal::Locked(..))), "{refusal:?}");
}

#[test]
fn the_checker_finds_a_forgotten_half_of_a_cube() {
    let refusal = refusal(PlanningDefect::IgnoreOwnHalf, Model::Strict);
    assert!(matches!(refusal, Some(Refusal::Touch(..))), "{refusal:?}");
}

/// Visited by shape, a search loses goals that it could reach: the defect of the report's planner.
#[test]
fn a_search_that_visits_by_shape_misses_a_goal() {
    let start = line(&[0, 0]).unwrap();
    let graph = ShapeGraph { modules: 3, prices: Prices::ONE };
    let mut shapes = Levels::new(graph, &Shape::of(&start), LIMITS);
    while shapes.advance(1_000) == Counted::Running {}
    let missed = (0..shapes.table().len() as u32).find(|id| {
        let goal = shapes.space().state(shapes.table().key(*id));
        let mut by_shape = Report2009::new(rules(Model::Final), &start, &goal, Rng::named(0, "ties", 0));
        while by_shape.advance(1_000, true) {}
        let space = Assembly::new(3, rules(Model::Final), Objective::Actions, &Goal::Shape(goal), usize::MAX);
        let mut exact = Search::new(space, &start, LIMITS, Method::astar());
        by_shape.found().first.is_none()
            && matches!(exact.advance(u64::MAX), Step::Done(Outcome::Solved { .. }))
    });
    assert!(missed.is_some());
}

pub(super) fn all_physical_actions(c: &Configuration) -> Vec<PhysicalAction> {
    let mut actions = Vec::new();
    let n = c.len();
    for m in 0..n {
        for joint in 0..3 {
            actions.extend([PhysicalAction::Turn(m, joint, false), PhysicalAction::Turn(m, joint, true)]);
        }
        for other in m + 1..n {
            for a in Connector::ALL {
                for b in Connector::ALL {
                    actions.extend([
                        PhysicalAction::Attach((m, a), (other, b)),
                        PhysicalAction::Detach((m, a), (other, b)),
                    ]);
                }
            }
        }
    }
    actions
}

/// Returns the same configuration moved as a whole, with modules and ends renamed.
fn renamed(rng: &mut Rng, c: &Configuration) -> Configuration {
    let t = &**TABLES;
    let turn = rng.below(24) as u8;
    let mut modules: Vec<Module> = c.modules().to_vec();
    for i in (1..modules.len()).rev() {
        modules.swap(i, rng.below(i as u64 + 1) as usize);
    }
    for m in &mut modules {
        m.cell = add(t.rotate(turn, sub(m.cell, [1, 2, 0])), [-3, 2, 1]);
        m.rotation = t.times(turn, m.rotation);
        if rng.below(2) == 1 {
            *m = m.reversed();
        }
    }
    Configuration::new(&modules).unwrap()
}

fn key(detail: Detail, c: &Configuration) -> Vec<u8> {
    let mut key = vec![0; detail.key_width(c.len())];
    detail.key(c, &mut key);
    key
}

#[test]
fn canonical_forms_do_not_depend_on_place_and_names() {
    let mut rng = Rng::named(2, "canonical", 0);
    for _ in 0..2_000 {
        let n = 1 + rng.below(6) as usize;
        let c = drawn(&mut rng, n, 8);
        let other = renamed(&mut rng, &c);
        for detail in [Detail::Joints, Detail::Frames] {
            let form = key(detail, &c);
            assert_eq!(key(detail, &other), form, "{c:?}");
            let back = detail.configuration(&form);
            assert_eq!(key(detail, &back), form, "{c:?}");
            assert_eq!(Shape::of(&back).canonical(), Shape::of(&c).canonical());
        }
        let form = Shape::of(&c).canonical();
        assert_eq!(Shape::of(&other).canonical(), form);
        assert_eq!(Shape::from_key(&form).canonical(), form);
        if key(Detail::Joints, &c) != key(Detail::Joints, &other) {
            panic!("different forms");
        }
    }
}

/// Different keys of neighbours are different configurations: the checker's fingerprint separates them under every
/// naming, so equal keys must have equal fingerprints of their decoded forms.
#[test]
fn equal_hemispheres_have_the_same_successors() {
    let mut rng = Rng::named(3, "frames", 0);
    for model in [Model::Final, Model::Strict] {
        let rules = rules(model);
        for _ in 0..200 {
            let n = 2 + rng.below(3) as usize;
            let c = drawn(&mut rng, n, 10);
            let form = Detail::Frames.configuration(&key(Detail::Frames, &c));
            let successors = |c: &Configuration| {
                let mut keys = Vec::new();
                rules.expand(c, |_, to| keys.push(key(Detail::Frames, to)));
                keys.sort();
                keys
            };
            assert_eq!(successors(&c), successors(&form), "{c:?}");
        }
    }
}

/// Actions can be undone, and what undoes them leads back to the same configuration.
#[test]
fn every_action_can_be_undone() {
    let mut rng = Rng::named(4, "undo", 0);
    for model in [Model::Final, Model::Strict] {
        let rules = rules(model);
        for _ in 0..40 {
            let c = drawn(&mut rng, 4, 10);
            rules.expand(&c, |action, to| {
                let mut back = false;
                rules.expand(to, |_, again| back |= key(Detail::Joints, again) == key(Detail::Joints, &c));
                assert!(back, "{action:?} of {c:?}");
            });
        }
    }
}

#[test]
fn shapes_and_configurations_are_as_many_as_counted() {
    let expected: [&[u64]; 3] = [
        &[1, 1, 4, 1],
        &[1, 2, 16, 34, 49, 42, 42, 1],
        &[1, 3, 36, 162, 530, 1063, 2157, 3783, 2433, 499, 56, 3],
    ];
    for (n, expected) in (2..).zip(expected) {
        let start = shape(&format!("line:{n}")).unwrap();
        let mut levels = Levels::new(ShapeGraph { modules: n, prices: Prices::ONE }, &start, LIMITS);
        assert_eq!(levels.advance(u64::MAX), Counted::All);
        assert_eq!(levels.counts(), expected, "{n} modules");
    }
    let expected: [&[u64]; 3] = [
        &[1, 6, 34, 90, 167, 180, 130, 48, 10],
        &[1, 10, 78, 368, 1198, 2762, 4737, 6669],
        &[1, 12, 140, 924, 4438],
    ];
    for (n, expected) in (2..).zip(expected) {
        let space = Assembly::new(n, rules(Model::Final), Objective::Actions, &Goal::None, 0);
        let start = line(&vec![0; n - 1]).unwrap();
        let mut levels = Levels::new(space, &start, LIMITS);
        while levels.complete() <= expected.len() && levels.advance(100) == Counted::Running {}
        assert_eq!(levels.counts()[..expected.len()], *expected, "{n} modules");
    }
}

fn towards(to: &str, model: Model) -> Assembly {
    let goal = shape(to).unwrap();
    Assembly::new(goal.len(), rules(model), Objective::Actions, &Goal::Shape(goal), 30_000)
}

/// Solves, and checks the plan.
fn optimum(from: &Configuration, space: &Assembly) -> u32 {
    let model = space.rules().collision.model();
    let mut search = Search::new(space.clone(), from, LIMITS, Method::astar());
    let Step::Done(outcome) = search.advance(u64::MAX) else { panic!("a limit without a result") };
    let Outcome::Solved { path, lower } = outcome else { panic!("{outcome:?}") };
    assert_eq!(lower, path.cost);
    let plan = actions(search.space(), from, &path.keys).expect("the keys are a path");
    assert_eq!(plan.len() as u32, path.cost);
    let physics = Physics { collision: model, active: false, standing: None };
    let mut at = *from;
    let mut world = world(from);
    for action in plan {
        world = world.act(physical(action), physics).unwrap();
        at = search.space().rules().apply(&at, action).unwrap();
    }
    assert!(space.is_goal(&at));
    path.cost
}

/// All 64 lines of four modules, to the loop of 3 by 3: 39 in four actions, 24 in five, one in six.
#[test]
fn lines_of_four_become_loops_in_as_few_actions_as_known() {
    let mut lengths = [0; 8];
    let space = towards("loop:3x3", Model::Final);
    for types in 0..64_u8 {
        let digits = [types / 16, types / 4 % 4, types % 4];
        let cost = optimum(&line(&digits).unwrap(), &space);
        assert!(cost != 6 || digits == [0; 3]);
        lengths[cost as usize] += 1;
    }
    assert_eq!(lengths, [0, 0, 0, 0, 39, 24, 1, 0]);
    for model in [Model::Core, Model::Strict] {
        let space = towards("loop:3x3", model);
        assert_eq!(optimum(&line(&[0, 0, 0]).unwrap(), &space), 6);
        assert_eq!(optimum(&line(&[1, 2, 3]).unwrap(), &space), 4);
        assert_eq!(optimum(&line(&[0, 0]).unwrap(), &towards("loop:2x3", model)), 4);
    }
}

#[test]
fn larger_loops_take_six_actions() {
    for (n, to) in [(5, "loop:4x3"), (6, "loop:4x4"), (8, "loop:5x5")] {
        assert_eq!(optimum(&line(&vec![0; n - 1]).unwrap(), &towards(to, Model::Final)), 6, "{to}");
    }
}

/// Near a goal the bounds of both kinds are compared with true distances, found from the goal. Returns the first state
/// whose bound, raised by `error`, exceeds its distance.
fn exceeding(error: u32) -> Option<String> {
    let mut rng = Rng::named(6, "true distance", 0);
    for name in ["loop:2x3", "line:3", "ell:3", "loop:3x3", "line:4", "quadruped:4"] {
        let goal = shape(name).unwrap();
        let n = goal.len();
        let space = Assembly::new(n, rules(Model::Final), Objective::Actions, &Goal::Shape(goal), usize::MAX);
        for _ in 0..6 {
            let start = goal.filled(|_| {
                (rng.below(4) as u8, [rng.below(3) as u8, rng.below(4) as u8, rng.below(3) as u8])
            });
            // Actions can be undone, so a state at level k is at most k from the goal.
            let around = Assembly::new(n, rules(Model::Final), Objective::Actions, &Goal::None, 0).in_full();
            let limits = Limits { work: 1_500, ..LIMITS };
            let mut levels = Levels::new(around, &start, limits);
            levels.advance(u64::MAX);
            for id in 0..levels.table().len() as u32 {
                let state = levels.space().state(levels.table().key(id));
                let (far, lower) = (levels.table().cost(id), space.lower(&state).unwrap() + error);
                if lower > far && !space.is_goal(&state) {
                    return Some(format!("{name}: bound {lower} at distance {far}: {state:?}"));
                }
            }
        }
    }
    None
}

#[test]
fn no_bound_exceeds_the_true_distance() {
    assert_eq!(exceeding(0), None);
}

/// A bound that is too large by one is found.
#[test]
fn an_inadmissible_bound_is_found() {
    assert!(exceeding(1).is_some());
}

/// The distance of shapes never exceeds the true one, and falls by one at most.
#[test]
fn the_shape_distance_is_a_consistent_bound() {
    let mut rng = Rng::named(5, "bound", 0);
    let goal = shape("loop:3x3").unwrap();
    let space = Assembly::new(4, rules(Model::Final), Objective::Actions, &Goal::Shape(goal), usize::MAX)
        .by_shape_only();
    for _ in 0..300 {
        let c = drawn(&mut rng, 4, 15);
        let here = space.lower(&c).unwrap();
        space.expand(&c, &mut |action, cost, to| {
            let there = space.lower(to).unwrap();
            assert!(here <= there + cost, "{action:?} of {c:?}: {here} to {there}");
        });
        assert_eq!(here == 0, space.is_goal(&c));
    }
    assert!(!Links::of(2, []).is_connected());
}
