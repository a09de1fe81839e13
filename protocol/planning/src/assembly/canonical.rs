//! The canonical form of a configuration, by geometry: equal for configurations that differ only by a rigid
//! motion, the numbers of modules and the names of their ends.
//!
//! In a connected configuration one module fixes all others. So every module is taken as root, from
//! either end; the others are written in the frame of the root, each from the end whose cell is smaller, and sorted by
//! cell; the least of these lists is the form. Roots are first compared by their own posture and connectors, which
//! leaves one of them in most cases. Exact, and of order n² log n at worst.
//!
//! **Equivalent hemispheres.** The three connectors of an outer hemisphere follow each other by 120° about its
//! diagonal, and so does its body. If all connectors may be used alike and the goal does not name joint values, the
//! angle of an outer joint makes no difference: [`Detail::Frames`] leaves out both outer joint values, which
//! merges up to 9 configurations a module into one. Joints still turn by the same steps to the same places.

use super::configuration::{Configuration, MAX_MODULES, Module};
use super::tables::{OFFSET, Rot, TABLES, Vec3, sub};

/// Level of detail in which two configurations must agree to count as equal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Detail {
    /// Everything.
    Joints,
    /// Everything except outer joint values and the assignment of an outer hemisphere's connectors to its faces.
    Frames,
    /// Everything, and the place: configurations on the ground do not move as a whole (see [`ground`](super::ground)).
    Place,
}

impl Detail {
    /// Returns the bytes of a module other than the root: cell 21 bits, rotation 5, connectors 10, joints 6 or 2.
    const fn bytes(self) -> usize {
        match self {
            Detail::Joints | Detail::Place => 6,
            Detail::Frames => 5,
        }
    }
    /// Returns the number of bytes of the keys of `modules` modules.
    pub const fn key_width(self, modules: usize) -> usize {
        match self {
            Detail::Place => modules * self.bytes(),
            Detail::Joints | Detail::Frames => 2 + (modules - 1) * self.bytes(),
        }
    }
    /// Returns the bits of what does not depend on the place of a module.
    const fn local_bits(self) -> u32 {
        match self {
            Detail::Joints | Detail::Place => 16,
            Detail::Frames => 12,
        }
    }

    /// Returns the module without what this detail leaves out.
    pub fn seen(self, m: &Module) -> Module {
        match self {
            Detail::Joints | Detail::Place => *m,
            Detail::Frames => without_outer_joints(m),
        }
    }

    /// Writes the key of a configuration.
    pub fn key(self, configuration: &Configuration, key: &mut [u8]) {
        let n = configuration.len();
        if self == Detail::Place {
            let mut list = [0; MAX_MODULES];
            for (to, m) in list.iter_mut().zip(configuration.modules()) {
                *to = self.packed(&[*m, m.reversed()], [0; 3], 0);
            }
            list[..n].sort_unstable();
            return self.write(&list[..n], key);
        }
        let mut ends = [[Module::default(); 2]; MAX_MODULES];
        let mut codes = [[0; 2]; MAX_MODULES];
        let mut least = u16::MAX;
        for (i, m) in configuration.modules().iter().enumerate() {
            let m = self.seen(m);
            ends[i] = [m, m.reversed()];
            codes[i] = ends[i].map(|m| self.local(&m));
            least = least.min(codes[i][0]).min(codes[i][1]);
        }
        let mut best = [u64::MAX; MAX_MODULES];
        let mut list = [0; MAX_MODULES];
        for (root, of_ends) in codes[..n].iter().enumerate() {
            for (end, code) in of_ends.iter().enumerate() {
                if *code != least {
                    continue;
                }
                self.list(&ends[..n], root, end, &mut list);
                if list[..n - 1] < best[..n - 1] {
                    best = list;
                }
            }
        }
        key[..2].copy_from_slice(&least.to_be_bytes());
        self.write(&best[..n - 1], &mut key[2..]);
    }

