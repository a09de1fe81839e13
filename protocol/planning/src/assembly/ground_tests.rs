//! Structures on the ground, against the checker.

use super::action::Rules;
use super::canonical::Detail;
use super::checker::{Physics, Refusal};
use super::collision::Model;
use super::configuration::Configuration;
use super::ground::{Fall, Ground, held_at, rotated};
use super::named::{line, shape};
use super::space::{Assembly, Goal, Objective};
use super::standing::Standing;
use super::tables::TABLES;
use super::tests::{LIMITS, all_physical_actions, drawn, physical, rules, world};
use crate::plan::search::{Method, Search};
use crate::plan::{Outcome, Step, actions};
use metamorph_core::rng::Rng;
use std::collections::BTreeSet;

/// Returns the rotation that takes +x, along which lines lie, to +z.
fn upright() -> u8 {
    TABLES.rotations.iter().position(|r| r.apply([1, 0, 0]) == [0, 0, 1]).unwrap() as u8
}

fn physics(model: Model, ground: Ground, held: (usize, bool)) -> Physics {
    let standing = Standing {
        held: (held.0, if held.1 { 3 } else { 0 }),
        floor: ground.floor.map(|z| 2 * i16::from(z) - 1),
        gravity: ground.gravity,
    };
    Physics { collision: model, active: false, standing: Some(standing) }
}

/// Draws a structure that stands: how it is held, and on what.
fn standing(rng: &mut Rng) -> (Configuration, Ground, (usize, bool)) {
    loop {
        let n = 2 + rng.below(3) as usize;
        let at = drawn(rng, n, 12);
        let held = (rng.below(n as u64) as usize, rng.below(2) == 1);
        let at = rotated(&held_at(&at, held.0, held.1).unwrap(), rng.below(24) as u8);
        let lowest = at.modules().iter().flat_map(|m| m.cells()).map(|c| c[2]).min().unwrap();
        let (floor, gravity) = [(true, false), (false, true), (true, true)][rng.below(3) as usize];
        let ground = Ground { floor: floor.then_some(lowest), gravity };
        if ground.check(&at).is_ok() {
            return (at, ground, held);
        }
    }
}

/// Exactly the actions that the planner generates are possible for the checker, and leave every module where it says.
#[test]
fn the_checker_permits_what_the_planner_generates_on_the_ground_and_nothing_else() {
    let mut rng = Rng::named(1, "ground", 0);
    let mut refused = BTreeSet::new();
    for model in [Model::Final, Model::Core, Model::Strict] {
        for round in 0..if model == Model::Final { 60 } else { 12 } {
            let (at, ground, held) = standing(&mut rng);
            let place = format!("{model:?}, round {round}: {ground:?}, {held:?} of {at:?}");
            let (before, physics) = (world(&at), physics(model, ground, held));
            let mut found = Vec::new();
            rules(model).on(ground).expand(&at, |action, to| {
                let after = before.act(physical(action), physics);
                let after = after.unwrap_or_else(|e| panic!("{place}: {action:?}: {e}"));
                assert_eq!(after, world(to), "{place}: {action:?}");
                found.push(physical(action));
            });
            for action in all_physical_actions(&at) {
                let refusal = before.act(action, physics).err();
                assert_eq!(refusal.is_none(), found.contains(&action), "{place}: {action:?}, {refusal:?}");
                refused.extend(match refusal {
                    Some(Refusal::BelowFloor(_)) => Some("below the floor"),
                    Some(Refusal::IntoFloor(_)) => Some("into the floor"),
                    Some(Refusal::Overloaded { .. }) => Some("overloaded"),
                    _ => None,
                });
            }
        }
    }
    assert_eq!(refused.len(), 3, "{refused:?}");
}

