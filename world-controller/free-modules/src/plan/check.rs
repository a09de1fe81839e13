//! `metamorph plan --check`: carries out a plan on the checker's world, and names the first bad action.

use super::document::{PlanFile, What};
use super::error::PlanError;
use super::input::{Structured, of_document, read_plan};
use super::solve::{physics, world};
use metamorph_protocol::assembly::checker::{PhysicalAction, Robot, World};
use metamorph_protocol::assembly::configuration::{Configuration, MAX_MODULES, Module};
use metamorph_protocol::assembly::shape::Shape;
use metamorph_protocol::assembly::space::Objective;
use metamorph_protocol::assembly::tables::TABLES;
use metamorph_protocol::roombots::lattice_pose::LatticePose;
use metamorph_text::sources::Sources;
use std::path::Path;

/// Largest number of actions of a plan that is checked.
const ACTIONS_MAX: usize = 100_000;

/// Reads and checks a plan. Returns it if it is valid.
pub fn check_file(sources: &dyn Sources, path: &Path) -> Result<PlanFile, PlanError> {
    let plan = read_plan(sources, "--check", path)?;
    check(&format!("--check {}", path.display()), &plan)?;
    Ok(plan)
}

/// Checks a plan.
pub fn check(place: &str, plan: &PlanFile) -> Result<(), PlanError> {
    let start = match of_document(&format!("{place}, start"), &plan.start)? {
        Structured::Configuration(configuration) => configuration,
        Structured::Shape(_) => {
            let reason = "the start has no joint values".to_owned();
            return Err(PlanError::Format { place: format!("{place}, start"), reason, schema: "plan" });
        }
    };
    let goal = of_document(&format!("{place}, goal"), &plan.goal)?;
    let bad = |i: Option<usize>, reason: String| {
        let place = i.map_or_else(|| place.to_owned(), |i| format!("{place}, action {i}"));
        let fix = "plan again from the same start: `metamorph plan --from FILE`".to_owned();
        PlanError::Check { place, reason, fix }
    };
    if plan.actions.len() > ACTIONS_MAX {
        return Err(bad(None, format!("it has more than {ACTIONS_MAX} actions")));
    }
    let mut at = world(&start);
    at.check().map_err(|e| bad(None, format!("the start: {e}")))?;
    let physics = physics(plan, &at);
    if let Some(standing) = physics.standing {
        let held = standing.held.0;
        if held >= at.robots.len() {
            return Err(bad(None, format!("`ground` holds module {held}, which does not exist")));
        }
        standing.check(&at).map_err(|e| bad(None, format!("the start: {e}")))?;
    }
    let prices = plan.objective.prices();
    let mut cost = 0;
    for (i, step) in plan.actions.iter().enumerate() {
        if let Some(j) = step.after.iter().find(|j| **j >= i) {
            return Err(bad(Some(i), format!("its `after` names action {j}, which is not an earlier one")));
        }
        let fingerprint = format!("{:016x}", at.fingerprint());
        if step.from != fingerprint {
            return Err(bad(Some(i), format!("it begins in {fingerprint}, not in {}", step.from)));
        }
        let action =
            step.what.action().ok_or_else(|| bad(Some(i), "it is not a step of a joint".to_owned()))?;
        at = at.act(action, physics).map_err(|e| bad(Some(i), e.to_string()))?;
        let fingerprint = format!("{:016x}", at.fingerprint());
        if step.to != fingerprint {
            return Err(bad(Some(i), format!("it ends in {fingerprint}, not in {}", step.to)));
        }
        cost += match action {
            PhysicalAction::Attach(..) => prices.attach,
            PhysicalAction::Detach(..) => prices.detach,
            PhysicalAction::Turn(..) => prices.turn,
        };
    }
    if cost != plan.cost || plan.lower > cost {
        let reason = format!("its cost is {cost}; the file says {}, and at least {}", plan.cost, plan.lower);
        return Err(bad(None, reason));
    }
    if !reaches(&at, &goal) {
        return Err(bad(None, "it does not end in the goal".to_owned()));
    }
    Ok(())
}

/// Returns true if a world is a goal: their canonical forms are equal. This is all that the check has in common with
/// the planner.
fn reaches(at: &World, goal: &Structured) -> bool {
    let Some(found) = configuration(at) else { return false };
    match goal {
        Structured::Shape(shape) => Shape::of(&found).canonical() == shape.canonical(),
        Structured::Configuration(wanted) => {
            use metamorph_protocol::assembly::canonical::Detail;
            let key = |c: &Configuration| {
                let mut key = vec![0; Detail::Joints.key_width(c.len())];
                Detail::Joints.key(c, &mut key);
                key
            };
            wanted.len() == found.len() && key(wanted) == key(&found)
        }
    }
}

fn configuration(at: &World) -> Option<Configuration> {
    let t = &**TABLES;
    let module = |robot: &Robot| {
        let LatticePose { rotation, half } = robot.foot;
        let up = rotation.apply([0, 0, 1]);
        let cell = [0, 1, 2].map(|i| i8::try_from((half[i] + up[i]) / 2).ok());
        let [Some(x), Some(y), Some(z)] = cell else { return None };
        let rotation = t.rotations.iter().position(|r| *r == rotation)? as u8;
        Some(Module { cell: [x, y, z], rotation, posture: robot.posture.code() as u8, held: 0 })
    };
    let mut modules: Vec<Module> = at.robots.iter().map(module).collect::<Option<_>>()?;
    for (a, b) in &at.held {
        for (m, connector) in [a, b] {
            modules.get_mut(*m)?.held |= 1 << *connector as u16;
        }
    }
    (modules.len() <= MAX_MODULES).then(|| Configuration::new(&modules)).flatten()
}

/// Returns the action in words.
pub fn words(what: &What) -> String {
    match what {
        What::Attach([(a, c), (b, d)]) => format!("attach  {c} of module {a} to {d} of module {b}"),
        What::Detach([(a, c), (b, d)]) => format!("detach  {c} of module {a} from {d} of module {b}"),
        What::Turn(module, joint, degrees) => {
            format!("turn    joint {joint} of module {module} by {degrees:+}°")
        }
    }
}

/// Returns what an objective counts.
pub fn unit(objective: Objective) -> &'static str {
    match objective {
        Objective::Actions => "action",
        Objective::Connections => "attachment or detachment",
        Objective::Turns => "turn",
        Objective::Moves => "attachment",
    }
}
