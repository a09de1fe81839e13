//! The goal of a swarm as a structure of seats and elements, and the order in which its elements are brought: that of the
//! bundles that `metamorph plan` finds by taking the structure apart.

use metamorph_agents::metamodule::blueprint::Task;
use metamorph_agents::metamodule::elements::PassiveElement;
use metamorph_agents::metamodule::setup::Setup;
use metamorph_planning::manipulation::structure::assembly::bundles;
use metamorph_planning::manipulation::structure::{Grips, Part, Seat, Site, Structure};
use metamorph_planning::manipulation::terrain::Terrain;
use std::sync::Arc;

/// Returns the structure of a goal; `None` without elements, or with too many items.
pub fn structure(setup: &Setup, task: Task, grips: Grips) -> Option<Structure> {
    let site = Site {
        database: Arc::clone(setup.motions.database()),
        kind: setup.kind(),
        floor: Terrain::rectangle(setup.floor.min, setup.floor.max),
        limits: setup.elements.limits(),
    };
    let seats: Vec<Seat> = setup.seeds(task).map(|(_, seed)| seed.cells()).collect();
    let part = |element: &PassiveElement| Part {
        shape: element.shape.clone(),
        grams: element.grams,
        start: element.start.clone(),
        goal: element.goal(task.goal).to_vec(),
    };
    let parts = setup.elements.all().iter().map(part).collect();
    Structure::new(site, seats, parts, grips)
}

/// Returns the elements in the order of the bundles of a goal. Those that lie at their goals come first, since the structure
/// does not hold them; without bundles the order is that of the scenario.
pub fn element_order(setup: &Setup, task: Task) -> Vec<usize> {
    let all = setup.elements.all().len();
    let is_held = |e: &usize| !setup.elements.lies(*e, task.goal);
    let (held, lying): (Vec<usize>, Vec<usize>) = (0..all).partition(is_held);
    let by_bundles = || {
        // Of one element there is one order, and what lies is no part of a structure.
        let structure =
            (held.len() > 1 && lying.is_empty()).then(|| structure(setup, task, Grips::OfSeats))??;
        let pieces =
            bundles(&structure)?.into_iter().flat_map(|items| structure.pieces_in(items).collect::<Vec<_>>());
        Some(pieces.collect())
    };
    by_bundles().unwrap_or_else(|| lying.iter().chain(&held).copied().collect())
}
