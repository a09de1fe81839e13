//! Symmetric limbs, by the labels of their connections (thesis 7.5.2).
//!
//! The connection to the body is one of those compared; without it the limbs of the thesis's second quadruped, of which
//! one is turned, would all be alike.

use super::limbs::Partition;
use super::structure::{Connection, Joint, Structure};
use metamorph_core::ids::ModuleId;
use metamorph_roombots::connector::Connector;
use std::collections::BTreeSet;

/// Returns the class of a connector: 0 for the outer hemispheres, whose connectors are alike under a third of a turn,
/// and 1 to 4 for the others, in their order.
pub const fn class(connector: Connector) -> u64 {
    match connector {
        Connector::C1Y => 1,
        Connector::C1Z => 2,
        Connector::C2Y => 3,
        Connector::C2Z => 4,
        _ => 0,
    }
}

/// Returns a number for each pair of numbers (Cantor's pairing, thesis equation 7.6).
const fn paired(a: u64, b: u64) -> u64 {
    ((a + b) * (a + b) + 3 * a + b) / 2
}

/// Returns the label of a connection whose `a` is nearer to the body.
pub const fn label(connection: &Connection) -> u64 {
    paired(paired(class(connection.at), class(connection.to)), connection.rotation as u64)
}

/// A limb by the distance of its modules from the body.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Levels {
    /// Sorted labels of the connections that lead to each distance from 1, or lie within it.
    pub labels: Vec<Vec<u64>>,
    /// The joints, those near the body first. Joints of symmetric limbs correspond in this order.
    pub joints: Vec<Joint>,
}

impl Levels {
    /// Returns the levels of a limb of a partition.
    pub fn of(structure: &Structure, limb: &[ModuleId]) -> Levels {
        let limb: BTreeSet<ModuleId> = limb.iter().copied().collect();
        let touches = |c: &&Connection| limb.contains(&c.a) || limb.contains(&c.b);
        let connections: Vec<Connection> = structure.connections().iter().filter(touches).copied().collect();
        // All that is nearer to the body: at first what is not in the limb, since limbs do not touch each other.
        let mut inner: BTreeSet<ModuleId> = structure.modules().filter(|m| !limb.contains(m)).collect();
        let (mut labels, mut entries) = (Vec::new(), Vec::<Entry>::new());
        while entries.len() < limb.len() {
            let both = connections.iter().flat_map(|c| [*c, c.reversed()]);
            let outward: Vec<Connection> =
                both.filter(|c| inner.contains(&c.a) && !inner.contains(&c.b)).collect();
            let here: BTreeSet<ModuleId> = outward.iter().map(|c| c.b).collect();
            let within = connections.iter().filter(|c| here.contains(&c.a) && here.contains(&c.b));
            // Neither end is nearer, so the label must not depend on the order of the ends.
            let within = within.map(|c| label(c).min(label(&c.reversed())));
            let mut level: Vec<u64> = outward.iter().map(label).chain(within).collect();
            level.sort_unstable();
            labels.push(level);
            let entry =
                |m: &ModuleId| outward.iter().filter(|c| c.b == *m).map(|c| Entry::of(c, &entries)).min();
            let mut level: Vec<Entry> = here.iter().filter_map(entry).collect();
            // Invariant: a limb is connected with the body, so every level has a module and the loop ends.
            debug_assert!(!level.is_empty(), "a limb is not connected");
            level.sort_unstable();
            entries.extend(level);
            inner.extend(here);
        }
        Levels { labels, joints: entries.iter().flat_map(Entry::joints).collect() }
    }
}

/// How a module of a limb is reached from the body.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Entry {
    /// The place of the module before it in the order; 0 for the body.
    parent: usize,
    label: u64,
    module: ModuleId,
    /// True if it is entered by hemisphere 2 or 3, so that q3 is its joint near the body.
    reversed: bool,
}

impl Entry {
    fn of(connection: &Connection, before: &[Entry]) -> Entry {
        let parent = before.iter().position(|e| e.module == connection.a).map_or(0, |i| i + 1);
        let [_, near] = connection.joints();
        Entry { parent, label: label(connection), module: connection.b, reversed: near.within() == 2 }
    }
    fn joints(&self) -> [Joint; 3] {
        let order = if self.reversed { [2, 1, 0] } else { [0, 1, 2] };
        order.map(|j| Joint::new(self.module, j))
    }
}

/// Returns the groups of symmetric limbs, as indices: limbs with equally many modules and the same labels at every
/// distance. Every limb is in one group; groups are in the order of their first limbs.
pub fn groups(partition: &Partition, levels: &[Levels]) -> Vec<Vec<usize>> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (i, limb) in partition.limbs.iter().enumerate() {
        let alike = |group: &&mut Vec<usize>| {
            let other = group[0];
            partition.limbs[other].len() == limb.len() && levels[other].labels == levels[i].labels
        };
        match groups.iter_mut().find(alike) {
            Some(group) => group.push(i),
            None => groups.push(vec![i]),
        }
    }
    groups
}
