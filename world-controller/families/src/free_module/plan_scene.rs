//! A plan as a scene of the page: one action a second, in the order of the plan, without agents.

use super::look::swing;
use crate::visible::Bodies;
use crate::visible::Visible;
use metamorph_free_modules::plan::check::{unit, words};
use metamorph_free_modules::plan::document::PlanFile;
use metamorph_free_modules::plan::error::PlanError;
use metamorph_free_modules::plan::input::{Structured, of_document};
use metamorph_free_modules::plan::solve::{physics, world};
use metamorph_protocol::assembly::checker::{PhysicalAction, Physics, Robot, World};
use metamorph_protocol::assembly::collision::Model;
use metamorph_protocol::free_module::reconfiguration::message::Swing;
use metamorph_protocol::free_module::reconfiguration::place::LatticePlace;
use metamorph_protocol::free_module::reconfiguration::{LatticeModule, LatticeSetup};
use metamorph_protocol::ids::ModuleId;
use metamorph_protocol::time::{Span, Time};
use metamorph_scene::beginning::{Heading, PLANNED};
use metamorph_scene::parts::Motion;
use metamorph_scene::scene::{Event, Scene};
use metamorph_scene::visible::ActionOutcome;
use metamorph_text::format::many;
use std::ops::Range;
use std::sync::Arc;

/// The time of one action on the page.
const ACTION_TIME: Span = Span::secs(1);
/// Number of half cubes of a module.
const HALVES: usize = 4;

/// Makes the scene of a plan and the bodies in it; `repeat` is the command that shows it again.
///
/// # Errors
/// Refuses a plan whose start has no joint values, and one with an action that is not possible.
pub fn plan_scene(plan: &PlanFile, repeat: String) -> Result<(Scene, Bodies<LatticeModule>), PlanError> {
    let Structured::Configuration(start) = of_document("start", &plan.start)? else {
        return Err(PlanError::option("start", "it has no joint values", "plan again"));
    };
    let mut at = world(&start);
    // The plan has been checked: what a turn touches on the way is not sampled again.
    let physics = Physics { collision: Model::Final, ..physics(plan, &at) };
    let setup = Arc::new(LatticeSetup::scaled(ACTION_TIME, Span::ZERO));
    let places = at.robots.iter().map(place).collect();
    let bodies = Bodies::<LatticeModule> { setup: Arc::clone(&setup), places, contacts: Vec::new() };
    let mut scene = Scene::new(heading(plan, repeat), &bodies, true);
    for (i, step) in (0..).zip(&plan.actions) {
        let refused = |reason: String| PlanError::option(&format!("action {i}"), reason, "plan again");
        let action = step.what.action().ok_or_else(|| refused("it is not a step of a joint".to_owned()))?;
        let next = at.act(action, physics).map_err(|error| refused(error.to_string()))?;
        let (begin, end) = (Time(ACTION_TIME.0 * i), Time(ACTION_TIME.0 * (i + 1)));
        scene.note(begin, Event::Injected(None, format!("action {i}"), words(&step.what)));
        let moved = motions(&setup, action, &at, &next);
        for (id, motion) in &moved {
            let to = LatticeModule::whereabouts(&place(&next.robots[id.index()]));
            scene.asked(begin, *id, Some((motion.clone(), to)));
        }
        for (n, (id, _)) in moved.iter().enumerate() {
            let outcome = if n == 0 { ActionOutcome::Done } else { ActionOutcome::Carried };
            scene.went(end, *id, outcome);
        }
        at = next;
    }
    scene.ended(&many(plan.cost.into(), unit(plan.objective)));
    scene.end(Vec::new());
    Ok((scene, bodies))
}

fn heading(plan: &PlanFile, repeat: String) -> Heading {
    let bound = match plan.lower == plan.cost {
        true => "no plan costs less".to_owned(),
        false => format!("every plan costs at least {}", plan.lower),
    };
    let modules = many(plan.start.modules.len() as u64, "module");
    Heading {
        title: format!("plan of {} for {modules}", many(plan.actions.len() as u64, "action")),
        description: Some(format!("planner {}; {bound}", plan.planner)),
        seed: None,
        link: PLANNED,
        repeat,
        goals: vec![("the goal".to_owned(), 0)],
        partitions: Vec::new(),
        changes: Vec::new(),
        hosts: None,
        commands: Vec::new(),
    }
}

fn place(robot: &Robot) -> LatticePlace {
    // Which connectors are closed is not drawn.
    LatticePlace::of_robot(robot, 0)
}

