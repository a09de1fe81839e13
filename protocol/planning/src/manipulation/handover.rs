//! Hand-over tables: the pairs of postures in which two metamodules hold one element at different ports.

use super::carry::CarryTable;
use super::element::{Element, cell_at, centre_of, moved};
use metamorph_core::lattice::{Cell, Face};
use metamorph_roombots::database::Table;
use metamorph_roombots::lattice_pose::LatticePose;
use std::collections::BTreeMap;

/// A holder and a receiver that hold an element at the same time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct PosturePair {
    /// The posture of the holder.
    pub holder: u16,
    /// The posture of the receiver.
    pub receiver: u16,
}

/// The hand-overs from one grip to another, by the pose of the receiver's foot in the foot frame of the holder.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct HandoverTable {
    /// The number of pairs that hold the element in one place at different ports.
    pub examined: u64,
    /// Those that do not collide, ascending.
    pub pairs: BTreeMap<LatticePose, Vec<PosturePair>>,
}

/// A posture and the cells of its cubes.
type Standing = (u16, [Cell; 4]);

/// Holders with the element in one pose, and which of them fill each cell, a bit for each.
struct Holders {
    postures: Vec<u16>,
    filling: BTreeMap<Cell, Vec<u64>>,
}

impl Holders {
    fn of(standing: Vec<Standing>) -> Holders {
        let mut filling: BTreeMap<Cell, Vec<u64>> = BTreeMap::new();
        for (i, (_, cells)) in standing.iter().enumerate() {
            for cell in cells {
                let words = filling.entry(*cell).or_insert_with(|| vec![0; standing.len().div_ceil(64)]);
                words[i / 64] |= 1 << (i % 64);
            }
        }
        Holders { postures: standing.into_iter().map(|(posture, _)| posture).collect(), filling }
    }

    /// Iterates over the holders that fill none of these cells.
    fn clear_of(&self, cells: [Cell; 4]) -> impl Iterator<Item = u16> + '_ {
        let filling = cells.map(|cell| self.filling.get(&cell));
        let is_clear =
            move |i: &usize| filling.iter().flatten().all(|words| words[i / 64] >> (i % 64) & 1 == 0);
        (0..self.postures.len()).filter(is_clear).map(|i| self.postures[i])
    }
}

impl HandoverTable {
    /// Generates the table for a holder and a receiver with these carry tables, both in their main sets. The foot of the receiver
    /// is on the floor of the holder, or on a wall above it.
    pub fn new(
        table: &Table,
        element: &Element,
        holder: &CarryTable,
        receiver: &CarryTable,
    ) -> HandoverTable {
        HandoverTable::between(table, element, [holder, receiver], [holder.main_set(), receiver.main_set()])
    }

    /// Generates the table for these postures of a holder and a receiver.
    pub fn between(
        table: &Table,
        element: &Element,
        [holder, receiver]: [&CarryTable; 2],
        [holders, receivers]: [Vec<u16>; 2],
    ) -> HandoverTable {
        let symmetries = element.symmetries();
        let receivers = by_pose(table, receiver, &receivers);
        // The middle of the occupied port, in the frame of the element.
        let port_of = |carry: &CarryTable| carry.grip().offset.inverse().half;
        let mut found = HandoverTable::default();
        for (pose, holders) in by_pose(table, holder, &holders) {
            let (occupied, holders) = (moved(pose, port_of(holder)), Holders::of(holders));
            for symmetry in &symmetries {
                let turned = pose.compose(*symmetry);
                if moved(turned, port_of(receiver)) == occupied {
                    continue;
                }
                for (of_receiver, receivers) in &receivers {
                    let foot = turned.compose(of_receiver.inverse());
                    if is_foothold(foot) {
                        found.add(foot, &holders, receivers);
                    }
                }
            }
        }
        found.pairs.values_mut().for_each(|pairs| pairs.sort_unstable());
        found
    }

    fn add(&mut self, foot: LatticePose, holders: &Holders, receivers: &[Standing]) {
        self.examined += (holders.postures.len() * receivers.len()) as u64;
        let mut free = Vec::new();
        for (receiver, cells) in receivers {
            let cells = cells.map(|cell| cell_at(moved(foot, centre_of(cell))));
            if cells.iter().any(|c| c.z < 0) {
                continue;
            }
            free.extend(holders.clear_of(cells).map(|holder| PosturePair { holder, receiver: *receiver }));
        }
        if !free.is_empty() {
            self.pairs.entry(foot).or_default().extend(free);
        }
    }

    /// Returns the number of pairs that do not collide.
    pub fn free(&self) -> usize {
        self.pairs.values().map(Vec::len).sum()
    }
    /// Returns the number of foot poses on the floor of the holder.
    pub fn same_floor(&self) -> usize {
        self.pairs.keys().filter(|foot| foot.rotation.up() == Face::Up).count()
    }
}

/// Returns true for foot poses on the floor, and on walls above it.
fn is_foothold(pose: LatticePose) -> bool {
    match pose.rotation.up() {
        Face::Up => pose.half[2] == 0,
        Face::Down => false,
        _ => pose.half[2] > 0,
    }
}

/// Returns postures by the pose of the element in the foot frame.
fn by_pose(table: &Table, carry: &CarryTable, postures: &[u16]) -> BTreeMap<LatticePose, Vec<Standing>> {
    let mut all: BTreeMap<LatticePose, Vec<Standing>> = BTreeMap::new();
    for posture in postures {
        let placement = table.postures()[usize::from(*posture)].posture.placement();
        let pose = placement.head.compose(carry.grip().offset);
        all.entry(pose).or_default().push((*posture, placement.cells));
    }
    all
}
