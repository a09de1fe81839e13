//! Shapes: which cells are filled, by which modules, joined at which faces; joint values are left out.
//!
//! This is the report's graph with labels by position (report 2.2 and 3.2). Its canonical form has 8 frames a module as
//! roots, two ends and four rotations about the long axis: the symmetries of a module.

use super::configuration::{Configuration, Links, MAX_MODULES, Module, Pair};
use super::tables::{ROTATIONS, STEP, TABLES, Vec3, add, face_to, sub};
use std::sync::LazyLock;

/// A module of a shape.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Bar {
    /// The cell of one cube.
    pub cell: Vec3,
    /// The direction to the other one.
    pub direction: u8,
    /// The joined faces of both cubes, as bits.
    pub joined: [u8; 2],
}

impl Bar {
    /// Returns both cells.
    pub fn cells(&self) -> [Vec3; 2] {
        [self.cell, add(self.cell, STEP[usize::from(self.direction)])]
    }
    /// Returns the same module named from its other end.
    pub fn reversed(&self) -> Bar {
        let [a, b] = self.joined;
        Bar { cell: self.cells()[1], direction: self.direction ^ 1, joined: [b, a] }
    }
}

/// A shape of at most [`MAX_MODULES`] modules.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Shape {
    len: u8,
    bars: [Bar; MAX_MODULES],
}

impl std::fmt::Debug for Shape {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_list().entries(self.bars()).finish()
    }
}

/// A joined face of two cubes: module and cube at both sides, and the face of the first one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Join {
    /// The module with the smaller number, and its cube.
    pub a: (u8, u8),
    /// The other one.
    pub b: (u8, u8),
    /// The face of the first one.
    pub face: u8,
}

/// The rotations that turn a direction to +z.
static TO_UP: LazyLock<[[u8; 4]; 6]> = LazyLock::new(|| {
    let up = |direction: usize| {
        let turns = (0..ROTATIONS as u8).filter(|r| TABLES.face[usize::from(*r)][direction] == 4);
        turns.collect::<Vec<_>>().try_into().expect("four rotations turn a direction to another")
    };
    [0, 1, 2, 3, 4, 5].map(up)
});

/// Returns the rotations that turn +z to a direction.
pub fn frames_along(direction: u8) -> [u8; 4] {
    TO_UP[usize::from(direction)].map(|r| TABLES.inverse[usize::from(r)])
}

