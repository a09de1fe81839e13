//! The kept-edges bound: a lower bound of the cost of a plan, by the connections that it keeps from beginning to end.
//!
//! Let K be the connections that a plan never releases. Every other one is detached, every join of the goal that K
//! does not cover is attached, and every module turns its joints from their present values to those of its place in
//! the goal; a kept connection keeps the rotation between its two connectors. The bound is the least sum over all K,
//! all places of modules in the goal and all of their 144 end poses (4 frames about the long axis, 36 postures).
//!
//! It is computed in one pass over a spanning tree of the connections, from the leaves. For each module, each place in
//! the goal and each frame of the connector towards its parent, it has the least cost of the subtree. A connection is
//! either cut or leads to the place that the goal joins there. Two modules may get the same place, and connections
//! outside of the tree need not fit: both only lower the bound. Values of outer joints are relative to the present
//! ones (see [`canonical`](super::canonical)), so turns count the same under every name of the connectors.

use super::canonical::Detail;
use super::configuration::{Configuration, MAX_MODULES};
use super::shape::{Shape, frames_along};
use super::shape_graph::Prices;
use super::tables::{ROTATIONS, Rot, TABLES, hemisphere};
use crate::plan::Cost;
use metamorph_roombots::connector::Connector;
use std::cell::RefCell;
use std::sync::LazyLock;

/// Number of end poses of a module whose long axis is given.
const POSES: usize = 144;
/// A number of actions above every cost.
const NEVER: u16 = 0x3fff;

/// The end poses by direction of the long axis.
struct Poses {
    /// The frame of each connector.
    frames: [[[Rot; 10]; POSES]; 6],
    /// For a module with one kept connection, the fewest steps of joints, by direction of the long axis, present value
    /// of the middle joint, connector and frame of the connector.
    leaf: Box<[[[[u8; ROTATIONS]; 10]; 4]; 6]>,
    /// The frames of connectors whose outward normal, −z, points to a face.
    outward: [[Rot; 4]; 6],
}

static END_POSES: LazyLock<Box<Poses>> = LazyLock::new(|| {
    let t = &**TABLES;
    let mut poses = Box::new(Poses {
        frames: [[[0; 10]; POSES]; 6],
        leaf: Box::new([[[[u8::MAX; ROTATIONS]; 10]; 4]; 6]),
        outward: [0, 1, 2, 3, 4, 5].map(|face| {
            let all = (0..ROTATIONS as Rot).filter(|r| t.face[usize::from(*r)][5] == face);
            all.collect::<Vec<_>>().try_into().expect("four rotations turn a direction to another")
        }),
    });
    let power = |one: Rot, n: usize| (0..n).fold(0, |r, _| t.times(r, one));
    for pose in 0..POSES {
        let (class, first, middle, last) = (pose / 36, pose / 12 % 3, pose / 3 % 4, pose % 3);
        let outer = u8::from(first > 0) + u8::from(last > 0);
        let turns = middle_turns(middle).map(|turns| turns + outer);
        for direction in 0..6 {
            let behind = frames_along(direction as u8)[class];
            let front = t.times(behind, power(t.diagonal, (3 - first) % 3));
            let second = t.times(behind, power(t.quarter, middle));
            let end = t.times(second, power(t.diagonal, last));
            for connector in Connector::ALL {
                let base = [front, behind, second, end][connector.hemisphere()];
                let own = t.rotations.iter().position(|r| *r == connector.frame());
                let frame = t.times(base, own.expect("the rotations are a group") as Rot);
                poses.frames[direction][pose][connector as usize] = frame;
                for (now, turns) in turns.into_iter().enumerate() {
                    let least = &mut poses.leaf[direction][now][connector as usize][usize::from(frame)];
                    *least = turns.min(*least);
                }
            }
        }
    }
    poses
});

/// Returns the number of a pose: the frame about the long axis, and the joint values.
const fn pose_of(class: usize, first: usize, middle: usize, last: usize) -> usize {
    class * 36 + first * 12 + middle * 3 + last
}

/// Returns the steps of the middle joint between a value and each of the four.
fn middle_turns(value: usize) -> [u8; 4] {
    [0, 1, 2, 3].map(|other: usize| {
        let apart = other.abs_diff(value);
        apart.min(4 - apart) as u8
    })
}

/// A cube: its module, and which of the two it is.
type Cube = (u8, u8);

/// The joins of a goal, prepared for the bound.
#[derive(Clone, Debug)]
pub struct KeptEdges {
    modules: usize,
    prices: Prices,
    directions: Vec<u8>,
    /// For each face of each cube of each module, the cube that the goal joins there.
    joined: Vec<[[Option<Cube>; 6]; 2]>,
    joins: Cost,
    scratch: RefCell<Box<Scratch>>,
}

/// Scratch memory, too large to be cleared for each computation; all of it is written before it is read.
#[derive(Clone, Debug)]
struct Scratch {
    paid: [Costs; MAX_MODULES],
    costs: Costs,
}

