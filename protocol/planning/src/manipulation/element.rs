//! Elements: rigid sets of cells with ports, and the grips by which a head plate can hold them.

use metamorph_core::lattice::{Cell, Face};
use metamorph_roombots::lattice_pose::{Half, LatticePose, LatticeRotation};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// The largest number of cells of an element.
pub const MAX_CELLS: usize = 64;

/// The shapes that have a name, for messages.
pub const NAMES: &str = "cube, bar2, bar3, L3, plate2x2, plate3x3, plateNxM, module";

/// Why there is no such element.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ElementError {
    /// A name that no shape has.
    #[error("`{0}` is not an element; write one of {NAMES}")]
    UnknownName(String),
    /// No cell, or too many.
    #[error("an element has 1 to {MAX_CELLS} cells, this one has {0}")]
    CellCount(usize),
    /// A cell that is given twice.
    #[error("cell {0} of the element is given twice")]
    CellTwice(Cell),
    /// Cells that are not connected by faces.
    #[error("cell {0} of the element is not connected to the first one by faces")]
    Apart(Cell),
    /// A cell too far from the origin of the element.
    #[error("cell {0} of the element is farther than {MAX_CELLS} cells from its origin")]
    TooFar(Cell),
    /// A port that is not on the surface.
    #[error("port {face:?} of cell {cell} is not on the surface of the element")]
    PortInside {
        /// The cell.
        cell: Cell,
        /// The side of the cell.
        face: Face,
    },
}

/// A passive four-way symmetric connector on the surface of an element.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Port {
    /// The cell.
    pub cell: Cell,
    /// The side of the cell.
    pub face: Face,
}

/// A rigid set of cells that are connected by faces.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Element {
    cells: Vec<Cell>,
    ports: Vec<Port>,
}

/// A way in which a head plate holds an element. Ports and twists that put the element into the same cells are one
/// grip.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Grip {
    /// The first port of this grip.
    pub port: Port,
    /// The quarter turns of the element about the normal of the plate, 0..3.
    pub twist: u8,
    /// The pose of the element in the head frame.
    pub offset: LatticePose,
    /// The centres of the cells in the head frame, in half cells, sorted. The cell that is held is at (0, 0, −1).
    pub centres: Vec<Half>,
}

impl Element {
    /// Creates an element with ports on all outer faces.
    pub fn new(cells: impl IntoIterator<Item = Cell>) -> Result<Element, ElementError> {
        let cells = checked(cells.into_iter().collect())?;
        let ports = surface(&cells).collect();
        Ok(Element { cells, ports })
    }

    /// Creates an element with these ports only.
    pub fn with_ports(
        cells: impl IntoIterator<Item = Cell>,
        ports: impl IntoIterator<Item = Port>,
    ) -> Result<Element, ElementError> {
        let mut element = Element::new(cells)?;
        let ports: BTreeSet<Port> = ports.into_iter().collect();
        if let Some(Port { cell, face }) = ports.iter().find(|p| element.ports.binary_search(p).is_err()) {
            return Err(ElementError::PortInside { cell: *cell, face: *face });
        }
        element.ports = ports.into_iter().collect();
        Ok(element)
    }

    /// Returns the cells, sorted.
    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }
    /// Returns the ports, sorted.
    pub fn ports(&self) -> &[Port] {
        &self.ports
    }

    /// Returns the grips by port and twist.
    pub fn grips(&self) -> Vec<Grip> {
        let mut all = BTreeMap::new();
        let mut grips = Vec::new();
        for port in &self.ports {
            let onto = LatticeRotation::all().find(|r| r.face(port.face) == Face::Up);
            let onto = onto.expect("invariant: a rotation of the cube takes any face to any other");
            for twist in 0..4 {
                let rotation = LatticeRotation::QUARTER.power(twist) * onto;
                let [x, y, z] = rotation.apply(doubled(-port.cell));
                let offset = LatticePose { rotation, half: [x, y, z - 1] };
                let centres = self.centres(offset);
                if all.insert(centres.clone(), ()).is_none() {
                    grips.push(Grip { port: *port, twist, offset, centres });
                }
            }
        }
        grips
    }

    /// Returns the centres of the cells at a pose, in half cells, sorted.
    pub fn centres(&self, pose: LatticePose) -> Vec<Half> {
        let mut centres: Vec<Half> = self.cells.iter().map(|c| moved(pose, doubled(*c))).collect();
        centres.sort_unstable();
        centres
    }

    /// Returns the rotations, with the shifts that go with them, that put the element into its own cells.
    pub fn symmetries(&self) -> Vec<LatticePose> {
        let own = self.centres(LatticePose::IDENTITY);
        let of_rotation = |rotation| {
            let turned = self.centres(LatticePose { rotation, half: [0; 3] });
            let half = [0, 1, 2].map(|i| own[0][i] - turned[0][i]);
            let pose = LatticePose { rotation, half };
            (self.centres(pose) == own).then_some(pose)
        };
        LatticeRotation::all().filter_map(of_rotation).collect()
    }
}

fn checked(mut cells: Vec<Cell>) -> Result<Vec<Cell>, ElementError> {
    if cells.is_empty() || cells.len() > MAX_CELLS {
        return Err(ElementError::CellCount(cells.len()));
    }
    let limit = MAX_CELLS as i16;
    if let Some(far) = cells.iter().find(|c| [c.x, c.y, c.z].iter().any(|x| !(-limit..=limit).contains(x))) {
        return Err(ElementError::TooFar(*far));
    }
    let first = cells[0];
    cells.sort_unstable();
    if let Some(pair) = cells.windows(2).find(|pair| pair[0] == pair[1]) {
        return Err(ElementError::CellTwice(pair[0]));
    }
    let mut seen = BTreeSet::from([first]);
    let mut edge = vec![first];
    while let Some(cell) = edge.pop() {
        edge.extend(cell.neighbours().into_iter().filter(|n| cells.contains(n) && seen.insert(*n)));
    }
    match cells.iter().find(|c| !seen.contains(c)) {
        Some(apart) => Err(ElementError::Apart(*apart)),
        None => Ok(cells),
    }
}

