//! Where metamodules stand at first: upright, attached by their feet, at random (thesis 4.1.3).

use super::blueprint::{Floor, Task};
use super::pose::Pose;
use super::setup::Setup;
use crate::metamodule::planning::paths::Ground;
use metamorph_core::lattice::Cell;
use metamorph_core::rng::Rng;
use metamorph_roombots::grid::GridState;
use metamorph_roombots::posture::Posture;
use thiserror::Error;

/// Why metamodules cannot be placed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum StartError {
    /// No draw placed all metamodules without shutting one of them in.
    #[error(
        "the floor has no room for {wanted} metamodules two cells apart and away from the goal (only {placed} found a place); make it larger"
    )]
    NoRoom {
        /// How many there should be.
        wanted: usize,
        /// How many found a place in the best draw; one less than `wanted` if all did and one was shut in.
        placed: usize,
    },
}

/// A start, and what it took to draw it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Start {
    /// Where the metamodules stand, by id.
    pub poses: Vec<Pose>,
    /// How many starts were drawn before it in which a metamodule was shut in.
    pub redrawn: u32,
}

/// Largest number of starts drawn until one is complete and has no metamodule that is shut in.
const TRIES: usize = 100;

/// Draws places for `count` metamodules in an area of the floor: any connector outside the rectangle around the
/// seeds' feet grown by one and not next to an element, at least two cells from each other along x or y, turned in
/// any of the four ways. None is shut in: each can get away from where it starts while the others stand where they
/// stand. (PAR has landings in front of it only: in a corner, turned to the wall, it has none at all, and two at one
/// wall can be each other's only way out forever.)
///
/// # Errors
/// If no such start was found.
pub fn draw_start(setup: &Setup, area: Floor, count: usize, seed: u64) -> Result<Start, StartError> {
    let mut rng = Rng::named(seed, "start", 0);
    let (mut most, mut redrawn) = (0, 0);
    for _ in 0..TRIES {
        let poses = draw(setup, area, count, &mut rng);
        most = most.max(poses.len());
        if poses.len() < count {
            continue;
        }
        if !any_shut_in(setup, &poses) {
            return Ok(Start { poses, redrawn });
        }
        redrawn += 1;
    }
    Err(StartError::NoRoom { wanted: count, placed: most.min(count.saturating_sub(1)) })
}

/// The poses of [`draw_start`] on the whole floor.
///
/// # Errors
/// If no such start was found.
pub fn random_start(setup: &Setup, count: usize, seed: u64) -> Result<Vec<Pose>, StartError> {
    draw_start(setup, setup.floor, count, seed).map(|start| start.poses)
}

fn draw(setup: &Setup, area: Floor, count: usize, rng: &mut Rng) -> Vec<Pose> {
    let feet = || setup.seeds(Task::default()).map(|(_, s)| s.foot);
    // Invariant: a blueprint has a seed; without one nothing would be kept free.
    let x = (feet().map(|f| f.0).min().unwrap_or(0) - 1, feet().map(|f| f.0).max().unwrap_or(0) + 1);
    let y = (feet().map(|f| f.1).min().unwrap_or(0) - 1, feet().map(|f| f.1).max().unwrap_or(0) + 1);
    let floor = setup.floor;
    let mut free: Vec<(i16, i16)> = (area.min.0..=area.max.0)
        .flat_map(|i| (area.min.1..=area.max.1).map(move |j| (i, j)))
        .filter(|(i, j)| floor.has(*i, *j))
        .filter(|(i, j)| !(x.0..=x.1).contains(i) || !(y.0..=y.1).contains(j))
        .filter(|(i, j)| !lying(setup).any(|c| c.x.abs_diff(*i).max(c.y.abs_diff(*j)) <= 1))
        .collect();
    // Invariant: the zero posture stands upright and is in every database.
    let posture = setup.motions.table().find(Posture::zero(setup.kind())).unwrap_or(0);
    let mut poses = Vec::with_capacity(count);
    while poses.len() < count && !free.is_empty() {
        let at = free[rng.below(free.len() as u64) as usize];
        free.retain(|f| f.0.abs_diff(at.0).max(f.1.abs_diff(at.1)) >= 2);
        let state = GridState::new(at.0, at.1, rng.below(4) as u8);
        poses.push(Pose::standing(state, posture));
    }
    poses
}

/// The cells of all elements at the start.
fn lying(setup: &Setup) -> impl Iterator<Item = Cell> + '_ {
    setup.elements.all().iter().flat_map(|element| element.start.iter().copied())
}

fn any_shut_in(setup: &Setup, poses: &[Pose]) -> bool {
    let motions = &setup.motions;
    poses.iter().enumerate().any(|(i, pose)| {
        let others = poses.iter().enumerate().filter(|(j, _)| *j != i);
        let taken: Vec<Cell> = others.flat_map(|(_, p)| motions.cells(*p)).chain(lying(setup)).collect();
        let ground = Ground { motions, floor: setup.floor, taken: &taken };
        ground.is_shut_in(*pose)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metamodule::blueprint::{Blueprint, SeedOrder, box_of_four};
    use crate::metamodule::elements::Elements;
    use crate::metamodule::motions::Motions;
    use crate::metamodule::params::{Params, Strategy};
    use metamorph_core::time::Span;
    use metamorph_roombots::Kind;
    use metamorph_roombots::database::Database;
    use std::sync::Arc;

    #[test]
    fn starts_are_apart_off_the_goal_and_repeatable() {
        let mut setup = Setup {
            params: Params::scaled(Strategy::Step, Span::secs(1), Span::millis(10)),
            floor: Floor { min: (0, 0), max: (12, 12) },
            goals: vec![Blueprint::new(&box_of_four(5, 5), SeedOrder::Circular).unwrap()],
            motions: Motions::new(Arc::new(Database::build()), Kind::Par).unwrap(),
            elements: Elements::NONE,
        };
        for seed in 0..100 {
            let poses = random_start(&setup, 6, seed).unwrap();
            assert_eq!(random_start(&setup, 6, seed).unwrap(), poses);
            for (i, p) in poses.iter().enumerate() {
                let (x, y) = p.foot();
                assert!(setup.floor.has(x, y) && !((4..=8).contains(&x) && (4..=8).contains(&y)));
                for q in &poses[..i] {
                    assert!(x.abs_diff(q.foot().0).max(y.abs_diff(q.foot().1)) >= 2);
                }
            }
        }
        assert_ne!(random_start(&setup, 6, 1), random_start(&setup, 6, 2));
        // Starts in which a metamodule is shut in are thrown away.
        let starts: Vec<Start> =
            (0..100).map(|seed| draw_start(&setup, setup.floor, 6, seed).unwrap()).collect();
        assert!(starts.iter().all(|start| !any_shut_in(&setup, &start.poses)));
        // They are in the area that they are to be in.
        let corner = Floor { min: (9, 0), max: (12, 8) };
        for seed in 0..20 {
            let start = draw_start(&setup, corner, 3, seed).unwrap();
            assert!(start.poses.iter().all(|p| corner.has(p.foot().0, p.foot().1)), "seed {seed}");
        }
        // A setup survives the serialization by which processes receive it.
        let text = serde_json::to_string(&setup).unwrap();
        let again: Setup = serde_json::from_str(&text).unwrap();
        assert_eq!(again.motions.table(), setup.motions.table());
        assert_eq!(again.goals, setup.goals);
        setup.floor.max = (5, 5);
        assert!(matches!(random_start(&setup, 20, 1), Err(StartError::NoRoom { wanted: 20, .. })));
    }
}
