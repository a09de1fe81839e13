//! Configurations of free modules: where every module is, its joint values, and which connectors hold.

use super::tables::{Code, NONE, Rot, STEP, TABLES, Vec3, add, face_to, hemisphere};

/// The largest number of modules of a configuration.
pub const MAX_MODULES: usize = 16;

/// A module on the lattice.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Module {
    /// The cell of the cube at the foot.
    pub cell: Vec3,
    /// The rotation of the foot frame.
    pub rotation: Rot,
    /// The joint values.
    pub posture: Code,
    /// The connectors that hold, by their numbers as bits.
    pub held: u16,
}

impl Module {
    /// Returns the direction from the first to the second cube.
    pub fn direction(&self) -> u8 {
        let t = &**TABLES;
        t.face[usize::from(self.rotation)][usize::from(t.direction[usize::from(self.posture)])]
    }
    /// Returns the cells of both cubes.
    pub fn cells(&self) -> [Vec3; 2] {
        [self.cell, add(self.cell, STEP[usize::from(self.direction())])]
    }
    /// Returns the same module seen from its other end.
    pub fn reversed(&self) -> Module {
        let t = &**TABLES;
        let posture = usize::from(self.posture);
        Module {
            cell: self.cells()[1],
            rotation: t.times(self.rotation, t.head[posture]),
            posture: t.reversed[posture],
            held: t.reversed_held[usize::from(self.held)],
        }
    }
    /// Returns the connector at a face of a cube, [`NONE`] between the cubes.
    pub fn connector_at(&self, cube: usize, face: u8) -> u8 {
        TABLES.at_face[usize::from(self.rotation)][usize::from(self.posture)][cube][usize::from(face)]
    }
    /// Returns the face that a connector is at.
    pub fn face_of(&self, connector: u8) -> u8 {
        TABLES.normal[usize::from(self.rotation)][usize::from(self.posture)][usize::from(connector)]
    }
    /// Returns the frame of a connector: +z into the module.
    pub fn connector_frame(&self, connector: u8) -> Rot {
        let t = &**TABLES;
        t.times(self.rotation, t.connector[usize::from(self.posture)][usize::from(connector)])
    }
    /// Returns the set of faces of a cube whose connectors hold, as bits.
    pub fn held_faces(&self, cube: usize) -> u8 {
        let mut faces = 0;
        for connector in 5 * cube as u8..5 * cube as u8 + 5 {
            faces |= ((self.held >> connector & 1) as u8) << self.face_of(connector);
        }
        faces
    }
    /// Returns true if a connector holds.
    pub fn holds(&self, connector: u8) -> bool {
        self.held >> connector & 1 != 0
    }
}

/// Two connectors that face each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Pair {
    /// The module with the smaller number, and its connector.
    pub a: (u8, u8),
    /// The other one.
    pub b: (u8, u8),
}

/// A configuration of at most [`MAX_MODULES`] modules.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Configuration {
    len: u8,
    modules: [Module; MAX_MODULES],
}

impl std::fmt::Debug for Configuration {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries(self.modules()).finish()
    }
}