/// Iterates over the outer faces of sorted cells.
fn surface(cells: &[Cell]) -> impl Iterator<Item = Port> {
    let outer = |cell: Cell, face: Face| cells.binary_search(&cell.step(face)).is_err();
    cells.iter().flat_map(move |cell| {
        Face::ALL.into_iter().filter(move |face| outer(*cell, *face)).map(|face| Port { cell: *cell, face })
    })
}

/// Returns a cell of an element in half cells. Unlike those of a robot its centre is the origin for cell (0, 0, 0).
fn doubled(c: Cell) -> Half {
    [2 * c.x, 2 * c.y, 2 * c.z]
}

/// Returns the place of a point of a frame outside of it.
pub fn moved(pose: LatticePose, point: Half) -> Half {
    let turned = pose.rotation.apply(point);
    [0, 1, 2].map(|i| pose.half[i] + turned[i])
}

/// Returns the cell whose centre is at this place in half cells of a foot frame.
pub fn cell_at(centre: Half) -> Cell {
    let [x, y, z] = centre;
    Cell::new(x / 2, y / 2, (z - 1).div_euclid(2))
}

/// Returns the centre of a cell in half cells of a foot frame.
pub fn centre_of(cell: Cell) -> Half {
    [2 * cell.x, 2 * cell.y, 2 * cell.z + 1]
}

impl FromStr for Element {
    type Err = ElementError;

    fn from_str(name: &str) -> Result<Element, ElementError> {
        let row = |n: i16| Element::new((0..n).map(|x| Cell::new(x, 0, 0)));
        match name {
            "cube" => row(1),
            "bar2" | "module" => row(2),
            "bar3" => row(3),
            "L3" => Element::new([[0, 0, 0], [1, 0, 0], [0, 1, 0]].map(Cell::from)),
            _ => {
                let unknown = || ElementError::UnknownName(name.to_owned());
                let (n, m) =
                    name.strip_prefix("plate").and_then(|s| s.split_once('x')).ok_or_else(unknown)?;
                let size = |s: &str| s.parse::<u8>().ok().filter(|n| *n > 0).ok_or_else(unknown);
                let (n, m) = (size(n)?, size(m)?);
                if usize::from(n) * usize::from(m) > MAX_CELLS {
                    return Err(ElementError::CellCount(usize::from(n) * usize::from(m)));
                }
                Element::new(
                    (0..i16::from(n)).flat_map(|x| (0..i16::from(m)).map(move |y| Cell::new(x, y, 0))),
                )
            }
        }
    }
}

impl fmt::Display for Grip {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "port {:?} of {}, twist {}", self.port.face, self.port.cell, self.twist)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn grips_and_symmetries_of_the_named_shapes() {
        for (name, cells, grips, symmetries) in [
            ("cube", 1, 1, 24),
            ("bar2", 2, 5, 8),
            ("module", 2, 5, 8),
            ("bar3", 3, 7, 8),
            ("L3", 3, 28, 2),
            ("plate2x2", 4, 8, 8),
            ("plate3x3", 9, 15, 8),
            ("plate2x3", 6, 22, 4),
        ] {
            let element: Element = name.parse().unwrap();
            assert_eq!(element.cells().len(), cells, "{name}");
            assert_eq!(element.grips().len(), grips, "{name}");
            assert_eq!(element.symmetries().len(), symmetries, "{name}");
            for grip in element.grips() {
                assert!(grip.centres.contains(&[0, 0, -1]), "{name}: {grip}");
                // The normal of the port looks into the robot.
                assert_eq!(grip.offset.rotation.face(grip.port.face), Face::Up, "{name}: {grip}");
            }
        }
        assert_eq!("module".parse::<Element>().unwrap().ports().len(), 10);
    }

    #[test]
    fn bad_elements_are_refused_with_a_reason() {
        let of = |cells: &[[i16; 3]]| Element::new(cells.iter().copied().map(Cell::from));
        assert_eq!(of(&[]), Err(ElementError::CellCount(0)));
        assert_eq!(of(&[[0; 3], [0; 3]]), Err(ElementError::CellTwice(Cell::default())));
        assert_eq!(of(&[[0; 3], [1, 1, 0]]), Err(ElementError::Apart(Cell::new(1, 1, 0))));
        assert_eq!(of(&[[0, 0, 16_000]]), Err(ElementError::TooFar(Cell::new(0, 0, 16_000))));
        for name in ["ball", "plate", "plate0x3", "plate3", "Cube", "plate3x-1"] {
            assert_eq!(name.parse::<Element>(), Err(ElementError::UnknownName(name.into())));
        }
        assert_eq!("plate9x9".parse::<Element>(), Err(ElementError::CellCount(81)));
        let inside = Port { cell: Cell::default(), face: Face::East };
        let cells = [Cell::default(), Cell::new(1, 0, 0)];
        let refused = Element::with_ports(cells, [inside]).unwrap_err();
        assert!(refused.to_string().contains("not on the surface"), "{refused}");
        let top = Port { cell: Cell::default(), face: Face::Up };
        assert_eq!(Element::with_ports(cells, [top]).unwrap().grips().len(), 4);
    }
}
