//! How alike two structures are: by labels of their joins, by their largest common subgraph, and by their volumes.
//!
//! A join is labelled by the pair of modules that it joins, as a shape of its own: two joins have one label if one pair
//! can be moved onto the other. This is the report's label 40·source + 4·target + rotation (report 4.1) modulo the
//! eight symmetries of both modules. The report's distance is 1 − |common| / max (report 2.3); the sum over labels
//! bounds the common subgraph from above. None of these bounds the number of actions; the shape distance does.

use super::configuration::Configuration;
use super::shape::{Join, Shape};
use super::tables::{ROTATIONS, TABLES, Vec3, add, sub};
use pathfinding::kuhn_munkres::kuhn_munkres_min;
use pathfinding::matrix::Matrix;
use serde::Serialize;
use std::collections::BTreeMap;

/// The largest number of modules for which the common subgraph is computed.
const MOST_MATCHED: usize = 8;

/// The similarities of two structures.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Similarity {
    /// The number of joins of one structure that have a partner with the same label in the other.
    pub shared_labels: usize,
    /// The larger number of joins.
    pub joins: usize,
    /// Joins of the largest common subgraph, for at most 8 modules.
    pub common_subgraph: Option<usize>,
    /// The square of the Hausdorff distance of the cells, least over 24 rotations and all shifts.
    pub hausdorff_squared: i32,
    /// The sum of |dx| + |dy| + |dz| over the best assignment of cells, least over 24 rotations and all shifts.
    pub assignment: i32,
}

/// Returns the label of a join.
pub fn label(shape: &Shape, join: Join) -> Vec<u8> {
    let mut pair = [join.a.0, join.b.0].map(|m| shape.bars()[usize::from(m)]);
    pair.iter_mut().for_each(|bar| bar.joined = [0; 2]);
    let mut pair = Shape::new(&pair).expect("invariant: two modules are few");
    pair.set(Join { a: (0, join.a.1), b: (1, join.b.1), face: join.face }, true);
    pair.canonical()
}

/// Returns the numbers of joins by label.
pub fn labels(shape: &Shape) -> BTreeMap<Vec<u8>, usize> {
    let mut all = BTreeMap::new();
    for join in shape.joins() {
        *all.entry(label(shape, join)).or_default() += 1;
    }
    all
}

/// Returns the number of joins with partners of the same label.
pub fn shared(a: &BTreeMap<Vec<u8>, usize>, b: &BTreeMap<Vec<u8>, usize>) -> usize {
    a.iter().map(|(label, n)| *n.min(b.get(label).unwrap_or(&0))).sum()
}

/// Compares two configurations with the same number of modules.
pub fn similarity(a: &Configuration, b: &Configuration) -> Similarity {
    let shapes = [a, b].map(Shape::of);
    let [of_a, of_b] = shapes.map(|s| labels(&s));
    let [hausdorff_squared, assignment] = volumes(&shapes);
    Similarity {
        shared_labels: shared(&of_a, &of_b),
        joins: shapes[0].joins().len().max(shapes[1].joins().len()),
        common_subgraph: (a.len() <= MOST_MATCHED).then(|| common_subgraph(&shapes)),
        hausdorff_squared,
        assignment,
    }
}

/// Labelled joins by their pair of modules.
type Edges = BTreeMap<(u8, u8), Vec<Vec<u8>>>;

/// Returns the joins of the largest common subgraph, by branch and bound over partial maps of modules.
fn common_subgraph(shapes: &[Shape; 2]) -> usize {
    let edges = |shape: &Shape| {
        let mut all: Edges = BTreeMap::new();
        for join in shape.joins() {
            let label = label(shape, join);
            all.entry((join.a.0, join.b.0)).or_default().push(label);
        }
        all
    };
    let n = shapes[0].len();
    let [a, b] = [edges(&shapes[0]), edges(&shapes[1])];
    let mut best = 0;
    extend(&a, &b, n, &mut Vec::new(), 0, &mut best);
    best
}

fn extend(a: &Edges, b: &Edges, n: usize, map: &mut Vec<u8>, matched: usize, best: &mut usize) {
    let next = map.len() as u8;
    let left: usize = a.iter().filter(|((_, to), _)| *to >= next).map(|(_, l)| l.len()).sum();
    if matched + left <= *best {
        return;
    }
    if map.len() == n {
        *best = matched;
        return;
    }
    for image in 0..n as u8 {
        if map.contains(&image) {
            continue;
        }
        let mut more = 0;
        for (from, of_from) in map.iter().enumerate() {
            let Some(labels) = a.get(&(from as u8, next)) else { continue };
            let key = ((*of_from).min(image), (*of_from).max(image));
            let mut partners = b.get(&key).cloned().unwrap_or_default();
            for label in labels {
                if let Some(i) = partners.iter().position(|p| p == label) {
                    partners.swap_remove(i);
                    more += 1;
                }
            }
        }
        map.push(image);
        extend(a, b, n, map, matched + more, best);
        map.pop();
    }
}

/// Returns the squared Hausdorff distance and the assignment distance of the cells.
fn volumes(shapes: &[Shape; 2]) -> [i32; 2] {
    let t = &**TABLES;
    let [a, b] = shapes.map(|s| s.bars().iter().flat_map(|bar| bar.cells()).collect::<Vec<Vec3>>());
    let mut best = [i32::MAX; 2];
    for r in 0..ROTATIONS as u8 {
        let turned: Vec<Vec3> = a.iter().map(|c| t.rotate(r, *c)).collect();
        let mut shifts: Vec<Vec3> = turned.iter().flat_map(|x| b.iter().map(|y| sub(*y, *x))).collect();
        shifts.sort_unstable();
        shifts.dedup();
        for shift in shifts {
            let moved: Vec<Vec3> = turned.iter().map(|c| add(*c, shift)).collect();
            best[0] = best[0].min(hausdorff(&moved, &b));
            let apart = |i: usize, j: usize| difference(moved[i], b[j]).iter().map(|d| d.abs()).sum::<i32>();
            if lower(&moved, &b) < best[1] {
                let costs = Matrix::from_fn(moved.len(), b.len(), |(i, j)| apart(i, j));
                best[1] = best[1].min(kuhn_munkres_min(&costs).0);
            }
        }
    }
    best
}

fn difference(a: Vec3, b: Vec3) -> [i32; 3] {
    sub(a, b).map(i32::from)
}

fn hausdorff(a: &[Vec3], b: &[Vec3]) -> i32 {
    let square = |x: Vec3, y: Vec3| difference(x, y).iter().map(|d| d * d).sum::<i32>();
    let one = |from: &[Vec3], to: &[Vec3]| {
        let nearest = |x: &Vec3| to.iter().map(|y| square(*x, *y)).min().unwrap_or(0);
        from.iter().map(nearest).max().unwrap_or(0)
    };
    one(a, b).max(one(b, a))
}

/// Returns a lower bound of the assignment: the sum of the distances from each cell of `a` to the nearest of `b`.
fn lower(a: &[Vec3], b: &[Vec3]) -> i32 {
    let apart = |x: Vec3, y: Vec3| difference(x, y).iter().map(|d| d.abs()).sum::<i32>();
    a.iter().map(|x| b.iter().map(|y| apart(*x, *y)).min().unwrap_or(0)).sum()
}