    fn write(self, list: &[u64], key: &mut [u8]) {
        let bytes = self.bytes();
        for (to, module) in key.chunks_exact_mut(bytes).zip(list) {
            to.copy_from_slice(&module.to_be_bytes()[8 - bytes..]);
        }
    }

    /// Packs what does not depend on the place of a module: joint values, and the connectors that hold.
    fn local(self, m: &Module) -> u16 {
        match self {
            Detail::Joints | Detail::Place => u16::from(m.posture) << 10 | m.held,
            Detail::Frames => u16::from(m.posture / 3) << 10 | m.held,
        }
    }

    /// Lists all modules but the root in the frame of the root, in order.
    fn list(self, ends: &[[Module; 2]], root: usize, end: usize, list: &mut [u64; MAX_MODULES]) {
        let origin = ends[root][end].cell;
        let back = TABLES.inverse[usize::from(ends[root][end].rotation)];
        let others = ends.iter().enumerate().filter(|(i, _)| *i != root);
        for (to, (_, module)) in list.iter_mut().zip(others) {
            *to = self.packed(module, origin, back);
        }
        list[..ends.len() - 1].sort_unstable();
    }

    /// Packs a module, given from both ends, in the frame with this origin whose inverse rotation is `back`: from the
    /// end whose cell is smaller.
    fn packed(self, module: &[Module; 2], origin: Vec3, back: Rot) -> u64 {
        let t = &**TABLES;
        let cells =
            [t.packed(back, sub(module[0].cell, origin)), t.packed(back, sub(module[1].cell, origin))];
        let first = usize::from(cells[1] < cells[0]);
        let m = &module[first];
        let rotation = u64::from(t.times(back, m.rotation));
        (cells[first] << 5 | rotation) << self.local_bits() | u64::from(self.local(m))
    }

    /// Returns the configuration with this key; its root is at the origin, unless the key has its place.
    pub fn configuration(self, key: &[u8]) -> Configuration {
        let mut modules = [Module::default(); MAX_MODULES];
        let local = |m: &mut Module, code: u16| {
            m.held = code & 0x3ff;
            m.posture = (code >> 10) as u8 * if self == Detail::Frames { 3 } else { 1 };
        };
        let (mut n, mut rest) = (0, key);
        if self != Detail::Place {
            local(&mut modules[0], u16::from_be_bytes([key[0], key[1]]));
            (n, rest) = (1, &key[2..]);
        }
        for from in rest.chunks_exact(self.bytes()) {
            let code = from.iter().fold(0_u64, |code, b| code << 8 | u64::from(*b));
            let local_bits = self.local_bits();
            local(&mut modules[n], (code & ((1 << local_bits) - 1)) as u16);
            modules[n].rotation = (code >> local_bits & 31) as u8;
            modules[n].cell = unpack(code >> (local_bits + 5));
            n += 1;
        }
        Configuration::new(&modules[..n]).expect("invariant: keys have at most 16 modules")
    }
}

fn unpack(code: u64) -> [i8; 3] {
    [14, 7, 0].map(|shift| (code >> shift & 127) as i8 - OFFSET)
}

/// Returns the module with both outer joints at 0, and the same hemispheres between them and connections at the
/// same faces.
fn without_outer_joints(m: &Module) -> Module {
    let t = &**TABLES;
    let (first, middle, last) = (m.posture / 12, m.posture / 3 % 4, m.posture % 3);
    let turn = |n: u8| (0..n).fold(0, |r, _| t.times(r, t.diagonal));
    // Connector k of the hemisphere at the foot has the frame R D^k = (R D^first) D^(k - first); of that at the
    // head H D^(last + k).
    let foot = rotated_bits(m.held & 7, 3 - first);
    let head = rotated_bits(m.held >> 7, last);
    Module {
        cell: m.cell,
        rotation: t.times(m.rotation, turn(first)),
        posture: middle * 3,
        held: m.held & 0b00_0111_1000 | foot | head << 7,
    }
}

/// Moves bit k of three to bit k + n modulo 3.
fn rotated_bits(bits: u16, n: u8) -> u16 {
    let n = n % 3;
    (bits << n | bits >> (3 - n)) & 7
}
