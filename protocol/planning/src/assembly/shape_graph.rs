//! The graph of shapes: what turns, attachments and detachments can do to a shape if joint values are free.
//!
//! A turn may use any diagonal that some joint values would give; cubes may attach at any two faces that touch;
//! final cells must be free. Every action of a configuration, under every stricter set of rules, changes its
//! shape by at most one edge of this graph. So distances in it never exceed those of configurations, and one
//! action changes them by one at most: an admissible and consistent lower bound.

use super::configuration::{Links, MAX_MODULES, Pair};
use super::shape::{Bar, Join, Shape, frames_along};
use super::tables::{TABLES, Vec3, add, sub};
use crate::plan::{Cost, Space};

/// Costs of the actions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Prices {
    /// Of an attachment.
    pub attach: Cost,
    /// Of a detachment.
    pub detach: Cost,
    /// Of a step of a joint.
    pub turn: Cost,
}

/// The kinds of edges.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Change {
    /// Two cubes are joined.
    Attach,
    /// They are parted.
    Detach,
    /// A part of the shape turns.
    Turn,
}

impl Prices {
    /// Every action costs 1.
    pub const ONE: Prices = Prices { attach: 1, detach: 1, turn: 1 };

    /// Returns the cost of a change.
    pub fn of(&self, change: Change) -> Cost {
        match change {
            Change::Attach => self.attach,
            Change::Detach => self.detach,
            Change::Turn => self.turn,
        }
    }
    /// Returns the least cost.
    pub fn least(&self) -> Cost {
        self.attach.min(self.detach).min(self.turn)
    }
}

/// The graph as a search space without a goal. Edges lead both ways, so a search towards a shape starts from it.
#[derive(Clone, Debug)]
pub struct ShapeGraph {
    /// The number of modules.
    pub modules: usize,
    /// The costs of edges, in the direction of the search.
    pub prices: Prices,
}

impl Space for ShapeGraph {
    type State = Shape;
    type Action = Change;
    fn key_width(&self) -> usize {
        Shape::key_width(self.modules)
    }
    fn key(&self, shape: &Shape, key: &mut [u8]) {
        shape.key(key);
    }
    fn state(&self, key: &[u8]) -> Shape {
        Shape::from_key(key)
    }
    fn expand(&self, shape: &Shape, visit: &mut impl FnMut(Change, Cost, &Shape)) {
        expand(shape, &mut |change, next| visit(change, self.prices.of(change), next));
    }
    fn lower(&self, _: &Shape) -> Option<Cost> {
        Some(0)
    }
    fn is_goal(&self, _: &Shape) -> bool {
        false
    }
}

/// Visits all neighbours of a shape.
pub fn expand(shape: &Shape, visit: &mut impl FnMut(Change, &Shape)) {
    let n = shape.len();
    let mut touching = Vec::with_capacity(2 * n);
    shape.touching(|join| touching.push(join));
    let joins: Vec<Join> = touching.iter().filter(|j| shape.is_joined(**j)).copied().collect();
    let pair = |j: &Join| Pair { a: (j.a.0, 0), b: (j.b.0, 0) };
    let links = Links::of(n, joins.iter().map(pair));
    let mut next = *shape;
    for join in &touching {
        if !shape.is_joined(*join) {
            next.set(*join, true);
            visit(Change::Attach, &next);
            next.set(*join, false);
        } else if joins.len() >= n {
            let rest = joins.iter().filter(|j| *j != join).map(pair);
            if Links::of(n, rest).is_connected() {
                next.set(*join, false);
                visit(Change::Detach, &next);
                next.set(*join, true);
            }
        }
    }
    for module in 0..n as u8 {
        turns(shape, &joins, &links, module, visit);
    }
}

/// Visits the shapes after turns of the joints of one module.
fn turns(shape: &Shape, joins: &[Join], links: &Links, module: u8, visit: &mut impl FnMut(Change, &Shape)) {
    let t = &**TABLES;
    let bar = shape.bars()[usize::from(module)];
    // The modules that hang at each face of both cubes.
    let mut at = [[0_u16; 6]; 2];
    for join in joins {
        let (cube, face, other) = match (join.a.0 == module, join.b.0 == module) {
            (true, _) => (join.a.1, join.face, join.b.0),
            (_, true) => (join.b.1, join.face ^ 1, join.a.0),
            _ => continue,
        };
        at[usize::from(cube)][usize::from(face)] |= links.reach(1 << other, 1 << module);
    }
    let all = |cube: usize| at[cube].iter().fold(0, |a, b| a | b);
    let mut turned = |moving: u16, still: u16, turn: u8, pivot: Vec3, own: Bar| {
        if moving & still == 0 {
            let (next, free) = moved(shape, module, moving, turn, pivot, own);
            if free {
                visit(Change::Turn, &next);
            }
        }
    };
    for (end, own) in [bar, bar.reversed()].into_iter().enumerate() {
        for frame in frames_along(own.direction) {
            let behind = [0, 2].map(|f| t.face[usize::from(frame)][f]);
            let carried: u8 = behind.iter().map(|f| 1 << f).sum();
            let faces = |set: bool| {
                (0..6).filter(move |f| (carried & 1 << f != 0) == set).fold(0, |a, f| a | at[end][f])
            };
            let (moving, still) = (faces(true) | all(1 - end), faces(false));
            for diagonal in [t.diagonal, t.inverse[usize::from(t.diagonal)]] {
                let turn = t.times(t.times(frame, diagonal), t.inverse[usize::from(frame)]);
                let image = &t.faces[usize::from(turn)];
                let [a, b] = own.joined;
                let a = a & !carried | image[usize::from(a & carried)];
                let direction = t.face[usize::from(turn)][usize::from(own.direction)];
                let next = Bar { cell: own.cell, direction, joined: [a, image[usize::from(b)]] };
                turned(moving, still, turn, own.cell, if end == 0 { next } else { next.reversed() });
            }
        }
    }
    let frame = frames_along(bar.direction)[0];
    for quarter in [t.quarter, t.inverse[usize::from(t.quarter)]] {
        let turn = t.times(t.times(frame, quarter), t.inverse[usize::from(frame)]);
        let joined = [bar.joined[0], t.faces[usize::from(turn)][usize::from(bar.joined[1])]];
        turned(all(1), all(0), turn, bar.cell, Bar { joined, ..bar });
    }
}

/// Returns the shape after a turn of `moving` about `pivot`, and true if no cell is filled twice.
fn moved(shape: &Shape, module: u8, moving: u16, turn: u8, pivot: Vec3, own: Bar) -> (Shape, bool) {
    let t = &**TABLES;
    let mut next = *shape;
    let n = shape.len();
    let mut cells = [[[0; 3]; 2]; MAX_MODULES];
    for (i, bar) in next.bars_mut().iter_mut().enumerate() {
        if i == usize::from(module) {
            *bar = own;
        } else if moving & 1 << i != 0 {
            bar.cell = add(pivot, t.rotate(turn, sub(bar.cell, pivot)));
            bar.direction = t.face[usize::from(turn)][usize::from(bar.direction)];
            bar.joined = bar.joined.map(|set| t.faces[usize::from(turn)][usize::from(set)]);
        }
        cells[i] = bar.cells();
    }
    let group = |i: usize| if i == usize::from(module) { 2 } else { u8::from(moving & 1 << i != 0) };
    let free = (0..n)
        .all(|i| (i + 1..n).all(|j| group(i) == group(j) || !cells[i].iter().any(|c| cells[j].contains(c))));
    (next, free)
}
