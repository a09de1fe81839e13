//! The terrain of the transport experiments: planes of connectors, and what lies behind them.

use super::element::moved;
use metamorph_core::lattice::{Cell, Face};
use metamorph_roombots::lattice_pose::{Half, LatticePose, LatticeRotation};
use std::ops::RangeInclusive;

/// A connector of a plane: the middle of its plate in half cells, and the normal of the plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct GridConnector {
    /// The middle of the plate.
    pub half: Half,
    /// The normal, away from the plane.
    pub normal: Face,
}

/// Planes of connectors around a room. Cells behind a plane are blocked, as far as the plane is continued.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Terrain {
    connectors: Vec<GridConnector>,
    /// The cells of the room along x and z.
    room: [RangeInclusive<i16>; 2],
}

impl Terrain {
    /// Creates a floor with corner (0, 0).
    pub fn floor(size: (i16, i16)) -> Terrain {
        Terrain::rectangle((0, 0), (size.0 - 1, size.1 - 1))
    }

    /// Creates a floor with these corners, both included.
    pub fn rectangle(min: (i16, i16), max: (i16, i16)) -> Terrain {
        let connectors = (min.0..=max.0).flat_map(|x| (min.1..=max.1).map(move |y| [2 * x, 2 * y, 0]));
        let connectors = connectors.map(|half| GridConnector { half, normal: Face::Up }).collect();
        Terrain { connectors, room: [i16::MIN..=i16::MAX, 0..=i16::MAX] }
    }

    /// Creates the terrain of thesis 5.1.4 with 458 connectors: a floor of 20 × 13, and two walls of 11 × 9 at right
    /// angles to it, whose distance is 20 cells. The thesis gives the number of connectors only.
    pub fn experiment() -> Terrain {
        let mut terrain = Terrain::floor((20, 13));
        for (x, normal) in [(-1, Face::East), (39, Face::West)] {
            let places = (1..12).flat_map(|y| (0..9).map(move |z| [x, 2 * y, 2 * z + 1]));
            terrain.connectors.extend(places.map(|half| GridConnector { half, normal }));
        }
        terrain.room[0] = 0..=19;
        terrain
    }

    /// Returns the connectors.
    pub fn connectors(&self) -> &[GridConnector] {
        &self.connectors
    }
    /// Returns true for cells behind a plane.
    pub fn is_blocked(&self, cell: Cell) -> bool {
        !self.room[0].contains(&cell.x) || !self.room[1].contains(&cell.z)
    }

    /// Returns the poses of a foot: four for each connector, in their order.
    pub fn footholds(&self) -> Vec<LatticePose> {
        let poses = self.connectors.iter().flat_map(|c| {
            let upright = LatticeRotation::all().filter(|r| r.up() == c.normal);
            upright.map(|rotation| LatticePose { rotation, half: c.half })
        });
        poses.collect()
    }
}

/// Returns the direction of gravity in the frame of a foot.
pub fn gravity(foot: LatticePose) -> Face {
    foot.rotation.inverse().face(Face::Down)
}

/// Returns the cell outside of a frame that is `cell` in it.
pub fn world_cell(foot: LatticePose, cell: Cell) -> Cell {
    super::element::cell_at(moved(foot, super::element::centre_of(cell)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_experiment_has_458_connectors() {
        let terrain = Terrain::experiment();
        assert_eq!(terrain.connectors().len(), 458);
        assert_eq!(terrain.footholds().len(), 4 * 458);
        for foot in terrain.footholds() {
            // The foot cube is in the room, the cell behind the connector is not.
            assert!(!terrain.is_blocked(world_cell(foot, Cell::default())), "{foot:?}");
            assert!(terrain.is_blocked(world_cell(foot, Cell::new(0, 0, -1))), "{foot:?}");
        }
        let wall = terrain.footholds()[4 * 300];
        assert_ne!(gravity(wall), Face::Down);
        assert_eq!(gravity(terrain.footholds()[0]), Face::Down);
    }
}