impl Shape {
    /// Creates a shape; of more than [`MAX_MODULES`] modules, `None`.
    pub fn new(bars: &[Bar]) -> Option<Shape> {
        let mut all = [Bar::default(); MAX_MODULES];
        all.get_mut(..bars.len())?.copy_from_slice(bars);
        Some(Shape { len: bars.len() as u8, bars: all })
    }
    /// Returns the shape of a configuration; modules keep their numbers and ends.
    pub fn of(configuration: &Configuration) -> Shape {
        let mut bars = [Bar::default(); MAX_MODULES];
        for (bar, m) in bars.iter_mut().zip(configuration.modules()) {
            *bar = Bar { cell: m.cell, direction: m.direction(), joined: [0, 1].map(|c| m.held_faces(c)) };
        }
        Shape { len: configuration.len() as u8, bars }
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
    pub fn bars(&self) -> &[Bar] {
        &self.bars[..self.len()]
    }
    /// Returns the modules, to be changed.
    pub fn bars_mut(&mut self) -> &mut [Bar] {
        let len = self.len();
        &mut self.bars[..len]
    }

    /// Visits the faces at which cubes of different modules touch.
    pub fn touching(&self, mut visit: impl FnMut(Join)) {
        let mut cells = [[[0; 3]; 2]; MAX_MODULES];
        for (to, bar) in cells.iter_mut().zip(self.bars()) {
            *to = bar.cells();
        }
        for a in 0..self.len {
            for b in a + 1..self.len {
                for x in 0..2_u8 {
                    for y in 0..2_u8 {
                        let (from, to) =
                            (cells[usize::from(a)][usize::from(x)], cells[usize::from(b)][usize::from(y)]);
                        if let Some(face) = face_to(from, to) {
                            visit(Join { a: (a, x), b: (b, y), face });
                        }
                    }
                }
            }
        }
    }
    /// Returns true if the cubes are joined at this face.
    pub fn is_joined(&self, join: Join) -> bool {
        self.bars[usize::from(join.a.0)].joined[usize::from(join.a.1)] & 1 << join.face != 0
    }
    /// Joins or parts two cubes.
    pub fn set(&mut self, join: Join, joined: bool) {
        for ((module, cube), face) in [(join.a, join.face), (join.b, join.face ^ 1)] {
            let bits = &mut self.bars[usize::from(module)].joined[usize::from(cube)];
            *bits = *bits & !(1 << face) | u8::from(joined) << face;
        }
    }
    /// Returns all joined faces, in order.
    pub fn joins(&self) -> Vec<Join> {
        let mut all = Vec::with_capacity(self.len() + 4);
        self.touching(|join| {
            if self.is_joined(join) {
                all.push(join);
            }
        });
        all
    }
    /// Returns true if all modules hang together.
    pub fn is_connected(&self) -> bool {
        Links::of(self.len(), self.joins().into_iter().map(as_pair)).is_connected()
    }

    /// Returns the number of bytes of the keys of `modules` modules.
    pub const fn key_width(modules: usize) -> usize {
        2 + 5 * (modules - 1)
    }

    /// Writes the key: equal for shapes that differ only by a rigid motion, the numbers of modules and the
    /// names of their ends. Returns the number of frames that give it, which is the order of the group of symmetries.
    pub fn key(&self, key: &mut [u8]) -> usize {
        let t = &**TABLES;
        let n = self.len();
        let mut ends = [[Bar::default(); 2]; MAX_MODULES];
        let mut least = u16::MAX;
        let mut codes = [[[0; 4]; 2]; MAX_MODULES];
        for (i, bar) in self.bars().iter().enumerate() {
            ends[i] = [*bar, bar.reversed()];
            for end in 0..2 {
                for (k, r) in TO_UP[usize::from(ends[i][end].direction)].iter().enumerate() {
                    codes[i][end][k] = local(&t.faces[usize::from(*r)], &ends[i][end]);
                    least = least.min(codes[i][end][k]);
                }
            }
        }
        let mut best = [u64::MAX; MAX_MODULES];
        let mut list = [0; MAX_MODULES];
        let mut frames = 0;
        for i in 0..n {
            for end in 0..2 {
                for (k, r) in TO_UP[usize::from(ends[i][end].direction)].iter().enumerate() {
                    if codes[i][end][k] != least {
                        continue;
                    }
                    list_in_frame(&ends[..n], i, end, *r, &mut list);
                    match list[..n - 1].cmp(&best[..n - 1]) {
                        std::cmp::Ordering::Less => (best, frames) = (list, 1),
                        std::cmp::Ordering::Equal => frames += 1,
                        std::cmp::Ordering::Greater => {}
                    }
                }
            }
        }
        key[..2].copy_from_slice(&least.to_be_bytes());
        for (to, bar) in key[2..].chunks_exact_mut(5).zip(&best) {
            to.copy_from_slice(&bar.to_be_bytes()[3..]);
        }
        frames
    }

    /// Returns the key as a vector.
    pub fn canonical(&self) -> Vec<u8> {
        let mut key = vec![0; Shape::key_width(self.len())];
        self.key(&mut key);
        key
    }

    /// Returns the shape with this key.
    pub fn from_key(key: &[u8]) -> Shape {
        let mut bars = [Bar::default(); MAX_MODULES];
        let joined = |code: u64| [(code >> 6) as u8 & 63, code as u8 & 63];
        let root = u16::from_be_bytes([key[0], key[1]]);
        bars[0] = Bar { cell: [0; 3], direction: 4, joined: joined(root.into()) };
        let mut n = 1;
        for from in key[2..].chunks_exact(5) {
            let code = from.iter().fold(0_u64, |code, b| code << 8 | u64::from(*b));
            let cell = [14, 7, 0].map(|shift| (code >> (15 + shift) & 127) as i8 - 64);
            bars[n] = Bar { cell, direction: (code >> 12 & 7) as u8, joined: joined(code) };
            n += 1;
        }
        Shape::new(&bars[..n]).expect("invariant: keys have at most 16 modules")
    }

    /// Returns a configuration of this shape. `fill` chooses for each module its frame along the module (0..3) and its
    /// joint values in steps.
    pub fn filled(&self, mut fill: impl FnMut(usize) -> (u8, [u8; 3])) -> Configuration {
        let t = &**TABLES;
        let mut modules = [Module::default(); MAX_MODULES];
        for (i, bar) in self.bars().iter().enumerate() {
            let (class, steps) = fill(i);
            let back = (0..(3 - steps[0] % 3) % 3).fold(0, |r, _| t.times(r, t.diagonal));
            let behind = frames_along(bar.direction)[usize::from(class % 4)];
            let posture = (steps[0] % 3) * 12 + (steps[1] % 4) * 3 + steps[2] % 3;
            modules[i] = Module { cell: bar.cell, rotation: t.times(behind, back), posture, held: 0 };
            for cube in 0..2 {
                let faces = (0..6).filter(|f| bar.joined[cube] & 1 << f != 0);
                modules[i].held |= faces.map(|f| 1 << modules[i].connector_at(cube, f)).sum::<u16>();
            }
        }
        Configuration::new(&modules[..self.len()]).expect("invariant: shapes have at most 16 modules")
    }
}

fn as_pair(join: Join) -> Pair {
    Pair { a: (join.a.0, 0), b: (join.b.0, 0) }
}

fn local(faces: &[u8; 64], bar: &Bar) -> u16 {
    let [a, b] = bar.joined.map(|set| u16::from(faces[usize::from(set)]));
    a << 6 | b
}

fn list_in_frame(ends: &[[Bar; 2]], root: usize, end: usize, r: u8, list: &mut [u64; MAX_MODULES]) {
    let t = &**TABLES;
    let origin = ends[root][end].cell;
    let mut at = 0;
    for (i, bar) in ends.iter().enumerate() {
        if i == root {
            continue;
        }
        let cells = [t.packed(r, sub(bar[0].cell, origin)), t.packed(r, sub(bar[1].cell, origin))];
        let first = usize::from(cells[1] < cells[0]);
        let bar = &bar[first];
        let direction = u64::from(t.face[usize::from(r)][usize::from(bar.direction)]);
        list[at] = (cells[first] << 3 | direction) << 12 | u64::from(local(&t.faces[usize::from(r)], bar));
        at += 1;
    }
    list[..at].sort_unstable();
}
