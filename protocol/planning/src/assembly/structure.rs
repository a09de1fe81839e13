//! Shapes and configurations from lists of cells and joins, with every inconsistency named.

use super::configuration::{Configuration, Links, MAX_MODULES, Module, Pair};
use super::shape::{Bar, Shape};
use super::tables::{NONE, ROTATIONS, TABLES, Vec3, face_to, sub};
use metamorph_roombots::lattice_pose::LatticeRotation;
use thiserror::Error;

/// A joined face: the cells on both sides.
pub type Joined = [Vec3; 2];

/// Why a list is not a structure.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum StructureError {
    /// There is nothing.
    #[error("the structure has no modules")]
    Empty,
    /// There are too many modules.
    #[error("{0} modules, but a plan of free modules has at most {MAX_MODULES}")]
    TooMany(usize),
    /// The two cells of a module are not neighbours.
    #[error("module {module}: its cells {a:?} and {b:?} are not neighbours")]
    NotAdjacent {
        /// The module.
        module: usize,
        /// Its cells.
        a: Vec3,
        /// The other one.
        b: Vec3,
    },
    /// Two modules fill one cell.
    #[error("modules {first} and {second} both fill the cell {cell:?}")]
    Overlap {
        /// A module.
        first: usize,
        /// Another one.
        second: usize,
        /// The cell.
        cell: Vec3,
    },
    /// A joined face has no module at one side.
    #[error("joined face {join}: no module fills the cell {cell:?}")]
    NoModule {
        /// The number of the joined face.
        join: usize,
        /// The cell.
        cell: Vec3,
    },
    /// Two joined cells do not touch.
    #[error("joined face {join}: the cells {a:?} and {b:?} do not touch")]
    NotTouching {
        /// The number of the joined face.
        join: usize,
        /// A cell.
        a: Vec3,
        /// The other one.
        b: Vec3,
    },
    /// Both cells belong to one module.
    #[error("joined face {join}: both cells belong to module {module}")]
    SameModule {
        /// The number of the joined face.
        join: usize,
        /// The module.
        module: usize,
    },
    /// A module is not connected with module 0.
    #[error("module {module} is not connected with module 0")]
    Disconnected {
        /// The module.
        module: usize,
    },
    /// A matrix is not a rotation.
    #[error("module {module}: the foot rotation is not a rotation of the lattice")]
    NotARotation {
        /// The module.
        module: usize,
    },
    /// Pose and joint values do not lead to the second cell.
    #[error("module {module}: with this foot rotation and these joint values the second cell is {found:?}")]
    OtherCell {
        /// The module.
        module: usize,
        /// The cell to which they lead.
        found: Vec3,
    },
}

/// The pose of a module in a list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Placed {
    /// Both cells, that at the foot first.
    pub cells: [Vec3; 2],
    /// The rows of the rotation of the foot frame.
    pub rotation: [[i8; 3]; 3],
    /// The joint values in steps.
    pub steps: [u8; 3],
}

/// Returns the shape of modules given by their cells, joined at these faces.
pub fn joined(modules: &[[Vec3; 2]], joins: &[Joined]) -> Result<Shape, StructureError> {
    let faces = checked(modules, joins)?;
    let bars: Vec<Bar> = modules
        .iter()
        .zip(faces)
        .map(|(cells, joined)| Bar {
            cell: cells[0],
            direction: face_to(cells[0], cells[1]).expect("invariant: checked above"),
            joined,
        })
        .collect();
    Shape::new(&bars).ok_or(StructureError::TooMany(modules.len()))
}

