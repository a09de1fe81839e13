//! Worlds of the transport experiments of thesis 5.1.4, drawn from a seed.

use super::colour::colour;
use super::scene::Scene;
use super::terrain::{GridConnector, world_cell};
use super::transport::Task;
use super::walking::Body;
use metamorph_core::lattice::{Cell, Face};
use metamorph_core::ratio::Ratio;
use metamorph_core::rng::Rng;
use metamorph_roombots::posture::Posture;
use std::collections::BTreeSet;

/// The room in which goals are drawn, in cells.
const ROOM: [u64; 3] = [20, 13, 4];
/// The places along x where the cube lies at the start.
const START: std::ops::RangeInclusive<i16> = 3..=6;

/// A world: which connectors exist, where two metamodules stand upright, and where the cube goes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TransportWorld {
    connectors: BTreeSet<GridConnector>,
    bodies: Vec<Body>,
    start: Cell,
    goal: Cell,
}

impl TransportWorld {
    /// Draws a world in which a connector exists with this probability. The metamodules stand on the two existing
    /// connectors of the floor nearest to (0, 0) that are two or more cells apart, and the cube lies on the floor;
    /// its goal has the colour of its start.
    pub fn draw(scene: &Scene, probability: Ratio, seed: u64) -> TransportWorld {
        TransportWorld::drawn(scene, probability, seed, false)
    }

    /// Draws a world with all connectors in which the goal has the other colour than the start.
    pub fn draw_of_other_colour(scene: &Scene, seed: u64) -> TransportWorld {
        TransportWorld::drawn(scene, Ratio::ONE, seed, true)
    }

    fn drawn(scene: &Scene, probability: Ratio, seed: u64, is_other: bool) -> TransportWorld {
        let mut rng = Rng::named(seed, "transport", 0);
        let all = scene.terrain().connectors();
        let connectors: BTreeSet<GridConnector> =
            all.iter().filter(|_| rng.chance(probability)).copied().collect();
        let bodies = starts(scene, &connectors);
        let table = scene.table();
        let upright = table.find(Posture::zero(table.kind()));
        let posture = upright.expect("invariant: the upright posture is above the floor");
        let bodies: Vec<Body> = bodies.into_iter().map(|foothold| Body { foothold, posture }).collect();
        let taken: BTreeSet<Cell> = bodies.iter().flat_map(|b| scene.body(b.foothold, b.posture)).collect();
        let mut draw = |n: u64| rng.below(n) as i16;
        let connectors_of_floor = || connectors.iter().filter(|c| c.normal == Face::Up);
        let side =
            |axis: usize| connectors_of_floor().map(|c| c.half[axis] / 2 + 1).max().unwrap_or(1) as u64;
        let room = if is_other { [side(0), side(1), ROOM[2]] } else { ROOM };
        loop {
            let start = Cell::new(START.start() + draw(START.len() as u64), draw(room[1]), 0);
            let goal = Cell::new(draw(room[0]), draw(room[1]), draw(room[2]));
            if start != goal && (colour(start) != colour(goal)) == is_other && !taken.contains(&start) {
                return TransportWorld { connectors, bodies, start, goal };
            }
        }
    }

    /// Returns true if a connector exists.
    pub fn exists(&self, connector: &GridConnector) -> bool {
        self.connectors.contains(connector)
    }

    /// Returns the task, for a search with this weight in hundredths.
    pub fn task(&self, weight: u32) -> Task {
        Task::new(self.bodies.clone(), vec![self.start], vec![self.goal], weight)
    }
}

/// Returns the footholds of the two metamodules, or fewer where connectors are missing.
fn starts(scene: &Scene, connectors: &BTreeSet<GridConnector>) -> Vec<u16> {
    let mut near: Vec<(u32, u16, Cell)> = Vec::new();
    for (i, connector) in scene.terrain().connectors().iter().enumerate() {
        if connector.normal == Face::Up && connectors.contains(connector) {
            let foot = (0..4).map(|k| 4 * i + k).find(|f| scene.footholds()[*f].rotation.class() == Some(0));
            let foot =
                foot.expect("invariant: one of the four rotations of a floor connector has class 0") as u16;
            let cell = world_cell(scene.pose(foot), Cell::default());
            near.push((cell.manhattan(Cell::default()), foot, cell));
        }
    }
    near.sort_unstable();
    let Some(first) = near.first() else { return Vec::new() };
    let second = near.iter().find(|n| n.2.manhattan(first.2) >= 2);
    [Some(first), second].into_iter().flatten().map(|n| n.1).collect()
}