/// A key keeps the place of every module, and not their numbers or ends.
#[test]
fn keys_on_the_ground_keep_the_place() {
    let mut rng = Rng::named(2, "ground", 0);
    let key = |c: &Configuration| {
        let mut key = vec![0; Detail::Place.key_width(c.len())];
        Detail::Place.key(c, &mut key);
        key
    };
    for _ in 0..200 {
        let (at, ..) = standing(&mut rng);
        let form = Detail::Place.configuration(&key(&at));
        assert_eq!(key(&form), key(&at));
        let cells =
            |c: &Configuration| -> BTreeSet<_> { c.modules().iter().flat_map(|m| m.cells()).collect() };
        assert_eq!(cells(&form), cells(&at));
        let mut other: Vec<_> = at.modules().iter().map(|m| m.reversed()).collect();
        other.reverse();
        assert_eq!(key(&Configuration::new(&other).unwrap()), key(&at));
        assert_ne!(key(&rotated(&at, 1 + rng.below(23) as u8)), key(&at));
    }
}

fn cost(from: &Configuration, to: &str, rules: Rules, physics: Physics) -> Option<u32> {
    let goal = Goal::Shape(shape(to).unwrap());
    let space = Assembly::new(from.len(), rules, Objective::Actions, &goal, 30_000);
    let mut search = Search::new(space, from, LIMITS, Method::astar());
    let Step::Done(outcome) = search.advance(u64::MAX) else { panic!("a limit without a result") };
    let Outcome::Solved { path, .. } = outcome else {
        assert!(matches!(outcome, Outcome::Impossible { .. }), "{outcome:?}");
        return None;
    };
    let plan = actions(search.space(), from, &path.keys).expect("the keys are a path");
    let mut at = world(from);
    for action in plan {
        at = at.act(physical(action), physics).unwrap();
    }
    Some(path.cost)
}

/// A tower bends nearly as freely as in the air; what a line on the floor can do, held at one end, depends on how deep its
/// cubes may press into the floor.
#[test]
fn plans_on_the_ground_cost_as_much_or_more() {
    // The fewest actions in the air, of a tower, and of a line on the floor.
    let known = [
        (3, "ell:3", Model::Core, 1, [Some(1), Some(1)]),
        (3, "ell:3", Model::Strict, 1, [Some(1), None]),
        (3, "loop:2x3", Model::Core, 4, [Some(4), Some(4)]),
        (3, "loop:2x3", Model::Strict, 4, [Some(4), None]),
        (4, "loop:3x3", Model::Core, 6, [Some(8), Some(9)]),
        (4, "loop:3x3", Model::Strict, 6, [Some(8), None]),
        (4, "zigzag:4", Model::Core, 3, [Some(3), Some(10)]),
    ];
    for (n, to, model, in_the_air, on_the_ground) in known {
        let lying = line(&vec![0; n - 1]).unwrap();
        let ground = Ground { floor: Some(0), gravity: true };
        let on_ground = physics(model, ground, (0, false));
        let free = Physics { standing: None, ..on_ground };
        assert_eq!(cost(&lying, to, rules(model), free), Some(in_the_air), "{to}, {model:?}");
        let costs = [rotated(&lying, upright()), lying]
            .map(|from| cost(&from, to, rules(model).on(ground), on_ground));
        assert_eq!(costs, on_the_ground, "{to}, {model:?}");
    }
}

/// The torque at the foot of a module that reaches out sideways is that of its masses.
#[test]
fn a_line_that_reaches_too_far_is_overloaded() {
    let ground = Ground { floor: None, gravity: true };
    let reach = |n: usize| ground.check(&line(&vec![0; n - 1]).unwrap());
    assert_eq!(reach(1), Ok(()));
    let Err(Fall::Overloaded { module: 0, joint, torque, .. }) = reach(4) else { panic!("{:?}", reach(4)) };
    // Cubes of 0.7 kg at 1 to 7 cells of 0.11 m, about a diagonal or the line itself.
    let all = 0.7 * 9.81 * 0.11 * 28.0;
    assert_eq!(joint, 0);
    assert!((torque - all / 3.0_f64.sqrt()).abs() < 1e-9, "{torque} of {all}");
    assert_eq!(ground.check(&rotated(&line(&[0; 3]).unwrap(), upright())), Ok(()));
}
