//! The structure of a scenario with elements, planned: `metamorph plan SCENARIO`.

mod document;
mod text;

pub use document::{AssemblyDocument, AssemblyVerdict};
pub use text::text;

use super::Metamodules;
use document::document;
use metamorph_free_modules::plan::PlanError;
use metamorph_free_modules::plan::solve::Planner;
use metamorph_protocol::manipulation::structure::assembly::{
    StructureAnswer, plan_as_thesis, plan_structure,
};
use metamorph_protocol::manipulation::structure::isolation::{ThesisOrder, thesis_order};
use metamorph_protocol::manipulation::structure::{Grips, Structure};
use metamorph_protocol::manipulation::walking::Body;
use metamorph_protocol::metamodule::blueprint::Task;
use metamorph_protocol::metamodule::planning::bundles;
use metamorph_protocol::metamodule::planning::transport::foot;
use metamorph_protocol::plan::and_or::Items;
use metamorph_scenario::Plan;

/// Result of planning, from which the document and the text are made.
struct Planned<'a> {
    swarm: &'a Metamodules,
    structure: Structure,
    answer: StructureAnswer,
    /// The order of thesis B.5, if it was asked for.
    thesis: Option<ThesisOrder>,
}

/// Plans the structure of a scenario. Grips that no metamodule in a seed has are looked at if there is no plan without
/// them.
///
/// # Errors
/// If the scenario has no elements, or several goals, or the planner is for free modules.
pub fn assembly(plan: &Plan, planner: Planner) -> Result<AssemblyDocument, PlanError> {
    let Some(swarm) = plan.swarm.of::<Metamodules>().filter(|swarm| !swarm.setup.elements.is_empty()) else {
        let fix =
            "name a scenario of metamodules with [[swarm.element]], such as `table`, or use --from and --to";
        return Err(PlanError::option("SCENARIO", "the scenario has no elements", fix));
    };
    let is_thesis = match planner {
        Planner::Auto | Planner::Levels => false,
        Planner::Thesis => true,
        _ => {
            let fix = "use --planner levels or --planner thesis";
            return Err(PlanError::option("--planner", "this planner is for free modules", fix));
        }
    };
    let planned = |grips: Grips| {
        let (structure, bodies) = structure(swarm, grips)?;
        let answer = match is_thesis {
            true => plan_as_thesis(&structure, &bodies),
            false => plan_structure(&structure, &bodies),
        };
        let thesis = is_thesis.then(|| thesis_order(&structure));
        Some(Planned { swarm, structure, answer, thesis })
    };
    let first = planned(Grips::OfSeats);
    let settled =
        first.as_ref().is_some_and(|p| is_thesis || !matches!(p.answer, StructureAnswer::Undecided(_)));
    let found = if settled { first } else { planned(Grips::All) };
    let fix = format!("leave some out: a structure has at most {} of both", Items::MAX);
    found
        .map(|found| document(&found))
        .ok_or_else(|| PlanError::option("SCENARIO", "the scenario has too many seeds and elements", fix))
}

/// Returns the structure of a scenario, and where its metamodules stand at the start.
fn structure(swarm: &Metamodules, grips: Grips) -> Option<(Structure, Vec<Body>)> {
    let structure = bundles::structure(&swarm.setup, Task::default(), grips)?;
    let body = |pose: &metamorph_protocol::metamodule::pose::Pose| {
        Some(Body { foothold: structure.foothold(foot(*pose))?, posture: pose.posture })
    };
    let bodies = swarm.poses.iter().map(body).collect::<Option<Vec<Body>>>()?;
    Some((structure, bodies))
}