/// A connection of the spanning tree, seen from the child.
#[derive(Clone, Copy, Default)]
struct Branch {
    parent: u8,
    /// The connectors of the child and of the parent.
    own: u8,
    other: u8,
    /// The child's connector frame in that of the parent.
    relative: Rot,
}

/// The least cost of a module's subtree, by place of the module and frame of its connector towards the parent.
type Costs = [[u16; ROTATIONS]; 2 * MAX_MODULES];

impl KeptEdges {
    /// Prepares the bound for a goal.
    pub fn to(goal: &Shape, prices: Prices) -> KeptEdges {
        let mut joined = vec![[[None; 6]; 2]; goal.len()];
        let joins = goal.joins();
        for j in &joins {
            joined[usize::from(j.a.0)][usize::from(j.a.1)][usize::from(j.face)] = Some(j.b);
            joined[usize::from(j.b.0)][usize::from(j.b.1)][usize::from(j.face ^ 1)] = Some(j.a);
        }
        let cleared: Costs = [[NEVER; ROTATIONS]; 2 * MAX_MODULES];
        let scratch = RefCell::new(Box::new(Scratch { paid: [cleared; MAX_MODULES], costs: cleared }));
        let directions = goal.bars().iter().map(|b| b.direction).collect();
        KeptEdges { modules: goal.len(), prices, directions, joined, joins: joins.len() as Cost, scratch }
    }

    /// Returns a lower bound of the cost from a configuration to the goal.
    pub fn of(&self, configuration: &Configuration) -> Cost {
        let mut seen = *configuration;
        for m in seen.modules_mut() {
            *m = Detail::Frames.seen(m);
        }
        let connections = seen.connections();
        let (order, branches) = spanning_tree(&seen, &connections);
        let mut children = [[0_u8; MAX_MODULES]; MAX_MODULES];
        let mut count = [0; MAX_MODULES];
        for m in &order[1..self.modules] {
            let parent = usize::from(branches[usize::from(*m)].parent);
            children[parent][count[parent]] = *m;
            count[parent] += 1;
        }
        let cut = (self.prices.detach + self.prices.attach) as u16;
        // By child: what the parent pays for it, by the place and the connector frame of the parent.
        let scratch = &mut *self.scratch.borrow_mut();
        let (paid, costs) = (&mut scratch.paid, &mut scratch.costs);
        let mut total = NEVER;
        for m in order[..self.modules].iter().rev() {
            let own = usize::from(*m);
            costs[..2 * self.modules].fill([NEVER; ROTATIONS]);
            let children = &children[own][..count[own]];
            let towards = (*m != order[0]).then_some(branches[own].own);
            let now = usize::from(seen.modules()[own].posture / 3);
            let least = match (towards, children) {
                (Some(connector), []) => self.leaf(now, connector, costs),
                _ => self.behind(middle_turns(now), &branches, children, towards, paid, costs),
            };
            match towards {
                None => total = least,
                Some(_) => self.pay(&branches[own], least + cut, costs, &mut paid[own]),
            }
        }
        self.with_other_edges(connections.len() as Cost, total.into())
    }

    /// Adds the cost of the connections that are not in the spanning tree.
    fn with_other_edges(&self, edges: Cost, tree: Cost) -> Cost {
        let Prices { attach, detach, .. } = self.prices;
        if edges <= self.joins {
            return attach * (self.joins - edges) + tree;
        }
        // As many may be cut for their detachment alone.
        let excess = edges - self.joins;
        (detach * excess).max(tree.saturating_sub(attach * excess))
    }

    /// Writes the costs of a module without children, and returns the least of them: 0, for a pose that needs no turn.
    fn leaf(&self, now: usize, connector: u8, costs: &mut Costs) -> u16 {
        let price = self.prices.turn as u16;
        for (place, costs) in costs.iter_mut().enumerate().take(2 * self.modules) {
            let direction = usize::from(self.directions[place / 2] ^ (place % 2) as u8);
            let leaf = &END_POSES.leaf[direction][now][usize::from(connector)];
            for (cost, turns) in costs.iter_mut().zip(leaf) {
                *cost = if *turns == u8::MAX { NEVER } else { u16::from(*turns) * price };
            }
        }
        0
    }

