//! Structures: modules, and the connectors by which they hold each other.

use super::graph::Graph;
use metamorph_core::digest::Portable;
use metamorph_core::ids::ModuleId;
use metamorph_roombots::connector::Connector;
use serde::{Deserialize, Serialize};
use siphasher::sip::SipHasher13;
use std::collections::BTreeMap;
use std::fmt;
use std::hash::{Hash, Hasher};
use thiserror::Error;

/// The largest number of modules of a structure.
pub const MAX_MODULES: usize = 256;
/// Number of joints of a module.
pub const JOINTS: u16 = 3;

/// A joint of a structure: `3 * module + joint`, with joint 0, 1, 2 for q1, q2, q3.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Joint(pub u16);

impl Joint {
    /// Returns joint 0, 1 or 2 of a module with a number below [`MAX_MODULES`].
    pub const fn new(module: ModuleId, joint: u16) -> Joint {
        Joint(JOINTS * module.0 as u16 + joint)
    }
    /// Returns its module.
    pub const fn module(self) -> ModuleId {
        ModuleId((self.0 / JOINTS) as u32)
    }
    /// Returns its number within the module: 0, 1 or 2.
    pub const fn within(self) -> u16 {
        self.0 % JOINTS
    }
    /// Returns its index in arrays of one entry per joint.
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

impl fmt::Display for Joint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.q{}", self.module(), self.within() + 1)
    }
}

/// A connection of two connectors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Connection {
    /// A module.
    pub a: ModuleId,
    /// Its connector.
    pub at: Connector,
    /// The other module.
    pub b: ModuleId,
    /// Its connector.
    pub to: Connector,
    /// Quarter turns 0..3 of `b` about the outward normal of `at`, from the posture in which the diagonal axes of two
    /// modules joined end to end are parallel. It is the same seen from `b`.
    pub rotation: u8,
}

impl Connection {
    /// Returns the joint next to each end: q1 for hemispheres 0 and 1, q3 for 2 and 3. Hemispheres 1 and 2 are between
    /// two joints; the one of the same cube counts.
    pub const fn joints(&self) -> [Joint; 2] {
        [Joint::new(self.a, near(self.at)), Joint::new(self.b, near(self.to))]
    }
    /// Returns the connection with its ends exchanged.
    pub const fn reversed(&self) -> Connection {
        Connection { a: self.b, at: self.to, b: self.a, to: self.at, rotation: self.rotation }
    }
    /// Returns both ends.
    pub const fn ends(&self) -> [(ModuleId, Connector); 2] {
        [(self.a, self.at), (self.b, self.to)]
    }
    /// Returns the connection with its smaller end first.
    fn ordered(self) -> Connection {
        if (self.a, self.at) <= (self.b, self.to) { self } else { self.reversed() }
    }
}

const fn near(connector: Connector) -> u16 {
    if connector.hemisphere() < 2 { 0 } else { 2 }
}

/// Contribution of a module to a structure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
enum Member {
    /// It is not part of the structure.
    Absent,
    /// It is part of it, but its joints do not move: dead or stuck.
    Passive,
    /// It is part of it, and its joints move.
    Active,
}

/// Why a list of modules and connections is not a structure.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum StructureError {
    /// There is no module.
    #[error("the structure has no modules")]
    Empty,
    /// There are too many modules.
    #[error("{0} modules, but a structure has at most {MAX_MODULES}")]
    TooMany(usize),
    /// A connection names a module that is not there.
    #[error("connection {connection}: there is no module {module}")]
    NoModule {
        /// The number of the connection.
        connection: usize,
        /// The module.
        module: ModuleId,
    },
    /// A connection joins a module to itself.
    #[error("connection {connection}: joins module {module} to itself")]
    ToItself {
        /// The number of the connection.
        connection: usize,
        /// The module.
        module: ModuleId,
    },
    /// A connector has two connections.
    #[error("connections {first} and {second} both use connector {connector} of module {module}")]
    UsedTwice {
        /// A connection.
        first: usize,
        /// The other one.
        second: usize,
        /// The module.
        module: ModuleId,
        /// The connector.
        connector: Connector,
    },
    /// A rotation is not a number of quarter turns.
    #[error("connection {connection}: {rotation} is not a number of quarter turns below 4")]
    Rotation {
        /// The number of the connection.
        connection: usize,
        /// The rotation.
        rotation: u8,
    },
    /// A module is not connected with the first one.
    #[error("module {module} is not connected with module {first}")]
    Disconnected {
        /// The module.
        module: ModuleId,
        /// The first module.
        first: ModuleId,
    },
}

/// A connected structure of modules.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Structure {
    /// By the number of the module.
    members: Vec<Member>,
    /// Sorted, each with its smaller end first.
    connections: Vec<Connection>,
}

impl Structure {
    /// Creates a structure of modules numbered from 0, all of them active.
    ///
    /// # Errors
    /// Names the first connection or module that is wrong.
    pub fn new(modules: usize, connections: &[Connection]) -> Result<Structure, StructureError> {
        if modules > MAX_MODULES {
            return Err(StructureError::TooMany(modules));
        }
        let members = (0..modules as u32).map(|m| (ModuleId(m), true)).collect();
        Structure::of(&members, connections)
    }

