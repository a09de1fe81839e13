//! A metamodule at any joint angles, with the cube that it holds or that lies beside it: what it touches, and its torques.

use crate::manipulation::contact::{Block, CORNER_RADIUS};
use crate::manipulation::element::centre_of;
use crate::manipulation::load::{LoadLimits, Peak};
use metamorph_core::lattice::Cell;
use metamorph_roombots::chain::{Chain, Pose};
use metamorph_roombots::collision::{SHRINK, self_collision};
use metamorph_roombots::convex::{Cuboid, overlap};
use metamorph_roombots::inverse::solve;
use metamorph_roombots::lattice_pose::LatticeRotation;
use metamorph_roombots::torque::{Load, torques};
use metamorph_roombots::{HALF_EDGE, Kind, OUTER_RADIUS, body::bodies};
use nalgebra::{Matrix3, Vector3};

/// Depth into the floor that does not count, in cells: 0.3 mm.
const FLOOR_TOLERANCE: f64 = 0.3 / 110.0;

/// Where the cube is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Cube {
    /// The head holds it.
    Held,
    /// It lies in this cell, seen from the foot.
    At(Cell),
}

/// A metamodule that stands on an open floor, and a cube.
#[derive(Clone, Debug)]
pub struct Arm {
    kind: Kind,
    chain: Chain,
    cube: Cube,
    /// Mass of the cube in kilograms.
    mass: f64,
    limits: LoadLimits,
    /// Cells that nothing may enter, seen from the foot.
    obstacles: Vec<Cell>,
}

/// Returns the middle of a cell in the frame of a foot.
fn middle(cell: Cell) -> Vector3<f64> {
    Vector3::from(centre_of(cell).map(|x| f64::from(x) / 2.0))
}

impl Arm {
    /// Creates a metamodule with a cube of so many grams.
    pub fn new(kind: Kind, cube: Cube, grams: u32, limits: LoadLimits) -> Arm {
        let (chain, mass) = (Chain::of(kind), f64::from(grams) / 1000.0);
        Arm { kind, chain, cube, mass, limits, obstacles: Vec::new() }
    }
    /// Returns the same among obstacles, seen from the foot.
    pub fn among(mut self, obstacles: Vec<Cell>) -> Arm {
        self.obstacles = obstacles;
        self
    }
    /// Returns the kind.
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// Returns the angles that hold the cube in a cell with the head turned like this.
    pub fn holding(&self, cell: Cell, rotation: LatticeRotation) -> Vec<Vec<f64>> {
        let rotation = rotation.matrix();
        let origin = middle(cell) + rotation * Vector3::new(0.0, 0.0, HALF_EDGE);
        let solutions = solve(self.kind, &Pose { rotation, origin }).unwrap_or_default();
        solutions.into_iter().map(|solution| solution.q).collect()
    }

    fn cube(&self, q: &[f64]) -> Block {
        match self.cube {
            Cube::At(cell) => Block { centre: middle(cell), rotation: Matrix3::identity(), half: HALF_EDGE },
            Cube::Held => {
                let head = self.chain.head(q);
                let centre = head.point(&Vector3::new(0.0, 0.0, -HALF_EDGE));
                Block { centre, rotation: head.rotation, half: HALF_EDGE }
            }
        }
    }

    /// Returns true if the metamodule touches neither itself nor the floor, the cube or an obstacle, the cube none of these
    /// either, and no joint is over its limit of torque.
    pub fn is_free(&self, q: &[f64]) -> bool {
        let Ok(bodies) = bodies(self.kind, q) else { return false };
        let cube = self.cube(q);
        let is_held = self.cube == Cube::Held;
        let in_floor = |lowest: f64| lowest < -FLOOR_TOLERANCE;
        if bodies.iter().any(|b| in_floor(b.lowest())) || self_collision(&bodies, SHRINK) {
            return false;
        }
        if is_held && in_floor(-cube.reach(&-Vector3::z())) {
            return false;
        }
        let block = Block { half: HALF_EDGE * SHRINK, ..cube };
        let meets = bodies.iter().any(|body| {
            (block.centre - body.centre).norm() < (CORNER_RADIUS + OUTER_RADIUS) * SHRINK
                && overlap(&block, &body.scaled(SHRINK))
        });
        let is_clear = |cell: &Cell| {
            let cuboid = Cuboid { centre: middle(*cell), half: HALF_EDGE * SHRINK };
            let near =
                |centre: &Vector3<f64>, radius: f64| (centre - cuboid.centre).norm() < CORNER_RADIUS + radius;
            let body =
                bodies.iter().any(|b| near(&b.centre, OUTER_RADIUS) && overlap(&b.scaled(SHRINK), &cuboid));
            let cube = is_held && near(&block.centre, CORNER_RADIUS) && overlap(&block, &cuboid);
            !body && !cube
        };
        !meets && self.obstacles.iter().all(is_clear) && self.holds(q)
    }

    fn holds(&self, q: &[f64]) -> bool {
        let payload = if self.cube == Cube::Held { self.mass } else { 0.0 };
        let payload_at = Vector3::new(0.0, 0.0, -HALF_EDGE);
        let load = Load { payload, payload_at, ..Load::floor() };
        torques(self.kind, q, &load).is_ok_and(|all| Peak::of(&all).within(self.limits))
    }
}