    /// Computes the costs of a module with its children by place and frame, and returns the least. The joints are
    /// independent once the frame of the hemisphere behind the first one is given: the first joint moves only what is
    /// in front of it, the middle one both hemispheres behind it, the last one the last.
    fn behind(
        &self,
        turns: [u8; 4],
        branches: &[Branch; MAX_MODULES],
        children: &[u8],
        towards: Option<u8>,
        paid: &[Costs; MAX_MODULES],
        costs: &mut Costs,
    ) -> u16 {
        let ends = &**END_POSES;
        let price = self.prices.turn as u16;
        let outer = |steps: usize| if steps > 0 { price } else { 0 };
        // By hemisphere.
        let mut hanging = [[0_u8; MAX_MODULES]; 4];
        let mut count = [0; 4];
        for child in children {
            let at = hemisphere(branches[usize::from(*child)].other);
            hanging[at][count[at]] = *child;
            count[at] += 1;
        }
        let mut least = NEVER;
        for place in 0..2 * self.modules {
            let direction = usize::from(self.directions[place / 2] ^ (place % 2) as u8);
            let frames = &ends.frames[direction];
            // Sums the costs of the branches on one hemisphere in a pose.
            let sum = |at: usize, pose: usize| -> u16 {
                let child = |child: &u8| {
                    let child = usize::from(*child);
                    let frame = frames[pose][usize::from(branches[child].other)];
                    paid[child][place][usize::from(frame)]
                };
                hanging[at][..count[at]].iter().map(child).sum()
            };
            let mut know = |pose: usize, cost: u16| {
                let frame = frames[pose][usize::from(towards.unwrap_or(0))];
                let known = &mut costs[place][usize::from(frame)];
                *known = cost.min(*known);
            };
            for class in 0..4 {
                let base = sum(1, pose_of(class, 0, 0, 0));
                let first = [0, 1, 2].map(|f| outer(f) + sum(0, pose_of(class, f, 0, 0)));
                let front = base + first[0].min(first[1]).min(first[2]);
                let mut behind = NEVER;
                for (middle, turns) in turns.into_iter().enumerate() {
                    let own = u16::from(turns) * price + sum(2, pose_of(class, 0, middle, 0));
                    let last = [0, 1, 2].map(|l| outer(l) + sum(3, pose_of(class, 0, middle, l)));
                    let rest = own + last[0].min(last[1]).min(last[2]);
                    behind = behind.min(rest);
                    match towards.map(hemisphere) {
                        Some(2) => know(pose_of(class, 0, middle, 0), front + rest),
                        Some(3) => {
                            for (l, last) in last.into_iter().enumerate() {
                                know(pose_of(class, 0, middle, l), front + own + last);
                            }
                        }
                        _ => {}
                    }
                }
                match towards.map(hemisphere) {
                    Some(0) => {
                        for (f, first) in first.into_iter().enumerate() {
                            know(pose_of(class, f, 0, 0), base + first + behind);
                        }
                    }
                    Some(1) => know(pose_of(class, 0, 0, 0), front + behind),
                    _ => {}
                }
                least = least.min(front + behind);
            }
        }
        least
    }

    /// Computes what a parent pays for a child: cutting it off, or keeping it where the goal joins the two.
    fn pay(&self, branch: &Branch, cut: u16, costs: &Costs, paid: &mut Costs) {
        let t = &**TABLES;
        let cubes = [branch.other, branch.own].map(|c| hemisphere(c) / 2);
        for (place, paid) in paid.iter_mut().enumerate().take(2 * self.modules) {
            paid.fill(cut);
            let cube = cubes[0] ^ (place % 2);
            for (face, joined) in self.joined[place / 2][cube].iter().enumerate() {
                let Some((module, at)) = joined else { continue };
                let child = 2 * usize::from(*module) + (usize::from(*at) ^ cubes[1]);
                for frame in END_POSES.outward[face] {
                    let own = usize::from(t.times(frame, branch.relative));
                    paid[usize::from(frame)] = cut.min(costs[child][own]);
                }
            }
        }
    }
}

/// Returns the modules, parents first, and of each the connection to its parent. The root is a module with the most
/// neighbours, so that the tree is shallow.
fn spanning_tree(
    seen: &Configuration,
    connections: &[super::configuration::Pair],
) -> ([u8; MAX_MODULES], [Branch; MAX_MODULES]) {
    let t = &**TABLES;
    let mut degree = [0; MAX_MODULES];
    for pair in connections {
        degree[usize::from(pair.a.0)] += 1;
        degree[usize::from(pair.b.0)] += 1;
    }
    let root = (0..seen.len()).max_by_key(|m| (degree[*m], std::cmp::Reverse(*m))).unwrap_or(0);
    let mut order = [0; MAX_MODULES];
    order[0] = root as u8;
    let mut branches = [Branch::default(); MAX_MODULES];
    let mut reached = 1_u32 << root;
    let (mut next, mut len) = (0, 1);
    while next < len {
        let parent = order[next];
        next += 1;
        for pair in connections {
            for (from, to) in [(pair.a, pair.b), (pair.b, pair.a)] {
                if from.0 != parent || reached & 1 << to.0 != 0 {
                    continue;
                }
                reached |= 1 << to.0;
                let frame = |(m, c): (u8, u8)| seen.modules()[usize::from(m)].connector_frame(c);
                let relative = t.times(t.inverse[usize::from(frame(from))], frame(to));
                branches[usize::from(to.0)] = Branch { parent, own: to.1, other: from.1, relative };
                order[len] = to.0;
                len += 1;
            }
        }
    }
    (order, branches)
}