    /// Creates a structure of these modules; true for those whose joints move.
    ///
    /// # Errors
    /// Names the first connection or module that is wrong.
    pub fn of(
        modules: &BTreeMap<ModuleId, bool>,
        connections: &[Connection],
    ) -> Result<Structure, StructureError> {
        let bound = modules.keys().next_back().map_or(0, |last| last.index() + 1);
        if bound > MAX_MODULES {
            return Err(StructureError::TooMany(bound));
        }
        let mut members = vec![Member::Absent; bound];
        for (module, active) in modules {
            members[module.index()] = if *active { Member::Active } else { Member::Passive };
        }
        let mut used = vec![[None; Connector::ALL.len()]; bound];
        for (i, c) in connections.iter().enumerate() {
            let missing = [c.a, c.b].into_iter().find(|m| !modules.contains_key(m));
            if let Some(module) = missing {
                return Err(StructureError::NoModule { connection: i, module });
            }
            if c.a == c.b {
                return Err(StructureError::ToItself { connection: i, module: c.a });
            }
            if c.rotation > 3 {
                return Err(StructureError::Rotation { connection: i, rotation: c.rotation });
            }
            for (module, connector) in c.ends() {
                if let Some(first) = used[module.index()][connector as usize].replace(i) {
                    return Err(StructureError::UsedTwice { first, second: i, module, connector });
                }
            }
        }
        let mut connections: Vec<Connection> = connections.iter().map(|c| c.ordered()).collect();
        connections.sort_unstable();
        let structure = Structure { members, connections };
        structure.connected()?;
        Ok(structure)
    }

    /// Marks a module as one whose joints do not move. A module that is not there stays away.
    pub fn set_passive(&mut self, module: ModuleId) {
        if let Some(member @ Member::Active) = self.members.get_mut(module.index()) {
            *member = Member::Passive;
        }
    }

    fn connected(&self) -> Result<(), StructureError> {
        let parts = self.graph().parts();
        match parts.as_slice() {
            [] => Err(StructureError::Empty),
            [_] => Ok(()),
            [first, second, ..] => Err(StructureError::Disconnected {
                module: ModuleId(second[0] as u32),
                first: ModuleId(first[0] as u32),
            }),
        }
    }

    /// Returns the connections in order, each with its smaller end first.
    pub fn connections(&self) -> &[Connection] {
        &self.connections
    }
    /// Iterates over the modules that are there.
    pub fn modules(&self) -> impl Iterator<Item = ModuleId> + '_ {
        let there = self.members.iter().enumerate().filter(|(_, m)| **m != Member::Absent);
        there.map(|(i, _)| ModuleId(i as u32))
    }
    /// Returns one more than the largest number that a module can have.
    pub fn bound(&self) -> usize {
        self.members.len()
    }
    /// Returns true if the joints of a module move.
    pub fn is_active(&self, module: ModuleId) -> bool {
        self.members.get(module.index()) == Some(&Member::Active)
    }
    /// Returns pairs of modules with more than one connection; they count as one edge between modules.
    pub fn joined_twice(&self) -> Vec<(ModuleId, ModuleId)> {
        let mut pairs: Vec<_> = self.connections.iter().map(|c| (c.a, c.b)).collect();
        pairs.sort_unstable();
        let mut twice: Vec<_> = pairs.windows(2).filter(|w| w[0] == w[1]).map(|w| w[0]).collect();
        twice.dedup();
        twice
    }

    /// Returns the graph of modules: an edge where two modules hold each other.
    pub fn graph(&self) -> Graph {
        let mut graph = Graph::new(self.members.len());
        self.modules().for_each(|m| graph.insert(m.index()));
        self.connections.iter().for_each(|c| graph.join(c.a.index(), c.b.index()));
        graph
    }
    /// Returns the graph of joints (FO): q1-q2-q3 in every module, and an edge per connection.
    pub fn joint_graph(&self) -> Graph {
        let mut graph = Graph::new(self.members.len() * usize::from(JOINTS));
        for module in self.modules() {
            let [q1, q2, q3] = [0, 1, 2].map(|j| Joint::new(module, j).index());
            [q1, q2, q3].into_iter().for_each(|q| graph.insert(q));
            graph.join(q1, q2);
            graph.join(q2, q3);
        }
        for connection in &self.connections {
            let [a, b] = connection.joints();
            graph.join(a.index(), b.index());
        }
        graph
    }

    /// Returns a hash that is the same on every machine: of members, which of them are passive, and connections.
    pub fn fingerprint(&self) -> u64 {
        let mut hasher = SipHasher13::new();
        let mut portable = Portable::new(&mut hasher);
        self.members.iter().for_each(|m| (*m as u8).hash(&mut portable));
        for c in &self.connections {
            (c.a, c.at as u8, c.b, c.to as u8, c.rotation).hash(&mut portable);
        }
        drop(portable);
        hasher.finish()
    }
}