impl Configuration {
    /// Creates a configuration; of more than [`MAX_MODULES`] modules, `None`.
    pub fn new(modules: &[Module]) -> Option<Configuration> {
        let mut all = [Module::default(); MAX_MODULES];
        all.get_mut(..modules.len())?.copy_from_slice(modules);
        Some(Configuration { len: modules.len() as u8, modules: all })
    }
    /// Returns the number of modules.
    pub fn len(&self) -> usize {
        self.len.into()
    }
    /// Returns true if there is no module.
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }
    /// Returns the modules.
    pub fn modules(&self) -> &[Module] {
        &self.modules[..self.len()]
    }
    /// Returns the modules, to be changed.
    pub fn modules_mut(&mut self) -> &mut [Module] {
        let len = self.len();
        &mut self.modules[..len]
    }

    /// Visits all pairs of connectors of different modules that face each other.
    pub fn facing(&self, mut visit: impl FnMut(Pair)) {
        let mut cells = [[[0; 3]; 2]; MAX_MODULES];
        for (i, m) in self.modules().iter().enumerate() {
            cells[i] = m.cells();
        }
        for a in 0..self.len() {
            for b in a + 1..self.len() {
                for x in 0..2 {
                    for y in 0..2 {
                        if let Some(face) = face_to(cells[a][x], cells[b][y]) {
                            let c = self.modules[a].connector_at(x, face);
                            let d = self.modules[b].connector_at(y, face ^ 1);
                            debug_assert!(c != NONE && d != NONE, "modules overlap");
                            visit(Pair { a: (a as u8, c), b: (b as u8, d) });
                        }
                    }
                }
            }
        }
    }

    /// Returns true if both connectors of a pair hold; one alone never does.
    pub fn is_held(&self, pair: Pair) -> bool {
        self.modules[usize::from(pair.a.0)].holds(pair.a.1)
    }

    /// Returns the connections, in order.
    pub fn connections(&self) -> Vec<Pair> {
        let mut all = Vec::with_capacity(self.len() + 4);
        self.facing(|pair| {
            if self.is_held(pair) {
                all.push(pair);
            }
        });
        all
    }

    /// Makes or ends the connection of a pair.
    pub fn set(&mut self, pair: Pair, held: bool) {
        for (module, connector) in [pair.a, pair.b] {
            let bits = &mut self.modules[usize::from(module)].held;
            *bits = *bits & !(1 << connector) | u16::from(held) << connector;
        }
    }
}

/// The connections of a configuration, for questions of connectivity.
#[derive(Clone, Debug)]
pub struct Links {
    /// For each module, the set of modules that it is connected with, as bits.
    neighbours: [u16; MAX_MODULES],
    len: usize,
}

impl Links {
    /// Collects the connections of a list.
    pub fn of(len: usize, connections: impl IntoIterator<Item = Pair>) -> Links {
        let mut neighbours = [0; MAX_MODULES];
        for pair in connections {
            neighbours[usize::from(pair.a.0)] |= 1 << pair.b.0;
            neighbours[usize::from(pair.b.0)] |= 1 << pair.a.0;
        }
        Links { neighbours, len }
    }
    /// Returns the set of all modules.
    pub fn all(&self) -> u16 {
        ((1_u32 << self.len) - 1) as u16
    }
    /// Returns the modules connected with those of `from`, without passing those of `without`.
    pub fn reach(&self, from: u16, without: u16) -> u16 {
        let mut reached = from & !without;
        let mut edge = reached;
        while edge != 0 {
            let next = self.neighbours[edge.trailing_zeros() as usize] & !reached & !without;
            reached |= next;
            edge = edge & (edge - 1) | next;
        }
        reached
    }
    /// Returns true if all modules are connected.
    pub fn is_connected(&self) -> bool {
        self.len > 0 && self.reach(1, 0) == self.all()
    }
}

/// Returns, for each hemisphere of a module, the set of modules connected through it. The modules of a loop are in
/// several of the sets.
pub fn at_hemispheres(links: &Links, connections: &[Pair], module: u8) -> [u16; 4] {
    let own = 1 << module;
    let mut at = [0; 4];
    for pair in connections {
        let (connector, other) = match (pair.a.0 == module, pair.b.0 == module) {
            (true, _) => (pair.a.1, pair.b.0),
            (_, true) => (pair.b.1, pair.a.0),
            _ => continue,
        };
        let place = &mut at[hemisphere(connector)];
        if *place & 1 << other == 0 {
            *place |= links.reach(1 << other, own);
        }
    }
    at
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_module_seen_twice_from_its_other_end_is_itself() {
        for rotation in 0..24 {
            for posture in 0..36 {
                let m = Module { cell: [3, -2, 5], rotation, posture, held: 0b01_1000_1011 };
                let other = m.reversed();
                assert_eq!(other.reversed(), m);
                assert_eq!(other.cells(), [m.cells()[1], m.cells()[0]]);
                assert_eq!([other.held_faces(0), other.held_faces(1)], [m.held_faces(1), m.held_faces(0)]);
            }
        }
    }
}