/// Returns the configuration of modules given by their poses, connected at these faces.
pub fn configured(modules: &[Placed], joins: &[Joined]) -> Result<Configuration, StructureError> {
    let t = &**TABLES;
    let cells: Vec<_> = modules.iter().map(|m| m.cells).collect();
    let faces = checked(&cells, joins)?;
    let mut all = Vec::with_capacity(modules.len());
    for (i, (placed, joined)) in modules.iter().zip(faces).enumerate() {
        let rotation = LatticeRotation::from_rows(placed.rotation)
            .and_then(|r| (0..ROTATIONS).find(|n| t.rotations[*n] == r))
            .ok_or(StructureError::NotARotation { module: i })? as u8;
        let [first, middle, last] = placed.steps;
        let posture = (first % 3) * 12 + (middle % 4) * 3 + last % 3;
        let mut m = Module { cell: placed.cells[0], rotation, posture, held: 0 };
        let found = m.cells()[1];
        if found != placed.cells[1] {
            return Err(StructureError::OtherCell { module: i, found });
        }
        for (cube, set) in joined.into_iter().enumerate() {
            for face in (0..6).filter(|f| set & 1 << f != 0) {
                let connector = m.connector_at(cube, face);
                debug_assert_ne!(connector, NONE, "faces between the cubes are refused above");
                m.held |= 1 << connector;
            }
        }
        all.push(m);
    }
    Configuration::new(&all).ok_or(StructureError::TooMany(modules.len()))
}

/// Checks a structure, and returns for every module the joined faces of both cubes.
fn checked(modules: &[[Vec3; 2]], joins: &[Joined]) -> Result<Vec<[u8; 2]>, StructureError> {
    let n = modules.len();
    if n == 0 {
        return Err(StructureError::Empty);
    }
    if n > MAX_MODULES {
        return Err(StructureError::TooMany(n));
    }
    for (module, [a, b]) in modules.iter().enumerate() {
        if face_to(*a, *b).is_none() {
            return Err(StructureError::NotAdjacent { module, a: *a, b: *b });
        }
        let before = modules[..module].iter().enumerate();
        for (first, cells) in before {
            if let Some(cell) = cells.iter().find(|c| **c == *a || **c == *b) {
                return Err(StructureError::Overlap { first, second: module, cell: *cell });
            }
        }
    }
    let mut faces = vec![[0_u8; 2]; n];
    let mut pairs = Vec::new();
    for (join, [a, b]) in joins.iter().enumerate() {
        let place = |cell: Vec3| {
            let found = modules
                .iter()
                .enumerate()
                .find_map(|(m, cells)| cells.iter().position(|c| *c == cell).map(|cube| (m, cube)));
            found.ok_or(StructureError::NoModule { join, cell })
        };
        let (from, to) = (place(*a)?, place(*b)?);
        let face = face_to(*a, *b).ok_or(StructureError::NotTouching { join, a: *a, b: *b })?;
        if from.0 == to.0 {
            return Err(StructureError::SameModule { join, module: from.0 });
        }
        faces[from.0][from.1] |= 1 << face;
        faces[to.0][to.1] |= 1 << (face ^ 1);
        pairs.push(Pair { a: (from.0 as u8, 0), b: (to.0 as u8, 0) });
    }
    let links = Links::of(n, pairs);
    let lost = links.all() & !links.reach(1, 0);
    if lost != 0 {
        return Err(StructureError::Disconnected { module: lost.trailing_zeros() as usize });
    }
    Ok(faces)
}

/// Returns the cells relative to the first one, so that they fit into small numbers; `None` if they are farther
/// apart than those of any connected structure.
pub fn around_first(cells: &[[i64; 3]]) -> Option<Vec<Vec3>> {
    let first = *cells.first()?;
    let near = |c: &[i64; 3]| {
        let mut v = [0; 3];
        for i in 0..3 {
            let d = c[i].checked_sub(first[i])?;
            v[i] = i8::try_from(d).ok().filter(|d| d.unsigned_abs() <= 2 * MAX_MODULES as u8)?;
        }
        Some(v)
    };
    cells.iter().map(near).collect()
}

/// Returns the joined faces of a shape, as cells.
pub fn joined_cells(shape: &Shape) -> Vec<Joined> {
    let cell = |(m, cube): (u8, u8)| shape.bars()[usize::from(m)].cells()[usize::from(cube)];
    shape.joins().into_iter().map(|j| [cell(j.a), cell(j.b)]).collect()
}

/// Returns the poses of a configuration with module 0 at the origin.
pub fn placed(configuration: &Configuration) -> Vec<Placed> {
    let t = &**TABLES;
    let origin = configuration.modules()[0].cell;
    let one = |m: &Module| Placed {
        cells: m.cells().map(|c| sub(c, origin)),
        rotation: t.rotations[usize::from(m.rotation)].rows(),
        steps: [m.posture / 12, m.posture / 3 % 4, m.posture % 3],
    };
    configuration.modules().iter().map(one).collect()
}
