//! The colour of cells, which no lattice motion changes.
//!
//! The colour of a cell is (x + y + z) mod 2. A joint turns by 120° about a body diagonal or by 90° about an axis
//! through the centre of a cell of the chain; both map the lattice to itself and keep the colour relative to that
//! centre, and gripping and letting go move nothing. So no number of metamodules brings an element into cells of the
//! other colour with lattice angles.

use super::element::{Element, Grip, cell_at, moved};
use metamorph_core::lattice::Cell;
use metamorph_core::rng::Rng;
use metamorph_roombots::Kind;
use metamorph_roombots::lattice_pose::{LatticePose, LatticeRotation};
use metamorph_roombots::posture::Posture;

/// Returns the colour of a cell, 0 or 1.
pub fn colour(cell: Cell) -> u8 {
    (cell.x + cell.y + cell.z).rem_euclid(2) as u8
}

/// Returns true if an element can never be brought from one set of cells to the other with lattice angles, because the
/// numbers of cells of each colour differ.
pub fn colours_differ(from: &[Cell], to: &[Cell]) -> bool {
    let black = |cells: &[Cell]| cells.iter().filter(|c| colour(**c) == 1).count();
    black(from) != black(to)
}

/// The number of actions of a random walk.
pub const ACTIONS: u32 = 16;

/// Random walks of metamodules of one kind that carry an element.
pub struct RandomWalks {
    kind: Kind,
    element: Element,
    grips: Vec<Grip>,
    rotations: Vec<LatticeRotation>,
}

impl RandomWalks {
    /// Creates the walks of a kind with an element.
    pub fn new(kind: Kind, element: Element) -> RandomWalks {
        let grips = element.grips();
        RandomWalks { kind, element, grips, rotations: LatticeRotation::all().collect() }
    }

    /// Counts the cells whose colour a random walk changes: metamodules with their feet anywhere turn joints at random
    /// and take the element from each other at random ports. Collisions do not matter to the theorem and are not
    /// tested.
    pub fn changes(&self, seed: u64) -> usize {
        let mut rng = Rng::named(seed, "colour", 0);
        let mut draw = |n: usize| rng.below(n as u64) as usize;
        let cells = self.element.cells();
        let colours =
            |pose| cells.iter().map(move |c| colour(cell_at(moved(pose, [2 * c.x, 2 * c.y, 2 * c.z]))));
        let mut pose = LatticePose { rotation: self.rotations[draw(self.rotations.len())], half: [0, 0, 1] };
        let before: Vec<u8> = colours(pose).collect();
        let mut changed = vec![false; before.len()];
        let mut holder: Option<(LatticePose, Posture, &Grip)> = None;
        for _ in 0..ACTIONS {
            let (foot, posture, grip) = match holder {
                Some(same) if draw(4) > 0 => same,
                _ => {
                    // Another metamodule takes the element: its foot follows from posture and grip.
                    let posture =
                        Posture::from_code(self.kind, draw(usize::from(Posture::count(self.kind))) as u16);
                    let grip = &self.grips[draw(self.grips.len())];
                    (pose.compose(posture.placement().head.compose(grip.offset).inverse()), posture, grip)
                }
            };
            let posture = posture.turned(draw(self.kind.joints()));
            holder = Some((foot, posture, grip));
            pose = foot.compose(posture.placement().head).compose(grip.offset);
            for ((colour, before), changed) in colours(pose).zip(&before).zip(&mut changed) {
                *changed |= colour != *before;
            }
        }
        changed.into_iter().filter(|c| *c).count()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use metamorph_roombots::grid::landings;

    #[test]
    fn random_walks_change_no_colour() {
        for name in ["cube", "L3", "plate3x3"] {
            for kind in Kind::METAMODULES {
                let walks = RandomWalks::new(kind, name.parse().unwrap());
                for seed in 0..300 {
                    assert_eq!(walks.changes(seed), 0, "{name} {kind} seed {seed}");
                }
            }
        }
    }

    #[test]
    fn colours_tell_what_cannot_be_reached() {
        let cube = |x, y, z| vec![Cell::new(x, y, z)];
        assert!(colours_differ(&cube(0, 0, 0), &cube(1, 0, 0)));
        assert!(!colours_differ(&cube(0, 0, 0), &cube(-1, 0, 3)));
        // Every landing puts the head on a connector of the other colour than that of the foot.
        for kind in Kind::METAMODULES {
            assert!(landings(kind).keys().all(|s| (s.x + s.y).rem_euclid(2) == 1), "{kind}");
        }
    }
}