/// Returns the motions of all modules that an action moves, that of the module that acts first. A connection moves
/// nothing, but takes both modules.
fn motions(
    setup: &LatticeSetup,
    action: PhysicalAction,
    at: &World,
    next: &World,
) -> Vec<(ModuleId, Motion)> {
    let id = |module: usize| ModuleId(module as u32);
    let (module, joint, positive) = match action {
        PhysicalAction::Turn(module, joint, positive) => (module, joint, positive),
        PhysicalAction::Attach(a, b) => return connection(setup, "attaches", [a, b]),
        PhysicalAction::Detach(a, b) => return connection(setup, "detaches", [a, b]),
    };
    let mover = place(&at.robots[module]);
    // On the ground the side of the foot moves if the other one is held.
    let is_front = at.robots[module].foot != next.robots[module].foot;
    let (axis, pivot) = mover.axis(joint as u8);
    let step = if joint == 1 { 90 } else { 120 };
    let degrees = if positive == is_front { -step } else { step };
    let by = Swing { pivot, axis: axis.map(|a| a as i8), degrees };
    let own: Range<usize> = if is_front { 0..joint + 1 } else { joint + 1..HALVES };
    let turn = swing(setup, &mover, &by, own, format!("turns joint {}", joint + 1));
    let carried = (0..at.robots.len()).filter(|m| *m != module && at.robots[*m].foot != next.robots[*m].foot);
    let carry = |m: usize| {
        let name = "is carried".to_owned();
        (id(m), swing(setup, &place(&at.robots[m]), &by, 0..HALVES, name))
    };
    std::iter::once((id(module), turn)).chain(carried.map(carry)).collect()
}

fn connection(
    setup: &LatticeSetup,
    verb: &str,
    ends: [metamorph_protocol::assembly::checker::Place; 2],
) -> Vec<(ModuleId, Motion)> {
    let still = |(module, connector)| {
        let name = format!("{verb} {connector}");
        (ModuleId(module as u32), Motion { takes: setup.connect_time, name, segments: Vec::new() })
    };
    ends.map(still).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_free_modules::plan::input::structured;
    use metamorph_free_modules::plan::solve::{Planner, Problem};
    use metamorph_protocol::assembly::action::{Connectors, Rules};
    use metamorph_protocol::assembly::named;
    use metamorph_protocol::assembly::space::Objective;
    use metamorph_protocol::plan::Limits;
    use metamorph_scene::parts::Part;
    use metamorph_text::sources::NoFiles;

    fn plan(from: &str, to: &str) -> PlanFile {
        let Structured::Shape(shape) = structured(&NoFiles, "--from", from).unwrap() else {
            panic!("a name")
        };
        let problem = Problem {
            start: named::line(&vec![0; shape.len() - 1]).unwrap(),
            goal: structured(&NoFiles, "--to", to).unwrap(),
            rules: Rules::new(Connectors::All, Model::Core),
            ground: None,
            objective: Objective::Actions,
            planner: Planner::Astar,
            weight: 100,
            limits: Limits { memory: 64 << 20, work: 10_000 },
        };
        problem.solve(&mut |_| None).plan.expect("an easy problem")
    }

    fn seen(parts: &[Part]) -> Vec<nalgebra::Vector3<f64>> {
        parts.iter().flat_map(|p| [p.centre(), p.pose.rotation * nalgebra::Vector3::repeat(1.0)]).collect()
    }

    /// After each action the parts are where the checker has the modules, on whichever side of a joint something is held.
    #[test]
    fn parts_go_where_the_checker_takes_them() {
        let plan = plan("line:4", "loop:3x3");
        let Ok(Structured::Configuration(start)) = of_document("start", &plan.start) else { panic!("poses") };
        let setup = LatticeSetup::scaled(ACTION_TIME, Span::ZERO);
        for held in [(0, 0), (3, 3)] {
            let mut at = world(&start);
            let free = Physics { collision: Model::Final, ..physics(&plan, &at) };
            let standing =
                metamorph_protocol::assembly::standing::Standing { held, floor: None, gravity: false };
            let physics = Physics { standing: Some(standing), ..free };
            let mut parts: Vec<Vec<Part>> =
                at.robots.iter().map(|r| LatticeModule::at_rest(&setup, &place(r))).collect();
            for step in &plan.actions {
                let action = step.what.action().unwrap();
                let next = at.act(action, physics).unwrap();
                for (id, motion) in motions(&setup, action, &at, &next) {
                    motion.carry(&mut parts[id.index()], 1.0);
                }
                for (parts, robot) in parts.iter().zip(&next.robots) {
                    let rest = seen(&LatticeModule::at_rest(&setup, &place(robot)));
                    let far = seen(parts).iter().zip(&rest).map(|(a, b)| (a - b).norm()).fold(0.0, f64::max);
                    assert!(far < 1e-9, "{:?}, held {held:?}: {far}", step.what);
                }
                at = next;
            }
        }
    }

    /// Each action of a plan is one second, and an entry of the list of the page.
    #[test]
    fn a_plan_takes_one_second_an_action() {
        let plan = plan("line:3", "loop:2x3");
        let (scene, _) = plan_scene(&plan, "metamorph plan".to_owned()).unwrap();
        assert_eq!(scene.now(), Time(ACTION_TIME.0 * 4));
        let entries: Vec<&Time> = scene
            .events()
            .iter()
            .filter_map(|(at, e)| matches!(e, Event::Injected(..)).then_some(at))
            .collect();
        let begins: Vec<Time> = (0..4).map(|i| Time(ACTION_TIME.0 * i)).collect();
        assert_eq!(entries, begins.iter().collect::<Vec<_>>());
        let begun = |at: Time| scene.events().iter().any(|(t, e)| *t == at && matches!(e, Event::Does(..)));
        assert!(begins.iter().all(|at| begun(*at)));
    }
}
