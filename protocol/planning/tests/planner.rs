//! The planner against lengths of optimal plans that were computed by another program.
#![allow(clippy::unwrap_used, reason = "a panic fails the test")]

use metamorph_planning::assembly::action::{Action, Connectors, Rules};
use metamorph_planning::assembly::collision::Model;
use metamorph_planning::assembly::configuration::{Configuration, Module};
use metamorph_planning::assembly::named::{line, shape};
use metamorph_planning::assembly::shape::Shape;
use metamorph_planning::assembly::space::{Assembly, Goal, Objective};
use metamorph_planning::assembly::structure;
use metamorph_planning::assembly::tables::TABLES;
use metamorph_planning::plan::search::{Method, Search};
use metamorph_planning::plan::{Limits, Outcome, Progress, Step};
use metamorph_roombots::Kind;
use metamorph_roombots::connector::Connector;
use metamorph_roombots::lattice_pose::LatticeRotation;
use metamorph_roombots::posture::Posture;
use serde_json::Value;

fn vectors() -> Value {
    serde_json::from_str(include_str!("data/planner-test-vectors.json")).unwrap()
}

fn model(name: &str) -> Model {
    serde_json::from_value(name.into()).unwrap()
}

fn rules(model: Model) -> Rules {
    Rules::new(Connectors::All, model)
}

fn towards(goal: &Shape, model: Model) -> Assembly {
    Assembly::new(goal.len(), rules(model), Objective::Actions, &Goal::Shape(*goal), 30_000)
}

/// Returns the optimal number of actions, and the work.
fn optimum(from: &Configuration, space: &Assembly) -> (u32, Progress) {
    let limits = Limits { memory: 1 << 30, work: u64::MAX };
    let mut search = Search::new(space.clone(), from, limits, Method::astar());
    let Step::Done(Outcome::Solved { path, lower }) = search.advance(u64::MAX) else { panic!("no plan") };
    assert_eq!(path.cost, lower);
    (path.cost, search.progress())
}

fn digits(types: &str) -> Vec<u8> {
    types.bytes().map(|b| b - b'0').collect()
}

#[test]
fn lines_become_loops_in_the_known_number_of_actions() {
    for case in vectors()["optimal_actions"].as_array().unwrap() {
        let model_name = case["model"].as_str().unwrap();
        let space = towards(&shape(case["to"].as_str().unwrap()).unwrap(), model(model_name));
        for (types, length) in case["length_by_types"].as_object().unwrap() {
            let (cost, _) = optimum(&line(&digits(types)).unwrap(), &space);
            assert_eq!(u64::from(cost), length.as_u64().unwrap(), "{case}: {types}");
        }
    }
}

/// Applies a plan of the vectors to the line.
fn carry_out(case: &Value, model: Model) -> Shape {
    let rules = rules(model);
    let mut at = line(&digits(case["types"].as_str().unwrap())).unwrap();
    for action in case["actions"].as_array().unwrap() {
        let number = |i: usize| action[i].as_i64().unwrap();
        let connector =
            |i: usize| Connector::ALL.into_iter().find(|c| c.name() == action[i].as_str().unwrap()).unwrap();
        let wanted = |a: &Action| match (a, action[0].as_str().unwrap()) {
            (Action::Turn { module, joint, positive }, "turn") => {
                (i64::from(*module), i64::from(*joint) + 1, *positive)
                    == (number(1), number(2), number(3) > 0)
            }
            (Action::Attach(pair), "attach") => {
                pair.a == (number(1) as u8, connector(2) as u8)
                    && pair.b == (number(3) as u8, connector(4) as u8)
            }
            _ => false,
        };
        let mut next = None;
        rules.expand(&at, |a, to| {
            if wanted(&a) {
                next = Some(*to);
            }
        });
        at = next.unwrap_or_else(|| panic!("{action} is not possible"));
    }
    Shape::of(&at)
}

#[test]
fn known_plans_can_be_carried_out() {
    let vectors = vectors();
    let goal = shape("loop:3x3").unwrap().canonical();
    for (name, models) in [
        ("example_plan", &[Model::Final, Model::Core][..]),
        ("example_plan_strict", &[Model::Final, Model::Core, Model::Strict]),
    ] {
        for model in models {
            assert_eq!(carry_out(&vectors[name], *model).canonical(), goal, "{name}, {model:?}");
        }
    }
}

fn start(case: &Value) -> Configuration {
    let module = |m: &Value| {
        let rows: [[i8; 3]; 3] = serde_json::from_value(m["foot_rotation"].clone()).unwrap();
        let rotation = LatticeRotation::from_rows(rows).unwrap();
        let rotation = TABLES.rotations.iter().position(|r| *r == rotation).unwrap() as u8;
        let degrees: Vec<f64> = serde_json::from_value(m["joints_deg"].clone()).unwrap();
        let posture = Posture::from_degrees(Kind::Single, &degrees, 1e-9).unwrap().code() as u8;
        let names: Vec<String> = serde_json::from_value(m["held"].clone()).unwrap();
        let held = names.iter().map(|n| Connector::ALL.iter().position(|c| c.name() == n).unwrap());
        let cells: [[i8; 3]; 2] = serde_json::from_value(m["cells"].clone()).unwrap();
        let made = Module { cell: cells[0], rotation, posture, held: held.map(|c| 1 << c).sum() };
        assert_eq!(made.cells(), cells);
        made
    };
    let modules: Vec<Module> = case["start"].as_array().unwrap().iter().map(module).collect();
    Configuration::new(&modules).unwrap()
}

/// The hard cases, among them twelve actions that the distance of shapes puts at three.
#[test]
fn hard_cases_are_solved() {
    for case in vectors()["hard"].as_array().unwrap() {
        let space = towards(&shape(case["to"].as_str().unwrap()).unwrap(), Model::Final);
        let from = start(case);
        let (cost, progress) = optimum(&from, &space);
        assert_eq!(u64::from(cost), case["optimal_actions"].as_u64().unwrap(), "{case}");
        assert!(progress.kept <= 200_000, "{case}: {progress:?}");
        if let Some(distance) = case["shape_distance"].as_u64() {
            assert_eq!(space.distance().unwrap().of(&Shape::of(&from)), Some(distance as u32));
        }
    }
}

#[test]
fn named_shapes_are_those_of_the_vectors() {
    for (name, case) in vectors()["shapes"].as_object().unwrap() {
        let modules: Vec<[[i8; 3]; 2]> = serde_json::from_value(case["modules"].clone()).unwrap();
        let joined: Vec<[[i8; 3]; 2]> = serde_json::from_value(case["joined"].clone()).unwrap();
        let given = structure::joined(&modules, &joined).unwrap();
        assert_eq!(shape(name).unwrap().canonical(), given.canonical(), "{name}");
    }
}
