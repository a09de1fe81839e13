//! The number of connectors of a regular grid that a robot reaches, as counted in thesis table 2.2.
//!
//! The table gives one number per kind without saying how it was computed. Numbers above 28 can
//! only count states (connector and connection class): a head at most three cells away from the
//! foot sees 28 connectors. **No complete method gives the published numbers**: SRS and SRZ are
//! mirror images, and grid, floor and classes are mirror symmetric, so their counts must be equal,
//! while the table has 38 and 35. The counts here are therefore given per set of assumptions.

use super::body::bodies;
use super::chain::{Chain, Pose, random_angles};
use super::collision;
use super::grid::{GridState, landings};
use super::inverse::levenberg_marquardt;
use super::inverse::{Solution, solve};
use super::spheres;
use super::{HALF_EDGE, Kind};
use metamorph_core::rng::Rng;
use std::collections::BTreeSet;

/// The conditions under which a state counts as reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Assumptions {
    /// Lattice angles and all cubes above the floor. The states that the motion database reaches.
    Lattice,
    /// Any angles, no collision at all.
    AnyAngles,
    /// Any angles, no cube centre lower than that of a cube standing on the floor.
    AboveFloor,
    /// As above, and the exact bodies of the robot do not overlap. For planners with continuous angles.
    ExactBodies,
    /// As above with the spheres of thesis 5.1.4, this many per rib, instead of the exact bodies.
    Spheres(u32),
    /// As with exact bodies, but a middle cube that touches the floor collides.
    HighMiddle,
}

impl Assumptions {
    /// All sets, from the lattice on.
    pub const ALL: [Assumptions; 7] = [
        Assumptions::Lattice,
        Assumptions::AnyAngles,
        Assumptions::AboveFloor,
        Assumptions::ExactBodies,
        Assumptions::Spheres(5),
        Assumptions::Spheres(1),
        Assumptions::HighMiddle,
    ];

    /// Returns the text of a table row.
    pub fn describe(self) -> String {
        match self {
            Assumptions::Lattice => "lattice angles, cells above the floor".to_owned(),
            Assumptions::AnyAngles => "any angles, no collision".to_owned(),
            Assumptions::AboveFloor => "+ middle cubes not below floor height".to_owned(),
            Assumptions::ExactBodies => "+ exact self collision".to_owned(),
            Assumptions::Spheres(n) => format!("thesis spheres instead, {n} per rib"),
            Assumptions::HighMiddle => "exact, middle cube may not touch the floor".to_owned(),
        }
    }

    fn accepts(self, kind: Kind, solution: &Solution) -> bool {
        let Ok(bodies) = bodies(kind, &solution.q) else { return false };
        let middle = &bodies[1..bodies.len() - 1];
        let above = middle.iter().all(|b| b.centre.z > HALF_EDGE - SLACK);
        let exact = || !collision::self_collision(&bodies, RESTING_SHRINK);
        match self {
            Assumptions::Lattice | Assumptions::AnyAngles => true,
            Assumptions::AboveFloor => above,
            Assumptions::ExactBodies => above && exact(),
            Assumptions::Spheres(n) => {
                above && spheres::spheres(kind, &solution.q, n).is_ok_and(|s| !spheres::self_collision(&s))
            }
            Assumptions::HighMiddle => middle.iter().all(|b| b.centre.z > HALF_EDGE + SLACK) && exact(),
        }
    }
}

/// Difference of heights, in cells, below which they are equal: the plain search ends up to 0.1 mm off.
const SLACK: f64 = 1e-3;
/// Scale factor of the bodies of a posture at rest, which may touch itself but not overlap: they are shrunk by 0.26
/// mm only. With the 1 % allowed during a step, SRS and SRZ would have one state more, in which their rims overlap by
/// 0.9 mm.
const RESTING_SHRINK: f64 = 0.998;
/// The numbers of thesis table 2.2, in the order of [`Kind::ALL`].
pub const PUBLISHED: [u32; 5] = [2, 19, 38, 43, 35];

/// Iterates over the states of the grid that a head may reach by its distance.
pub fn candidate_states() -> impl Iterator<Item = GridState> {
    (-3i16..=3).flat_map(|x| {
        (-3i16..=3)
            .filter(move |y| (1..=9).contains(&(x * x + y * y)))
            .flat_map(move |y| (0..4).map(move |class| GridState::new(x, y, class)))
    })
}

/// Returns the states a kind reaches under a set of assumptions.
pub fn reachable(kind: Kind, assumptions: Assumptions) -> BTreeSet<GridState> {
    reachable_each(kind, &[assumptions]).pop().unwrap_or_default()
}

/// Returns the states reached under each of several sets of assumptions, solving every state once.
pub fn reachable_each(kind: Kind, sets: &[Assumptions]) -> Vec<BTreeSet<GridState>> {
    let mut found = vec![BTreeSet::new(); sets.len()];
    if sets.iter().any(|s| *s != Assumptions::Lattice) {
        for state in candidate_states() {
            let Ok(solutions) = solve(kind, &state.pose().into()) else { continue };
            for (set, states) in sets.iter().zip(&mut found) {
                if solutions.iter().any(|s| set.accepts(kind, s)) {
                    states.insert(state);
                }
            }
        }
    }
    for (set, states) in sets.iter().zip(&mut found) {
        if *set == Assumptions::Lattice {
            *states = landings(kind).into_keys().collect();
        }
    }
    found
}

/// Returns the number of connectors among states.
pub fn positions(states: &BTreeSet<GridState>) -> usize {
    states.iter().map(|s| (s.x, s.y)).collect::<BTreeSet<_>>().len()
}

/// Runs an incomplete search of the kind that the thesis may have used: plain damped least squares from `starts`
/// random starts per state; a state counts if an outcome is free of collisions with the thesis spheres.
///
/// With four starts each number of thesis table 2.2 is within the spread of such searches. The thesis gives neither
/// the number of starts nor the step rule, so this shows that the table is plausible, but not how it was made.
pub fn incomplete_search(kind: Kind, starts: u32, seed: u64) -> BTreeSet<GridState> {
    let chain = Chain::of(kind);
    let mut rng = Rng::named(seed, "incomplete search", kind as u64);
    let reached = |state: &GridState| {
        let target: Pose = state.pose().into();
        (0..starts).any(|_| {
            let start = random_angles(kind, &mut rng);
            let outcome = levenberg_marquardt::solve_plainly(&chain, &target, &start);
            let solution = Solution { q: outcome.q, residual: outcome.residual };
            outcome.reached && Assumptions::Spheres(5).accepts(kind, &solution)
        })
    };
    candidate_states().filter(reached).collect()
}
